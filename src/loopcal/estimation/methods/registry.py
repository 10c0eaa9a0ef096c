"""The registry of methods: one line for each, its module loaded when the method is first used."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, cast

from loopcal.errors import unknown_name

if TYPE_CHECKING:
    from loopcal.estimation.methods.method import Method

METHODS = {
    "auto": "auto",
    "implicit-loop": "implicit_loop",
    "least-squares": "least_squares",
    "reweighted": "reweighted",
    "implicit-loop-undamped": "undamped",
}
"""Name -> module in this folder, which defines METHOD."""
DEFAULT, PLAIN = "auto", "implicit-loop"
"""The default of a calibration, and that of one fit, where nothing is to be chosen."""


@cache
def method_named(name: str) -> Method:
    """The method of that name.

    Raises InputError naming the nearest method if there is none of that name.
    """
    if name not in METHODS:
        raise unknown_name(f"there is no method {name!r}", name, METHODS)
    module = import_module(f"loopcal.estimation.methods.{METHODS[name]}")
    return cast("Method", module.METHOD)


def names_where(trait: str) -> tuple[str, ...]:
    """The names of the methods that have a trait, a field of `Method` such as "streamable"."""
    return tuple(name for name in METHODS if getattr(method_named(name), trait))

"""Properties that are computed when first used, and kept.

Up to Python 3.11 `functools.cached_property` holds one lock for all objects of a class, so that
threads with a fit each wait for one another. This one holds none, as that of Python 3.12: two
threads that first ask the same object at the same time both compute the value.
"""

from __future__ import annotations

import sys
from functools import cached_property
from typing import TYPE_CHECKING, Any

if not TYPE_CHECKING and sys.version_info < (3, 12):

    class cached_property(cached_property):  # noqa: N801  the name of what it stands for
        """The value of a method, kept in the object's own dictionary."""

        def __get__(self, instance: Any, owner: type | None = None) -> Any:
            if instance is None:
                return self
            kept = instance.__dict__
            if self.attrname not in kept:
                kept[self.attrname] = self.func(instance)
            return kept[self.attrname]


def keep(source: Any, target: Any, of: type) -> None:
    """Give another object what was computed of the properties that this class itself has."""
    computed = (name for name in vars(source) if isinstance(vars(of).get(name), cached_property))
    vars(target).update({name: vars(source)[name] for name in computed})


__all__ = ["cached_property", "keep"]

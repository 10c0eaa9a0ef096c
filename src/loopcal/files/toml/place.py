"""Where a table is, as messages say it (arm.toml: joint[2].form), and what it leaves open."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from loopcal.errors import short

_BARE = re.compile(r"[A-Za-z0-9_-]+")


@dataclass(frozen=True)
class Place:
    """A file and a path of keys in it; positions in lists count from 0 here, from 1 in messages.

    >>> str(Place("arm.toml").at("joint", 1, "form"))
    'arm.toml: joint[2].form'
    """

    file: str
    keys: tuple[str | int, ...] = ()

    def at(self, *keys: str | int) -> Place:
        """A place below this one."""
        return Place(self.file, (*self.keys, *keys))

    def __str__(self) -> str:
        path = toml_path(self.keys)
        return f"{self.file}: {path}" if path else self.file


def toml_path(keys: Sequence[str | int]) -> str:
    """Keys as TOML writes them: data.columns."joint 1", joint[2].form (the second joint)."""
    words = ""
    for key in keys:
        if isinstance(key, int):
            words += f"[{key + 1}]"
        else:
            name = short(key) if _BARE.fullmatch(key) else f'"{short(key)}"'
            words += ("." if words else "") + name
    return words


Names = Callable[[str], Mapping[str, str]]
"""Names and their SI units for a name or glob; raises InputError for one that fits nothing."""


@dataclass(frozen=True)
class Scope:
    """What a table leaves open.

    units: dimension -> unit of numbers that state none; names: what keys of mappings may name, by
    the word in `Key.names`; si: SI unit of the name that the table is of.
    """

    units: Mapping[str, str] = field(default_factory=dict)
    names: Mapping[str, Names] = field(default_factory=dict)
    si: str = "1"


NOTHING = Scope()

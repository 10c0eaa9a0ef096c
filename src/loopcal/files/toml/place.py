"""Where something stands in a TOML file, as messages say it: arm.toml: joint[2].form."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

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

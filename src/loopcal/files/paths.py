"""Paths as files state them: relative to the file, with variables of the environment."""

from __future__ import annotations

import os
import re
from pathlib import Path

from loopcal.errors import InputError
from loopcal.files.toml.place import Place

_VARIABLE = re.compile(r"\$\{(\w+)\}")


def expanded(path: str, folder: Path, place: Place) -> Path:
    """A path of a file, ${NAME} replaced by the environment, relative to the folder.

    Raises InputError naming a variable that is not set.
    """
    for name in _VARIABLE.findall(path):
        if not os.environ.get(name):
            raise InputError(
                f"the path {path!r} needs the environment variable {name}, which is not set",
                code="missing-file",
                place=str(place),
                remedy=f"set it to the folder: export {name}=/path/to/folder",
            )
    found = folder / Path(_VARIABLE.sub(lambda match: os.environ[match[1]], path))
    return found if folder.is_dir() else Path(os.path.normpath(found))  # nothing leads through it


def relative(path: str | Path, folder: str | Path) -> str:
    """A path as a file in a folder states it; absolute where no relative one leads there."""
    try:
        return Path(os.path.relpath(path, folder)).as_posix()
    except ValueError:  # another drive
        return Path(path).resolve().as_posix()

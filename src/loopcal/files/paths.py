"""Paths as files state them: relative to the file, with variables of the environment."""

from __future__ import annotations

import os
import re
from pathlib import Path

from loopcal.errors import InputError
from loopcal.files.toml.place import Place

INSIDE = "LOOPCAL_INSIDE"
"""Environment variable with the folder outside of which files may name no others."""
_VARIABLE = re.compile(r"\$\{(\w+)\}")


def expanded(path: str, folder: Path, place: Place) -> Path:
    """A path of a file, ${NAME} replaced by the environment, relative to the folder.

    Raises InputError naming a variable that is not set, and for a path that leads out of the
    folder in `INSIDE`.
    """
    for name in _VARIABLE.findall(path):
        if not os.environ.get(name):
            raise InputError(
                f"the path {path!r} needs the environment variable {name}, which is not set",
                code="missing-file",
                place=str(place),
                remedy=f"set it to the folder: export {name}=/path/to/folder",
            )
    joined_path = folder / Path(_VARIABLE.sub(lambda match: os.environ[match[1]], path))
    refuse_outside(joined_path, path, str(place))
    # nothing leads through a folder that is not there
    return joined_path if folder.is_dir() else Path(os.path.normpath(joined_path))


def refuse_outside(path: Path, named: str, place: str) -> None:
    """Raise InputError for a path that leads out of the folder in `INSIDE`, by whatever links.

    named: the path as the user wrote it; place: where.
    """
    inside = os.environ.get(INSIDE)
    if inside and not leads_into(path, Path(inside)):
        raise InputError(
            f"the path {named!r} leads out of the folder {inside}",
            code="missing-file",
            place=place,
            remedy="name a file in the folder, no link to another",
        )


def leads_into(path: str | Path, folder: Path) -> bool:
    """Whether a path ends in a folder, or in one inside it, when all links are followed."""
    return Path(os.path.realpath(path)).is_relative_to(os.path.realpath(folder))


def relative(path: str | Path, folder: str | Path) -> str:
    """A path as a file in a folder states it; absolute where no relative one leads there."""
    try:
        return Path(os.path.relpath(path, folder)).as_posix()
    except ValueError:  # another drive
        return Path(path).resolve().as_posix()

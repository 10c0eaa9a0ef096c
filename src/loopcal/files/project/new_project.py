"""A project to start from, written into a folder of its own."""

from __future__ import annotations

from pathlib import Path

from loopcal.errors import InputError
from loopcal.files.atomic import write_files
from loopcal.files.project.templates import template_files


def write_new_project(folder: str | Path, kind: str) -> tuple[Path, ...]:
    """The files of a commented project with a mechanism of this type, as they were written.

    Nothing is overwritten. Raises InputError where a file is in the way, and for a type that
    there is no project for.
    """
    folder = Path(folder)
    files = template_files(kind, folder.as_posix())
    for name in files:
        if (folder / name).exists():
            raise InputError(
                "the file exists and was not changed",
                code="unwritable-file",
                place=str(folder / name),
                remedy="give the project another name",
            )
    write_files(folder, files)
    return tuple(folder / name for name in files)

"""A project to start from, written into a folder of its own."""

from __future__ import annotations

from collections.abc import Mapping
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
    return write_new_files(folder, template_files(kind, folder.as_posix()))


def write_new_files(folder: Path, files: Mapping[str, str | bytes]) -> tuple[Path, ...]:
    """Write the files of a new project, name -> contents, all or none.

    Raises InputError where one of them is there already.
    """
    for name in files:
        if (folder / name).exists():
            raise InputError(
                "the file exists and is kept",
                code="unwritable-file",
                place=str(folder / name),
                remedy="name another folder, or remove the file",
            )
    write_files(folder, files)
    return tuple(folder / name for name in files)


def has_project(name: str) -> bool:
    """Whether a project is in the folder of this name."""
    return (Path(name) / "project.toml").is_file()

"""A project to start from, written into a folder of its own."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from pathlib import Path

from loopcal.errors import InputError, unknown_name
from loopcal.files.atomic import write_files


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
                "the file exists and was not changed",
                code="unwritable-file",
                place=str(folder / name),
                remedy="name another folder, or remove the file",
            )
    write_files(folder, files)
    return tuple(folder / name for name in files)


# Projects to start from: commented, complete, and ready to be simulated and calibrated.

TEMPLATES = (
    "planar-two-link",
    "serial",
    "serial-trackers",
    "serial-draw-wire",
    "serial-socket",
    "urdf",
    "exponentials",
    "motoman-ma1400",
    "four-bar",
    "five-bar",
    "three-rrr",
    "linear-delta",
    "rotary-delta",
    "stewart-gough",
    "function",
)
"""Types of mechanism, and common set-ups of a serial arm, for which there is a project to start
from."""


def template_files(kind: str, folder: str) -> Mapping[str, str]:
    """The files, name -> text, of a project with a mechanism of this type.

    folder: where they shall lie, for the commands that their comments show. Raises InputError
    for a type that there is no project for.
    """
    if kind not in TEMPLATES:
        raise unknown_name(f"there is no project of the type {kind!r}", kind, TEMPLATES)
    # a name that ends in .template keeps linters from taking an example for a module of ours
    shown = shlex.quote(" ".join(folder.split()))
    from importlib import resources

    source = resources.files("loopcal.files.project").joinpath("template_files", kind)
    return {
        entry.name.removesuffix(".template"): entry.read_text("utf-8").replace("NAME/", f"{shown}/")
        for entry in sorted(source.iterdir(), key=lambda entry: entry.name)
        if entry.is_file()
    }

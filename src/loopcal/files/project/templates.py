"""Projects to start from: commented, complete, and ready to be simulated and calibrated."""

from __future__ import annotations

import shlex
from collections.abc import Mapping

from loopcal.errors import unknown_name

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

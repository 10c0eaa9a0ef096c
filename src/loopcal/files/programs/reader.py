"""Programs by the endings of their files, read and written."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from pathlib import Path

from loopcal.errors import InputError
from loopcal.files.atomic import write_atomic
from loopcal.files.programs.fanuc import read_fanuc
from loopcal.files.programs.joint_axes import JointAxes
from loopcal.files.programs.krl import read_krl
from loopcal.files.programs.program import LARGEST, Program, text_of
from loopcal.files.programs.rapid import read_rapid
from loopcal.files.programs.table import read_table
from loopcal.files.programs.urscript import read_urscript
from loopcal.files.programs.yaskawa import read_yaskawa
from loopcal.files.tables.raw import bytes_of

Read = Callable[[str, str, JointAxes], Program]
FORMATS: dict[str, Read] = {
    **dict.fromkeys((".csv", ".tsv", ".txt"), read_table),
    **dict.fromkeys((".mod", ".modx", ".prg", ".sys"), read_rapid),
    **dict.fromkeys((".src", ".dat"), read_krl),
    ".ls": read_fanuc,
    ".jbi": read_yaskawa,
    ".script": read_urscript,
}


def read_program(path: str | Path, axes: JointAxes) -> Program:
    """The targets of a file. Raises InputError for an unknown ending and what cannot be read."""
    path = Path(path)
    read = FORMATS.get(path.suffix.lower())
    if read is None:
        raise InputError(
            f"the ending {path.suffix!r} is that of no known program",
            code="wrong-file-type",
            place=str(path),
            remedy=f"give a file that ends in {', '.join(FORMATS)}",
        )
    data = bytes_of(path, LARGEST)
    program = read(text_of(data, path.name), path.name, axes)
    for target in program.targets:
        if not all(math.isfinite(number.value) for number in target.numbers):
            raise InputError(
                f"the target {target.name} has a number that is too large",
                code="invalid-number",
                place=f"{path.name}, line {target.line}",
                remedy="correct the number",
            )
    return program


def beside(path: str | Path) -> Path:
    """Where a corrected file is written by default: NAME-corrected beside the program."""
    path = Path(path)
    return path.with_name(f"{path.stem}-corrected{path.suffix}")


def refuse_existing(path: Path, force: bool) -> None:
    """Raise InputError where a file is there that would be replaced without being asked."""
    if os.path.lexists(path) and not force:
        raise InputError(
            "the file exists already",
            code="unwritable-file",
            place=str(path),
            remedy="name another file with --out, or replace it with --force",
        )


def write_program(path: Path, content: bytes) -> None:
    """Write a corrected program, whole or not at all."""
    write_atomic(path, content)

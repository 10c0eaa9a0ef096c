"""Programs by the endings of their files, read and written."""

from __future__ import annotations

import math
from pathlib import Path

from loopcal.errors import InputError
from loopcal.files.programs.joint_axes import JointAxes
from loopcal.files.programs.program import LARGEST, Program, refuse_redundant, text_of
from loopcal.files.programs.registry import BY_ENDING
from loopcal.files.tables.raw import bytes_of


def read_program(path: str | Path, axes: JointAxes) -> Program:
    """The targets of a file. Raises InputError for an unknown ending and what cannot be read."""
    path = Path(path)
    dialect = BY_ENDING.get(path.suffix.lower())
    if dialect is None:
        raise InputError(
            f"the ending {path.suffix!r} is that of no known program",
            code="wrong-file-type",
            place=str(path),
            remedy=f"give a file that ends in {', '.join(BY_ENDING)}",
        )
    text = text_of(bytes_of(path, LARGEST), path.name)
    if dialect.drive is not None:  # a table alone has as many joints as the arm
        refuse_redundant(axes, path.name)
    program = dialect.read(text, path.name, axes)
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

"""All dialects of robot programs: which of them a file is in, how it is read and marked."""

from __future__ import annotations

import math
from pathlib import Path

from loopcal.companions.robot.programs import fanuc, krl, rapid, table, urscript, yaskawa
from loopcal.companions.robot.programs.coordinates import JointAxes
from loopcal.companions.robot.programs.dialect import ProgramDialect
from loopcal.companions.robot.programs.program import (
    LARGEST,
    Place,
    Program,
    Span,
    line_end,
    refuse_redundant,
    text_of,
)
from loopcal.errors import InputError
from loopcal.files.tables.raw import bytes_of

_MODULES = (table, rapid, krl, fanuc, yaskawa, urscript)
DIALECTS: dict[str, ProgramDialect] = {one.DIALECT.kind: one.DIALECT for one in _MODULES}
BY_ENDING = {ending: one for one in DIALECTS.values() for ending in one.endings}
WRITTEN = {one.endings[0]: one for one in DIALECTS.values() if one.drive is not None}
"""Those in which poses are driven to, by the ending of their files."""


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


MARK = "targets corrected by loopcal"
"""A comment at the head of a corrected program, so that nothing is corrected twice."""


def correction_mark(program: Program) -> list[Place]:
    """Where the mark is inserted; nowhere in a format, or a part of a program, without its head."""
    dialect = DIALECTS[program.kind]
    head = dialect.head.search(program.text) if dialect.head else None
    if head is None:
        return []
    at = Span(head.end(), head.end())
    return [Place(at, f"{dialect.comment} {MARK}{line_end(program.text)}")]


def refuse_corrected(program: Program) -> None:
    """Raise InputError for a program that carries the mark."""
    sign = DIALECTS[program.kind].comment
    if sign and f"{sign} {MARK}" in program.text:
        raise corrected_already(program.name)


def corrected_already(name: str) -> InputError:
    """The error for a program whose targets are corrected already."""
    return InputError(
        "the targets of this program are corrected already: a second correction would shift them "
        "twice",
        code="unsupported",
        place=name,
        remedy="correct the program as it was before, such as its backup (.bak)",
    )

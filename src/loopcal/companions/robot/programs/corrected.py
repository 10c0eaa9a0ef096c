"""The mark of a corrected program: a comment at its head, so that nothing is corrected twice."""

from __future__ import annotations

from loopcal.companions.robot.programs.program import Place, Program, Span, line_end
from loopcal.companions.robot.programs.registry import DIALECTS
from loopcal.errors import InputError

MARK = "targets corrected by loopcal"


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

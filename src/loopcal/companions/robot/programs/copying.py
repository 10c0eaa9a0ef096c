"""Where targets can be inserted ahead of a move: copies of its lines with a target of their own.

Safe is a move that stands on lines of its own, directly behind the move before it: then every run
of the program comes from there. What stands between them may wait or switch outputs, no more.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from loopcal.companions.robot.programs.program import (
    Move,
    Place,
    Program,
    Rows,
    Span,
    line_end,
    replaced,
)

# Without a bound, many moves on one endless line cost the square of its length.
_LONGEST = 1000
"""Characters of a line, at most."""
NOT_ALONE = "the move does not stand on lines of its own"
NOT_NEXT = "other instructions stand between this move and the one before"


def whole_lines(code: str, span: Span) -> Span | None:
    """The whole lines around a part of the code, without the last line end; None where more than
    blanks stands on them. code: comments blanked."""
    before = re.split(r"[\r\n]", code[max(span.start - _LONGEST, 0) : span.start])[-1]
    after = re.split(r"[\r\n]", code[span.end : span.end + _LONGEST], maxsplit=1)[0]
    if before.strip() or after.strip() or max(len(before), len(after)) == _LONGEST:
        return None
    return Span(span.start - len(before), span.end + len(after))


def movable(
    code: str, last: Span | None, span: Span, harmless: re.Pattern[str]
) -> tuple[Span, str]:
    """The lines of a move, and why nothing can be inserted ahead of it, if so.

    last: the move before, None where it is not known; harmless: all that may stand in between.
    """
    lines = whole_lines(code, span)
    if lines is None:
        return span, NOT_ALONE
    between = None if last is None else code[last.end : span.start]
    if between is None or not harmless.fullmatch(between):
        return lines, NOT_NEXT
    return lines, ""


def inserted(program: Program, ahead: Rows) -> Sequence[Place]:
    """Targets ahead of moves: copies of their lines, each with its target written out in it."""
    if program.insert is not None:
        return program.insert(program, ahead) if ahead else ()
    places = []
    for index, rows in ahead.items():
        move = program.moves[index]
        assert move is not None
        texts = [
            replaced(
                program.text,
                move.lines,
                [Place(move.called, literal(program, move, row, count))],
            )
            for count, row in enumerate(rows, 1)
        ]
        end = line_end(program.text)
        at = Span(move.lines.start, move.lines.start)
        places.append(Place(at, "".join(text + end for text in texts)))
    return places


def literal(program: Program, move: Move, row: Sequence[str], count: int) -> str:
    """The literal of a move's target with other numbers; count: of a target with a label."""
    target = program.targets[move.target]
    places = [Place(Span(n.start, n.end), t) for n, t in zip(target.numbers, row, strict=True)]
    if target.label is not None:
        label = target.label
        places.append(Place(Span(label.start, label.end), f"{label.text}-{count}"))
    return replaced(program.text, target.literal, places)

"""URScript: joints in radians, written into `movej`, `movel` and `movep` or assigned to their name.

A pose p[...] states no joints to begin from, and is left alone; so is what `get_inverse_kin` finds
while the program runs. Source: Universal Robots, The URScript Programming Language, "Motion".
"""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from loopcal.files.programs.copying import NOT_ALONE, movable
from loopcal.files.programs.dialect import WAIT, Drive, ProgramDialect, Stops
from loopcal.files.programs.joint_axes import JointAxes
from loopcal.files.programs.program import (
    NUMBER,
    Lines,
    Move,
    Noted,
    Program,
    ProgramTarget,
    Span,
    blanked,
    numbers_of,
    refuse_redundant,
    written,
)

Array = NDArray[np.float64]
_ASIDE = re.compile(r'"[^"\r\n]*"|#[^\r\n]*')
_NUMBER = NUMBER.pattern
_JOINTS = rf"\[\s*({_NUMBER}(?:\s*,\s*{_NUMBER})*)\s*\]"
_MOVE = re.compile(
    rf"\b(move[jlpc]|servo[jc])[ \t]*\(\s*(?:(?:q|pose)\s*=\s*)?"
    rf"(?:{_JOINTS}|([A-Za-z_]\w*)(?=\s*[,)])|)"
)
_ASSIGNED = re.compile(
    rf"^[ \t]*(?:global[ \t]+|local[ \t]+)?([A-Za-z_]\w*)[ \t]*=[ \t]*(?:{_JOINTS}[ \t]*$)?",
    re.MULTILINE,
)
_HARMLESS = re.compile(
    r"(?:[ \t]*+(?:(?:sleep|sync|textmsg|set_\w*digital_out)\b[^\r\n]*+)?[\r\n]++)*+[ \t]*+"
)
_REST = re.compile(r"[^\r\n]*+")
_UNDERSTOOD = ("movej", "movel", "movep")
_DECIMALS = 9


def read_urscript(text: str, name: str, axes: JointAxes) -> Program:
    """The joint targets of a script. Raises InputError for an arm of more than six joints."""
    refuse_redundant(axes, name)
    lines, code = Lines(text), blanked(text, _ASIDE)
    calls = list(_MOVE.finditer(code))
    called = {m[3] for m in calls if m[3] and m[1] in _UNDERSTOOD}
    circular = {
        word
        for m in calls
        if m[1] not in _UNDERSTOOD
        for word in re.findall(r"[A-Za-z_]\w*", code[m.end(1) : code.find(")", m.end(1)) + 1])
    }
    assigned: dict[str, list[re.Match[str]]] = {}
    for m in _ASSIGNED.finditer(code):
        assigned.setdefault(m[1], []).append(m)
    targets: list[ProgramTarget] = []
    noted: list[Noted] = []
    named: dict[str, int] = {}
    for variable in sorted(called - circular):
        several = assigned.get(variable, [])
        # Of a name that is assigned twice it is not certain which value a move takes.
        target = _target(several[0], 2, variable, lines, axes) if len(several) == 1 else None
        if target is not None:
            named[variable] = len(targets)
            targets.append(target)
    moves: list[Move | None] = []
    last: Span | None = None
    for m, behind in zip(calls, (*calls[1:], None), strict=False):
        line, kind, variable = lines.of(m.start()), m[1], m[3]
        inline = _target(m, 2, f"line {line}", lines, axes) if kind in _UNDERSTOOD else None
        stop = len(code) if behind is None else behind.start()
        end = _REST.match(code, m.end(), stop)  # a second move on the line begins another
        statement = Span(m.start(), m.end() if end is None else end.end())
        whole, fixed = movable(code, last, statement, _HARMLESS)
        last = statement
        # A call over several lines: a copy of its first line alone would be no statement.
        if code.count("(", *statement) != code.count(")", *statement):
            fixed = NOT_ALONE
        if inline is not None:
            moves.append(Move(len(targets), line, kind != "movej", whole, inline.literal, fixed))
            targets.append(inline)
        elif kind in _UNDERSTOOD and variable in named:
            at = Span(*m.span(3))
            moves.append(Move(named[variable], line, kind != "movej", whole, at, fixed))
        else:
            moves.append(None)
            why = "its target is no list of the arm's joints, assigned once"
            if kind not in _UNDERSTOOD:
                why = "a circle, or joints that are followed"
            noted.append(Noted(line, f"{kind}({variable or ''}: {why}"))
    return Program(
        "URScript",
        name,
        text,
        tuple(targets),
        tuple(noted),
        lambda target, joints, pose: _write(target, joints),
        moves=tuple(moves),
    )


def _target(
    match: re.Match[str], group: int, name: str, lines: Lines, axes: JointAxes
) -> ProgramTarget | None:
    """The target of a list of joints; None where there is none, or not of every joint."""
    if match[group] is None:
        return None
    numbers = numbers_of(match[group], match.start(group))
    if len(numbers) != len(axes.joints):
        return None
    q = np.array([number.value for number in numbers])
    step = np.array([10.0 ** -max(number.decimals, _DECIMALS) for number in numbers])
    # with its brackets
    start = match.string.rindex("[", 0, match.start(group))
    literal = Span(start, match.string.index("]", match.end(group)) + 1)
    line = lines.of(match.start(group))
    return ProgramTarget(name, line, False, numbers, q, None, step, literal=literal)


def _write(target: ProgramTarget, joints: Array) -> list[str]:
    return [
        written(v, max(n.decimals, _DECIMALS))
        for v, n in zip(joints.tolist(), target.numbers, strict=True)
    ]


def _driving(stops: Stops) -> list[str]:
    lines = [f"def {stops.name}():", *(f"  # {words}" for words in stops.words)]
    for one, row in zip(stops.ids, stops.texts(9), strict=True):
        # a [rad/s^2] and v [rad/s] of the leading axis.
        lines += [
            f"  # pose {one}",
            f"  movej([{','.join(row)}],a=0.5,v=0.3)",
            f"  sleep({WAIT:g})",
        ]
    return [*lines, "end"]


DIALECT = ProgramDialect(
    "URScript",
    "joints in `movej`, `movel` or `movep`, or assigned to their name once",
    "",
    (".script",),
    read_urscript,
    Drive(_driving, 64, si=True, ended="\n"),
    "#",
    re.compile(r"\A"),
)

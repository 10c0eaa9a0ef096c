"""URScript: joints in radians, written into `movej`, `movel` and `movep` or assigned to their name.

A pose p[...] states no joints to begin from, and is left alone; so is what `get_inverse_kin` finds
while the program runs. Source: Universal Robots, The URScript Programming Language, "Motion".
"""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from loopcal.files.programs.copying import NOT_ALONE, movable
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
_MOVE = re.compile(rf"\b(move[jlpc]|servo[jc])[ \t]*\(\s*(?:{_JOINTS}|([A-Za-z_]\w*)(?=\s*[,)])|)")
_ASSIGNED = re.compile(
    rf"^[ \t]*(?:global[ \t]+|local[ \t]+)?([A-Za-z_]\w*)[ \t]*=[ \t]*(?:{_JOINTS}[ \t]*$)?",
    re.MULTILINE,
)
_HARMLESS = re.compile(
    r"(?:[ \t]*+(?:(?:sleep|sync|textmsg|set_\w*digital_out)\b[^\r\n]*+)?[\r\n]++)*+[ \t]*+"
)
_UNDERSTOOD = ("movej", "movel", "movep")
_DECIMALS = 9


def read_urscript(text: str, name: str, axes: JointAxes) -> Program:
    """The joint targets of a script. Raises InputError for an arm of more than six joints."""
    refuse_redundant(axes, name)
    lines, code = Lines(text), blanked(text, _ASIDE)
    found = list(_MOVE.finditer(code))
    called = {m[3] for m in found if m[3] and m[1] in _UNDERSTOOD}
    circular = {m[3] for m in found if m[3] and m[1] not in _UNDERSTOOD}
    given: dict[str, list[re.Match[str]]] = {}
    for m in _ASSIGNED.finditer(code):
        given.setdefault(m[1], []).append(m)
    targets: list[ProgramTarget] = []
    noted: list[Noted] = []
    named: dict[str, int] = {}
    for own in sorted(called - circular):
        several = given.get(own, [])
        target = _target(several[0], 2, own, lines, axes) if len(several) == 1 else None
        if target is not None:
            named[own] = len(targets)
            targets.append(target)
    moves: list[Move | None] = []
    last: Span | None = None
    for m in found:
        line, kind, own = lines.of(m.start()), m[1], m[3]
        inline = _target(m, 2, f"line {line}", lines, axes) if kind in _UNDERSTOOD else None
        end = re.compile(r"[^\r\n]*").match(code, m.end())
        statement = Span(m.start(), m.end() if end is None else end.end())
        whole, fixed = movable(code, last, statement, _HARMLESS)
        last = statement
        if code.count("(", *statement) != code.count(")", *statement):
            fixed = NOT_ALONE
        if inline is not None:
            moves.append(Move(len(targets), line, kind != "movej", whole, inline.literal, fixed))
            targets.append(inline)
        elif kind in _UNDERSTOOD and own in named:
            at = Span(*m.span(3))
            moves.append(Move(named[own], line, kind != "movej", whole, at, fixed))
        else:
            moves.append(None)
            why = "its target is no list of the arm's joints, assigned once"
            if kind not in _UNDERSTOOD:
                why = "a circle, or joints that are followed"
            noted.append(Noted(line, f"{kind}({own or ''}: {why}"))
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
    found: re.Match[str], group: int, name: str, lines: Lines, axes: JointAxes
) -> ProgramTarget | None:
    """The target of a list of joints; None where there is none, or not of every joint."""
    if found[group] is None:
        return None
    numbers = numbers_of(found[group], found.start(group))
    if len(numbers) != len(axes.joints):
        return None
    q = np.array([number.value for number in numbers])
    step = np.array([10.0 ** -max(number.decimals, _DECIMALS) for number in numbers])
    # with its brackets
    start = found.string.rindex("[", 0, found.start(group))
    literal = Span(start, found.string.index("]", found.end(group)) + 1)
    line = lines.of(found.start(group))
    return ProgramTarget(name, line, False, numbers, q, None, step, literal=literal)


def _write(target: ProgramTarget, joints: Array) -> list[str]:
    return [
        written(v, max(n.decimals, _DECIMALS))
        for v, n in zip(joints.tolist(), target.numbers, strict=True)
    ]

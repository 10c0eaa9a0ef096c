"""ABB RAPID: literals of `jointtarget` and `robtarget`, declared or written into a move.

A jointtarget is [[j1, ..., j6], [e1, ..., e6]] in degrees; a robtarget [[x, y, z], [q1, ..., q4],
[cf1, cf4, cf6, cfx], [e1, ..., e6]] in mm, with the quadrants of axes 1, 4 and 6 (0 for 0 to 90
degrees, -1 for -90 to 0) and cfx from 0 to 7, odd where axis 5 is negative. Source: ABB, Technical
reference manual, RAPID Instructions, Functions and Data types, `confdata`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.files.programs.copying import NOT_ALONE, movable
from loopcal.files.programs.joint_axes import JointAxes
from loopcal.files.programs.poses_text import pose_of_quaternion, quaternion_of_pose
from loopcal.files.programs.program import (
    NUMBER,
    Lines,
    Move,
    Noted,
    Number,
    Program,
    ProgramTarget,
    Span,
    blanked,
    numbers_of,
    refuse_redundant,
    within,
    written,
)

Array = NDArray[np.float64]
_ASIDE = re.compile(r'"(?:[^"\r\n]|"")*"|![^\r\n]*')


def _list(count: int) -> str:
    number = NUMBER.pattern
    return rf"\[\s*({number}(?:\s*,\s*{number}){{{count - 1}}})\s*\]"


_JOINTS = re.compile(rf"\[\s*{_list(6)}\s*,\s*{_list(6)}\s*\]", re.ASCII)
_POSE = re.compile(
    rf"\[\s*{_list(3)}\s*,\s*{_list(4)}\s*,\s*{_list(4)}\s*,\s*{_list(6)}\s*\]", re.ASCII
)
_DECLARED = re.compile(r"\b(jointtarget|robtarget)\s+(\w+)\s*(\{[^}\r\n]*\})?\s*:=", re.IGNORECASE)
_VARIABLE = re.compile(
    r"\b(?:jointtarget|robtarget)[ \t]+(\w+)[ \t]*(?:\{[^}\r\n]*\})?[ \t]*;", re.IGNORECASE
)
_STATEMENT = re.compile(r"[^;]*;?")
_MOVE = re.compile(r"\b(Move\w+|Search\w+|Trigg[LJC]\w*)\b", re.IGNORECASE)
_CHANGED = re.compile(
    r"^[ \t]*(\w+)(?:\{[^}\r\n]*\})?\.\w[\w.]*[ \t]*:=|\b(?:Offs|RelTool)[ \t]*\(",
    re.IGNORECASE | re.MULTILINE,
)
_CALLED = re.compile(r"[A-Za-z]\w*(?=\s*,)")
_COMPACT = re.compile(r"\bIF\b(?![^\r\n]*\bTHEN\b)[^;]*\Z", re.IGNORECASE)
_HARMLESS = re.compile(
    r"\s*(?:(?:WaitTime|WaitDI|WaitDO|Set[DGA]O|Set|Reset|PulseDO|TPWrite)\b[^;]*;\s*)*",
    re.IGNORECASE,
)
_FRAME = re.compile(r"\\\s*WObj\s*:=\s*(\w+)", re.IGNORECASE)
_DECIMALS, _FINE = 6, 9
_EDGE = 1e-6
_REACH = 10_000
"""Characters before a literal in which its statement begins."""


def read_rapid(text: str, name: str, axes: JointAxes) -> Program:
    """The targets of a RAPID module. Raises InputError for an arm of more than six joints."""
    refuse_redundant(axes, name)
    lines, code = Lines(text), blanked(text, _ASIDE)
    found = [*_JOINTS.finditer(code), *_POSE.finditer(code)]
    found.sort(key=lambda m: m.start())
    targets: list[ProgramTarget] = []
    at: dict[int, int] = {}  # start of a literal -> index of its target
    named: dict[str, list[int]] = {}
    circular = {n for m in re.finditer(r"\bMoveC\b([^;]*)", code, re.I) for n in _words(m[1])}
    noted: list[Noted] = []
    for literal in found:
        begin = max(literal.start() - _REACH, 0)
        statement = max(code.rfind(";", begin, literal.start()) + 1, begin)
        before = code[max(code.rfind("\n", begin, literal.start()), statement) : literal.start()]
        declared = _DECLARED.search(code, statement, literal.start())
        own = declared[2] if declared else ""
        if re.search(r"\bMoveC\b", before, re.I) or own.lower() in circular:
            continue
        line = lines.of(literal.start())
        target = _target(literal, own or f"line {line}", line, axes, name)
        at[literal.start()] = len(targets)
        named.setdefault(own.lower(), []).append(len(targets))
        targets.append(target)
    starts = sorted(at)
    noted += [
        Noted(lines.of(m.start()), f"{m[1]}: a variable without a literal")
        for m in _VARIABLE.finditer(code)
    ]
    for declared in _DECLARED.finditer(code):
        end = code.find(";", declared.end())
        if not within(starts, declared.end(), end if end >= 0 else len(code)):
            circle = declared[2].lower() in circular
            words = "a point of a circle" if circle else "no literal of six joints or of a pose"
            noted.append(Noted(lines.of(declared.start()), f"{declared[2]}: {words}"))
    noted += [
        Noted(lines.of(m.end() - 1), f"{m[0].strip()[:40]}: an offset or a changed target")
        for m in _CHANGED.finditer(code)
    ]
    moves = _moves(code, lines, at, named, noted, targets)
    frames = [f for f in _FRAME.findall(code) if f.lower() != "wobj0"]
    return Program(
        "RAPID",
        name,
        text,
        tuple(targets),
        tuple(sorted(noted, key=lambda n: n.line)),
        lambda target, joints, pose: _write(target, joints, pose, axes),
        _fits,
        moves=moves,
        frame=f"the work object {frames[0]!r}" if frames else None,
    )


def _words(text: str) -> list[str]:
    return [w.lower() for w in re.findall(r"[A-Za-z]\w*", text)]


def _target(
    literal: re.Match[str], own: str, line: int, axes: JointAxes, name: str
) -> ProgramTarget:
    n = len(axes.joints)
    first = numbers_of(literal[1], literal.start(1))
    if literal.re is _JOINTS:
        numbers = first[:n]
        q = np.array([number.value for number in numbers]) * axes.scale
        step = _steps(numbers) * axes.scale
        whole = Span(*literal.span())
        return ProgramTarget(own, line, False, numbers, q, None, step, literal=whole)
    numbers = (*first, *numbers_of(literal[2], literal.start(2)))
    values = [number.value for number in numbers]
    config = [float(v) for v in literal[3].split(",")]
    if not all(map(math.isfinite, config)):
        raise InputError(
            f"the configuration of {own} has a number that is too large",
            code="invalid-number",
            place=f"{name}, line {line}",
            remedy="correct the number",
        )
    step = _steps(numbers)
    return ProgramTarget(
        own,
        line,
        True,
        numbers,
        None,
        pose_of_quaternion(values, f"{name}, line {line}"),
        np.array([*(1e-3 * step[:3]), *[2.0 * 10.0**-_FINE] * 3]),
        dict(zip(("cf1", "cf4", "cf6", "cfx"), map(int, config), strict=True)),
        Span(*literal.span()),
    )


def _steps(numbers: Sequence[Number]) -> Array:
    return np.array([10.0 ** -max(number.decimals, _DECIMALS) for number in numbers])


def _write(target: ProgramTarget, joints: Array, pose: Array, axes: JointAxes) -> list[str]:
    old = target.numbers
    if not target.cartesian:
        values = (joints / axes.scale).tolist()
        return [written(v, max(n.decimals, _DECIMALS)) for v, n in zip(values, old, strict=True)]
    values = quaternion_of_pose(pose, [n.value for n in old])
    least = [_DECIMALS] * 3 + [_FINE] * 4
    return [written(v, max(n.decimals, k)) for v, n, k in zip(values, old, least, strict=True)]


def _fits(target: ProgramTarget, joints: Array) -> bool:
    """Whether joints are in the stated quadrants, and axis 5 has the stated sign."""
    degrees = np.degrees(joints)
    for axis, key in ((0, "cf1"), (3, "cf4"), (5, "cf6")):
        stated = target.states.get(key)
        if stated is None or axis >= len(degrees):
            continue
        low = 90.0 * stated
        if not low - _EDGE <= degrees[axis] <= low + 90.0 + _EDGE:
            return False
    cfx = target.states.get("cfx")
    if cfx is None or len(degrees) < 6:
        return True
    negative = bool(cfx % 2)
    return bool(degrees[4] <= _EDGE if negative else degrees[4] >= -_EDGE)


def _moves(
    code: str,
    lines: Lines,
    at: dict[int, int],
    named: dict[str, list[int]],
    noted: list[Noted],
    targets: Sequence[ProgramTarget],
) -> tuple[Move | None, ...]:
    """The moves in their order; those that are not understood are noted."""
    moves: list[Move | None] = []
    starts = sorted(at)
    last: Span | None = None
    for statement in _STATEMENT.finditer(code):
        move = _MOVE.search(statement[0])
        if move is None or ":=" in statement[0][: move.start()]:
            continue
        begin = statement.start() + move.start()
        line, own = lines.of(begin), Span(begin, statement.end())
        conditional = _COMPACT.search(statement[0][: move.start()]) is not None
        before, last = last, None if conditional else own
        kind = move[1].lower()
        inside = within(starts, begin, statement.end())
        word = _CALLED.search(code, begin + len(kind), statement.end())
        known = named.get(word[0].lower(), []) if word else []
        offset = re.search(r"\b(Offs|RelTool)\s*\(", statement[0], re.I)
        if kind not in ("movel", "movej", "moveabsj") or offset or not (inside or len(known) == 1):
            moves.append(None)
            if not offset:
                why = "a circle" if kind == "movec" else "its target is no literal"
                if kind not in ("movel", "movej", "moveabsj", "movec"):
                    why = "an instruction that is not understood"
                noted.append(Noted(line, f"{move[1]}: {why}"))
            continue
        target = at[inside[0]] if inside else known[0]
        called = Span(*word.span()) if word and not inside else targets[target].literal
        whole, fixed = movable(code, before, own, _HARMLESS)
        whole_statement = statement[0].endswith(";") and not conditional
        fixed = fixed if whole_statement else NOT_ALONE
        moves.append(Move(target, line, kind == "movel", whole, called, fixed))
    return tuple(moves)

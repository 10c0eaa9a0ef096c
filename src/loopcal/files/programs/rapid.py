"""ABB RAPID: literals of `jointtarget` and `robtarget`, declared or written into a move.

A jointtarget is [[j1, ..., j6], [e1, ..., e6]] in degrees; a robtarget [[x, y, z], [q1, ..., q4],
[cf1, cf4, cf6, cfx], [e1, ..., e6]] in mm, with the quadrants of axes 1, 4 and 6 (0 for 0 to 90
degrees, -1 for -90 to 0) and cfx from 0 to 7, odd where axis 5 is negative. Source: ABB, Technical
reference manual, RAPID Instructions, Functions and Data types, `confdata`.
"""

from __future__ import annotations

import math
import re
from bisect import bisect_left
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.files.programs.copying import NOT_ALONE, movable
from loopcal.files.programs.dialect import WAIT, Drive, ProgramDialect, Stops
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
    handled,
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
_DECLARED = re.compile(
    r"\b(jointtarget|robtarget)\s++(\w++)\s*+(\{[^{}\r\n]*+\}\s*+)?:=", re.IGNORECASE
)
_VARIABLE = re.compile(
    r"\b(?:jointtarget|robtarget)[ \t]++(\w++)[ \t]*+(?:\{[^{}\r\n]*+\}[ \t]*+)?;", re.IGNORECASE
)
_STATEMENT = re.compile(r"[^;]*;?")
_MOVE = re.compile(r"\b(Move\w+|Search\w+|Trigg[LJC]\w*)\b", re.IGNORECASE)
_CHANGED = re.compile(
    r"^[ \t]*+(\w++)(?:\{[^{}\r\n]*+\})?\.\w[\w.]*+[ \t]*+:=|\b(?:Offs|RelTool)[ \t]*\(",
    re.IGNORECASE | re.MULTILINE,
)
_UNDERSTOOD = re.compile(r"(?:move|trigg)(l|j|absj)(do|ao|go|sync|ios)?", re.IGNORECASE)
_ARGUMENT = re.compile(r"(?:[^,\[\]{}()]|\[[^\[\]]*+\]|\{[^{}]*+\}|\([^()]*+\))*+")
"""Up to the next comma outside of brackets."""
_CALLED = re.compile(r"\s*([A-Za-z]\w*)\s*(?:\{\s*(\d+)\s*\})?\s*(?=\\|\Z)")
_MORE = "the instruction does more than move"
_CIRCLE = re.compile(r"\bMoveC\b", re.IGNORECASE)
_IF = re.compile(r"\b(?:IF|THEN)\b|[\r\n]", re.IGNORECASE)
_HARMLESS = re.compile(
    r"\s*+(?:(?:WaitTime|WaitDI|WaitDO|Set[DGA]O|Set|Reset|PulseDO|TPWrite)\b[^;]*+;\s*+)*+",
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
    literals = [*_JOINTS.finditer(code), *_POSE.finditer(code)]
    literals.sort(key=lambda m: m.start())
    targets: list[ProgramTarget] = []
    at: dict[int, int] = {}  # start of a literal -> index of its target
    named: dict[str, list[int]] = {}
    circular = {n for m in re.finditer(r"\bMoveC\b([^;]*)", code, re.I) for n in _words(m[1])}
    noted: list[Noted] = []
    declarations = list(_DECLARED.finditer(code))
    begun = [m.start() for m in declarations]
    circles = [m.start() for m in _CIRCLE.finditer(code)]
    for literal in literals:
        begin = max(literal.start() - _REACH, 0)
        statement = max(code.rfind(";", begin, literal.start()) + 1, begin)
        before = max(code.rfind("\n", begin, literal.start()), statement)
        declared = bisect_left(begun, statement)
        label = declarations[declared][2] if within(begun, statement, literal.start()) else ""
        if within(circles, before, literal.start()) or label.lower() in circular:
            continue
        line = lines.of(literal.start())
        target = _target(literal, label or f"line {line}", line, axes, name)
        at[literal.start()] = len(targets)
        named.setdefault(label.lower(), []).append(len(targets))
        targets.append(target)
    starts = sorted(at)
    noted += [
        Noted(lines.of(m.start()), f"{m[1]}: a variable without a literal")
        for m in _VARIABLE.finditer(code)
    ]
    end = 0
    for one in declarations:
        if end < one.end():  # else no semicolon stands between the last declaration and this one
            # find gives -1 without a semicolon; the modulo makes it the end of the text.
            end = code.find(";", one.end()) % (len(code) + 1)
        if not within(starts, one.end(), end):
            circle = one[2].lower() in circular
            words = "a point of a circle" if circle else "no literal of six joints or of a pose"
            noted.append(Noted(lines.of(one.start()), f"{one[2]}: {words}"))
    moves, inside = _moves(code, lines, at, named, noted, targets)
    # In reverse: of equal keys a dict keeps the last value, here the first change of a statement.
    changed = {
        code.rfind(";", 0, m.end()): m
        for m in reversed([*_CHANGED.finditer(code)])
        if not within(inside, code.rfind(";", 0, m.end()) + 1, m.end() + 1)
    }
    noted += [
        Noted(lines.of(m.end() - 1), f"{m[0].strip()[:40]}: an offset or a changed target")
        for m in changed.values()
    ]
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
    literal: re.Match[str], label: str, line: int, axes: JointAxes, name: str
) -> ProgramTarget:
    n = len(axes.joints)
    first = numbers_of(literal[1], literal.start(1))
    if len(literal.groups()) == 2:
        numbers = first[:n]
        q = np.array([number.value for number in numbers]) * axes.scale
        step = _steps(numbers) * axes.scale
        whole = Span(*literal.span())
        return ProgramTarget(label, line, False, numbers, q, None, step, literal=whole)
    numbers = (*first, *numbers_of(literal[2], literal.start(2)))
    values = [number.value for number in numbers]
    config = [float(v) for v in literal[3].split(",")]
    if not all(map(math.isfinite, config)):
        raise InputError(
            f"the configuration of {label} has a number that is too large",
            code="invalid-number",
            place=f"{name}, line {line}",
            remedy="correct the number",
        )
    # A change dq of a unit quaternion turns by 2 |dq|.
    step = _steps(numbers)
    return ProgramTarget(
        label,
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


def _fits(target: ProgramTarget, joints: Array) -> NDArray[np.bool_]:
    """Whether joints are in the stated quadrants, and axis 5 has the stated sign."""
    degrees = np.moveaxis(np.degrees(joints), -1, 0)
    fits = np.ones(joints.shape[:-1], dtype=bool)
    for axis, key in ((0, "cf1"), (3, "cf4"), (5, "cf6")):
        stated = target.states.get(key)
        if stated is None or axis >= len(degrees):
            continue
        low = 90.0 * stated - _EDGE
        fits &= (low <= degrees[axis]) & (degrees[axis] <= low + 90.0 + 2.0 * _EDGE)
    cfx = target.states.get("cfx")
    if cfx is not None and len(degrees) >= 6:
        fits &= (-degrees[4] if cfx % 2 else degrees[4]) >= -_EDGE
    return fits


def _compact_if(code: str) -> bool:
    """Whether an IF stands in it without THEN behind it on its line."""
    waiting = False
    for word in _IF.finditer(code):
        if word[0] in "\r\n" and waiting:
            return True
        waiting = word[0].upper() == "IF"
    return waiting


def _moves(
    code: str,
    lines: Lines,
    at: dict[int, int],
    named: dict[str, list[int]],
    noted: list[Noted],
    targets: Sequence[ProgramTarget],
) -> tuple[tuple[Move | None, ...], list[int]]:
    """The moves in their order, and where each begins; those that are not understood are noted."""
    moves: list[Move | None] = []
    begins: list[int] = []
    starts = sorted(at)
    last: Span | None = None
    for statement in _STATEMENT.finditer(code):
        move = _MOVE.search(statement[0])
        if move is None or ":=" in statement[0][: move.start()]:
            continue
        begin = statement.start() + move.start()
        begins.append(begin)
        line, span = lines.of(begin), Span(begin, statement.end())
        conditional = _compact_if(statement[0][: move.start()])
        # Behind a conditional move it is not certain where the robot is (docs/decisions/0081).
        before, last = last, None if conditional else span
        inside = within(starts, begin, statement.end())
        word = _target_named(code, statement.start() + move.end(), statement.end())
        indices = [at[inside[0]]] if inside else _targets_of_name(word, named)
        kind = _UNDERSTOOD.fullmatch(move[1])
        if kind is None or len(indices) != 1:
            moves.append(None)
            text = statement[0][move.end() :]
            why = "its target is no literal"
            if re.search(r"\b(Offs|RelTool)\s*\(", text, re.I):
                why = "an offset or a changed target"
            elif kind is None:
                circle = move[1].lower().startswith("movec")
                why = "a circle" if circle else "an instruction that is not understood"
            called = [targets[i] for w in _words(text) for i in named.get(w, [])]
            noted.append(Noted(line, f"{move[1]}: {handled(why, called)}"))
            continue
        target = indices[0]
        called_at = Span(*word.span(1)) if word and not inside else targets[target].literal
        if word and word[2]:
            called_at = Span(word.start(1), code.index("}", word.end(2)) + 1)
        whole, fixed = movable(code, before, span, _HARMLESS)
        if kind[2] or move[1].lower().startswith("trigg"):
            fixed = _MORE
        if conditional or not statement[0].endswith(";"):
            fixed = NOT_ALONE
        moves.append(Move(target, line, kind[1].lower() == "l", whole, called_at, fixed))
    return tuple(moves), begins


def _target_named(code: str, begin: int, end: int) -> re.Match[str] | None:
    """The name of the target: the first argument that is not optional, without its own options."""
    while begin < end:
        argument = _ARGUMENT.match(code, begin, end)
        stop = argument.end() if argument else begin
        if not code[begin:stop].lstrip().startswith("\\"):
            return _CALLED.match(code, begin, stop)
        begin = stop + 1
    return None


def _targets_of_name(word: re.Match[str] | None, named: dict[str, list[int]]) -> list[int]:
    """The targets of a name; of an element of an array the one of its number."""
    indices = [] if word is None else named.get(word[1].lower(), [])
    if word is None or word[2] is None:
        return indices
    return indices[int(word[2]) - 1 : int(word[2])] if int(word[2]) else []


def _driving(stops: Stops) -> list[str]:
    # 9E9 means that the external axis is absent (the manual above, `robtarget`).
    rest = ",".join(["9E9"] * 6)
    lines = [f"MODULE {stops.name}", *(f"  ! {words}" for words in stops.words)]
    for i, row in enumerate(stops.texts(6), 1):
        axes = ",".join([*row, *["0"] * (6 - len(row))])
        lines.append(f"  CONST jointtarget pose{i}:=[[{axes}],[{rest}]];")
    lines.append("  PROC main()")
    for i, one in enumerate(stops.ids, 1):
        lines += [
            f"    ! pose {one}",
            f"    MoveAbsJ pose{i},v100,fine,tool0;",
            f"    WaitTime {WAIT:g};",
        ]
    return [*lines, "  ENDPROC", "ENDMODULE"]


DIALECT = ProgramDialect(
    "RAPID",
    "ABB: literals of `jointtarget` and `robtarget`",
    "cf1, cf4, cf6; cfx for axis 5",
    (".mod", ".modx", ".prg", ".sys"),
    read_rapid,
    Drive(_driving, 32),
    "!",
    re.compile(r"^[ \t]*MODULE\b[^\r\n]*(?:\r\n|\n|\r)", re.I | re.M),
)

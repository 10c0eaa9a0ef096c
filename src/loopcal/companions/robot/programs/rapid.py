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

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.companions.robot.programs.coordinates import (
    JointAxes,
    pose_of_quaternion,
    quaternion_of_pose,
)
from loopcal.companions.robot.programs.copying import NOT_ALONE, movable
from loopcal.companions.robot.programs.dialect import WAIT, Drive, ProgramDialect, Stops
from loopcal.companions.robot.programs.program import (
    NUMBER,
    Listing,
    Move,
    Program,
    ProgramTarget,
    Span,
    numbers_of,
    texts,
    within,
)
from loopcal.errors import InputError

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
    listing = Listing(text, name, axes, _DECIMALS, aside=_ASIDE)
    lines, code = listing.lines, listing.code
    literals = [*_JOINTS.finditer(code), *_POSE.finditer(code)]
    literals.sort(key=lambda m: m.start())
    at: dict[int, int] = {}  # start of a literal -> index of its target
    named: dict[str, list[int]] = {}
    circular = {n for m in re.finditer(r"\bMoveC\b([^;]*)", code, re.I) for n in _words(m[1])}
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
        target = _target(literal, label or f"line {lines.of(literal.start())}", listing)
        at[literal.start()] = listing.add(target)
        named.setdefault(label.lower(), []).append(at[literal.start()])
    starts = sorted(at)
    for m in _VARIABLE.finditer(code):
        listing.note(m.start(), f"{m[1]}: a variable without a literal")
    end = 0
    for one in declarations:
        if end < one.end():  # else no semicolon stands between the last declaration and this one
            # find gives -1 without a semicolon; the modulo makes it the end of the text.
            end = code.find(";", one.end()) % (len(code) + 1)
        if not within(starts, one.end(), end):
            circle = one[2].lower() in circular
            words = "a point of a circle" if circle else "no literal of six joints or of a pose"
            listing.note(one.start(), f"{one[2]}: {words}")
    inside = _moves(listing, at, named)
    # In reverse: of equal keys a dict keeps the last value, here the first change of a statement.
    changed = {
        code.rfind(";", 0, m.end()): m
        for m in reversed([*_CHANGED.finditer(code)])
        if not within(inside, code.rfind(";", 0, m.end()) + 1, m.end() + 1)
    }
    for m in changed.values():
        listing.note(m.end() - 1, f"{m[0].strip()[:40]}: an offset or a changed target")
    frames = [f for f in _FRAME.findall(code) if f.lower() != "wobj0"]
    return listing.program(
        "RAPID",
        write=lambda target, joints, pose: (
            _write_pose(target, pose) if target.cartesian else listing.write(target, joints, pose)
        ),
        fits=_fits,
        frame=f"the work object {frames[0]!r}" if frames else None,
    )


def _words(text: str) -> list[str]:
    return [w.lower() for w in re.findall(r"[A-Za-z]\w*", text)]


def _target(literal: re.Match[str], label: str, listing: Listing) -> ProgramTarget:
    line, whole = listing.lines.of(literal.start()), Span(*literal.span())
    first = numbers_of(literal[1], literal.start(1))
    if len(literal.groups()) == 2:
        return listing.joints(label, literal.start(), first[: len(listing.scale)], whole)
    place = f"{listing.name}, line {line}"
    numbers = (*first, *numbers_of(literal[2], literal.start(2)))
    config = [float(v) for v in literal[3].split(",")]
    if not all(map(math.isfinite, config)):
        raise InputError(
            f"the configuration of {label} has a number that is too large",
            code="invalid-number",
            place=place,
            remedy="correct the number",
        )
    return ProgramTarget(
        label,
        line,
        True,
        numbers,
        None,
        pose_of_quaternion([number.value for number in numbers], place),
        # A change dq of a unit quaternion turns by 2 |dq|.
        np.array([*(1e-3 * listing.steps(first)), *[2.0 * 10.0**-_FINE] * 3]),
        dict(zip(("cf1", "cf4", "cf6", "cfx"), map(int, config), strict=True)),
        whole,
    )


def _write_pose(target: ProgramTarget, pose: Array) -> list[str]:
    old = target.numbers
    values = quaternion_of_pose(pose, [n.value for n in old])
    return [*texts(values[:3], old[:3], _DECIMALS), *texts(values[3:], old[3:], _FINE)]


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


def _moves(listing: Listing, at: dict[int, int], named: dict[str, list[int]]) -> list[int]:
    """Read the moves; where each begins. at, named: targets by place of their literal, by name."""
    code, starts = listing.code, sorted(at)
    begins: list[int] = []
    last: Span | None = None
    for statement in _STATEMENT.finditer(code):
        move = _MOVE.search(statement[0])
        if move is None or ":=" in statement[0][: move.start()]:
            continue
        begin = statement.start() + move.start()
        begins.append(begin)
        span = Span(begin, statement.end())
        conditional = _compact_if(statement[0][: move.start()])
        # Behind a conditional move it is not certain where the robot is (docs/decisions/0081).
        before, last = last, None if conditional else span
        inside = within(starts, begin, statement.end())
        word = _target_named(code, statement.start() + move.end(), statement.end())
        indices = [at[inside[0]]] if inside else _targets_of_name(word, named)
        kind = _UNDERSTOOD.fullmatch(move[1])
        if kind is None or len(indices) != 1:
            text = statement[0][move.end() :]
            why = "its target is no literal"
            if re.search(r"\b(Offs|RelTool)\s*\(", text, re.I):
                why = "an offset or a changed target"
            elif kind is None:
                circle = move[1].lower().startswith("movec")
                why = "a circle" if circle else "an instruction that is not understood"
            listing.leave(begin, move[1], why, [i for w in _words(text) for i in named.get(w, [])])
            continue
        target = indices[0]
        called_at = Span(*word.span(1)) if word and not inside else listing.targets[target].literal
        if word and word[2]:
            called_at = Span(word.start(1), code.index("}", word.end(2)) + 1)
        whole, fixed = movable(code, before, span, _HARMLESS)
        if kind[2] or move[1].lower().startswith("trigg"):
            fixed = _MORE
        if conditional or not statement[0].endswith(";"):
            fixed = NOT_ALONE
        line, straight = listing.lines.of(begin), kind[1].lower() == "l"
        listing.moves.append(Move(target, line, straight, whole, called_at, fixed))
    return begins


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

"""Fanuc LS listings: positions of group 1 in joints, or in X, Y, Z, W, P, R.

J1 ... are degrees; X, Y, Z mm; W, P, R degrees about the fixed x, y and z (Rz(R) Ry(P) Rx(W)).
CONFIG states flip, elbow and arm as letters, whose meaning depends on the model of the robot and is
not used, and the turns of axes 1, 4 and 6: 0 for -180 to 180 degrees.
"""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from loopcal.files.programs.copying import NOT_ALONE, NOT_NEXT, literal
from loopcal.files.programs.joint_axes import JointAxes
from loopcal.files.programs.program import (
    NUMBER,
    Lines,
    Move,
    Noted,
    Number,
    Place,
    Program,
    ProgramTarget,
    Rows,
    Span,
    line_end,
    refuse_redundant,
    replaced,
)
from loopcal.files.programs.turned import Turned

Array = NDArray[np.float64]
_POSITION = re.compile(r"^[ \t]*P\[\s*(\d+)\s*(?::[^\]\r\n]*)?\]\s*\{([^{}]*)\}", re.MULTILINE)
_BEGUN = re.compile(r"^[ \t]*P\[\s*(\d+)\s*(?::[^\]\r\n]*)?\]\s*\{", re.MULTILINE)
_FIELD = re.compile(rf"\b([XYZWPR]|J[1-9])\s*=\s*({NUMBER.pattern})\s*(mm|deg)\b")
_CONFIG = re.compile(r"CONFIG\s*:\s*'[^',]*,\s*(-?\d+)\s*,\s*(-?\d+)\s*,\s*(-?\d+)\s*'")
_FRAME = re.compile(r"\bUF\s*:\s*(\d+|F)")
_MOVE = re.compile(r"^[ \t]*\d+:[ \t]*([JLCAS])[ \t]+([^\r\n;]*)", re.MULTILINE)
_ENDED = re.compile(r"[ \t]*;[ \t]*(?=[\r\n]|\Z)")
_LINE_NUMBER = re.compile(r"^[ \t]*(\d+)(?=:)", re.MULTILINE)
_LINE_COUNT = re.compile(r"^LINE_COUNT\s*=\s*(\d+)", re.MULTILINE)
_HARMLESS = re.compile(
    r"[ \t]*;[ \t]*[\r\n]++(?:[ \t]*+\d*:[ \t]*+(?:(?:!|//|WAIT\b|[DR]O\[)[^;\r\n]*+)?"
    r";?[ \t]*+[\r\n]++)*+"
)
_POSE = ("X", "Y", "Z", "R", "P", "W")
_DECIMALS = 3
_EDGE = 1e-6


def read_fanuc(text: str, name: str, axes: JointAxes) -> Program:
    """The positions of a listing. Raises InputError for an arm of more than six joints."""
    refuse_redundant(axes, name)
    lines, own = Lines(text), Turned(axes, _POSE, "J", _DECIMALS)
    targets: list[ProgramTarget] = []
    noted: list[Noted] = []
    numbered: dict[str, int] = {}
    frames: set[str] = set()
    whole = {m.start(): m for m in _POSITION.finditer(text)}
    circular = {
        p for m in _MOVE.finditer(text) if m[1] in "CA" for p in re.findall(r"P\[\s*(\d+)", m[2])
    }
    for begun in _BEGUN.finditer(text):
        found, line = whole.get(begun.start()), lines.of(begun.start())
        target = None if found is None else _target(found, line, own)
        if target is None or begun[1] in circular:
            circle = begun[1] in circular
            words = "a point of a circle" if circle else "no whole position of group 1"
            noted.append(Noted(line, f"P[{begun[1]}]: {words}"))
            continue
        assert found is not None
        if target.cartesian:
            frames |= {f for f in _FRAME.findall(_group(found[2])) if f != "0"}
        numbered[begun[1]] = len(targets)
        targets.append(target)
    moves = _moves(text, lines, numbered, noted)
    return Program(
        "Fanuc LS",
        name,
        text,
        tuple(targets),
        tuple(sorted(noted, key=lambda n: n.line)),
        own.write,
        _fits,
        moves=moves,
        insert=_inserted,
        frame=f"the user frame {min(frames)}" if frames else None,
    )


def _group(body: str) -> str:
    """What is stated of the first group."""
    other = re.search(r"\bGP[2-9]\s*:", body)
    return body[: other.start()] if other else body


def _target(found: re.Match[str], line: int, own: Turned) -> ProgramTarget | None:
    body, start = _group(found[2]), found.start(2)
    fields: dict[str, Number] = {}
    for m in _FIELD.finditer(body):
        if m[1] in fields:
            return None
        fields[m[1]] = Number(start + m.start(2), start + m.end(2), m[2])
    config = _CONFIG.search(body)
    states = {} if config is None else {f"turn {k}": int(config[i]) for i, k in enumerate("146", 1)}
    whole = Span(*found.span())
    return own.target(f"P[{found[1]}]", line, fields, states, whole)


def _fits(target: ProgramTarget, joints: Array) -> bool:
    """Whether axes 1, 4 and 6 are in the stated turns."""
    degrees = np.degrees(joints)
    for axis in (1, 4, 6):
        turn = target.states.get(f"turn {axis}")
        if turn is not None and axis <= len(degrees):
            middle = 360.0 * turn
            if not abs(degrees[axis - 1] - middle) <= 180.0 + _EDGE:
                return False
    return True


def _moves(
    text: str, lines: Lines, numbered: dict[str, int], noted: list[Noted]
) -> tuple[Move | None, ...]:
    moves: list[Move | None] = []
    last: Span | None = None
    one = len(re.findall(r"^/(?:MN|POS)\b", text, re.MULTILINE)) == 2
    for found in _MOVE.finditer(text):
        line = lines.of(found.start(1))
        plain = re.match(r"P\[\s*(\d+)\s*(?::[^\]\r\n]*)?\]", found[2])
        shifted = re.search(r"\b(?:Tool_)?Offset\b|\bINC\b|\bVOFFSET\b", found[2], re.IGNORECASE)
        own = Span(*found.span())
        before, last = last, own
        if found[1] not in "JL" or shifted or plain is None or plain[1] not in numbered:
            moves.append(None)
            why = "an offset" if shifted else "a circle, or no position of this file"
            noted.append(Noted(line, f"{found[1]} {found[2][:30].strip()}: {why}"))
            continue
        at = found.start(2)
        called, target = Span(at, at + plain.end()), numbered[plain[1]]
        between = None if before is None else text[before.end : own.start]
        alone = _ENDED.match(text, own.end)
        fixed = NOT_ALONE if not alone else "" if one else "the file holds several programs"
        if not fixed and (between is None or not _HARMLESS.fullmatch(between)):
            fixed = NOT_NEXT
        whole = Span(own.start, alone.end()) if alone else own
        moves.append(Move(target, line, found[1] == "L", whole, called, fixed))
    return tuple(moves)


def _inserted(program: Program, ahead: Rows) -> list[Place]:
    """Lines ahead of moves with positions of their own, behind all others; lines are renumbered."""
    text, end = program.text, line_end(program.text)
    free = max(int(n) for n in re.findall(r"\bP\[\s*(\d+)", text)) + 1
    places, positions, shift = list[Place](), list[str](), 0
    wanted = {move.lines.start: i for i in ahead if (move := program.moves[i]) is not None}
    for found in _LINE_NUMBER.finditer(text, 0, _part(text, "/POS")):
        number, width = int(found[1]), found.end(1) - found.start()
        index = wanted.get(found.start())
        for count, row in enumerate(ahead[index] if index is not None else (), 1):
            move = program.moves[index] if index is not None else None
            assert move is not None
            block = literal(program, move, row, count)
            positions.append(f"P[{free}]{block[block.index('{') :]};")
            own = Place(Span(found.start(), found.end(1)), f"{number + shift:>{width}}")
            copy = replaced(text, move.lines, [own, Place(move.called, f"P[{free}]")])
            places.append(Place(Span(found.start(), found.start()), copy + end))
            free, shift = free + 1, shift + 1
        places.append(Place(Span(found.start(), found.end(1)), f"{number + shift:>{width}}"))
    for found in _LINE_COUNT.finditer(text):
        places.append(Place(Span(*found.span(1)), str(int(found[1]) + shift)))
    last = max(m.end() for m in _POSITION.finditer(text))
    closed = re.compile(r"[ \t]*;").match(text, last)
    last = closed.end() if closed else last
    return [*places, Place(Span(last, last), "".join(end + one for one in positions))]


def _part(text: str, name: str) -> int:
    """Where a part of the listing begins."""
    found = re.search(rf"^{name}\b", text, re.MULTILINE)
    return found.start() if found else len(text)

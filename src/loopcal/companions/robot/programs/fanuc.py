"""Fanuc LS listings: positions of group 1 in joints, or in X, Y, Z, W, P, R.

J1 ... are degrees; X, Y, Z mm; W, P, R degrees about the fixed x, y and z (Rz(R) Ry(P) Rx(W)).
CONFIG states flip, elbow and arm as letters, whose meaning depends on the model of the robot and is
not used, and the turns of axes 1, 4 and 6: 0 for -180 to 180 degrees.
"""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.companions.robot.programs.coordinates import JointAxes
from loopcal.companions.robot.programs.copying import NOT_ALONE, NOT_NEXT, literal
from loopcal.companions.robot.programs.dialect import WAIT, Drive, ProgramDialect, Stops
from loopcal.companions.robot.programs.program import (
    NUMBER,
    Listing,
    Move,
    Number,
    Place,
    Program,
    ProgramTarget,
    Rows,
    Span,
    line_end,
    replaced,
    whole,
)

_POSITION = re.compile(r"^[ \t]*P\[\s*(\d+)\s*(?::[^\]\r\n]*)?\]\s*\{([^{}]*)\}", re.MULTILINE)
_BEGUN = re.compile(r"^[ \t]*P\[\s*(\d+)\s*(?::[^\]\r\n]*)?\]\s*\{", re.MULTILINE)
_FIELD = re.compile(rf"\b([XYZWPR]|J[1-9])\s*=\s*({NUMBER.pattern})\s*(mm|deg)\b")
_CONFIG = re.compile(r"CONFIG\s*:\s*'[^',]*,\s*(-?\d+)\s*,\s*(-?\d+)\s*,\s*(-?\d+)\s*'")
_FRAME = re.compile(r"\bUF\s*:\s*(\d+|F)")
_MOVE = re.compile(r"^[ \t]*\d+:[ \t]*([JLCAS])[ \t]+([^\r\n;]*)", re.MULTILINE)
_CIRCLE = re.compile(r"^[ \t]*\d+:[ \t]*[CA][ \t]+([^;/]*)", re.MULTILINE)
_ENDED = re.compile(r"[ \t]*;[ \t]*(?=[\r\n]|\Z)")
_SHIFTED = re.compile(r"\b(?:Tool_)?Offset\b|\bINC\b|\bVOFFSET\b", re.IGNORECASE)
_LINE_NUMBER = re.compile(r"^[ \t]*(\d+)(?=:)", re.MULTILINE)
_POSITIONS = re.compile(r"^/POS\b", re.MULTILINE)
_LINE_COUNT = re.compile(r"^LINE_COUNT\s*=\s*(\d+)", re.MULTILINE)
# Possessive: a long run of waits cannot make the match back out (docs/decisions/0137).
_HARMLESS = re.compile(
    r"[ \t]*;[ \t]*[\r\n]++(?:[ \t]*+\d*:[ \t]*+(?:(?:!|//|WAIT\b|[DR]O\[)[^;\r\n]*+)?"
    r";?[ \t]*+[\r\n]++)*+"
)
# Turns in the order z, y, x of `Listing`.
_POSE = ("X", "Y", "Z", "R", "P", "W")
# [deg] At the edge of a turn the last digit of a joint must not decide.
_EDGE = 1e-6


def read_fanuc(text: str, name: str, axes: JointAxes) -> Program:
    """The positions of a listing. Raises InputError for an arm of more than six joints."""
    listing = Listing(text, name, axes, 3, joint="J", pose=_POSE)
    numbered: dict[str, int] = {}
    frames: set[str] = set()
    complete = {m.start(): m for m in _POSITION.finditer(text)}
    circular = {p for m in _CIRCLE.finditer(text) for p in re.findall(r"P\[\s*(\d+)", m[1])}
    for begun in _BEGUN.finditer(text):
        position = complete.get(begun.start())
        target = None if position is None else _target(position, listing)
        if position is None or target is None or begun[1] in circular:
            circle = begun[1] in circular
            words = "a point of a circle" if circle else "no whole position of group 1"
            listing.note(begun.start(), f"P[{begun[1]}]: {words}")
            continue
        if target.cartesian:
            frames |= {f for f in _FRAME.findall(_group(position[2])) if f != "0"}
        numbered[begun[1]] = listing.add(target)
    _moves(listing, numbered)
    frame = f"the user frame {min(frames)}" if frames else None
    return listing.program("Fanuc LS", once=True, fits=_fits, insert=_inserted, frame=frame)


def _group(body: str) -> str:
    """What is stated of the first group."""
    other = re.search(r"\bGP[2-9]\s*:", body)
    return body[: other.start()] if other else body


def _target(position: re.Match[str], listing: Listing) -> ProgramTarget | None:
    body, start = _group(position[2]), position.start(2)
    fields: dict[str, Number] = {}
    for m in _FIELD.finditer(body):
        if m[1] in fields:
            return None
        fields[m[1]] = Number(start + m.start(2), start + m.end(2), m[2])
    config = _CONFIG.search(body)
    turns = () if config is None else (Number(*config.span(i), config[i]) for i in (1, 2, 3))
    states = {f"turn {k}": whole(turn) for k, turn in zip("146", turns, strict=False)}
    literal = Span(*position.span())
    return listing.keyed(f"P[{position[1]}]", literal.start, fields, states, literal)


def _fits(target: ProgramTarget, joints: Array) -> NDArray[np.bool_]:
    """Whether axes 1, 4 and 6 are in the stated turns."""
    degrees = np.moveaxis(np.degrees(joints), -1, 0)
    fits = np.ones(joints.shape[:-1], dtype=bool)
    for axis in (1, 4, 6):
        turn = target.states.get(f"turn {axis}")
        if turn is not None and axis <= len(degrees):
            fits &= np.abs(degrees[axis - 1] - 360.0 * turn) <= 180.0 + _EDGE
    return fits


def _moves(listing: Listing, numbered: dict[str, int]) -> None:
    """Read the moves; numbered: targets by the number of their position."""
    text = listing.text
    last: Span | None = None
    # Numbers of lines and positions are those of one program; two in a file would be mixed up.
    one = len(re.findall(r"^/(?:MN|POS)\b", text, re.MULTILINE)) == 2
    for match in _MOVE.finditer(text):
        plain = re.match(r"P\[\s*(\d+)\s*(?::[^\]\r\n]*)?\]", match[2])
        shifted = _SHIFTED.search(match[2], plain.end() if plain else 0)
        span = Span(*match.span())
        before, last = last, span
        if match[1] not in "JL" or shifted or plain is None or plain[1] not in numbered:
            why = "an offset" if shifted else "a circle, or no position of this file"
            called = [numbered[plain[1]]] if plain and plain[1] in numbered else []
            listing.leave(match.start(1), f"{match[1]} {match[2][:30].strip()}", why, called)
            continue
        at, line = match.start(2), listing.lines.of(match.start(1))
        named_at, target = Span(at, at + plain.end()), numbered[plain[1]]
        between = None if before is None else text[before.end : span.start]
        alone = _ENDED.match(text, span.end)
        fixed = NOT_ALONE if not alone else "" if one else "the file holds several programs"
        if not fixed and (between is None or not _HARMLESS.fullmatch(between)):
            fixed = NOT_NEXT
        all_of_it = Span(span.start, alone.end()) if alone else span
        listing.moves.append(Move(target, line, match[1] == "L", all_of_it, named_at, fixed))


def _inserted(program: Program, ahead: Rows) -> list[Place]:
    """Lines ahead of moves with positions of their own, behind all others; lines are renumbered."""
    text, end = program.text, line_end(program.text)
    # Above every number that occurs, so that no position is overwritten.
    free = max(int(n) for n in re.findall(r"\bP\[\s*(\d+)", text)) + 1
    places, positions, shift = list[Place](), list[str](), 0
    wanted = {move.lines.start: i for i in ahead if (move := program.moves[i]) is not None}
    of_positions = _POSITIONS.search(text)
    last_line = of_positions.start() if of_positions else len(text)
    for match in _LINE_NUMBER.finditer(text, 0, last_line):
        number, width = int(match[1]), match.end(1) - match.start()
        index = wanted.get(match.start())
        for count, row in enumerate(ahead[index] if index is not None else (), 1):
            move = program.moves[index] if index is not None else None
            assert move is not None
            block = literal(program, move, row, count)
            positions.append(f"P[{free}]{block[block.index('{') :]};")
            number_place = Place(Span(match.start(), match.end(1)), f"{number + shift:>{width}}")
            copy = replaced(text, move.lines, [number_place, Place(move.called, f"P[{free}]")])
            places.append(Place(Span(match.start(), match.start()), copy + end))
            free, shift = free + 1, shift + 1
        places.append(Place(Span(match.start(), match.end(1)), f"{number + shift:>{width}}"))
    for match in _LINE_COUNT.finditer(text):
        places.append(Place(Span(*match.span(1)), str(int(match[1]) + shift)))
    last = max(m.end() for m in _POSITION.finditer(text))
    closed = re.compile(r"[ \t]*;").match(text, last)
    last = closed.end() if closed else last
    return [*places, Place(Span(last, last), "".join(end + one for one in positions))]


def _driving(stops: Stops) -> list[str]:
    moves = [f"!{words[:32]}" for words in stops.words]
    moves += ["UFRAME_NUM=0", "UTOOL_NUM=1"]
    for i, one in enumerate(stops.ids, 1):
        moves += [f"!pose {one[:26]}", f"J P[{i}] 10% FINE", f"WAIT {WAIT:.2f}(sec)"]
    head = [f"/PROG  {stops.name.upper()}", "/ATTR", "OWNER\t\t= MNEDITOR;"]
    head += ['COMMENT\t\t= "poses to measure";', f"LINE_COUNT\t= {len(moves)};"]
    head += ["DEFAULT_GROUP\t= 1,*,*,*,*;", "/MN"]
    lines = [f"{i:4d}:  {move} ;" for i, move in enumerate(moves, 1)]
    lines.append("/POS")
    for i, row in enumerate(stops.texts(3), 1):
        pairs = zip(row, stops.units, strict=True)
        axes = [f"\tJ{k}= {v:>9} {unit}" for k, (v, unit) in enumerate(pairs, 1)]
        lines += [f"P[{i}]{{", "   GP1:", "\tUF : 0, UT : 1,"]
        lines += [*(f"{axis}," for axis in axes[:-1]), axes[-1], "};"]
    return [*head, *lines, "/END"]


DIALECT = ProgramDialect(
    "Fanuc LS",
    "positions of group 1",
    "turns of axes 1, 4 and 6",
    (".ls",),
    read_fanuc,
    Drive(_driving, 36),
)

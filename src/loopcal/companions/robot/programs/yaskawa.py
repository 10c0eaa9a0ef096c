"""Yaskawa JBI jobs: positions in pulses of the robot's axes, C00000=... under ///PULSE.

How many pulses a degree has depends on the robot, so the user states it for each joint. Positions
in a Cartesian frame and position variables are left alone.
"""

from __future__ import annotations

import re

from loopcal.companions.robot.programs.coordinates import JointAxes
from loopcal.companions.robot.programs.dialect import WAIT, Drive, ProgramDialect, Stops
from loopcal.companions.robot.programs.program import (
    Listing,
    Move,
    Program,
    ProgramTarget,
    numbers_of,
)

_LINE = re.compile(r"[^\r\n]+")
_POSITION = re.compile(r"[ \t]*((?:B|E)?[CP]\d+)[ \t]*=([^\r\n]*)")
_MOVE = re.compile(r"[ \t]*(\+?[ES]?I?MOV[JLCS]?|REFP)\b([^\r\n]*)")
# docs/decisions/0081: positions are numbered by their moves, so no line can be copied.
_FIXED = "a job numbers its positions; insert them on the pendant, and correct again"


def read_yaskawa(text: str, name: str, axes: JointAxes) -> Program:
    """The positions of a job. Raises InputError without the pulses of every joint."""
    listing = Listing(text, name, axes, 0, scale=axes.scale / axes.pulses_each(name))
    named: dict[str, int] = {}
    pulse = False
    circular = set(re.findall(r"MOVC\s+(C\d+)", text))
    for row in _LINE.finditer(text):
        at = row.start()
        if row[0].startswith("///"):
            if re.match(r"///(PULSE|RECTAN|POSTYPE)\b", row[0]):
                pulse = row[0].startswith("///PULSE") or "POSTYPE PULSE" in row[0]
            continue
        position = _POSITION.fullmatch(row[0])
        if position is not None:
            target = None
            if pulse and re.fullmatch(r"C\d+", position[1]) and position[1] not in circular:
                target = _target(position, at, listing)
            if target is None:
                listing.note(at, f"{position[1]}: no whole pulses of the robot's axes")
            else:
                named[position[1]] = listing.add(target)
            continue
        move = _MOVE.match(row[0])
        if move is not None:
            word = re.match(r"\s+(C\d+)\b", move[2])
            if word and word[1] in named and move[1] in ("MOVJ", "MOVL", "SMOVL", "MOVS"):
                line, straight = listing.lines.of(at), move[1].endswith("MOVL")
                listing.moves.append(Move(named[word[1]], line, straight, fixed=_FIXED))
                continue
            called = [named[c] for c in re.findall(r"\bC\d+", move[2]) if c in named]
            listing.leave(at, row[0].strip()[:40], "a circle, shift or variable", called)
    return listing.program("Yaskawa JBI")


def _target(position: re.Match[str], start: int, listing: Listing) -> ProgramTarget | None:
    """The target of a line; None where it has not the whole numbers of an arm."""
    pieces, count = position[2].split(","), len(listing.scale)
    if len(pieces) < count or not all(re.fullmatch(r"\s*[+-]?\d+\s*", p) for p in pieces):
        return None
    numbers = numbers_of(position[2], start + position.start(2))[:count]
    return listing.joints(position[1], start, numbers)


def _driving(stops: Stops) -> list[str]:
    lines = ["/JOB", f"//NAME {stops.name.upper()}", "//POS", f"///NPOS {len(stops.ids)},0,0,0,0,0"]
    lines += ["///TOOL 0", "///POSTYPE PULSE", "///PULSE"]
    lines += [f"C{i:05d}={','.join(row)}" for i, row in enumerate(stops.texts(0))]
    lines += ["//INST", "///DATE 2000/01/01 00:00", "///ATTR SC,RW", "///GROUP1 RB1", "NOP"]
    lines += [f"'{words[:32]}" for words in stops.words]
    # VJ is in percent of the largest speed.
    for i, one in enumerate(stops.ids):
        lines += [f"'pose {one[:26]}", f"MOVJ C{i:05d} VJ=10.00", f"TIMER T={WAIT:.2f}"]
    return [*lines, "END"]


DIALECT = ProgramDialect(
    "Yaskawa JBI",
    "pulses (`///PULSE`), with `--pulses-per-degree`",
    "",
    (".jbi",),
    read_yaskawa,
    Drive(_driving, 32, pulses=True),
    "'",
    re.compile(r"^NOP[ \t]*(?:\r\n|\n|\r)", re.M),
)

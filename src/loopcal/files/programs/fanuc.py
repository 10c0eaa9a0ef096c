"""Fanuc LS listings: positions of group 1 in joints, or in X, Y, Z, W, P, R.

J1 ... are degrees; X, Y, Z mm; W, P, R degrees about the fixed x, y and z (Rz(R) Ry(P) Rx(W)).
CONFIG states flip, elbow and arm as letters, whose meaning depends on the model of the robot and is
not used, and the turns of axes 1, 4 and 6: 0 for -180 to 180 degrees.
"""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from loopcal.files.programs.joint_axes import JointAxes
from loopcal.files.programs.program import (
    NUMBER,
    Lines,
    Move,
    Noted,
    Number,
    Program,
    ProgramTarget,
    refuse_redundant,
)
from loopcal.files.programs.turned import Turned

Array = NDArray[np.float64]
_POSITION = re.compile(r"^[ \t]*P\[\s*(\d+)\s*(?::[^\]\r\n]*)?\]\s*\{([^{}]*)\}", re.MULTILINE)
_BEGUN = re.compile(r"^[ \t]*P\[\s*(\d+)\s*(?::[^\]\r\n]*)?\]\s*\{", re.MULTILINE)
_FIELD = re.compile(rf"\b([XYZWPR]|J[1-9])\s*=\s*({NUMBER.pattern})\s*(mm|deg)\b")
_CONFIG = re.compile(r"CONFIG\s*:\s*'[^',]*,\s*(-?\d+)\s*,\s*(-?\d+)\s*,\s*(-?\d+)\s*'")
_FRAME = re.compile(r"\bUF\s*:\s*(\d+|F)")
_MOVE = re.compile(r"^[ \t]*\d+:[ \t]*([JLCAS])[ \t]+([^\r\n;]*)", re.MULTILINE)
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
    return own.target(f"P[{found[1]}]", line, fields, states)


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
    for found in _MOVE.finditer(text):
        line = lines.of(found.start(1))
        plain = re.match(r"P\[\s*(\d+)", found[2])
        shifted = re.search(r"\b(?:Tool_)?Offset\b|\bINC\b|\bVOFFSET\b", found[2], re.IGNORECASE)
        known = plain is not None and plain[1] in numbered
        if found[1] not in "JL" or shifted or not known:
            moves.append(None)
            why = "an offset" if shifted else "a circle, or no position of this file"
            noted.append(Noted(line, f"{found[1]} {found[2][:30].strip()}: {why}"))
            continue
        assert plain is not None
        moves.append(Move(numbered[plain[1]], line, found[1] == "L"))
    return tuple(moves)

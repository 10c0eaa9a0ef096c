"""Yaskawa JBI jobs: positions in pulses of the robot's axes, C00000=... under ///PULSE.

How many pulses a degree has depends on the robot, so the user states it for each joint. Positions
in a Cartesian frame and position variables are left alone.
"""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.files.programs.joint_axes import JointAxes
from loopcal.files.programs.program import (
    Lines,
    Move,
    Noted,
    Program,
    ProgramTarget,
    numbers_of,
    refuse_redundant,
)

Array = NDArray[np.float64]
_LINE = re.compile(r"[^\r\n]+")
_POSITION = re.compile(r"[ \t]*((?:B|E)?[CP]\d+)[ \t]*=[ \t]*([^\r\n]*?)[ \t]*")
_MOVE = re.compile(r"[ \t]*(MOV[JLCS]|IMOV)\b([^\r\n]*)")
_FIXED = "a job numbers its positions; insert them on the pendant, and correct again"


def read_yaskawa(text: str, name: str, axes: JointAxes) -> Program:
    """The positions of a job. Raises InputError without the pulses of every joint."""
    refuse_redundant(axes, name)
    scale = axes.scale / pulses_of(axes, name)
    lines = Lines(text)
    targets: list[ProgramTarget] = []
    noted: list[Noted] = []
    named: dict[str, int] = {}
    moves: list[Move | None] = []
    pulse = False
    circular = set(re.findall(r"MOVC\s+(C\d+)", text))
    for found in _LINE.finditer(text):
        line = lines.of(found.start())
        if found[0].startswith("///"):
            if re.match(r"///(PULSE|RECTAN|POSTYPE)\b", found[0]):
                pulse = found[0].startswith("///PULSE") or "POSTYPE PULSE" in found[0]
            continue
        position = _POSITION.fullmatch(found[0])
        if position is not None:
            target = None
            if pulse and re.fullmatch(r"C\d+", position[1]) and position[1] not in circular:
                target = _target(position, found.start(), line, scale)
            if target is None:
                noted.append(Noted(line, f"{position[1]}: no whole pulses of the robot's axes"))
                continue
            named[position[1]] = len(targets)
            targets.append(target)
            continue
        move = _MOVE.match(found[0])
        if move is not None:
            word = re.match(r"\s+(C\d+)\b", move[2])
            if word and word[1] in named and move[1] in ("MOVJ", "MOVL"):
                moves.append(Move(named[word[1]], line, move[1] == "MOVL", fixed=_FIXED))
                continue
            moves.append(None)
            noted.append(Noted(line, f"{found[0].strip()[:40]}: a circle, shift or variable"))
    return Program(
        "Yaskawa JBI",
        name,
        text,
        tuple(targets),
        tuple(noted),
        lambda target, joints, pose: [str(round(v)) for v in (joints / scale).tolist()],
        moves=tuple(moves),
    )


def pulses_of(axes: JointAxes, name: str) -> Array:
    """(n,) pulses per degree or millimetre. Raises InputError where not every joint has them."""
    n, stated = len(axes.joints), np.array(axes.pulses, dtype=float)
    if len(stated) != n or not np.isfinite(stated).all() or (stated == 0.0).any():
        raise InputError(
            f"positions are in pulses, and {len(stated)} numbers of pulses are stated",
            code="missing-key",
            place=name,
            remedy=f"state the pulses per degree of all {n} joints: --pulses-per-degree N,N,...",
        )
    return stated


def _target(position: re.Match[str], start: int, line: int, scale: Array) -> ProgramTarget | None:
    """The target of a line; None where it has not the whole numbers of an arm."""
    pieces = position[2].split(",")
    if len(pieces) < len(scale) or not all(re.fullmatch(r"\s*[+-]?\d+\s*", p) for p in pieces):
        return None
    numbers = numbers_of(position[2], start + position.start(2))[: len(scale)]
    q = np.array([number.value for number in numbers]) * scale
    return ProgramTarget(position[1], line, False, numbers, q, None, np.abs(scale))

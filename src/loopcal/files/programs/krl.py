"""KUKA KRL: aggregates of `E6AXIS` and `E6POS` (or AXIS, POS), declared or written into a move.

Axes are degrees; X, Y, Z mm; A, B, C degrees about Z, the new Y and the newest X (Rz Ry Rx). Bit i
of T is set where axis i + 1 is negative; bit 1 of S where axis 3 is beyond the stretched arm.
Source: KUKA System Software, Operating and Programming Instructions for System Integrators,
"Status" and "Turn".
"""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from loopcal.files.programs.copying import movable
from loopcal.files.programs.joint_axes import JointAxes
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
    refuse_redundant,
    within,
)
from loopcal.files.programs.turned import Turned

Array = NDArray[np.float64]
_ASIDE = re.compile(r'"[^"\r\n]*"|;[^\r\n]*')
_BRACES = re.compile(r"\{([^{}\r\n]*)\}")
_PART = re.compile(rf"\s*(\w+)\s+({NUMBER.pattern}|[BHbh]?'[^']*')\s*")
_MOVE = re.compile(r"^[ \t]*(S?PTP|S?LIN|S?CIRC|S?LIN_REL|S?PTP_REL|SPL)\b([^\r\n]*)", re.I | re.M)
_CHANGED = re.compile(r"^[ \t]*(\w+)\.(?:[XYZABCST]|[AE][1-6])\s*=", re.IGNORECASE | re.MULTILINE)
_FRAME = re.compile(r"\$BASE\s*=\s*(?!\$NULLFRAME)([\w$\[\]]+)|\bBASE_NO\s+([1-9]\d*)", re.I)
_HARMLESS = re.compile(
    r"(?:[ \t]*+(?:(?:WAIT\b|\$OUT\b|\$VEL|\$ACC|\$BWDSTART|[PLF]DAT_ACT\b"
    r"|BAS\s*\(\s*#(?:CP|PTP)_PARAMS)"
    r"[^\r\n]*+)?[\r\n]++)*+[ \t]*+",
    re.IGNORECASE,
)
_POSE = ("X", "Y", "Z", "A", "B", "C")
_DECIMALS = 6
_EDGE = 1e-6


def read_krl(text: str, name: str, axes: JointAxes) -> Program:
    """The targets of a .src or .dat file. Raises InputError for an arm of more than six joints."""
    refuse_redundant(axes, name)
    lines, code = Lines(text), blanked(text, _ASIDE)
    turned = Turned(axes, _POSE, "A", _DECIMALS)
    circles = [m[2] for m in _MOVE.finditer(code) if "CIRC" in m[1].upper()]
    circular = {word.upper() for part in circles for word in re.findall(r"\w+", part)}
    targets: list[ProgramTarget] = []
    at: dict[int, int] = {}
    named: dict[str, int] = {}
    noted: list[Noted] = []
    for braces in _BRACES.finditer(code):
        start = max(code.rfind("\n", 0, braces.start()), code.rfind("\r", 0, braces.start())) + 1
        before, line = code[start : braces.start()], lines.of(braces.start())
        parts = _parts(braces)
        own = re.search(r"([\w$]+)\s*(?:\[[^\]]*\])?\s*=\s*$", before)
        label = own[1] if own else f"line {line}"
        if not _positional(parts, before):
            continue
        relative = re.search(r"_REL\b|\bCIRC\b|\bSCIRC\b", before, re.I)
        if relative or label.upper() in circular or label.startswith("$"):
            words = "a system variable" if label.startswith("$") else "relative, or of a circle"
            noted.append(Noted(line, f"{label}: {words}"))
            continue
        bits = {key: parts.get(key) for key in "ST"}
        states = {k: int(n.value) for k, n in bits.items() if n is not None and n.text.isdigit()}
        target = turned.target(label, line, parts, states, Span(*braces.span()))
        if target is None:
            noted.append(Noted(line, f"{label}: not all axes or coordinates are numbers"))
            continue
        at[braces.start()] = named[label.upper()] = len(targets)
        targets.append(target)
    noted += [
        Noted(lines.of(m.start(1)), f"{m[1]}: changed while the program runs")
        for m in _CHANGED.finditer(code)
    ]
    for declared in re.finditer(r"\bE6(?:POS|AXIS)\s+(\w+)[^\r\n{]*=([^\r\n]*)", code, re.I):
        if not _BRACES.search(declared[2]):
            noted.append(Noted(lines.of(declared.start()), f"{declared[1]}: no whole literal"))
    moves = _moves(code, lines, at, named, noted)
    frame = _FRAME.search(code)
    return Program(
        "KRL",
        name,
        text,
        tuple(targets),
        tuple(sorted(noted, key=lambda n: n.line)),
        turned.write,
        _fits,
        _chosen,
        moves,
        f"the base {frame[1] or frame[2]!r}" if frame else None,
    )


def _parts(braces: re.Match[str]) -> dict[str, Number | None]:
    """Key -> number; None for a value that is none."""
    found: dict[str, Number | None] = {}
    at = braces.start(1)
    for piece in braces[1].split(","):
        typed = re.match(r"\s*\w+\s*:", piece)
        skip = typed.end() if typed else 0
        part = _PART.fullmatch(piece, skip)
        if part:
            plain = NUMBER.fullmatch(part[2])
            number = Number(at + part.start(2), at + part.end(2), part[2]) if plain else None
            found[part[1].upper()] = number
        else:
            words = piece[skip:].split()
            if words:
                found[words[0].upper()] = None
        at += len(piece) + 1
    return found


def _positional(parts: dict[str, Number | None], before: str) -> bool:
    """Whether the aggregate is a target: joints, or a pose of a declared target or a move."""
    if "A1" in parts:
        return True
    if "X" not in parts and "A" not in parts:
        return False
    stated = "S" in parts or "T" in parts
    typed = re.search(r"\b(E6POS|POS)\b", before, re.I)
    moved = re.search(r"\b(S?PTP|S?LIN|S?CIRC|S?PTP_REL|S?LIN_REL)\s*$", before, re.I)
    return bool(stated or typed or moved)


def _fits(target: ProgramTarget, joints: Array) -> bool:
    """Whether the axes have the signs of T."""
    turn = target.states.get("T")
    if turn is None:
        return True
    degrees = np.degrees(joints)
    signs = [bool(turn >> i & 1) for i in range(len(degrees))]
    return all(
        d <= _EDGE if negative else d >= -_EDGE for d, negative in zip(degrees, signs, strict=True)
    )


def _chosen(target: ProgramTarget, several: list[Array]) -> list[Array]:
    """Of two positions of the elbow that of bit 1 of S: set where axis 3 is the larger one."""
    state = target.states.get("S")
    if state is None or len(several) != 2 or abs(several[0][2] - several[1][2]) < _EDGE:
        return several
    ordered = sorted(several, key=lambda q: float(q[2]))
    return [ordered[state >> 1 & 1]]


def _moves(
    code: str, lines: Lines, at: dict[int, int], named: dict[str, int], noted: list[Noted]
) -> tuple[Move | None, ...]:
    moves: list[Move | None] = []
    starts = sorted(at)
    last: Span | None = None
    for found in _MOVE.finditer(code):
        kind, line = found[1].upper().removeprefix("S"), lines.of(found.start(1))
        inside = within(starts, found.start(), found.end())
        word = re.match(r"\s*(\w+)\s*(?::|$|\s|,)", found[2])
        known = [named[word[1].upper()]] if word and word[1].upper() in named else []
        shifted = word is not None and ":" in found[2]
        own = Span(found.start(1), found.end())
        before, last = last, own
        if kind not in ("PTP", "LIN") or shifted or not (inside or known):
            moves.append(None)
            if not inside and (kind != "PTP" or word or found[2].strip()):
                why = "shifted by a frame" if shifted else "no target of this file, or a circle"
                noted.append(Noted(line, f"{found[1]}{found[2][:30].rstrip()}: {why}"))
            continue
        if inside:
            called = Span(inside[0], code.index("}", inside[0]) + 1)
        else:
            assert word is not None
            called = Span(found.start(2) + word.start(1), found.start(2) + word.end(1))
        target = at[inside[0]] if inside else known[0]
        lines_of, fixed = movable(code, before, own, _HARMLESS)
        moves.append(Move(target, line, kind == "LIN", lines_of, called, fixed))
    return tuple(moves)

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

from loopcal.arrays import Array
from loopcal.companions.robot.programs.coordinates import JointAxes
from loopcal.companions.robot.programs.copying import movable
from loopcal.companions.robot.programs.dialect import WAIT, Drive, ProgramDialect, Stops
from loopcal.companions.robot.programs.program import (
    NUMBER,
    Listing,
    Move,
    Number,
    Program,
    ProgramTarget,
    Span,
    whole,
    within,
)

_ASIDE = re.compile(r'"[^"\r\n]*"|;[^\r\n]*')
_BRACES = re.compile(r"\{([^{}\r\n]*)\}")
_PART = re.compile(rf"\s*(\w+)\s+({NUMBER.pattern}|[BHbh]?'[^']*')\s*")
_MOVE = re.compile(r"^[ \t]*(S?PTP|S?LIN|S?CIRC|S?LIN_REL|S?PTP_REL|SPL)\b([^\r\n]*)", re.I | re.M)
_CHANGED = re.compile(r"^[ \t]*(\w+)\.(?:[XYZABCST]|[AE][1-6])\s*=", re.IGNORECASE | re.MULTILINE)
_DECLARED = re.compile(r"\bE6(?:POS|AXIS)\s+(\w+)", re.IGNORECASE)
_ASSIGNED = re.compile(r"(?<![\w$])([\w$]++)\s*+(?:\[[^\[\]]*+\]\s*+)?=\s*+\Z")
_NO_TARGET = re.compile(r"_REL\b|\bS?CIRC\b", re.IGNORECASE)
_TYPED = re.compile(r"\b(?:E6)?POS\b", re.IGNORECASE)
_MOVED = re.compile(r"\b(?:S?PTP|S?LIN|S?CIRC|S?PTP_REL|S?LIN_REL)\s*+\Z", re.IGNORECASE)
_NAMED = 200
"""Characters before a literal in which its name stands."""
_FRAME = re.compile(r"\$BASE\s*=\s*(?!\$NULLFRAME)([\w$\[\]]+)|\bBASE_NO\s+([1-9]\d*)", re.I)
_HARMLESS = re.compile(
    r"(?:[ \t]*+(?:(?:WAIT\b|\$OUT\b|\$VEL|\$ACC|\$BWDSTART|[PLF]DAT_ACT\b"
    r"|BAS\s*\(\s*#(?:CP|PTP)_PARAMS)"
    r"[^\r\n]*+)?[\r\n]++)*+[ \t]*+",
    re.IGNORECASE,
)
# Turns in the order z, y, x of `Listing`.
_POSE = ("X", "Y", "Z", "A", "B", "C")
_EDGE = 1e-6


def read_krl(text: str, name: str, axes: JointAxes) -> Program:
    """The targets of a .src or .dat file. Raises InputError for an arm of more than six joints."""
    listing = Listing(text, name, axes, 6, aside=_ASIDE, joint="A", pose=_POSE)
    code = listing.code
    circles = [m[2] for m in _MOVE.finditer(code) if "CIRC" in m[1].upper()]
    circular = {word.upper() for part in circles for word in re.findall(r"\w+", part)}
    at: dict[int, int] = {}
    named: dict[str, int] = {}
    untargeted, typed = ([m.start() for m in w.finditer(code)] for w in (_NO_TARGET, _TYPED))
    for braces in _BRACES.finditer(code):
        at_brace = braces.start()
        line, start = listing.lines.of(at_brace), listing.lines.begin(at_brace)
        before = code[max(start, at_brace - _NAMED) : at_brace]
        parts = _parts(braces)
        assigned = _ASSIGNED.search(before)
        label = assigned[1] if assigned else f"line {line}"
        moved = within(typed, start, at_brace) or _MOVED.search(before)
        if not _positional(parts, bool(moved)):
            continue
        if (
            within(untargeted, start, at_brace)
            or label.upper() in circular
            or label.startswith("$")
        ):
            words = "a system variable" if label.startswith("$") else "relative, or of a circle"
            listing.note(at_brace, f"{label}: {words}")
            continue
        bits = {key: parts.get(key) for key in "ST"}
        states = {k: whole(n) for k, n in bits.items() if n is not None and n.text.isdigit()}
        target = listing.keyed(label, at_brace, parts, states, Span(*braces.span()))
        if target is None:
            listing.note(at_brace, f"{label}: not all axes or coordinates are numbers")
        else:
            at[at_brace] = named[label.upper()] = listing.add(target)
    for m in _CHANGED.finditer(code):
        listing.note(m.start(1), f"{m[1]}: changed while the program runs")
    for row in re.finditer(r"[^\r\n]+", code):
        stated, equals, value = row[0].partition("=")
        declared = _DECLARED.search(stated) if equals and "{" not in stated else None
        if declared and not _BRACES.search(value):
            at_name = row.start() + declared.start()
            listing.note(at_name, f"{declared[1]}: no whole literal")
    _moves(listing, at, named)
    frame = _FRAME.search(code)
    return listing.program(
        "KRL",
        once=True,
        fits=_fits,
        chosen=_chosen,
        frame=f"the base {frame[1] or frame[2]!r}" if frame else None,
    )


def _parts(braces: re.Match[str]) -> dict[str, Number | None]:
    """Key -> number; None for a value that is none."""
    numbers: dict[str, Number | None] = {}
    at = braces.start(1)
    for piece in braces[1].split(","):
        typed = re.match(r"\s*\w+\s*:", piece)
        skip = typed.end() if typed else 0
        part = _PART.fullmatch(piece, skip)
        if part:
            # S and T may be binary literals ('B0101'): no decimal number, so they are not used.
            plain = NUMBER.fullmatch(part[2])
            number = Number(at + part.start(2), at + part.end(2), part[2]) if plain else None
            numbers[part[1].upper()] = number
        else:
            words = piece[skip:].split()
            if words:
                numbers[words[0].upper()] = None
        at += len(piece) + 1
    return numbers


def _positional(parts: dict[str, Number | None], moved: bool) -> bool:
    """Whether the aggregate is a target: joints, or a pose of a declared target or a move.

    moved: whether the words before it are those of a target or a move.
    """
    if "A1" in parts:
        return True
    if "X" not in parts and "A" not in parts:
        return False
    return moved or "S" in parts or "T" in parts


def _fits(target: ProgramTarget, joints: Array) -> NDArray[np.bool_]:
    """Whether the axes have the signs of T."""
    turn = target.states.get("T")
    if turn is None:
        return np.ones(joints.shape[:-1], dtype=bool)
    # An axis at zero has either sign, so the edge counts as both.
    signs = np.array([-1.0 if turn >> i & 1 else 1.0 for i in range(joints.shape[-1])])
    return np.asarray((signs * np.degrees(joints) >= -_EDGE).all(axis=-1))


def _chosen(target: ProgramTarget, several: list[Array]) -> list[Array]:
    """Of two positions of the elbow that of bit 1 of S: set where axis 3 is the larger one."""
    state = target.states.get("S")
    if state is None or len(several) != 2 or abs(several[0][2] - several[1][2]) < _EDGE:
        return several
    ordered = sorted(several, key=lambda q: float(q[2]))
    return [ordered[state >> 1 & 1]]


def _moves(listing: Listing, at: dict[int, int], named: dict[str, int]) -> None:
    """Read the moves; at, named: targets by the place of their literal and by name."""
    code, starts = listing.code, sorted(at)
    last: Span | None = None
    for match in _MOVE.finditer(code):
        begin, kind = match.start(1), match[1].upper().removeprefix("S")
        inside = within(starts, match.start(), match.end())
        word = re.match(r"\s*(\w+)\s*(?::|$|\s|,)", match[2])
        by_name = [named[word[1].upper()]] if word and word[1].upper() in named else []
        shifted = re.match(r"\s*(?:\w+|\{[^{}]*\})\s*:", match[2]) is not None
        span = Span(begin, match.end())
        before, last = last, span
        if kind not in ("PTP", "LIN", "PL") or shifted or not (inside or by_name):
            if match[2].strip():
                why = "shifted by a frame" if shifted else "no target of this file, or a circle"
                words = f"{match[1]}{match[2][:30].rstrip()}"
                listing.leave(begin, words, why, (*(at[k] for k in inside), *by_name))
            else:  # a word alone belongs to the pendant's form of a move
                listing.moves.append(None)
            continue
        if inside:
            called = Span(inside[0], code.index("}", inside[0]) + 1)
        else:
            assert word is not None
            called = Span(match.start(2) + word.start(1), match.start(2) + word.end(1))
        target = at[inside[0]] if inside else by_name[0]
        lines_of, fixed = movable(code, before, span, _HARMLESS)
        line = listing.lines.of(begin)
        listing.moves.append(Move(target, line, kind == "LIN", lines_of, called, fixed))


def _driving(stops: Stops) -> list[str]:
    lines = [f"DEF {stops.name}( )", *(f"; {words}" for words in stops.words)]
    # $VEL_AXIS is in percent of the largest speed.
    lines += ["INT I", "BAS(#INITMOV,0)", "FOR I=1 TO 6", "$VEL_AXIS[I]=10", "ENDFOR"]
    for one, row in zip(stops.ids, stops.texts(6), strict=True):
        axes = ",".join(f"A{k} {v}" for k, v in enumerate(row, 1))
        lines += [f"; pose {one}", f"PTP {{{axes}}}", f"WAIT SEC {WAIT:g}"]
    return [*lines, "END"]


DIALECT = ProgramDialect(
    "KRL",
    "KUKA: `E6AXIS`, `E6POS`, `AXIS`, `POS`",
    "T; bit 1 of S",
    (".src", ".dat"),
    read_krl,
    Drive(_driving, 24),
    ";",
    re.compile(r"^[ \t]*DEF(?:DAT)?\b[^\r\n]*(?:\r\n|\n|\r)", re.I | re.M),
)

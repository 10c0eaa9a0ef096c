"""URScript: joints in radians, written into `movej`, `movel` and `movep` or assigned to their name.

A pose p[...] states no joints to begin from, and is left alone; so is what `get_inverse_kin` finds
while the program runs. Source: Universal Robots, The URScript Programming Language, "Motion".
"""

from __future__ import annotations

import re

import numpy as np

from loopcal.companions.robot.programs.coordinates import JointAxes
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
)

_ASIDE = re.compile(r'"[^"\r\n]*"|#[^\r\n]*')
_NUMBER = NUMBER.pattern
_JOINTS = rf"\[\s*({_NUMBER}(?:\s*,\s*{_NUMBER})*)\s*\]"
_MOVE = re.compile(
    rf"\b(move[jlpc]|servo[jc])[ \t]*\(\s*(?:(?:q|pose)\s*=\s*)?"
    rf"(?:{_JOINTS}|([A-Za-z_]\w*)(?=\s*[,)])|)"
)
_ASSIGNED = re.compile(
    rf"^[ \t]*(?:global[ \t]+|local[ \t]+)?([A-Za-z_]\w*)[ \t]*=[ \t]*(?:{_JOINTS}[ \t]*$)?",
    re.MULTILINE,
)
_HARMLESS = re.compile(
    r"(?:[ \t]*+(?:(?:sleep|sync|textmsg|set_\w*digital_out)\b[^\r\n]*+)?[\r\n]++)*+[ \t]*+"
)
_REST = re.compile(r"[^\r\n]*+")
_UNDERSTOOD = ("movej", "movel", "movep")


def read_urscript(text: str, name: str, axes: JointAxes) -> Program:
    """The joint targets of a script. Raises InputError for an arm of more than six joints."""
    listing = Listing(text, name, axes, 9, aside=_ASIDE, scale=np.ones(len(axes.joints)))
    code = listing.code
    calls = list(_MOVE.finditer(code))
    called = {m[3] for m in calls if m[3] and m[1] in _UNDERSTOOD}
    circular = {
        word
        for m in calls
        if m[1] not in _UNDERSTOOD
        for word in re.findall(r"[A-Za-z_]\w*", code[m.end(1) : code.find(")", m.end(1)) + 1])
    }
    assigned: dict[str, list[re.Match[str]]] = {}
    for m in _ASSIGNED.finditer(code):
        assigned.setdefault(m[1], []).append(m)
    named: dict[str, int] = {}
    for variable in sorted(called - circular):
        several = assigned.get(variable, [])
        # Of a name that is assigned twice it is not certain which value a move takes.
        target = _target(several[0], variable, listing) if len(several) == 1 else None
        if target is not None:
            named[variable] = listing.add(target)
    last: Span | None = None
    for m, behind in zip(calls, (*calls[1:], None), strict=False):
        line, kind, variable = listing.lines.of(m.start()), m[1], m[3]
        inline = _target(m, f"line {line}", listing) if kind in _UNDERSTOOD else None
        stop = len(code) if behind is None else behind.start()
        end = _REST.match(code, m.end(), stop)  # a second move on the line begins another
        statement = Span(m.start(), m.end() if end is None else end.end())
        whole, fixed = movable(code, last, statement, _HARMLESS)
        last = statement
        # A call over several lines: a copy of its first line alone would be no statement.
        if code.count("(", *statement) != code.count(")", *statement):
            fixed = NOT_ALONE
        if inline is not None:
            index, at = listing.add(inline), inline.literal
        elif kind in _UNDERSTOOD and variable in named:
            index, at = named[variable], Span(*m.span(3))
        else:
            why = "its target is no list of the arm's joints, assigned once"
            if kind not in _UNDERSTOOD:
                why = "a circle, or joints that are followed"
            listing.leave(m.start(), f"{kind}({variable or ''}", why)
            continue
        listing.moves.append(Move(index, line, kind != "movej", whole, at, fixed))
    return listing.program("URScript")


def _target(match: re.Match[str], label: str, listing: Listing) -> ProgramTarget | None:
    """The target of a list of joints; None where there is none, or not of every joint."""
    if match[2] is None:
        return None
    numbers = numbers_of(match[2], match.start(2))
    if len(numbers) != len(listing.scale):
        return None
    # with its brackets
    start = match.string.rindex("[", 0, match.start(2))
    literal = Span(start, match.string.index("]", match.end(2)) + 1)
    return listing.joints(label, match.start(2), numbers, literal)


def _driving(stops: Stops) -> list[str]:
    lines = [f"def {stops.name}():", *(f"  # {words}" for words in stops.words)]
    for one, row in zip(stops.ids, stops.texts(9), strict=True):
        # a [rad/s^2] and v [rad/s] of the leading axis.
        lines += [
            f"  # pose {one}",
            f"  movej([{','.join(row)}],a=0.5,v=0.3)",
            f"  sleep({WAIT:g})",
        ]
    return [*lines, "end"]


DIALECT = ProgramDialect(
    "URScript",
    "joints in `movej`, `movel` or `movep`, or assigned to their name once",
    "",
    (".script",),
    read_urscript,
    Drive(_driving, 64, si=True, ended="\n"),
    "#",
    re.compile(r"\A"),
)

"""Ids of poses: always text, so that 13 in a file, 13 in a project and "13" are one pose."""

from __future__ import annotations

import numbers
import re
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError, nearest

_WHOLE = re.compile(r"[+-]?\d++\.0+")
_FORMULA = re.compile(r"[=+@\t\r-]")
_MARK = "'"


def pose_id(value: object) -> str:
    """The id as text; whole numbers without a decimal point, as text too.

    >>> pose_id(13.0), pose_id("13.0"), pose_id(" wall-1 "), pose_id("1.10"), pose_id("'=A1")
    ('13', '13', 'wall-1', '1.10', '=A1')
    """
    if not isinstance(value, str) and isinstance(value, numbers.Real):
        number = float(value)
        return str(int(number)) if number.is_integer() else repr(number)
    text = str(value).strip()
    if text.isdecimal():
        return text
    if text.startswith(_MARK) and _FORMULA.match(text, 1):  # as `cell_text` writes it
        text = text[1:]
    return text.partition(".")[0] if _WHOLE.fullmatch(text) else text


def cell_text(text: str) -> str:
    """A text as a cell that no spreadsheet takes for a formula: those that begin like one get an
    apostrophe ahead, as in a spreadsheet, and `pose_id` takes it away. Numbers stay.

    >>> cell_text("=A1"), cell_text("-x"), cell_text("-1.5"), cell_text("wall-1")
    ("'=A1", "'-x", '-1.5', 'wall-1')
    """
    if not _FORMULA.match(text):
        return text
    try:
        float(text)
    except ValueError:
        return _MARK + text
    return text


def counted(number: int) -> tuple[str, ...]:
    """Ids "1" to "N" for poses that came without."""
    return tuple(map(str, range(1, number + 1)))


def asked_ids(asked: Iterable[object] | object) -> frozenset[str]:
    """The ids asked for, one or several."""
    if isinstance(asked, str | numbers.Real) or not isinstance(asked, Iterable):
        asked = (asked,)
    return frozenset(map(pose_id, asked))


def positions_of(
    asked: Iterable[object] | object, poses: Sequence[str], place: str | None
) -> NDArray[np.int64]:
    """Positions, ascending, of every pose whose id is among those asked for.

    Raises InputError naming the nearest id when an id belongs to no pose.
    """
    wanted = asked_ids(asked)
    if not wanted:
        return np.empty(0, dtype=np.int64)
    positions = np.array([i for i, name in enumerate(poses) if name in wanted], dtype=np.int64)
    unknown = wanted.difference(poses)
    if unknown:
        name = min(unknown)
        few = poses if len(poses) <= 20 else [*poses[:3], "...", *poses[-2:]]
        close = nearest(name, poses) if len(poses) <= 2000 else ""
        remedy = close if close.startswith("did") else "the ids are " + ", ".join(map(str, few))
        raise InputError(
            f"there is no pose {name!r}", code="unknown-name", place=place, remedy=remedy
        )
    return positions

"""Ids of poses: always text, so that 13 in a file, 13 in a project and "13" are one pose."""

from __future__ import annotations

import numbers
import re
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError, nearest

_WHOLE = re.compile(r"[+-]?\d+\.0+")


def pose_id(value: object) -> str:
    """The id as text; whole numbers without a decimal point, as text too.

    >>> pose_id(13.0), pose_id("13.0"), pose_id(" wall-1 "), pose_id("1.10")
    ('13', '13', 'wall-1', '1.10')
    """
    if isinstance(value, numbers.Real):
        number = float(value)
        return str(int(number)) if number.is_integer() else repr(number)
    text = str(value).strip()
    return text.partition(".")[0] if _WHOLE.fullmatch(text) else text


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
    found = np.array([i for i, name in enumerate(poses) if name in wanted], dtype=np.int64)
    unknown = wanted.difference(poses)
    if unknown:
        name = min(unknown)
        few = poses if len(poses) <= 20 else [*poses[:3], "...", *poses[-2:]]
        close = nearest(name, poses) if len(poses) <= 2000 else ""
        remedy = close if close.startswith("did") else "the ids are " + ", ".join(map(str, few))
        raise InputError(
            f"there is no pose {name!r}", code="unknown-name", place=place, remedy=remedy
        )
    return found

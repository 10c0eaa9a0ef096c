"""Rows of two tools or reflectors under one name, or each under the name of the other."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from loopcal.errors import InputError
from loopcal.estimation.mounted import exchanged_targets, two_targets
from loopcal.files.recognition.fields import names_of
from loopcal.files.recognition.meanings import Meaning
from loopcal.presentation.shown import significant, with_unit
from loopcal.workflow.beginning.searching import CLEARLY, Understood

# Chosen, not derived: a joint that slips once or twice moves the tool as well, but not in turn.
_IN_TURN = 4
"""The rows change from one target to the other more often than this."""


def swapped_targets(way: Understood) -> InputError | None:
    """The refusal of two targets that stand in each other's columns in some rows; None where none
    do."""
    for one, other in combinations(_points_of(way), 2):
        rows = np.flatnonzero(exchanged_targets(way.bodies, one.position, other.position)) + 1
        if len(rows):
            return InputError(
                f"{names_of(one.seen.position)} and {names_of(other.seen.position)}, of two "
                f"targets, are swapped in {len(rows)} of {len(one.position)} rows "
                f"({', '.join(map(str, rows))})",
                code="implausible-readings",
                remedy="swap them in these rows, or leave the rows out",
            )
    return None


def _points_of(way: Understood) -> list[Meaning]:
    """The targets that are seen as points from where the station stands."""
    return [m for m in way.seen if m.position.ndim == 2 and m.turns is None and not m.inverted]


def mixed_targets(way: Understood) -> InputError | None:
    """The refusal of points of which some are those of another target; None where none are."""
    for meaning in _points_of(way):
        two = two_targets(way.bodies, meaning.position)
        if two is None or CLEARLY * two.share > meaning.share:
            continue
        if np.count_nonzero(np.diff(two.second.astype(np.intp))) <= _IN_TURN:
            continue
        rows = np.flatnonzero(two.second) + 1
        return InputError(
            f"{names_of(meaning.seen.position)} are of two targets in turn, "
            f"{with_unit(two.apart, 'm', 3)} apart, such as two tools: {len(rows)} of "
            f"{len(two.second)} rows are of the second ({', '.join(map(str, rows))}). So the "
            f"nominal machine misses the readings by {significant(100.0 * two.share, 2)} % of "
            f"their spread, and by {significant(100.0 * meaning.share, 2)} % as of one target",
            code="implausible-readings",
            remedy="write the rows of each target to a separate file, and begin with one of them",
        )
    return None

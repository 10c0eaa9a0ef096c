"""Rows of two tools or reflectors under one name: each alone fits the nominal machine."""

from __future__ import annotations

import numpy as np

from loopcal.errors import InputError
from loopcal.estimation.mounted import two_targets
from loopcal.files.recognition.fields import names_of
from loopcal.presentation.shown import significant, with_unit
from loopcal.workflow.beginning.searching import CLEARLY, Understood

# Chosen, not derived: a joint that slips once or twice moves the tool as well, but not in turn.
_IN_TURN = 4
"""The rows change from one target to the other more often than this."""


def mixed_targets(way: Understood) -> InputError | None:
    """The refusal of points of which some are those of another target; None where none are."""
    for meaning in way.seen:
        if meaning.position.ndim < 2 or meaning.turns is not None or meaning.inverted:
            continue
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

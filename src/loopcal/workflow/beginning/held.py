"""Rows that repeat the last reading of an instrument, which a log asked too often."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError, listed
from loopcal.estimation.mounted import Bodies
from loopcal.files.recognition.fields import names_of
from loopcal.workflow.beginning.objections import ONE_POSE
from loopcal.workflow.beginning.searching import Understood

# Chosen, not derived: of more rows than this share the instrument holds still, not the log.
_MOST = 0.3


def _about_a_point(bodies: Bodies, rows: NDArray[np.intp]) -> bool:
    """Whether a point t of the body stays from the row before: o + R t is the same in both."""
    R, o = (values[rows] - values[rows - 1] for values in (bodies.rotations, bodies.origins))
    t, *_ = np.linalg.lstsq(R.reshape(-1, 3), -o.ravel(), rcond=None)
    return bool(np.linalg.norm(o + R @ t, axis=1).max() < ONE_POSE)


def held_readings(way: Understood, poses: Sequence[str]) -> InputError | None:
    """The refusal of rows in which points stay to the last digit while the machine moves; None
    where there are none, or where the machine turns about the point, as about the tip of a tool.
    Joints that stay are no fault: two targets may be seen in one pose."""
    for meaning in way.seen:
        points = meaning.position
        if points.ndim < 2 or len(points) < 2:
            continue
        stays = (np.diff(points, axis=0) == 0.0).all(axis=1)
        moves = np.linalg.norm(np.diff(way.bodies.origins, axis=0), axis=1) > ONE_POSE
        rows = np.flatnonzero(stays & moves) + 1
        if 0 < len(rows) <= _MOST * len(points) and not _about_a_point(way.bodies, rows):
            held = [poses[i] for i in rows.tolist()]
            error = InputError(
                f"{names_of(meaning.seen.position)} repeat the row before to the last digit in "
                f"{len(held)} of {len(points)} poses, although the joints moved the machine "
                f"({listed(held, 5)}): the instrument was not read again",
                code="implausible-readings",
                remedy="leave these poses out, or correct their rows",
            )
            return error.offering("--exclude", ",".join(held))
    return None

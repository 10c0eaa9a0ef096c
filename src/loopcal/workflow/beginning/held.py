"""Rows that repeat the last reading of a sensor, as where a log asks faster than it is answered."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from loopcal.errors import InputError, listed
from loopcal.files.recognition.fields import Field, names_of
from loopcal.workflow.beginning.objections import ONE_POSE
from loopcal.workflow.beginning.searching import Understood

# Chosen, not derived: two targets that are measured in turn in every pose make half of the rows.
_MOST = 0.3
"""More rows than this share that agree with the row before were measured so."""


def held_readings(way: Understood, poses: Sequence[str]) -> InputError | None:
    """The refusal of rows in which joints or points stay to the last digit while the others move;
    None where there are none."""
    joints = np.array([way.joints[name] for name in way.joints]).T
    for meaning in way.seen:
        points = meaning.position
        if points.ndim < 2 or len(points) < 2:
            continue
        sensors = (
            (meaning.seen.position, points, way.bodies.origins),
            (way.layout.joints, joints, points),
        )
        for fields, readings, others in sensors:
            stays = (np.diff(readings, axis=0) == 0.0).all(axis=1)
            moves = np.linalg.norm(np.diff(others, axis=0), axis=1) > ONE_POSE
            rows = np.flatnonzero(stays & moves) + 1
            if 0 < len(rows) <= _MOST * len(points):
                return _refusal(fields, [poses[i] for i in rows.tolist()], len(points))
    return None


def _refusal(fields: Sequence[Field], poses: list[str], count: int) -> InputError:
    error = InputError(
        f"{names_of(fields)} repeat the row before to the last digit in {len(poses)} of {count} "
        f"poses, although the others show that the machine moved ({listed(poses, 5)}): these "
        "sensors were not read again",
        code="implausible-readings",
        remedy="leave these poses out, or correct their rows",
    )
    return error.offering("--exclude", ",".join(poses))

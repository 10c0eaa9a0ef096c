"""What data need not say in every pose: readings that are implied, and constants of each pose.

Joints that stand still: what reads the same in every pose has one error, not one in each.

Taken as uncertain, such a joint would seem to move by its corrections, which then tell parameters
apart that no pose does; where nothing is known of these, the fit follows them without end.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.errors import InputError
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import ReadingUncertainty
from loopcal.mechanisms.effects.backlash import directions
from loopcal.mechanisms.instruments.orientation import Orientation
from loopcal.mechanisms.machine import ENDS
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parallel.free_body import BEGIN, COLUMNS


def with_implied(mechanism: Mechanism, data: Dataset) -> Dataset:
    """The data with the readings that are implied, where they have no column for them.

    Small turns are implied where an orientation was measured that they can be small beside.
    """
    absent = {
        q: np.full(len(data), v) for q, v in mechanism.implied.items() if q not in data.readings
    }
    for orientation in mechanism.orientations:
        lost = _lost(orientation, data)
        for turn in orientation.turns:
            if turn in absent:
                absent[turn][lost] = np.nan
    return data.with_readings(absent) if absent else data


def with_latest(mechanism: Mechanism, data: Dataset) -> Dataset:
    """Readings of the machine as it is now: after the last change, where no column dates them."""
    absent = {
        name: np.full(len(data), value)
        for name, value in mechanism.latest.items()
        if name not in data.readings
    }
    return data.with_readings(absent, units={n: mechanism.pose_constants[n] for n in absent})


def as_now(mechanism: Mechanism, constants: Array) -> Array:
    """Constants (c, N) [SI] of its tape, those that date a change as after the last one."""
    now = constants.copy()
    for i, name in enumerate(mechanism.tape.pose_constants):
        if name in mechanism.latest:
            now[i] = mechanism.latest[name]
    return now


def conditions_of(mechanism: Mechanism, constants: Array) -> dict[str, tuple[float, float]]:
    """Constants (c, N) [SI] of its tape that a machine may meet again -> their ranges.

    Not those that date a change, the numbers of an orientation, where the search for a free body
    begins, and what no loop depends on.
    """
    names = {*mechanism.tape.pose_constants}
    bodies = [end for end in ENDS if names.issuperset(name + end for name in COLUMNS)]
    body = {name + end for name in (*BEGIN, *COLUMNS) for end in bodies}
    turns = {column for orientation in mechanism.orientations for column in orientation.columns}
    used = frozenset().union(*mechanism.tape.depends_on())
    aside = {*mechanism.latest, *turns, *body, *directions(mechanism)}
    return {
        name: (float(values.min()), float(values.max()))
        for name, values in zip(mechanism.tape.pose_constants, constants, strict=True)
        if name in used - aside and values.size
    }


def constants_by_pose(mechanism: Mechanism, data: Dataset) -> Array:
    """The constants (c, N) [SI] of every pose; where an orientation was not measured, any one.

    Raises InputError for a constant that is missing, for numbers that are no orientation, and for
    directions of approach other than 1, 0 and -1.
    """
    filled: dict[str, Array] = {}
    for orientation in mechanism.orientations:
        filled |= _orientation(orientation, data)
    rows = []
    for name in mechanism.tape.pose_constants:
        values = filled.get(name, data.readings.get(name))
        if values is None or np.isnan(values).any():
            which = (
                "none"
                if values is None
                else f"pose {data.poses[int(np.argmax(np.isnan(values)))]!r} lacks it"
            )
            raise InputError(
                f"the known constant {name!r} is missing in some poses ({which})",
                code="missing-reading",
                remedy="name its column, or exclude the poses without it",
            )
        rows.append(values)
    for name in directions(mechanism):
        _refuse_other_directions(data, name)
    return np.array(rows).reshape(len(rows), len(data))


def _refuse_other_directions(data: Dataset, name: str) -> None:
    values = data.readings[name]
    wrong = np.flatnonzero(~np.isin(values, (-1.0, 0.0, 1.0)))
    if wrong.size:
        raise InputError(
            f"the direction {name!r} is {values[wrong[0]]:g} in pose {data.poses[wrong[0]]!r} and "
            f"no direction in {wrong.size} of {len(data)} poses",
            code="invalid-value",
            place=data.place(int(wrong[0]), name),
            remedy="give 1 for an approach with a growing reading, -1 for a falling one, 0 "
            "where backlash was removed",
        )


def _orientation(orientation: Orientation, data: Dataset) -> dict[str, Array]:
    columns = {n: data.readings[n] for n in orientation.columns if n in data.readings}
    if len(columns) < len(orientation.columns):
        return {}  # whoever needs it says so
    lost = _lost(orientation, data)
    anywhere = orientation.written(np.array([[1.0], [0.0], [0.0], [0.0]]))
    filled = {name: np.where(lost, anywhere[name], values) for name, values in columns.items()}
    for i in orientation.senseless(filled)[:1]:
        raise InputError(
            f"the quaternion {', '.join(orientation.columns)} is 0, which is no orientation",
            code="lost-reflector",
            place=data.place(int(i), orientation.columns[0]),
            remedy="leave its numbers blank (NaN) where no orientation was measured",
        )
    return filled


def _lost(orientation: Orientation, data: Dataset) -> NDArray[np.bool_]:
    """Poses in which some of the numbers are missing."""
    lost = np.zeros(len(data), dtype=bool)
    for name in orientation.columns:
        if name in data.readings:
            lost |= np.isnan(data.readings[name])
    return lost


# docs/decisions/0052.
FEWEST = 3
"""Poses from which equal readings are no chance."""


def standing(mechanism: Mechanism, readings: NDArray[np.float64]) -> list[int]:
    """Positions of the joints that read the same in every pose; readings (k, N).

    Not those of instruments, whose readings follow from the machine, nor what is no reading (an
    error of the machine model, taken as 0).
    """
    if readings.shape[1] < FEWEST:
        return []
    alike = np.flatnonzero((readings == readings[:, :1]).all(axis=1)).tolist()
    if not alike:
        return []
    seen = {q for family in mechanism.families for q in family.readings}
    seen |= {*mechanism.implied, *mechanism.disturbances}
    return [i for i in alike if mechanism.tape.quantities[i] not in seen]


def standing_exact(
    mechanism: Mechanism, readings: NDArray[np.float64], uncertainty: ReadingUncertainty
) -> ReadingUncertainty:
    """The uncertainty with the readings (k, N) of joints that never move taken as exact.

    What they are off by is the same in all poses, and parameters take it up. Not where a loop would
    be left without any reading that is uncertain.
    """
    alike = standing(mechanism, readings)
    if not alike:
        return uncertainty
    names, loops = mechanism.tape.quantities, mechanism.tape.depends_on("quantity")
    inside = {i for block in uncertainty.blocks for i in block.indices}
    sd = uncertainty.sd
    uncertain = [bool((row > 0.0).all()) for row in sd]
    still = [i for i in alike if i not in inside and uncertain[i] and np.isfinite(sd[i]).all()]
    moving = {name for i, name in enumerate(names) if uncertain[i] and i not in still}
    if not still or not all(moving.intersection(inputs) for inputs in loops):
        return uncertainty
    exact = sd.copy()
    exact[still] = 0.0
    return replace(uncertainty, sd=exact)

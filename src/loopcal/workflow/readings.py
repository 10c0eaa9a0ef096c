"""Readings as a user states them: a value, a table, a file, or the folder of a result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError, listed
from loopcal.estimation.faults.repairs import set_apart
from loopcal.estimation.result import FitResult
from loopcal.files.cameras.folder import are_images
from loopcal.files.project.project_data import (
    read_new_readings,
    reads,
    result_columns,
    result_pose_column,
)
from loopcal.files.result.result_poses import poses_of_result
from loopcal.files.tables.readers import column_labels, read_dataset, read_once
from loopcal.measurements.checks import refuse_implausible
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.tables import column_names
from loopcal.mechanisms.frame import joint_rows
from loopcal.mechanisms.mechanism import PIXELS, Mechanism
from loopcal.mechanisms.parameters import matching
from loopcal.units import from_si, to_si, unit

Units = Mapping[str, str] | str | None
"""Of columns or globs; one for all that is an angle or all that is a length."""
Files = str | Path | Sequence[str | Path]
"""A file of readings, or several of one measurement."""
_NEAR = 0.05
"""So far [rad] beyond the calibrated poses an array of joints lies among them at least."""
_FAR = 1.0
"""So far [rad] at most; between them the travel of the joint decides."""
_SEVERAL = 3
"""Joints that move by less than a turn in radians from which on degrees are in doubt."""
_OF_A_LAYOUT = ("missing-column", "invalid-syntax", "conflicting-keys")
"""Codes of errors in reading a file whose layout is not that of the first day."""
POSE = "pose"
"""The column of pose ids of a table or file that no project describes."""


def readings(data: Any, mechanism: Mechanism, units: Units = None) -> Dataset:
    """A dataset of a table or a file, in the units stated or else in SI.

    A column "pose" holds ids. Columns of a file that the mechanism does not know are left out.
    Raises InputError where SI is implausible, with the likely unit.
    """
    if isinstance(data, Dataset):
        if units:
            raise InputError(
                "units are given for a Dataset, whose values are SI already",
                code="conflicting-keys",
                remedy="remove units, or give them to Dataset.from_arrays",
            )
        return data
    units_of = mechanism.units
    from_file = isinstance(data, str | Path)
    source = read_once(data) if from_file else data
    names = column_labels(source) if from_file else column_names(data)
    if isinstance(units, str):
        alike = unit(units).si
        units = {name: units for name in names if units_of.get(name) == alike}
    stated_units = {
        name: of for key, of in (units or {}).items() for name in matching(key, names, "column")
    }
    # A machine may have a quantity of this name.
    pose = POSE if POSE in names and POSE not in units_of else None
    if from_file:
        named = {q: q for q in units_of if q in names} or None
        dataset = read_dataset(source, named, pose=pose, units=stated_units)
    else:
        dataset = Dataset.from_arrays(data, units=stated_units, poses=pose)
    # A stated unit is believed; SI is only assumed.
    refuse_implausible(dataset, {q: u for q, u in units_of.items() if q not in stated_units})
    return dataset


def first_of(files: Files) -> str | Path:
    """The file by which messages and pages call several."""
    return files if isinstance(files, str | Path) else files[0]


def new_readings(
    data: Any, inputs: Mapping[str, Any], mechanism: Mechanism, *, whole: bool = False
) -> Dataset:
    """Files or tables of another day: of cameras what `init` takes, else a project's columns.

    whole: with the outputs. Raises InputError for what is none of both.
    """
    entries = [data] if isinstance(data, str | Path) else list(data)
    cameras = any(family.form == PIXELS for family in mechanism.families)
    seen = cameras and are_images(entries)
    observe, flange = (inputs.get("data", {}).get(key) or () for key in ("observe", "flange"))
    if seen and not observe:
        from loopcal.workflow.beginning.later_images import later_images

        return later_images(entries, mechanism, flange)
    # A table of the robot may have the very columns of the project's own, which was read before.
    anew = flange and _are_files(entries) and Path(entries[0]).name != inputs["data"]["file"]
    if cameras and not whole and (anew or not reads(entries[0], inputs, mechanism, whole=whole)):
        from loopcal.workflow.beginning.later_images import later_poses

        if (poses := later_poses(entries, mechanism, flange)) is not None:
            return poses
    if mechanism.families and {f.form for f in mechanism.families} == {"pose"}:
        from loopcal.workflow.beginning.from_samples import later_samples, samples_of

        if not mechanism.joints and (samples := samples_of(entries)):
            return later_samples(samples, mechanism)
    alone = len(entries) == 1 and not seen
    if observe and not (alone and reads(entries[0], inputs, mechanism, whole=whole)):
        from loopcal.workflow.beginning.from_tree import later_observed

        return later_observed(entries, mechanism, observe)
    try:
        return read_new_readings(data, inputs, mechanism, whole=whole)
    except InputError as error:
        if error.code not in _OF_A_LAYOUT or not whole or not _are_files(entries):
            raise
        from loopcal.workflow.beginning.later_layout import later_layout

        made, source = None, inputs.get("data", {}).get("source") or {}
        try:
            made = later_layout(entries, mechanism, source.get("columns"))
        except InputError as other:  # else what is missing says more
            if other.code == "mismatched-poses":
                raise other from None
        if made is None:
            raise
        return made


def _are_files(entries: Sequence[Any]) -> bool:
    return all(isinstance(one, str | Path) for one in entries)


def later_readings(result: Any, data: Any, units: Units, *, whole: bool) -> Any:
    """Further readings for a result; a path is read in the columns of its project, several in the
    layout of its first files.

    whole: with the outputs. A folder of a result stands for the readings it was calibrated with.
    """
    if isinstance(data, FitResult | Dataset):
        return data
    # Of a limb the project is that of the whole robot.
    mechanism: Mechanism = getattr(result, "whole", result).mechanism
    folder = getattr(data, "path", None)
    if isinstance(folder, Path):  # of a result
        data = folder
    if isinstance(data, list | tuple) and data and _are_files(data):
        if len(data) > 1:
            return new_readings(data, getattr(result, "inputs", {}), mechanism, whole=whole)
        data = first_of(data)
    if not isinstance(data, str | Path):
        return _of_table(result, data, units, whole=whole)
    poses = poses_of_result(data, mechanism)
    if poses is not None:
        return poses
    if units is not None:
        return readings(data, mechanism, units)
    made = new_readings(data, getattr(result, "inputs", {}), mechanism, whole=whole)
    if not whole:  # else what was measured shows the unit
        refuse_other_angles(made, result)
    return made


def refuse_other_angles(made: Dataset, result: Any) -> None:
    """Raise InputError for a file whose headers state no unit, and whose degrees are radians, or
    whose radians are degrees."""
    from loopcal.files.recognition.headers import heading

    source = made.source
    for taken in ("deg", "rad"):
        bare = {
            q: from_si(made[q], taken)
            for q in result.mechanism.joints
            if source.stated.get(q) == taken
            and heading(source.columns.get(q, "[deg]")).unit is None
            and np.isfinite(made[q]).any()
        }
        largest = [float(np.nanmax(np.abs(v))) for v in bare.values()]
        if sum(v > 0.0 for v in largest) < _SEVERAL:
            continue
        units, file = dict.fromkeys(bare, taken), source.file or "a table"
        if taken == "rad" or max(largest) <= 2.0 * np.pi:
            _refuse_doubtful(bare, units, result, file)
        # A few poses in degrees may be near the zeros of all joints, small as radians are.
        sizes = np.linalg.norm([*bare.values()], axis=0)
        for _, large in set_apart(sizes) if taken == "rad" else ():
            some = listed([made.poses[i] for i in np.flatnonzero(large)], 5)
            rows = {q: v[large] for q, v in bare.items()}
            _refuse_doubtful(rows, units, result, f"poses {some} of {file}")


def _refuse_doubtful(
    joints: Mapping[str, NDArray[np.float64]],
    in_source: Mapping[str, str],
    result: Any,
    what: str = "an array",
) -> None:
    """Raise InputError for angles without a unit that lie among the calibrated poses in the other
    one: radians beside a file in degrees, or degrees that the poses in radians do not reach.

    Angles [rad] that are small as degrees as well are taken as SI. Poses reach beyond the
    calibrated ones, and radians are small numbers as degrees: a joint lies among them also as far
    outside as it travelled.
    """
    poses, quantities = result.poses, result.mechanism.quantities
    angles = {
        q: v for q, v in joints.items() if quantities[q] == "rad" and np.nanmax(np.abs(v)) > 0
    }
    units = {in_source.get(q, "rad") for q in angles}
    if poses is None or not angles or len(units) != 1 or not units < {"rad", "deg"}:
        return

    def among(of: str) -> bool:
        ends = {q: (float(np.nanmin(poses[q])), float(np.nanmax(poses[q]))) for q in angles}
        beyond = {q: min(max(_NEAR, high - low), _FAR) for q, (low, high) in ends.items()}
        return all(
            ends[q][0] - beyond[q] <= to_si(float(np.nanmin(v)), of)
            and to_si(float(np.nanmax(v)), of) <= ends[q][1] + beyond[q]
            for q, v in angles.items()
        )

    (taken,) = units
    other = "deg" if taken == "rad" else "rad"
    if not among(other) or (taken == "rad" and among("rad")):
        return
    raise InputError(
        f"the joints of {what} without units are read in {taken}"
        + (", as those of the first readings" if in_source else "")
        + f"; in {other} they lie among the calibrated poses"
        + (" too" if among(taken) else ""),
        code="implausible-unit",
        remedy=f"state their unit, in headers such as J1 [{other}]; in Python by units={other!r} "
        f"or units={taken!r}",
    )


def _of_table(result: Any, data: Any, units: Units, *, whole: bool) -> Dataset:
    """A table in the columns and units of what the result was calibrated with, where its project
    states them; else named by quantity. An array has the joints, then what was measured."""
    mechanism, inputs = result.mechanism, getattr(result, "inputs", {})
    source = inputs.get("data", {}).get("source")
    if isinstance(data, list | np.ndarray):
        columns = np.asarray(data, dtype=float)
        outputs, unused = mechanism.outputs, mechanism.predicting().unused
        aside = {*outputs, *unused, *mechanism.disturbances}
        joints = [q for q in mechanism.quantities if q not in aside]
        names = [*joints, *outputs] if whole else joints
        stated = source["columns"] if source else {}
        in_source = {q: stated[q]["unit"] for q in names if q in stated}
        table = dict(zip(names, joint_rows(np.atleast_2d(columns), names).T, strict=True))
        if units is None:
            _refuse_doubtful({q: table[q] for q in joints}, in_source, result)
        return readings(table, mechanism, units or in_source)
    if isinstance(data, Mapping):  # one pose may be numbers
        data = {name: np.atleast_1d(values) for name, values in data.items()}
    if units is None and source is not None and not isinstance(data, Dataset):
        labels = {str(one["column"]) for one in source["columns"].values()}
        if labels <= {*column_names(data)}:
            return read_new_readings((data,), inputs, mechanism, whole=whole)
    if units is None and "data" in inputs and not isinstance(data, Dataset):
        data, units = _by_quantity(data, inputs, mechanism, whole=whole)
    return readings(data, mechanism, units)


def _by_quantity(
    data: Any, inputs: Mapping[str, Any], mechanism: Mechanism, *, whole: bool
) -> tuple[Any, Units]:
    """A table under the columns of a project, named by quantity, and its units; any other as it
    is, and so one whose columns are called as the quantities are, which is in SI."""
    needless = set() if whole else {*mechanism.outputs, *mechanism.predicting().unused}
    columns = {q: c for q, c in result_columns(inputs, mechanism).items() if q not in needless}
    names, labels = {*column_names(data)}, {c.column for c in columns.values()}
    if not labels <= names or labels <= mechanism.quantities.keys():
        return data, None
    pose = result_pose_column(inputs, mechanism)
    ids = {POSE: data[pose]} if pose in names else {}
    units = {q: c.unit for q, c in columns.items() if c.unit is not None}
    return ids | {q: data[c.column] for q, c in columns.items()}, units

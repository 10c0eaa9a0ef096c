"""The errors of the poses by name, each in its unit; and errors beside those of a result: with no
change along the run taken up, and of poses left out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import lru_cache

import numpy as np

from loopcal.arrays import Array
from loopcal.estimation.prediction import predict_outputs
from loopcal.files.result.pose_table import PoseTable
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.presentation.shown import factor, unit_shown
from loopcal.report.drawn import by_instrument, pose_distances
from loopcal.report.source import Source
from loopcal.statistics.changes import ids_are_numbers

Named = Mapping[str, Array]
ALONG_THE_RUN = ("shift", "drift")
"""Types of the effects that take up a change along the run."""


@dataclass(frozen=True, eq=False)
class LeftOut:
    """Poses that the fit does not use: ids, numbers (N,) as of those used, differences computed
    minus measured, their sizes (N,), and readings [SI]."""

    poses: tuple[str, ...]
    numbers: Array
    differences: Named
    sizes: Array
    readings: Named


@lru_cache(maxsize=4)  # a source compares by identity
def without_poses(source: Source, poses: tuple[str, ...]) -> Source:
    """The same result without these poses, which it used."""
    gone, table = set(poses), source.table
    kept = [i for i, pose in enumerate(table.poses) if pose not in gone]
    if len(kept) in (0, len(table.poses)):
        return source
    columns = {
        part: {name: values[kept] for name, values in getattr(table, part).items()}
        for part in (field.name for field in fields(table))
        if part != "poses"
    }
    return replace(source, table=PoseTable(tuple(table.poses[i] for i in kept), **columns))


@lru_cache(maxsize=4)
def without_changes(source: Source) -> Named | None:
    """Output -> (N,) computed minus measured, the calibrated machine without what it takes up as
    changed along the run; None where it takes up nothing."""
    mechanism, table = source.mechanism, source.table
    if mechanism is None or not _by_outputs(mechanism):
        return None
    described = (mechanism.description or {}).get("effect", [])
    names = [str(e.get("name")) for e in described if e.get("type") in ALONG_THE_RUN]
    changing = {p for name in names for p in mechanism.effects.get(name, ())}
    changing |= {p.name for p in mechanism.parameters if p.changes}  # of the load: no effect's
    if not changing:
        return None
    unchanged = mechanism.with_nominal(dict.fromkeys(changing, 0.0))
    return _differences(unchanged, table.readings, table.pose_constants, len(table.poses))


def left_out(source: Source, data: Dataset) -> LeftOut | None:
    """The poses of the readings that a result does not use; None where it uses all of them.

    What dates a change has the value of the pose used that is nearest in the run.
    """
    mechanism, table = source.mechanism, source.table
    used = {pose: i for i, pose in enumerate(table.poses)}
    places = [i for i, pose in enumerate(data.poses) if pose not in used]
    kept = [i for i, pose in enumerate(data.poses) if pose in used]
    whole = len(kept) == len(used) > 0
    if mechanism is None or not places or not whole or not _by_outputs(mechanism):
        return None
    near = [int(np.argmin(np.abs(np.array(kept) - i))) for i in places]
    readings = {name: values[places] for name, values in data.readings.items()}
    constants = {name: values[near] for name, values in table.pose_constants.items()}
    differences = _differences(mechanism, readings, constants, len(places))
    poses = tuple(data.poses[i] for i in places)
    aside = replace(source, table=PoseTable(poses, readings=readings))
    sizes = pose_distances(aside, differences)
    # Positions count the poses used: one left out stands between its neighbours.
    numbers = np.interp(places, kept, np.arange(1.0, len(kept) + 1.0))
    if ids_are_numbers(data.poses):
        numbers = np.array([float(pose) for pose in poses])
    return LeftOut(poses, numbers, differences, sizes, readings)


def _by_outputs(mechanism: Mechanism) -> bool:
    """Whether what is compared are outputs alone; small turns follow from no prediction."""
    return bool(mechanism.outputs) and mechanism.compared == mechanism.outputs


def _differences(mechanism: Mechanism, readings: Named, constants: Named, count: int) -> Named:
    nothing = np.zeros(count)
    tape = mechanism.tape
    asked = np.array([np.nan_to_num(readings.get(q, nothing)) for q in tape.quantities])
    dated = np.array([constants.get(q, nothing) for q in tape.pose_constants]).reshape(-1, count)
    values = np.array([p.nominal for p in mechanism.parameters])
    computed = predict_outputs(mechanism, values, asked, dated)
    lost = np.full(count, np.nan)
    outputs = zip(mechanism.outputs, computed, strict=True)
    return {name: value - readings.get(name, lost) for name, value in outputs}


# The errors of the poses by name, each in its unit.


SIZE = "distance"
"""The error of a pose as one number: the length of its differences."""
TURN = "{instrument}: turn"
"""The rotation from the measured to the computed orientation, of one instrument."""


def errors_by_name(
    source: Source, differences: Mapping[str, Array], unit: str
) -> tuple[dict[str, Array], dict[str, str]]:
    """Name -> (N,) errors, and their units: the size of all, that of each instrument where there
    are several or where it turns too, and each output but the corners of images and lone gaps.

    unit: of the size [SI].
    """
    instruments = by_instrument(source, differences) or ()
    # Corners of images are too many, and a gap is the distance of its instrument already.
    counted = {
        q
        for one in instruments
        for q in one.seen.position
        if one.seen.image or (len(instruments) > 1 and len(one.seen.position) == 1)
    }
    si = {SIZE: unit}
    shown = {SIZE: pose_distances(source, differences)}
    for one in instruments:
        name = one.seen.instrument
        if one.position is not None and len(instruments) > 1:
            si.setdefault(name, one.seen.unit)
            shown.setdefault(name, one.position)
        if one.position is not None and one.angle is not None:
            turn = TURN.format(instrument=name)
            si[turn], shown[turn] = "rad", one.angle
    quantities = {} if source.document.mechanism is None else source.document.mechanism.quantities
    for name, values in differences.items():
        if quantities.get(name) == unit and name not in counted:
            si.setdefault(name, unit)
            shown.setdefault(name, values)
    scaled = {name: values / factor(si[name]) for name, values in shown.items()}
    return scaled, {name: unit_shown(one) for name, one in si.items()}

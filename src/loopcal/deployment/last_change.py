"""Poses of a machine that changed along its run, as it would be read after the last change."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.prediction import predict_outputs
from loopcal.estimation.problem.constants import constants_by_pose, with_implied
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.mechanism import Mechanism


def after_last_change(machine: Mechanism, poses: Dataset) -> Dataset:
    """The poses with outputs y + f(q, now) - f(q, then): what the model says changed since then.

    machine: a calibrated one; f: its outputs [SI] with the constants as after the last change, and
    as they were. Poses stay as they are where the machine did not change or nothing dates them.
    """
    dated = [name for name in machine.latest if name in poses.readings]
    if not dated:
        return poses
    data = with_implied(machine, poses)
    # Only the difference counts, so what the model does not explain in a reading stays in it.
    then = constants_by_pose(machine, data)
    now = then.copy()
    for name in dated:
        now[machine.tape.pose_constants.index(name)] = machine.latest[name]
    values = np.array([p.nominal for p in machine.parameters])
    x = np.array([_read(machine, data, q) for q in machine.tape.quantities])
    moved = predict_outputs(machine, values, x, now) - predict_outputs(machine, values, x, then)
    seen = {q: poses.readings[q] + d for q, d in zip(machine.outputs, moved, strict=True)}
    return poses.with_readings(seen)


def _read(machine: Mechanism, data: Dataset, quantity: str) -> NDArray[np.float64]:
    """(N,) readings; without any, the value at home, which is 0 for errors of the model."""
    if quantity in data.readings:
        return data.readings[quantity]
    return np.full(len(data), machine.home.get(quantity, 0.0))

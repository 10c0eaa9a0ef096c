"""A reading that is missing in a few poses: folds begin where the fit of all poses left it."""

from __future__ import annotations

import numpy as np

import loopcal as lc
from loopcal.estimation.problem.problem import build_problem
from loopcal.estimation.steps import Near, begun_near
from loopcal.statistics.validation import unread

STEPS = np.radians(np.arange(0.0, 91.0, 15.0))
TRUTH = lc.planar_two_link().with_nominal({"l2": 0.8, "l3": 0.6})
SDS = lc.Noise({"xP": 1e-4, "yP": 1e-4, "phi2": 1e-4, "phi3": 1e-4})


def test_a_fold_begins_where_the_missing_joint_stood() -> None:
    made = lc.simulate(TRUTH, lc.grid_poses({"phi2": STEPS, "phi3": STEPS}), noise=SDS, seed=0)
    phi3 = made.dataset.readings["phi3"].copy()
    meant = float(phi3[10])
    phi3[10] = np.nan
    readings = {**made.dataset.readings, "phi3": phi3}
    data = lc.Dataset(readings)
    whole = lc.calibrate(lc.planar_two_link(), data, noise=SDS, method="implicit-loop")
    values = unread(whole)
    assert list(values) == ["phi3"]
    assert abs(values["phi3"][10] - meant) < 2e-3

    index = np.setdiff1d(np.arange(len(data)), [9])  # a neighbour, from which the place holder came
    part = build_problem(whole.mechanism, data.take(index), SDS, whole.value)
    begun = begun_near(part, Near(values).take(index).unread)
    assert begun.first_corrections is not None
    row = whole.mechanism.tape.quantities.index("phi3")
    where = begun.readings[row] + begun.first_corrections[row]
    assert abs(where[9] - values["phi3"][10]) < 1e-12
    assert not begun.first_corrections[0].any()

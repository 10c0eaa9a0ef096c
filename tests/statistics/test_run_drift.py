"""A drift of the instrument where the joints tell the order of the poses."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

import loopcal as lc
from loopcal.estimation.fit import Fit
from loopcal.mechanisms.instruments.length import draw_wire
from loopcal.mechanisms.instruments.point import point
from loopcal.mechanisms.planar import motoman_ma1400
from loopcal.mechanisms.serial import Joint, serial_machine
from loopcal.statistics.case import Case, Entrant, entrants, nominal_machine, without_terms
from loopcal.statistics.judged_readings import SUGGESTED
from loopcal.statistics.run_drift import COLUMN, drifting, with_run_drift
from loopcal.statistics.run_order import told_by_joints
from tests.reference.simulated import planar_arm

ARM = planar_arm(60)
SDS = {"xP": 1e-4, "yP": 1e-4, "phi2": 1e-5, "phi3": 1e-5}
READ = ARM.read(SDS, 1)
SORTED = READ.take(np.argsort(READ["phi2"]))
OVER = 1e-3
"""[m] by which the tracker drifts along x."""


def case(data: lc.Dataset, **options: object) -> Case:
    fit = Fit(method="implicit-loop", **options)  # type: ignore[arg-type]
    return Case(ARM.truth, data, lc.Noise(SDS), fit)


def drifted(data: lc.Dataset) -> lc.Dataset:
    return data.with_readings({"xP": data["xP"] + np.linspace(0.0, OVER, len(data))})


def test_only_an_order_that_the_joints_tell_gets_a_drift() -> None:
    random = case(READ)
    assert with_run_drift(random) is random
    assert with_run_drift(case(SORTED, loss="huber")).mechanism is ARM.truth
    made = with_run_drift(case(SORTED))
    assert made.mechanism.terms[-1].parameters == ("xP_drift", "yP_drift")
    np.testing.assert_allclose(made.data[COLUMN][[0, -1]], [-0.5, 0.5])
    # a drift that the user has modelled stays alone
    assert with_run_drift(made) is made


def test_a_drift_is_found_and_predictions_are_of_the_middle_of_the_run() -> None:
    plain, free = (one.calibrated() for one in (case(drifted(SORTED)), _free(drifted(SORTED))))
    assert free.value["xP_drift"] == pytest.approx(OVER, abs=1e-4)
    assert abs(free.value["yP_drift"]) < 1e-4
    fresh = {q: ARM.exact[q] for q in ("phi2", "phi3")}
    off = [lc.predict(one, fresh).outputs["xP"] - ARM.exact["xP"] for one in (plain, free)]
    worst = [np.abs(values - 0.5 * OVER).max() for values in off]
    assert worst[1] < 0.5 * worst[0]


def test_readings_without_a_drift_rarely_suggest_one_and_a_drift_of_ten_sds_always() -> None:
    """At 5 % of a test of one set: 11 of 100 or more are rarer than 1 %."""
    sets = [ARM.read(SDS, seed) for seed in range(100)]
    for over, least, most in ((0.0, 0, 10), (OVER, 100, 100)):
        suggested = 0
        for one in sets:
            data = one.take(np.argsort(one["phi2"]))
            moved = data["xP"] + np.linspace(0.0, over, len(data))
            terms = _free(data.with_readings({"xP": moved})).calibrated().terms
            (gain,) = (term.gain for term in terms if term.name == "run_drift")
            assert gain is not None
            suggested += gain >= SUGGESTED
        assert least <= suggested <= most


def test_what_the_poses_cannot_separate_widens_and_poses_measured_again_separate_it() -> None:
    """The same poses along an arc of one joint, with three of them again at the end or without."""
    rows = np.linspace(0, 59, 57).astype(int)
    again = np.concatenate([rows, rows[[5, 28, 50]]])
    sds = [
        _free(SORTED.take(index)).calibrated().sd["xP_drift"] or np.nan
        for index in (np.arange(60), again)
    ]
    assert sds[1] < sds[0]


def test_the_drift_stays_where_terms_leave_and_the_nominal_machine_has_it_too() -> None:
    made = with_run_drift(case(SORTED))
    one = next(iter(entrants(made)))
    assert isinstance(one, Entrant)
    assert without_terms(made, one, {"run_drift"}) is None
    fewer = without_terms(made, one, {"run_drift", "harmonics"})
    assert fewer is not None
    assert "run_drift" in {term.name for term in fewer.case.mechanism.terms}
    assert {"xP_drift", "yP_drift"} <= {*nominal_machine(made.mechanism).parameters.free}


def test_rows_that_copy_others_are_found_beside_a_drift() -> None:
    """What only dates a pose does not make a copied row a measurement."""
    rows = np.append(np.arange(60), [3, 3, 17, 40])
    copied = lc.Dataset.from_arrays({q: SORTED[q][rows] for q in SDS})
    made = with_run_drift(case(copied))
    assert made.mechanism.terms
    assert len(made.copied) == 4


def test_what_drifts_is_a_place_or_the_zero_of_a_reading() -> None:
    def machine(*instruments: lc.Instrument) -> lc.Mechanism:
        arm = serial_machine([Joint("q1", "dh", "revolute"), Joint("q2", "dh", "revolute")])
        return lc.assemble(arm, list(instruments))

    assert drifting(machine(point(readings=("x", "y", "z")))) == ("base_x", "base_y", "base_z")
    two = [point(f"r{k}", readings=(f"x{k}", f"y{k}", f"z{k}"), target=f"r{k}") for k in (1, 2)]
    assert drifting(machine(*two)) == ("base_x", "base_y", "base_z")
    assert drifting(machine(draw_wire("wire", anchor="anchor"))) == ("wire",)
    assert drifting(ARM.truth) == ("xP", "yP")
    # transitions say where such an arm stands, and its geometry as well
    assert drifting(motoman_ma1400()) == ("x", "y", "z")


@pytest.mark.parametrize("joints", [2, 3, 6])
def test_few_poses_in_random_order_rarely_tell_it(joints: int) -> None:
    rng = np.random.default_rng(joints)

    def told(poses: int, *, ordered: bool) -> bool:
        q: NDArray[np.float64] = rng.uniform(-1.0, 1.0, (poses, joints))
        return told_by_joints(q[np.argsort(q[:, 0])] if ordered else q) is not None

    for poses in (joints + 17, 2 * joints + 20, 60):
        assert sum(told(poses, ordered=False) for _ in range(100)) <= 4
        assert told(poses, ordered=True)
    assert not told(8, ordered=True)


def _free(data: lc.Dataset) -> Case:
    return with_run_drift(case(data))

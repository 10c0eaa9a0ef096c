"""Two calibrations of one machine: placement aside, within their uncertainty or not."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import kstest

import loopcal as lc
from analyses.gauntlet_worlds import Parallel
from loopcal.statistics.calibrated import Calibrated
from loopcal.statistics.comparison import compare
from loopcal.statistics.gauge import gauge, moved, values_of
from tests.reference.machines import MACHINES
from tests.reference.simulated import Simulated, arm_at, ma1400, planar_arm
from tests.refusals import refused

DRAWS = 50


def elsewhere(arm: Simulated, seed: int, poses: int) -> Simulated:
    """The same machine in other poses, seen by an instrument that stands elsewhere."""
    truth = arm.truth
    assert truth.placement is not None
    d = len(truth.outputs)
    new = truth.placement.moved(arm.values, *motion(seed, d))
    rng = np.random.default_rng([seed, 1])
    joints = rng.uniform(-1.2, 1.2, (len(truth.quantities) - d, poses))
    return arm_at(truth.with_nominal(new), joints)


def motion(seed: int, d: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """How an instrument that stands elsewhere sees the points of one in d dimensions move."""
    R = lc.rot_z(0.6) if d == 3 else np.array([[0.8, -0.6], [0.6, 0.8]])
    return np.array(R, dtype=float), np.random.default_rng(seed).uniform(-1.0, 1.0, d)


def sds_of(arm: Simulated) -> dict[str, float]:
    return dict.fromkeys(arm.truth.quantities, 1e-4)


def calibrated(arm: Simulated, seed: int, prior: lc.Prior | None = None) -> lc.Result:
    sds = sds_of(arm)
    noise = lc.Noise(sds)
    return lc.calibrate(
        arm.truth,
        arm.read(sds, seed),
        noise=noise,
        prior=prior,
        start="nominal",
        method="implicit-loop",
    )


@pytest.mark.parametrize("arm", [planar_arm(40), ma1400(50)], ids=["planar", "MA1400"])
def test_differences_follow_their_distribution(arm: Simulated) -> None:
    other = elsewhere(arm, seed=4, poses=50)
    p, inside, z = [], [], []
    for seed in range(DRAWS // 2):
        found = compare(calibrated(arm, seed), calibrated(other, 1000 + seed))
        p.append(found.p_value)
        assert found.points is not None
        inside.append(found.points.inside)
        z.append([q.z for q in found.parameters if q.z is not None])
    gauge_directions = 3 if len(arm.truth.outputs) == 2 else 6
    assert found.degrees_of_freedom == len(arm.truth.parameters) - gauge_directions
    assert kstest(p, "uniform").pvalue > 0.01
    assert np.mean(inside) == pytest.approx(0.95, abs=0.05)
    assert np.std(z) == pytest.approx(1.0, abs=0.15)


def test_a_prior_that_both_share_counts_once() -> None:
    nominal = ma1400(40)
    assert nominal.truth.placement is not None
    own = [n for n in nominal.values if n not in nominal.truth.placement.parameters]
    prior, noise = lc.Prior(dict.fromkeys(own, 3e-5)), lc.Noise(sds_of(nominal))
    joints = [np.array(list(ma1400(40, seed).exact.values()))[:6] for seed in (2, 5)]
    rng, p = np.random.default_rng(0), []
    for seed in range(DRAWS // 2):
        drawn = {n: nominal.values[n] + 3e-5 * rng.standard_normal() for n in own}
        truth = nominal.truth.with_nominal(drawn)
        a, b = (
            lc.calibrate(
                nominal.truth,
                arm_at(truth, q).read(sds_of(nominal), 10 * seed + i),
                noise=noise,
                prior=prior,
                start="nominal",
                method="implicit-loop",
            )
            for i, q in enumerate(joints)
        )
        p.append(compare(a, b).p_value)
    assert kstest(p, "uniform").pvalue > 0.01


def test_a_machine_that_changed_is_told() -> None:
    arm = planar_arm(60)
    other = elsewhere(arm, seed=4, poses=60)
    joints = np.array([other.exact[q] for q in ("phi2", "phi3")])
    longer = arm_at(other.truth.with_nominal({"l3": 0.592}), joints)
    found = compare(calibrated(arm, 1), calibrated(longer, 2))
    assert found.p_value is not None
    assert found.p_value < 1e-6
    own = [q for q in found.parameters if not q.placement]
    worst = max(own, key=lambda q: abs(q.z or 0.0))
    assert worst.name == "l3"
    assert worst.difference == pytest.approx(2e-3, abs=4 * (worst.sd or 0.0))
    assert found.points is not None
    assert 0.2e-3 < found.points.max < 3e-3
    text = str(found)
    assert "differ by more than their stated uncertainty" in text
    assert "l3 (z = " in text
    assert found.document()["chi_squared"]["p_value"] == found.p_value


def test_where_the_instrument_stood_makes_no_difference() -> None:
    arm = planar_arm(40)
    assert arm.truth.placement is not None
    a, b = calibrated(arm, 1), calibrated(elsewhere(arm, seed=4, poses=40), 2)
    plain = compare(a, b)
    c, s = np.cos(2.0), np.sin(2.0)
    R = np.array([[c, -s], [s, c]])
    again = arm.truth.with_nominal(arm.truth.placement.moved(b.value, R, np.array([3.0, -2.0])))
    readings = np.array([b.dataset["xP"], b.dataset["yP"]])
    turned = dict(zip(("xP", "yP"), R @ readings + [[3.0], [-2.0]], strict=True))
    data = b.dataset.with_readings(turned)
    seen = lc.calibrate(
        again, data, noise=lc.Noise(sds_of(arm)), start="nominal", method="implicit-loop"
    )
    found = compare(a, seen)
    assert found.chi_squared == pytest.approx(plain.chi_squared, rel=1e-5)
    assert [q.difference for q in found.parameters] == pytest.approx(
        [q.difference for q in plain.parameters], abs=1e-8
    )


@pytest.mark.parametrize("name", [n for n, m in MACHINES.items() if m.placement and n != "gantry"])
def test_the_gauge_moves_no_machine(name: str) -> None:
    machine = MACHINES[name]
    d = len(machine.outputs)
    values = values_of(machine)
    G = gauge(machine, values, np.full(d, 0.3))
    assert np.linalg.matrix_rank(G) == (3 if d == 2 else 6)
    still = moved(machine, values, np.eye(d), np.zeros(d))
    assert np.sin(still - values) == pytest.approx(0.0, abs=1e-12)


def test_platforms_that_no_sensor_reads_are_found_by_the_loops(tmp_path: Path) -> None:
    """Two halves of the readings of a delta robot, the second after its machine has changed."""
    trial = Parallel("delta", poses=120).made(np.random.default_rng(7))
    halves = [
        {q: v[part] for q, v in trial.readings.items()} for part in np.split(np.arange(120), 2)
    ]
    halves.append({q: v + 2e-3 * (q == "slide_1") for q, v in halves[1].items()})
    first, same, changed = (
        lc.calibrate(trial.mechanism, half, noise=trial.noise, method="implicit-loop")
        for half in halves
    )
    agreed = compare(first, same)
    off = compare(first, changed)
    assert (agreed.p_value or 0.0) > 0.01
    assert (off.p_value or 0.0) < 1e-6
    assert off.points is not None
    assert agreed.points is not None
    assert off.points.rms > 10.0 * agreed.points.rms
    # the same from a folder, whose prediction says what no sensor reads
    for name, result in (("a", first), ("b", same)):
        result.save(tmp_path / name, report=False)
    written = lc.compare(str(tmp_path / "a"), str(tmp_path / "b"))
    assert written.p_value == pytest.approx(agreed.p_value, rel=1e-3)


def test_what_one_of_them_leaves_open_is_left_out() -> None:
    arm = planar_arm(40)
    exact = sds_of(arm) | {"phi3": 0.0}
    straight = arm_at(arm.truth, np.array([np.linspace(-1, 1, 20), np.zeros(20)]))
    b = lc.calibrate(
        arm.truth,
        straight.read(exact, 3),
        noise=lc.Noise(exact),
        start="nominal",
        method="implicit-loop",
    )
    found = compare(calibrated(arm, 1), b)
    by_name = {q.name: q for q in found.parameters}
    assert by_name["l2"].sd is None
    assert found.degrees_of_freedom < 3
    assert "unknown" in str(found)


def test_same_readings_and_other_machines() -> None:
    arm = planar_arm(40)
    data = arm.read(sds_of(arm), 1)
    a = lc.calibrate(arm.truth, data, noise=lc.Noise(sds_of(arm)), method="implicit-loop")
    b = lc.calibrate(arm.truth, data, method="least-squares")
    found = compare(a, b)
    assert any("same readings" in note for note in found.notes)
    assert found.verdict().startswith("The two machines agree")
    kept = compare(a, b, align=False)
    assert not kept.aligned
    assert kept.degrees_of_freedom == 6
    with refused("conflicting-keys", "xA", "x0"):
        compare(a, calibrated(ma1400(50), 1))


def test_halves_of_the_measured_grid_agree_all_over_the_joint_box(
    shared_data: Callable[[str], Path],
) -> None:
    file = shared_data("motoman_ma1400_leica/left_arm_grid.csv")
    joints = {f"theta_{i}": n for i, n in enumerate("SLURBT", 1)}
    data = lc.read_dataset(file, joints | {q: q for q in "xyz"}, pose="pose")
    arm = lc.motoman_ma1400({"z1": 1.4159, "x6B": 0.05, "z6B": -0.45})
    sds = dict(zip(joints, (42e-6, 25e-6, 11e-6, 99e-6, 95e-6, 44e-6), strict=True))
    noise = lc.Noise(sds | dict.fromkeys("xyz", 5e-6))
    chosen = np.random.default_rng(1).permutation(len(data))
    a, b = (
        lc.calibrate(arm, data.take(np.sort(half)), noise=noise, method="implicit-loop")
        for half in np.array_split(chosen, 2)
    )
    box = {q: (float(data[q].min()), float(data[q].max())) for q in joints}
    at = lc.Dataset.from_arrays(lc.random_poses(box, 300, seed=2))
    found = compare(a, b, poses=at, align=False)
    assert found.points is not None
    assert found.points.max > 2e-3  # far more than the 0.07 mm of the fit
    assert found.points.inside >= 0.9


def test_poses_that_both_calibrations_share_count_once() -> None:
    arm = planar_arm(30)
    found = compare(calibrated(arm, 1), calibrated(arm, 1))
    assert found.points is not None
    assert len(found.points.poses) == 30
    other = compare(calibrated(arm, 1), calibrated(arm, 2))
    assert other.points is not None
    assert len(other.points.poses) == 60


def eccentric(box: dict[str, tuple[float, float]], seed: int, *, shift: float = 0.0) -> lc.Result:
    """An arm with an eccentric encoder that its model does not know, in a region of its joints."""
    arm = lc.planar_two_link()
    truth = arm.with_nominal({"l3": arm.parameters["l3"].nominal + shift})
    at = lc.random_poses(box, 40, seed=1000 + seed)
    made = lc.simulate(truth, at, noise={"*": 1e-4}, seed=seed).dataset
    readings = {q: np.array(made[q]) for q in made.quantities}
    readings["phi2"] += 1e-3 * np.sin(readings["phi2"] + readings["phi3"])
    return lc.calibrate(arm, readings, noise={"*": 1e-4}, start="nominal", method="implicit-loop")


def test_an_unchanged_imperfect_machine_in_two_regions_gives_no_alarm() -> None:
    low, high = {"phi2": (0.0, 0.8), "phi3": (0.3, 1.1)}, {"phi2": (0.8, 1.6), "phi3": (0.9, 1.7)}
    found = [compare(eccentric(low, s), eccentric(high, 50 + s)) for s in range(8)]
    assert all(f.p_value is not None and f.p_value < 0.05 for f in found)
    assert [f.differ for f in found] == [None] * 8
    assert "different regions" in found[0].verdict()
    assert found[0].document()["differ"] is None


def test_a_change_in_the_same_region_is_seen() -> None:
    box = {"phi2": (0.0, 1.6), "phi3": (0.3, 1.7)}
    assert compare(eccentric(box, 1), eccentric(box, 2, shift=5e-3)).differ is True


def test_rejected_sds_count_as_large_as_the_residuals() -> None:
    arm = planar_arm(40)
    small = lc.Noise(dict.fromkeys(arm.truth.quantities, 2e-5))
    a, b = (
        lc.calibrate(
            arm.truth,
            arm.read(sds_of(arm), seed),
            noise=small,
            start="nominal",
            method="implicit-loop",
        )
        for seed in (1, 2)
    )
    found = compare(a, b)
    assert a.chi_squared is not None and a.chi_squared.too_large  # noqa: PT018
    assert found.p_value is not None
    assert found.p_value > 1e-3
    assert any("count 5" in note or "count 4.9" in note or "count 5.1" in note
               for note in found.notes)  # fmt: skip


def test_an_imperfect_machine_that_did_not_change_raises_few_alarms_in_the_same_region() -> None:
    """17 % by the stated sds, even where these count as large as the residuals."""
    box = {"phi2": (0.0, 1.6), "phi3": (0.3, 1.7)}
    found = [compare(eccentric(box, 2 * s), eccentric(box, 2 * s + 1)) for s in range(60)]
    assert sum(f.p_value < 0.05 for f in found if f.p_value is not None) <= 6
    seen = [f for f in found if any("poses scatter" in note for note in f.notes)]
    assert seen
    assert all(np.isfinite(f.test.denominator) for f in seen)


def test_a_written_calibration_holds_the_scatter_of_its_poses(tmp_path: Path) -> None:
    box = {"phi2": (0.0, 1.6), "phi3": (0.3, 1.7)}
    result = eccentric(box, 1)
    known = Calibrated.of(result, "A").scatter
    lc.write_result(result, tmp_path)
    document = lc.read_result(tmp_path / "result.json").document
    again = Calibrated.from_document(document, result.mechanism, None, "B").scatter
    assert known is not None
    assert again is not None
    np.testing.assert_allclose(again.matrix, known.matrix, rtol=1e-5)
    assert again.freedom == known.freedom


def test_the_scatter_of_good_poses_is_their_covariance_and_varies_as_it_says() -> None:
    """A Wishart matrix over nu degrees of freedom: variances (n^2 + n) / nu in all."""
    arm = planar_arm(40)
    found, freedom = [], []
    for seed in range(60):
        result = calibrated(arm, seed)
        known = Calibrated.of(result, "A").scatter
        assert known is not None
        root = np.linalg.cholesky(np.linalg.inv(result.covariance))
        found.append(root.T @ known.matrix @ root)
        freedom.append(known.freedom)
    assert np.trace(np.mean(found, axis=0)) / 6 == pytest.approx(1.0, abs=0.1)
    assert 42.0 / np.var(found, axis=0).sum() == pytest.approx(np.mean(freedom), rel=0.2)

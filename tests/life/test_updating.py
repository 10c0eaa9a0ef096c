"""An update: yesterday's covariance is as good as yesterday's poses."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import loopcal as lc
from analyses.instruments import setup
from analyses.verify import another_day
from analyses.what_changed import NOISE, joints, measured
from analyses.what_changed import arm as arm_as_drawn
from loopcal.companions.life.updating import update
from loopcal.document.plain import symmetric
from loopcal.estimation.result import FitResult
from loopcal.statistics.calibrated import Calibrated
from tests.command_line import run_here as run
from tests.reference.simulated import planar_arm
from tests.refusals import refused
from tests.statistics.test_comparison import sds_of

EXAMPLES = Path(__file__).resolve().parents[2] / "examples" / "motoman"
FIRST, SECOND = np.arange(50), np.arange(50, 100)


def values(result: FitResult) -> np.ndarray:
    return np.array([result.value[name] for name in result.estimated])


def sds(result: FitResult) -> np.ndarray:
    return np.array([result.sd[name] for name in result.estimated], dtype=float)


def straight() -> lc.Mechanism:
    return lc.Mechanism.from_function(
        lambda x, p: [x.y - p.a * x.q - p.b],
        {"q": "m", "y": "m"},
        {"a": (1.0, "1"), "b": (0.0, "m")},
        outputs=("y",),
    )


def test_in_a_linear_problem_it_equals_fitting_everything_at_once() -> None:
    line = straight()
    rng = np.random.default_rng(0)
    q = rng.uniform(0.0, 1.0, 40)
    y = 1.1 * q + 0.2 + 1e-3 * rng.standard_normal(40)
    noise = lc.Noise({"q": 0.0, "y": 1e-3})
    first = lc.calibrate(line, {"q": q[:20], "y": y[:20]}, noise=noise, method="implicit-loop")
    every = lc.calibrate(line, {"q": q, "y": y}, noise=noise, method="implicit-loop")
    found = lc.update(first, {"q": q[20:], "y": y[20:]})
    assert values(found) == pytest.approx(values(every), rel=1e-12)
    assert found.covariance == pytest.approx(every.covariance, rel=1e-10)
    assert found.chi_squared is not None
    assert every.chi_squared is not None
    assert first.chi_squared is not None
    both = first.chi_squared.value + found.chi_squared.value
    assert both == pytest.approx(every.chi_squared.value, rel=1e-10)
    assert found.chi_squared.degrees_of_freedom == 20


def test_a_pose_that_does_not_fit_is_left_out_of_an_update() -> None:
    given = setup("six-axis spherical")
    data = lc.simulate(given.truth, given.driven, noise=given.noise, seed=1).dataset
    nominal = given.truth.with_parameters(given.truth.parameters.with_fixed(given.held))
    first = lc.calibrate(nominal, data.take(FIRST), noise=given.noise, method="implicit-loop")
    later, wrong = data.take(SECOND), np.arange(len(SECOND)) == 7
    output = first.mechanism.outputs[0]
    bent = later.with_readings({output: later[output] + 0.02 * wrong})
    found, without = lc.update(first, bent), lc.update(first, later.take(np.flatnonzero(~wrong)))
    assert found.document.data.discarded == (later.poses[7],)
    assert any("discarded from the fit" in words for words in found.document.warnings)
    assert np.abs((values(found) - values(without)) / sds(without)).max() < 1e-2
    of_first, of_update = (
        {row.split("  ")[0] for row in f"{r}".split("\n")} for r in (first, found)
    )
    assert ("nominal" in of_first, "nominal" in of_update) == (True, False)
    assert "before the update" in of_update - of_first
    check = lc.verify(first, later.take(np.flatnonzero(~wrong)))
    assert found.document.accuracy is not None
    assert check.calibrated is not None
    before = found.document.accuracy.before
    assert before.rms == pytest.approx(check.calibrated.rms, rel=1e-2)


def half(same_place: bool) -> tuple[lc.Result, lc.Result]:
    """An arm updated by its second half of poses, and calibrated by all."""
    given = setup("six-axis spherical")
    data = lc.simulate(given.truth, given.driven, noise=given.noise, seed=1).dataset
    nominal = given.truth.with_parameters(given.truth.parameters.with_fixed(given.held))
    every, first = (
        lc.calibrate(nominal, part, noise=given.noise, method="implicit-loop")
        for part in (data, data.take(FIRST))
    )
    return lc.update(first, data.take(SECOND), moved=not same_place), every


def test_an_arm_is_within_a_tenth_of_an_sd_of_fitting_everything_at_once() -> None:
    found, every = half(same_place=True)
    assert np.abs((values(found) - values(every)) / sds(every)).max() < 0.1
    assert sds(found) / sds(every) == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("seed", [0, 1])
def test_along_a_curved_valley_it_equals_fitting_everything_at_once(
    seed: int, shared_data: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The grid determines some directions by a 30,000th of others, and the halves differ there."""
    path = shared_data("motoman_ma1400_leica/left_arm_grid.csv")
    monkeypatch.setenv("LOOPCAL_DATA", os.fspath(path.parents[1]))
    project = lc.read_project(EXAMPLES / "left_arm_grid.toml")
    loaded = lc.load_dataset(project)
    rows = np.random.default_rng(seed).permutation(len(loaded.dataset))
    first, every = (
        lc.calibrate(project.mechanism, data, noise=loaded.noise, method="implicit-loop")
        for data in (loaded.dataset.take(np.sort(rows[:104])), loaded.dataset)
    )
    found = lc.update(first, loaded.dataset.take(np.sort(rows[104:])), moved=False)
    away = np.abs(values(found) - values(every)) / np.sqrt(np.diag(every.spectrum.covariance()))
    assert np.abs(values(first) - values(every)).max() > 0.01
    assert away.max() < 0.02
    plain, of_all = found.spectrum.covariance(), every.spectrum.covariance()
    assert np.sqrt(np.diag(plain) / np.diag(of_all)) == pytest.approx(1.0, abs=0.01)
    # residuals depend on the pose order: that widens what is stated, not what is known
    assert np.all(np.diag(found.covariance) >= 0.999 * np.diag(plain))
    assert (np.diag(first.covariance) / np.diag(first.spectrum.covariance())).max() > 2.0
    entry = found.document.covariance
    assert entry.unwidened is not None
    assert symmetric(entry.unwidened) == pytest.approx(plain)


def test_where_the_poses_show_a_product_it_settles_on_fitting_everything_at_once() -> None:
    """Linearised at its own end, each fit would lead to the other side of the valley."""
    bend = lc.Mechanism.from_function(
        lambda x, p: [
            x.y - p.c * x.q - p.a * p.b * np.sin(3.0 * x.q),
            x.z - p.c * x.q**2 - 0.01 * (p.a + 0.3 * p.b) * x.q**3,
        ],
        {"q": "m", "y": "m", "z": "m"},
        {"a": (0.0, "1"), "b": (0.0, "1"), "c": (1.0, "1")},
        outputs=("y", "z"),
    )
    rng, sd = np.random.default_rng(4), 1e-3
    q = rng.uniform(0.0, 1.0, 60)
    y = 1.02 * q + 0.005 * np.sin(3.0 * q) + sd * rng.standard_normal(60)
    z = 1.02 * q**2 + 0.0008 * q**3 + sd * rng.standard_normal(60)
    noise, prior = lc.Noise({"q": 0.0, "y": sd, "z": sd}), lc.Prior({"a": 0.2, "b": 0.2})
    every, first = (
        lc.calibrate(
            bend,
            {"q": q[:n], "y": y[:n], "z": z[:n]},
            noise=noise,
            prior=prior,
            method="implicit-loop",
        )
        for n in (60, 30)
    )
    found = lc.update(first, {"q": q[30:], "y": y[30:], "z": z[30:]}, moved=False)
    assert np.abs((values(found) - values(every)) / sds(every)).max() < 0.1


def line() -> lc.Mechanism:
    return lc.Mechanism.from_function(
        lambda x, p: [x.y - p.a * x.q - p.b, x.z - p.a * x.q],
        {"q": "m", "y": "m", "z": "m"},
        {"a": (1.0, "1"), "b": (0.0, "m")},
        outputs=("y", "z"),
    )


def test_sds_are_learnt_from_the_poses_of_both_days() -> None:
    rng = np.random.default_rng(0)
    q = rng.uniform(0.0, 1.0, 60)
    y = 1.1 * q + 0.2 + 2e-3 * rng.standard_normal(60)
    z = 1.1 * q + 5e-3 * rng.standard_normal(60)
    noise = lc.Noise({"q": 0.0, "y": 1e-3, "z": 1e-3}, estimate={"y": "each", "z": "each"})
    every, first = (
        lc.calibrate(
            line(), {"q": q[:n], "y": y[:n], "z": z[:n]}, noise=noise, method="implicit-loop"
        )
        for n in (60, 20)
    )
    later = {"q": q[20:], "y": y[20:], "z": z[20:]}
    found = lc.update(first, later)
    assert values(found) == pytest.approx(values(every), abs=1e-3 * sds(every).min())
    for one, both in zip(found.noise, every.noise, strict=True):
        assert one.quantities == both.quantities
        assert one.source == both.source
        assert one.sd == pytest.approx(both.sd, rel=2e-3)
        assert (one.sd_of_sd or 0.0) == pytest.approx(both.sd_of_sd or 0.0, rel=1e-2)
        assert np.linalg.norm(one.slopes) == pytest.approx(np.linalg.norm(both.slopes), rel=1e-2)
    held = lc.update(first, later, noise={"q": 0.0, "y": 1e-3, "z": 1e-3})
    assert {one.sd for one in held.noise} == {0.0, 1e-3}
    once_more = lc.update(found, later)
    assert [one.source for one in once_more.noise] == [one.source for one in found.noise]


def test_sds_of_which_only_the_sum_is_seen_are_as_sure_as_it_after_an_update() -> None:
    """Each alone is open, so that the next check saw nothing, or took both for known."""
    mechanism = straight()
    rng = np.random.default_rng(0)
    q = rng.uniform(0.0, 1.0, 60)
    y = 1.1 * q + 0.2 + 3e-3 * rng.standard_normal(60)
    data = lc.Dataset.from_arrays({"q": q, "y": y})
    one, two, three = (data.take(np.arange(at, at + 20)) for at in (0, 20, 40))
    noise = lc.Noise({"q": 1e-3, "y": 1e-3}, estimate={"q": "each", "y": "each"})
    first = lc.calibrate(mechanism, one, noise=noise, method="implicit-loop")
    found = lc.update(first, two)
    freedoms = [lc.verify(result, three).innovation.learnt_freedom for result in (first, found)]
    assert freedoms == pytest.approx([18.0, 38.0], rel=0.03)


def test_a_drift_is_not_taken_for_noise() -> None:
    rng = np.random.default_rng(0)
    q = rng.uniform(0.0, 1.0, 80)
    slope = np.where(np.arange(80) < 40, 1.1, 1.15)
    y, z = (slope * q + by + 2e-3 * rng.standard_normal(80) for by in (0.2, 0.0))
    data = lc.Dataset.from_arrays({"q": q, "y": y, "z": z})
    noise = lc.Noise({"q": 0.0, "y": 1e-3, "z": 1e-3}, estimate={"[yz]": "group"})
    first = lc.calibrate(line(), data.take(np.arange(40)), noise=noise, method="implicit-loop")
    later = data.take(np.arange(40, 80))
    for drift in ({"a": 0.1}, {}):  # stated, and found by the check
        allowed = update(first, later, drift=drift)
        assert {one.quantities: one.sd for one in allowed.noise}["y", "z"] < 2.5e-3
        assert allowed.value["a"] == pytest.approx(1.15, abs=5e-3)


def test_without_the_earlier_poses_the_learnt_sds_are_handed_on() -> None:
    rng = np.random.default_rng(0)
    q = rng.uniform(0.0, 1.0, 40)
    y, z = (1.1 * q + 2e-3 * rng.standard_normal(40) for _ in "yz")
    data = {"q": q, "y": y, "z": z}
    noise = lc.Noise({"q": 1e-3, "y": 1e-3, "z": 1e-3}, estimate={"[qy]": "each"})
    first = lc.calibrate(line(), data, noise=noise, method="implicit-loop")
    bare = replace(Calibrated.of(first, ""), poses=None)
    updated = lc.update(bare, data)
    assert updated.noise == Calibrated.of(first, "").noise
    before, after = (lc.predict(result, {"q": q}).sd["z"] for result in (first, updated))
    assert after == pytest.approx(before, rel=0.04)


def test_learnt_sds_and_parameters_are_those_of_all_poses_on_a_measured_set(
    shared_data: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = shared_data("motoman_ma1400_leica/left_arm_grid.csv")
    monkeypatch.setenv("LOOPCAL_DATA", os.fspath(path.parents[1]))
    project = lc.read_project(EXAMPLES / "left_arm_sensors.toml")
    loaded = lc.load_dataset(project)
    rows = np.random.default_rng(0).permutation(len(loaded.dataset))
    first, every = (
        lc.calibrate(project.mechanism, data, noise=loaded.noise, method="implicit-loop")
        for data in (loaded.dataset.take(np.sort(rows[:104])), loaded.dataset)
    )
    found = lc.update(first, loaded.dataset.take(np.sort(rows[104:])), moved=False)
    assert np.abs((values(first) - values(every)) / sds(every)).max() > 1.0
    assert np.abs((values(found) - values(every)) / sds(every)).max() < 0.02
    learnt, of_all = ([e.sd for e in one.noise] for one in (found, every))
    assert learnt == pytest.approx(of_all, rel=0.01)


def test_without_the_earlier_poses_the_covariance_serves() -> None:
    given = setup("six-axis spherical")
    data = lc.simulate(given.truth, given.driven, noise=given.noise, seed=1).dataset
    nominal = given.truth.with_parameters(given.truth.parameters.with_fixed(given.held))
    first = lc.calibrate(nominal, data.take(FIRST), noise=given.noise, method="implicit-loop")
    known = Calibrated.of(first, "")
    with_poses, bare = (
        update(one, data.take(SECOND), moved=False) for one in (known, replace(known, poses=None))
    )
    assert np.abs((values(with_poses) - values(bare)) / sds(with_poses)).max() < 0.05


def test_readings_of_another_machine_are_reported() -> None:
    arm = planar_arm(60)
    data, noise = arm.read(sds_of(arm), 1), lc.Noise(sds_of(arm))
    first = lc.calibrate(arm.truth, data, noise=noise, method="implicit-loop")
    longer = arm.truth.with_nominal({"l2": arm.values["l2"] + 5e-3})
    driven = {q: v for q, v in arm.exact.items() if q in ("phi2", "phi3")}
    day = lc.simulate(longer, driven, noise=noise, seed=2).dataset
    # Two machines within one day: no change of the calibrated one explains both.
    both = {q: np.concatenate([v[:30], day.readings[q][30:]]) for q, v in data.readings.items()}
    found = lc.update(first, both)
    (words,) = (w for w in found.warnings if "moved along this run: from pose" in w)
    assert "Update with the poses before that change alone" in words
    assert not any("anew" in w and "estimates" in w for w in found.warnings)


def test_a_file_at_fault_is_refused_as_verify_names_it() -> None:
    """With two joints of a SCARA exchanged an update searched for more than seven minutes."""
    arm = planar_arm(60)
    data, noise = arm.read(sds_of(arm), 1), lc.Noise(sds_of(arm))
    first = lc.calibrate(arm.truth, data, noise=noise, method="implicit-loop")
    exchanged = data.with_readings({"phi2": data["phi3"], "phi3": data["phi2"]})
    assert lc.verify(first, exchanged).faults
    with refused("implausible-readings", "phi2 and phi3 are exchanged"):
        lc.update(first, exchanged)


def test_a_change_that_the_check_names_is_followed_and_reported() -> None:
    arm = planar_arm(60)
    data, noise = arm.read(sds_of(arm), 1), lc.Noise(sds_of(arm))
    first = lc.calibrate(arm.truth, data, noise=noise, method="implicit-loop")
    longer = arm.truth.with_nominal({"l2": arm.values["l2"] + 5e-3})
    driven = {q: v for q, v in arm.exact.items() if q in ("phi2", "phi3")}
    day = lc.simulate(longer, driven, noise=noise, seed=2).dataset
    for drift in ({}, {"length": 1e-2}, {"l2": 1e-2}):
        found = lc.update(first, day, drift=drift)
        assert not any("mixes" in words for words in found.warnings)
        assert found.value["l2"] - first.value["l2"] == pytest.approx(5e-3, abs=3e-4)
        said = [w for w in found.warnings if "The update estimates l2 anew." in w]
        assert len(said) == (0 if "l2" in drift else 1)
        assert not any(", or " in words for words in said)


def test_the_learnt_model_error_is_carried() -> None:
    drawn, rng = arm_as_drawn(sagging=True), np.random.default_rng(0)
    data = measured(drawn, "sagging", joints(rng, 40), 1)
    first = lc.calibrate(drawn, data, noise=NOISE, method="implicit-loop")
    assert first.terms
    found = lc.update(first, measured(drawn, "sagging", joints(rng, 10), 2))
    assert found.document.terms == first.document.terms
    assert Calibrated.of(found, "").carried


def test_a_placement_that_is_an_arm_of_its_own_is_kept_too() -> None:
    arm = planar_arm(60)
    data, noise = arm.read(sds_of(arm), 1), lc.Noise(sds_of(arm))
    first, every = (
        lc.calibrate(arm.truth, part, noise=noise, method="implicit-loop")
        for part in (data.take(np.arange(30)), data)
    )
    found = lc.update(first, data.take(np.arange(30, 60)), moved=False)
    assert np.abs((values(found) - values(every)) / sds(every)).max() < 0.1


def test_intervals_hold_the_truth_where_the_tracker_was_moved() -> None:
    given = setup("six-axis spherical")
    nominal = given.truth.with_parameters(given.truth.parameters.with_fixed(given.held))
    there, z = another_day(given, 1), []
    true = {p.name: p.nominal for p in there.parameters}
    for seed in range(6):
        data = lc.simulate(given.truth, given.driven, noise=given.noise, seed=seed).dataset
        first = lc.calibrate(nominal, data.take(FIRST), noise=given.noise, method="implicit-loop")
        day = lc.simulate(there, given.driven, noise=given.noise, seed=seed + 100).dataset
        found = lc.update(first, day.take(SECOND))
        z.append((values(found) - [true[n] for n in found.estimated]) / sds(found))
    assert np.std(z) == pytest.approx(1.0, abs=0.2)
    assert np.mean(np.abs(z) < 1.96) > 0.9


def test_a_drift_allowance_gives_the_new_readings_more_weight() -> None:
    arm = planar_arm(60)
    data, noise = arm.read(sds_of(arm), 1), lc.Noise(sds_of(arm))
    first = lc.calibrate(arm.truth, data, noise=noise, method="implicit-loop")
    longer = arm.truth.with_nominal({"l2": arm.values["l2"] + 5e-5})
    day = lc.simulate(
        longer, {q: v for q, v in arm.exact.items() if q in ("phi2", "phi3")}, noise=noise, seed=2
    ).dataset
    held, free = lc.update(first, day), lc.update(first, day, drift={"length": 1e-2})
    # Too little for the check to name l2: without an allowance both days count alike.
    assert 1.5e-5 < held.value["l2"] - first.value["l2"] < 3.5e-5
    assert free.value["l2"] - first.value["l2"] == pytest.approx(5e-5, abs=2e-5)
    assert float(free.sd["l2"] or 0.0) > float(held.sd["l2"] or 0.0)
    with refused("unknown-name", "lenght"):
        lc.update(first, day, drift={"lenght": 1e-3})
    with refused("invalid-value", "length"):
        lc.update(first, day, drift={"length": -1e-3})


@pytest.mark.parametrize("key", ["l3", "angle"])
def test_a_drift_that_no_estimated_parameter_can_follow_is_refused(key: str) -> None:
    """Of a parameter, and of a kind of which every one is held."""
    arm = planar_arm(30)
    noise = lc.Noise(sds_of(arm))
    held = arm.truth.with_parameters(arm.truth.parameters.with_fixed(["l3", "phi30"]))
    first = lc.calibrate(held, arm.read(sds_of(arm), 1), noise=noise, method="implicit-loop")
    day = arm.read(sds_of(arm), 2)
    with refused("no-free-parameter", key):
        lc.update(first, day, drift={key: 1e-3})
    assert lc.update(first, day, drift={"length": 1e-4}).status.converged


def test_an_update_that_says_nothing_new_says_so() -> None:
    arm = planar_arm(600)
    data, noise = arm.read(sds_of(arm), 1), lc.Noise(sds_of(arm))
    first = lc.calibrate(arm.truth, data, noise=noise, method="implicit-loop")

    def notes(day: lc.Dataset) -> list[str]:
        found = lc.update(first, day)
        return [note for note in found.parts.notes if "changed no parameter" in note]

    driven = {q: data.readings[q][:2] for q in ("phi2", "phi3")}
    expected = lc.simulate(first.calibrated, driven, noise=lc.Noise({"*": 0.0}), seed=0).dataset
    assert len(notes(expected)) == 1
    assert not notes(arm.read(sds_of(arm), 2))
    twice = [[n for n in lc.update(first, d).parts.notes if "twice" in n] for d in (data, expected)]
    assert [len(words) for words in twice] == [1, 0]
    held = arm.truth.with_parameters(arm.truth.parameters.with_fixed(["l2", "l3", "phi30"]))
    first = lc.calibrate(held, data, noise=noise, method="implicit-loop")
    assert len(notes(data)) == 1


def test_without_sds_there_is_nothing_to_weigh_the_readings_with() -> None:
    arm = planar_arm(30)
    first = lc.calibrate(arm.truth, arm.read({}, 1), method="least-squares")
    with refused("missing-sd"):
        lc.update(first, arm.read({}, 2))


PROJECT = """
schema = 1
[mechanism]
type = "planar-two-link"
[data]
file = "a.csv"
[noise]
"?P" = { sd = 0.1, unit = "mm" }
"phi?" = { sd = 1, unit = "mrad" }
[fit]
method = "implicit-loop"
[simulation]
poses = 40
[simulation.ranges]
phi2 = { from = -90, to = 90, unit = "deg" }
phi3 = { from = -90, to = 90, unit = "deg" }
"""


def test_the_command_writes_a_result_that_can_be_verified_and_updated(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text(PROJECT)
    for name, seed in (("a", "1"), ("b", "2")):
        made = run(
            "simulate", str(tmp_path / "a.toml"), "--out", str(tmp_path / f"{name}.csv"),
            "--seed", seed,
        )  # fmt: skip
        assert made.returncode == 0, made.stderr
    assert run("calibrate", str(tmp_path / "a.toml"), "--no-report").returncode == 0
    first, day = str(tmp_path / "a-result"), str(tmp_path / "b.csv")
    done = run("update", first, day, "--drift", "length=0.01mm", "--json", "--no-report")
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    before = json.loads((tmp_path / "a-result" / "result.json").read_text())
    sd = {p["name"]: p["sd"] for p in before["parameters"]}
    assert all(p["sd"] < 1.01 * sd[p["name"]] for p in document["parameters"] if p["name"] == "l2")
    again = f"{first}-updated"
    assert run("verify", again, day).returncode == 0
    assert run("update", again, day, "--no-report").returncode == 0
    assert (tmp_path / "a-result-updated-updated" / "mechanism.toml").exists()
    wrong = run("update", first, day, "--drift", "length")
    assert wrong.returncode == 2
    assert "length=0.01mm" in wrong.stderr
    assert run("update", first, day, "--out", first).returncode == 2


@pytest.mark.parametrize("model", [{}, {"model": 1e-3}])
def test_a_machine_that_changed_along_its_run_is_updated_as_after_the_change(
    model: dict[str, float],
) -> None:
    """New readings need no column that dates the change, also where the model has an error."""
    changed = lc.with_effects(line(), [lc.effects.Shift(("b",), at=(20,))])
    rng = np.random.default_rng(3)
    q = rng.uniform(0.0, 1.0, 60)
    number = np.arange(60.0)
    y = 1.1 * q + 0.2 + 0.05 * (number >= 20) + 1e-3 * rng.standard_normal(60)
    noise = lc.Noise({"q": 0.0, "y": 1e-3, "z": 1e-3} | model)
    z = 1.1 * q + 1e-3 * rng.standard_normal(60)
    dated = {"q": q[:40], "y": y[:40], "z": z[:40], "pose": number[:40]}
    first = lc.calibrate(changed, dated, noise=noise, method="implicit-loop")
    found = lc.update(first, {"q": q[40:], "y": y[40:], "z": z[40:]})
    now = found.value["b"] + found.value["b_from20"]
    assert now == pytest.approx(0.25, abs=2e-3)
    before, after = first.sd["b_from20"], found.sd["b_from20"]
    assert before is not None
    assert after is not None
    assert after <= before

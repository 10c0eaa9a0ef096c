"""Predicted end points: their covariance against simulation, and the alarm of extrapolation."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

import loopcal as lc
from tests.reference.simulated import Simulated, ma1400, planar_arm
from tests.refusals import refused

DRAWS = 400


def coverage(simulated: Simulated, sds: dict[str, float], new: dict[str, np.ndarray]) -> float:
    """Share of true end points within the 95 % regions, over all draws and poses."""
    outputs = simulated.truth.outputs
    exact = lc.simulate(simulated.truth, new, noise=lc.Noise({"*": 0.0}), seed=0).quantities
    noise = lc.Noise(sds)
    rng = np.random.default_rng(17)
    inside = []
    for draw in range(DRAWS):
        result = lc.calibrate(
            simulated.truth,
            simulated.read(sds, seed=draw),
            noise=noise,
            start="nominal",
            method="implicit-loop",
        )
        read = {q: v + rng.normal(0, sds[q], len(v)) for q, v in new.items()}
        found = lc.predict(result, read)
        d = np.array([found.outputs[q] - exact[q] for q in outputs]).T
        square = np.einsum("ni,nij,nj->n", d, np.linalg.inv(found.covariance), d)
        inside.append(square < chi2.ppf(0.95, len(outputs)))
    return float(np.mean(inside))


def test_95_percent_regions_cover_in_the_plane() -> None:
    sds = {"xP": 1e-4, "yP": 1e-4, "phi2": 3e-4, "phi3": 1e-4}
    new = lc.random_poses({"phi2": (-3.0, 3.0), "phi3": (-3.0, 3.0)}, 10, seed=3)
    assert 0.93 < coverage(planar_arm(poses=25), sds, new) < 0.97


def test_95_percent_regions_cover_for_six_axes() -> None:
    simulated = ma1400(poses=40)
    sds = {q: 2e-5 if q in simulated.truth.outputs else 5e-5 for q in simulated.exact}
    new = {q: v for q, v in ma1400(poses=10, seed=8).exact.items() if q.startswith("theta")}
    assert 0.93 < coverage(simulated, sds, new) < 0.97


def planar() -> lc.Result:
    sds = {"xP": 1e-4, "yP": 1e-4, "phi2": 3e-4, "phi3": 1e-4}
    simulated = planar_arm(poses=25)
    return lc.calibrate(
        simulated.truth, simulated.read(sds), noise=lc.Noise(sds), method="implicit-loop"
    )


def test_both_parts_against_differences() -> None:
    result = planar()
    read = {"phi2": np.array([0.4]), "phi3": np.array([1.1])}

    def end(values: dict[str, float], at: dict[str, np.ndarray]) -> np.ndarray:
        machine = result.mechanism.with_nominal(values)
        made = lc.simulate(machine, at, noise=lc.Noise({"*": 0.0}), seed=0).quantities
        return np.array([made["xP"][0], made["yP"][0]])

    value, step = dict(result.value), 1e-6
    S_p = np.column_stack(
        [
            (end(value | {n: value[n] + step}, read) - end(value | {n: value[n] - step}, read))
            / (2 * step)
            for n in result.estimated
        ]
    )
    S_x = np.column_stack(
        [
            (end(value, read | {q: read[q] + step}) - end(value, read | {q: read[q] - step}))
            / (2 * step)
            for q in ("phi2", "phi3")
        ]
    )
    found = lc.predict(result, read)
    assert found.from_readings is not None
    assert np.allclose(found.from_parameters[0], S_p @ result.covariance @ S_p.T, rtol=1e-6)
    Sigma = np.diag([3e-4**2, 1e-4**2])
    assert np.allclose(found.from_readings[0], S_x @ Sigma @ S_x.T, rtol=1e-6)
    assert found.sd["xP"][0] == pytest.approx(math.sqrt(found.covariance[0, 0, 0]))
    joint = lc.Noise({("phi2", "phi3"): np.array([[9e-8, 2e-8], [2e-8, 1e-8]])})
    correlated = lc.predict(result, read, noise=joint).from_readings
    Sigma[:] = [[9e-8, 2e-8], [2e-8, 1e-8]]
    assert correlated is not None
    assert np.allclose(correlated[0], S_x @ Sigma @ S_x.T, rtol=1e-6)


def test_readings_of_outputs_do_not_matter_and_gaps_stay_gaps() -> None:
    result = planar()
    plain = lc.predict(result, {"phi2": [0.4, 0.5], "phi3": [1.1, 1.2]})
    more = lc.predict(result, {"xP": [9.0, 9.0], "phi2": [0.4, 0.5], "phi3": [1.1, np.nan]})
    assert more.outputs["xP"][0] == pytest.approx(plain.outputs["xP"][0], rel=1e-12)
    assert np.isnan(more.outputs["xP"][1])
    assert more.words().startswith("1 of 2 poses predicted")


def test_without_sds_of_readings_the_residuals_speak() -> None:
    simulated = planar_arm(poses=25)
    result = lc.calibrate(simulated.truth, simulated.read({"xP": 1e-4}), method="least-squares")
    found = lc.predict(result, {"phi2": [0.4], "phi3": [1.1]})
    after = result.accuracy_after
    assert after is not None
    assert found.from_readings is not None
    variance = after.rms**2 / 2.0 * result.solution.equations / result.freedom
    assert np.allclose(found.from_readings[0], variance * np.eye(2))
    assert "what the fit leaves" in found.words()
    known = lc.predict(result, {"phi2": [0.4], "phi3": [1.1]}, noise=lc.Noise({"phi?": 1e-4}))
    assert known.from_readings is not None
    assert "caused by readings" in known.words()


def test_nothing_to_predict_and_nothing_to_predict_from_are_refused() -> None:
    result = planar()
    with refused("missing-reading", "'phi3'"):
        lc.predict(result, {"phi2": [0.4]})
    rod = lc.Mechanism.from_function(
        lambda x, p: p.a - x.length, {"length": "m"}, {"a": (1.0, "m")}
    )
    measured = lc.calibrate(
        rod, {"length": [1.0, 1.1]}, noise=lc.Noise({"length": 0.1}), method="implicit-loop"
    )
    with refused("no-outputs"):
        lc.predict(measured, {"length": [1.0]})


def test_an_undetermined_direction_is_unknown_only_where_it_moves_the_output() -> None:
    double = lc.Mechanism.from_function(
        lambda x, p: p.gain * x.u + p.base + p.tool * x.w - x.y,
        {"u": "m", "w": "1", "y": "m"},
        {"gain": (1.0, "1"), "base": (0.0, "m"), "tool": (0.1, "m")},
        outputs=("y",),
    )
    u = np.linspace(0, 1, 20)
    noise = lc.Noise({"u": 0.0, "w": 0.0, "y": 1e-3})
    result = lc.calibrate(
        double, {"u": u, "w": np.ones(20), "y": 1.1 * u + 0.3}, noise=noise, method="implicit-loop"
    )
    found = lc.predict(result, {"u": [0.5, 0.5], "w": [1.0, 2.0]})
    assert found.sd["y"][0] < 1e-3
    assert np.isinf(found.sd["y"][1])
    assert found.extrapolated.tolist() == [False, True]
    assert "EXTRAPOLATION  in 1 of 2 poses" in found.words()
    assert found.document()["poses"][1]["sd"]["y"] is None


def test_no_alarm_at_the_calibration_poses_and_one_far_away() -> None:
    arm, noise = lc.planar_two_link(), lc.Noise({"?P": 1e-4, "phi?": 1e-4})
    near = lc.random_poses({"phi2": (0.3, 0.5), "phi3": (0.8, 1.0)}, 60, seed=2)
    made = lc.simulate(arm, near, noise=noise, seed=2)
    result = lc.calibrate(arm, made.dataset, noise=noise, method="implicit-loop")
    assert not lc.predict(result, near).extrapolated.any()
    assert lc.predict(result, {"phi2": [-2.0], "phi3": [2.5]}).extrapolated.all()


Grid = tuple[lc.Mechanism, lc.LoadedData]


@pytest.fixture(scope="module")
def left_grid(request: pytest.FixtureRequest) -> Grid:
    find: Callable[[str], Path] = request.getfixturevalue("shared_data")
    file = find("motoman_ma1400_leica/left_arm_grid.csv")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("LOOPCAL_DATA", str(file.parents[1]))
        example = Path(__file__).resolve().parents[2] / "examples/motoman/left_arm_grid.toml"
        project = lc.read_project(example)
        return project.mechanism, lc.load_dataset(project)


def in_the_box(data: lc.Dataset, seed: int, poses: int = 300) -> dict[str, np.ndarray]:
    """Joint vectors anywhere between the smallest and largest reading of each joint."""
    joints = [q for q in data.quantities if q.startswith("theta")]
    box = {q: (float(data[q].min()), float(data[q].max())) for q in joints}
    return dict(lc.random_poses(box, poses, seed=seed))


@pytest.mark.parametrize("method", ["least-squares", "reweighted", "implicit-loop"])
def test_the_alarm_fires_in_the_joint_box_of_the_left_grid(left_grid: Grid, method: str) -> None:
    mechanism, loaded = left_grid
    data = loaded.dataset
    result = lc.calibrate(mechanism, data, noise=loaded.noise, method=method)
    found = lc.predict(result, in_the_box(data, seed=1))
    assert found.extrapolated.all()
    assert "EXTRAPOLATION  in 300 of 300" in found.words()
    own = lc.predict(result, {q: data[q] for q in data.quantities if q.startswith("theta")})
    assert not own.extrapolated.any()


def halves(grid: Grid, method: str, seed: int, *, flat: bool) -> tuple[float, float, float]:
    """Of fits on random halves, at joint vectors of the box: share of differences within the 95 %
    region of their summed covariance, their median length [m], share that both warned of."""
    mechanism, loaded = grid
    data, rng = loaded.dataset, np.random.default_rng(seed)
    prior = lc.Prior({"*": math.inf}) if flat else None
    order = rng.permutation(len(data))
    new = in_the_box(data, seed)
    found = [
        lc.predict(
            lc.calibrate(
                mechanism,
                data.take(np.sort(half)),
                noise=None if method == "least-squares" else loaded.noise,
                prior=prior,
                method=method,
                max_iterations=1000,
            ),
            new,
        )
        for half in (order[: len(data) // 2], order[len(data) // 2 :])
    ]
    d = np.array([found[0].outputs[q] - found[1].outputs[q] for q in "xyz"]).T
    total = found[0].from_parameters + found[1].from_parameters
    inside = np.einsum("ni,nij,nj->n", d, np.linalg.inv(total), d) < chi2.ppf(0.95, 3)
    warned = found[0].extrapolated & found[1].extrapolated
    length = float(np.median(np.linalg.norm(d, axis=1)))
    return float(inside.mean()), length, float(warned.mean())


def test_half_samples_differ_by_centimetres_and_were_warned_of(left_grid: Grid) -> None:
    # All 300 differences of a split come from the same 27 estimates, so shares vary by split. Over
    # 57 splits it is 88.6 % (median 100 %): a little less than stated, for least squares takes the
    # errors of all poses as independent and alike. See analyses/half_samples.py.
    several = [halves(left_grid, "least-squares", seed, flat=True) for seed in range(6)]
    inside, lengths, warned = np.array(several).T
    assert inside.mean() > 0.8
    assert np.median(inside) > 0.9
    assert (lengths > 0.01).all()
    assert (warned == 1.0).all()


def test_half_samples_with_the_drawing_as_prior_agree_within_their_sds(left_grid: Grid) -> None:
    several = [halves(left_grid, "reweighted", seed, flat=False) for seed in range(4)]
    inside, _, warned = np.array(several).T
    assert (inside > 0.9).all()
    assert (warned == 1.0).all()

"""Observability indices and what the data say, against plain linear algebra and by their laws."""

from __future__ import annotations

import math
from dataclasses import asdict

import numpy as np
import pytest

import loopcal as lc
from loopcal.statistics.identifiability import SAYS_NOTHING
from tests.reference.plain_tape import loop_values
from tests.reference.simulated import planar_arm

LINEAR = lc.Mechanism.from_function(
    lambda x, p: p.a * x.u + p.b * x.v + p.c - x.y,
    {"u": "m", "v": "m", "y": "m"},
    {"a": (1.0, "1"), "b": (0.5, "1"), "c": (0.0, "m")},
    outputs=("y",),
)
SD = 2e-3


def linear(poses: int = 40, seed: int = 3, size: float = 1.0) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    u, v = rng.normal(0.3, 1.0, poses), rng.normal(-0.2, 0.2, poses)
    return {"u": u, "v": v, "y": size * (1.1 * u + 0.4 * v + 0.2) + rng.normal(0, SD, poses)}


NOISE = lc.Noise({"u": 0.0, "v": 0.0, "y": SD})


def test_the_indices_are_those_of_the_singular_values() -> None:
    data = linear()
    J = np.column_stack([data["u"], data["v"], np.ones(40)]) / SD
    s = np.linalg.svd(J / np.linalg.norm(J, axis=0), compute_uv=False)
    found = lc.findings(
        lc.calibrate(LINEAR, data, noise=NOISE, method="implicit-loop")
    ).observability
    assert pytest.approx(np.prod(s) ** (1 / 3) / math.sqrt(40)) == found.O1
    assert pytest.approx(s[-1] / s[0]) == found.O2
    assert pytest.approx(s[-1]) == found.O3
    assert pytest.approx(s[-1] ** 2 / s[0]) == found.O4
    assert pytest.approx(1 / (1 / s).sum()) == found.O5


def test_least_squares_on_a_loop_against_differences_and_svd() -> None:
    simulated = planar_arm(poses=30)
    result = lc.calibrate(simulated.truth, simulated.read(), method="least-squares")
    x = np.array([simulated.exact[q] for q in simulated.truth.tape.quantities])
    p = np.array([simulated.values[n] for n in result.estimated])
    columns = []
    for i in range(len(p)):
        step = np.zeros_like(p)
        step[i] = 1e-6
        ends = [
            loop_values(simulated.truth.tape, x, np.repeat((p + s * step)[:, None], 30, axis=1))
            for s in (1, -1)
        ]
        columns.append(((ends[0] - ends[1]) / 2e-6).ravel())
    J = np.array(columns).T
    s = np.linalg.svd(J / np.linalg.norm(J, axis=0), compute_uv=False)
    found = lc.findings(result)
    assert pytest.approx(s[-1], rel=1e-6) == found.observability.O3
    assert found.identifiability.condition_number == pytest.approx(s[0] / s[-1], rel=1e-6)


def test_neither_units_nor_the_size_of_all_sds_matter() -> None:
    scaled = lc.Mechanism.from_function(
        lambda x, p: 1e3 * (p.a * x.u + 1e-3 * p.b * x.v + p.c - x.y),
        {"u": "m", "v": "m", "y": "m"},
        {"a": (1.0, "1"), "b": (500.0, "1"), "c": (0.0, "m")},
        outputs=("y",),
    )
    one = lc.findings(
        lc.calibrate(LINEAR, linear(), noise=NOISE, method="implicit-loop")
    ).observability
    tenfold = lc.Noise({"u": 0.0, "v": 0.0, "y": 10 * SD})
    other = lc.findings(
        lc.calibrate(scaled, linear(), noise=tenfold, method="implicit-loop")
    ).observability
    assert list(asdict(other).values()) == pytest.approx(list(asdict(one).values()))


def test_repeating_every_pose_changes_only_the_first_index() -> None:
    data = linear()
    twice = lc.Dataset.from_arrays(data).take(np.tile(np.arange(40), 2))
    one, two = (
        lc.findings(lc.calibrate(LINEAR, d, noise=NOISE, method="implicit-loop")).observability
        for d in (data, twice)
    )
    assert pytest.approx(one.O1 / math.sqrt(2)) == two.O1
    others = list(asdict(one).values())[1:]
    assert list(asdict(two).values())[1:] == pytest.approx(others)


def test_a_direction_that_is_not_seen_makes_all_zero_whatever_the_prior() -> None:
    data = {**linear(), "v": np.zeros(40)}
    for prior in (None, lc.Prior({"b": 0.1})):
        found = lc.findings(
            lc.calibrate(LINEAR, data, noise=NOISE, prior=prior, method="implicit-loop")
        )
        assert set(asdict(found.observability).values()) == {0.0}
        assert found.identifiability.condition_number is None


def test_data_beside_the_prior_by_hand() -> None:
    data = {**linear(), "v": np.zeros(40)}
    prior = lc.Prior({"a": 0.1, "b": 0.02, "c": 1.0})
    said = lc.findings(
        lc.calibrate(LINEAR, data, noise=NOISE, prior=prior, method="implicit-loop")
    ).identifiability
    learned = {entry.parameter: entry for entry in said.learned}
    assert learned["b"].ratio == pytest.approx(1.0, rel=1e-12)
    assert learned["b"].words.startswith("the data do not determine 'b': sd 0.0200 of prior 0.0200")
    J = np.column_stack([data["u"], np.ones(40)]) / SD
    C = np.linalg.inv(J.T @ J + np.diag([1e2, 1.0]))
    assert learned["a"].ratio == pytest.approx(math.sqrt(C[0, 0]) / 0.1, rel=1e-9)
    assert learned["c"].ratio < 0.01 < SAYS_NOTHING
    assert said.words()[0] == (
        "these poses do not determine 'b'; only prior knowledge determines it"
    )


def test_redundant_parameters_are_named_with_and_without_a_prior() -> None:
    double = lc.Mechanism.from_function(
        lambda x, p: p.far * x.u + p.base + p.tool - x.y,
        {"u": "m", "y": "m"},
        {"far": (1.0, "1"), "base": (0.0, "m"), "tool": (0.1, "m")},
        outputs=("y",),
    )
    noise = lc.Noise({"u": 0.0, "y": SD})
    flat = lc.findings(
        lc.calibrate(double, linear(), noise=noise, method="implicit-loop")
    ).identifiability.weak
    assert [set(d.combination) for d in flat] == [{"base", "tool"}]
    assert flat[0].words == "'base' and 'tool' cannot be distinguished by these poses"
    held = lc.calibrate(
        double, linear(), noise=noise, prior=lc.Prior({"tool": 1e-3}), method="implicit-loop"
    )
    assert "only prior knowledge" in lc.findings(held).identifiability.weak[0].words


def test_a_nearly_null_direction_says_how_far_one_sd_goes() -> None:
    rng = np.random.default_rng(5)
    u = rng.normal(0, 1, 60)
    data = {"u": u, "v": u + 1e-3 * rng.normal(0, 1, 60), "y": 1.5 * u + rng.normal(0, SD, 60)}
    result = lc.calibrate(LINEAR, data, noise=NOISE, method="implicit-loop")
    (weak,) = lc.findings(result).identifiability.weak
    assert set(weak.combination) == {"a", "b"}
    assert weak.condition is not None
    assert weak.condition > 100
    # Along the weakest direction one sd is nearly all of either parameter's own sd.
    for name in "ab":
        assert abs(weak.one_sd[name]) == pytest.approx(result.sd[name], rel=1e-3)
    assert weak.one_sd["a"] * weak.one_sd["b"] < 0
    assert "'a' and 'b' are weakly distinguished" in weak.words or "'b' and 'a'" in weak.words


def test_least_squares_scales_its_directions_by_its_residuals() -> None:
    rng = np.random.default_rng(5)
    u = rng.normal(0, 1, 60)
    data = {"u": u, "v": u + 1e-3 * rng.normal(0, 1, 60), "y": 1.5 * u + rng.normal(0, SD, 60)}
    result = lc.calibrate(LINEAR, data, method="least-squares")
    (weak,) = lc.findings(result).identifiability.weak
    assert abs(weak.one_sd["a"]) == pytest.approx(result.sd["a"], rel=1e-3)


def test_the_calibration_index_counts_equations() -> None:
    simulated = planar_arm(poses=20)
    readings = {q: np.array(v) for q, v in simulated.read({"xP": 1e-4}).readings.items()}
    readings["yP"][:5] = np.nan
    noise = lc.Noise({"?P": 1e-4, "phi?": 1e-4})
    result = lc.calibrate(simulated.truth, readings, noise=noise, method="implicit-loop")
    index = lc.findings(result).identifiability.index
    assert (index.value, index.sensed, index.mobility) == (35, 75, 40)
    assert index.words() == (
        "calibration index 35 (sensed 75 - mobility 40, over 20 poses) for 6 parameters"
    )

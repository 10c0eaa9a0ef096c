"""Simulated readings are true values plus noise of the stated distribution, and repeatable."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from loopcal.errors import Code, InputError
from loopcal.expressions.engine import engine_for
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.planar import motoman_ma1400, planar_two_link
from loopcal.simulation.poses import grid_poses, random_poses
from loopcal.simulation.simulate import Simulation, simulate
from tests.refusals import refused

BASE = Noise({"xP": 1e-4, "yP": 1e-4, "phi?": 1e-3})
DRAWN_42 = [1.2544943667397455, 0.606289440131906, -1.3401775973994274, -1.0691373317905166]
POSES_42 = [0.9167441575549085, 0.9109866676343232]
GRID = grid_poses({"phi2": np.arange(0, 6, 0.5), "phi3": np.arange(0, 6, 0.5)})


def loops_of(mechanism: Mechanism, made: Simulation) -> np.ndarray:
    engine = engine_for(mechanism.tape, (), len(made.dataset))
    p = np.array(list(made.parameters.values()))
    x = np.array([made.quantities[q] for q in mechanism.tape.quantities])
    known = np.array([made.dataset[c] for c in mechanism.tape.pose_constants])
    return engine.evaluate(p, x, known.reshape(-1, x.shape[1])).f.copy()


def four_bar() -> Mechanism:
    """A four-bar linkage: crank `a` drives coupler `b` and rocker `c`, which no sensor reads."""
    return Mechanism.from_function(
        lambda x, p: (
            p.crank * np.cos(x.a) + p.coupler * np.cos(x.b) - p.rocker * np.cos(x.c) - p.base,
            p.crank * np.sin(x.a) + p.coupler * np.sin(x.b) - p.rocker * np.sin(x.c),
        ),
        {"a": "rad", "b": "rad", "c": "rad"},
        {"crank": (0.1, "m"), "coupler": (0.35, "m"), "rocker": (0.3, "m"), "base": (0.4, "m")},
    )


def test_outputs_follow_from_the_equations_of_the_arm() -> None:
    made = simulate(planar_two_link(), GRID, noise=BASE, seed=1, truth={"l2": 0.81, "phi30": 0.02})
    a, b = GRID["phi2"], GRID["phi2"] + GRID["phi3"] + 0.02
    expected = 0.81 * np.cos(a) + 0.6 * np.cos(b)
    np.testing.assert_allclose(made.quantities["xP"], expected, rtol=0, atol=1e-15)
    assert made.parameters["l2"] == 0.81
    assert made.parameters["l3"] == 0.6


@pytest.mark.parametrize("mechanism", [planar_two_link(), motoman_ma1400()])
def test_true_values_close_every_loop(mechanism: Mechanism) -> None:
    joints = [q for q in mechanism.quantities if q not in mechanism.outputs]
    poses = random_poses(dict.fromkeys(joints, (-2.0, 2.0)), 5000, seed=3)
    made = simulate(mechanism, poses, noise=Noise({"*": 1e-4}), seed=3)
    assert np.abs(loops_of(mechanism, made)).max() < 1e-15


def test_quantities_that_nobody_drives_come_from_the_loops() -> None:
    made = simulate(
        four_bar(),
        {"a": np.linspace(0, 6, 50)},
        noise=Noise({"*": 0.0}),
        seed=0,
        start={"b": 0.5, "c": 1.5},
    )
    assert np.abs(loops_of(four_bar(), made)).max() < 1e-15
    assert np.ptp(made.quantities["c"]) > 0.3


def test_noise_has_the_stated_sds_and_is_independent() -> None:
    poses = random_poses({"phi2": (-3, 3), "phi3": (-3, 3)}, 200_000, seed=5)
    made = simulate(planar_two_link(), poses, noise=BASE, seed=5)
    noise = np.array([made.dataset[q] - made.quantities[q] for q in made.quantities])
    scaled = noise / np.array([[1e-4], [1e-4], [1e-3], [1e-3]])
    np.testing.assert_allclose(np.cov(scaled), np.eye(4), atol=0.012)
    np.testing.assert_allclose(scaled.mean(axis=1), 0.0, atol=0.01)


def test_a_full_covariance_is_drawn_as_stated() -> None:
    poses = random_poses({"phi2": (-3, 3), "phi3": (-3, 3)}, 200_000, seed=6)
    wanted = np.array([[4.0, 1.5], [1.5, 1.0]]) * 1e-8
    entries: dict[str | tuple[str, ...], Any] = {("xP", "yP"): wanted, "phi?": 0.0}
    noise = Noise(entries)
    made = simulate(planar_two_link(), poses, noise=noise, seed=6)
    drawn = np.array([made.dataset[q] - made.quantities[q] for q in ("xP", "yP")])
    np.testing.assert_allclose(np.cov(drawn), wanted, atol=0.02 * 4e-8)


def test_a_covariance_per_pose_is_drawn_pose_by_pose() -> None:
    each = np.array([np.diag([s**2, 0.0]) for s in np.linspace(0, 1e-3, len(GRID["phi2"]))])
    entries: dict[str | tuple[str, ...], Any] = {("xP", "yP"): each, "phi?": 0.0}
    noise = Noise(entries)
    made = simulate(planar_two_link(), GRID, noise=noise, seed=7)
    drawn = made.dataset["xP"] - made.quantities["xP"]
    assert drawn[0] == 0.0
    assert np.abs(drawn[-50:]).mean() > np.abs(drawn[1:50]).mean()
    np.testing.assert_array_equal(made.dataset["yP"], made.quantities["yP"])


def test_sds_per_reading_scale_one_and_the_same_draw() -> None:
    def drawn(sd: object) -> np.ndarray:
        noise = Noise({"xP": sd, "yP": 1e-4, "phi?": 1e-3})
        made = simulate(planar_two_link(), GRID, noise=noise, seed=8)
        return np.asarray(made.dataset["xP"] - made.quantities["xP"])

    each = np.linspace(1e-4, 1e-2, len(GRID["phi2"]))
    np.testing.assert_allclose(drawn(each), drawn(1.0) * each, atol=1e-15)


def test_sd_zero_is_exact_and_sd_inf_is_no_reading() -> None:
    noise = Noise({"xP": 0.0, "yP": 1e-4, "phi2": np.inf, "phi3": 1e-3})
    made = simulate(planar_two_link(), GRID, noise=noise, seed=9)
    np.testing.assert_array_equal(made.dataset["xP"], made.quantities["xP"])
    assert np.isnan(made.dataset["phi2"]).all()
    np.testing.assert_array_equal(made.quantities["phi2"], GRID["phi2"])


def test_sds_that_came_with_the_poses_are_used_and_a_lost_reading_stays_lost() -> None:
    sds = {"xP": [1e-3, np.nan, 0.0], "phi2": [0.0, 0.0, 0.0]}
    poses = Dataset.from_arrays(
        {"xP": [1.0, np.nan, 1.0], "phi2": [0.1, 0.2, 0.3], "phi3": [1.0, 1.1, 1.2]},
        sds=sds,
        poses=["a", "b", "c"],
    )
    made = simulate(planar_two_link(), poses, noise=Noise({"*": 1e-4}), seed=1)
    assert made.dataset.poses == ("a", "b", "c")
    assert np.isnan(made.dataset["xP"]).tolist() == [False, True, False]
    assert made.dataset["xP"][2] == made.quantities["xP"][2]


def test_the_same_seed_gives_the_same_readings_and_another_seed_others() -> None:
    first, again, other = (
        simulate(planar_two_link(), GRID, noise=BASE, seed=s).dataset["phi2"] for s in (1, 1, 2)
    )
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 1e-4


def test_the_draws_of_a_seed_do_not_change_between_versions() -> None:
    made = simulate(
        planar_two_link(), {"phi2": [0.3], "phi3": [1.1]}, noise=Noise({"*": 1.0}), seed=42
    )
    drawn = [float(made.dataset[q][0] - made.quantities[q][0]) for q in made.quantities]
    poses = random_poses({"a": (0.0, 1.0)}, 2, seed=42)["a"]
    np.testing.assert_allclose(drawn, DRAWN_42, rtol=1e-12)
    np.testing.assert_allclose(poses, POSES_42, rtol=1e-12)


def test_known_constants_are_part_of_the_dataset() -> None:
    mechanism = Mechanism.from_function(
        lambda x, p: p.gain * x.load + x.a - x.b,
        {"a": "m", "b": "m"},
        {"gain": (2.0, "1")},
        ("b",),
        pose_constants={"load": "m"},
    )
    made = simulate(
        mechanism, {"a": [1.0, 2.0], "load": [0.5, 0.25]}, noise=Noise({"*": 0.0}), seed=0
    )
    assert made.dataset["b"].tolist() == [2.0, 2.5]
    assert made.dataset["load"].tolist() == [0.5, 0.25]


def test_a_grid_is_every_combination() -> None:
    made = grid_poses({"a": [1, 2], "b": [3, 4, 5]})
    assert list(zip(made["a"].tolist(), made["b"].tolist(), strict=True)) == [
        (1, 3), (1, 4), (1, 5), (2, 3), (2, 4), (2, 5),
    ]  # fmt: skip


def test_random_poses_fill_their_ranges() -> None:
    made = random_poses({"a": (-1.0, 3.0), "b": (2.0, 2.0)}, 10_000, seed=0)
    assert -1.0 <= made["a"].min() < -0.99
    assert 2.99 < made["a"].max() <= 3.0
    assert (made["b"] == 2.0).all()


@pytest.mark.parametrize(
    ("poses", "options", "code", "stated"),
    [
        ({"phi2": [0.0]}, {}, "undetermined-quantities", ("3",)),
        ({"phi2": [0.0], "phi4": [0.0]}, {}, "unknown-name", ("'phi4'",)),
        ({"phi2": [0.0, np.nan], "phi3": [0.0, 0.0]}, {}, "missing-reading", ("'phi2'", "'2'")),
        (GRID, {"truth": {"l9": 1.0}}, "unknown-name", ("'l9'",)),
        (GRID, {"start": {"zz": 1.0}}, "unknown-name", ("'zz'",)),
        (GRID, {"seed": -1}, "invalid-value", ("-1",)),
        (GRID, {"seed": 1.5}, "invalid-value", ("1.5",)),
        (GRID, {"noise": Noise({"xP": 1e-4})}, "missing-sd", ("'yP'",)),
    ],
)
def test_what_cannot_be_simulated_is_said(
    poses: dict, options: dict, code: Code, stated: tuple[str, ...]
) -> None:
    with refused(code, *stated):
        simulate(planar_two_link(), poses, **{"noise": BASE, "seed": 0, **options})


def test_driven_outputs_are_answered_with_what_is_to_be_driven() -> None:
    with pytest.raises(InputError) as error:
        simulate(planar_two_link(), {"xP": [1.0], "yP": [0.5]}, noise=BASE, seed=0)
    assert error.value.remedy is not None
    assert "2 of phi2, phi3" in error.value.remedy
    assert "outputs (xP, yP) are computed, not driven" in error.value.remedy


def test_a_pose_out_of_reach_is_named() -> None:
    with refused("open-loops", "pose '2'"):
        simulate(
            four_bar(),
            {"a": [0.1, 3.0]},
            noise=Noise({"*": 0.0}),
            seed=0,
            truth={"base": 0.7},
            start={"b": 0.5, "c": 2.0},
        )


@pytest.mark.parametrize("ranges", [{"a": (1.0, 0.0)}, {"a": (0.0, np.inf)}])
def test_a_range_that_is_none_is_refused(ranges: dict) -> None:
    with refused("invalid-value", "'a'"):
        random_poses(ranges, 3, seed=0)
    with refused("invalid-value", "0 poses"):
        random_poses({"a": (0.0, 1.0)}, 0, seed=0)


def test_a_gap_that_is_read_as_zero_is_truly_off_by_its_noise() -> None:
    """A ball in a socket has play: what is uncertain is where it stands, not what is read."""
    machine = Mechanism.from_function(
        lambda x, p: (p.length * np.cos(x.q) - p.wall - x.gap,),
        {"q": "rad", "gap": "m"},
        {"length": (1.0, "m"), "wall": (0.6, "m")},
    )
    machine = replace(machine, implied={"gap": 0.0}, home={"q": 0.8})
    data = Dataset.from_arrays({}, poses=[str(i) for i in range(400)])
    made = simulate(machine, data, noise=Noise({"gap": 1e-3, "q": 0.0}), seed=2)
    assert made.dataset["gap"] == pytest.approx(np.zeros(400), abs=1e-18)
    gap = np.cos(made.quantities["q"]) - 0.6
    assert gap == pytest.approx(made.quantities["gap"], abs=1e-12)
    assert gap.std() == pytest.approx(1e-3, rel=0.1)

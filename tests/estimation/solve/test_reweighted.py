"""Reweighted least squares: what it shares with the other methods, and where it differs."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import loopcal as lc
from loopcal.estimation.calibrate import calibrate
from loopcal.estimation.problem import starting

TRUTH = {"xA": 0.012, "yA": -0.008, "l2": 0.8015, "l3": 0.5991, "phi20": 0.004, "phi30": -0.007}


def planar(level: float, seed: int) -> tuple[lc.Dataset, lc.Noise]:
    turns = np.radians(np.arange(-45, 46, 10.0))
    phi2, phi3 = (a.ravel() for a in np.meshgrid(turns, turns + 1.5))
    noise = lc.Noise({"[xy]P": 0.1 * level, "phi2": level, "phi3": 3 * level})
    made = lc.simulate(
        lc.planar_two_link(), {"phi2": phi2, "phi3": phi3}, noise=noise, seed=seed, truth=TRUTH
    )
    return made.dataset, noise


def test_with_exact_joints_and_alike_coordinates_it_is_least_squares() -> None:
    data, _ = planar(1e-3, seed=1)
    alike = lc.Noise({"[xy]P": 1e-3, "phi?": 0.0})
    weighed = calibrate(lc.planar_two_link(), data, noise=alike, method="reweighted")
    plain = calibrate(lc.planar_two_link(), data, method="least-squares")
    for name in weighed.estimated:
        assert weighed.value[name] == pytest.approx(plain.value[name], abs=1e-10)


@pytest.mark.parametrize("level", [1e-5, 1e-4, 1e-3])
def test_at_small_noise_it_is_the_implicit_loop_to_a_fraction_of_an_sd(level: float) -> None:
    data, noise = planar(level, seed=2)
    weighed = calibrate(lc.planar_two_link(), data, noise=noise, method="reweighted")
    likely = calibrate(lc.planar_two_link(), data, noise=noise)
    assert weighed.status.converged
    for name in weighed.estimated:
        sd = likely.sd[name]
        assert sd
        assert weighed.sd[name] == pytest.approx(sd, rel=30 * level)
        assert abs(weighed.value[name] - likely.value[name]) < 50 * level * sd


def test_readings_closed_by_corrections_and_a_chi_squared_near_its_freedom() -> None:
    data, noise = planar(1e-3, seed=3)
    result = calibrate(lc.planar_two_link(), data, noise=noise, method="reweighted")
    assert result.closure_after.max < 1e-14
    assert result.chi_squared is not None
    assert result.chi_squared.variance_factor is not None
    assert abs(result.chi_squared.variance_factor - 1) < 4 * math.sqrt(2 / 194)


def test_a_missing_coordinate_is_projected_out() -> None:
    data, noise = planar(1e-4, seed=4)
    lost = np.array(data["yP"])
    lost[::3] = np.nan
    gappy = data.with_readings({"yP": lost})
    weighed = calibrate(lc.planar_two_link(), gappy, noise=noise, method="reweighted")
    likely = calibrate(lc.planar_two_link(), gappy, noise=noise)
    for name in weighed.estimated:
        assert abs(weighed.value[name] - likely.value[name]) < 0.01 * (likely.sd[name] or 0)


def test_a_prior_takes_part() -> None:
    data, noise = planar(1e-3, seed=5)
    sure = lc.Prior({"l2": 1e-6})
    result = calibrate(lc.planar_two_link(), data, noise=noise, prior=sure, method="reweighted")
    assert abs(result.value["l2"] - 0.8) < 1e-4


def test_flat_priors_on_the_left_arm_grid_leave_the_reflector_where_it_is(
    shared_data: Callable[[str], Path],
) -> None:
    file = shared_data("motoman_ma1400_leica/left_arm_grid.csv")
    columns: dict[str, Any] = {f"theta_{i}": c for i, c in enumerate("SLURBT", 1)}
    columns |= {k: {"column": k, "unit": "m", "sd_column": f"u_{k}"} for k in "xyz"}
    data = lc.read_dataset(file, columns, pose="pose")
    arm = lc.motoman_ma1400({"x6B": 0.05, "y6B": 0.0, "z6B": -0.45}, before={"rz": math.pi / 2})
    result = calibrate(arm, data, noise=lc.Noise({"theta_*": 5e-5}), method="reweighted")
    assert result.status.converged
    assert result.accuracy_after is not None
    assert result.accuracy_after.rms == pytest.approx(78.9e-6, abs=0.5e-6)
    assert abs(result.value["z6B"] + 0.45) < 0.05


def left_arm(
    shared_data: Callable[[str], Path], z: float = -0.45
) -> tuple[lc.Mechanism, lc.Dataset]:
    file = shared_data("motoman_ma1400_leica/left_arm_grid.csv")
    columns: dict[str, Any] = {f"theta_{i}": c for i, c in enumerate("SLURBT", 1)}
    columns |= {k: {"column": k, "unit": "m", "sd_column": f"u_{k}"} for k in "xyz"}
    arm = lc.motoman_ma1400({"x6B": 0.05, "y6B": 0.0, "z6B": z}, before={"rz": math.pi / 2})
    return arm, lc.read_dataset(file, columns, pose="pose")


@pytest.mark.parametrize("seed", range(4))
def test_a_hundred_alike_poses_converge_in_tens_of_iterations(
    shared_data: Callable[[str], Path], seed: int
) -> None:
    arm, data = left_arm(shared_data)
    some = data.take(np.random.default_rng(seed).permutation(len(data))[:100])
    noise = lc.Noise({"theta_*": 5e-5})
    for method in ("reweighted", "implicit-loop", "least-squares"):
        result = calibrate(arm, some, noise=noise, method=method)
        assert result.status.converged
        assert result.status.iterations <= 80


@pytest.mark.parametrize("method", ["implicit-loop", "least-squares"])
def test_a_reflector_half_a_metre_off_is_found_in_tens_of_iterations(
    shared_data: Callable[[str], Path], method: str
) -> None:
    noise = lc.Noise({"theta_*": 5e-5})
    near, data = left_arm(shared_data)
    far, _ = left_arm(shared_data, z=0.05)
    begun, off = (calibrate(arm, data, noise=noise, method=method) for arm in (near, far))
    assert begun.status.iterations <= 40
    assert off.status.iterations <= 60
    for name in begun.estimated:
        assert off.value[name] == pytest.approx(begun.value[name], abs=1e-6)


def test_iterations_and_tolerance_are_the_users() -> None:
    data, noise = planar(1e-2, seed=6)
    machine = lc.planar_two_link()
    fine = calibrate(machine, data, noise=noise, method="reweighted", tolerance=1e-9)
    coarse = calibrate(machine, data, noise=noise, method="reweighted", tolerance=1e-2)
    short = calibrate(machine, data, noise=noise, method="reweighted", max_iterations=1)
    assert fine.status.converged
    assert coarse.status.converged
    assert coarse.status.evaluations < fine.status.evaluations
    assert short.status.reason == "max_iterations"
    for name in fine.estimated:
        assert abs(coarse.value[name] - fine.value[name]) < 0.02 * (fine.sd[name] or 0.0)


def test_where_unread_angles_stand_is_sought_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Later rounds begin where the loops closed: each search costs as much as many rounds."""
    machine = lc.assemble(lc.machines.three_rrr(), [lc.instruments.pose("eye", dimension=2)])
    sds = {"theta_*": 5e-5, "[xy]": 2e-5, "eye_phi": 2e-4, "platform_*": math.inf}
    noise = lc.Noise(sds)
    where = {"platform_x": (-0.05, 0.05), "platform_y": (-0.05, 0.05), "platform_rz": (-0.3, 0.3)}
    poses = lc.random_poses(where, 40, seed=1)
    truth = {"distal_1": 0.201, "proximal_2": 0.199}
    made = lc.simulate(machine, poses, noise=noise, seed=1, truth=truth)
    searches: list[int] = []
    sought = starting._Searched.from_elsewhere

    def counted(self: starting._Searched, *where: Any) -> starting._Searched:
        searches.append(len(self.poses))
        return sought(self, *where)

    monkeypatch.setattr(starting._Searched, "from_elsewhere", counted)
    result = calibrate(machine, made.dataset, noise=noise, method="reweighted")
    assert result.status.converged
    assert len(searches) <= 1
    exact = calibrate(machine, made.dataset, noise=noise, method="implicit-loop")
    for name in exact.estimated:
        assert abs(result.value[name] - exact.value[name]) < 0.1 * (exact.sd[name] or 0.0)

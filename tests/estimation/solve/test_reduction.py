"""The parameter system: both ways of adding up agree, and solve what dense least squares solves."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from loopcal.estimation.calibrate import calibrate
from loopcal.estimation.solve.reduction import (
    LARGE,
    WELL_CONDITIONED,
    Accumulator,
    Spectrum,
    spectrum,
    undetermined,
)
from loopcal.measurements.noise import Noise
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.planar import AXES, DIRECTIONS, NOMINAL
from loopcal.mechanisms.prior import Prior
from loopcal.mechanisms.serial import Joint, serial_arm
from tests.reference.simulated import MA1400_RANGES, Simulated, arm_at, ma1400, planar_arm
from tests.refusals import refused

Array = NDArray[np.float64]
N, R, B = 5, 3, 40
FLAT = np.full(N, np.inf)
WAYS = [False, True]


def system(condition: float = 10.0, seed: int = 1) -> tuple[Array, Array]:
    """Equations D (rows, n) of this condition number, of columns that differ in size, and E."""
    rng = np.random.default_rng(seed)
    U, _, Vt = np.linalg.svd(rng.normal(size=(R * B, N)), full_matrices=False)
    D = (U * np.geomspace(1, 1 / condition, N)) @ Vt
    return D * np.array([1e3, 1.0, 1e-2, 10.0, 1.0]), rng.normal(size=R * B)


def added_up(
    D: Array, E: Array, triangular: bool, blocks: int = 4, units: Sequence[str] = ()
) -> Accumulator:
    accumulator = Accumulator(N, triangular, units)
    for part in np.split(np.arange(len(E)), blocks):
        rows = np.column_stack([D[part], E[part]]).T.reshape(N + 1, R, -1)
        accumulator.add(rows)
    return accumulator


def solved(D: Array, E: Array, triangular: bool, offset: Any = 0.0, sd: Array = FLAT) -> Spectrum:
    return spectrum(added_up(D, E, triangular), np.zeros(N) + offset, sd)


@pytest.mark.parametrize("size", [N, LARGE])
@pytest.mark.parametrize("condition", [1e2, 1e3, 1e5, 1e6, 1e7])
def test_the_inverse_shows_how_normal_equations_are_conditioned(
    condition: float, size: int
) -> None:
    rng = np.random.default_rng(7)
    turns = np.linalg.qr(rng.normal(size=(size, size)))[0]
    D = np.linalg.qr(rng.normal(size=(2 * size, size)))[0] * np.geomspace(1, 1 / condition, size)
    accumulator = Accumulator(size, False)
    rows = np.column_stack([D @ turns, rng.normal(size=2 * size)])
    accumulator.add(np.ascontiguousarray(rows.T[:, None, :]))
    found = spectrum(accumulator, np.zeros(size), np.full(size, np.inf))
    well = found.well_conditioned
    # Neither answer takes the decomposition, which says the same.
    assert "_directions" not in vars(found)
    assert well == (found.condition <= WELL_CONDITIONED)


@pytest.mark.parametrize("triangular", WAYS)
@pytest.mark.parametrize("condition", [1.0, 1e2, 1e4])
def test_the_step_is_that_of_least_squares(condition: float, triangular: bool) -> None:
    D, E = system(condition)
    found = solved(D, E, triangular)
    expected, *_ = np.linalg.lstsq(D, E)
    digits = 1e-15 * condition ** (1 if triangular else 2) * 100
    # in sds: the covariance is the inverse of the normal equations
    sd = np.sqrt(np.diag(np.linalg.inv(D.T @ D)))
    assert np.max(abs(found.step() - expected) / (sd + abs(expected))) <= max(digits, 1e-13)
    assert found.rank == N
    removed = E @ E - np.square(E - D @ expected).sum()
    digits = 1e-9 if triangular else 1e-9 + 1e-16 * condition**2
    assert found.decrement == pytest.approx(removed, rel=digits)
    assert found.predicted() == pytest.approx(removed, rel=digits)


@pytest.mark.parametrize(
    ("condition", "triangular"),
    [(1.0, False), (1e2, False), (1e3, False), (1.0, True), (1e4, True), (1e6, True)],
)
def test_a_determined_step_needs_no_directions_and_is_that_by_them(
    condition: float, triangular: bool
) -> None:
    D, E = system(condition)
    direct, by_directions = solved(D, E, triangular), solved(D, E, triangular)
    step, removed = direct.step(), direct.decrement
    assert direct.rank == by_directions.kept.sum() == N
    assert "_directions" not in vars(direct)
    z = by_directions.components / by_directions.singular_values
    expected = by_directions.scale * (by_directions.directions @ z)
    digits = 1e-14 * condition ** (1 if triangular else 2) + 1e-13
    assert step == pytest.approx(expected, rel=digits, abs=digits * np.abs(expected).max())
    assert removed == pytest.approx(float(np.square(by_directions.components).sum()), rel=digits)


@pytest.mark.parametrize("triangular", WAYS)
def test_only_a_condition_number_above_1e4_counts_as_ill(triangular: bool) -> None:
    for condition in (9e3, 1.2e4):
        D, E = system(condition)
        D /= np.linalg.norm(D, axis=0)
        s = np.linalg.svd(D, compute_uv=False)
        assert solved(D, E, triangular).well_conditioned == bool(s[0] / s[-1] <= 1e4)


def test_a_singular_system_is_not_well_conditioned() -> None:
    D, E = system()
    D[:, 1] = D[:, 0]
    assert not solved(D, E, False).well_conditioned


@pytest.mark.parametrize("condition", [1.0, 1e2, 1e4])
def test_normal_equations_and_triangles_agree(condition: float) -> None:
    D, E = system(condition)
    summed, stacked = solved(D, E, False), solved(D, E, True)
    assert summed.step() == pytest.approx(stacked.step(), rel=1e-15 * condition**2 + 1e-12)
    sd = np.sqrt(np.diag(stacked.covariance()))
    difference = abs(summed.covariance() - stacked.covariance()) / np.outer(sd, sd)
    assert difference.max() <= 1e-14 * condition**2 + 1e-12
    assert summed.condition == pytest.approx(stacked.condition, rel=1e-15 * condition**2 + 1e-12)
    assert added_up(D, E, False).chi_squared == pytest.approx(float(E @ E))
    assert added_up(D, E, True).chi_squared == pytest.approx(float(E @ E))


@pytest.mark.parametrize("triangular", WAYS)
def test_the_condition_number_does_not_see_the_units_of_parameters(triangular: bool) -> None:
    D, E = system(50.0)
    scaled = solved(D * np.array([1e6, 1e-6, 1.0, 1e3, 1e-3]), E, triangular)
    assert scaled.condition == pytest.approx(solved(D, E, triangular).condition, rel=1e-9)


@pytest.mark.parametrize("triangular", WAYS)
def test_a_column_of_rounding_is_no_effect(triangular: bool) -> None:
    """What cancelling terms leave of a column shows beside the columns of the same unit."""
    D, E = system()
    D[:, 1] *= 1e-16
    data = added_up(D, E, triangular, units=("m", "m", "rad", "m", "rad"))
    found = spectrum(data, np.zeros(N), FLAT)
    assert found.rank == N - 1
    assert undetermined(found, "abcde") == ({"b": 1.0},)
    assert abs(found.step()[1]) < 1e-9


@pytest.mark.parametrize("triangular", WAYS)
def test_the_covariance_is_the_inverse_of_the_normal_equations(triangular: bool) -> None:
    D, E = system(1e2)
    covariance = solved(D, E, triangular).covariance()
    expected = np.linalg.inv(D.T @ D)
    assert covariance == pytest.approx(expected, rel=1e-8, abs=1e-10 * abs(expected).min())
    assert np.array_equal(covariance, covariance.T)
    assert np.linalg.eigvalsh(covariance).min() > 0


@pytest.mark.parametrize("triangular", WAYS)
def test_a_prior_is_so_many_rows_more(triangular: bool) -> None:
    D, E = system(1e3)
    sd = np.array([1e-3, np.inf, 10.0, 0.1, np.inf])
    offset = np.array([1e-3, 5.0, -2.0, 0.1, 7.0])  # nominal minus current
    found = solved(D, E, triangular, offset, sd)
    rows = np.diag(1 / sd)[np.isfinite(sd)]
    D_all = np.vstack([D, rows])
    E_all = np.concatenate([E, rows @ np.where(np.isfinite(sd), offset, 0.0)])
    assert found.step() == pytest.approx(np.linalg.lstsq(D_all, E_all)[0], rel=1e-8)
    expected = np.linalg.inv(D_all.T @ D_all)
    assert found.covariance() == pytest.approx(
        expected, rel=1e-7, abs=float(1e-9 * abs(expected).min())
    )


@pytest.mark.parametrize("triangular", WAYS)
def test_how_poses_are_cut_into_blocks_is_nothing(triangular: bool) -> None:
    D, E = system(1e2)
    whole, many = added_up(D, E, triangular, 1), added_up(D, E, triangular, 20)
    joined = added_up(D[: R * B // 2], E[: R * B // 2], triangular, 2)
    joined.add_other(added_up(D[R * B // 2 :], E[R * B // 2 :], triangular, 2))
    for other in (many, joined):
        step = spectrum(other, np.zeros(N), FLAT).step()
        assert step == pytest.approx(spectrum(whole, np.zeros(N), FLAT).step(), rel=1e-9)


@pytest.mark.parametrize("triangular", WAYS)
@pytest.mark.parametrize("damping", [1e-6, 1e-2, 1.0, 1e3])
def test_damping_is_levenbergs_in_scaled_parameters(damping: float, triangular: bool) -> None:
    D, E = system(1e2)
    found = solved(D, E, triangular)
    scale = 1 / np.linalg.norm(D, axis=0)
    A = D * scale
    expected = scale * np.linalg.solve(A.T @ A + damping * np.eye(N), A.T @ E)
    assert found.step(damping) == pytest.approx(expected, rel=1e-8)
    removed = E @ E - np.square(E - D @ expected).sum()
    assert found.predicted(damping) == pytest.approx(removed, rel=1e-6)


@pytest.mark.parametrize("triangular", WAYS)
def test_an_undetermined_direction_is_found_and_does_not_move(triangular: bool) -> None:
    D, E = system(10.0)
    D[:, 3] = 0.2 * D[:, 1] - 3.0 * D[:, 2]
    found = solved(D, E, triangular)
    assert found.rank == N - 1
    assert found.condition > 1e7 or math.isinf(found.condition)
    step = found.step()
    # among all steps that solve the equations it is the shortest in scaled parameters
    scale = 1 / np.linalg.norm(D, axis=0)
    expected = scale * (np.linalg.pinv(D * scale, rcond=1e-9) @ E)
    assert step == pytest.approx(expected, rel=1e-6)
    covariance = found.covariance()
    pseudo = np.outer(scale, scale) * np.linalg.pinv((D * scale).T @ (D * scale), rcond=1e-12)
    assert covariance == pytest.approx(pseudo, rel=1e-5, abs=1e-9)
    (combination,) = undetermined(found, list("abcde"))
    assert set(combination) <= {"b", "c", "d"}
    assert max(abs(share) for share in combination.values()) == pytest.approx(1.0)


@pytest.mark.parametrize("triangular", WAYS)
def test_a_parameter_without_any_effect_is_named_alone(triangular: bool) -> None:
    D, E = system(10.0)
    D[:, 2] = 0.0
    found = solved(D, E, triangular)
    (combination,) = undetermined(found, list("abcde"))
    assert list(combination) == ["c"]
    assert abs(found.step()[2]) <= 1e-15


@pytest.mark.parametrize("triangular", WAYS)
def test_a_prior_determines_what_the_data_do_not(triangular: bool) -> None:
    D, E = system(10.0)
    D[:, 3] = 0.2 * D[:, 1] - 3.0 * D[:, 2]
    sd = np.array([np.inf, np.inf, np.inf, 0.01, np.inf])
    found = solved(D, E, triangular, 0.0, sd)
    assert found.rank == N
    assert undetermined(found, list("abcde")) == ()
    assert math.sqrt(found.covariance()[3, 3]) == pytest.approx(0.01, rel=1e-6)


@pytest.mark.parametrize("triangular", WAYS)
def test_two_directions_name_as_few_parameters_as_can_be(triangular: bool) -> None:
    D, E = system(10.0)
    D[:, 1] = 2.0 * D[:, 0]
    D[:, 4] = -D[:, 3]
    combinations = undetermined(solved(D, E, triangular), list("abcde"))
    assert sorted(sorted(c) for c in combinations) == [["a", "b"], ["d", "e"]]


# the same for whole machines


def redundant_ma1400() -> Mechanism:
    """The MA1400's transitions on a base: six parameters more than a point can tell."""
    joints = [
        Joint(f"theta_{i}", f"transition-{axis}", direction=d)
        for i, (axis, d) in enumerate(zip(AXES, DIRECTIONS, strict=True), 1)
    ]
    tool = {"x6B": 0.05, "y6B": 0.0, "z6B": -0.45}
    return serial_arm(joints, {**NOMINAL, "z1": 0.45, **tool}, base=True)


def six_axis_poses(truth: Mechanism, poses: int = 80) -> Simulated:
    low, high = MA1400_RANGES.T
    return arm_at(truth, np.random.default_rng(3).uniform(low, high, (poses, 6)).T)


SDS = {"theta_*": 1e-4, "xyz": 1e-4}


def read(simulated: Simulated) -> Any:
    sds = dict.fromkeys(simulated.exact, 0.0001)
    return simulated.read(sds, seed=4)


def test_a_base_under_the_seeds_chain_is_reported_not_inverted() -> None:
    simulated = six_axis_poses(redundant_ma1400())
    result = calibrate(simulated.truth, read(simulated), noise=Noise(SDS), start="nominal")
    assert result.status.converged
    found = result.identifiability
    assert (found.parameters, found.rank, found.data_rank) == (33, 27, 27)
    assert found.condition_number is None
    assert len(found.not_identifiable) == 6
    involved = set().union(*(set(u.combination) for u in found.not_identifiable))
    assert {f"base_{key}" for key in ("x", "y", "z", "rz", "ry", "rx")} <= involved
    assert not involved & {"x6B", "y6B", "z6B", "x5", "y5", "z2"}
    (warning,) = [w for w in result.warnings if w.startswith("Not identifiable")]
    assert all(loose.words in warning for loose in found.not_identifiable)
    # the fit itself is as good as with the minimal 27
    minimal = six_axis_poses(ma1400().truth)
    plain = calibrate(minimal.truth, read(minimal), noise=Noise(SDS), start="nominal")
    assert result.chi_squared is not None
    assert plain.chi_squared is not None
    assert result.chi_squared.degrees_of_freedom == plain.chi_squared.degrees_of_freedom


def test_the_28th_parameter_is_named_and_moved_least() -> None:
    machine = redundant_ma1400()
    names = [f"base_{key}" for key in ("x", "y", "rz", "ry", "rx")]
    machine = machine.with_parameters(machine.parameters.with_fixed(names))
    simulated = six_axis_poses(machine)
    start = simulated.truth.with_nominal({"base_z": 0.3, "z1": simulated.values["z1"] - 0.3})
    result = calibrate(start, read(simulated), noise=Noise(SDS), start="nominal")
    assert result.status.converged
    assert result.identifiability.rank == 27
    (loose,) = result.identifiability.not_identifiable
    assert set(loose.combination) == {"base_z", "z1"}
    # lifting the base is lowering the shoulder, so both share with opposite signs
    assert loose.combination["base_z"] == pytest.approx(-loose.combination["z1"], rel=1e-4)
    assert "'base_z' and 'z1' cannot be distinguished" in loose.words
    assert result.sd["base_z"] == result.sd["z1"] == math.inf
    # only their sum is determined; what they differ by stays as it was at the start
    before = start.parameters["base_z"].nominal - start.parameters["z1"].nominal
    assert result.value["base_z"] - result.value["z1"] == pytest.approx(before, abs=1e-9)
    total = result.value["base_z"] + result.value["z1"]
    assert total == pytest.approx(simulated.values["base_z"] + simulated.values["z1"], abs=1e-3)
    assert result.warnings[0].startswith("Not identifiable: 'base_z' and 'z1'")


def test_a_prior_on_one_of_them_determines_both() -> None:
    machine = redundant_ma1400()
    names = [f"base_{key}" for key in ("x", "y", "rz", "ry", "rx")]
    machine = machine.with_parameters(machine.parameters.with_fixed(names))
    simulated = six_axis_poses(machine)
    prior = Prior({"base_z": 1e-3})
    result = calibrate(machine, read(simulated), noise=Noise(SDS), prior=prior, start="nominal")
    assert result.status.converged
    assert result.identifiability.rank == 28
    assert result.identifiability.data_rank == 27
    assert result.identifiability.not_identifiable == ()
    assert result.sd["base_z"] == pytest.approx(1e-3, rel=1e-6)


def parallel_arm(form: str, fixed: list[str]) -> Simulated:
    """Shoulder upright, two parallel axes; what the base or tool already say is fixed."""
    joints = [Joint("q1", "dh"), Joint("q2", form), Joint("q3", "dh")]
    values = {"alpha_1": math.pi / 2, "a_2": 0.6, "a_3": 0.5, "d_1": 0.4, "tool_z": 0.1}
    arm = serial_arm(joints, values)
    hidden = ["base_z", "base_rz", "a_3", "d_3", "alpha_3", "offset_3", *fixed]
    arm = arm.with_parameters(arm.parameters.with_fixed(hidden))
    return arm_at(arm, np.random.default_rng(5).uniform(-2.5, 2.5, (3, 60)))


def test_the_two_offsets_along_parallel_dh_axes_cannot_be_told_apart() -> None:
    simulated = parallel_arm("dh", ["alpha_2"])
    result = calibrate(simulated.truth, read(simulated), noise=Noise({"*": 1e-4}), start="nominal")
    assert result.status.converged
    (loose,) = result.identifiability.not_identifiable
    assert set(loose.combination) == {"d_2", "tool_z"}
    assert result.value["d_2"] + result.value["tool_z"] == pytest.approx(0.1, abs=1e-3)
    # moved least: what they differ by stays as it was
    assert result.value["tool_z"] - result.value["d_2"] == pytest.approx(0.1, abs=1e-9)


def test_hayatis_form_determines_nearly_parallel_axes() -> None:
    simulated = parallel_arm("hayati", [])
    result = calibrate(simulated.truth, read(simulated), noise=Noise({"*": 1e-4}), start="nominal")
    assert result.status.converged
    assert result.identifiability.not_identifiable == ()
    assert result.identifiability.condition_number is not None
    assert result.identifiability.condition_number < 100
    for name in result.estimated:
        sd = result.sd[name]
        assert sd is not None
        assert abs(result.value[name] - simulated.values[name]) <= 5 * sd


def test_too_few_poses_are_told_and_a_prior_makes_them_enough() -> None:
    simulated = planar_arm(2)
    data = simulated.read()
    with refused("too-few-poses", "4 loop", "2 poses", "6"):
        calibrate(simulated.truth, data, noise=Noise({"*": 1e-3}))
    result = calibrate(simulated.truth, data, noise=Noise({"*": 1e-3}), prior=Prior({"*": 0.01}))
    assert result.status.converged
    assert result.identifiability.rank == 6

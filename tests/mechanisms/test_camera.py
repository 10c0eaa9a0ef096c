"""A camera: pixels written out by hand, and images reduced by their own readings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import loopcal as lc
from loopcal.companions.planning.information import end_point_rows, end_point_unit
from loopcal.estimation import prediction
from loopcal.estimation.cameras.at_board import pixel_sizes
from loopcal.estimation.noise.linear_model import fit, linear_model
from loopcal.estimation.problem import patterns
from loopcal.estimation.problem.error_modes import image_modes
from loopcal.estimation.problem.pose_equations import pose_equations
from loopcal.estimation.problem.problem import Problem, build_problem
from loopcal.estimation.solve.sweep import Sweeper
from loopcal.mechanisms.cameras.lens import Intrinsics, project, turning_radius
from loopcal.mechanisms.instruments.camera import before_lens
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.outputs import OutputGroup
from loopcal.statistics.region import _in_view

POINTS = {str(i): (0.04 * (i % 4), 0.04 * (i // 4), 0.0) for i in range(12)}
LENS = Intrinsics("brown5", 900.0, 902.0, 630.0, 470.0, (-0.1, 0.05, 1e-3, -5e-4, 0.01))
FAR = (0.05, -0.4, 1.1, 0.1, -0.2, 3.0)
NEAR = (-0.05, 0.02, 0.1, 0.3, 0.1, -0.2)
SIX = ("x", "y", "z", "rz", "ry", "rx")


def placed(numbers: tuple[float, ...]) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("ZYX", numbers[3:]).as_matrix()
    T[:3, 3] = numbers[:3]
    return T


def hands(count: int, seed: int) -> np.ndarray:
    random = np.random.default_rng(seed)
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3] = Rotation.from_rotvec(random.uniform(-0.4, 0.4, (count, 3))).as_matrix()
    T[:, :3, 3] = random.uniform([-0.1, -0.5, -0.1], [0.1, -0.3, 0.1], (count, 3))
    return T


def pixels(
    T: np.ndarray, *, on: str, points: Mapping[str, Sequence[float]] | None = None
) -> np.ndarray:
    """(points, 2, N), from the definition."""
    far, near = placed(FAR), placed(NEAR)
    X = np.array([(*p, 1.0) for p in (points or POINTS).values()]).T
    if on == "base":  # T_camera_base T_base_flange T_flange_board
        seen = far @ T @ near @ X
    else:  # T_flange_camera^-1 T_base_flange^-1 T_board_base^-1
        seen = np.linalg.inv(near) @ np.linalg.inv(T) @ np.linalg.inv(far) @ X
    uv = np.array(project(LENS.lens, seen.transpose(1, 0, 2)[:3], LENS.values))
    return uv.transpose(2, 0, 1)


def readings(T: np.ndarray, uv: np.ndarray) -> dict[str, np.ndarray]:
    q = Rotation.from_matrix(T[:, :3, :3]).as_quat().T
    table = dict(zip(("x", "y", "z", "qx", "qy", "qz", "qw"), (*T[:, :3, 3].T, *q), strict=True))
    for point, (u, v) in zip(POINTS, uv, strict=True):
        table |= {f"eye:board:{point}:u": u, f"eye:board:{point}:v": v}
    return table


def mechanism(on: str, *, read: bool = True) -> Mechanism:
    eye, board = (FAR, NEAR) if on == "base" else (NEAR, FAR)
    nominal = {f"eye_{n}": v for n, v in zip(SIX, eye, strict=True)}
    nominal |= {f"board_{n}": v for n, v in zip(SIX, board, strict=True)}
    nominal |= {f"eye_{n}": v for n, v in LENS.values.items()}
    look = lc.instruments.camera("eye", points=POINTS, on=on)
    return lc.assemble(lc.machines.free_body(read=read), [look], nominal)


@pytest.mark.parametrize("on", ["base", "body"])
def test_a_board_behind_the_lens_of_a_free_body_is_not_seen(on: str) -> None:
    T = hands(40, 3)
    T[::2, 2, 3] += 3.0
    T[::3, :3, :3] = T[::3, :3, :3] @ Rotation.from_rotvec((0.0, 3.0, 0.0)).as_matrix()
    far, near = placed(FAR), placed(NEAR)
    way = far @ T @ near if on == "base" else np.linalg.inv(far @ T @ near)
    X = np.array([(*p, 1.0) for p in POINTS.values()]).T
    x, y, z = (way @ X)[:, :3].transpose(1, 0, 2)
    most = turning_radius(LENS.lens, LENS.values)
    seen = ((z > 0.0) & (np.hypot(x, y) < most * z)).all(axis=1)
    stated = readings(T, np.zeros((12, 2, 40))) | dict.fromkeys(("wx", "wy", "wz"), np.zeros(40))
    made = mechanism(on)
    assert 5 < seen.sum() < 35
    np.testing.assert_array_equal(before_lens(made, made.families[0], stated, 40), seen)


@pytest.mark.parametrize("on", ["base", "body"])
def test_pixels_are_those_of_the_definition(on: str) -> None:
    T = hands(5, 1)
    # In hand the board stands before the camera that looks away from the flange.
    uv = pixels(T, on=on)
    data = lc.Dataset.from_arrays(readings(T, uv))
    problem = build_problem(mechanism(on), data, lc.Noise({"*": 1e-3}))
    sweeper = Sweeper(problem)
    for pattern, block in sweeper.blocks(problem.start):
        assert np.abs(sweeper.loop_values(pattern, block).f).max() < 1e-8


def problem_of(
    monkeypatch: pytest.MonkeyPatch | None,
    sd: float,
    *,
    missing: bool,
    free: Sequence[str] | None = None,
) -> tuple[Problem, np.ndarray]:
    """A problem of images with noise; by the covariance of each pose where patched."""
    random = np.random.default_rng(3)
    T = hands(8, 2)
    uv = pixels(T, on="base") + random.normal(0.0, 0.3, (len(POINTS), 2, 8))
    if missing:
        gone = random.random((len(POINTS), 1, 8)) < 0.2
        uv[np.broadcast_to(gone, uv.shape)] = np.nan
    if monkeypatch is not None:
        monkeypatch.setattr(patterns, "_predicted_readings", lambda *_: ())
    noise = {"[xyz]": sd, "w?": sd, "eye": 0.3}
    table = readings(T, uv)
    made = mechanism("base", read=not np.isinf(sd))
    if np.isinf(sd):
        table |= {f"{axis}0": table.pop(axis) for axis in "xyz"}
        placing = [f"{owner}_{n}" for owner in ("eye", "board") for n in SIX]
        made = made.with_parameters(made.parameters.with_fixed([*placing, "board_scale"]))
    if free is not None:
        rest = [n for n in made.parameters.names if n not in free]
        made = made.with_parameters(made.parameters.with_fixed(rest))
    problem = build_problem(made, lc.Dataset.from_arrays(table), lc.Noise(noise))
    return problem, np.zeros(problem.readings.shape)


@pytest.mark.parametrize("sd", [1e-3, np.inf])
def test_images_are_reduced_as_any_loops(sd: float, monkeypatch: pytest.MonkeyPatch) -> None:
    images, zero = problem_of(None, sd, missing=False)
    one = Sweeper(images).sweep(images.start, zero, closing=1e-9)
    loops, zero = problem_of(monkeypatch, sd, missing=False)
    other = Sweeper(loops).sweep(loops.start, zero, closing=1e-9)
    assert images.patterns[0].predicted
    assert not loops.patterns[0].predicted
    scale = np.abs(other.data.products).max()
    assert np.abs(one.data.products - other.data.products).max() < 1e-10 * scale
    assert one.proposal == pytest.approx(other.proposal, abs=1e-8)
    assert one.equations == other.equations


@pytest.mark.parametrize("sd", [1e-3, np.inf])
def test_missing_corners_count_nothing(sd: float, monkeypatch: pytest.MonkeyPatch) -> None:
    images, zero = problem_of(None, sd, missing=True)
    one = Sweeper(images).sweep(images.start, zero, closing=1e-9)
    loops, zero = problem_of(monkeypatch, sd, missing=True)
    other = Sweeper(loops).sweep(loops.start, zero, closing=1e-9)
    assert len(images.patterns) == 1 < len(loops.patterns)
    scale = np.abs(other.data.products).max()
    assert np.abs(one.data.products - other.data.products).max() < 1e-10 * scale
    assert one.equations == other.equations


@pytest.mark.parametrize("missing", [False, True])
@pytest.mark.parametrize("sd", [1e-3, np.inf])
def test_the_equations_kept_of_an_image_say_what_all_of_them_say(
    sd: float, missing: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def products(problem: Problem) -> tuple[dict[str, np.ndarray], int]:
        modes, kinds = image_modes(problem), ("EE", "ED", "DD", "EX", "DX", "XX", "MM", "count")
        made: dict[str, dict[int, Any]] = {kind: {} for kind in kinds}
        most = 0
        for block in pose_equations(problem, problem.start, np.zeros(problem.readings.shape)):
            most = max(most, block.E.shape[1])
            for i, n in enumerate(block.poses):
                E, D, X = block.E[i], block.D[i], block.X[i]
                M = X @ modes
                each = (E @ E, E @ D, D.T @ D, E @ X, D.T @ X, block.squares[i], M.T @ M)
                for kind, value in zip(kinds, (*each, block.count[i]), strict=True):
                    made[kind][n] = value
        return {k: np.array([by[n] for n in range(8)]) for k, by in made.items()}, most

    few = ("eye_f", "eye_cx", "board_aspect", "board_warp_x")
    images, rows = products(problem_of(None, sd, missing=missing, free=few)[0])
    loops, all_rows = products(problem_of(monkeypatch, sd, missing=missing, free=few)[0])
    assert rows < all_rows
    for kind, one in images.items():
        assert np.abs(one - loops[kind]).max() <= 1e-9 * np.abs(loops[kind]).max(), kind


@pytest.mark.parametrize("sd", [1e-3, np.inf])
def test_rows_of_corner_noise_alone_change_no_likelihood(sd: float) -> None:
    problem, zero = problem_of(None, sd, missing=True)
    corrections = Sweeper(problem).close(problem.start, zero, 1e-6, 1.0).corrections
    names = problem.mechanism.tape.quantities
    groups = [[i for i, n in enumerate(names) if n.startswith("eye")]]
    if np.isfinite(sd):
        groups += [[names.index(n) for n in "xyz"], [names.index(f"w{n}") for n in "xyz"]]
    every = problem, problem.start, corrections, groups
    short, whole = linear_model(*every), linear_model(*every, compressed=False)
    apart = []
    for k in range(3):
        ratios = np.exp(np.random.default_rng(k).normal(size=len(groups)))
        one, other = fit(short, ratios), fit(whole, ratios)
        assert one is not None
        assert other is not None
        assert one.score == pytest.approx(other.score, rel=1e-8)
        assert one.information == pytest.approx(other.information, rel=1e-8)
        apart.append(one.criterion - other.criterion)
    assert np.ptp(apart) < 1e-6
    assert short.blocks[0].e.shape[1] <= whole.blocks[0].e.shape[1]


def test_a_pixel_at_the_board_is_the_distance_over_the_focal_length() -> None:
    problem, zero = problem_of(None, 1e-3, missing=False)
    (pixel,) = pixel_sizes(problem, problem.start, zero)
    X = np.array([(*p, 1.0) for p in POINTS.values()]).T
    Z = (placed(FAR) @ hands(8, 2) @ placed(NEAR) @ X)[:, 2]
    # The lens bends the image by some per cent, and corners lie up to 30 degrees off the axis.
    assert pixel.size == pytest.approx(np.sqrt(np.square(Z / LENS.fx).mean()), rel=0.1)


def test_a_region_counts_where_the_camera_sees_the_whole_board() -> None:
    names = ("q", "u1", "v1", "u2", "v2")
    group = OutputGroup("eye", None, "px", names[1:], (0, 1, 2, 3), 2)
    seen = np.array([[0.0, 0.0], [100.0, 300.0], [200.0, 400.0], [120.0, 320.0], [210.0, 410.0]])
    predicted = np.array([[200.0, 470.0, 200.0, 200.0], [300.0, 300.0, -500.0, 300.0]] * 2)
    predicted[2, 3] = 1e12  # a corner beside the camera
    assert _in_view(seen, names, group, predicted, 0.5).tolist() == [True, False, False, False]
    beside = predicted[:, :1] + 150.0  # 140 from the middle of u, which corners reach to 110
    assert _in_view(seen, names, group, beside, 0.5).all()
    assert not _in_view(seen, names, group, beside, 0.0).any()
    assert _in_view(seen, names, group, seen[1:], 0.0).all()


def test_a_region_ends_where_no_corner_was_as_far_from_the_middle() -> None:
    """A lens of eight coefficients was sure to 64 mm in the corners of an image, else to 0.2 mm."""
    group = OutputGroup("eye", None, "px", ("u", "v"), (0, 1), 2)
    cross = np.array([[0.0, 100.0, 50.0, 50.0], [50.0, 50.0, 0.0, 100.0]])
    predicted = np.array([[80.0, 95.0, 120.0], [80.0, 95.0, 120.0]])
    assert _in_view(cross, ("u", "v"), group, predicted, 0.0).tolist() == [True, False, False]
    assert _in_view(cross, ("u", "v"), group, predicted, 0.5).tolist() == [True, True, True]


def test_a_camera_that_moves_puts_the_board_as_far_away() -> None:
    problem, zero = problem_of(None, 1e-3, missing=False)
    rows = end_point_rows(problem, problem.start, problem.readings + zero, problem.pose_constants)
    assert end_point_unit(problem.mechanism) == "m"
    for axis in "xyz":
        moved = rows[:, :, problem.names.index(f"eye_{axis}")]
        assert np.linalg.norm(moved, axis=1) == pytest.approx(np.ones(8), abs=1e-9)


def test_pixels_are_predicted_without_closing_loops(monkeypatch: pytest.MonkeyPatch) -> None:
    T = hands(6, 4)
    uv = pixels(T, on="base")
    made = mechanism("base")
    data = lc.Dataset.from_arrays(readings(T, uv))
    problem = build_problem(made, data, lc.Noise({"*": 1e-3}))
    x = problem.readings + 3.0 * np.isin(made.tape.quantities, [*made.outputs]).reshape(
        -1, 1
    )  # where the search begins does not matter
    arguments = (made, problem.start, x, problem.pose_constants)
    direct = prediction.predict_outputs(*arguments)
    monkeypatch.setattr(prediction, "pixel_loops", lambda *_: None)
    np.testing.assert_allclose(direct, prediction.predict_outputs(*arguments), atol=1e-9)
    np.testing.assert_allclose(direct, uv.reshape(-1, 6), atol=1e-9)

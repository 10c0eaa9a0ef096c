"""Each mistake in the files is named, corrected where that leaves no doubt, and nothing else is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from loopcal.estimation.cameras.corners import Corners
from loopcal.estimation.cameras.images import explained
from loopcal.estimation.cameras.mistakes import MIRRORED
from loopcal.estimation.cameras.orders import on_other_squares
from loopcal.estimation.cameras.placing import Reading
from loopcal.estimation.cameras.scene import Adjusted, Scene
from loopcal.estimation.cameras.start import start
from loopcal.mechanisms.cameras.board import Board
from loopcal.mechanisms.cameras.lens import Intrinsics
from loopcal.workflow.beginning.later_images import _refuse_another_format
from tests.estimation.cameras.truth import COLUMNS, ROWS, SIZE, grid_board, motion, pixel, shots
from tests.refusals import refused

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


def transposed(T: Array) -> Array:
    T = T.copy()
    T[:, :3, :3] = T[:, :3, :3].transpose(0, 2, 1)
    return T


def scalar_first(T: Array) -> Array:
    """Quaternions written w, x, y, z and read x, y, z, w."""
    T = T.copy()
    q = Rotation.from_matrix(T[:, :3, :3]).as_quat()
    T[:, :3, :3] = Rotation.from_quat(q[:, [3, 0, 1, 2]]).as_matrix()
    return T


def millimetres(T: Array) -> Array:
    T = T.copy()
    T[:, :3, 3] *= 1000.0
    return T


HANDS: dict[str, Callable[[Array], Array]] = {
    "poses-inverted": lambda T: np.asarray(np.linalg.inv(T)),
    "rotations-transposed": transposed,
    "quaternion-order": scalar_first,
    "unit-of-poses": millimetres,
    "poses-shifted": lambda T: np.roll(T, 1, axis=0),
}


def numbered(corners: Corners, label: Callable[[Indices], Indices]) -> Corners:
    """The corners labelled anew; labels below 0 were not detected."""
    point = label(corners.point)
    inside = (point >= 0) & (point < COLUMNS * ROWS)
    corners = corners.where(inside).numbered(point[inside])
    index = [corners.image, corners.camera, corners.board, corners.point]
    return Corners.of(index, corners.uv, corners.cameras, corners.boards, corners.poses)


def alternate(point: Indices) -> Indices:
    x, y = point % COLUMNS, point // COLUMNS
    x = x + np.where(y % 2 == 0, 1, -1)
    return np.where((x >= 0) & (x < COLUMNS), x + COLUMNS * y, -1)


LABELS: dict[str, Callable[[Indices], Indices]] = {
    "begin at 1": lambda k: k + 1,
    "along columns": lambda k: (k % COLUMNS) * ROWS + k // COLUMNS,
    "legacy": alternate,
}


@pytest.mark.parametrize("code", HANDS)
def test_poses_read_in_another_way(code: str) -> None:
    true = shots(23)
    begun = true.start(T=HANDS[code](true.T))
    assert [fact.code for fact in begun.facts if fact.applied] == [code]
    np.testing.assert_allclose(begun.X[0], true.X, atol=4e-3)


def test_the_order_of_quaternions_is_that_of_the_columns() -> None:
    true = shots(23)
    (fact,) = (f for f in true.start(T=scalar_first(true.T)).facts if f.applied)
    assert "w, x, y, z" in fact.sentence


@pytest.mark.parametrize("words", LABELS)
def test_points_numbered_in_another_way(words: str) -> None:
    true = shots(29)
    begun = true.start(corners=numbered(true.corners, LABELS[words]))
    (fact,) = (fact for fact in begun.facts if fact.applied)
    assert fact.code == "board-numbering"
    assert words in fact.sentence
    np.testing.assert_allclose(begun.X[0], true.X, atol=4e-3)


@pytest.mark.parametrize("seed", range(8))
def test_few_corners_are_numbered_as_they_are(seed: int) -> None:
    """Of three columns that are displaced by one, two of three rows fit a plane always."""
    true = shots(seed, images=14)
    few = np.array([_of_nine(int(k)) for k in true.corners.point])
    points = {k: p for k, p in grid_board().points.items() if _of_nine(int(k))}
    label = {int(k): i for i, k in enumerate(points)}
    corners = true.corners.where(few)
    corners = corners.numbered(np.array([label[int(k)] for k in corners.point]))
    board = Board("board", {str(i): p for i, p in enumerate(points.values())})
    begun = true.start(corners=replace(corners, boards=(board,)))
    assert [fact.code for fact in begun.facts if fact.applied] == []


def _of_nine(k: int) -> bool:
    return k % COLUMNS < 3 and k // COLUMNS < 3


def test_board_in_millimetres() -> None:
    true = shots(31)
    points = {k: (1e3 * x, 1e3 * y, z) for k, (x, y, z) in true.corners.boards[0].points.items()}
    corners = replace(true.corners, boards=(Board("board", points),))
    begun = true.start(corners=corners)
    assert [fact.code for fact in begun.facts if fact.applied] == ["unit-of-board"]
    np.testing.assert_allclose(begun.X[0], true.X, atol=4e-3)


def test_u_and_v_exchanged() -> None:
    true = shots(37)
    begun = true.start(corners=true.corners.at(true.corners.uv[:, ::-1].copy()))
    assert [fact.code for fact in begun.facts if fact.applied] == ["uv-exchanged"]
    np.testing.assert_allclose(begun.X[0], true.X, atol=4e-3)


def test_v_that_counts_upwards() -> None:
    true = shots(60200)
    uv = true.corners.uv.copy()
    uv[:, 1] = SIZE[1] - 1.0 - uv[:, 1]
    begun = true.start(stated=False, corners=true.corners.at(uv))
    assert [fact.code for fact in begun.facts if fact.applied] == ["v-reversed"]
    np.testing.assert_allclose(begun.X[0], true.X, atol=4e-2)


def test_a_mirror_of_images_of_any_size_is_left_open() -> None:
    """Where neither lens nor size is stated, exchanged u and v explain it as well."""
    true = shots(60201, images=16)
    uv = true.corners.uv.copy()
    uv[:, 1] = SIZE[1] - 1.0 - uv[:, 1]
    for pixels, code in ((uv, MIRRORED), (true.corners.uv[:, ::-1].copy(), "uv-exchanged")):
        begun = start(true.corners.at(pixels), true.T)
        assert [fact.code for fact in begun.facts if fact.applied][:1] == [code]


def test_v_that_counts_upwards_on_a_later_day_is_refused_as_that() -> None:
    """Of images without a size it is u and v exchanged, and a lens on its side."""
    true = shots(60203, images=16)
    uv = true.corners.uv.copy()
    uv[:, 1] = SIZE[1] - 1.0 - uv[:, 1]
    lens = replace(true.intrinsics["cam"], image=None)
    begun = start(true.corners.at(uv), true.T, {"cam": lens}, {}, true.held)
    with refused("conflicting-keys", "mirror", "v = height - 1 - v"):
        _refuse_another_format(begun.facts)


@pytest.mark.parametrize("wrong", [0, 1])
def test_u_and_v_of_one_camera_exchanged(wrong: int) -> None:
    true = shots(38, images=14)
    one, X = true.corners, motion(np.array([0.0, 0.02, 0.3]), np.array([0.02, 0.0, 0.0])) @ true.X
    lens = true.intrinsics["cam"]
    uv = []
    for T in true.T:
        P = X @ T @ true.Y
        seen = one.boards[0].xyz @ P[:3, :3].T + P[:3, 3]
        uv.append(pixel(seen, true.f, np.array([lens.cx, lens.cy])))
    both = np.array([one.uv, np.concatenate(uv)])
    both[wrong] = both[wrong][:, ::-1].copy()
    camera = np.repeat([0, 1], len(one))
    index = [np.tile(one.image, 2), camera, np.tile(one.board, 2), np.tile(one.point, 2)]
    corners = Corners.of(index, np.concatenate(both), ("cam", "two"), one.boards, one.poses)
    begun = start(corners, true.T, {"cam": lens, "two": lens}, {}, True)
    (fact,) = (fact for fact in begun.facts if fact.applied)
    assert (fact.code, corners.cameras[wrong] in fact.sentence) == ("uv-exchanged", True)
    np.testing.assert_allclose(begun.X, [true.X, X], atol=5e-3)


def test_intrinsics_of_an_image_on_its_side() -> None:
    true = shots(41)
    lens = true.intrinsics["cam"]
    # Turned clockwise: u' = H - 1 - v, v' = u.
    turned = Intrinsics("brown5", lens.fy, lens.fx, SIZE[1] - 1.0 - lens.cy, lens.cx)
    begun = true.start(intrinsics={"cam": turned})
    assert [fact.code for fact in begun.facts if fact.applied] == ["intrinsics-turned"]
    assert begun.intrinsics_stated["cam"].cx == pytest.approx(lens.cx, abs=60.0)


@pytest.mark.parametrize(("width", "words"), [(0.5, "by 2."), (1.5, "by 0.6667.")])
def test_intrinsics_of_images_of_another_size(width: float, words: str) -> None:
    true = shots(41)
    f, cx, cy = (width * v for v in (true.f, *(0.5 * np.array(SIZE))))
    lens = Intrinsics("brown5", f, f, cx, cy)
    (fact,) = (f for f in true.start(intrinsics={"cam": lens}).facts if f.applied)
    assert fact.code == "intrinsics-of-another-size"
    assert words in fact.sentence


@pytest.mark.parametrize("by_P", [False, True])
def test_rectified_images_beside_the_distortion_of_raw_ones(by_P: bool) -> None:
    true = shots(41)
    lens = true.intrinsics["cam"]
    f, cx, cy = (0.85 * lens.fx, lens.cx - 20.0, lens.cy + 9.0) if by_P else lens_of(lens)
    P = Scene((lens,), true.X[None], true.Y[None], A=true.T).in_camera(true.corners)
    seen = f * P[:, :2] / P[:, 2:] + [cx, cy]
    seen += np.random.default_rng(41).normal(0.0, 0.2, seen.shape)
    bent = (-0.3, 0.1, 0.0, 0.0, 0.0)
    stated = Intrinsics("brown5", lens.fx, lens.fx, lens.cx, lens.cy, bent, None, (f, f, cx, cy))
    begun = true.start(corners=true.corners.at(seen), intrinsics={"cam": stated})
    (fact,) = (fact for fact in begun.facts if fact.applied)
    assert fact.code == "images-rectified"
    assert ("by the stated P" in fact.sentence) == by_P
    assert begun.intrinsics_stated["cam"].fx == f
    assert not any(begun.intrinsics_stated["cam"].distortion)


def lens_of(lens: Intrinsics) -> tuple[float, float, float]:
    return lens.fx, lens.cx, lens.cy


def test_images_that_were_cut() -> None:
    true = shots(41)
    lens = true.intrinsics["cam"]
    whole = replace(lens, cx=lens.cx + 300.0, cy=lens.cy + 250.0, image=(SIZE[0] + 500, SIZE[1]))
    begun = true.start(intrinsics={"cam": whole})
    assert [fact.code for fact in begun.facts if fact.applied] == ["principal-point"]
    now = begun.intrinsics_stated["cam"]
    assert (now.cx, now.cy) == pytest.approx((lens.cx, lens.cy), abs=20.0)
    assert now.image is None


def test_an_image_is_off_where_it_is_in_pixels_and_in_lengths() -> None:
    """An error of the hand's place is larger in pixels where the board is near."""
    true = shots(5, images=12)
    lenses = (true.intrinsics["cam"],)
    scene = Scene(lenses, true.X[None], true.Y[None], A=true.T)
    views = true.corners.views
    z = views.medians(np.linalg.norm(scene.in_camera(true.corners), axis=1))
    near = int(np.argmin(z))
    reading = Reading(true.corners, true.T, lenses)

    def named(px: float) -> list[str]:
        r = np.where(views.of_corner == near, px, 1.0)[:, None] * [1.0, 0.0]
        return [one.code for one in explained(reading, Adjusted(scene, r, {})).facts]

    middle = np.median(z) / z[near]
    assert middle > 1.1
    assert named(4.9 * middle) == []
    assert named(5.1 * middle) == ["image-unexplained"]


def test_one_image_in_another_order() -> None:
    true = shots(43)
    point = true.corners.point.copy()
    one = true.corners.image == 3
    point[one] = COLUMNS * ROWS - 1 - point[one]
    begun = true.start(corners=true.corners.numbered(point))
    (fact,) = (fact for fact in begun.facts if fact.applied)
    assert (fact.code, fact.images) == ("points-in-another-order", ("image 3",))
    assert begun.rms < 0.35


def test_an_order_whose_pose_errs_as_others_do_is_named() -> None:
    """No image is off by less than five medians: such an order is that of the points."""
    true = shots(43, images=12)
    point = true.corners.point.copy()
    one = true.corners.image == 3
    point[one] = COLUMNS * ROWS - 1 - point[one]
    lenses = (true.intrinsics["cam"],)
    scene = Scene(lenses, true.X[None], true.Y[None], A=true.T)
    corners = true.corners.numbered(point)
    views = corners.views

    def named(px: float) -> list[str]:
        """With an image in another order, whose pose is off by so many medians."""
        typical = float(np.median(views.medians(np.linalg.norm(scene.residuals(corners), axis=1))))
        uv = corners.uv + np.where(corners.image == 3, px * typical, 0.0)[:, None] * [1.0, 0.0]
        moved = corners.at(uv)
        found = Adjusted(scene, scene.residuals(moved), {})
        return [fact.code for fact in explained(Reading(moved, true.T, lenses), found).facts]

    assert named(4.0) == ["points-in-another-order"]
    assert named(6.0) == ["image-unexplained"]


def test_two_poses_exchanged() -> None:
    true = shots(47)
    T = true.T.copy()
    T[[5, 9]] = T[[9, 5]]
    begun = true.start(T=T)
    named = {fact.images: fact.values["pose"] for fact in begun.facts if fact.applied}
    assert named == {("image 5",): "image 9", ("image 9",): "image 5"}
    assert begun.rms < 0.35


def test_pitch_of_the_print() -> None:
    true = shots(53)
    points = {k: (x / 1.01, y / 1.01, z) for k, (x, y, z) in true.corners.boards[0].points.items()}
    begun = true.start(corners=replace(true.corners, boards=(Board("board", points),)))
    (fact,) = (fact for fact in begun.facts if fact.code == "board-pitch")
    assert not fact.applied
    assert fact.values["pitch"] == pytest.approx(1.01, abs=1e-3)


def test_half_a_pixel() -> None:
    true = shots(59, images=30, noise=0.03)
    lens = true.intrinsics["cam"]
    moved = replace(lens, cx=lens.cx + 0.5, cy=lens.cy + 0.5)
    begun = true.start(intrinsics={"cam": moved})
    (fact,) = begun.facts
    assert fact.code == "pixel-centre"
    assert fact.values["u_px"] == pytest.approx(-0.5, abs=0.1)


def test_intrinsics_of_two_cameras_exchanged() -> None:
    true = shots(59)
    lens = true.intrinsics["cam"]
    beside = replace(lens, fx=1.04 * lens.fx, fy=1.04 * lens.fy, cx=lens.cx + 40.0)
    n = len(true.corners)
    uv = true.corners.uv.copy()
    second = (uv - (lens.cx, lens.cy)) * 1.04 + (beside.cx, beside.cy)
    doubled = [np.concatenate([ids, ids]) for ids in (true.corners.image, true.corners.point)]
    camera = np.repeat([0, 1], n)
    corners = Corners.of(
        [doubled[0], camera, np.zeros(2 * n, dtype=int), doubled[1]],
        np.concatenate([uv, second]),
        ("left", "right"),
        true.corners.boards,
        true.corners.poses,
    )
    begun = start(corners, true.T, {"left": beside, "right": lens}, {}, True)
    assert [fact.code for fact in begun.facts if fact.applied] == ["cameras-exchanged"]
    assert begun.intrinsics_stated["right"].cx == beside.cx


@pytest.mark.parametrize("columns", [5, 6])
def test_markers_of_a_legacy_pattern(columns: int) -> None:
    def squares(first: int) -> Board:
        free = [(r, c) for r in range(4) for c in range(columns) if (r + c) % 2 == first]
        corners = [(0.006, 0.006), (0.024, 0.006), (0.024, 0.024), (0.006, 0.024)]
        points = {
            f"{k}_{j}": (0.03 * c + x, -0.03 * r - y, 0.0)
            for k, (r, c) in enumerate(free)
            for j, (x, y) in enumerate(corners)
        }
        return Board("board", points)

    legacy = on_other_squares(squares(1))
    assert legacy is not None
    np.testing.assert_allclose(legacy.xyz, squares(0).xyz, atol=1e-12)
    assert on_other_squares(grid_board()) is None


def test_a_board_counted_in_a_mirror_is_named() -> None:
    true = shots(61)
    points = {k: (-x, y, z) for k, (x, y, z) in true.corners.boards[0].points.items()}
    mirror = replace(true.corners, boards=(Board("board", points),))
    codes = [
        {fact.code for fact in true.start(corners=one).facts} & {"board-from-behind"}
        for one in (true.corners, mirror)
    ]
    assert len(codes[0]) + len(codes[1]) == 1

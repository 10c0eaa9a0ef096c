"""Cameras, boards and lenses from corners and poses alone: the start of a calibration.

Guess lenses where none are stated, correct the mistakes that leave no doubt, place everything in
closed form, adjust it by a soft loss with the robot held, and name what the images cannot tell.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.errors import InputError
from loopcal.estimation.cameras.board_pose import BoardPoses, facing
from loopcal.estimation.cameras.corners import Corners, Views
from loopcal.estimation.cameras.facts import Fact
from loopcal.estimation.cameras.homography import focal_length, homographies, spread
from loopcal.estimation.cameras.images import explained
from loopcal.estimation.cameras.lens_choice import EVERY, FINEST, WRONG, Trial, clearly_better
from loopcal.estimation.cameras.mistakes import CLEAR, corrected, image_misfit, mounted_misfit
from loopcal.estimation.cameras.motions import most_alike, motion_facts
from loopcal.estimation.cameras.placing import Reading, placed, usable_part, view_poses
from loopcal.estimation.cameras.scale import scale_facts
from loopcal.estimation.cameras.scene import (
    REDESCENDING,
    Adjusted,
    Scene,
    adjusted,
    groups,
)
from loopcal.mechanisms.cameras.lens import Intrinsics

PER_VIEW = 24
"""Corners per view that the adjustment of a start takes."""
TRIAL = 100, 100
"""Images, and corners per view, by which lenses are compared."""
FITS = 3.0
"""A guessed lens is taken without trying another if the robot adds no more than this factor."""
_WIDE = 1.2
"""What corners span over the focal length, from which a lens may be a fisheye: 62 degrees."""
FREE = ("f", "cx", "cy", "k1", "k2")
"""What a start adjusts of a lens of the family brown; a fisheye has the same names."""
USUAL = "brown5"
"""The lens that is taken where images do not ask for another."""
_WORDS = {
    "brown8": "bent by eight coefficients",
    "brown12": "bent by twelve coefficients",
    "fisheye": "a fisheye",
}


@dataclass(frozen=True)
class CameraStart:
    """Where everything stands, and what was found out about the files.

    corners, T_base_flange: as corrected; the arrays per corner and view follow these corners.
    on_flange: cameras that the flange carries; boards of the others are on it, or nowhere without a
    robot. X, Y: (cameras, 4, 4) and (boards, 4, 4) of C_i = X A_i Y (`hand_eye`), A_i inverse for
    cameras on the flange. T_camera_board: (V, 4, 4) of each view
    in the order of `corners.views`; branches: (V, 2, 4, 4) both poses that the view alone allows,
    chosen: (V,) which of them is nearer. residuals: (N, 2) [px].
    """

    corners: Corners
    T_base_flange: Array | None
    on_flange: frozenset[str]
    intrinsics: Mapping[str, Intrinsics]
    intrinsics_stated: Mapping[str, Intrinsics]
    X: Array
    Y: Array
    T_camera_board: Array
    branches: Array
    chosen: NDArray[np.intp]
    residuals: Array
    facts: tuple[Fact, ...]

    @property
    def held(self) -> bool | None:
        """Whether boards are on the flange, and no camera; None without a robot."""
        return None if self.T_base_flange is None else not self.on_flange

    @property
    def rms(self) -> float:
        """Rms [px] of the residuals' lengths over all corners, wrong ones included."""
        return float(np.sqrt(np.mean(np.sum(self.residuals**2, axis=1))))


def start(
    corners: Corners,
    T_base_flange: Array | None,
    intrinsics: Mapping[str, Intrinsics] | None = None,
    image_sizes: Mapping[str, tuple[int, int]] | None = None,
    held: bool | None = None,
    *,
    lens: str = "brown5",
    free: Sequence[str] = FREE,
) -> CameraStart:
    """Start a calibration of cameras from nothing.

    T_base_flange: (n, 4, 4) [m], a row per `corners.poses`, rows with NaN are left out; None
    without a robot. intrinsics: as stated, by camera; image_sizes: width and height [px]; held:
    the board is on the flange (True), the camera is (False), or unknown (None). lens: of cameras
    without stated intrinsics; free: what is adjusted of lenses, where they have it.

    Raises InputError where no view shows four corners of a board.
    """
    corners = _with_poses(corners, T_base_flange)
    stated, sizes = dict(intrinsics or {}), dict(image_sizes or {})
    best: tuple[Reading, list[Fact], Adjusted] | None = None
    complete = all(camera in stated for camera in corners.cameras)
    for lenses in _lens_choices(corners, stated, sizes, lens):
        first = Reading(corners, T_base_flange, lenses, held is not False, complete)
        reading, facts = corrected(first, held)
        rough = _rough(reading, free)
        if rough is None or (best is not None and rough.core > CLEAR * best[2].core):
            continue
        best = reading, facts, rough
        if rough.core < FITS * image_misfit(reading):
            break
    if best is None:
        raise InputError(
            "no image shows four corners of a board",
            code="not-identifiable",
            remedy="state more corners, or check image, board and point of each",
        )
    reading, facts, rough = best
    reading, result = _adjusted(reading, rough, free)
    after = explained(reading, result)
    if any(fact.applied for fact in after.facts):
        again = _rough(after.reading, free)
        assert again is not None
        reading, result = _adjusted(after.reading, again, free)
    facts += after.facts
    facts += _behind(reading, result)
    facts += motion_facts(reading, result.scene, stated=reading.stated)
    facts += scale_facts(reading, result, FREE)
    return _start_of(reading, result, facts)


def started(
    corners: Corners,
    T_base_flange: Array | None,
    intrinsics: Mapping[str, Intrinsics],
    image_sizes: Mapping[str, tuple[int, int]],
    held: bool | None = None,
) -> CameraStart:
    """`start`; a lens that no file states is the one that fits clearly better than others."""
    begun = start(corners, T_base_flange, intrinsics, image_sizes, held)
    unstated = [camera for camera in corners.cameras if camera not in intrinsics]
    if not unstated:
        return begun
    seen = {c: corners.uv[corners.camera == i] for i, c in enumerate(corners.cameras)}
    reach = [float(np.ptp(seen[c], axis=0).max()) / begun.intrinsics[c].fx for c in unstated]
    usual = _trial(begun)
    tried = {USUAL: usual}
    if usual.rms < FINEST:
        return begun
    if max(reach) > _WIDE:
        try:
            wide = start(corners, None, intrinsics, image_sizes, lens="fisheye", free=EVERY)
            tried["fisheye"] = _trial(wide)
        except InputError:
            pass
    tried |= {each: usual.with_lens(each, unstated) for each in ("brown8", "brown12")}
    lens = USUAL
    for other in tried:
        if clearly_better(tried[other], tried[lens]):
            lens = other
    if lens == USUAL:
        return begun
    bent = start(corners, T_base_flange, intrinsics, image_sizes, held, lens=lens, free=EVERY)
    words = (
        f"No file states the lens. It is taken as {_WORDS[lens]}, which leaves "
        f"{tried[lens].rms:.2f} px at corners of boards that stand anywhere, the usual lens "
        f"{usual.rms:.2f} px."
    )
    return replace(bent, facts=(Fact(f"lens-{lens}", words, applied=True), *bent.facts))


def _trial(begun: CameraStart) -> Trial:
    """Some images with the usual lens, boards with free poses."""
    views, X = begun.corners.views, begun.X @ np.linalg.inv(begun.X[0])
    boards = np.linalg.inv(X[views.camera]) @ begun.T_camera_board
    begins = dict(zip(_images(views), boards, strict=True))
    lenses = tuple(begun.intrinsics.values())
    corners = Reading(begun.corners, None, lenses).thinned(*TRIAL).corners
    F = np.array([begins[one] for one in sorted({*_images(corners.views)})])
    return Trial.of(corners, Scene(lenses, X, np.eye(4)[None], F=F))


def _images(views: Views) -> list[tuple[int, int]]:
    """Image and board of each view, by which free poses are ordered."""
    return list(zip(views.image.tolist(), views.board.tolist(), strict=True))


def _behind(reading: Reading, result: Adjusted) -> list[Fact]:
    """Flat boards whose z axis points away from the cameras in all images."""
    views = reading.corners.views
    away = facing(result.scene.of_views(views)) < 0.0
    sentence = (
        "The z axis of the board {!r} points away from the camera, into the print: its points "
        "count rows downwards, as OpenCV does, or are a mirror image. Only the frame of the board "
        "depends on it."
    )
    return [
        Fact("board-from-behind", sentence.format(board.name))
        for b, board in enumerate(reading.corners.boards)
        if board.planar and (mine := views.board == b).any() and away[mine].all()
    ]


def way_of_turning(
    ways: Mapping[str, Array],
    corners: Corners,
    intrinsics: Mapping[str, Intrinsics],
    image_sizes: Mapping[str, tuple[int, int]],
) -> str:
    """Which of several poses of the flange (n, 4, 4) by name turn as the board does; of those that
    turn alike the one by which the images fit."""
    complete = all(camera in intrinsics for camera in corners.cameras)
    lenses = _lens_choices(corners, intrinsics, image_sizes, "brown5")[0]
    reading = Reading(corners, None, lenses, stated=complete)
    alike = most_alike(ways, reading)
    if len(alike) == 1:
        return alike[0]
    return min(alike, key=lambda way: mounted_misfit(replace(reading, T_base_flange=ways[way])))


def with_stated_lenses(begun: CameraStart) -> CameraStart:
    """The same placed anew with the lenses as stated, which are held."""
    lenses = tuple(begun.intrinsics_stated[camera] for camera in begun.corners.cameras)
    held = not begun.on_flange
    reading = Reading(begun.corners, begun.T_base_flange, lenses, held, True)
    poses = view_poses(reading)
    if reading.A is None:
        reading, poses = usable_part(reading, poses)
    result = placed(reading, poses, ())
    return begun if result is None else _start_of(reading, result, begun.facts)


def _with_poses(corners: Corners, T: Array | None) -> Corners:
    if T is None:
        return corners
    complete = np.asarray(np.isfinite(T.reshape(len(T), 16)).all(axis=1))
    return corners.where(complete[corners.image])


def _lens_choices(
    corners: Corners,
    stated: Mapping[str, Intrinsics],
    sizes: Mapping[str, tuple[int, int]],
    lens: str,
) -> list[tuple[Intrinsics, ...]]:
    """Lenses of all cameras: as stated, or the two best guesses."""
    choices: list[list[Intrinsics]] = []
    for c, camera in enumerate(corners.cameras):
        size = sizes.get(camera)
        if camera in stated:
            one = stated[camera]
            choices.append([replace(one, image=one.image or size)])
        else:
            choices.append(guessed(corners, c, size, lens)[:2])
    count = max(len(each) for each in choices)
    return [tuple(each[min(i, len(each) - 1)] for each in choices) for i in range(count)]


def _rough(reading: Reading, free: Sequence[str]) -> Adjusted | None:
    """A part of the images and corners, with lenses adjusted."""
    few = reading.thinned(100, 24)
    return placed(few, view_poses(few), _of_all(reading, free))


def _adjusted(reading: Reading, rough: Adjusted, free: Sequence[str]) -> tuple[Reading, Adjusted]:
    """All images, from the placement of a part of them; corners beyond 24 per view add little.

    An image gives about six numbers, those of a pose, however many corners it has. Without a robot
    the reading is left with the views that have a pose through the lenses of that placement.
    """
    free, few = _of_all(reading, free), reading.thinned(len(reading.corners.poses), PER_VIEW)
    if reading.A is not None:
        scene = replace(rough.scene, A=reading.A)
        result = adjusted(few.corners, scene, free, iterations=10)
    else:
        adapted, rig = replace(few, lenses=rough.scene.intrinsics), rough.scene.X
        poses = view_poses(adapted)
        seen = poses.usable[reading.corners.views.of_corner]
        reading = replace(reading, corners=reading.corners.where(seen))
        few, poses = usable_part(adapted, poses)
        placement = placed(few, poses, free, iterations=8, rig=rig)
        assert placement is not None
        result = placement
    result = adjusted(few.corners, result.scene, free, loss=REDESCENDING)
    if (anew := _posed_anew(few, result)) is not None:
        result = adjusted(few.corners, anew, free, loss=REDESCENDING)
    return reading, Adjusted(result.scene, result.scene.residuals(reading.corners), result.sds)


def _posed_anew(reading: Reading, result: Adjusted) -> Scene | None:
    """With the poses of boards whose images do not fit as their corners say, each for itself, where
    that fits better: the adjustment gave them up on its way. None without any."""
    corners, scene = reading.corners, result.scene
    if scene.F is None:
        return None
    views, of = corners.views, corners.views.of_corner
    d = np.hypot(*result.residuals.T)
    count = np.bincount(of)
    left = np.sqrt(np.bincount(of, d**2) / count)
    poses = view_poses(replace(reading, lenses=scene.intrinsics))
    F, group = scene.F.copy(), groups(views)
    far = poses.usable & (left > WRONG * np.median(left))
    for view in np.flatnonzero(far):
        for T in poses.T_camera_board[view]:
            tried = F.copy()
            tried[group[view]] = np.linalg.inv(scene.X[views.camera[view]]) @ T
            r = replace(scene, F=tried).residuals(corners)[of == view]
            if (rms := float(np.sqrt(np.square(r).sum() / count[view]))) < left[view]:
                F, left[view] = tried, rms
    return None if np.array_equal(F, scene.F) else replace(scene, F=F)


def _of_all(reading: Reading, free: Sequence[str]) -> Sequence[str]:
    """What all of the lenses have of these."""
    return tuple(name for name in free if all(name in lens.values for lens in reading.lenses))


def _start_of(reading: Reading, result: Adjusted, facts: Sequence[Fact]) -> CameraStart:
    corners, scene = reading.corners, result.scene
    T = scene.of_views(corners.views)
    few = replace(reading, lenses=scene.intrinsics).thinned(len(corners.poses), PER_VIEW)
    poses: BoardPoses = view_poses(few)
    near = np.linalg.norm((poses.T_camera_board - T[:, None])[:, :, :3, :3], axis=(2, 3))
    return CameraStart(
        corners,
        reading.T_base_flange,
        frozenset(() if reading.T_base_flange is None or reading.held else corners.cameras),
        dict(zip(corners.cameras, scene.intrinsics, strict=True)),
        dict(zip(corners.cameras, reading.lenses, strict=True)),
        scene.X,
        scene.Y,
        T,
        poses.T_camera_board,
        np.argmin(near, axis=1),
        result.residuals,
        tuple(facts),
    )


# A lens without stated intrinsics: its focal length, from tilted boards or fields of view.


FIELDS = (60.0, 35.0, 90.0, 20.0)
"""Horizontal fields of view [deg] to try: the adjustment converges from a factor of two in f."""
WIDE = (100.0, 140.0, 180.0)
"""The same for a fisheye."""


def guessed(
    corners: Corners, camera: int, size: tuple[int, int] | None, lens: str = "brown5"
) -> list[Intrinsics]:
    """Lenses to start from, the most plausible first: square pixels, no distortion.

    From homographies where three boards are tilted and the lens is no fisheye, then by fields of
    view. Of two that adjust alike the first stands.
    """
    mine = corners.seen(camera=camera)
    mine = replace(mine, camera=np.zeros_like(mine.camera), cameras=(corners.cameras[camera],))
    centre, width = frame(mine, size)
    lenses = [
        Intrinsics(lens, f, f, float(centre[0]), float(centre[1]), (), size)
        for f in _focal_lengths(mine, centre, width, lens)
    ]
    return sorted(lenses, key=lambda one: _misfit(mine, one))


def frame(corners: Corners, size: tuple[int, int] | None) -> tuple[Array, float]:
    """Middle (2,) and width [px] of an image; without its size, of what the corners cover."""
    if size is not None:
        return (np.array(size, dtype=float) - 1.0) / 2.0, float(size[0])
    low, high = corners.uv.min(axis=0), corners.uv.max(axis=0)
    return (low + high) / 2.0, float(max(high - low))


def _focal_lengths(corners: Corners, centre: Array, width: float, lens: str) -> Iterator[float]:
    if lens == "fisheye":
        yield from (width / np.radians(field) for field in WIDE)
        return
    flat = np.array([board.planar for board in corners.boards])[corners.board]
    if flat.any():
        some = Reading(corners.where(flat), None, ()).thinned(60, 40).corners
        xy, views = some.xyz[:, :2], some.views
        H, _ = homographies(views, xy, some.uv)
        f = focal_length(H[spread(views, xy)], centre)
        if f is not None and 0.2 * width < f < 20.0 * width:
            yield f
    yield from (0.5 * width / np.tan(np.radians(field / 2.0)) for field in FIELDS)


def _misfit(corners: Corners, lens: Intrinsics) -> float:
    """Core rms [px] with a free pose per image after f and k1 were adjusted."""
    reading = Reading(corners, None, (lens,)).thinned(20, 12)
    adjusted = placed(reading, view_poses(reading), ("f", "k1"), iterations=6)
    return np.inf if adjusted is None else core_of(adjusted)


def core_of(adjusted: Adjusted) -> float:
    """Core rms in steps of 2 %: lenses that differ by less are equally good."""
    return float(np.round(np.log(max(adjusted.core, 1e-6)) / 0.02))

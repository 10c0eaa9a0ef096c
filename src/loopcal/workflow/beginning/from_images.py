"""A project from corners that cameras saw: boards, poses and lenses found by themselves."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from loopcal.arrays import Array
from loopcal.errors import InputError, listed
from loopcal.estimation.cameras.corners import Corners
from loopcal.estimation.cameras.images import GROSS, copied_images
from loopcal.estimation.cameras.mistakes import MIRRORED
from loopcal.estimation.cameras.parts import in_parts
from loopcal.estimation.cameras.start import (
    CameraStart,
    started,
    way_of_turning,
    with_stated_lenses,
)
from loopcal.estimation.faults.repairs import set_apart
from loopcal.files.cameras.corner_table import CornerTable
from loopcal.files.cameras.folder import Files, read_files
from loopcal.mechanisms.cameras.board import Board
from loopcal.mechanisms.cameras.lens import Intrinsics
from loopcal.presentation.shown import significant
from loopcal.workflow.beginning.begun import READINGS, Begun
from loopcal.workflow.beginning.images_hand import Describe, Hand, hand_of, states_flange, unread
from loopcal.workflow.beginning.images_project import CORNERS, UNEXPLAINED, WRONG, ImagesProject
from loopcal.workflow.beginning.misfits import LeftOut
from loopcal.workflow.beginning.searching import CLEARLY, NOTHING, PLAUSIBLE
from loopcal.workflow.beginning.still_cameras import without_still

USUAL_LENS = "brown5"
_FEWEST = 3
"""Images that have a pose at least: fewer calibrate nothing."""
# Chosen, not derived: degrees are 57 times radians, and poses differ by a few times.
_MUCH_LARGER = 15.0
"""Joints that are so many times as large as others may be in another unit."""
CENTRAL = 0.45
"""A principal point is no nearer to the edge than this share of how far corners reach. Chosen:
half would be the middle of an image that corners fill."""


@dataclass(frozen=True, eq=False)
class FromImages:
    """What was begun from images, and its parts, of which corners may be left out."""

    begun: Begun
    project: ImagesProject

    @property
    def doubtful(self) -> tuple[str, ...]:
        """Images that copy others, or are grossly off in any order and beside any pose."""
        facts = [f for f in self.project.begun.facts if f.code == UNEXPLAINED]
        gross = (f for f in facts if float(f.values.get("times", np.inf)) > GROSS)
        return tuple(p for f in gross for p in f.images)

    @property
    def share(self) -> float:
        """What is left (`shares_of`) of the camera of which most is; 0 without a robot."""
        return max(shares_of(self.project.begun).values(), default=0.0)

    def clear_of(self, out: LeftOut) -> Begun:
        """What was begun without what is left out, and without doubts of images that fit."""
        project = self.project
        gone = {
            fact.sentence
            for fact in project.begun.facts
            if fact.code == UNEXPLAINED and out.explained.issuperset(fact.images)
        }
        remarks = tuple(one for one in self.begun.remarks if one not in gone)
        if not out.words:
            return _made(project, remarks) if gone else self.begun
        wrong = project.marked(out.readings)
        begun = project.begun
        corners = begun.corners
        kept = replace(begun, corners=corners.where(~wrong), residuals=begun.residuals[~wrong])
        left = project.begun_at(kept)
        rest = replace(begun, corners=corners.where(wrong), residuals=begun.residuals[wrong])
        aside = project.begun_at(rest)
        made = _made(left, (*remarks, out.words))
        return replace(made, beside={**made.beside, WRONG: aside.corners()})


def shares_of(begun: CameraStart) -> dict[str, float]:
    """Of each camera, what poses of the robot leave of how far points move between images; empty
    without a robot."""
    if begun.T_base_flange is None:
        return {}
    c = begun.corners
    of_point = np.unique([c.camera, c.board, c.point], axis=1, return_inverse=True)[1].ravel()
    count = np.bincount(of_point)
    away = [x - (np.bincount(of_point, x) / count)[of_point] for x in c.uv.T]
    left, moved = np.hypot(*begun.residuals.T), np.hypot(*away)
    several = count[of_point] > 1  # a point that is seen once does not move
    return {
        name: float(np.median(left[mine])) / max(float(np.median(moved[mine])), 1e-9)
        for k, name in enumerate(c.cameras)
        if (mine := several & (c.camera == k)).any()
    }


def from_images(
    entries: Sequence[Any],
    describe: Describe | None,
    joints: str | None,
    folder: Path,
    *,
    named: bool,
) -> FromImages:
    """`init` of a folder or files that hold corners.

    describe: the robot by the columns of its joints, None where nothing describes one; joints:
    these columns, as in `init`; folder: where the project will lie; named: whether the user names
    the robot: one whose file lies beside the others gives way to stated poses of the flange.
    Raises InputError where something remains open.
    """
    files = read_files(entries)
    if describe is not None and not named and (not files.poses or states_flange(files)):
        made = _by_joints(entries, describe, joints, folder) if files.poses else None
        if made is not None:
            return made
        describe = None
    files, still = without_still(files)
    hand = hand_of(files.poses, describe, joints, folder)
    if hand.unturned and not _explained(files, hand):
        hand = hand_of(files.poses, describe, joints, folder, unturned=False)
    project, turned = understood(files, hand)
    remarks = (
        *files.remarks,
        *still,
        *project.hand.remarks,
        *project.left_out,
        *turned,
        # The poses of joints are those of a drawing, which scatter does not show to be wrong.
        *(f.sentence for f in project.begun.facts if describe is None or f.code != "board-pitch"),
    )
    return FromImages(_made(project, remarks), project)


def _explained(files: Files, hand: Hand) -> bool:
    """Whether the images are those of this hand."""
    try:
        project, _ = understood(files, hand)
    except InputError:
        return False
    return FromImages(_made(project, ()), project).share < PLAUSIBLE


def _by_joints(
    entries: Sequence[Any], describe: Describe, joints: str | None, folder: Path
) -> FromImages | None:
    """The same by joints that stand beside poses of the flange, where they explain the images."""
    try:
        made = from_images(entries, describe, joints, folder, named=True)
    except InputError:
        return None
    words = "a file describes the robot: joints are used, not the poses of the flange beside them"
    remarks = (*made.begun.remarks, words)
    return (
        replace(made, begun=replace(made.begun, remarks=remarks))
        if (made.share < PLAUSIBLE)
        else None
    )


def on_another_link(
    made: FromImages, tips: Sequence[str], on: Callable[[str], FromImages]
) -> FromImages:
    """The same with what moves on another link, the first of these tips that fits clearly better.

    Raises InputError where poses of the robot explain nothing of what the images show.
    """
    best = made
    for tip in tips:
        best = min(best, on(tip), key=lambda one: one.share)
        if best.share < PLAUSIBLE:
            break
    if CLEARLY * best.share < made.share:
        first, last = (one.project.hand.table["tip"] for one in (made, best))
        rms, more = (significant(one.project.begun.rms, 2) for one in (best, made))
        words = (
            f"what moves is taken to be on {last!r}: the images are {rms} px off, and {more} px "
            f"with it on {first!r}"
        )
        remarks = (*best.begun.remarks, words)
        return replace(best, begun=replace(best.begun, remarks=remarks))
    refuse_unexplained(made.project)
    return made


def refuse_unexplained(project: ImagesProject) -> None:
    """Raise InputError where poses of the robot explain nothing of what the images show, with the
    cause where the files show one."""
    begun, read = project.begun, project.hand.readings
    shares = shares_of(begun)
    worst = max(shares, key=shares.__getitem__, default="")
    if not shares.get(worst, 0.0) > NOTHING:
        return
    of = f" of the camera {worst!r}" if len(shares) > 1 else ""
    causes = [
        "check that each row is the pose of the flange, the order of the rows, that all images "
        "have one size, and that camera and board stayed in place; if the rows are joints, name "
        "the robot: --urdf or --dh"
        if "x" in read
        else "check the joints, their units and signs, the order of the rows, that all images have "
        "one size, that camera and board stayed in place, and which link carries the camera or the "
        "board (--tip LINK)"
    ]
    poses = begun.corners.poses
    if repeated := [poses[i] for i in copied_images(begun.corners)]:
        causes = [f"take these images again, or leave them out: {listed(repeated, 5)}"]
        of += f", and {len(repeated)} repeat the corners of another image to the last digit"
    sizes = np.linalg.norm([*read.values()], axis=0)
    for small, large in set_apart(sizes) if "x" not in read else ():
        if np.median(sizes[large]) < _MUCH_LARGER * np.median(sizes[small]):
            continue
        rows = large if large.sum() <= small.sum() else small
        names = [pose for pose, one in zip(project.hand.poses, rows, strict=True) if one]
        causes.append(
            f"and whether the joints of {len(names)} rows ({listed(names, 5)}), which are much "
            f"{'larger' if rows is large else 'smaller'} than the others, are in another unit"
        )
        break
    raise InputError(
        f"the poses of the robot do not explain the images{of}: corners are "
        f"{significant(begun.rms, 2)} px off",
        code="mismatched-poses",
        remedy=", ".join(causes),
    )


def _made(project: ImagesProject, remarks: tuple[str, ...]) -> Begun:
    begun = project.begun
    words = (
        f"{len(project.kept)} images with {len(begun.corners)} corners; the calibration begins at "
        f"{begun.rms:.2f} px rms"
    )
    beside = {READINGS: project.readings(), CORNERS: project.corners()}
    return Begun(project.tables, beside, remarks, project.dataset, words)


def understood(
    files: Files, hand: Hand, held: Mapping[str, bool] | None = None
) -> tuple[ImagesProject, tuple[str, ...]]:
    """A project of the files, and what was changed of the stated lenses; held: by camera, whether
    the board that it sees is on the flange, None where the images are to show it."""
    boards = [named(files.boards, name) for name in files.corners.boards]
    table, renamed = matched(files.corners, boards, hand.poses, counted=hand.counted)
    corners = _corners(table, boards, hand.poses)
    stated, sizes = by_camera(files.lenses, table.cameras), dict(table.sizes)
    lenses, turned = _upright(stated, table)
    if hand.ways:
        hand = hand.turned(way_of_turning(hand.ways, corners, lenses, sizes))

    def begin(lenses: Mapping[str, Intrinsics]) -> CameraStart:
        def run(corners: Corners, T_base_flange: Array | None) -> CameraStart:
            cameras = corners.cameras
            mount = None if held is None else held[cameras[0]]
            some = {camera: lenses[camera] for camera in cameras if camera in lenses}
            begun = started(corners, T_base_flange, some, sizes, mount)
            # What was stated is nominal: what the images add to it is for the calibration to say.
            return with_stated_lenses(begun) if len(some) == len(cameras) else begun

        return in_parts(corners, hand.T_base_flange, run)

    begun = begin(lenses)
    if any(fact.code == MIRRORED for fact in begun.facts):
        raise InputError(
            "corners fit as in a mirror only: v counts upwards from the bottom of the image, or u "
            "and v are exchanged, and no file states the lens or the size of the images",
            code="conflicting-keys",
            place=table.file,
            remedy="write the pixels of OpenCV: u to the right, v downwards from the top "
            "(v = height - 1 - v). Or state the lens with the size of the images",
        )
    if turned and any(fact.code == "u-reversed" for fact in begun.facts):
        # An image on its side that is a mirror besides is one whose u and v are exchanged.
        lenses, turned = stated, ()
        begun = begin(lenses)
    if hand.T_base_flange is None:
        hand = unread(begun, hand)
    elif begun.T_base_flange is not None:
        hand = hand.corrected(begun.T_base_flange)
    return ImagesProject(begun, hand, table, lenses, title=files.title), (*renamed, *turned)


def named(boards: Mapping[str, Board], name: str) -> Board:
    if name in boards:
        return boards[name]
    if len(boards) == 1:
        return replace(next(iter(boards.values())), name=name)
    raise InputError(
        f"the corners are of the board {name!r}, which no file describes",
        code="unknown-name",
        remedy=f"name it as one of {listed(list(boards), 10)}",
    )


def by_camera(lenses: Mapping[str, Intrinsics], cameras: Sequence[str]) -> dict[str, Intrinsics]:
    """The stated lenses under the names of the corners' cameras; a pinhole may be bent."""
    lenses = {
        name: replace(lens, lens=USUAL_LENS, distortion=()) if lens.lens == "pinhole" else lens
        for name, lens in lenses.items()
    }
    if set(cameras) <= set(lenses):
        return {name: lenses[name] for name in cameras}
    if len(lenses) == len(cameras):  # in their order, where names differ
        return dict(zip(cameras, lenses.values(), strict=True))
    return {name: lenses[name] for name in cameras if name in lenses}


def _upright(
    lenses: Mapping[str, Intrinsics], table: CornerTable
) -> tuple[dict[str, Intrinsics], tuple[str, ...]]:
    """The lenses, those turned back whose principal point is that of an image on its side."""
    upright, remarks = dict(lenses), []
    for name, lens in lenses.items():
        seen = [i for i, camera in enumerate(table.camera) if camera == name]
        most_u, most_v = float(table.u[seen].max()), float(table.v[seen].max())

        def inside(cx: float, cy: float, u: float = most_u, v: float = most_v) -> bool:
            return cx >= CENTRAL * u and cy >= CENTRAL * v

        if inside(lens.cx, lens.cy) or not inside(lens.cy, lens.cx):
            continue
        values = lens.values | dict.fromkeys(("p1", "p2"), 0.0)
        values |= {"f": lens.fy, "aspect": lens.fx / lens.fy - 1.0, "cx": lens.cy, "cy": lens.cx}
        values = {key: values[key] for key in lens.values}
        upright[name] = Intrinsics.of(lens.lens, values, lens.image and lens.image[::-1])
        remarks.append(
            f"the stated principal point ({lens.cx:.0f}, {lens.cy:.0f}) px of camera {name!r} is "
            f"that of an image on its side, since corners reach ({most_u:.0f}, {most_v:.0f}) px: "
            f"({lens.cy:.0f}, {lens.cx:.0f}) px is used"
        )
    return upright, tuple(remarks)


def _corners(table: CornerTable, boards: Sequence[Board], poses: tuple[str, ...]) -> Corners:
    """The corners of poses that are there, by indices. Raises InputError for unknown points."""
    poses = poses or tuple(dict.fromkeys(table.image))
    where = {pose: i for i, pose in enumerate(poses)}
    rows = [i for i, image in enumerate(table.image) if image in where]
    named = {table.image[i] for i in rows}
    if len(named) < min(_FEWEST, len(table.images)):
        few = f"only {len(named)} of {len(table.images)} images have the names of poses"
        raise InputError(
            few if named else "no image has the name of a pose",
            code="mismatched-poses",
            remedy=f"name images as poses: {listed(list(poses), 3)}; the images are "
            f"{listed(list(table.images), 3)}",
        )
    some = table.at(rows)
    camera = {name: i for i, name in enumerate(table.cameras)}
    board = {name: i for i, name in enumerate(table.boards)}
    points = [{p: i for i, p in enumerate(b.points)} for b in boards]
    index: list[list[int]] = [[], [], [], []]
    for image, cam, name, point in zip(
        some.image, some.camera, some.board, some.point, strict=True
    ):
        b = board[name]
        if point not in points[b]:
            raise InputError(
                f"the board {name!r} has no point {point!r}",
                code="unknown-name",
                place=table.file,
                remedy=f"its points are {listed(list(points[b]), 12)}",
            )
        for ids, i in zip(index, (where[image], camera[cam], b, points[b][point]), strict=True):
            ids.append(i)
    uv = np.stack([some.u, some.v], axis=1)
    return Corners.of([np.array(ids) for ids in index], uv, table.cameras, boards, poses)


# Names of images and points in a table of corners, matched to those of poses and boards.


def matched(
    table: CornerTable, boards: Sequence[Board], poses: Sequence[str], *, counted: bool = False
) -> tuple[CornerTable, tuple[str, ...]]:
    """The corners under the names of poses and points, and what was changed, in words.

    boards: in the order of `table.boards`; counted: whether poses have no names, and are counted
    from 1. Names stay where nothing or not everything matches.
    """
    remarks = []
    by, how = _by_time(table.images, poses), "poses nearest in time"
    if not by and counted:
        by, how = _by_row(table.images, poses), "poses in the order of their rows"
    elif not by and poses and {*poses}.isdisjoint(table.image):
        by, how = _by_number(table.images, poses), "poses of the same number"
    if by:
        first = next(iter(by.items()))
        remarks.append(f"images belong to the {how}: {first[0]!r} to {first[1]!r}")
        table = replace(table, image=tuple(by.get(name, name) for name in table.image))
    points = list(table.point)
    for name, board in zip(table.boards, boards, strict=True):
        mine = [i for i, of in enumerate(table.board) if of == name]
        step = _step({points[i] for i in mine}, board.points)
        if step:
            begins = "1, those of the board at 0" if step > 0 else "0, those of the board at 1"
            remarks.append(f"numbers of corners of {name!r} begin at {begins}: matched so")
        for i in mine if step else ():
            points[i] = str(int(points[i]) - step)
        if begin := _first_of_tags({points[i] for i in mine}, board.points):
            names = ["", *board.points][1 - int(begin) :]
            remarks.append(f"corners of {name!r} are numbered tag by tag from {begin}: matched so")
            for i in mine:
                points[i] = names[int(points[i])]
    return replace(table, point=tuple(points)), tuple(remarks)


def _by_number(images: Sequence[str], poses: Sequence[str]) -> Mapping[str, str]:
    """Image -> pose with the same last number; empty where numbers are missing or repeated."""
    by = [{_last_number(name): name for name in names} for names in (images, poses)]
    if any(None in one for one in by) or [len(one) for one in by] != [len(images), len(poses)]:
        return {}
    return {by[0][n]: by[1][n] for n in by[0] if n in by[1]}


def _by_time(images: Sequence[str], poses: Sequence[str]) -> Mapping[str, str]:
    """Image -> the pose nearest in time, of names that are times in s, ms, us or ns; empty where
    one is farther from all poses than these follow each other, or names are alike."""
    try:
        t, s = (np.array([float(name) for name in names]) for names in (images, poses))
    except ValueError:
        return {}
    if len(s) < 2 or not (np.diff(s) > 0.0).all() or min(t.min(), s[0]) <= 0.0:
        return {}
    t *= 1000.0 ** np.round(np.log(np.median(s) / np.median(t)) / np.log(1000.0))
    near = np.abs(t[:, None] - s).argmin(axis=1)
    far = np.abs(t - s[near]).max() > np.median(np.diff(s))
    if far or np.unique(near).size < len(t) or {*images} & {*poses}:
        return {}
    return {name: poses[i] for name, i in zip(images, near, strict=True)}


def _by_row(images: Sequence[str], poses: Sequence[str]) -> Mapping[str, str]:
    """Image -> pose, whose rows have no names: images that count rows from 0, or from 1, or as many
    of any other numbers; empty where numbers say nothing."""
    numbers = {name: n for name in images if (n := _last_number(name)) is not None}
    every = sorted(numbers.values())
    if len({*every}) < len(images) or not every:
        return {}
    first = min(every[0], 1)
    if every[-1] < len(poses) + first:
        by = {name: poses[n - first] for name, n in numbers.items()}
        return {name: pose for name, pose in by.items() if name != pose}
    if len(images) == len(poses) and every[-1] > len(poses):
        return {name: poses[every.index(n)] for name, n in numbers.items()}
    return {}


def _last_number(name: str) -> int | None:
    digits = re.findall(r"\d+", name.rpartition("/")[2])
    return int(digits[-1]) if digits else None


def _step(used: Collection[str], points: Collection[str]) -> int:
    """By how much the numbers of corners exceed those of the points; 0 where names match."""
    if {*used} <= {*points} or not all(name.isdecimal() for name in (*used, *points)):
        return 0
    fitting = (step for step in (1, -1) if {str(int(n) - step) for n in used} <= {*points})
    return next(fitting, 0)


def _first_of_tags(used: Collection[str], points: Collection[str]) -> str:
    """The number of the first of corners that are counted through, on a board that names them by
    tag and corner; empty where names match."""
    tags = all(re.fullmatch(r"\d+\.\d+", name) for name in points)
    if not tags or not used or not all(name.isdecimal() for name in used):
        return ""
    most = max(map(int, used))
    if most < len(points):
        return "0"
    return "1" if most == len(points) and "0" not in used else ""

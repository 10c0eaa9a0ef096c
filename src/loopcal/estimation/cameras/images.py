"""Images and corners that do not fit: in another order, beside another pose, or simply wrong."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from loopcal.estimation.cameras.corners import Corners
from loopcal.estimation.cameras.facts import Fact
from loopcal.estimation.cameras.orders import image_orders, renumbered
from loopcal.estimation.cameras.placing import Reading
from loopcal.estimation.cameras.scene import Adjusted, Scene

FAR = 5.0
"""Lengths of plane normal errors exceed k medians with probability 2^-(k^2): here 3e-8."""
NEAR = 3.0
"""The same: one of 500 is farther."""
# Chosen, not derived: arms err by some ten times as much in another form; an image of another pose
# or session is off by hundreds.
GROSS = 30.0
"""Medians from which on an image that nothing explains says nothing of the robot."""

SURE = 3
"""Corners that say which pose a view is of: one point is as near to a point of some other pose."""
SOME = 12
"""Corners of a view that are sought beside other poses."""


@dataclass(frozen=True)
class Explained:
    """A reading with what single images were corrected, and the facts about them."""

    reading: Reading
    facts: tuple[Fact, ...]


def explained(reading: Reading, result: Adjusted) -> Explained:
    """Each image that does not fit, tried in other orders and beside other poses."""
    corners, views = reading.corners, reading.corners.views
    scene, facts = result.scene, []
    # Errors of the hand's place are larger in px where the board is near, those of its turns in mm
    # where it is far: what does not fit is off in both.
    away = np.linalg.norm(scene.in_camera(corners), axis=1)
    px, mm = (views.medians(d) for d in (result.distance, result.distance * away))
    typical = max(float(np.median(px)), 1e-6)
    off = (px > FAR * typical) & (mm > FAR * np.median(mm))
    orders: dict[int, list[str]] = {}
    rows: dict[int, int] = {}
    copies: dict[int, int] = {}
    wrong: dict[int, float] = {}
    new = corners
    for v in np.flatnonzero(off):
        one = corners.where(views.of_corner == v)
        name, ordered = _in_order(one, scene, FAR * typical)
        image = int(views.image[v])
        if ordered is not None:
            new = _replaced(new, one, ordered)
            orders.setdefault(image, []).append(name)
        elif (first := _copied(corners, int(v))) is not None:
            copies[image] = first
        elif (row := _beside(one, scene, NEAR * typical)) is not None:
            rows[image] = row
        else:
            wrong[image] = max(float(px[v]) / typical, wrong.get(image, 0.0))
    facts += _order_facts(corners, orders)
    facts += _row_facts(corners, rows)
    facts += _copy_facts(corners, copies)
    gross = {image for image, times in wrong.items() if times > GROSS}
    for some, remedy in (
        (gross, "Inspect corners and poses."),
        (wrong.keys() - gross, "Poses of an arm in another form err so: the calibration judges."),
    ):
        if names := _names(corners, sorted(some)):
            times = max(wrong[image] for image in some)
            sentence = (
                f"{_count(names)} not fit, neither in another order nor beside another pose: off "
                f"by up to {times:.0f} times the usual. {remedy}"
            )
            values: dict[str, float | str] = {"images": len(names), "times": times}
            facts.append(Fact("image-unexplained", sentence, values, names))
    reading = replace(reading, corners=new)
    if rows and reading.T_base_flange is not None:
        T = reading.T_base_flange.copy()
        T[list(rows)] = reading.T_base_flange[list(rows.values())]
        reading = replace(reading, T_base_flange=T)
    return Explained(reading, tuple(facts))


def _in_order(one: Corners, scene: Scene, limit: float) -> tuple[str, Corners | None]:
    """The order in which a view's corners fit the pose that the others predict."""
    best, name, ordered = limit, "", None
    b = int(one.board[0])
    for order in image_orders(one.boards[b]):
        other = renumbered(one, {b: order})
        if len(other) < max(3, len(one) // 2):
            continue
        size = _median(other, scene)
        if size < best:
            best, name, ordered = size, order.name, other
    return name, ordered


def _median(corners: Corners, scene: Scene) -> float:
    return float(np.median(np.linalg.norm(scene.residuals(corners), axis=1)))


def _beside(one: Corners, scene: Scene, limit: float) -> int | None:
    """The image beside whose pose a view fits."""
    if scene.A is None or len(one) < SURE:
        return None
    some = one.where(np.unique(np.linspace(0, len(one) - 1, SOME).astype(int)))
    sizes = [_median(some, replace(scene, A=np.broadcast_to(A, scene.A.shape))) for A in scene.A]
    row = int(np.argmin(sizes))
    return row if sizes[row] < limit and row != int(one.image[0]) else None


def copied_images(corners: Corners) -> list[int]:
    """The images whose corners have the same pixels as those of an earlier image."""
    image, copies = corners.views.image, set[int]()
    for v in range(len(image)):
        if (other := _copied(corners, v)) is not None and other < image[v]:
            copies.add(int(image[v]))
    return sorted(copies)


def _copied(corners: Corners, view: int) -> int | None:
    """Another image in which all corners of a view have the same pixels."""
    views = corners.views
    mine = np.flatnonzero(views.of_corner == view)
    alike = np.all([k == k[view] for k in (views.camera, views.board, views.sizes)], axis=0)
    alike[view] = False
    for other in np.flatnonzero(alike) if len(mine) >= SURE else ():
        theirs = views.first[other] + np.arange(len(mine))
        same = np.array_equal(corners.point[theirs], corners.point[mine])
        if same and np.array_equal(corners.uv[theirs], corners.uv[mine]):
            return int(views.image[other])
    return None


def _replaced(corners: Corners, old: Corners, new: Corners) -> Corners:
    """Corners with those of one view as other points; the ones without a point are left out."""
    mine = (corners.image == old.image[0]) & (corners.camera == old.camera[0])
    mine &= corners.board == old.board[0]
    rest = corners.where(~mine)
    index = [
        np.concatenate([getattr(rest, k), getattr(new, k)])
        for k in ("image", "camera", "board", "point")
    ]
    uv = np.concatenate([rest.uv, new.uv])
    return Corners.of(index, uv, corners.cameras, corners.boards, corners.poses)


def _names(corners: Corners, images: list[int]) -> tuple[str, ...]:
    return tuple(corners.poses[i] for i in images)


def _count(names: tuple[str, ...]) -> str:
    few = ", ".join(names[:5]) + (", ..." if len(names) > 5 else "")
    return f"Image {few} does" if len(names) == 1 else f"{len(names)} images ({few}) do"


def _order_facts(corners: Corners, orders: dict[int, list[str]]) -> list[Fact]:
    by_name: dict[str, list[int]] = {}
    for image, names in orders.items():
        for name in set(names):
            by_name.setdefault(name, []).append(image)
    facts = []
    for name, images in by_name.items():
        poses = _names(corners, sorted(images))
        sentence = (
            f"{_count(poses)} not number the points as the others do: {name}. "
            "Correct the detection, or exclude them."
        )
        values: dict[str, float | str] = {"order": name, "images": len(poses)}
        facts.append(Fact("points-in-another-order", sentence, values, poses, applied=True))
    return facts


def _row_facts(corners: Corners, rows: dict[int, int]) -> list[Fact]:
    facts = []
    for image, row in sorted(rows.items()):
        values: dict[str, float | str] = {"pose": corners.poses[row]}
        sentence = (
            f"Image {corners.poses[image]} fits the pose of {corners.poses[row]}, not its row's. "
            "Check which pose belongs to it."
        )
        names = (corners.poses[image],)
        facts.append(Fact("pose-of-another-image", sentence, values, names, applied=True))
    return facts


def _copy_facts(corners: Corners, copies: dict[int, int]) -> list[Fact]:
    facts = []
    for image, first in sorted(copies.items()):
        sentence = (
            f"Image {corners.poses[image]} copies image {corners.poses[first]}: all of its corners "
            "have the same pixels. It does not fit its pose. Detect its corners again."
        )
        values: dict[str, float | str] = {"image": corners.poses[first]}
        facts.append(Fact("image-unexplained", sentence, values, (corners.poses[image],)))
    return facts

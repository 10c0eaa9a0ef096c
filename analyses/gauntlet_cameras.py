"""The kinds of set of images of the gauntlet: clean ones, and one for each mistake of a user.

Robots, lenses and images are those of `analyses.cameras_truth`, with a camera on the hand in every
second draw and in front of it in the others.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from analyses.cameras_truth import COLUMNS, ROWS, Shots, inverse, shots
from analyses.gauntlet_days import Planted
from analyses.gauntlet_truth import Array

Rng = np.random.Generator


@dataclass(eq=False)
class Files:
    """What a user's folder is made of: pixels (N, n, 2), points (n, 3) of the board, and the poses
    of the flange (N, 4, 4) where these are kept instead of joints; planted: as in a day."""

    uv: Array
    points: Array
    T: Array | None = None
    planted: Planted = field(default_factory=lambda: Planted("images"))


Mistake = Callable[[Files, Shots, Rng], None]


@dataclass(frozen=True, eq=False)
class Photographed:
    """How a set of images comes about; turns: of the hand (`cameras_truth.poses`); pose: the table
    holds poses of the flange instead of joints; mistake: afterwards, in the files."""

    turns: str = "free"
    pose: bool = False
    mistake: Mistake | None = None
    images: int = 40

    def shots(self, draw: int) -> Shots:
        """Of one draw."""
        return shots(draw, held=draw % 2 == 0, images=self.images, turns=self.turns)

    def written(self, draw: int, folder: Path, rng: Rng) -> tuple[Shots, Planted]:
        """Into a folder; the images, and what was planted."""
        one = self.shots(draw)
        T = one.rig.flange(one.read) if self.pose else None
        files = Files(one.uv.copy(), one.rig.points, T)
        if self.mistake is not None:
            self.mistake(files, one, rng)
        one.write(folder, uv=files.uv, points=files.points, T=files.T)
        return one, files.planted


def wrong_corners(files: Files, shots: Shots, rng: Rng) -> None:
    """A tenth of the corners were detected elsewhere, by 3 to 60 px."""
    bad = rng.random(files.uv.shape[:2]) < 0.1
    about = rng.uniform(0.0, 2.0 * np.pi, int(bad.sum()))
    far = np.exp(rng.uniform(np.log(3.0), np.log(60.0), int(bad.sum())))
    files.uv[bad] += far[:, None] * np.column_stack([np.cos(about), np.sin(about)])


def one_corner(files: Files, shots: Shots, rng: Rng) -> None:
    """One corner of one image is off by 20 px."""
    i, k = int(rng.integers(len(files.uv))), int(rng.integers(files.uv.shape[1]))
    files.uv[i, k] += [20.0, 0.0]
    files.planted = replace(files.planted, pose=i + 1)


def another_order(files: Files, shots: Shots, rng: Rng) -> None:
    """One image's corners are numbered from the other end."""
    i = int(rng.integers(len(files.uv)))
    files.uv[i] = files.uv[i, ::-1].copy()
    files.planted = replace(files.planted, pose=i + 1)


def pose_of_another(files: Files, shots: Shots, rng: Rng) -> None:
    """One image stands beside the pose of another."""
    i = int(rng.integers(len(files.uv)))
    files.uv[i] = files.uv[i - 7]
    files.planted = replace(files.planted, pose=i + 1)


def inverted(files: Files, shots: Shots, rng: Rng) -> None:
    """The base in the flange is kept, not the flange in the base."""
    assert files.T is not None
    files.T = inverse(files.T)


def poses_in_mm(files: Files, shots: Shots, rng: Rng) -> None:
    """Millimetres stand under a heading that says metres."""
    assert files.T is not None
    files.T = files.T.copy()
    files.T[:, :3, 3] *= 1e3


def board_in_mm(files: Files, shots: Shots, rng: Rng) -> None:
    """Points of the board in millimetres under a heading that says metres."""
    files.points = 1e3 * files.points


def legacy(files: Files, shots: Shots, rng: Rng) -> None:
    """Rows of corners are displaced by a column to either side in turn: the black squares of an
    older pattern are the white ones of the newer."""
    grid = files.uv.reshape(len(files.uv), ROWS, COLUMNS, 2)
    moved = np.full_like(grid, np.nan)
    moved[:, ::2, 1:] = grid[:, ::2, :-1]
    moved[:, 1::2, :-1] = grid[:, 1::2, 1:]
    files.uv = moved.reshape(files.uv.shape)


def mirrored(files: Files, shots: Shots, rng: Rng) -> None:
    """The board's x runs the other way: of a flat board the same as seen from behind, which only
    turns its frame."""
    files.points = files.points * [-1.0, 1.0, 1.0]


def exchanged(files: Files, shots: Shots, rng: Rng) -> None:
    """u stands under v."""
    files.uv = files.uv[:, :, ::-1].copy()


def rows_late(files: Files, shots: Shots, rng: Rng) -> None:
    """Each image stands beside the pose of the next one."""
    files.uv = np.roll(files.uv, 1, axis=0)


ORDER = r"\border\b|number"
KINDS: dict[str, tuple[Photographed, str | None]] = {
    "images, joints": (Photographed(), None),
    "images, poses": (Photographed(pose=True), None),
    "images, 15": (Photographed(images=15), None),
    "images: wrong corners": (Photographed(mistake=wrong_corners), r"corner"),
    "images: one wrong corner": (Photographed(mistake=one_corner), r"corner|outlier|not fit"),
    "images: one in another order": (Photographed(mistake=another_order), ORDER),
    "images: one with another's pose": (Photographed(mistake=pose_of_another), r"\bpose\b"),
    "images: transform inverted": (Photographed(pose=True, mistake=inverted), "invert|inverse"),
    "images: poses in mm": (Photographed(pose=True, mistake=poses_in_mm), r"\bmm\b"),
    "images: board in mm": (Photographed(mistake=board_in_mm), r"\bmm\b"),
    "images: legacy board": (Photographed(mistake=legacy), "legacy"),
    "images, mirrored board": (Photographed(mistake=mirrored), None),
    "images: u and v exchanged": (Photographed(mistake=exchanged), "exchanged|mirror"),
    "images: one row late": (Photographed(mistake=rows_late), r"\brows?\b"),
    "images: never turned": (Photographed(turns="none"), "turned alike"),
    "images: turned about one axis": (Photographed(turns="axis"), "turns only about"),
}
"""How each kind comes about, and what an answer must speak of; nothing: it is clean."""

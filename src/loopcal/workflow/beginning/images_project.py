"""The tables and files of a project of images, from what was understood of them."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.errors import listed
from loopcal.estimation.cameras.start import (
    CameraStart,
)
from loopcal.estimation.mounted import NEAR, TURNED
from loopcal.files.cameras.corner_table import CornerTable
from loopcal.files.tables.writer import table_bytes
from loopcal.files.toml.reader import SCHEMA
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.instruments.camera import PIXEL
from loopcal.mechanisms.placement import rigid, yaw_pitch_roll
from loopcal.units import from_si, to_si
from loopcal.workflow.beginning.begun import READINGS
from loopcal.workflow.beginning.images_hand import Hand

CORNERS, WRONG = "corners.csv", "wrong-corners.csv"
"""Those of the project, and those that do not fit, which it leaves out."""
CORNER = 0.02
"""Where the learning of the sd of a corner begins, at least [px]."""
_NORMAL = 1.4826
"""The sd of normal values over the median of their sizes."""
POINT_SD = 0.5e-3
"""How far markers on a body are from where they are stated [m], as its sd."""
USUAL = {"k2": 0.5} | dict.fromkeys(("k3", "k4", "k5", "k6"), 1.0)
USUAL |= dict.fromkeys(("p1", "p2", "s1", "s2", "s3", "s4"), 5e-3)
"""Prior sds of coefficients of distortion that few images determine. Chosen: lenses on sale have
smaller ones."""
_STATED, _CENTRED = 0.02, 0.05
"""Sds in focal lengths: of stated intrinsics, and of a principal point that is not stated from the
middle of the image. Chosen: lenses are refocused, images cut."""
_MOUNTED, _TURNED = 20.0, 3.0
"""As sds [mm, deg]: where a board or camera sits on a hand that is never turned, which no image
shows, beside where the start puts it."""
_FEWEST = 3
"""Points that an image needs to show where a board of unknown pose is."""


FIXED = {"fixed": True}
SIX = ("x", "y", "z", "rz", "ry", "rx")
"""Endings of the parameters of a place."""


def word(name: str, kind: str) -> str:
    """A name that parameters may begin with."""
    word = re.sub(r"\W", "_", name)
    return word if re.match(r"[A-Za-z_]", word) else f"{kind}_{word}"


UNEXPLAINED = "image-unexplained"
UNFIT = (UNEXPLAINED, "wrong-corners")
"""Codes of facts about images that are not corrected."""


class ImagesProject:
    """The tables of the project, and the files beside it.

    on_body: the cameras' bodies carry them, so that their places and those of the boards are the
    inverse ones; by default as `begun` has each.
    """

    def __init__(
        self,
        begun: CameraStart,
        hand: Hand,
        table: CornerTable,
        stated: Collection[str],
        on_body: bool | None = None,
        title: str = "images",
    ) -> None:
        self.title = title
        self.begun, self.hand, self.table, self.stated = begun, hand, table, stated
        corners = begun.corners
        carried = begun.on_flange if on_body is None else {*corners.cameras} if on_body else ()
        self.on_body = [camera in carried for camera in corners.cameras]
        self._seen_by = dict(sorted({(b, c) for c, b in self._pairs()}))
        seen = np.unique(corners.image, return_counts=True)
        enough = seen[1] >= (_FEWEST if hand.table.get("read") is False else 1)
        self.kept = [int(i) for i in seen[0][enough]]
        self.eyes = {c: word(c, "camera") for c in corners.cameras}
        self.boards = {b.name: word(b.name, "board") for b in corners.boards}

    def begun_at(self, begun: CameraStart, on_body: bool | None = None) -> ImagesProject:
        """The same from another start."""
        return ImagesProject(begun, self.hand, self.table, self.stated, on_body, self.title)

    @property
    def left_out(self) -> tuple[str, ...]:
        """Images and poses that are not used, in words."""
        poses, images = self.begun.corners.poses, self.table.images
        used, seen = {poses[i] for i in self.kept}, {*images}
        unused = {
            "images without a pose or with too few corners": [i for i in images if i not in used],
            "poses without an image": [pose for pose in poses if pose not in seen],
        }
        return tuple(
            f"{len(names)} {what} are left out: {listed(names, 5)}"
            for what, names in unused.items()
            if names
        )

    @property
    def tables(self) -> dict[str, Any]:
        """Of the project file."""
        hand = self.hand
        read_as = hand.words(self.begun.facts)
        spread = {k: k for k in ("pose", "camera", "board", "point", "u", "v")}
        return {
            "schema": SCHEMA,
            "title": self.title,
            "mechanism": {
                **hand.table,
                "instrument": list(self._instruments()),
                "parameters": self._parameters(),
            },
            "data": {
                "file": READINGS,
                "pose": "pose",
                **({"flange": read_as} if read_as else {}),
                "join": [{"file": CORNERS, "pose": "pose", "spread": spread}],
            },
            "noise": {**hand.noise, **self._noise()},
        }

    def _pairs(self) -> Iterable[tuple[int, int]]:
        views = self.begun.corners.views
        every = zip(views.camera.tolist(), views.board.tolist(), strict=True)
        return sorted(dict.fromkeys(every))

    def _names(self) -> dict[tuple[int, int], str]:
        """What each instrument is called: by its camera, and by its board where it sees several."""
        corners = self.begun.corners
        several = len(corners.boards) > 1
        return {
            (c, b): self.eyes[corners.cameras[c]]
            + (f"_{self.boards[corners.boards[b].name]}" if several else "")
            for c, b in self._pairs()
        }

    def _instruments(self) -> Iterable[dict[str, Any]]:
        corners = self.begun.corners
        for (c, b), name in self._names().items():
            camera, board = corners.cameras[c], corners.boards[b]
            seen = (corners.camera == c) & (corners.board == b)
            ids = list(board.points)
            used = [ids[i] for i in np.unique(corners.point[seen])]
            # In the unit of the lengths that state none.
            length = dict(self.hand.table.get("units", {})).get("length", "m")
            image = self.begun.intrinsics[camera].image
            points = {p: from_si(np.array(board.points[p]), length).tolist() for p in used}
            yield {
                "type": "camera",
                "name": name,
                "eye": self.eyes[camera],
                "board": self.boards[board.name],
                "on": "body" if self.on_body[c] else "base",
                "lens": self.begun.intrinsics[camera].lens,
                **({} if image is None else {"image": list(image)}),
                "offsets": not board.planar,
                "points": points,
            }

    def _parameters(self) -> dict[str, Any]:
        begun, corners = self.begun, self.begun.corners
        stated: dict[str, Any] = dict(self.hand.parameters)
        free = self.hand.table.get("read") is False
        blind = any(fact.code in ("no-rotation", "parallel-axes") for fact in begun.facts)
        # what the hand carries is a guess of the start, and no drawing
        guessed = (1e3 * NEAR, round(math.degrees(TURNED), 1))
        near = None if free else (_MOUNTED, _TURNED) if blind else guessed
        for c, (camera, eye) in enumerate(self.eyes.items()):
            X = begun.X[c] @ np.linalg.inv(begun.X[0]) if free else begun.X[c]
            place = np.linalg.inv(X) if self.on_body[c] else X
            stated |= six_of(
                eye, place, free and c == 0, near if camera in begun.on_flange else None
            )
            lens = begun.intrinsics[camera]
            for key, value in lens.values.items():
                entry: dict[str, Any] = {"value": float(value)}
                if key in ("f", "cx", "cy"):
                    entry["unit"] = "px"
                    stated_sd = camera in self.stated
                    if key != "f" or stated_sd:
                        share = _STATED if stated_sd else _CENTRED
                        entry["sd"] = round(share * abs(lens.fx), 1)
                if key in USUAL and lens.lens != "fisheye":
                    entry["sd"] = USUAL[key]
                stated[f"{eye}_{key}"] = entry
        for b, board in enumerate(corners.boards):
            Y = begun.Y[b]
            if free:
                Y = np.linalg.inv(begun.Y[0]) @ Y
            alone = not board.xyz.any()  # a point at its origin has no turn
            if alone:
                Y = rigid(np.eye(3), Y[:3, 3])
            seer = self._seen_by.get(b, 0)
            place = np.linalg.inv(Y) if self.on_body[seer] else Y
            carried = corners.cameras[seer] not in begun.on_flange
            mounted = near if carried else None
            placed = six_of(self.boards[board.name], place, free and b == 0, mounted)
            for turn in SIX[3:] if alone else ():
                placed[f"{self.boards[board.name]}_{turn}"] = {"value": 0.0, "unit": "deg", **FIXED}
            stated |= placed
            if free and board.planar and len(board.points) > _FEWEST:
                # nothing but the board says how large anything is
                stated[f"{self.boards[board.name]}_scale"] = {"value": 0.0, **FIXED}
            if not board.planar:
                seen = corners.point[corners.board == b]
                held = frame_of(board.xyz, np.bincount(seen), sized=free)
                for point in np.unique(seen):
                    for k, axis in enumerate("xyz"):
                        name = f"{self.boards[board.name]}_{list(board.points)[point]}_{axis}"
                        how = FIXED if (int(point), k) in held else {"sd": 1e3 * POINT_SD}
                        stated[name] = {"value": 0.0, "unit": "mm", **how}
        return stated

    def _noise(self) -> dict[str, Any]:
        corners, residuals = self.begun.corners, self.begun.residuals
        noise = {}
        for (c, b), name in self._names().items():
            left = np.abs(residuals[(corners.camera == c) & (corners.board == b)])
            # Of the start, which wrong corners do not bend.
            sd = max(_NORMAL * float(np.median(left)), CORNER)
            noise[name] = {"sd": round(sd, 3), "unit": "px", "estimate": "group"}
        return noise

    def _labels(self) -> list[str]:
        """Under which each corner is read."""
        corners = self.begun.corners
        ids = [list(b.points) for b in corners.boards]
        eyes = [self.eyes[camera] for camera in corners.cameras]
        boards = [self.boards[board.name] for board in corners.boards]
        which = zip(corners.camera, corners.board, corners.point, strict=True)
        return [f"{eyes[c]}:{boards[b]}:{ids[b][k]}" for c, b, k in which]

    def marked(self, readings: Mapping[str, NDArray[np.bool_]]) -> NDArray[np.bool_]:
        """(N,) the corners one of whose coordinates is marked, by reading and image kept."""
        row = {image: i for i, image in enumerate(self.kept)}
        none = np.zeros(len(self.kept), dtype=bool)
        marks = [
            image in row and bool(readings.get(f"{label}:u", none)[row[image]])
            for label, image in zip(self._labels(), self.begun.corners.image.tolist(), strict=True)
        ]
        return np.array(marks, dtype=bool)

    @property
    def places(self) -> dict[str, float]:
        """Where the start puts cameras and boards: parameter -> value [SI]."""
        six = [
            f"{owner}_{p}" for owner in (*self.eyes.values(), *self.boards.values()) for p in SIX
        ]
        stated = self._parameters()
        return {n: float(to_si(stated[n]["value"], stated[n]["unit"])) for n in six if n in stated}

    @property
    def dataset(self) -> Dataset:
        """The readings, under the names that they have in the project."""
        corners, kept = self.begun.corners, self.kept
        readings = {name: values[kept] for name, values in self.hand.readings.items()}
        row = {image: i for i, image in enumerate(kept)}
        for label, image, pixel in zip(self._labels(), corners.image, corners.uv, strict=True):
            for axis, value in zip(PIXEL, pixel, strict=True):
                column = readings.setdefault(f"{label}:{axis}", np.full(len(kept), np.nan))
                if image in row:
                    column[row[image]] = value
        units = {name: "px" for name in readings if name.endswith((":u", ":v"))}
        poses = [corners.poses[i] for i in kept]
        return Dataset.from_arrays(readings, units=units, poses=poses)

    def readings(self) -> bytes:
        """The poses that show enough, a row each."""
        columns: dict[str, Any] = {"pose": [self.begun.corners.poses[i] for i in self.kept]}
        for name, values in self.hand.readings.items():
            columns[name] = values[self.kept]
        return table_bytes(columns, ".csv")

    def corners(self) -> bytes:
        """The corners of these poses."""
        corners = self.begun.corners
        rows = np.flatnonzero(np.isin(corners.image, self.kept))
        ids = [list(b.points) for b in corners.boards]
        columns: dict[str, Any] = {
            "pose": [corners.poses[corners.image[i]] for i in rows],
            "camera": [self.eyes[corners.cameras[corners.camera[i]]] for i in rows],
            "board": [self.boards[corners.boards[corners.board[i]].name] for i in rows],
            "point": [ids[corners.board[i]][corners.point[i]] for i in rows],
            "u": corners.uv[rows, 0],
            "v": corners.uv[rows, 1],
        }
        return table_bytes(columns, ".csv")


def frame_of(xyz: Array, seen: NDArray[np.intp], *, sized: bool) -> set[tuple[int, int]]:
    """Coordinates (point, axis) by which the frame of a body is held, of points (n, 3).

    Six are held, as the place of the body has six: three of a point, two of the point farthest from
    it, and one of the point farthest from both. Were none held, all points and the place could move
    alike. seen: (up to n,) how often each is seen; sized: hold the third one of the second point
    too, where nothing else shows how large the body is.
    """
    often = np.flatnonzero(seen >= 0.5 * seen.max(initial=1))
    P = xyz[often] - xyz[often].mean(axis=0)
    a = int(np.argmax(np.linalg.norm(P, axis=1)))
    along = P - P[a]
    b = int(np.argmax(np.linalg.norm(along, axis=1)))
    normals = np.cross(along[b], along)
    c = int(np.argmax(np.linalg.norm(normals, axis=1)))
    longest, across = (int(np.argmax(np.abs(v))) for v in (along[b], normals[c]))
    held = {(a, axis) for axis in range(3)}
    if along[b].any():
        held |= {(b, axis) for axis in range(3) if sized or axis != longest}
    if normals[c].any():
        held.add((c, across))
    return {(int(often[i]), axis) for i, axis in held}


def six_of(
    owner: str, T: Array, fixed: bool = False, near: tuple[float, float] | None = None
) -> dict[str, Any]:
    """[parameters] of a place; near: how well it is known, as sds [mm, deg]."""
    turns = yaw_pitch_roll(T[:3, :3])
    entries = [(axis, 1e3 * float(v), "mm", 0) for axis, v in zip("xyz", T[:3, 3], strict=True)]
    entries += [
        (name, float(from_si(np.array(v), "deg")), "deg", 1)
        for name, v in zip(SIX[3:], turns, strict=True)
    ]
    further = FIXED if fixed else {}
    return {
        f"{owner}_{name}": {"value": value, "unit": of, **({"sd": near[k]} if near else further)}
        for name, value, of, k in entries
    }


def doubts(project: ImagesProject) -> tuple[str, ...]:
    """What was corrected or does not fit, of images of a calibrated camera, in words."""
    facts = project.begun.facts
    some = [f for f in facts if (f.applied and f.code != "mount") or f.code in UNFIT]
    return (*(fact.sentence for fact in some), *project.left_out)

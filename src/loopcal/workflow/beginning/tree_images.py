"""Corners of boards among what was observed of a tree of bodies.

To `understood` the body with the camera is the base of a robot, and the one with the board its
flange; for a board on the ground it is the other way.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from loopcal.arrays import Array
from loopcal.errors import InputError, listed
from loopcal.estimation.cameras.start import CameraStart
from loopcal.files.cameras.corner_table import CornerTable
from loopcal.files.cameras.corners import pixel_stem
from loopcal.files.cameras.folder import (
    LONE,
    Files,
    folders_of_images,
    lenses_of,
    of_images,
    read_files,
    with_columns,
    without_files,
)
from loopcal.files.recognition.fields import Source
from loopcal.files.recognition.rows import Observation, chosen_rows
from loopcal.files.recognition.sources import sources_of
from loopcal.mechanisms.cameras.board import Board
from loopcal.mechanisms.cameras.lens import Intrinsics
from loopcal.mechanisms.placement import inverse
from loopcal.workflow.beginning.from_images import by_camera, named, understood
from loopcal.workflow.beginning.images_hand import Hand
from loopcal.workflow.beginning.images_project import ImagesProject, doubts, word

# Chosen, not derived, as of the faults of a whole file: drawings miss by a hundredth, images of
# another body by a third and more.
ASTRAY, CLEARLY = 0.1, 1 / 3
"""Shares: of the spread of the corners that a start may miss, and of that miss that another body
must leave."""


@dataclass(frozen=True, eq=False)
class Pictures:
    """Files with corners, and the table whose rows are the poses of their images; of: the one
    observation that names the columns of its pixels there."""

    files: Files
    source: Source
    of: str = ""

    def is_of(self, one: Observation) -> bool:
        """Whether an observation is among them: by their files, or by their folder, and by the
        camera and board that it names."""
        if self.of or one.columns:
            return self.of == one.name
        path, corners = self.source.path, self.files.corners
        places = (path, path and path.parent, Path(corners.file))
        seen = one.camera in ("", *corners.cameras) and one.board in ("", *corners.boards)
        return seen and any(one.of_file(place) for place in places)


@dataclass(eq=False)
class Eyes:
    """What cameras saw: instruments, entries of [parameters] and [noise].

    words: what was understood; doubts: what was corrected and what does not fit; taken: names of
    observations; starts: by name of the camera, where it stands at the start; carriers: by name of
    a camera or board, the body that carries it; lenses: as they begin.
    """

    instruments: list[dict[str, Any]] = field(default_factory=list)
    parameters: dict[str, Any] = field(default_factory=dict)
    noise: dict[str, Any] = field(default_factory=dict)
    words: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    taken: tuple[str, ...] = ()
    starts: dict[str, Array] = field(default_factory=dict)
    carriers: dict[str, str] = field(default_factory=dict)
    lenses: dict[str, Intrinsics] = field(default_factory=dict)

    def lenses_of(self, cameras: Sequence[str]) -> dict[str, Intrinsics]:
        """Of those cameras that have begun with other boards."""
        return {camera: self.lenses[camera] for camera in cameras if camera in self.lenses}


def sources_and_pictures(
    entries: Sequence[Any],
    looking: Sequence[Observation],
    usual: Mapping[str, Board] = MappingProxyType({}),
) -> tuple[list[Source], list[Pictures]]:
    """The tables of rows, and the files with corners: those of a folder belong together, as do
    those named one by one.

    usual: the boards where no file describes one. Raises InputError for corners beside which no
    table has the poses of their images.
    """
    pointing = [one for one in looking if one.table["type"] == "camera" and one.columns]
    if pointing:
        return _of_columns(entries, looking, pointing, usual)
    sources: list[Source] = []
    pictures: list[Pictures] = []

    def read(some: Iterable[Any]) -> list[Source]:
        added = [source for entry in some for source in sources_of(entry, len(sources))]
        sources.extend(added)
        return added

    pictured, described = folders_of_images(entries), of_images(entries)
    apart = {id(entry) for entry in (*pictured, *described)}  # a table has no equality
    rest = [entry for entry in entries if id(entry) not in apart]
    stated = lenses_of(rest) if pictured else {}
    read(without_files(rest, stated))
    if described:
        files = read_files(described, usual, alone=True)
        if not any({*files.corners.images}.intersection(one.ids or ()) for one in sources):
            sources += _beside_corners(files, described, len(sources))
        pictures.append(Pictures(files, _with_poses(files, sources)))
    for folder in pictured:
        files = read_files([folder], usual, alone=True)
        files = replace(files, lenses={**_all(stated), **files.lenses})
        pictures.append(Pictures(files, _with_poses(files, read(files.poses))))
    return sources, pictures


def _of_columns(
    entries: Sequence[Any],
    looking: Sequence[Observation],
    pointing: Sequence[Observation],
    usual: Mapping[str, Board],
) -> tuple[list[Source], list[Pictures]]:
    """The same where tables of joints have columns of the pixels of single points."""
    tables = dict.fromkeys(p for one in pointing for p in with_columns(entries, one.columns))
    stated = lenses_of(entries)
    rest = without_files(entries, [*tables, *stated])
    others = [one for one in looking if one not in pointing]
    sources, pictures = sources_and_pictures(rest, others, usual) if rest else ([], [])
    for path in tables:
        for source in sources_of(path, len(sources)):
            sources.append(source)
            pictures += [
                Pictures(files, source, one.name)
                for one in pointing
                if one.of_file(path) and (files := _points(one, source, stated)) is not None
            ]
    return sources, pictures


def _points(
    one: Observation, source: Source, stated: Mapping[Path, Mapping[str, Intrinsics]]
) -> Files | None:
    """What a camera saw of the one point whose columns are named; None where it has none."""
    fields = {pixel_stem(f.heading.text): f for f in source.fields if f.heading}
    columns = [fields.get(pixel_stem(name)) for name in one.columns]
    if len(one.columns) != 2:
        raise InputError(
            f"{one.name!r} reads u and v of one point, but {len(one.columns)} columns are named",
            code="wrong-shape",
            place="--observe",
            remedy="name two, columns=u,v; of several points state an observation each",
        )
    if None in columns:
        return None
    u, v = (field.values for field in columns if field)
    seen = np.flatnonzero(chosen_rows(source, one) & np.isfinite(u) & np.isfinite(v))
    if not seen.size:
        return None
    ids = source.ids or tuple(str(i) for i in range(1, len(source) + 1))
    count, board = len(seen), one.board or one.name
    table = CornerTable(
        tuple(ids[i] for i in seen),
        (one.camera or "1",) * count,
        (board,) * count,
        (LONE,) * count,
        u[seen],
        v[seen],
        file=source.name,
    )
    return Files(table, {board: Board(board, {LONE: (0.0, 0.0, 0.0)})}, _all(stated), ())


def _all(stated: Mapping[Path, Mapping[str, Intrinsics]]) -> dict[str, Intrinsics]:
    return {name: lens for some in stated.values() for name, lens in some.items()}


def _beside_corners(files: Files, entries: Sequence[Any], number: int) -> list[Source]:
    """The table of poses that a file of corners is itself, with the joints in every row."""
    path = next((Path(one) for one in entries if Path(one).name == files.corners.file), None)
    made = () if path is None else sources_of(path, number)
    return [one for one in made if {*files.corners.images} == {*(one.ids or ())}]


def _with_poses(files: Files, sources: Sequence[Source]) -> Source:
    """The table that names most images of the corners, or the only one."""
    images = {*files.corners.images}
    counts = [len(images.intersection(source.ids or ())) for source in sources]
    best = [source for source, count in zip(sources, counts, strict=True) if count == max(counts)]
    if len(best) == 1:
        return best[0]
    raise InputError(
        "several tables may hold the joints of the images"
        if best
        else "no table holds the joints of the images",
        code="mismatched-poses",
        place=files.corners.file,
        remedy="put the corners, the board and the table of their poses in a folder, and name it"
        + (f"; tables are {listed([s.name for s in best], 5)}" if best else ""),
    )


def see(
    eyes: Eyes,
    one: Observation,
    pictures: Pictures,
    moving: Mapping[str, Array],
    units: Mapping[str, str],
) -> dict[str, Array]:
    """Add what the cameras of an observation saw, and return its pixels by reading and row.

    moving: by the body that the observation names, and by others that could be meant, (N, 4, 4) by
    row of the table of poses, of the body with the board in that of the camera. Raises InputError
    where another body moves as the images do.
    """
    # A board on the ground is looked at by a camera in hand. Any other is in hand itself: where the
    # hand is never turned, the board is taken to sit near the origin of its body.
    held = "sees" in one.table or "on" not in one.table
    files = _chosen(one, pictures.files, eyes)
    # One lens of all its boards: a longer one would put a board farther away.
    files = replace(files, lenses={**files.lenses, **eyes.lenses_of(files.corners.cameras)})
    ids = pictures.source.ids or tuple(str(i) for i in range(1, len(pictures.source) + 1))

    def understood_on(body: str) -> tuple[ImagesProject, tuple[str, ...]]:
        T = moving[body] if held else inverse(moving[body])
        hand = Hand(ids, {"units": {"length": units.get("length", "m")}}, {}, T, {})
        return understood(files, hand, dict.fromkeys(files.corners.cameras, held))

    key = "sees" if "sees" in one.table else "on"
    stated = one.table.get(key, next(iter(moving)))
    project, turned = understood_on(stated)
    missed = _missed(project)
    for body in moving if missed > ASTRAY else ():
        if body != stated and _missed(understood_on(body)[0]) < CLEARLY * missed:
            raise InputError(
                f"what {one.name!r} saw moves as {body!r} does, not as {stated!r}: it misses the "
                f"corners by {missed:.0%} of their spread",
                code="mismatched-poses",
                place=files.corners.file,
                remedy=f"exchange the boards, or the bodies: {key}={body}",
            )
    begun = _beside(project.begun, eyes.starts)
    project = project.begun_at(begun, "on" in one.table)
    eyes.starts |= dict(zip(begun.corners.cameras, begun.X, strict=True))
    eyes.lenses = {**begun.intrinsics, **eyes.lenses}
    bodies = {key: one.table[key] for key in ("on", "sees") if key in one.table}
    tables = project.tables
    made = tables["mechanism"]["instrument"]
    noise = iter(tables["noise"].values())
    begun_before = {(table["eye"], table["board"]): table for table in eyes.instruments}
    for table in made:
        name = f"{one.name}_{table['name']}" if len(made) > 1 else one.name
        sd = next(noise)
        if (same := begun_before.get((table["eye"], table["board"]))) is not None:
            same["points"] |= table["points"]  # of further images
        else:
            eyes.instruments.append({**table, **bodies, "name": name})
            eyes.noise[name] = sd
    eyes.parameters = tables["mechanism"]["parameters"] | eyes.parameters
    eyes.doubts += doubts(project)
    facts = tuple(f.sentence for f in begun.facts if f.code != "board-pitch")
    eyes.words += tuple(
        f"{one.name}: {remark}" for remark in (*files.remarks, *project.left_out, *turned, *facts)
    )
    rows = {pose: i for i, pose in enumerate(ids)}
    at = [rows[pose] for pose in project.dataset.poses]
    pixels = {}
    for reading, values in project.dataset.readings.items():
        pixels[reading] = np.full(len(ids), np.nan)
        pixels[reading][at] = values
    return pixels


def _missed(project: ImagesProject) -> float:
    """How far a start misses the corners, as a share of their spread."""
    begun = project.begun
    spread = float(np.linalg.norm(np.std(begun.corners.uv, axis=0)))
    return float(np.median(np.linalg.norm(begun.residuals, axis=1))) / spread


def _chosen(one: Observation, files: Files, eyes: Eyes) -> Files:
    """The corners of the cameras and boards that are named, under names of their own."""
    table = files.corners
    lenses = by_camera(files.lenses, table.cameras)
    some = table.at(
        [
            i
            for i, (camera, board) in enumerate(zip(table.camera, table.board, strict=True))
            if one.camera in ("", camera) and one.board in ("", board)
        ]
    )
    carrier = {"camera": one.table.get("on", ""), "board": one.table.get("sees", "")}

    def named_on(name: str, kind: str) -> str:
        # What another body carries under this name is another thing.
        name = word(name, kind)
        name = f"{name}_{kind}" if name in eyes.taken else name
        if eyes.carriers.setdefault(name, carrier[kind]) == carrier[kind]:
            return name
        name = f"{one.name}_{name}"
        eyes.carriers[name] = carrier[kind]
        return name

    cameras = {name: named_on(name, "camera") for name in some.cameras}
    boards = {name: named_on(name, "board") for name in some.boards}
    described = {new: replace(named(files.boards, old), name=new) for old, new in boards.items()}
    return replace(
        files,
        corners=replace(
            some,
            camera=tuple(cameras[name] for name in some.camera),
            board=tuple(boards[name] for name in some.board),
            sizes=tuple((cameras[c], size) for c, size in some.sizes if c in cameras),
        ),
        boards=described,
        lenses={cameras[name]: lens for name, lens in lenses.items() if name in cameras},
    )


def _beside(begun: CameraStart, starts: Mapping[str, Array]) -> CameraStart:
    """The start with cameras where they already stand, and boards moved to be seen as before.

    With T = X A Y of a board in the camera, Y' = Y T^-1 X X'^-1 T keeps an image for another X'.
    """
    cameras = begun.corners.cameras
    if not set(cameras) <= starts.keys():
        return begun
    X = np.array([starts[camera] for camera in cameras])
    views, Y = begun.corners.views, begun.Y.copy()
    for b in range(len(Y)):
        of_board = np.flatnonzero(views.board == b)
        v = of_board[len(of_board) // 2]
        c, T = views.camera[v], begun.T_camera_board[v]
        Y[b] = Y[b] @ inverse(T) @ begun.X[c] @ inverse(X[c]) @ T
    return replace(begun, X=X, Y=Y)

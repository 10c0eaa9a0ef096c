"""What a folder of a camera's files holds: corners, boards, lenses, poses, by their contents."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from loopcal.errors import InputError, listed
from loopcal.files.cameras.boards import is_chess, read_boards
from loopcal.files.cameras.corner_documents import LISTS, has_tags
from loopcal.files.cameras.corner_table import CornerTable
from loopcal.files.cameras.corners import is_corners, pixel_stem, read_corners
from loopcal.files.cameras.document import DOCUMENTS
from loopcal.files.cameras.images import ENDINGS, detect
from loopcal.files.cameras.intrinsics import read_intrinsics
from loopcal.files.cameras.places import TABLES, lists_poses, read_places, read_samples
from loopcal.files.cameras.several import each_named, together
from loopcal.files.recognition.headers import heading, words
from loopcal.files.recognition.records import FEWEST
from loopcal.files.recognition.sources import sources_of
from loopcal.files.tables.readers import column_labels
from loopcal.files.tables.registry import reader_of
from loopcal.mechanisms.cameras.board import Board
from loopcal.mechanisms.cameras.lens import Intrinsics
from loopcal.presentation.shown import with_unit

_MADE = ("result.json", "project.toml")
"""Beside them stands what loopcal wrote."""
_POINTS = frozenset((*words("corners", "point"), "id"))
_IMAGES = frozenset(words("corners", "image"))
_OF_A_LENS = ("wrong-shape", "invalid-value")
"""Codes of errors in what a file states of a lens."""
_UNREAD = {"cameras.txt": "COLMAP", "camera.xml": "ViSP"}
"""Files of lenses that are not read, and whose they are."""
_OTHER = frozenset(
    (
        *("", ".urdf", ".xacro", ".srdf", ".stl", ".dae", ".obj", ".ply", ".toml", ".launch"),
        *(".md", ".rst", ".html", ".pdf", ".svg", ".py", ".ipynb", ".m", ".cpp", ".h", ".sh"),
    )
)
"""Endings of files beside readings that hold none."""
_SAME = 1e-3
"""Two descriptions of a board agree within this share of its size: printed sizes are rounded."""
_WORDS = re.compile(r"[^a-z]+")


@dataclass(frozen=True, eq=False)
class Files:
    """What a folder holds: corners, boards, lenses, and tables of poses or joints; title: the name
    of their folder, of one file or of several folders that of the first file."""

    corners: CornerTable
    boards: Mapping[str, Board]
    lenses: Mapping[str, Intrinsics]
    poses: tuple[Path, ...]
    remarks: tuple[str, ...] = ()
    title: str = "images"


def files_of(entries: Sequence[Any]) -> list[Path]:
    """The files that the entries name, those of folders one by one but for projects and results in
    them."""
    paths: list[Path] = []
    for entry in entries:
        if not isinstance(entry, str | Path):
            return []
        path = Path(entry)
        inside = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
        made = {p.parent for p in inside if p.name in _MADE} - {path}
        paths += [p for p in inside if made.isdisjoint(p.parents)]
    return paths


def tables_of(entries: Sequence[Any]) -> list[Any]:
    """The entries, a folder of text tables as these, one by one.

    A text without columns, as a program prints it, is no table. Raises InputError for a folder
    without tables, and for a board without corners.
    """
    documents = [p for p in files_of(entries) if p.suffix.lower() in DOCUMENTS]
    if board := next((path for path in documents if _reads(read_boards, path)), None):
        raise InputError(
            f"{board.name} describes a board, and no file holds corners of images",
            code="no-data",
            remedy="add the images, or a table with the columns image, camera, board, point, u_px, "
            "v_px",
        )
    opened: list[Any] = []
    for entry in entries:
        folder = isinstance(entry, str | Path) and Path(entry).is_dir()
        texts = [p for p in files_of([entry]) if p.suffix.lower() in TABLES] if folder else []
        tables = [p for p in texts if p.suffix.lower() != ".txt" or len(_header(p)) > 1]
        whole = folder and any(Path(entry).glob(reader_of(entry).in_folder or "*.parquet"))
        if folder and not tables and not whole:  # a file per pose
            tables = [p for p in files_of([entry]) if p.suffix.lower() in DOCUMENTS]
        if folder and not tables and not whole:
            raise InputError(
                "this folder holds no table of readings",
                code="no-data",
                place=str(entry),
                remedy="name files of readings, or a folder of CSV files, Parquet files or a bag",
            )
        opened += tables or [entry]
    return opened


_BEGIN = 10_000
"""Characters of a YAML or JSON file after which it has named what it holds."""
_LISTS = re.compile(rf"\b(?:{'|'.join(LISTS)})\b")
_NO_CORNERS = ("missing-key", "invalid-syntax")
"""Codes of errors of a document without corners."""
_READINGS = 4
"""Columns of a table of joints or poses at least: a SCARA has four."""
_WIDEST = 60
"""At most: a log of a controller has some dozens, an array of corners has more."""
_OF_BOARD = 6
"""Columns of a table of a board's points at most: a table with joints has more."""


def are_images(entries: Sequence[Any], fewest: int = 1) -> bool:
    """Whether one of the files holds corners of boards, or so many are images.

    Fewer images beside a table are pictures of something else.
    """
    kinds = Counter(map(_kind, files_of(entries)))
    enough = kinds["image"] >= fewest or not kinds["poses"]
    return bool(kinds["corners"] or (kinds["image"] and enough))


def folders_of_images(entries: Sequence[Any]) -> list[Any]:
    """The entries that are folders with corners or images."""
    folders = [e for e in entries if isinstance(e, str | Path) and Path(e).is_dir()]
    return [folder for folder in folders if are_images([folder])]


def of_images(entries: Sequence[Any]) -> list[Any]:
    """The files among the entries that hold corners, boards or lenses, or are images; none where
    none of them holds corners or is an image."""
    paths = [e for e in entries if isinstance(e, str | Path) and not Path(e).is_dir()]
    kinds = [_kind(Path(e)) for e in paths]
    if {"corners", "image"}.isdisjoint(kinds):
        return []
    described = ("corners", "image", "board", "document")
    return [e for e, kind in zip(paths, kinds, strict=True) if kind in described]


def with_columns(entries: Sequence[Any], columns: Sequence[str]) -> list[Path]:
    """The text tables among the files, and in folders, that have all these columns."""
    stems = {pixel_stem(name) for name in columns}
    return [
        path
        for path in files_of(entries)
        if path.suffix.lower() in TABLES
        and path.is_file()
        and stems <= {pixel_stem(name) for name in _header(path)}
    ]


def without_files(entries: Sequence[Any], paths: Collection[Path]) -> list[Any]:
    """The entries but those all of whose files are among these."""
    inside = [(entry, files_of([entry])) for entry in entries]
    return [entry for entry, files in inside if not files or not {*files} <= {*paths}]


def lenses_of(entries: Sequence[Any]) -> dict[Path, dict[str, Intrinsics]]:
    """The lenses that files state, those in folders too, by the file."""
    lenses = {}
    for path in files_of(entries):
        if path.suffix.lower() in DOCUMENTS:
            with suppress(InputError):
                lenses[path] = read_intrinsics(path)
    return lenses


def _kind(path: Path) -> str:
    ending = path.suffix.lower()
    if ending in ENDINGS:
        return "image"
    if ending == ".vnl":
        return "corners"
    if ending in DOCUMENTS:
        return "corners" if _shows_corners(path) else "document"
    if not path.is_file() or ending in _OTHER:
        return ""
    if ending not in TABLES:
        return "poses" if _reads(read_places, path) or _has_readings(path) else ""
    if is_chess(path):
        return "board"
    names = _header(path)
    parts = [set(_WORDS.split(name.lower())) for name in names]
    stems = {"".join(_WORDS.split(heading(name).stem)) for name in names}
    pixels = any("px" in w for w in parts) or all(any(a in w for w in parts) for a in "uv")
    # x and y may be any point: beside the names of images and of points they are pixels.
    pixels = pixels or ("z" not in stems and not stems.isdisjoint(_IMAGES))
    if pixels and is_corners(names):
        return "corners"
    few = len(names) <= _OF_BOARD
    if few and {"x", "y"} <= stems and not _POINTS.isdisjoint(stems):
        return "board"
    return "poses"


def _shows_corners(path: Path) -> bool:
    """Whether a document lists pixels of corners, whatever else it holds."""
    try:
        with path.open(encoding="utf-8") as file:
            begin = file.read(_BEGIN)
    except (OSError, UnicodeDecodeError):
        return False
    if not _LISTS.search(begin):
        return False
    try:
        read_corners(path)
    except InputError as error:
        return error.code not in _NO_CORNERS
    return True


def _header(path: Path) -> tuple[str, ...]:
    try:
        return column_labels(path)
    except InputError:
        return ()


def read_files(
    entries: Sequence[Any],
    usual: Mapping[str, Board] = MappingProxyType({}),
    *,
    alone: bool = False,
) -> Files:
    """What the files hold, by their contents.

    usual: the boards where no file describes one; alone: without any, each named point is a thing
    of one point. Raises InputError where there is none.
    """
    paths = files_of(entries)
    kinds = {path: _kind(path) for path in paths}
    boards: dict[str, Board] = {}
    by_file: dict[Path, Mapping[str, Intrinsics]] = {}
    poses: list[Path] = []
    tables: list[tuple[Path, CornerTable]] = []
    remarks = [
        f"{path.name} states lenses as {_UNREAD[path.name]} does, which is not read. State them in "
        "a YAML file of OpenCV or ROS."
        for path in paths
        if path.name in _UNREAD and not _reads(read_intrinsics, path)
    ]
    remarks += [
        f"{path.name} is not read. If it holds poses or corners, write it as CSV, YAML or JSON."
        for path in paths
        if not kinds[path] and path.suffix.lower() not in _OTHER
    ]
    stated: dict[str, str] = {}
    # A list of points says more than counts and sizes: of two descriptions it comes first.
    for path, kind in sorted(kinds.items(), key=lambda one: one[1] == "document"):
        if kind == "board":
            _describe(path, read_boards(path), boards, stated, remarks)
        elif kind and path.suffix.lower() in DOCUMENTS:
            described: dict[str, Board] = {}
            if _document(path, described, by_file, tables, remarks, corners=kind == "corners"):
                poses.append(path)
            _describe(path, described, boards, stated, remarks)
        elif kind == "corners":
            tables.append((path, read_corners(path)))
        elif kind == "poses":
            poses.append(path)
    images = [path for path, kind in kinds.items() if kind == "image"]
    boards = boards or dict(usual)
    if alone and not boards and len(tables) == 1:
        tables = [(tables[0][0], _each_alone(tables[0][1]))]
        boards = {name: Board(name, {LONE: (0.0, 0.0, 0.0)}) for name in tables[0][1].boards}
    if not boards:
        raise InputError(
            "no file describes the board",
            code="missing-key",
            remedy="add a CSV file with the columns board, point, x_m, y_m, z_m, or a YAML file "
            "with its type, counts and sizes",
        )
    if images and not tables:
        detection = detect(images, next(iter(boards.values())))
        tables.append((images[0], detection.corners))
        if detection.missed:
            remarks.append(f"no board was seen in {listed(list(detection.missed), 5)}")
    if not tables:
        raise InputError(
            "no file holds corners",
            code="no-data",
            remedy="add a table with the columns image, camera, board, point, u_px, v_px",
        )
    folders = {path.resolve().parent for path in paths}
    title = folders.pop().name if len(paths) > 1 == len(folders) else paths[0].stem
    if len(tables) > 1:
        remarks.append(f"{len(tables)} files hold corners, which are taken together")
    corners = together(tables)
    return Files(corners, boards, each_named(by_file), tuple(poses), tuple(remarks), title)


LONE = "0"
"""The point of a thing that has no other one."""


def _each_alone(table: CornerTable) -> CornerTable:
    """The corners with a board for each point, named BOARD_POINT where a board has several."""
    points: dict[str, set[str]] = {}
    for board, point in zip(table.board, table.point, strict=True):
        points.setdefault(board, set()).add(point)
    names = (
        board if len(points[board]) == 1 else f"{board}_{point}"
        for board, point in zip(table.board, table.point, strict=True)
    )
    return replace(table, board=tuple(names), point=(LONE,) * len(table))


def _describe(
    path: Path,
    described: Mapping[str, Board],
    boards: dict[str, Board],
    stated: dict[str, str],
    remarks: list[str],
) -> None:
    """Take boards of a file that no file before has; stated: the file of each."""
    for name, board in described.items():
        if name not in boards:
            boards[name], stated[name] = board, path.name
        elif {*board.points} != {*boards[name].points}:
            remarks.append(
                f"{stated[name]} and {path.name} name other points of the board {name!r}: "
                f"{len(boards[name].points)} and {len(board.points)} of them. {stated[name]} is "
                "used. Remove the one that is wrong."
            )
        else:
            boards[name] = replace(boards[name], pattern=boards[name].pattern or board.pattern)
            away = max(math.dist(board.points[p], at) for p, at in boards[name].points.items())
            size = float(np.ptp(boards[name].xyz, axis=0).max())
            if away > _SAME * size:
                remarks.append(
                    f"{stated[name]} and {path.name} state the board {name!r} differently: points "
                    f"by {with_unit(away, 'm')}. {stated[name]} is used. Remove the one "
                    "that is wrong."
                )


def _document(
    path: Path,
    boards: dict[str, Board],
    lenses: dict[Path, Mapping[str, Intrinsics]],
    tables: list[tuple[Path, CornerTable]],
    remarks: list[str],
    *,
    corners: bool,
) -> bool:
    """Take what a YAML, JSON or XML file says; whether it holds poses, or joints, too.

    corners: whether it holds corners. Poses of single tags beside them are none of the flange.
    """
    taken, unusable = 0, list[str]()
    for read in (read_intrinsics, read_boards):
        try:
            stated = read(path)
            taken += 1
            if read is read_intrinsics:
                lenses[path] = stated  # type: ignore[assignment]
            else:
                boards.update(stated)  # type: ignore[arg-type]
        except InputError as error:
            words = f"{error.place or path.name}: {error.message}; it is not used"
            if error.code == "unsupported":
                remarks.append(words)
            elif read is read_intrinsics and error.code in _OF_A_LENS:
                unusable.append(words)
    if corners:
        tables.append((path, read_corners(path)))
        return not has_tags(tables[-1][1].point) and _reads(read_places, path)
    if taken:
        return lists_poses(path)  # as files of industrial_calibration do beside the lens
    if _reads(read_samples, path) or _reads(read_places, path) or _has_readings(path):
        return True
    if path.name not in _UNREAD:
        unread = f"{path.name}: no camera, board, pose or corner is recognised; it is not used"
        remarks += unusable or [unread]
    return False


def _reads(read: Callable[[Path], object], path: Path) -> bool:
    try:
        read(path)
    except InputError:
        return False
    return True


def _has_readings(path: Path) -> bool:
    """Whether a document repeats numbers by name, as the columns of a table of joints."""
    try:
        table = sources_of(path, 0)[0]
    except InputError:
        return False
    return len(table) >= FEWEST and _READINGS <= len(table.fields) <= _WIDEST

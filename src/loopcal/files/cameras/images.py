"""Corners of a board in images, by OpenCV in the guarded child; the extra `loopcal[images]`.

An image that cannot be read, takes too long, or shows no board is named with the reason, and the
others are read all the same.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from loopcal.errors import InputError, listed
from loopcal.files.cameras.corner_table import CornerTable
from loopcal.files.cameras.corners import split_name
from loopcal.files.guarded import Stopped, guarded
from loopcal.files.tables.raw import existing_file
from loopcal.mechanisms.cameras.board import Board

ENDINGS = frozenset(
    (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm", ".ppm", ".webp", ".jp2")
)
_FOLDERS = 2
"""Levels of folders: images, or a folder of images per camera."""


@dataclass(frozen=True, eq=False)
class Detection:
    """corners: of all images that show the board; missed: image -> why it has none."""

    corners: CornerTable
    missed: Mapping[str, str]


def detect(images: str | Path | Iterable[str | Path], board: Board) -> Detection:
    """The corners of a board in images, by their names as `split_name` takes them apart.

    images: a folder, or files. Pixels are those of the file: a turn that a camera only notes (EXIF)
    is left out. sds are those that the noise of the image explains, NaN where it cannot be known.
    Raises InputError without OpenCV, without images, for a
    board whose pattern is not stated, and where no image shows it.
    """
    if find_spec("cv2") is None:
        raise InputError(
            "images are read by OpenCV, which is not installed",
            code="missing-dependency",
            remedy="pip install 'loopcal[images]'",
        ).then("pip install 'loopcal[images]'")
    if board.pattern is None:
        raise InputError(
            f"how the board {board.name!r} is printed is not stated",
            code="missing-key",
            remedy='state its type: board = { type = "checkerboard", columns = 9, ... }',
        )
    files = _files(images)
    # Images of one camera each may lie in a folder that has its name.
    parents = [path.parent for path in files]
    if isinstance(images, str | Path) and Path(images).is_dir():
        parents = [Path(images)]
    folder = Path(os.path.commonpath([os.path.abspath(one) for one in parents]))
    rows: list[tuple[str, str, str, float, float, float]] = []
    missed: dict[str, str] = {}
    sizes: dict[str, tuple[int, int]] = {}
    for path in files:
        name = Path(os.path.abspath(path)).relative_to(folder).as_posix()
        arguments = {"path": str(path.absolute()), "pattern": asdict(board.pattern)}
        try:
            answer = guarded(f"{_READER}:packed", arguments, path.stat().st_size)
        except (Stopped, InputError) as why:
            missed[name] = str(getattr(why, "message", why))
            continue
        seen = json.loads(answer)
        image, camera = split_name(name)
        size = sizes.setdefault(camera or "1", tuple(seen["size"]))
        if [*size] != seen["size"]:
            width, height = seen["size"]
            missed[name] = f"it has {width} x {height} px, and others {size[0]} x {size[1]}"
            continue
        if not seen["points"]:
            missed[name] = "the board is not seen in it"
        rows += [(image, camera or "1", *row) for row in seen["points"]]
    if not rows:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in [*missed.items()][:3])
        raise InputError(
            f"the board {board.name!r} is seen in none of {len(files)} images ({reasons})",
            code="no-data",
            place=str(images) if isinstance(images, str | Path) else None,
            remedy="check columns, rows and dictionary of the board, and whether it is legacy",
        )
    name_columns = list(zip(*(row[:3] for row in rows), strict=True))
    numbers = np.array([row[3:] for row in rows])
    corners = CornerTable(
        name_columns[0],
        name_columns[1],
        (board.name,) * len(rows),
        name_columns[2],
        numbers[:, 0],
        numbers[:, 1],
        numbers[:, 2] if np.isfinite(numbers[:, 2]).any() else None,
        file=str(images) if isinstance(images, str | Path) else "",
        sizes=tuple(sizes.items()),
    )
    return Detection(corners, missed)


_READER = "loopcal.files.cameras.detectors"


def _files(images: str | Path | Iterable[str | Path]) -> list[Path]:
    """The files of images as stated, or those in a folder."""
    place = None
    if not isinstance(images, str | Path):
        files = [existing_file(one) for one in images]
    elif not Path(images).is_dir():
        files = [existing_file(images)]
    else:
        place = str(images)
        patterns = ["/".join("*" * level) for level in range(1, _FOLDERS + 1)]
        every = sorted(one for pattern in patterns for one in Path(images).glob(pattern))
        files = [existing_file(one) for one in every if one.suffix.lower() in ENDINGS]
    if not files:
        raise InputError(
            "there is no image",
            code="no-data",
            place=place,
            remedy=f"name a folder with images ({listed(sorted(ENDINGS))})",
        )
    return files

"""A reader of tables: for which files, with which options, and how it is called."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from loopcal.files.tables.table import Table
from loopcal.keys import Key


@dataclass(frozen=True)
class Layout:
    """How a file is written: keys of [data], and keywords of `read_dataset`.

    What is not stated is recognised.
    """

    sheet: Annotated[str | int | None, Key("XLSX: name or number from 1.")] = None
    variable: Annotated[str | None, Key("MATLAB: name of the variable.")] = None
    topic: Annotated[str | None, Key("ROS bag: the only measuring topic.")] = None
    header: Annotated[bool | None, Key("Text: whether the first row holds names.")] = None
    delimiter: Annotated[str | None, Key("Text: between the cells.", example=";")] = None
    decimal: Annotated[str | None, Key("Text: decimal mark.", choices=(".", ","))] = None
    encoding: Annotated[str | None, Key("Text: its encoding.", example="utf-8")] = None
    spread: Annotated[
        Mapping[str, str] | None,
        Key(
            "Columns of a table that has a row for each point of an image: pose, camera, board, "
            "point, u, v. Its readings are then CAMERA:BOARD:POINT:u and :v, without what has no "
            "column.",
            choices=("pose", "camera", "board", "point", "u", "v"),
            example={"pose": "pose", "camera": "camera", "point": "corner", "u": "u", "v": "v"},
        ),
    ] = None

    @property
    def keywords(self) -> dict[str, Any]:
        """What is stated, as keywords of `read_dataset`."""
        options = {key: getattr(self, key) for key in Layout.__dataclass_fields__}
        return {key: value for key, value in options.items() if value is not None}


RECOGNISED = Layout()
"""Nothing is stated."""


@dataclass(frozen=True)
class Reader:
    """A kind of file that holds a table.

    kind: as messages call it; words: what is read of it, its row in docs/reference/project-file.md;
    endings: of names of its files; read(path, layout, wanted=...): the table, with at least the
    columns wanted (all of them for None); options: the keys of `Layout` that it takes; part: the
    option that names one of several tables; guarded: whether it runs in the guarded child, as
    others' code must; in_folder: pattern of the files that make a folder one of this kind;
    relatives: endings of files that look alike and are not read.
    """

    kind: str
    words: str
    endings: tuple[str, ...]
    read: Callable[..., Table]
    options: tuple[str, ...] = ()
    part: str = ""
    guarded: bool = True
    in_folder: str = ""
    relatives: tuple[str, ...] = ()

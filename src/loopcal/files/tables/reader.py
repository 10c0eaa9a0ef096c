"""A reader of tables: for which files, with which options, and how it is called."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypedDict

from loopcal.files.tables.table import Table


class Layout(TypedDict, total=False):
    """How a file is written, as keyword arguments; what is not stated is recognised."""

    sheet: str | int | None
    header: bool | None
    delimiter: str | None
    decimal: str | None
    encoding: str | None
    variable: str | None
    topic: str | None


@dataclass(frozen=True)
class Reader:
    """A kind of file that holds a table.

    kind: as messages call it; words: what is read of it, its row in docs/reference/project-file.md;
    endings: of names of its files; read(path, *, wanted, **options): the table, with at least the
    columns wanted (all of them for None); options: those of `Layout` that it takes; part: the
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

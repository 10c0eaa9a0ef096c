"""A format of an export: its name, what it needs of a machine, and how its files are written."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from loopcal.document.exported import Exported


@dataclass(frozen=True)
class ExportOptions:
    """source: the user's own file, where a format needs it; vendor: whose orientation convention
    tables of frames follow, a name of ORIENTATIONS; counts: joint -> encoder counts per degree or
    mm."""

    source: Path | None = None
    vendor: str | None = None
    counts: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class ExportFiles:
    """files: name -> content; warnings: what the user must know of them."""

    files: Mapping[str, str | bytes]
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class Format:
    """A format of an export.

    label: what it is; user: who takes it; then: what that user does with its files; these three
    make its row in docs/how-to/enter-into-the-controller.md. write: its files; needs: "parameters"
    of any machine, "chain" of a serial arm, "origins" of one described by joint origins, or
    "zeros", of an arm with a measured point;
    source: what --source names, empty where nothing; optional: whether it may be absent; nominal:
    whether it is for a controller that keeps its nominal geometry; described: whether the source is
    the file that the machine was read from, taken from the project where --source is not stated;
    options: "offsets", "vendor" or "counts", where it takes them.
    """

    name: str
    label: str
    user: str
    then: str
    write: Callable[[Exported, ExportOptions], ExportFiles]
    needs: str = "chain"
    source: str = ""
    optional: bool = False
    nominal: bool = False
    described: bool = False
    options: tuple[str, ...] = ()

"""A format of an export: its name, what it needs of a machine, and how its files are written."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from loopcal.document.exported import Exported
from loopcal.files.atomic import write_files


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
    of any machine, "chain" of a serial arm, "origins" of one described by joint origins,
    "zeros", of an arm with a measured point, "cameras" of any machine with a camera, "eyes" of one
    with a camera or hand-eye samples, or "places", one of "zeros" and "eyes";
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


# Files of an export put where they belong: never over another file unless that is asked for.


@dataclass(frozen=True)
class PlacedFiles:
    """written: files with new content; unchanged: that had it; backups: of those replaced."""

    folder: Path
    written: tuple[str, ...]
    unchanged: tuple[str, ...]
    backups: tuple[str, ...]


def place_files(folder: str | Path, files: Mapping[str, bytes]) -> PlacedFiles:
    """Write files into a folder, all or none; a file that is there with the same content stays.

    Raises InputError for a file with another content, unless the user asked to replace it.
    """
    folder = Path(folder)
    present = {n for n in files if (folder / n).is_file()}
    same = tuple(n for n in files if n in present and (folder / n).read_bytes() == files[n])
    new = {n: c for n, c in files.items() if n not in same}
    backups = write_files(folder, new) if new else ()
    return PlacedFiles(folder, tuple(new), same, tuple(path.name for path in backups))

"""Files of an export put where they belong: never over another file unless that is asked for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from loopcal.files.atomic import write_files


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

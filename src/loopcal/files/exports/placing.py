"""Files of an export put where they belong: never over another file unless that is asked for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from loopcal.errors import InputError
from loopcal.files.atomic import write_files


@dataclass(frozen=True)
class PlacedFiles:
    """written: files with new content; unchanged: that had it; backups: of those replaced."""

    folder: Path
    written: tuple[str, ...]
    unchanged: tuple[str, ...]
    backups: tuple[str, ...]


def place_files(
    folder: str | Path, files: Mapping[str, str | bytes], *, force: bool
) -> PlacedFiles:
    """Write files into a folder, all or none.

    A file that is there with the same content stays. Another content is replaced only where `force`
    says so, and kept as NAME.bak (NAME.bak2, ... where that exists). Raises InputError otherwise.
    """
    folder = Path(folder)
    contents = {n: c.encode() if isinstance(c, str) else c for n, c in files.items()}
    there = {n: (folder / n).read_bytes() for n in contents if (folder / n).is_file()}
    same = tuple(n for n, old in there.items() if old == contents[n])
    replaced = [n for n in there if n not in same]
    if replaced and not force:
        raise InputError(
            f"{replaced[0]!r} exists already, with another content",
            code="unwritable-file",
            place=str(folder / replaced[0]),
            remedy="state --force to replace it (a backup is kept), or name another folder with "
            "--out",
        )
    backups = {_free(folder, n): there[n] for n in replaced}
    new = {n: c for n, c in contents.items() if n not in same}
    if new:
        write_files(folder, backups | new)
    return PlacedFiles(folder, tuple(new), same, tuple(backups))


def _free(folder: Path, name: str) -> str:
    number = 1
    while (folder / (free := f"{name}.bak{'' if number == 1 else number}")).exists():
        number += 1
    return free

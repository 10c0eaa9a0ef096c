"""One server at a time on a folder: a lock that ends with the process that holds it."""

from __future__ import annotations

import os
from pathlib import Path
from typing import BinaryIO

from loopcal.errors import InputError
from loopcal.files.paths import leads_into

NAME = ".loopcal-app.lock"
_PLACE = 1 << 30
"""The byte that is locked on Windows, behind what others may read."""


class FolderLock:
    """Held from its making until `release`, or until the process ends in whatever way.

    Raises InputError where another process holds it, with the address it wrote, and where the
    folder cannot be written. On a file system without locks it excludes nobody.
    """

    def __init__(self, folder: Path, address: str) -> None:
        path = folder / NAME
        if not leads_into(path, folder):
            raise InputError(
                "leads out of the folder",
                code="unwritable-file",
                place=str(path),
                remedy="remove this link",
            )
        try:
            # Not truncated: a file that another app has locked states its address.
            self._file: BinaryIO = path.open("r+b" if path.exists() else "w+b")
        except OSError as error:
            raise InputError(
                f"cannot be written: {error.strerror or error}",
                code="unwritable-file",
                place=str(folder),
                remedy="choose a folder with write permission",
            ) from None
        if not _taken(self._file):
            held = self._file.read(200).decode("utf-8", "replace").strip()
            self._file.close()
            raise InputError(
                f"another app serves this folder already, at {held}",
                code="unwritable-file",
                place=str(folder),
                remedy="open that address, or end that app first",
            )
        self._file.truncate(0)
        self._file.write(address.encode())
        self._file.flush()

    def release(self) -> None:
        """Let others have the folder."""
        self._file.close()


def _taken(file: BinaryIO) -> bool:
    """Whether the lock is ours now; also where the file system has none."""
    try:
        if os.name == "nt":
            import msvcrt

            file.seek(_PLACE)
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]
            file.seek(0)
        else:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        file.seek(0)
        return False
    except OSError:
        file.seek(0)
    return True

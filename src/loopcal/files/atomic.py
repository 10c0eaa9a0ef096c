"""Files written whole or not at all.

Everything is written under temporary names in the same folder and forced to the disk; only then
do the files take their names, one rename each. Whatever goes wrong before the end is undone: the
temporary files vanish, and files that were there before have their old contents.
"""

from __future__ import annotations

import errno
import os
import secrets
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from loopcal.errors import InputError

_NO_SPACE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_NO_RIGHT = (errno.EACCES, errno.EPERM, errno.EROFS)


def write_atomic(path: str | Path, data: str | bytes) -> None:
    """Write one file (text as UTF-8), whole or not at all; its folder is made if need be.

    A device or pipe is written to as it is. Raises InputError, with the reason and a remedy, when
    it cannot be written.
    """
    path = Path(os.path.realpath(path))
    if os.path.exists(path) and not path.is_file() and not path.is_dir():
        try:
            path.write_bytes(_bytes(data))
        except OSError as error:
            raise _unwritable(path, error) from None
        return
    write_files(path.parent, {path.name: data})


def write_files(
    folder: str | Path, files: Mapping[str, str | bytes], *, remove: Sequence[str] = ()
) -> None:
    """Write several files (name -> contents, text as UTF-8) into one folder, all or none.

    The folder is made if need be; files to remove go, where they are, as the others come. Raises
    InputError, naming the file, the reason and a remedy.
    """
    work = _Work(Path(folder))
    try:
        work.make_folder()
        for name, data in files.items():
            work.write(name, _bytes(data))
        work.rename()
        work.remove(remove)
    except OSError as error:
        work.undo()
        raise _unwritable(work.current, error) from None
    except BaseException:
        work.undo()
        raise
    work.forget_old()


@dataclass
class _Work:
    """What has been done so far, so that it can be undone."""

    folder: Path
    made: list[Path] = field(default_factory=list)
    temporary: dict[str, Path] = field(default_factory=dict)
    old: dict[str, Path] = field(default_factory=dict)
    renamed: list[str] = field(default_factory=list)
    current: Path = field(init=False)

    def __post_init__(self) -> None:
        self.current = self.folder

    def make_folder(self) -> None:
        missing = [p for p in (self.folder, *self.folder.parents) if not p.exists()]
        for path in reversed(missing):
            path.mkdir(exist_ok=True)
            self.made.append(path)

    def write(self, name: str, data: bytes) -> None:
        self.current = self.folder / name
        if self.current.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        path = self.folder / f".{name}.{secrets.token_hex(6)}.part"
        self.temporary[name] = path
        with path.open("xb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())

    def rename(self) -> None:
        for name, path in self.temporary.items():
            self.current = target = self.folder / name
            if target.exists():
                keep = path.with_suffix(".old")
                _keep(target, keep)
                self.old[name] = keep
            path.replace(target)
            self.renamed.append(name)
        _sync_folder(self.folder)

    def remove(self, names: Sequence[str]) -> None:
        for name in names:
            self.current = target = self.folder / name
            if target.is_file():
                keep = self.folder / f".{name}.{secrets.token_hex(6)}.old"
                target.replace(keep)
                self.old[name] = keep

    def undo(self) -> None:
        for name in self.renamed:
            if name not in self.old:
                with suppress(OSError):
                    (self.folder / name).unlink()
        for name, keep in self.old.items():
            with suppress(OSError):
                keep.replace(self.folder / name)
        for path in self.temporary.values():
            with suppress(OSError):
                path.unlink()
        for path in reversed(self.made):
            with suppress(OSError):
                path.rmdir()

    def forget_old(self) -> None:
        for keep in self.old.values():
            with suppress(OSError):
                keep.unlink()


def _keep(target: Path, keep: Path) -> None:
    """A second name for a file, so that its first is never absent; where links exist at all."""
    try:
        os.link(target, keep)
    except OSError:
        target.replace(keep)


def _sync_folder(folder: Path) -> None:
    with suppress(OSError):  # some systems have no such thing
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _bytes(data: str | bytes) -> bytes:
    return data.encode("utf-8") if isinstance(data, str) else data


def _unwritable(path: Path, error: OSError) -> InputError:
    """Why a file cannot be written, and what to do, in the user's words."""
    if error.errno in _NO_SPACE:
        why, remedy = "the disk is full", "free some space, or choose another folder"
    elif error.errno in _NO_RIGHT:
        why, remedy = "no permission to write here", "choose a folder with write permission"
    elif error.errno == errno.EISDIR:
        why, remedy = "a folder has this name", "choose another name"
    elif error.errno in (errno.ENOTDIR, errno.EEXIST):
        why, remedy = "a file has the name of a needed folder", "choose another folder"
    elif error.errno == errno.ENAMETOOLONG:
        why, remedy = "the name is too long", "choose a shorter name"
    else:
        why, remedy = f"{error.strerror or error}", "choose another folder"
    return InputError(
        f"cannot be written: {why}; nothing was changed",
        code="unwritable-file",
        place=str(path),
        remedy=remedy,
    )

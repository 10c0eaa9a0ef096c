"""Files written whole or not at all.

Everything is written under temporary names in the same folder and forced to the disk; only then
do the files take their names, one rename each. Whatever goes wrong before the end is undone: the
temporary files vanish, and files that were there before have their old contents. What a killed run
has left in a folder, the next run that writes there completes or removes.
"""

from __future__ import annotations

import errno
import os
import re
import secrets
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from loopcal.errors import InputError
from loopcal.files.outputs import free_name, is_foreign, refuse_outside

_NO_SPACE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_NO_RIGHT = (errno.EACCES, errno.EPERM, errno.EROFS)
_LEFT = re.compile(r"\.(.+)\.([0-9a-f]{12})\.(part|old)", re.DOTALL)
_WHOLE = "loopcal"
Data = str | bytes


def write_atomic(path: str | Path, data: Data, *, anything: bool = False) -> None:
    """Write one file, as `write_all`."""
    write_all({Path(path): data}, anything=anything)


def write_files(folder: str | Path, files: Mapping[str, Data]) -> tuple[Path, ...]:
    """Write several files (name -> contents) into one folder, as `write_all`."""
    return write_all({Path(folder) / name: data for name, data in files.items()})


def write_all(
    files: Mapping[Path, Data],
    *,
    remove: Iterable[Path] = (),
    new: Iterable[Path] = (),
    anything: bool = False,
) -> tuple[Path, ...]:
    """Write several files (text as UTF-8), all or none, and return the backups that were kept.

    Folders are made if need be; links stay links; files to remove go, where they are, as the others
    come. new: those that must not exist, or FileExistsError. A device or pipe is written to as it
    is. A file is replaced or removed only as `files.outputs` allows, unless `anything` is.

    In each folder the files come in this order; what goes does so behind the first. Raises
    InputError, naming the file, the reason and a remedy.
    """
    removed = tuple(remove)
    for path in (*files, *removed):
        refuse_outside(path, str(path), str(path))
    real = {Path(os.path.realpath(path)): _bytes(data) for path, data in files.items()}
    devices = [path for path in real if _is_device(path)]
    gone = [Path(os.path.realpath(path.parent)) / path.name for path in removed]
    exclusive = {Path(os.path.realpath(path)) for path in new}
    folders = {path.parent for path in real if path not in devices} | {p.parent for p in gone}
    works = {folder: _Work(folder) for folder in sorted(folders)}  # all lock in one order
    current = next(iter(real), Path())
    try:
        for folder, work in works.items():
            current = folder
            work.open()
        for current in real:
            if current.is_dir():
                raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        for path, data in real.items():
            current = path
            if path not in devices:
                work, names = works[path.parent], {p.name: d for p, d in real.items()}
                if path.is_file() and not anything and is_foreign(path, data, names.get):
                    work.backups[path.name] = free_name(path)
                work.write(path.name, data, exclusive=path in exclusive)
        for path in gone:
            if path.is_file():
                current = path
                if is_foreign(path, None, lambda _: None):
                    works[path.parent].backups[path.name] = free_name(path)
                works[path.parent].removed.append(path.name)
        for path in devices:
            current = path
            path.write_bytes(real[path])
        # One rename is atomic by itself; only several of them, or a backup, need a way back.
        if len(real) + len(gone) > 1 or any(work.backups for work in works.values()):
            for work in works.values():
                work.begin_renames()
                for current in work.each():
                    work.keep(current)
        for work in works.values():
            for current in work.each():
                work.rename(current)
        for work in works.values():
            _sync_folder(work.folder)
    except FileExistsError as error:
        _undo(works.values())
        if current in exclusive:
            raise
        raise unwritable(current, error) from None
    except OSError as error:
        _undo(works.values())
        raise unwritable(current, error) from None
    except BaseException:
        _undo(works.values())
        raise
    for work in works.values():
        work.close()
    return tuple(path for work in works.values() for path in work.backups.values())


def _undo(works: Iterable[_Work]) -> None:
    for work in works:
        work.undo()
        work.close()
    for work in reversed(list(works)):
        for path in reversed(work.made):
            with suppress(OSError):
                path.rmdir()


@dataclass
class _Work:
    """What has been done so far in one folder, so that it can be undone."""

    folder: Path
    tag: str = field(default_factory=lambda: secrets.token_hex(6))
    made: list[Path] = field(default_factory=list)
    temporary: dict[str, Path] = field(default_factory=dict)
    removed: list[str] = field(default_factory=list)
    exclusive: set[str] = field(default_factory=set)
    backups: dict[str, Path] = field(default_factory=dict)
    old: dict[str, Path] = field(default_factory=dict)
    renamed: list[str] = field(default_factory=list)
    mark: Path | None = None
    lock: int | None = None

    def open(self) -> None:
        """Make the folder, keep other runs out of it, and clear up after dead ones."""
        missing = [p for p in (self.folder, *self.folder.parents) if not p.exists()]
        for path in reversed(missing):
            path.mkdir(exist_ok=True)
            self.made.append(path)
        self.lock = _locked(self.folder)
        # Without the lock the remains could belong to a run that is still alive.
        if self.lock is not None:
            with suppress(OSError):
                _clear_up(self.folder)

    def write(self, name: str, data: bytes, *, exclusive: bool) -> None:
        """Write a file under its temporary name."""
        path = self.folder / f".{name}.{self.tag}.part"
        self.temporary[name] = path
        if exclusive:
            self.exclusive.add(name)
        with path.open("xb") as file:
            file.write(data)
            file.flush()
            # A rename may reach the disk ahead of the content: power loss would leave it empty.
            os.fsync(file.fileno())

    def each(self) -> list[Path]:
        """The files that come or go: the first and the last one come."""
        first, *rest = [*self.temporary] or [""]
        names = (first, *self.removed, *rest) if first else self.removed
        return [self.folder / name for name in names]

    def begin_renames(self) -> None:
        """Say that all new files are whole: should this run die now, the next completes it."""
        self.mark = self.folder / f".{_WHOLE}.{self.tag}.old"
        self.mark.touch(exist_ok=False)

    def keep(self, path: Path) -> None:
        """Second names for a file that is there, so that its first is never absent."""
        if path.name in self.exclusive or not path.exists():
            return
        keep = self.folder / f".{path.name}.{self.tag}.old"
        if _linked(path, keep):
            self.old[path.name] = keep
        if path.name in self.backups and not _linked(path, self.backups[path.name]):
            with self.backups[path.name].open("xb") as file:
                file.write(path.read_bytes())

    def rename(self, path: Path) -> None:
        """A file takes its name, or goes."""
        name = path.name
        if name in self.exclusive:
            # A link fails where the name is taken; a rename would replace that file silently.
            os.link(self.temporary[name], path)
            self.renamed.append(name)
            self.temporary[name].unlink()
            return
        if self.mark and path.exists() and name not in self.old:  # where there are no links
            keep = self.folder / f".{name}.{self.tag}.old"
            path.replace(keep)
            self.old[name] = keep
        if name in self.temporary:
            self.temporary[name].replace(path)
            self.renamed.append(name)
        else:
            path.unlink(missing_ok=True)

    def undo(self) -> None:
        """Everything as it was."""
        # The mark goes first: with it the next run would complete what is undone here.
        self.forget_mark()
        for name in self.renamed:
            if name not in self.old:
                with suppress(OSError):
                    (self.folder / name).unlink()
        for name, keep in self.old.items():
            with suppress(OSError):
                if name in self.renamed or not (self.folder / name).exists():
                    keep.replace(self.folder / name)
        for path in (*self.temporary.values(), *self.backups.values()):
            with suppress(OSError):
                path.unlink()

    def close(self) -> None:
        """Forget what was kept, and let other runs in."""
        # The mark goes last: without it the next run would bring the old files back.
        for keep in self.old.values():
            with suppress(OSError):
                keep.unlink()
        self.forget_mark()
        if self.lock is not None:
            os.close(self.lock)
            self.lock = None

    def forget_mark(self) -> None:
        if self.mark is not None:
            with suppress(OSError):
                self.mark.unlink()
            self.mark = None


def clear_up(folder: Path) -> None:
    """Complete or remove what dead runs have left in a folder, as whoever writes there does."""
    lock = _locked(folder)
    if lock is not None:
        with suppress(OSError):
            _clear_up(folder)
        os.close(lock)


def _locked(folder: Path) -> int | None:
    """A lock on the folder, which ends with this process; None where there are no such locks."""
    try:
        import fcntl

        handle = os.open(folder, os.O_RDONLY)
    except (ImportError, OSError):
        return None
    try:
        # flock ends with the process, however that dies; a lock file would remain.
        fcntl.flock(handle, fcntl.LOCK_EX)
    except OSError:
        os.close(handle)
        return None
    except BaseException:
        os.close(handle)
        raise
    return handle


def _clear_up(folder: Path) -> None:
    """Complete the runs that died once all their new files were whole, and undo the others."""
    left: dict[str, dict[str, dict[str, Path]]] = {}
    for path in sorted(folder.glob(".*")):
        match = _LEFT.fullmatch(path.name)
        if match and path.is_file():
            kinds = left.setdefault(match[2], {"part": {}, "old": {}})
            kinds[match[3]][match[1]] = path
    for kinds in left.values():
        parts, olds = kinds["part"], kinds["old"]
        mark = olds.pop(_WHOLE, None)
        for name, part in parts.items():
            if mark is None:
                part.unlink()
            else:
                part.replace(folder / name)
        for name, old in olds.items():
            path = folder / name
            if mark is None:
                old.replace(path)
            elif name not in parts and path.exists() and path.samefile(old):
                path.unlink()  # it was to be removed
            old.unlink(missing_ok=True)
        if mark is not None:
            mark.unlink()


def _linked(target: Path, other: Path) -> bool:
    """Whether the file now has a second name."""
    try:
        os.link(target, other)
    except OSError:
        return False
    return True


def _is_device(path: Path) -> bool:
    return os.path.exists(path) and not path.is_file() and not path.is_dir()


def _sync_folder(folder: Path) -> None:
    with suppress(OSError):  # some systems have no such thing
        handle = os.open(folder, os.O_RDONLY)
        try:
            # A rename is durable only once its folder is on the disk (POSIX).
            os.fsync(handle)
        finally:
            os.close(handle)


def _bytes(data: Data) -> bytes:
    return data.encode("utf-8") if isinstance(data, str) else data


def unwritable(path: Path, error: OSError) -> InputError:
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

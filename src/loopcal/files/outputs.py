"""What may be written over: files of the same kind that loopcal wrote, and none that is read.

Most files say themselves what they are: pages by a meta element, JSON by its key "loopcal", TOML by
its first line, tables by columns that only loopcal writes. Tables in the columns of a project do
not: NAME.json or NAME.truth.json beside lists their SHA-256. A new project is meant to be changed;
its last lines list the SHA-256 of its files. All others, such as programs of robots and files that
were changed since, count as the user's.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, field
from functools import wraps
from hashlib import file_digest, sha256
from pathlib import Path
from typing import ParamSpec, TypeVar

from loopcal.errors import InputError
from loopcal.files.toml.place import Place

Arguments = ParamSpec("Arguments")
Returned = TypeVar("Returned")
REMEDY = "name another output, or state --force (force=True) to replace it; a backup is kept"
_FOREIGN = "it was changed since loopcal wrote it, or is of another origin"
_WINDOW = 1 << 16
"""Bytes at either end of a file in which its mark stands."""
_PAGE = re.compile(rb'<meta name="loopcal(?:-(record))?" content="([a-z-]+|[0-9a-f]{64})">')
_OLD_REPORT = b'<meta name="generator" content="loopcal '
"""Of pages of versions before 0.2, which were reports or records."""
_SEAL = b"# loopcal init replaces its files while they are unchanged. SHA-256:\n"
_SEALED = re.compile(rb"\n" + re.escape(_SEAL) + rb"(?P<files>(?:#   .+\n)+)\Z")
_PROJECT = "project.toml"
_MARKS = {
    "certificate": re.compile(rb'<record xmlns="urn:loopcal:record"'),
    "JSON": re.compile(rb'\A\{\s*"schema": \d+,\s*"loopcal": "[^"\n]*"(?!,\s*"name")'),  # no export
    "progress": re.compile(rb'\A\{\s*"task": "[^"\n]*",\s*"checkpoint": '),
    "mechanism": re.compile(rb"\A# [^\n]*: a mechanism file of loopcal, made by it\."),
    "start": re.compile(rb"\A# Where the next machine of this type begins: "),
    "prediction": re.compile(rb"\A(?:[^\n]*,|[^\n]*\t|PAR1.*)extrapolated\b", re.DOTALL),
    "residuals": re.compile(rb"\A(?:pose[,\t]|PAR1.*)residual [^\n]* before\b", re.DOTALL),
    "draws": re.compile(rb"\APAR1.*other_optimum", re.DOTALL),
}


@dataclass
class Command:
    """What a command has read so far, by device and number of the file; force: replace others."""

    force: bool = False
    read: set[tuple[int, int]] = field(default_factory=set)


_COMMAND: ContextVar[Command | None] = ContextVar("command", default=None)


@contextmanager
def command(*, force: bool | None = None) -> Iterator[Command]:
    """What is read within this counts as input of one command, and is not written over.

    force: whether files of others are replaced, as the command around this says where it is None.
    """
    around = _COMMAND.get()
    if around is None:
        inner = Command(bool(force))
    else:
        inner = Command(around.force if force is None else force, around.read)
    token = _COMMAND.set(inner)
    try:
        yield inner
    finally:
        _COMMAND.reset(token)


def one_command(function: Callable[Arguments, Returned]) -> Callable[Arguments, Returned]:
    """The function as one command; its argument `force` says whether files of others are
    replaced."""

    @wraps(function)
    def within(*arguments: Arguments.args, **options: Arguments.kwargs) -> Returned:
        with command(force=bool(options.get("force")) or None):
            return function(*arguments, **options)

    return within


@contextmanager
def carried_over() -> Iterator[None]:
    """What is read within this may be written over by what follows from it."""
    token = _COMMAND.set(None)
    try:
        yield
    finally:
        _COMMAND.reset(token)


def force_outputs() -> None:
    """Let the command under way replace files of others; backups are kept."""
    under_way = _COMMAND.get()
    if under_way is not None:
        under_way.force = True


def note_input(path: Path) -> None:
    """The command under way reads this file."""
    under_way = _COMMAND.get()
    if under_way is not None:
        with suppress(OSError):
            under_way.read.add(_identity(path))


def sealed(files: Mapping[str, bytes]) -> dict[str, bytes]:
    """The files of a new project, whose last lines list them, and so tell when they are changed."""
    listed = b"".join(_listed(name, content) for name, content in files.items())
    return {**files, _PROJECT: files[_PROJECT] + b"\n" + _SEAL + listed}


def refuse_foreign(*paths: Path) -> None:
    """Raise InputError, before any work, where one of these files is there and is not loopcal's."""
    for path in paths:
        if path.is_file() and not _forced():
            _refuse_input(path)
            if kind_of(path.name, _window(path), _digest(path), _beside(path)) is None:
                raise _refused(path, _FOREIGN)


def is_foreign(path: Path, new: bytes | None, together: Callable[[str], bytes | None]) -> bool:
    """Whether a file that is there must be kept as a backup, if it gives way to `new`.

    new: None where it is deleted; together: content of the files that are written with it, by name.
    Raises InputError for such a file where the user did not ask to replace it.
    """
    # The same bytes lose nothing, even where the file is an input.
    if new is not None and path.stat().st_size == len(new) and path.read_bytes() == new:
        return False
    old = kind_of(path.name, _window(path), _digest(path), _beside(path))
    if new is None:
        allowed = old is not None
    else:
        wanted = kind_of(path.name, _ends(new), lambda: sha256(new).hexdigest(), together)
        allowed = old is not None and old == wanted
    if _forced():
        return not allowed or _is_input(path)
    _refuse_input(path)
    if not allowed:
        why = _FOREIGN
        raise _refused(path, why if old is None else f"it holds another result of loopcal ({old})")
    return False


def kind_of(
    name: str, window: bytes, digest: Callable[[], str], beside: Callable[[str], bytes | None]
) -> str | None:
    """What loopcal calls this file; None where loopcal did not write it.

    window: of its bytes; beside: content of the files in its folder, by name.
    """
    page = _PAGE.search(window) if b"<meta" in window else None
    if page is not None:
        return "record" if page[1] else page[2].decode()
    if _OLD_REPORT in window:
        return "report"
    marked_kind = next((kind for kind, mark in _MARKS.items() if mark.search(window)), None)
    if marked_kind is not None:
        return marked_kind
    for end in (".json", ".truth.json"):
        listing = beside(f"{Path(name).stem}{end}") or b""
        if _MARKS["JSON"].search(listing[:_WINDOW]) and digest().encode() in listing:
            return f"table of *{end}"
    project = window if name == _PROJECT else beside(_PROJECT) or b""
    if seal := _SEALED.search(project):
        content = project[: seal.start()] if name == _PROJECT else None
        line = _listed(name, content) if content is not None else _line(name, digest())
        return "file of loopcal init" if line in seal["files"] else None
    return None


def _listed(name: str, content: bytes) -> bytes:
    return _line(name, sha256(content).hexdigest())


def _line(name: str, digest: str) -> bytes:
    return f"#   {digest}  {name}\n".encode()


def free_name(path: Path) -> Path:
    """NAME.bak beside a file, or NAME.bak2 and so on where those exist."""
    number = 1
    while os.path.lexists(free := path.with_name(f"{path.name}.bak{number if number > 1 else ''}")):
        number += 1
    return free


def _forced() -> bool:
    under_way = _COMMAND.get()
    return under_way is not None and under_way.force


def _is_input(path: Path) -> bool:
    under_way = _COMMAND.get()
    return under_way is not None and _identity(path) in under_way.read


def _refuse_input(path: Path) -> None:
    if _is_input(path):
        raise _refused(path, "this command reads it")


def _refused(path: Path, why: str) -> InputError:
    return InputError(
        f"the file exists and is kept: {why}",
        code="unwritable-file",
        place=str(path),
        remedy=REMEDY,
    ).offering("--force")


def _identity(path: Path) -> tuple[int, int]:
    status = path.stat()
    # Links and other spellings of a path lead to the same input.
    return status.st_dev, status.st_ino


def _ends(content: bytes) -> bytes:
    # The same parts as `_window` reads, or new content and old file would differ in kind.
    return content if len(content) <= 2 * _WINDOW else content[:_WINDOW] + content[-_WINDOW:]


def _window(path: Path) -> bytes:
    with path.open("rb") as file:
        first = file.read(2 * _WINDOW)
        size = file.seek(0, os.SEEK_END)
        if size <= 2 * _WINDOW:
            return first
        file.seek(-_WINDOW, os.SEEK_END)
        return first[:_WINDOW] + file.read(_WINDOW)


def _digest(path: Path) -> Callable[[], str]:
    def digest() -> str:
        with path.open("rb") as file:
            return file_digest(file, "sha256").hexdigest()

    return digest


def _beside(path: Path) -> Callable[[str], bytes | None]:
    def content(name: str) -> bytes | None:
        try:
            return path.with_name(name).read_bytes()
        except OSError:
            return None

    return content


# Paths as files state them: relative to the file, with variables of the environment.

INSIDE = "LOOPCAL_INSIDE"
"""Environment variable with the folder outside of which files may name no others."""
_VARIABLE = re.compile(r"\$\{(\w+)\}")


def expanded(path: str, folder: Path, place: Place) -> Path:
    """A path of a file, ${NAME} replaced by the environment, relative to the folder.

    Raises InputError naming a variable that is not set, and for a path that leads out of the
    folder in `INSIDE`.
    """
    for name in _VARIABLE.findall(path):
        if not os.environ.get(name):
            raise InputError(
                f"the path {path!r} needs the environment variable {name}, which is not set",
                code="missing-file",
                place=str(place),
                remedy=f"set it to the folder: export {name}=/path/to/folder",
            )
    joined_path = folder / Path(_VARIABLE.sub(lambda match: os.environ[match[1]], path))
    refuse_outside(joined_path, path, str(place))
    # nothing leads through a folder that is not there
    return joined_path if folder.is_dir() else Path(os.path.normpath(joined_path))


def refuse_outside(path: Path, named: str, place: str) -> None:
    """Raise InputError for a path that leads out of the folder in `INSIDE`, by whatever links.

    named: the path as the user wrote it; place: where.
    """
    inside = os.environ.get(INSIDE)
    if inside and not leads_into(path, Path(inside)):
        raise InputError(
            f"the path {named!r} leads out of the folder {inside}",
            code="missing-file",
            place=place,
            remedy="copy the file into the folder and name it there (a link does not do), or open "
            "the folder that holds both",
        )


def leads_into(path: str | Path, folder: Path) -> bool:
    """Whether a path ends in a folder, or in one inside it, when all links are followed."""
    return Path(os.path.realpath(path)).is_relative_to(os.path.realpath(folder))


def relative(path: str | Path, folder: str | Path) -> str:
    """A path as a file in a folder states it; absolute where no relative one leads there."""
    try:
        return Path(os.path.relpath(path, folder)).as_posix()
    except ValueError:  # another drive
        return Path(path).resolve().as_posix()

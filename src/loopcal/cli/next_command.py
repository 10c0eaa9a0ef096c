"""The command that follows an error, filled in with the files of the user.

The error states it where it is raised: options, a word that was meant, another command. Words in
capitals (PROJECT, RESULT, READINGS, ROBOT) become files below the folder of the command. Where
nothing else follows, the same command is run again after the remedy, or its help.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from itertools import islice, pairwise
from pathlib import Path
from shlex import join, quote, split
from typing import Any

from loopcal.errors import InputError, LoopcalError, NoTrustworthyResult, closest

_MOST = 2_000
"""Entries of folders that are looked at: the command may run in a large one."""
_TABLES = (".csv", ".tsv", ".xlsx", ".parquet")
_RESULT = "result.json"
_ROBOT = ("--urdf", "--dh", "--machine")
_OTHER_FILE = ("missing-file", "wrong-file-type", "no-data", "invalid-syntax", "missing-column")
_OF_PROJECTS = ("calibrate", "check", "plan", "simulate")
_OF_RESULTS = ("predict", "compare", "report", "export", "verify", "update", "correct", "record")
_CAPITALS = re.compile(r"[A-Z]{2,}(?:\.[a-z]+|\.{3})?")
_OPTION = re.compile(r"--[a-z][a-z-]+")
_NUMBER = re.compile(r"\d+(?:\.\d+)?")


def fill_in(error: LoopcalError, words: Sequence[str]) -> None:
    """Give the error the command to type next; words: of the command that failed.

    A result that is not trusted keeps the commands of its verdict.
    """
    if error.command or isinstance(error, NoTrustworthyResult) or not words:
        return
    if not _typeable(words):
        error.again = False
        return
    if [*words] == ["init"] and _tables(words):
        error.options = ("READINGS", "ROBOT")
    error.options = tuple(_filled(error.options, words))
    error.next_command(words)
    if not error.again:
        if words[0] == "init" and not {*_ROBOT} & {*split(error.command)}:
            error.command = f"{error.command} {_robot(words)}".strip()
        return
    error.again = False
    begins, *rest = split(error.follows) or [""]
    follows = [begins, *_filled(rest, words)]
    every = (follows, _placed(error, words), _whole_day(error, words), _before(error, words))
    for mended in every:
        if len(mended) > 1:
            error.command = join(mended)
            return
    # A file is mended for the same command; other arguments, and further ones, need its help.
    further = {*_OPTION.findall(error.remedy or "")} - {*words}
    error.again = isinstance(error, InputError) and not further
    error.command = join(["loopcal", *(words if error.again else [*words[:1], "--help"])])


def after_usage(error: Any, words: Sequence[str]) -> str:
    """The command after arguments that do not parse; error: as typer raises it."""
    from loopcal.cli.registry import COMMANDS

    command = words[0] if words and words[0] in COMMANDS else ""
    if not _typeable(words):
        return _help(command) if command else "loopcal --help"
    kind = type(error).__name__
    if not command:
        meant = closest(words[0], [*COMMANDS]) if words and not words[0].startswith("-") else None
        return join(
            ["loopcal", *([meant, *words[1:]] if meant else ["--help"] if words else ["demo"])]
        )
    mended: list[str] | None = None
    if kind == "NoSuchOption":
        name, names = error.option_name, sorted(getattr(error, "possibilities", None) or ())
        meant = closest(name.lstrip("-"), [other.lstrip("-") for other in names])
        near = [f"--{meant}"] if meant else []
        flags = {o for p in error.ctx.command.params for o in p.opts if getattr(p, "is_flag", 0)}
        after = [*words[words.index(name) + 1 :], "-"][0] if name in words else "-"
        if near and near[0] in flags and not after.startswith("-"):
            return _help(command)  # a value follows, and the flag takes none
        if command in _OF_PROJECTS and name in _ROBOT:
            return join(["loopcal", "init", *words[1:]])  # readings and a robot make a project
        if not near:
            return _help(command)
        mended = [m for w in words for m in (near if w.partition("=")[0] == name else [w])]
    elif kind == "MissingParameter":
        mended = _with_missing(error.param, words)
    elif kind == "BadParameter" and error.param is not None:
        mended = _with_number(error.param, words)
    elif command in _OF_PROJECTS:  # more arguments than a project
        typed = f"loopcal init {join([w for w in words[1:] if w.endswith(_TABLES)])}"
        robot = "" if "--urdf" in words else f" {_robot(words)}"
        return f"{typed}{robot}" if typed[-1] != " " and robot != " " else _help(command)
    return join(["loopcal", *mended]) if mended and mended != [*words] else _help(command)


def _typeable(words: Sequence[str]) -> bool:
    """Whether a terminal shows the words as they are; a command with others is not repeated."""
    return all(word.isprintable() for word in words)


def _help(command: str) -> str:
    return join(["loopcal", command, "--help"])


def _filled(parts: Sequence[str], words: Sequence[str]) -> list[str]:
    """The words with files for those in capitals; none where the folder has none for one."""
    made: list[str] = []
    for part in parts:
        names = _files(part, words) if _CAPITALS.fullmatch(part) else [part]
        if not names:
            return []
        made += names
    return made


def _placed(error: LoopcalError, words: Sequence[str]) -> list[str]:
    """The same command with a file of this folder for one that is absent or of another kind."""
    place = (error.place or "").removesuffix(f"/{_RESULT}").partition(": ")[0]
    if error.code not in _OTHER_FILE or place not in words[1:] or place.startswith("-"):
        return []
    at = len(words) - 1 - words[::-1].index(place)
    others = [w for w in words[1:] if w != place and _is_table(w)] if words[0] == "init" else []
    if others and words[at - 1] not in _ROBOT:
        robot = [] if {*_ROBOT} & {*words} else split(_robot(words))
        return ["loopcal", *words[:at], *words[at + 1 :], *robot]  # the others have readings
    ahead, behind = ["loopcal", *words[:at]], list(words[at + 1 :])
    if ahead[-1] == "--urdf" and _is_dh(place):
        return [*ahead[:-1], "--dh", place, *behind]
    if ahead[-1] in _ROBOT:
        robot = split(_robot([]))
        return [*ahead[:-1], *robot, *behind] if robot and place not in robot else []
    takes = "PROJECT" if words[0] in _OF_PROJECTS else "RESULT" if words[0] in _OF_RESULTS else ""
    takes = "READINGS" if words[0] == "init" else takes
    names = _files(takes, [w for w in words if w != place or takes == "PROJECT"])
    if words[0] == "init" and names and not {*_ROBOT} & {*words}:
        behind += split(_robot(words))
    if {*names} & {place, *behind}:  # a file that is named already is none instead
        return []
    return [*ahead, *names, *behind] if at == 1 and names else []


def _before(error: LoopcalError, words: Sequence[str]) -> list[str]:
    """The calibration that a command of results needs, where the folder has none."""
    if words[0] not in _OF_RESULTS or not str(error.place).endswith(_RESULT):
        return []
    projects = _newest(_is_project)[:1]
    return ["loopcal", "calibrate", *projects] if projects else []


def _whole_day(error: LoopcalError, words: Sequence[str]) -> list[str]:
    """All tables of the first day, or both of the folder, where only some of them were named."""
    first = {"init": 1, "predict": 2, "verify": 2, "update": 2}.get(words[0])
    if error.code != "missing-column" or first is None:
        return []
    tables = _tables(words)
    named = [i for i in range(first, len(words)) if words[i].endswith(_TABLES)]
    named = [i for i in named if first > 1 or not _is_dh(words[i])]  # the robot of `init` stays
    named = [i for i in named if words[i - 1] not in (*_ROBOT, "--out")]
    if not named or {words[i] for i in named} >= {*tables} or (first == 1 and len(tables) != 2):
        return []
    # The readings of a calibration cannot test it.
    if words[0] in ("verify", "update") and len(named) >= len(tables):
        return []
    rest = [word for i, word in enumerate(words) if i not in named[1:]]
    return ["loopcal", *rest[: named[0]], *tables, *rest[named[0] + 1 :]]


def _with_missing(param: Any, words: Sequence[str]) -> list[str] | None:
    """The words with an argument or option that is missing; None where nothing answers it."""
    metavar = str(getattr(param, "metavar", None) or param.name).strip("[]{}")
    names = _files(metavar.upper(), words)
    if not names and metavar == "PROJECT":
        tables, robot = _tables(words), _robot(words)
        return ["init", *tables, *split(robot)] if tables and robot else ["demo"]
    option = next((o for o in getattr(param, "opts", ()) if o.startswith("--")), None)
    if not names:
        return None
    return [*words, option, *names] if option else [words[0], *_positional(words, names)]


def _positional(words: Sequence[str], names: Sequence[str]) -> list[str]:
    """The arguments with further ones ahead of the first option."""
    rest = list(words[1:])
    first = next((i for i, word in enumerate(rest) if word.startswith("-")), len(rest))
    return [*rest[:first], *names, *rest[first:]]


def _with_number(param: Any, words: Sequence[str]) -> list[str]:
    """The words with the number that an option's value begins with, else without the option."""
    option = next((o for o in param.opts if o.startswith("--")), "")
    typed_value = next(
        (v for w, v in zip(words, [*words[1:], ""], strict=True) if w == option),
        next((w.partition("=")[2] for w in words if w.startswith(f"{option}=")), ""),
    )
    rest, number = _without(option, words), _NUMBER.match(typed_value)
    return [*rest, option, number[0]] if number and number[0] != typed_value else rest


def _without(option: str, words: Sequence[str]) -> list[str]:
    kept = [
        w for i, w in enumerate(words) if option not in (w.partition("=")[0], words[max(i - 1, 0)])
    ]
    return [*words[:1], *kept[1:]]


def _files(what: str, words: Sequence[str]) -> list[str]:
    """What stands for a word in capitals, newest first; none where this folder has none."""
    projects = [w for w in words[1:] if w.endswith(".toml") and Path(w).is_file()]
    finders: dict[str, Callable[[], list[str]]] = {
        "PROJECT": lambda: projects or _of_result(words) or _newest(_is_project)[:1],
        "RESULT": lambda: _newest(_is_result)[:1],
        "RESULT...": lambda: _newest(_is_result)[:1],
        "A": lambda: _newest(_is_result)[:2],
        "B": lambda: [r for r in _newest(_is_result) if r not in words][:1],
        "READINGS": lambda: _tables(words),
        "FILE...": lambda: _tables(words) if words[0] == "predict" else [],
        # Where there is none yet, the file that the remedy says how to write.
        "ROBOT": lambda: split(_robot(words)) or ["--dh", "dh.csv"],
        "FORMAT": lambda: ["dh"],
        "NAME": lambda: [w for w in words[1:2] if words[0] == "new" and w[0] != "-"] or ["machine"],
        "FOLDER": lambda: ["machine.history"],
        "PROJECT|RESULT": lambda: ["project"],
        "FILE": lambda: ["simulated.csv"] if words[0] == "simulate" else [],
    }
    finder = finders.get(what)
    return finder() if finder else []


def _entries() -> Iterator[Path]:
    """Files of this folder, and two levels below it, as far as there is room to look."""

    def walk(folder: Path, depth: int) -> Iterator[Path]:
        with suppress(OSError):
            entries = sorted(folder.iterdir())
            yield from (entry for entry in entries if entry.is_file())
            for entry in entries if depth else ():
                if entry.is_dir() and not entry.name.startswith("."):
                    yield from walk(entry, depth - 1)

    yield from islice(walk(Path(), 2), _MOST)


def _newest(wanted: Callable[[Path], bool]) -> list[str]:
    chosen = [path for path in _entries() if wanted(path)]
    with suppress(OSError):
        chosen.sort(key=lambda path: -path.stat().st_mtime)
    return [str(path.parent if path.name == _RESULT else path) for path in chosen]


def _is_result(path: Path) -> bool:
    return path.name == _RESULT


def _is_project(path: Path) -> bool:
    if path.suffix != ".toml" or path.name == "mechanism.toml":
        return False
    with suppress(OSError), path.open("rb") as file:
        text = file.read(100_000)
        return b"[mechanism" in text and b"[data" in text
    return False


def _result_in(words: Sequence[str]) -> Path | None:
    results = (Path(w) if w.endswith(_RESULT) else Path(w) / _RESULT for w in words[1:])
    return next((path for path in results if path.is_file()), None)


def _of_result(words: Sequence[str]) -> list[str]:
    """The project that a named result came from, NAME.toml beside NAME-result."""
    result = _result_in(words)
    project = None if result is None else Path(f"{str(result.parent).removesuffix('-result')}.toml")
    return [str(project)] if project is not None and project.is_file() else []


def _tables(words: Sequence[str]) -> list[str]:
    """The readings of the result that is named, else the tables of this folder."""
    result = _result_in(words)
    if result is not None:
        with suppress(OSError, ValueError, KeyError, TypeError, AttributeError):
            data = json.loads(result.read_bytes())["inputs"]["data"]
            first = data["file"]
            further = data.get("join", ()) if isinstance(first, str) else first
            names = [first] * isinstance(first, str) + [one["file"] for one in further]
            paths = [os.path.relpath(result.parent.parent / name) for name in names]
            return paths if all(Path(path).is_file() for path in paths) else []
    tables = [path for path in _entries() if path.suffix in _TABLES and path.parent == Path()]
    tables = [path for path in tables if not _is_dh(path)]
    whole = [path for path in tables if _is_whole(path)] if len(tables) > 2 else []
    return [str(path) for path in whole[:1] or tables][:4]


def _is_whole(path: Path) -> bool:
    """Whether a table has columns of joints and of an instrument."""
    from loopcal.files.recognition.joint_sets import usual_joints
    from loopcal.files.recognition.layouts import instruments
    from loopcal.files.recognition.sources import sources_of

    with suppress(InputError):
        fields = [f for source in sources_of(path, 0) for f in source.fields]
        joints = usual_joints(fields)
        return len(joints) > 1 and bool(instruments([f for f in fields if f not in joints]))
    return False


def _is_dh(path: str | Path) -> bool:
    from loopcal.files.recognition.dh_table import is_dh  # only errors ask

    return is_dh(path)


def _is_table(path: str) -> bool:
    return path.endswith(_TABLES) and os.path.isfile(path) and not _is_dh(path)


def _robot(words: Sequence[str]) -> str:
    """The option that names the robot, as it was typed; else a URDF or a table of the folder."""
    for option, value in pairwise(words):
        if option in _ROBOT:
            return join([option, value])
    folders = [Path(word) for word in words[1:] if Path(word).is_dir()]
    folders += [Path(word).parent for word in words[1:] if Path(word).is_file()]
    for folder in [*folders, Path()]:
        with suppress(OSError):
            beside = sorted(islice(folder.iterdir(), _MOST))
            urdfs = [path for path in beside if path.suffix == ".urdf"]
            if len(urdfs) == 1:
                return f"--urdf {quote(str(urdfs[0]))}"
            tables = [path for path in beside if _is_dh(path)]
            if len(tables) == 1:
                return f"--dh {quote(str(tables[0]))}"
    return ""

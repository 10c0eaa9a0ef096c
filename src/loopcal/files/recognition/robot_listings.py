"""Robots listed in plain text: a line per body, the header in a comment, a section per robot.

    # columns body, parent, reading, a, d, alpha, offset [m, rad]
    [arm]
    hand  wrist  T1  0.05  0.2  -90deg  0

A robot of several is named behind the file, as `robots.txt[arm]`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from io import BytesIO
from pathlib import Path

import numpy as np

from loopcal.errors import InputError, listed, unknown_name
from loopcal.files.recognition.headers import heading, meanings
from loopcal.files.tables.readers import read_table
from loopcal.files.tables.table import Table
from loopcal.units import convertible

_KEYS = meanings("dh")
_NUMBERS = {"a": "m", "d": "m", "alpha": "rad", "offset": "rad"}
_SECTION = re.compile(r"\[([\w .-]+)\]")
_NAMED = re.compile(r"(?P<file>.+)\[(?P<robot>[\w .-]+)\]")
_COLUMNS = re.compile(r".*\bcolumns?\b:?\s*(?P<names>[^\[]*)(?:\[(?P<units>[^\]]*)\])?.*", re.I)
_DIGIT = re.compile(r"\d|pi|^-$")


@dataclass
class _Robot:
    """Lines of one robot: their numbers and cells, and those that are none of its rows."""

    lines: list[int] = field(default_factory=list)
    cells: list[list[str]] = field(default_factory=list)
    others: list[str] = field(default_factory=list)


def without_robot(path: str | Path) -> tuple[Path, str | None]:
    """The file, and the robot that is named behind it."""
    match = _NAMED.fullmatch(str(path))
    if match is None or Path(path).exists():
        return Path(path), None
    return Path(match["file"]), match["robot"]


def listed_robot(path: Path, robot: str | None) -> tuple[Table, tuple[str, ...]] | None:
    """The rows of one robot as a table, and remarks; None where a file lists none like this.

    Raises InputError where several are listed and none is named, or one that is not there.
    """
    if path.suffix.lower() != ".txt" or not path.is_file():
        return None
    names: tuple[str, ...] = ()
    robots, section = dict[str, _Robot](), ""
    for number, line in enumerate(path.read_text("utf-8", errors="replace").splitlines(), 1):
        bare, _, comment = (part.strip() for part in line.partition("#"))
        names = names or _header(comment if not bare else "")
        if match := _SECTION.fullmatch(bare):
            section = match[1]
        elif bare and names:
            cells, one = bare.split(), robots.setdefault(section, _Robot())
            if len(cells) == len(names) and all(map(_DIGIT.search, _numbers(names, cells))):
                one.lines.append(number)
                one.cells.append(cells)
            else:
                one.others.append(bare)
    robots = {name: one for name, one in robots.items() if one.cells}
    if not robots:
        return None
    if robot is None and len(robots) > 1:
        raise InputError(
            f"it lists {len(robots)} robots: {listed(robots, 10)}",
            code="missing-key",
            place=path.name,
            remedy=f"name one behind the file: {path.name}[{next(iter(robots))}]",
        )
    if robot is not None and robot not in robots:
        raise unknown_name(f"{path.name} lists no robot {robot!r}", robot, tuple(robots))
    one = robots[robot] if robot is not None else next(iter(robots.values()))
    text = "\n".join(",".join(cells) for cells in [list(names), *one.cells]) + "\n"
    table = read_table(BytesIO(text.encode()))
    others = f"{path.name}: these lines are no rows of the robot: {listed(one.others, 1)}"
    return replace(table, file=path.name, rows=np.array(one.lines)), (others,) * bool(one.others)


def _header(comment: str) -> tuple[str, ...]:
    """The names of columns that a comment states, units included; none of another comment."""
    match = _COLUMNS.fullmatch(comment)
    if match is None:
        return ()
    words = [word for word in re.split(r"[,;|\s]+", match["names"]) if word]
    keys = [_KEYS.get(heading(word).stem, "") for word in words]
    if not {"a", "d", "alpha"} <= {*keys}:
        return ()
    stated = [unit for unit in re.split(r"[,;\s]+", match["units"] or "") if unit]
    names = []
    for word, key in zip(words, keys, strict=True):
        of = next((u for u in stated if key in _NUMBERS and convertible(u, _NUMBERS[key])), None)
        names.append(word if of is None else f"{word} [{of}]")
    return tuple(names)


def _numbers(names: Sequence[str], cells: Sequence[str]) -> list[str]:
    """The cells that hold numbers."""
    keys = [_KEYS.get(heading(name).stem, "") for name in names]
    return [cell for key, cell in zip(keys, cells, strict=True) if key in _NUMBERS]


# Robots as programs for robotics toolboxes write them, a call or a row per joint:
#
#     L(2) = Link([0 0.1 0.425 pi/2 0 -pi/2], 'modified');    theta, d, a, alpha, sigma, offset
#     RevoluteDH(d=0.1, a=0.425, alpha=pi/2, offset=-pi/2)
#     setFixedTransform(joint, rows(1,:), 'mdh');             rows = [a alpha d theta; ...]
#
# The angle of a joint that turns is its variable, so its theta takes no part (P. Corke, Robotics,
# Vision and Control, section 7.1; MATLAB, setFixedTransform). Nothing is executed.


_COMMENT = re.compile(r"[%#].*|\.\.\.[ \t]*\n")
_NUMBER = r"[^\s,;\[\]]+"
_CALL = re.compile(
    r"(?<!\w)(?P<name>Link|(?:Revolute|Prismatic)(?:MDH|DH)?)\s*\("
    r"(?P<inside>(?:[^()]|\([^()]*\))*)\)"
)
_VECTOR = re.compile(r"\s*\[([^\[\]]*)\](.*)", re.DOTALL)
_ARGUMENT = re.compile(
    r"(?:['\"](\w+)['\"]\s*,|\b(\w{1,40})\s*=(?!=))\s*(\[[^\[\]]*\]|[^,\[\]'\"]+)"
)
_MATRIX = re.compile(r"\bSerialLink\s*\(\s*\[([^\[\]]*)\](.*)")
_TREE = re.compile(
    r"\bsetFixedTransform\s*\(\s*\w+\s*,\s*(\w+)\s*\([^()]*\)\s*,\s*['\"](m?dh)['\"]"
)
_STATED = re.compile(r"\b(\w{1,40})\s*=\s*\[([^\[\]]*)\]")
_DEGREES = re.compile(r"deg2rad\(([^()]+)\)|(?<![-+.\d])([-+.\d]+)\*(?:pi/180|deg(?!\w))")
_ORDER = ("theta", "d", "a", "alpha", "sigma", "offset")
_TREE_ORDER = ("a", "alpha", "d", "theta")
_MOST = 200_000
"""Bytes of a program, beyond which a file is none that defines a robot."""
_HEADER = ("type", "a", "d", "alpha", "theta", "convention")


def called_robot(path: Path) -> Table | None:
    """The rows of a robot that a program defines; None of any other text."""
    if path.suffix.lower() not in (".m", ".py", ".txt") or not path.is_file():
        return None
    if path.stat().st_size > _MOST:
        return None
    text = _COMMENT.sub("", path.read_text("utf-8", errors="replace"))
    rows = [*_calls(text)] or [*_matrices(text)]
    if not rows:
        return None
    lines = [",".join(_HEADER), *(",".join(row[key] for key in _HEADER) for row in rows)]
    return replace(read_table(BytesIO("\n".join(lines).encode())), file=path.name)


def _calls(text: str) -> Iterator[dict[str, str]]:
    for call in _CALL.finditer(text):
        name, inside = call["name"], call["inside"]
        vector = _VECTOR.match(inside)
        named = {a or b: value for a, b, value in _ARGUMENT.findall(inside)}
        if vector is not None:
            named = dict(zip(_ORDER, re.findall(_NUMBER, vector[1]), strict=False))
        if named.keys() & {*_ORDER}:
            modified = "MDH" in name or "modified" in inside
            slides = name.startswith("Prismatic") or "prismatic" in inside
            yield _row(named, modified=modified, slides=slides)


def _matrices(text: str) -> Iterator[dict[str, str]]:
    for matrix in _MATRIX.finditer(text):
        for cells in _cells(matrix[1]):
            named = dict(zip(_ORDER, cells, strict=False))
            yield _row(named, modified="modified" in matrix[2], slides=False)
    stated = dict(_STATED.findall(text))
    for name, form in dict(_TREE.findall(text)).items():
        for cells in _cells(stated.get(name, "")):
            named = dict(zip(_TREE_ORDER, cells, strict=False))
            yield _row(named, modified=form == "mdh", slides=False)


def _cells(matrix: str) -> Iterator[list[str]]:
    for row in re.split(r"[;\n]", matrix):
        if cells := re.findall(_NUMBER, row):
            yield cells


def _row(named: Mapping[str, str], *, modified: bool, slides: bool) -> dict[str, str]:
    """The cells of one joint; the offset of one that slides adds to d."""
    slides = slides or named.get("sigma", "0").strip() == "1"
    offset = named.get("offset", "0")
    cells = {
        "type": "prismatic" if slides else "revolute",
        "a": named.get("a", "0"),
        "d": offset if slides else named.get("d", "0"),
        "alpha": named.get("alpha", "0"),
        "theta": named.get("theta", "0") if slides else offset,
        "convention": "modified" if modified else "standard",
    }
    return {key: _plain(cell) for key, cell in cells.items()}


def _plain(cell: str) -> str:
    """A number as tables of robots write it."""
    cell = re.sub(r"\s+|\b(?:np|math|numpy)\.", "", cell)
    return _DEGREES.sub(lambda match: f"{match[1] or match[2]} deg", cell)

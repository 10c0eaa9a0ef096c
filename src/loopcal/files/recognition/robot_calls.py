"""Robots as programs for robotics toolboxes write them, a call or a row per joint:

    L(2) = Link([0 0.1 0.425 pi/2 0 -pi/2], 'modified');    theta, d, a, alpha, sigma, offset
    RevoluteDH(d=0.1, a=0.425, alpha=pi/2, offset=-pi/2)
    setFixedTransform(joint, rows(1,:), 'mdh');             rows = [a alpha d theta; ...]

The angle of a joint that turns is its variable, so its theta takes no part (P. Corke, Robotics,
Vision and Control, section 7.1; MATLAB, setFixedTransform). Nothing is executed.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from io import BytesIO
from pathlib import Path

from loopcal.files.tables.readers import read_table
from loopcal.files.tables.table import Table

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
_COLUMNS = ("type", "a", "d", "alpha", "theta", "convention")


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
    lines = [",".join(_COLUMNS), *(",".join(row[key] for key in _COLUMNS) for row in rows)]
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

"""Cells that hold several numbers: lists of Python and NumPy, messages of ROS, structures of KRL.

A column whose every cell is in brackets and has as many numbers under the same names, such as
`[0.1, 0.2]` or `{A1 10.0, A2 20.0}`, becomes a column for each.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from loopcal.files.recognition.headers import Heading, stem

_BRACKETS = re.compile(r"[\[({].*[\])}]", re.DOTALL)
_ITEM = re.compile(
    r"(?:(?P<name>\b[A-Za-z_]\w{0,40})['\"]?[\s:=]{1,9})?"
    r"(?P<number>[-+]?(?:\d{1,40}\.?\d{0,40}|\.\d{1,40})(?:[eE][-+]?\d{1,4})?)"
)

Column = tuple[Heading, NDArray[np.float64]]


def listed_columns(header: Heading | None, cells: Sequence[str]) -> list[Column]:
    """A column for each number of the cells; none where they are no lists of one length."""
    if not cells or not all(_BRACKETS.fullmatch(cell.strip()) for cell in cells):
        return []
    rows = [[(m["name"] or "", m["number"]) for m in _ITEM.finditer(cell)] for cell in cells]
    names = [name for name, _ in rows[0]]
    if len(names) < 2 or any([name for name, _ in row] != names for row in rows):
        return []
    if not any(names):
        names = [*"xyz"] if len(names) == 3 else [str(k + 1) for k in range(len(names))]
    if len({*names}) < len(names):
        return []
    base = header or Heading("", "")
    values = np.array([[float(number) for _, number in row] for row in rows])
    headings = [
        replace(base, text=f"{base.text} {n}".strip(), stem=f"{base.stem}_{stem(n)}".strip("_"))
        for n in names
    ]
    return list(zip(headings, values.T, strict=True))

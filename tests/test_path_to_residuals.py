"""From a table on the disk to residuals a reading wanders through few modules."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

import loopcal
from loopcal.estimation.problem.problem import build_problem
from loopcal.estimation.residuals import residuals
from loopcal.files.project.project_data import load_dataset
from loopcal.files.project.project_file import read_project

PACKAGE = str(Path(loopcal.__file__).parent)
PLANAR = Path(__file__).resolve().parents[1] / "examples" / "planar" / "project.toml"
MOST_FROM_TABLE, MOST_FROM_PROJECT, MOST_ENTRIES = 41, 60, 2
"""Modules on the way, and how often it comes into the one that reads bytes."""


def entered(call: Callable[[], Any]) -> Counter[str]:
    """Module -> how often a call comes into it from another module; imports do not count."""
    seen: Counter[str] = Counter()

    def note(frame: FrameType, event: str, _: object) -> None:
        code, caller = frame.f_code, frame.f_back
        if event != "call" or not code.co_filename.startswith(PACKAGE):
            return
        if caller is not None and caller.f_code.co_filename == code.co_filename:
            return
        seen[code.co_filename[len(PACKAGE) + 1 :]] += 1

    sys.setprofile(note)
    try:
        call()
    finally:
        sys.setprofile(None)
    return seen


def from_table() -> None:
    project = PROJECT
    data = load_dataset(project).dataset
    problem = build_problem(project.mechanism, data, project.noise.noise())
    values = residuals(problem, problem.start)
    assert all(np.isfinite(loop).all() for loop in values.values())


PROJECT = read_project(PLANAR)


def test_a_reading_enters_few_modules_from_its_table_to_its_residual() -> None:
    from_table()  # whatever is made once, and was not kept since, is made here
    seen = entered(from_table)
    both = seen.keys() | entered(lambda: read_project(PLANAR)).keys()
    assert len(seen) <= MOST_FROM_TABLE, sorted(seen)
    assert len(both) <= MOST_FROM_PROJECT, sorted(both)
    assert seen["files/tables/raw.py"] <= MOST_ENTRIES

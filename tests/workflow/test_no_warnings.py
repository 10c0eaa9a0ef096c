"""No damage of readings makes NumPy, SciPy or Python warn: whatever a command says is its own."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from loopcal.cli import run
from loopcal.workflow.checking import run_simulation
from loopcal.workflow.projects import new_project

Table = list[list[str]]


def as_measured(table: Table) -> None:
    """Every pose as it was simulated."""


def without_joints(table: Table) -> None:
    """One pose without slides: what is left of its loops says nothing."""
    table[4][1:4] = [""] * 3


def without_points(table: Table) -> None:
    """Coordinates missing in every third pose, all of them in one."""
    for row in table[1::3]:
        row[-1] = ""
    table[5][-3:] = [""] * 3


def standing(table: Table) -> None:
    """The first joint stands still while all else moves."""
    for row in table[1:]:
        row[1] = table[1][1]


def huge(table: Table) -> None:
    """Readings that overflow where they are squared."""
    for row in table[1::4]:
        row[1:] = [f"{1e200 * float(cell)}" if cell else "" for cell in row[1:]]


def tiny(table: Table) -> None:
    """Readings that vanish where they are squared."""
    for row in table[1:]:
        row[1:] = [f"{1e-200 * float(cell)}" if cell else "" for cell in row[1:]]


@pytest.mark.parametrize(
    ("kind", "poses", "damage"),
    [
        ("serial-draw-wire", 25, as_measured),  # as many readings as parameters
        ("linear-delta", 12, without_joints),
        ("linear-delta", 12, without_points),
        ("linear-delta", 12, huge),
        ("five-bar", 12, tiny),
        ("five-bar", 12, standing),
    ],
)
def test_no_command_prints_a_warning_of_numpy_or_scipy(
    kind: str, poses: int, damage: Callable[[Table], None], tmp_path: Path
) -> None:
    project, data, out = (tmp_path / "p" / n for n in ("project.toml", "poses.csv", "result"))
    new_project(str(tmp_path / "p"), kind)
    text = re.sub(r"(?m)^poses = \d+", f"poses = {poses}", project.read_text("utf-8"))
    project.write_text(text, "utf-8")
    run_simulation(project, out=data, seed=1)
    calibrated = ["--method", "least-squares", "--no-report", "--out", str(out)]
    good = data.read_text("utf-8")
    table = [line.split(",") for line in good.splitlines()]
    damage(table)
    damaged = tmp_path / "p" / "damaged.csv"
    damaged.write_text("\n".join(map(",".join, table)) + "\n", "utf-8")
    data.write_text(damaged.read_text("utf-8"), "utf-8")
    commands = [["check", str(project)], ["calibrate", str(project), *calibrated]]
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        codes = [run._run(command) for command in commands]
        data.write_text(good, "utf-8")
        codes.append(run._run(["calibrate", str(project), *calibrated]))
        for command in ("predict", "verify"):
            codes.append(run._run([command, str(out), str(damaged)]))
    assert [str(one.message) for one in heard] == []
    assert set(codes) <= {0, 3, 4}
    assert np.isin(codes, (0, 4)).any()

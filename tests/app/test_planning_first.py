"""From a robot alone to a plan; then its poses appear while the file of readings grows."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from loopcal.companions.app import words
from tests.app.pointing import Hand, new_page
from tests.app.serving import Served
from tests.command_line import run_here
from tests.reference import dh_arm

POSES = 12


def measured(folder: Path, count: int) -> None:
    """The first poses of the plan, as they were commanded, in a file that grows."""
    names = [f"J{i}" for i in range(1, 7)]
    plan = json.loads((folder / "project-plan/plan.json").read_text("utf-8"))["poses"]
    rows = [[pose["readings"][name] for name in names] for pose in plan[:count]]
    points = dh_arm.seen(np.array(rows))[:, :3, 3]
    lines = [",".join(["pose", *(f"{n} [rad]" for n in names), "x [mm]", "y [mm]", "z [mm]"])]
    for i, (row, point) in enumerate(zip(rows, points, strict=True), 1):
        lines.append(",".join(map(repr, [i, *row, *(1e3 * point).tolist()])))
    (folder / "live.csv").write_text("\n".join(lines) + "\n", "utf-8")


def test_from_a_urdf_alone_to_a_plan_that_follows_a_growing_file(
    browser: Any, cell: tuple[Served, Path], tmp_path: Path
) -> None:
    served, folder = cell
    page = new_page(browser)
    page.goto(served.address)
    hand = Hand(page, folder)
    dh_arm.write_slipped(tmp_path)
    hand.drop("Drop the URDF here", tmp_path / "arm.urdf")
    hand.sees("Plan before you measure")
    hand.step("Plan")
    hand.run("Plan for arm.urdf")
    hand.sees("Poses to measure")
    with (folder / "project.toml").open("a", encoding="utf-8") as file:
        file.write("[plan]\ncandidates = 100\nrepeats = false\n")
    page.get_by_label("Poses to measure").fill(str(POSES))
    hand.run("Choose poses")
    hand.sees("Download plan.csv")
    measured(folder, 9)
    line = ("init", "live.csv", "--urdf", "arm.urdf", "--out", ".", "--force")
    assert run_here(*line, cwd=folder).returncode == 0
    hand.sees(f"9 of {POSES} planned poses are measured")
    measured(folder, POSES)
    hand.sees("Stop here")
    assert not page.get_by_text(words.OUTDATED).count()
    page.close()
    assert "[data]" in (folder / "project.toml").read_text("utf-8")
    assert "[data]" not in (folder / "project.toml.bak").read_text("utf-8")
    assert run_here("check", "project.toml", cwd=folder).returncode == 0

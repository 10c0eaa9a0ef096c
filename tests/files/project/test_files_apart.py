"""Files with poses of their own: two arms, each in a file with the same columns, and contact."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import loopcal as lc
from loopcal.files.project.project_data import _groups
from tests.refusals import refused

ARMS = {"l": ("left", 0.3), "r": ("right", -0.3)}
FILES = """
[data]
pose = "id"
units = { length = "mm", angle = "rad" }
[[data.file]]
file = "left.csv"
columns = { lq1 = "J1", lq2 = "J2", left_x = "x", left_y = "y", left_z = "z" }
where = { note = "good*" }
[[data.file]]
file = "right.csv"
columns = { rq1 = "J1", rq2 = "J2", right_x = "x", right_y = "y", right_z = "z" }
"""
CONTACT = """
[[data.file]]
file = "contact.csv"
instrument = ["touch"]
"""


def project_text(*, touch: bool) -> str:
    """The two arms under a tracker; touch: they also touch each other, in a file of its own."""
    lines = ["schema = 1", "[mechanism]", 'type = "tree"', 'root = "base"']
    for side, (_, at) in ARMS.items():
        rows = ((at, 0.4, 0.0), (0.06, 0.35, np.pi / 2), (0.42, 0.0, 0.0))
        for i, (a, d, alpha) in enumerate(rows):
            parent = f"{side}{i - 1}" if i else "base"
            lines += ["[[mechanism.body]]", f'name = "{side}{i}"', f'parent = "{parent}"']
            lines += ["fixed = true"] if i == 0 else []
            joint = f"{side}q{i}" if i else f"{side}foot"
            lines.append(f'row = {{ name = "{joint}", a = {a}, d = {d}, alpha = {alpha} }}')
    for side, (name, _) in ARMS.items():
        lines += ["[[mechanism.instrument]]", 'type = "point"', f'name = "{name}"']
        lines += [f'on = "{side}2"', 'station = "tracker"', f'target = "{name}_target"']
        lines.append(f'readings = ["{name}_x", "{name}_y", "{name}_z"]')
    if touch:
        lines += ["[[mechanism.instrument]]", 'type = "contact"', 'name = "touch"']
        lines += ['between = ["l2", "r2"]', "radius = [0.02, 0.02]"]
    lines += ["[mechanism.parameters]", '"*_target_?" = { sd = 0.01 }']
    lines += ["[noise]", '"?q?" = { sd = 30, unit = "urad" }']
    lines += ['"touch_gap" = { sd = 0.1, unit = "mm" }'] if touch else []
    lines += ['"left_[xyz],right_[xyz]" = { sd = 20, unit = "um" }']
    lines += ["[fit]", 'method = "implicit-loop"']
    return "\n".join(lines) + FILES + (CONTACT if touch else "")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """left.csv with a bad row, right.csv, contact.csv, those of another day, and the project."""
    draw = np.random.default_rng(2)
    (tmp_path / "project.toml").write_text(project_text(touch=False), "utf-8")
    machine = lc.read_project(tmp_path / "project.toml").mechanism
    for day, poses in (("", 30), ("_monday", 12)):
        joints = {f"{s}q{i}": draw.uniform(-1.2, 1.2, poses) for s in ARMS for i in (1, 2)}
        noise = lc.Noise({"?q?": 3e-5, "left_?": 2e-5, "right_?": 2e-5})
        seen = lc.simulate(machine, joints, noise=noise, seed=poses).dataset
        for side, (name, _) in ARMS.items():
            lines = ["id,J1,J2,note,x,y,z"]
            for k in range(poses):
                q = [seen[f"{side}q{i}"][k] for i in (1, 2)]
                p = [1e3 * seen[f"{name}_{axis}"][k] for axis in "xyz"]
                note = "bad" if k == 3 else "good enough"
                values = [k, *q, note, *(p if note != "bad" or name == "right" else (7, 7, 7))]
                lines.append(",".join(map(str, values)))
            (tmp_path / f"{name}{day}.csv").write_text("\n".join(lines) + "\n", "utf-8")
    touching = ["id,lq1,lq2,rq1,rq2", *(f"{k},0,0.{k},0.1,-0.{k}" for k in range(1, 5))]
    (tmp_path / "touching.toml").write_text(project_text(touch=True), "utf-8")
    (tmp_path / "contact.csv").write_text("\n".join(touching) + "\n", "utf-8")
    return tmp_path


def test_each_file_has_its_poses_and_what_it_does_not_hold_was_not_read(folder: Path) -> None:
    data = lc.load_dataset(lc.read_project(folder / "touching.toml")).dataset
    assert len(data) == 29 + 30 + 4
    assert data.poses[2:4] == ("left:2", "left:4")  # the row with another word is not taken
    for quantity, poses in (("left_x", 29), ("rq1", 34), ("lq1", 33), ("touch_gap", 4)):
        assert np.isfinite(data[quantity]).sum() == poses
    assert data.source.rows_read == 30 + 30 + 4
    assert "right.csv, row 2" in data.place(29, "right_x")


def test_files_of_another_day_are_told_apart_by_columns_or_names(folder: Path) -> None:
    lc.calibrate(folder / "project.toml").save(folder / "result")
    days = [folder / "right_monday.csv", folder / "left_monday.csv"]
    assert not lc.verify(folder / "result", days).failed
    assert not lc.verify(folder / "result", days[0]).failed
    updated = lc.update(folder / "result", days)
    assert [pose for pose in updated.dataset.poses if "monday:0" in pose] == [
        "right_monday:0",
        "left_monday:0",
    ]
    days[0].rename(folder / "day.csv")
    with refused("missing-column", "columns are those of several files", "left.csv"):
        lc.verify(folder / "result", folder / "day.csv")


def test_a_joint_that_a_file_lacks_is_named(folder: Path) -> None:
    project = folder / "project.toml"
    project.write_text(project.read_text("utf-8").replace('lq2 = "J2", ', ""), "utf-8")
    with refused("missing-column", "'lq2' between 'l2' and 'base'", "left.csv"):
        lc.load_dataset(lc.read_project(project))


def test_joined_files_beside_those_apart_are_refused(folder: Path) -> None:
    project = folder / "project.toml"
    more = '[[data.join]]\nfile = "contact.csv"\npose = "id"\n'
    project.write_text(project.read_text("utf-8") + more, "utf-8")
    with refused("conflicting-keys", "data.join"):
        lc.read_project(project)


def test_a_list_without_files_is_refused(folder: Path) -> None:
    project = folder / "project.toml"
    text = project.read_text("utf-8")
    project.write_text(text[: text.index("[data]")] + "[data]\nfile = []\n", "utf-8")
    with refused("missing-key", "data.file"):
        lc.read_project(project)


def test_no_row_with_such_a_word_is_an_error(folder: Path) -> None:
    project = folder / "project.toml"
    project.write_text(project.read_text("utf-8").replace("good*", "best*"), "utf-8")
    with refused("no-data", "note = 'best*'"):
        lc.load_dataset(lc.read_project(project))


def test_groups_of_one_file_are_not_those_of_another(folder: Path) -> None:
    project = lc.read_project(folder / "project.toml")
    poses = lc.load_dataset(project).dataset.poses
    groups = _groups(project, "id", poses)
    assert len(set(groups)) == len(poses)
    assert groups[1] - groups[0] == 1.0

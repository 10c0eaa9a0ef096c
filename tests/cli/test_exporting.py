"""`loopcal export`: files, messages and refusals."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import loopcal as lc
from loopcal.cli.run import main
from loopcal.companions.robot.commands import _counts
from loopcal.companions.robot.exports.registry import EXPORTS
from tests.command_line import run_here as run
from tests.refusals import refused


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A robot of a URDF, and a machine that is no arm, both calibrated."""
    here = tmp_path_factory.mktemp("export")
    for name, kind in (("robot", "urdf"), ("delta", "linear-delta")):
        for arguments in (
            ("new", name, "--mechanism", kind),
            ("simulate", f"{name}/project.toml", "--out", f"{name}/poses.csv", "--seed", "1"),
            ("calibrate", f"{name}/project.toml", "--method", "reweighted", "--no-report",
             "--out", f"{here}/{name}-result"),
        ):  # fmt: skip
            assert main([str(here / a) if "/" in a or a == name else a for a in arguments]) == 0
    return here


def test_a_second_export_changes_nothing(folder):
    urdf = ("export", "robot-result", "--to", "urdf", "--source", "robot/robot.urdf")
    first = run(*urdf, cwd=folder)
    assert first.returncode == 0, first.stderr
    assert "written: robot-result/export/robot.urdf" in first.stdout
    patched = (folder / "robot-result/export/robot.urdf").read_bytes()
    again = run(*urdf[:-1], "robot-result/export/robot.urdf", "--json", cwd=folder)
    stated = json.loads(again.stdout)
    assert stated["unchanged"] == ["robot.urdf"]
    assert [one["model"] for one in stated["accuracy"]] == [
        "nominal", "zeros and tool", "geometry", "full",
    ]  # fmt: skip
    there = {"source": folder / "robot/robot.urdf", "out": folder / "robot-result/export"}
    with refused("unwritable-file", "--force"):
        lc.export(folder / "robot-result", "urdf", offsets="file", **there)
    forced = lc.export(folder / "robot-result", "urdf", offsets="file", force=True, **there)
    assert forced.placed is not None
    assert forced.placed.backups == ("robot.urdf.bak",)
    assert (folder / "robot-result/export/robot.urdf.bak").read_bytes() == patched


def test_every_format_of_an_arm_is_made_in_python(folder: Path):
    robot = folder / "robot/robot.urdf"
    with refused("unsupported", "Universal Robots"):
        lc.export(folder / "robot-result", "ur")
    for name, one in EXPORTS.items():
        if name == "ur" or one.needs in ("cameras", "eyes"):
            continue
        made = lc.export(
            folder / "robot-result", name, source=robot if one.source and not one.optional else None
        )
        assert made.files
        assert made.placed is None
        nominal, zeros, geometry, full = (one.figures[0] or 0.0 for one in made.machine.accuracy)
        assert nominal > zeros > geometry == pytest.approx(full)


def test_other_machines_export_their_parameters(folder):
    made = lc.export(folder / "delta-result", "json")
    stated = json.loads(made.files["geometry.json"])
    result = lc.read_result(folder / "delta-result")
    assert {p["name"]: p["exported"] for p in stated["parameters"]} == dict(result.value)
    with refused("unsupported", "json"):
        lc.export(folder / "delta-result", "mjcf")
    with refused("unsupported"):
        lc.export(folder / "delta-result", "zeros")


@pytest.mark.parametrize(
    ("options", "code"),
    [
        ({"to": "urd"}, "unknown-name"),
        ({"to": "dh", "source": "x"}, "conflicting-keys"),
        ({"to": "dh", "offsets": "file"}, "conflicting-keys"),
        ({"to": "xacro", "offsets": "both"}, "unknown-name"),
        ({"to": "frames", "vendor": "kukka"}, "unknown-name"),
        ({"to": "zeros", "counts": {"joint_9": 1.0}}, "unknown-name"),
        ({"to": "urdf", "source": "absent.urdf"}, "missing-file"),
    ],
)
def test_what_does_not_go_together_is_refused(folder, options, code):
    with refused(code):
        lc.export(folder / "robot-result", **options)


@pytest.mark.parametrize(
    "words",
    [
        "export nothing --to xyz",
        "export nothing --to frames --vendor foo",
        "export nothing --to urdf --offsets foo",
        "plan nothing --criterion Q",
        "performance nothing --angles foo",
    ],
)
def test_a_value_that_no_option_takes_is_an_error_of_usage(words):
    *_, option, value = words.split()
    done = run(*words.split())
    assert done.returncode == 2
    assert f"{option} cannot be {value!r}" in done.stderr


def test_counts_are_read_from_the_command_line(folder):
    out = ("--out", "zeros", "--counts", "joint_2=1000")
    done = run("export", "robot-result", "--to", "zeros", *out, cwd=folder)
    assert done.returncode == 0, done.stderr
    table = np.genfromtxt(folder / "zeros/zeros.csv", delimiter=",", names=True, dtype=None,
                          encoding="utf-8")  # fmt: skip
    assert table["counts"][1] == pytest.approx(1000 * table["correction"][1], abs=0.5)


def test_counts_without_a_number_are_refused():
    for text in ("joint_2", "joint_2=", "joint_2=x", "=5", "joint_2=0", "joint_2=inf"):
        with refused("invalid-value", "JOINT=N"):
            _counts(text)

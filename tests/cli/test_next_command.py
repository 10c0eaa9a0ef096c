"""Every error of the command line ends with a command, filled in with the files of the folder."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import loopcal as lc
from analyses.layouts import World, described, ids, joints, written, xyz
from loopcal.cli.registry import COMMANDS
from loopcal.files.recognition.dh_table import read_dh
from loopcal.workflow.beginning.robot_file import DH_HEADER
from tests.refusals import refused

from .conftest import Run

P, R = "project.toml", "project-result"
NEXT = {
    "a misspelled command": ("calibrat project.toml", "calibrate project.toml"),
    "a misspelled option": (f"calibrate {P} --methd auto", f"calibrate {P} --method auto"),
    "a flag like an option with a value": (f"record {R} --format dcc", "record --help"),
    "an abbreviated method": (
        f"calibrate {P} --method lsq",
        f"calibrate {P} --method least-squares",
    ),
    "a method that nobody knows": (
        f"calibrate {P} --method=zz",
        f"calibrate {P} --method=auto",
    ),
    "a format that nobody knows": (f"export {R} --to kuka", f"export {R} --to urdf"),
    "an option of another command": (
        "calibrate readings.csv --urdf robot.urdf",
        "init readings.csv --urdf robot.urdf",
    ),
    "an option that nobody knows": ("init readings.csv --robot robot.urdf", "init --help"),
    "a table of the robot for a URDF": (
        "init readings.csv --urdf table.csv",
        "init readings.csv --dh table.csv",
    ),
    "a robot that is absent": (
        "init readings.csv --dh arm-7.csv",
        "init readings.csv --urdf robot.urdf",
    ),
    "readings for a table of the robot": (
        "init readings.csv --dh other.csv",
        "init readings.csv --urdf robot.urdf",
    ),
    "one table of readings": ("calibrate readings.csv", "init readings.csv --urdf robot.urdf"),
    "one name of several": (
        f"calibrate {P} --require sound,bettr",
        f"calibrate {P} --require sound,better",
    ),
    "a number with a unit": (
        f"calibrate {P} --tolerance 0.5mm",
        f"calibrate {P} --tolerance 0.5",
    ),
    "more folds than poses": (
        f"calibrate {P} --folds 4000",
        f"calibrate {P} --folds 42",
    ),
    "no number": (f"calibrate {P} --folds ten", f"calibrate {P}"),
    "no project": ("check", f"check {P}"),
    "a project that is absent": ("check nothing-like-it.toml", f"check {P}"),
    "a result for a project": (f"check {R}", f"check {P}"),
    "a project for a result": (f"report {P}", f"report {R}"),
    "no result": ("report", f"report {R}"),
    "no readings": (f"predict {R}", f"predict {R} readings.csv"),
    "a table without the joints": (
        f"predict {R} table.csv --out points.csv",
        f"predict {R} readings.csv --out points.csv",
    ),
    "no format": (f"export {R}", f"export {R} --to dh"),
    "no output": (f"simulate {P}", f"simulate {P} --out simulated.csv"),
    "readings for a project": (
        "calibrate readings.csv other.csv",
        "init readings.csv other.csv --urdf robot.urdf",
    ),
    "no robot": ("init readings.csv --out new", "init readings.csv --out new --urdf robot.urdf"),
    "nothing at all": ("init", "init other.csv readings.csv --urdf robot.urdf"),
    "a stray picture": ("init readings.csv arm.png", "init readings.csv --urdf robot.urdf"),
    "a folder without tables": (
        "init empty --urdf robot.urdf",
        "init other.csv readings.csv --urdf robot.urdf",
    ),
    "no history": ("history", f"history machine.history --add {R}"),
    "nothing to fill in": (f"verify {R}", "verify --help"),
    "no name": ("new --mechanism serial", "new machine --mechanism serial"),
    "a certificate without its laboratory": (
        f"record {R} --dcc",
        f"record {R} --dcc --project {P}",
    ),
}


@pytest.mark.parametrize("name", NEXT)
def test_an_error_ends_with_the_next_command(name: str, folder: Path, run: Run) -> None:
    typed, command = NEXT[name]
    (folder / "empty").mkdir()
    (folder / "arm.png").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(100))
    (folder / "robot.urdf").write_text("<robot/>", "utf-8")
    shutil.copy(folder / "readings.csv", folder / "other.csv")
    (folder / "table.csv").write_text("a [mm],d [mm],alpha [deg],theta [deg]\n1,2,90,0\n", "utf-8")
    done = run(*typed.split())
    assert done.code in (2, 3), done.err
    assert "Traceback" not in done.err
    assert done.err.endswith(f"Next command:\n    loopcal {command}\n"), done.err


def test_readings_without_a_robot_say_what_they_hold_and_how_to_write_one(
    folder: Path, run: Run
) -> None:
    for path in folder.iterdir():
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    (folder / "day").mkdir()
    rows = (f"{i},{0.1 * i},{-0.2 * i},1.{i},0.5,0.{i},1,0,0,0\n" for i in range(9))
    head = "pose,j1_rad,j2_rad,target_x_m,target_y_m,target_z_m,qw,qx,qy,qz\n"
    (folder / "day" / "poses.csv").write_text(head + "".join(rows), "utf-8")
    for typed in ("day", "day/poses.csv"):
        done = run("init", typed, "--run")
        assert done.code == 2, done.err
        for stated in ("2 joints", "'j2_rad'", "poses of a target", DH_HEADER):
            assert stated in done.err
        assert done.err.endswith(f"Next command:\n    loopcal init {typed} --run --dh dh.csv\n")
    (folder / "dh.csv").write_text(f"{DH_HEADER}\n1,500,0,-90,0\n2,400,0,0,0\n", "utf-8")
    assert read_dh(folder / "dh.csv").moving == 2


def test_the_robot_among_the_readings_stays(folder: Path, run: Run) -> None:
    (folder / "table.csv").write_text("a [mm],d [mm],alpha [deg],theta [deg]\n1,2,90,0\n", "utf-8")
    (folder / "joints.csv").write_text("J1 [deg]\n1\n20\n30\n", "utf-8")
    done = run("init", "joints.csv", "table.csv")
    assert done.err.endswith("loopcal init joints.csv readings.csv table.csv\n"), done.err


def test_readings_of_one_pose_lead_to_a_plan_for_the_robot_that_was_named(
    folder: Path, run: Run
) -> None:
    poses = np.random.default_rng(1).normal(
        [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 1.0, 2.0, 0.5], 1e-5, (20, 9)
    )
    head = ",".join([*(f"J{i} [rad]" for i in range(1, 7)), *(f"{c} [m]" for c in "xyz")])
    np.savetxt(folder / "still.csv", poses, delimiter=",", header=head, comments="")
    done = run("init", "still.csv", "--machine", "motoman-ma1400")
    command = "init --machine motoman-ma1400 --out planned"
    assert done.err.endswith(f"Next command:\n    loopcal {command}\n"), done.err
    assert run(*command.split()).code == 0


def test_a_file_is_mended_for_the_same_command(folder: Path, run: Run) -> None:
    text = (folder / P).read_text("utf-8")
    (folder / P).write_text(text.replace('unit = "mm"', 'unit = "mmm"'), "utf-8")
    assert run("check", P).err.endswith(f"Then run:\n    loopcal check {P}\n")


def test_an_empty_folder_begins_with_the_demonstration(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run: Run
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run("calibrate").err.endswith("Next command:\n    loopcal demo\n")


def test_poses_that_cannot_be_used_are_left_out_by_the_next_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run: Run
) -> None:
    monkeypatch.chdir(tmp_path)
    world = World("six", 1)
    described(world, tmp_path)
    columns: dict[str, Any] = {"pose": ids(world), **joints(world), **xyz("{}", world.points)}
    columns["J2"] = [f"{v:.5f}" for v in columns["J2"]]
    columns["J2"][3] = "lost"
    for axis in "xyz":
        columns[axis][[6, 9]] = 0.0
    written(tmp_path / "data.csv", columns)
    said = run("init", "data.csv", "--dh", "dh.csv").err
    assert said.endswith("Next command:\n    loopcal init data.csv --dh dh.csv --exclude P004\n")
    said = run("init", "data.csv", "--dh", "dh.csv", "--exclude", "P004").err
    assert said.endswith("loopcal init data.csv --dh dh.csv --exclude P004,P007,P010\n")
    done = run("init", "data.csv", "--dh", "dh.csv", "--exclude", "P004,P007,P010")
    assert done.code == 0
    assert "Left out of data.csv: P004, P007, P010." in done.out
    assert (
        "'P0044' is no pose"
        in run("init", "data.csv", "--dh", "dh.csv", "--exclude", "P004,P007,P010,P0044").err
    )
    with refused("unknown-name", "'Q1' is no pose"):
        lc.init({"q": world.read, "p": world.points}, dh="dh.csv", exclude="Q1")
    assert (
        len(lc.init({"q": world.read, "p": world.points}, dh="dh.csv", exclude="2").dataset) == 35
    )


def test_without_arguments_every_command_is_listed_and_the_first_is_the_next(run: Run) -> None:
    said = run()
    assert said.code == 2
    assert all(f"\n  {name} " in said.err for name in COMMANDS)
    assert said.err.endswith("Next command:\n    loopcal demo\n")


def test_a_result_that_is_not_there_yet_is_calibrated_first(folder: Path, run: Run) -> None:
    shutil.rmtree(folder / R)
    assert run("export", R, "--to", "dh").err.endswith(
        f"Next command:\n    loopcal calibrate {P}\n"
    )

"""ROS bags of three containers: stands, medians, topics, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import loopcal as lc
from loopcal.files.tables.readers import read_table
from tests.bags import CONTAINERS, write_bag
from tests.command_line import run_here as run
from tests.refusals import refused

pytest.importorskip("rosbags", reason="rosbags is not installed (loopcal[bags])")

POSES = np.random.default_rng(3).uniform(-1.0, 1.0, (12, 2))
JOINTS = {"shoulder": POSES[:, 0], "slide": POSES[:, 1]}
PLACES = np.random.default_rng(4).uniform(-1.0, 1.0, (12, 3))


@pytest.mark.parametrize("container", CONTAINERS)
def test_a_bag_has_a_row_for_each_stand(tmp_path: Path, container: str) -> None:
    """Also where the instrument is 37 ms late; the image beside it is never deserialised."""
    noise = 1e-4
    points = {"/tracker/point": PLACES}
    bag = write_bag(tmp_path, container, JOINTS, points, noise=noise, delay=0.037)
    read = lc.read_dataset(bag, {**{name: name for name in JOINTS}, "x": "x [m]", "z": "z [m]"})
    assert len(read) == len(POSES)
    for name, its in JOINTS.items():
        np.testing.assert_allclose(read[name], its, atol=noise)
    np.testing.assert_allclose(read["z"], PLACES[:, 2], atol=noise)
    files = [bag] if bag.is_file() else [one for one in bag.iterdir() if one.suffix != ".yaml"]
    table = read_table(files[0])  # a storage file alone, as people copy it
    assert table.names == ("time [s]", "shoulder", "slide", "x [m]", "y [m]", "z [m]")


def test_topics_are_told_apart(tmp_path: Path) -> None:
    bag = write_bag(tmp_path, "mcap", JOINTS, {"/a/point": PLACES, "/b": PLACES + 1.0})
    assert read_table(bag).names[-3:] == ("b_x [m]", "b_y [m]", "b_z [m]")
    one = read_table(bag, topic="/b")
    assert one.names[-3:] == ("x [m]", "y [m]", "z [m]")
    x = one.numbers(3, np.arange(len(POSES)))
    np.testing.assert_allclose(x, PLACES[:, 0] + 1.0, atol=1e-12)
    with refused("unknown-name", "/a/point"):
        read_table(bag, topic="/a/points")
    with refused("conflicting-keys", "sheet"):
        lc.read_dataset(bag, sheet="Sheet1")
    with refused("conflicting-keys", "topic"):
        lc.read_dataset(tmp_path / "poses.csv", topic="/b")


def test_what_is_no_recording_of_poses_is_refused(tmp_path: Path) -> None:
    with refused("invalid-value", "shoulder"):
        read_table(write_bag(tmp_path, "mcap", JOINTS, {}, stamped=False))
    with refused("missing-column", "/camera"):
        read_table(write_bag(tmp_path, "bag", {}, {}))
    bag = tmp_path / "calib.bag"
    for content in (b"#ROSBAG V2.0\n" + bytes(50), bag.read_bytes()[:-40], bytes(200)):
        (tmp_path / "broken.bag").write_bytes(content)
        with refused("wrong-file-type", "broken.bag"):
            read_table(tmp_path / "broken.bag")
    (tmp_path / "broken.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(range(256)))
    with refused("wrong-file-type", "broken.mcap"):
        read_table(tmp_path / "broken.mcap")


def test_a_bag_becomes_a_project_and_a_result(tmp_path: Path) -> None:
    """From the recording and the URDF alone, the robot is calibrated as from its table."""
    project = tmp_path / "robot" / "project.toml"
    assert run("new", "robot", "--mechanism", "urdf", cwd=tmp_path).returncode == 0
    out = ("--out", "robot/poses.csv", "--seed", "1")
    assert run("simulate", "robot/project.toml", *out, cwd=tmp_path).returncode == 0
    fit = ("--method", "least-squares", "--no-report", "--json")
    from_table = json.loads(run("calibrate", "robot/project.toml", *fit, cwd=tmp_path).stdout)
    names = [f"joint_{i}" for i in range(1, 7)]
    columns = {**dict.fromkeys(names, "rad"), **dict.fromkeys("xyz", "mm")}
    read = lc.read_dataset(project.parent / "poses.csv", {n: n for n in columns}, units=columns)
    joints = {name: read[name] for name in names}
    xyz = np.column_stack([read[axis] for axis in "xyz"])
    write_bag(tmp_path, "mcap", joints, {"/tracker": xyz}, noise=1e-6, delay=0.03)
    init = ("init", "calib-mcap", "--sheet", "/tracker", "--urdf", "robot/robot.urdf")
    made = run(*init, "--out", "new", cwd=tmp_path)
    assert made.returncode == 0, made.stderr
    from_bag = json.loads(run("calibrate", "new/project.toml", *fit, cwd=tmp_path).stdout)
    assert from_bag["data"]["used"] == len(read)
    rms, expected = (one["accuracy"]["after"]["rms"] for one in (from_bag, from_table))
    assert rms == pytest.approx(expected, rel=0.05)

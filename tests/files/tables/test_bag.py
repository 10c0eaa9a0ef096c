"""ROS bags of three containers: stands, medians, topics, and what is refused."""

from __future__ import annotations

import json
import sqlite3
import sys
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

import loopcal as lc
from loopcal.files.tables import bag as bag_module
from loopcal.files.tables import recording
from loopcal.files.tables.readers import read_table
from tests.bags import CONTAINERS, RATE, TRACKER_RATE, motion, times, write_bag
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


def moved(rng: np.random.Generator, urdf: Path) -> Callable[[Any], Any]:
    """Where the tool of a robot is seen that is not quite the URDF's, for joints (N, 6)."""
    nominal = lc.load_urdf(urdf)
    off = {
        n: replace(p, nominal=p.nominal + rng.normal(0, 1e-3))
        for n, p in nominal.parameters.items()
    }
    robot = replace(nominal, parameters=off)

    def seen(q: Any) -> Any:
        T = robot.fk(q)
        return T[:, :3, :3] @ np.array([0.03, 0.02, 0.1]) + T[:, :3, 3] + np.array([1.0, 0.5, -0.3])

    return seen


@pytest.fixture(scope="module")
def urdf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("urdf")
    assert run("new", "robot", "--mechanism", "urdf", cwd=folder).returncode == 0
    return folder / "robot" / "robot.urdf"


@pytest.mark.parametrize("container", CONTAINERS)
def test_the_delay_of_an_instrument_is_said_with_its_sd(
    tmp_path: Path, container: str, urdf: Path
) -> None:
    """Two publishers of joints; analyses/bag_delays.py counts how often the sds hold."""
    rng = np.random.default_rng(7)
    q = rng.uniform(-1.0, 1.0, (12, 6))
    joints = {f"joint_{i + 1}": q[:, i] for i in range(6)}
    points = {"/tracker": moved(rng, urdf)}
    bag = write_bag(tmp_path, container, joints, points, noise=1e-4, delay=0.037, publishers=2)
    made = lc.init(bag, urdf=urdf)
    (delay,) = made.delays
    assert (delay.topic, delay.moves, len(made.dataset)) == ("/tracker", 11, 12)
    assert 0.0 < delay.sd < 1e-4
    assert abs(delay.value - 0.037) < 4.0 * delay.sd
    words = str(made)
    for said in ("12 poses at rest", "/tracker: 450 readings, 25.0 per s", "/camera", "sd 0.0"):
        assert said in words
    assert lc.read_bag(bag).late == {"/tracker": pytest.approx(0.04, abs=0.011)}
    result = lc.calibrate(made, method="least-squares")
    assert result.converged
    assert result.rms is not None
    assert result.rms < 3e-4
    assert "</html>" in lc.report(result, tmp_path / "report.html").read_text("utf-8")


def test_an_instrument_may_be_half_a_second_late(tmp_path: Path, urdf: Path) -> None:
    rng = np.random.default_rng(8)
    q = rng.uniform(-1.0, 1.0, (12, 6))
    joints = {f"joint_{i + 1}": q[:, i] for i in range(6)}
    seen = {"/tracker": moved(rng, urdf)}
    made = lc.init(write_bag(tmp_path, "mcap", joints, seen, noise=1e-4, delay=0.5), urdf=urdf)
    assert abs(made.delays[0].value - 0.5) < 4.0 * made.delays[0].sd


def test_a_log_with_a_time_column_is_read_as_a_bag_is(tmp_path: Path, urdf: Path) -> None:
    """Joints and instrument in two files of one clock, here in milliseconds; a later day too."""
    rng = np.random.default_rng(9)
    q = rng.uniform(-1.0, 1.0, (36, 6))
    seen = moved(rng, urdf)
    t, s = times(36, RATE), times(36, TRACKER_RATE)
    joints = motion(q, t) + rng.normal(0, 1e-4, (len(t), 6))
    points = seen(motion(q, s - 0.037)) + rng.normal(0, 1e-4, (len(s), 3))
    names = [f"joint_{i + 1}" for i in range(6)]
    ahead = {"timestamp [ms]": 1e3 * (5.0 + t)}
    log = pl.DataFrame({**ahead, **{n: joints[:, i] for i, n in enumerate(names)}})
    log.write_csv(tmp_path / "joints.csv")
    tracker = {"time [ms]": 1e3 * (5.0 + s), **{a: points[:, i] for i, a in enumerate("xyz")}}
    pl.DataFrame(tracker).write_csv(tmp_path / "tracker.csv")
    files = (tmp_path / "joints.csv", tmp_path / "tracker.csv")
    made = lc.init(*files, urdf=urdf, out=tmp_path / "project")
    assert len(made.dataset) == 36
    (delay,) = made.delays
    assert delay.sd < 1e-4
    assert abs(delay.value - 0.037) < 4.0 * delay.sd
    result = lc.calibrate(made, method="least-squares")
    assert result.rms is not None
    assert result.rms < 3e-4
    x = lc.predict(result, log).outputs["x"]
    np.testing.assert_allclose(x, made.dataset["x"], atol=1e-3)


def test_an_instrument_read_once_in_a_while_has_no_delay() -> None:
    """Its moves are not seen: its readings are taken at the stands as they are."""
    at = times(12, RATE)
    slow = np.arange(0.5, at[-1], 1.5)
    joints = {
        n: recording.Series(1.0 + at, motion(q[:, None], at), (n,)) for n, q in JOINTS.items()
    }
    seen = recording.Series(1.0 + slow, motion(PLACES, slow), ("x [m]", "y [m]", "z [m]"))
    made = recording.Recording(joints, {"/tracker": seen})
    assert made.late == {"/tracker": 0.0}
    np.testing.assert_allclose(made["x [m]"], PLACES[:, 0], atol=1e-12)


def test_a_bomb_ends_in_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A message of kilobytes that unfolds beyond the bound of the child, here 130 MB."""
    monkeypatch.setattr("loopcal.files.guarded.MEMORY", 1 << 27)
    zstd = pytest.importorskip("backports.zstd")
    write_bag(tmp_path, "sqlite3", {}, {})
    folder = tmp_path / "calib-sqlite3"
    compress = zstd.ZstdCompressor()
    block = bytes(1 << 24)
    bomb = b"".join(compress.compress(block) for _ in range(20)) + compress.flush()
    (database,) = folder.glob("*.db3")
    with closing(sqlite3.connect(database)) as opened, opened:
        opened.execute("UPDATE topics SET type = 'sensor_msgs/msg/JointState'")
        opened.execute("UPDATE messages SET data = ?", (bomb,))
    about = folder / "metadata.yaml"
    text = about.read_text().replace("sensor_msgs/msg/Image", "sensor_msgs/msg/JointState")
    text = text.replace("compression_format: ''", "compression_format: zstd")
    about.write_text(text.replace("compression_mode: ''", "compression_mode: message"))
    assert "compression_mode: message" in about.read_text()
    with refused("wrong-file-type", folder.name):
        lc.read_bag(folder)


def test_without_rosbags_the_command_that_installs_it_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with refused("missing-dependency", "pip install 'loopcal[bags]'"), bag_module._opened(tmp_path):
        pass


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

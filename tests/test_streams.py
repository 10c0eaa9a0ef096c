"""Readings that come in chunks: from Parquet to written results, and on from an interruption."""

from __future__ import annotations

import json
import multiprocessing
import pickle
import platform
import shutil
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from loopcal import Noise
from loopcal.errors import Code
from loopcal.estimation.stream import calibrate as last_pass
from loopcal.execution.cluster import Cluster
from loopcal.execution.executor import Executor
from loopcal.execution.local import Processes, Threads
from loopcal.files.project import stream as parquet_stream
from loopcal.files.project.project_data import load_dataset
from loopcal.files.project.project_file import Project, read_project
from loopcal.files.project.stream import project_stream
from loopcal.files.result.pose_table import ResidualParts
from loopcal.mechanisms.planar import planar_two_link
from loopcal.simulation.poses import random_poses
from loopcal.simulation.simulate import simulate
from loopcal.workflow.calibration import Listeners, Request, run_calibration
from loopcal.workflow.checking import run_check
from tests.command_line import environment, run_here
from tests.dask_cluster import dask_cluster
from tests.execution.pieces import Backwards
from tests.refusals import refused

PROJECT = """
schema = 1
fit = { method = "implicit-loop" }
[mechanism]
type = "planar-two-link"
[data]
file = "poses"
pose = "id"
every = 2
exclude = ["p3", "p301"]
units = { length = "mm", angle = "deg" }
[noise]
"phi*" = { sd = 1e-4, unit = "rad" }
xPyP = { sd = 0.02, unit = "mm" }
"""


KILLED = """
import os, signal, sys
from loopcal.cli.run import main
from loopcal.files.project import stream

stream.CHUNK = 64
read, left = stream.ParquetStream.chunk, int(sys.argv[1])

def chunk(self, number):
    global left
    left -= 1
    if left < 0:
        os.kill(os.getpid(), signal.SIGKILL)
    return read(self, number)

stream.ParquetStream.chunk = chunk
sys.exit(main(sys.argv[2:]))
"""
"""The command, killed when it reads so many chunks and one more."""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A project whose 500 poses lie in two Parquet files, read 64 rows at a time."""
    monkeypatch.setattr(parquet_stream, "CHUNK", 64)
    arm = planar_two_link()
    driven = random_poses({"phi2": (0.0, 3.0), "phi3": (0.3, 2.5)}, 500, seed=1)
    noise = Noise({"phi?": 1e-4, "?P": 2e-5})
    data = simulate(arm, driven, noise=noise, seed=1, truth={"l2": 0.803, "phi20": 0.01}).dataset
    whole = pl.DataFrame(
        {"id": [f"p{i + 1}" for i in range(500)]}
        | {q: np.degrees(data[q]) for q in ("phi2", "phi3")}
        | {q: 1000 * data[q] for q in ("xP", "yP")}
    )
    (tmp_path / "poses").mkdir()
    whole[:300].write_parquet(tmp_path / "poses" / "part-1.parquet")
    whole[300:].write_parquet(tmp_path / "poses" / "part-2.parquet")
    whole.write_parquet(tmp_path / "whole.parquet")
    (tmp_path / "project.toml").write_text(PROJECT)
    return tmp_path


def read(folder: Path, text: str = PROJECT) -> Project:
    (folder / "project.toml").write_text(text)
    return read_project(folder / "project.toml")


def test_chunks_are_the_poses_that_memory_would_hold(folder: Path) -> None:
    stream = project_stream(read(folder))
    assert stream is not None
    whole = load_dataset(read(folder, PROJECT.replace('"poses"', '"whole.parquet"'))).dataset
    chunks = [stream.chunk(number).data for number in range(stream.count)]
    assert len(chunks) > 5
    assert stream.poses == len(whole) == 250 - 2
    assert [pose for chunk in chunks for pose in chunk.poses] == list(whole.poses)
    for quantity in whole.quantities:
        together = np.concatenate([chunk[quantity] for chunk in chunks])
        assert np.array_equal(together, whole[quantity])
    assert chunks[-1].place(0, "xP").startswith("poses, part-2.parquet, row ")


def test_a_stream_reports_where_its_sds_come_from(folder: Path) -> None:
    encoders = PROJECT.replace('{ sd = 1e-4, unit = "rad" }', "{ encoder = { bits = 14 } }")
    read(folder, encoders)
    done = run_calibration(folder / "project.toml")
    sources = {q: n.source for n in done.written.document.noise for q in n.quantities}
    assert sources == {"phi2": "datasheet", "phi3": "datasheet", "xP": "given", "yP": "given"}


def test_a_calibration_from_a_stream_is_that_from_memory(folder: Path) -> None:
    streamed = run_calibration(folder / "project.toml")
    read(folder, PROJECT.replace('"poses"', '"whole.parquet"'))
    whole = run_calibration(folder / "project.toml", out=folder / "whole")
    assert streamed.objection is None
    for name, value in whole.result.value.items():
        sd = whole.result.sd[name]
        assert sd is not None
        assert streamed.result.value[name] == pytest.approx(value, abs=1e-7 * sd)
    assert streamed.written.files == (*whole.written.files, "residuals/")
    document = streamed.written.document
    assert document.data.used == 248
    assert document.data.poses == 500
    kept = pl.read_parquet(folder / "project-result" / "residuals" / "*.parquet")
    assert kept["pose"].to_list() == list(whole.result.dataset.poses)
    there = kept["phi2 correction [rad]"].to_numpy()
    assert there == pytest.approx(whole.result.corrections["phi2"], abs=1e-9)
    assert not (folder / "project-result" / "unfinished.json").exists()


def test_a_calibration_interrupted_at_any_iteration_ends_as_an_uninterrupted_one(
    folder: Path,
) -> None:
    class Broken(Exception):
        pass

    project, result = folder / "project.toml", folder / "project-result"
    whole = run_calibration(project, out=folder / "whole")
    iterations = whole.result.status.iterations
    assert iterations >= 3
    for last in range(1, iterations + 1):

        def interrupt(iteration: int, merit: float, decrement: float, last: int = last) -> None:
            if iteration == last:
                raise Broken

        with pytest.raises(Broken):
            run_calibration(project, listeners=Listeners(progress=interrupt))
        assert [path.name for path in result.iterdir()] == ["unfinished.json"]
        seen: list[int] = []
        told: list[str] = []
        done = run_calibration(
            project,
            listeners=Listeners(
                progress=lambda *given: seen.append(given[0]),  # noqa: B023
                notice=told.append,
            ),
        )
        where = f"resuming after iteration {last - 1} of an interrupted run"
        assert told == [f"{result / 'unfinished.json'}: {where}"]
        assert seen == list(range(last, iterations + 1))
        assert done.written.document == whole.written.document
        assert residuals(result) == residuals(folder / "whole")
        assert not (result / "unfinished.json").exists()
        shutil.rmtree(result)


def test_a_command_killed_anywhere_ends_as_an_uninterrupted_one(folder: Path) -> None:
    """Killed by SIGKILL again and again: each run reads so many chunks, 9 in a sweep."""
    result = folder / "project-result"

    def command(chunks: int, out: Path) -> subprocess.CompletedProcess[bytes]:
        arguments = ["calibrate", folder / "project.toml", "--out", out, "--no-report", "--json"]
        return subprocess.run(
            [sys.executable, "-c", KILLED, str(chunks), *map(str, arguments)],
            capture_output=True,
            env=environment(),
            check=False,
        )

    whole = command(1000, folder / "whole")
    assert whole.returncode == 0
    kept: list[int] = []
    for chunks in (15, 24, 24):
        assert command(chunks, result).returncode == -signal.SIGKILL
        unfinished = json.loads((result / "unfinished.json").read_text())
        kept.append(unfinished["checkpoint"]["iterations"])
    assert kept == [0, 1, 2]
    again = command(1000, result)
    assert again.returncode == 0
    assert json.loads(again.stdout) == json.loads(whole.stdout)
    assert residuals(result) == residuals(folder / "whole")


def test_what_a_killed_run_left_goes_with_the_next(folder: Path) -> None:
    result = folder / "project-result"
    killed = ResidualParts(result)
    killed.add(b"half of the poses")
    (result / "residuals").mkdir()
    (result / "residuals").rename(result / ".residuals.0123456789ab.old")
    run_calibration(folder / "project.toml")
    assert (result / "residuals" / "part-00001.parquet").exists()
    assert not list(result.glob(".*"))


def test_a_file_in_place_of_the_residuals_stays(folder: Path) -> None:
    result = folder / "project-result"
    result.mkdir()
    (result / "residuals").write_text("mine")
    with refused("unwritable-file"):
        run_calibration(folder / "project.toml")
    assert [path.name for path in result.iterdir()] == ["residuals"]
    assert (result / "residuals").read_text() == "mine"


@pytest.mark.parametrize("ending", [False, True])
def test_two_runs_into_one_folder_do_not_mix_their_residuals(tmp_path: Path, ending: bool) -> None:
    one, other = ResidualParts(tmp_path), ResidualParts(tmp_path)
    one.add(b"one, 1")
    other.begin()
    with refused("unwritable-file") as error:
        one.finish() if ending else one.add(b"one, 2")
    assert error.value.remedy
    other.add(b"other, 1")
    one.undo()
    other.finish()
    assert residuals(tmp_path) == {"part-00001.parquet": b"other, 1"}


def residuals(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted((folder / "residuals").iterdir())}


@pytest.mark.parametrize("executor", [Threads(2), Processes(2), Backwards()], ids=str)
def test_files_are_the_same_whoever_does_the_chunks(folder: Path, executor: Executor) -> None:
    alone = run_calibration(folder / "project.toml", out=folder / "alone")
    shared = run_calibration(folder / "project.toml", out=folder / "shared", executor=executor)
    assert shared.written.document == alone.written.document
    assert residuals(folder / "shared") == residuals(folder / "alone")
    assert len(residuals(folder / "shared")) == 9  # 5 of one file, 4 of the other


def test_the_command_takes_workers(folder: Path) -> None:
    (folder / "project.toml").write_text(PROJECT.replace("every = 2", "every = 3"))
    done = run_here("calibrate", folder / "project.toml", "--workers", "2", "--no-report", "--json")
    alone = run_calibration(folder / "project.toml", out=folder / "alone")
    found = {p["name"]: p["value"] for p in json.loads(done.stdout)["parameters"]}
    assert found == pytest.approx(dict(alone.result.value), rel=1e-12)  # other chunks


@pytest.mark.parametrize("executor", [Threads(2), Processes(2)], ids=str)
def test_interrupted_with_workers_it_ends_and_goes_on(folder: Path, executor: Executor) -> None:
    def interrupt(iteration: int, merit: float, decrement: float) -> None:
        if iteration == 2:
            raise KeyboardInterrupt

    project, threads = folder / "project.toml", threading.active_count()
    before = set(multiprocessing.active_children())  # those of a test of the app may end later
    with pytest.raises(KeyboardInterrupt):
        run_calibration(project, executor=executor, listeners=Listeners(progress=interrupt))
    assert threading.active_count() <= threads  # one of an earlier test may have ended
    assert before.issuperset(multiprocessing.active_children())
    result = folder / "project-result"
    assert [path.name for path in result.iterdir()] == ["unfinished.json"]
    shutil.copytree(result, folder / "alone")
    alone = run_calibration(project, out=folder / "alone")
    shared = run_calibration(project, executor=executor)
    assert shared.written.document == alone.written.document
    assert residuals(result) == residuals(folder / "alone")


def test_a_lost_worker_of_a_cluster_costs_nothing(folder: Path) -> None:
    alone = run_calibration(folder / "project.toml", out=folder / "alone")
    (folder / "dask").mkdir()
    with dask_cluster(folder / "dask") as cluster:
        cluster.start_workers("")
        cluster.start_workers("dying", DIES_AT_PIECE="7")  # in the second sweep
        cluster.start_workers("dying", DIES_AT_PIECE="10")
        executor = Cluster(cluster.address)
        shared = run_calibration(folder / "project.toml", out=folder / "shared", executor=executor)
        for worker in cluster.workers[1:]:
            assert worker.wait(300) == -signal.SIGKILL
    assert shared.written.document == alone.written.document
    assert residuals(folder / "shared") == residuals(folder / "alone")
    kept = pl.read_parquet(folder / "shared" / "residuals" / "*.parquet")
    assert kept["pose"].to_list() == list(alone.result.dataset.poses)


@pytest.mark.parametrize("what", ["changed", "gone"])
def test_a_file_that_is_another_one_where_the_work_is_done(folder: Path, what: str) -> None:
    def meddle(iteration: int, merit: float, decrement: float) -> None:
        path = folder / "poses" / "part-2.parquet"
        frame = pl.read_parquet(path)
        if what == "gone":
            path.unlink()
        else:
            frame.with_columns(phi2=pl.col("phi2").reverse(), xP=1.1 * pl.col("xP")).write_parquet(
                path
            )

    with refused("unreadable-file", "part-2.parquet", platform.node()) as fault:
        run_calibration(
            folder / "project.toml", executor=Threads(2), listeners=Listeners(progress=meddle)
        )
    assert "at this path" in str(fault.value.remedy)
    assert [path.name for path in (folder / "project-result").iterdir()] == ["unfinished.json"]


def test_a_stream_that_is_sent_need_not_look_at_its_files_again(folder: Path) -> None:
    stream = project_stream(read(folder))
    assert stream is not None
    there = pickle.dumps(stream)
    stream.chunk(0)
    sent = pickle.loads(pickle.dumps(stream))
    assert len(there) < 20_000
    for name in ("sha256", "_parts", "_excluded"):
        assert sent.__dict__[name] == stream.__dict__[name]


def test_what_was_reached_with_other_readings_is_not_gone_on_from(folder: Path) -> None:
    (folder / "project-result").mkdir()
    stale = {"task": "another", "checkpoint": {"damping": 0.0}}
    (folder / "project-result" / "unfinished.json").write_text(json.dumps(stale))
    told: list[str] = []
    done = run_calibration(folder / "project.toml", listeners=Listeners(notice=told.append))
    assert done.result.status.converged
    (line,) = told
    assert "from the beginning" in line
    run_calibration(folder / "project.toml", listeners=Listeners(notice=told.append))
    assert len(told) == 1  # nothing was left


def test_a_large_file_is_read_in_chunks_by_itself_or_when_asked(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = PROJECT.replace('"poses"', '"whole.parquet"')
    assert project_stream(read(folder, text)) is None
    assert project_stream(read(folder, text.replace("every", "stream = true\nevery"))) is not None
    monkeypatch.setattr(parquet_stream, "LARGE", 400)
    assert project_stream(read(folder, text)) is not None
    assert project_stream(read(folder, text.replace("every", "stream = false\nevery"))) is None


def test_a_folder_is_read_into_memory_when_asked(folder: Path) -> None:
    text = PROJECT.replace("every", "stream = false\nevery")
    data = load_dataset(read(folder, text)).dataset
    whole = load_dataset(read(folder, text.replace('"poses"', '"whole.parquet"'))).dataset
    assert data.poses == whole.poses
    for quantity in whole.quantities:
        assert np.array_equal(data[quantity], whole[quantity])
    stream = project_stream(read(folder))
    assert stream is not None
    assert data.source.sha256 == stream.sha256
    read(folder, text)
    done = run_here("calibrate", folder / "project.toml", "--folds", "3", "--no-report")
    assert "on poses not used" in done.stdout
    predicted = run_here("predict", folder / "project-result", folder / "poses")
    assert len(predicted.stdout.splitlines()) == 1 + 500


def test_files_of_a_folder_are_joined_by_pose(folder: Path) -> None:
    (folder / "seen").mkdir()
    for path in (folder / "poses").iterdir():
        frame = pl.read_parquet(path)
        frame.select("id", "phi2", "phi3").write_parquet(path)
        frame.select("xP", "id", "yP").write_parquet(folder / "seen" / path.name)
    join = '[[data.join]]\nfile = "seen"\npose = "id"\nunits = { length = "mm" }\n[noise]'
    text = PROJECT.replace("every", "stream = false\nevery").replace("[noise]", join)
    data = load_dataset(read(folder, text)).dataset
    whole = load_dataset(read(folder, PROJECT.replace('"poses"', '"whole.parquet"'))).dataset
    assert data.poses == whole.poses
    assert np.array_equal(data["xP"], whole["xP"])


def test_a_check_looks_at_some_poses_of_a_stream(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(last_pass, "SHOWN", 50)
    checked = run_check(folder / "project.toml")
    assert checked.check.poses == 63  # every fourth, none of them left out
    assert "63 of 248 poses" in checked.warnings[0]
    assert "up to 2 times smaller" in checked.warnings[0]
    read(folder, PROJECT.replace("every", "stream = false\nevery"))
    whole = run_check(folder / "project.toml")
    assert whole.check.poses == 248
    assert not whole.warnings
    for name, sd in whole.check.expected_sd.items():
        assert sd is not None
        assert checked.check.expected_sd[name] == pytest.approx(2 * sd, rel=0.2)


def test_a_file_that_is_there_twice_is_told(folder: Path) -> None:
    poses = folder / "poses"
    shutil.copy(poses / "part-1.parquet", poses / "part-3.parquet")
    stream = project_stream(read(folder))
    assert stream is not None
    told = [str(warning) for warning in stream.warnings]
    assert len(told) == 1
    assert "part-3.parquet" in told[0]
    assert "part-1.parquet" in told[0]


def test_folders_inside_are_told_and_not_looked_into(folder: Path) -> None:
    inside = folder / "poses" / "day-2"
    inside.mkdir()
    shutil.copy(folder / "poses" / "part-1.parquet", inside)
    told: list[str] = []
    done = run_calibration(folder / "project.toml", listeners=Listeners(warn=told.append))
    assert done.result.parts.about_readings == tuple(told)
    assert len(told) == 1
    assert "day-2/part-1.parquet" in told[0]
    (folder / "empty").mkdir()
    inside.rename(folder / "empty" / "day-2")
    read(folder, PROJECT.replace('"poses"', '"empty"'))
    with refused("wrong-file-type"):
        run_calibration(folder / "project.toml")


def test_what_is_odd_is_told_before_the_fit(folder: Path) -> None:
    for path in (folder / "poses").iterdir():
        frame = pl.read_parquet(path)
        frame.with_columns(pl.col("phi2", "phi3") * (np.pi / 180)).write_parquet(path)
    told: list[str] = []

    def interrupted(*_: object) -> None:
        assert len(told) == 2
        assert all("are these rad?" in words for words in told)
        raise KeyboardInterrupt

    for text in (PROJECT, PROJECT.replace("every", "stream = false\nevery")):
        told.clear()
        read(folder, text)
        with pytest.raises(KeyboardInterrupt):
            run_calibration(
                folder / "project.toml", listeners=Listeners(progress=interrupted, warn=told.append)
            )


@pytest.mark.parametrize("where", ["part-1.parquet", "part-2.parquet"])
def test_a_pose_without_an_id_is_refused(folder: Path, where: str) -> None:
    path = folder / "poses" / where
    frame = pl.read_parquet(path).with_row_index()
    frame = frame.with_columns(id=pl.when(pl.col("index") == 78).then(None).otherwise(pl.col("id")))
    frame.drop("index").write_parquet(path)
    for text in (PROJECT, PROJECT.replace("every", "stream = false\nevery")):
        read(folder, text)
        with refused("mismatched-poses", f"{where}, row 79"):
            run_calibration(folder / "project.toml")


def test_columns_of_the_files_may_come_in_any_order(folder: Path) -> None:
    alone = run_calibration(folder / "project.toml", out=folder / "alone")
    path = folder / "poses" / "part-2.parquet"
    frame = pl.read_parquet(path)
    frame.select(sorted(frame.columns)).write_parquet(path)
    again = run_calibration(folder / "project.toml", out=folder / "again")
    assert dict(again.result.value) == dict(alone.result.value)


def test_an_infinite_reading_is_told_with_its_file(folder: Path) -> None:
    path = folder / "poses" / "part-2.parquet"
    frame = pl.read_parquet(path).with_row_index()
    odd = pl.when(pl.col("index") == 78).then(np.inf).otherwise(pl.col("xP"))
    frame.with_columns(xP=odd).drop("index").write_parquet(path)
    with refused("invalid-number", "part-2.parquet", "row 79", "column 'xP'"):
        run_calibration(folder / "project.toml")


def test_a_robust_calibration_from_a_stream_is_that_from_memory(folder: Path) -> None:
    text = PROJECT.replace("fit = { ", 'fit = { loss = "huber", ')
    read(folder, text)
    streamed = run_calibration(folder / "project.toml").result
    read(folder, text.replace('"poses"', '"whole.parquet"'))
    whole = run_calibration(folder / "project.toml", out=folder / "whole").result
    for name, sd in whole.sd.items():
        assert streamed.value[name] == pytest.approx(whole.value[name], abs=1e-6 * (sd or 0.0))
        assert streamed.sd[name] == (sd and pytest.approx(sd, rel=1e-9))


@pytest.mark.parametrize(
    ("old", "new", "code", "stated"),
    [
        ('"p301"', '"p999"', "unknown-name", ("'p999'",)),
        (
            "fit = { ",
            "fit = { validation = { folds = 5 }, ",
            "unsupported",
            ("validation",),
        ),
        (
            "implicit-loop",
            "reweighted",
            "unsupported",
            ("'reweighted'",),
        ),
        ('"poses"', '"empty"', "wrong-file-type", ("empty", "Parquet")),
        ('"poses"', '"mixed"', "unreadable-file", ("a.parquet", "b.parquet")),
    ],
)
def test_what_a_stream_cannot_do_is_refused(
    folder: Path, old: str, new: str, code: Code, stated: tuple[str, ...]
) -> None:
    (folder / "empty").mkdir()
    (folder / "mixed").mkdir()
    for name in ("a", "b"):
        pl.DataFrame({name: [1.0]}).write_parquet(folder / "mixed" / f"{name}.parquet")
    read(folder, PROJECT.replace(old, new))
    with refused(code, *stated) as error:
        run_calibration(folder / "project.toml")
    assert error.value.remedy
    assert not (folder / "project-result" / "residuals").exists()


@pytest.mark.parametrize("asked", [{"folds": 5}, {"profile": ["*"]}, {"compare": True}], ids=str)
def test_no_cluster_is_asked_for_what_is_refused(folder: Path, asked: dict[str, Any]) -> None:
    met: list[Executor] = []
    with refused("unsupported"):
        run_calibration(
            folder / "project.toml",
            Request(**asked),
            executor=Threads(2),
            listeners=Listeners(sharing=met.append),
        )
    assert not met

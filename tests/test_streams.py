"""Readings that come in chunks: from Parquet to written results, and on from an interruption."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from loopcal import Noise
from loopcal.errors import InputError
from loopcal.files import parquet_stream
from loopcal.files.parquet_stream import project_stream
from loopcal.files.project_data import load_dataset
from loopcal.files.project_file import Project, read_project
from loopcal.mechanisms.planar import planar_two_link
from loopcal.simulation.poses import random_poses
from loopcal.simulation.simulate import simulate
from loopcal.workflow.calibration import run_calibration

PROJECT = """
schema = 1
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


def test_a_calibration_from_a_stream_is_that_from_memory(folder: Path) -> None:
    streamed = run_calibration(folder / "project.toml")
    read(folder, PROJECT.replace('"poses"', '"whole.parquet"'))
    whole = run_calibration(folder / "project.toml", out=folder / "whole")
    assert streamed.objection is None
    for name, value in whole.result.value.items():
        sd = whole.result.sd[name]
        assert sd is not None
        assert streamed.result.value[name] == pytest.approx(value, abs=1e-7 * sd)
    document = streamed.written.document
    assert document["data"]["used"] == 248
    assert document["data"]["poses"] == 500
    kept = pl.read_parquet(folder / "project-result" / "residuals" / "*.parquet")
    assert kept["pose"].to_list() == list(whole.result.dataset.poses)
    there = kept["phi2 correction [rad]"].to_numpy()
    assert there == pytest.approx(whole.result.corrections["phi2"], abs=1e-9)
    assert not (folder / "project-result" / "unfinished.json").exists()


def test_an_interrupted_calibration_goes_on_and_leaves_nothing_half_done(folder: Path) -> None:
    class Broken(Exception):
        pass

    def interrupt(iteration: int, merit: float, decrement: float) -> None:
        if iteration == 2:
            raise Broken

    with pytest.raises(Broken):
        run_calibration(folder / "project.toml", progress=interrupt)
    result = folder / "project-result"
    assert [path.name for path in result.iterdir()] == ["unfinished.json"]
    reached = json.loads((result / "unfinished.json").read_text())["parameters"]
    assert reached["l2"] == pytest.approx(0.803, abs=1e-3)
    seen: list[float] = []
    done = run_calibration(
        folder / "project.toml", progress=lambda i, merit, decrement: seen.append(merit)
    )
    assert seen[0] < 1000.0  # it began near the end, not at the nominal machine
    assert any("interrupted" in warning for warning in done.result.warnings)
    assert not (result / "unfinished.json").exists()


def test_what_was_reached_with_other_readings_is_not_gone_on_from(folder: Path) -> None:
    (folder / "project-result").mkdir()
    stale = {"task": "another", "parameters": {"l2": 7.0}}
    (folder / "project-result" / "unfinished.json").write_text(json.dumps(stale))
    done = run_calibration(folder / "project.toml")
    assert not any("interrupted" in warning for warning in done.result.warnings)


def test_a_large_file_is_read_in_chunks_by_itself_or_when_asked(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = PROJECT.replace('"poses"', '"whole.parquet"')
    assert project_stream(read(folder, text)) is None
    assert project_stream(read(folder, text.replace("every", "stream = true\nevery"))) is not None
    monkeypatch.setattr(parquet_stream, "LARGE", 400)
    assert project_stream(read(folder, text)) is not None
    assert project_stream(read(folder, text.replace("every", "stream = false\nevery"))) is None


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"p301"', '"p999"', "no pose 'p999'"),
        ("schema = 1", "schema = 1\nfit = { validation = { folds = 5 } }", "a validation needs"),
        ("schema = 1", 'schema = 1\nfit = { loss = "huber" }', "the loss 'huber' needs"),
        ("schema = 1", 'schema = 1\nfit = { method = "reweighted" }', "'reweighted' needs"),
        ('"poses"', '"empty"', "no Parquet file"),
        ('"poses"', '"mixed"', "its columns are not those of"),
    ],
)
def test_what_a_stream_cannot_do_is_refused(folder: Path, old: str, new: str, words: str) -> None:
    (folder / "empty").mkdir()
    (folder / "mixed").mkdir()
    for name in ("a", "b"):
        pl.DataFrame({name: [1.0]}).write_parquet(folder / "mixed" / f"{name}.parquet")
    read(folder, PROJECT.replace(old, new))
    with pytest.raises(InputError, match=words) as refused:
        run_calibration(folder / "project.toml")
    assert refused.value.remedy
    assert not (folder / "project-result" / "residuals").exists()

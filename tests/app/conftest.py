"""One folder whose every name is a page's script, calibrated, and the app on it."""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from loopcal.files.project.project_folder import NAME as LOCK
from tests.app.serving import Served, serving
from tests.browser import chromium
from tests.command_line import run_here as run

SCRIPT = "<img src=x onerror=window.hit=1>"
"""What must be shown as text wherever it stands."""


@pytest.fixture(scope="session")
def hostile(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A planar arm: columns, pose ids, title, file and log full of HTML; with its result."""
    folder = tmp_path_factory.mktemp("app") / "arm"
    project = folder / "project.toml"
    assert run("new", folder, "--mechanism", "planar-two-link").returncode == 0
    plain = project.read_text("utf-8").replace("step = 10", "step = 30")
    project.write_text(plain.replace('"auto" ', '"implicit-loop" '), "utf-8")
    readings = folder / "poses.csv"
    assert run("simulate", project, "--out", readings, "--seed", "1").returncode == 0
    with readings.open(newline="") as file:
        head, *rows = csv.reader(file)
    named = [f"{SCRIPT}{name}" for name in head]
    with (folder / f"{SCRIPT}.csv").open("w", newline="") as file:
        csv.writer(file).writerows([named, *([f"{SCRIPT}{row[0]}", *row[1:]] for row in rows)])
    text = project.read_text("utf-8").replace('"poses.csv"', json.dumps(f"{SCRIPT}.csv"))
    text = text.replace('"A planar two-link arm"', json.dumps(SCRIPT))
    for name in head:
        text = text.replace(f'column = "{name}"', f"column = {json.dumps(SCRIPT + name)}")
    text = text.replace('pose = "pose"', f"pose = {json.dumps(SCRIPT + 'pose')}")
    project.write_text(text, "utf-8")
    done = run("calibrate", project)
    assert done.returncode == 0, done.stderr
    told = {"at": "2026-01-01T00:00:00+00:00", "kind": "note", "what": SCRIPT, "reason": SCRIPT}
    (folder / "loopcal-log.jsonl").write_text(json.dumps(told) + "\n", "utf-8")
    return folder


@pytest.fixture(scope="session")
def served(hostile: Path) -> Iterator[Served]:
    """The app on it."""
    with serving(hostile) as server:
        yield server


@pytest.fixture(scope="session")
def served_cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Served, Path]]:
    """The app on a folder that is empty at first."""
    folder = tmp_path_factory.mktemp("app") / "cell"
    folder.mkdir()
    with serving(folder) as server:
        yield server, folder


@pytest.fixture
def cell(served_cell: tuple[Served, Path]) -> tuple[Served, Path]:
    """The same, with nothing in the folder but the lock of the server."""
    server, folder = served_cell
    for entry in folder.iterdir():
        if entry.is_dir():
            shutil.rmtree(entry)
        elif entry.name != LOCK:
            entry.unlink()
    return server, folder


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """Chromium."""
    with chromium() as found:
        yield found

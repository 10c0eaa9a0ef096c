"""What the report says of other days: verifications, history and fleet of a result."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

import loopcal as lc
from loopcal.companions.life.fleet import Fleet
from loopcal.companions.life.fleet_files import run_fleet
from loopcal.companions.life.history import History
from loopcal.companions.life.history_files import run_history
from loopcal.companions.life.pages import other_days
from loopcal.companions.life.report_sections import sections
from loopcal.companions.life.update_files import run_update
from loopcal.document.plain import rebuilt
from loopcal.figures.figure import Figure
from loopcal.files.result.deployed import FLEET, HISTORY, VERIFICATION, read_deployed
from loopcal.report.page import report_html
from loopcal.report.source import read_source
from loopcal.statistics.changed import WhatChanged
from loopcal.workflow.checking import run_verification
from tests.command_line import run_here as run

PLANAR = Path(__file__).resolve().parents[2] / "examples" / "planar"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three calibrations of a planar arm, of which the first was verified and entered."""
    made = tmp_path_factory.mktemp("days")
    header, *rows = (PLANAR / "poses.csv").read_text("utf-8").splitlines()
    for i, name in enumerate(("one", "two", "three")):
        shutil.copytree(PLANAR, made / f"planar-{name}")
        own = "\n".join([header, *rows[i::3]])
        (made / f"planar-{name}" / "poses.csv").write_text(f"{own}\n", "utf-8")
        project, out = made / f"planar-{name}" / "project.toml", made / name
        run("calibrate", project, "--method", "implicit-loop", "--out", out, "--no-report")
    run_verification(made / "one", made / "planar-two" / "poses.csv")
    run_history(made / "arm.history", add=[made / "one"], events=["new <belt>"])
    run_history(made / "arm.history", add=[made / "two"])
    run_fleet([made / name for name in ("one", "two", "three")], out=made / "fleet.toml")
    return made


def test_the_report_has_what_was_found_on_other_days(folder: Path) -> None:
    page = report_html([read_source(folder / "two")], sections)
    assert 'id="later"' in page
    assert "new &lt;belt&gt;" in page
    assert "new <belt>" not in page
    verified = report_html([read_source(folder / "one")], sections)
    assert "poses.csv" in verified
    assert "What changed: poses.csv" in verified
    assert re.search(r"lengths_\d", verified)


def test_a_result_without_other_days_has_no_such_section(folder: Path, tmp_path: Path) -> None:
    shutil.copytree(folder / "three", tmp_path / "bare")
    shutil.rmtree(tmp_path / "bare" / "deployed")
    assert 'id="later"' not in report_html([read_source(tmp_path / "bare")], sections)


def test_notes_hold_what_the_commands_found(folder: Path) -> None:
    notes = {one.kind: one.document for one in read_deployed(folder / "one" / "result.json")}
    assert notes.keys() == {VERIFICATION, HISTORY, FLEET}
    its = notes[VERIFICATION]
    found = WhatChanged.from_document(its["changes"], its["chi_squared"])
    assert found.document() == its["changes"]
    verified = run_verification(folder / "one", folder / "planar-two" / "poses.csv")
    assert verified.changes is not None
    assert found.lines() == verified.changes.lines()
    history = History.from_document(notes[HISTORY])
    assert [one.name for one in history.trends] == [
        one.name for one in lc.history(folder / "arm.history").trends
    ]
    assert len(history.trends[0].values) == 1
    fleet = rebuilt(Fleet, notes[FLEET])
    names = [folder / name for name in ("one", "two", "three")]
    assert fleet.parameters == lc.fleet(names).parameters


def test_the_report_of_an_update_draws_by_how_much_it_narrowed(folder: Path) -> None:
    run_update(folder / "one", folder / "planar-two" / "poses.csv", out=folder / "new")
    source = read_source(folder / "new")
    found = other_days(source)
    assert found is not None
    assert found.words[0].startswith("This result updates an earlier calibration: the sds of ")
    figure = next(one for one in found.parts if getattr(one, "key", "") == "sds_lengths")
    assert isinstance(figure, Figure)
    before, after = (np.array(bar["x"]) for bar in figure.data)
    assert (after < before).all()
    assert 'id="later"' in report_html([source], sections)


def test_a_damaged_note_is_named_and_left_out(folder: Path, tmp_path: Path) -> None:
    shutil.copytree(folder / "one", tmp_path / "one")
    note = tmp_path / "one" / "deployed" / "verification-poses.json"
    told = json.loads(note.read_text("utf-8"))
    note.write_text(json.dumps({**told, "changes": {"found": 3}}), "utf-8")
    source = read_source(tmp_path / "one")
    found = other_days(source)
    assert found is not None
    assert [words for words in found.words if "verification" in words and "damaged" in words]
    assert not [one for one in found.parts if "poses.csv" in getattr(one, "caption", "")]

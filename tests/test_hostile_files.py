"""Files altered at random: every command ends as it should, and none with a fault of ours."""

from __future__ import annotations

import random
import shutil
from pathlib import Path

import pytest

from analyses.hostile_files import DATA, PROJECT, altered, fault_of
from analyses.hostile_inputs import KINDS, kept, state
from loopcal.cli import main


@pytest.fixture(scope="module")
def valid(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("hostile") / "arm"
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder.parent)
        assert main(["new", "arm", "--mechanism", "planar-two-link"]) == 0
        project = folder / PROJECT
        text = project.read_text("utf-8").replace('"auto" ', '"implicit-loop" ')
        project.write_text(text, "utf-8")
        patch.chdir(folder)
        assert main(["simulate", PROJECT, "--out", DATA, "--seed", "1"]) == 0
        assert main(["calibrate", PROJECT, "--no-report"]) == 0
    return folder


@pytest.mark.parametrize("number", range(1, 25))
def test_an_altered_file_is_met_without_a_fault(
    number: int,
    valid: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder = shutil.copytree(valid, tmp_path / "arm")
    _, _, command = altered(folder, number)
    monkeypatch.chdir(folder)
    capsys.readouterr()
    code = main([*command])
    said = capsys.readouterr()
    assert not fault_of(code, said.out, said.err)


SAMPLE = [
    (kind, number)
    for kind in ("text_tables", "projects", "functions", "arguments")
    for number in (1, 2, 3)
]


@pytest.mark.parametrize(("kind", "number"), SAMPLE)
def test_a_hostile_input_is_met_and_nothing_is_lost(
    kind: str,
    number: int,
    valid: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder = shutil.copytree(valid, tmp_path / "arm")
    for name in ("other.csv", "dh.csv", "arm.csv", "targets.csv"):
        shutil.copy(folder / DATA, folder / name)
    monkeypatch.chdir(folder)
    command = KINDS[kind](folder, random.Random(number))
    before = state(folder)
    capsys.readouterr()
    code = main([*command])
    said = capsys.readouterr()
    assert not fault_of(code, said.out, said.err), command
    after = state(folder)
    lost = [name for name, its in before.items() if after.get(name) != its and kept(name, command)]
    assert not lost, command


@pytest.mark.parametrize(
    ("code", "said"), [(1, ""), (0, "Traceback (most"), (0, "\x1b[2J"), (3, "a" * 30_000)]
)
def test_what_is_a_fault_is_seen(code: int, said: str) -> None:
    assert fault_of(code, "", said)
    assert not fault_of(3, "", "loopcal: there is no such file")

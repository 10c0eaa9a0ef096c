"""The command `loopcal record`: the page, its check, and the [record] of a project as it is now."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from loopcal.cli import main


def test_a_record_is_written_and_checked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["new", "arm", "--mechanism", "planar-two-link"]) == 0
    project = tmp_path / "arm" / "project.toml"
    assert main(["simulate", str(project), "--out", "arm/poses.csv"]) == 0
    fit = ["--method", "least-squares", "--no-report", "--out", "arm/result"]
    assert main(["calibrate", str(project), *fit]) == 0
    with project.open("a", encoding="utf-8") as file:
        file.write('\n[record]\ncustomer = "Example Works"\nnumber = "17"\n')
    capsys.readouterr()
    assert main(["record", "arm/result", "--project", str(project), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["number"] == "17"
    assert "customer" not in document["missing"]
    assert "operator" in document["missing"]
    page = tmp_path / "arm" / "result" / "record.html"
    assert "Example Works" in page.read_text("utf-8")
    assert main(["record", "--verify", str(page)]) == 0
    assert main(["record", "--verify", str(page.parent)]) == 0
    assert "unaltered" in capsys.readouterr().out
    project.write_text(project.read_text("utf-8") + "\n", "utf-8")
    assert main(["record", "--verify", str(page), "--json"]) == 4
    assert json.loads(capsys.readouterr().out)["files"]["project.toml"] == "altered"


def test_wrong_use_ends_with_its_code(tmp_path: Path) -> None:
    assert main(["record", str(tmp_path)]) == 3
    assert main(["record", str(tmp_path), "--verify", "--out", "page.html"]) == 2

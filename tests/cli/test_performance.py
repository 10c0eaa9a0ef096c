"""The command `loopcal performance`: text, JSON, page and template."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

import loopcal as lc
from loopcal.cli import main


@pytest.fixture
def table(tmp_path: Path) -> Path:
    """The template with measured values filled in."""
    folder = tmp_path / "test"
    assert main(["new", str(folder), "--performance"]) == 0
    path = folder / "performance.csv"
    rng = np.random.default_rng(1)
    lines = path.read_text("utf-8").splitlines()
    for i, line in enumerate(lines[1:], 1):
        pose, cycle, *asked = line.rstrip(",").split(",")
        at = np.array(asked, dtype=float) + rng.normal([0.2, 0.0, 0.1], 0.02)
        lines[i] = ",".join([pose, cycle, *asked, *(f"{v:.4f}" for v in at)])
    path.write_text("\n".join(lines), "utf-8")
    return path


def test_text_and_json_show_the_same_figures(
    table: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    capsys.readouterr()
    assert main(["performance", str(table), "--instrument-sd", "5 um"]) == 0
    text = capsys.readouterr().out
    assert main(["performance", str(table), "--instrument-sd", "5 um", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert "no conformity" in document["method"]
    pose = document["conditions"][0]["poses"][0]
    assert f"{1e3 * pose['accuracy']['value']:.4f}" in text
    assert pose["accuracy"]["value"] == pytest.approx(2.24e-4, abs=2e-5)
    assert "Not computed" in text
    found = lc.performance(table, instrument_sd="5 um")
    assert isinstance(found, lc.Performance)
    assert found.conditions[0].poses[0].accuracy.value == pose["accuracy"]["value"]


def test_the_template_is_not_overwritten(table: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["new", str(table.parent), "--performance"]) == 3
    assert "exists" in capsys.readouterr().err
    assert main(["new", str(table.parent)]) == 2


def test_wrong_options_end_with_their_code(table: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["performance", str(table), "--distance", "P1"]) == 2
    assert main(["performance", str(table), "--instrument-sd", "5 kg"]) == 3
    assert main(["performance", str(table), "--tracker", "leica-at50"]) == 3
    assert "leica-at500" in capsys.readouterr().err
    assert main(["performance", str(table), "--station", "1 m, 2 m, 3 m"]) == 3


def test_the_page_has_its_figures(table: Path) -> None:
    """`tests/report/test_on_paper.py` draws it, without any network."""
    page = table.with_name("page.html")
    assert main(["performance", str(table), "--out", str(page)]) == 0
    text = page.read_text("utf-8")
    assert len(re.findall(r'class="[^"]*\bplot\b', text)) == 3
    assert "AP after fitting the base" in text

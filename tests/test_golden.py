"""The printed summary and the report's text, word for word; see tests/golden_files.py."""

from __future__ import annotations

from pathlib import Path
from shutil import copytree, ignore_patterns

import pytest

from loopcal.cli import main
from tests import golden_files as golden

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


def test_summary_and_report_say_what_they_said(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    copytree(EXAMPLES / "planar", "planar", ignore=ignore_patterns("*-result"))
    asked = ["--method", "implicit-loop", "--folds", "4", "--full"]
    assert main(["calibrate", "planar/project.toml", "--out", "out", *asked]) == 0
    golden.check("summary.txt", capsys.readouterr().out)
    page = (tmp_path / "out" / "report.html").read_text("utf-8")
    golden.check("report.txt", golden.page_text(page))


def test_only_what_may_differ_is_taken_out() -> None:
    text = "rms  1.2345 mm, 3.1e-16, 2,345 poses, x6B, SHA " + "ab" * 32
    assert golden.normalised(text) == "rms 1.23 mm, tiny, 2,345 poses, x6B, SHA HASH\n"
    assert golden.page_text("<p>a<b>b</b></p><script>x</script><td>1</td>") == "ab\n1 |"

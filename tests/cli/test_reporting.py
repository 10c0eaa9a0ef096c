"""`loopcal report`, and what becomes of reports when results are written again."""

from __future__ import annotations

from pathlib import Path

from tests.cli.conftest import Run, contents


def test_the_page_lies_beside_the_result(folder: Path, run: Run) -> None:
    page = folder / "project-result" / "report.html"
    first = page.read_bytes()
    page.unlink()
    done = run("report", "project-result")
    assert (done.code, done.err) == (0, "")
    assert done.out == "written to project-result/report.html\n"
    assert page.read_bytes() == first


def test_several_results_need_a_file(folder: Path, run: Run) -> None:
    before = contents(folder)
    done = run("report", "project-result", "project-result/result.json")
    assert done.code == 2
    assert "--out" in done.err
    assert contents(folder) == before
    assert run("report", "project-result", "project-result", "--out", "both.html").code == 0
    assert (folder / "both.html").read_text("utf-8").count("Use it with care") >= 2


def test_without_a_report_an_earlier_one_goes(folder: Path, run: Run) -> None:
    done = run("calibrate", "project.toml", "--no-report")
    assert done.code == 0
    assert done.out.endswith("result.json, residuals.csv, mechanism.toml\n")
    assert not (folder / "project-result" / "report.html").exists()
    assert "report.html" not in str(sorted((folder / "project-result").iterdir()))


def test_what_is_no_result_is_told(folder: Path, run: Run) -> None:
    before = contents(folder)
    for place in ("nowhere", "project.toml", "readings.csv"):
        done = run("report", place)
        assert done.code == 3, place
        assert place in done.err
    (folder / "project-result" / "residuals.csv").write_text("")
    done = run("report", "project-result")
    assert done.code == 3
    assert "residuals.csv" in done.err
    (folder / "project-result" / "residuals.csv").write_bytes(
        before["project-result/residuals.csv"]
    )
    assert contents(folder) == before

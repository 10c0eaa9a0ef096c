"""`loopcal demo`: a calibration and its report without any file, as README prints it."""

from __future__ import annotations

import re
from pathlib import Path

from tests.command_line import run_here

README = Path(__file__).resolve().parents[2] / "README.md"


def test_the_demo_prints_what_readme_says(tmp_path: Path) -> None:
    done = run_here("demo", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    printed = re.search(r"prints:\n\n```text\n(.*?)```", README.read_text("utf-8"), re.S)
    assert printed is not None
    assert {*printed[1].splitlines()} <= {*done.stdout.splitlines(), "..."}
    assert (tmp_path / "loopcal-demo" / "project-result" / "report.html").is_file()
    error = re.search(r"is off by (\S+) mm rms", done.stdout)
    assert error is not None
    assert float(error[1]) < 0.05

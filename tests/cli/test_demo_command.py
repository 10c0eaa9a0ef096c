"""`loopcal demo`: a calibration and its report without any file; README is run by test_docs."""

from __future__ import annotations

import re
from pathlib import Path

from tests.command_line import run_here


def test_the_demo_calibrates_and_tells_the_true_error(tmp_path: Path) -> None:
    done = run_here("demo", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "loopcal-demo" / "project-result" / "report.html").is_file()
    error = re.search(r"is off by (\S+) mm rms", done.stdout)
    assert error is not None
    assert float(error[1]) < 0.05

"""Reports of results on the disk."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from loopcal.companions import called
from loopcal.errors import UsageError
from loopcal.files.atomic import write_atomic
from loopcal.files.result.deployed import result_path
from loopcal.report.page import report_html
from loopcal.report.source import read_source


def run_report(results: Sequence[str | Path], out: str | Path | None) -> Path:
    """Write the report of results that `loopcal calibrate` wrote, several side by side.

    out: the file, by default report.html in the folder of the only result. Raises InputError for
    what cannot be read or written, UsageError for several results and no `out`.
    """
    if out is None and len(results) > 1:
        raise UsageError(
            "several results are given, but no file for their report",
            remedy="name it: --out report.html",
        )
    page = report_html([read_source(path) for path in results], called("sections"))
    path = Path(out) if out is not None else result_path(results[0]).with_name("report.html")
    write_atomic(path, page)
    return path

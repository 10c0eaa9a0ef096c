"""The report of one result, as a text or a file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from loopcal.companions import called
from loopcal.errors import InputError
from loopcal.files.atomic import write_atomic
from loopcal.report.page import report_html
from loopcal.report.source import read_source


def report(result: Any, out: str | Path = "report.html") -> Path:
    """Write the report of a result, one self-contained HTML page, and return its path.

    result: of `calibrate` or `read_result`, or the path of its folder. Raises InputError for
    anything else, and where the page cannot be written.
    """
    write_atomic(Path(out), html_of(result))
    return Path(out)


def html_of(result: Any) -> str:
    """The page of the report."""
    if isinstance(result, str | Path):
        return report_html([read_source(result)], called("sections"))
    if not hasattr(result, "source"):
        raise InputError(
            f"a {type(result).__name__} is no result",
            code="invalid-value",
            remedy="give what lc.calibrate or lc.read_result returns, or the path of a folder",
        )
    return report_html([result.source], called("sections"))

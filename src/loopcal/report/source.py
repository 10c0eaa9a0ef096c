"""What a report is made of: result.json, residuals.csv and the calibrated mechanism."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from loopcal.estimation.result import Result
from loopcal.files.machines.mechanism_file import read_arm
from loopcal.files.result.result_columns import ResultColumns, read_result_columns
from loopcal.files.result.result_file import read_result
from loopcal.mechanisms.mechanism import Mechanism


@dataclass(frozen=True, eq=False)
class Source:
    """One result.

    name: what tells it from others; document: of result.json; columns: of residuals.csv;
    mechanism: the calibrated one, None where only its author's code has it.
    """

    name: str
    document: Mapping[str, Any]
    columns: ResultColumns
    mechanism: Mechanism | None

    @property
    def title(self) -> str:
        """Title of the project, or the name of the result."""
        return str(self.document["title"] or self.name)


def source_of(result: Result, document: Mapping[str, Any], folder: str | Path) -> Source:
    """Of a result and its document, about to be written to a folder."""
    return Source(Path(folder).name, document, ResultColumns.of(result), result.calibrated)


def read_source(path: str | Path) -> Source:
    """Of a folder that `loopcal calibrate` wrote, or of the result.json in it.

    Raises InputError where result.json, residuals.csv or mechanism.toml are absent or wrong.
    """
    path = Path(path)
    if path.name != "result.json":
        path = path / "result.json"
    document = read_result(path)
    columns = read_result_columns(path.with_name("residuals.csv"))
    mechanism = read_arm(path.with_name("mechanism.toml"))
    return Source(path.absolute().parent.name, document, columns, mechanism)

"""What a report is made of: result.json, residuals.csv and the calibrated mechanism."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import date
from pathlib import Path

from loopcal.document.result_document import MechanismEntry, ResultDocument
from loopcal.estimation.result import FitResult
from loopcal.files.machines.mechanism_file import read_arm
from loopcal.files.result.deployed import Deployed, read_deployed
from loopcal.files.result.pose_table import PoseTable, pose_table, read_pose_table
from loopcal.files.result.result_file import read_result
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.presentation.shown import brief
from loopcal.report.templates import today


@dataclass(frozen=True, eq=False)
class Source:
    """One result.

    name: what distinguishes it from others; document: of result.json; table: of residuals.csv;
    mechanism: the calibrated one, None where only its author's code has it; deployed: what was made
    of it since; written: the day on which the result was.
    """

    __repr__ = brief

    name: str
    document: ResultDocument
    table: PoseTable
    mechanism: Mechanism | None
    deployed: tuple[Deployed, ...] = ()
    written: str = field(default_factory=today)

    @property
    def title(self) -> str:
        """Title of the project, or the name of the result."""
        return self.document.title or self.name


def source_of(result: FitResult, document: ResultDocument, folder: str | Path) -> Source:
    """Of a result and its document, about to be written to a folder."""
    return Source(Path(folder).name, document, pose_table(result), result.calibrated)


def read_source(path: str | Path) -> Source:
    """Of a folder that `loopcal calibrate` wrote, or of the result.json in it.

    Raises InputError where result.json, residuals.csv or mechanism.toml are absent or wrong.
    """
    path = Path(path)
    if path.name != "result.json":
        path = path / "result.json"
    document = read_result(path)
    mechanism = read_arm(path.with_name("mechanism.toml"))
    names = document.mechanism
    if names is None and mechanism is not None:
        names = MechanismEntry.of(mechanism)
    table = read_pose_table(path.with_name("residuals.csv"), names)
    written = date.fromtimestamp(path.stat().st_mtime).isoformat()
    name, deployed = path.absolute().parent.name, read_deployed(path)
    return Source(name, document, table, mechanism, deployed, written)

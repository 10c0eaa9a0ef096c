"""The calibration record of a result on the disk, and its check."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from loopcal.files.atomic import write_atomic
from loopcal.files.result.record_file import RecordCheck, RecordFile, check_record, record_files
from loopcal.files.result.result_file import read_result
from loopcal.files.toml.place import Place
from loopcal.files.toml.reader import checked_schema, read_toml
from loopcal.report.record_page import record_page

PAGE = "record.html"


@dataclass(frozen=True)
class Record:
    """A calibration record that was written.

    path: of the page; number: unique; title: "Calibration record", or "Calibration certificate"
    where an accreditation is stated; files: those behind it; missing: keys of [record] that it
    prints as "not stated".
    """

    path: Path
    number: str
    title: str
    files: tuple[RecordFile, ...]
    missing: tuple[str, ...]

    def document(self) -> dict[str, Any]:
        """Plain data for JSON."""
        return {
            "path": str(self.path),
            "number": self.number,
            "title": self.title,
            "files": [vars(file) for file in self.files],
            "missing": list(self.missing),
        }

    def __str__(self) -> str:
        lines = [f"{self.title} {self.number} written to {self.path}"]
        if self.missing:
            lines.append(f"not stated in [record]: {', '.join(self.missing)}")
        lost = [file.name for file in self.files if file.path is None]
        if lost:
            lines.append(f"not found, only the SHA-256 is recorded: {', '.join(lost)}")
        return "\n".join(lines)


def record(
    result: str | Path, *, project: str | Path | None = None, out: str | Path | None = None
) -> Record:
    """Write the calibration record of a result folder: one page for print.

    project: the project file, whose [record] is taken as it is now; without it that of the
    calibration is. out: the page, by default record.html in the folder of the result. Raises
    InputError for what cannot be read or written, and for readings that changed since.
    """
    path = Path(result)
    path = path if path.name == "result.json" else path / "result.json"
    document = read_result(path)
    stated: Mapping[str, Any] = document.inputs.get("record") or {}
    if project is not None:
        stated = _stated(Path(project))
    page = path.with_name(PAGE) if out is None else Path(out)
    files = record_files(path, document, page, None if project is None else Path(project))
    made = record_page(document, {k: str(v) for k, v in stated.items() if v is not None}, files)
    write_atomic(page, made.html)
    return Record(page, made.number, made.title, files, made.missing)


def verify_record(path: str | Path) -> RecordCheck:
    """Check whether a record and the files behind it are as they were when it was written.

    Raises InputError for a file that is no record.
    """
    return check_record(path)


def _stated(project: Path) -> dict[str, Any]:
    """[record] of a project file as it is now."""
    from loopcal.files.project.project_schema import ProjectModel
    from loopcal.files.toml.model import validated

    place = Place(str(project))
    data = read_toml(project)
    checked_schema(data, place)
    return validated(ProjectModel, data, place).record.model_dump()

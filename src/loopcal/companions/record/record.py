"""The calibration record of a result on the disk, as page and as XML, and its check."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from loopcal.companions.record.budget import Budget, LengthErrors, budgets
from loopcal.companions.record.content import RecordContent, record_content
from loopcal.companions.record.page import record_page
from loopcal.companions.record.record_file import (
    RecordCheck,
    RecordFile,
    check_record,
    record_files,
)
from loopcal.companions.record.xml_schema import check_against, schema_version
from loopcal.document.result_document import ResultDocument
from loopcal.errors import InputError
from loopcal.files.atomic import write_all
from loopcal.files.toml.place import Place
from loopcal.files.toml.reader import checked_schema, read_toml
from loopcal.workflow.saved_result import SavedResult, read_result

PAGE = "record.html"


@dataclass(frozen=True)
class Record:
    """A calibration record that was written.

    path: of the page; number: unique; title: "Calibration record", or "Calibration certificate"
    where an accreditation is stated; files: those behind it; missing: keys of [record] that it
    prints as "not stated"; dcc: path of the digital calibration certificate, None if not asked for;
    cautions: dates that do not agree.
    """

    path: Path
    number: str
    title: str
    files: tuple[RecordFile, ...]
    missing: tuple[str, ...]
    dcc: Path | None = None
    cautions: tuple[str, ...] = ()

    def document(self) -> dict[str, Any]:
        """Plain data for JSON."""
        return {
            "path": str(self.path),
            "number": self.number,
            "title": self.title,
            "files": [vars(file) for file in self.files],
            "missing": list(self.missing),
            "dcc": None if self.dcc is None else str(self.dcc),
            "cautions": list(self.cautions),
        }

    def __str__(self) -> str:
        lines = [f"{self.title} {self.number} written to {self.path}"]
        if self.dcc is not None:
            lines.append(f"digital calibration certificate written to {self.dcc}")
        if self.missing:
            lines.append(f"not stated in [record]: {', '.join(self.missing)}")
        lost = [file.name for file in self.files if file.path is None]
        if lost:
            lines.append(f"not found, only the SHA-256 is recorded: {', '.join(lost)}")
        lines += [f"CAUTION  {words}" for words in self.cautions]
        return "\n".join(lines)


def record(
    result: str | Path,
    *,
    project: str | Path | None = None,
    out: str | Path | None = None,
    dcc: bool = False,
    schema: str | Path | None = None,
) -> Record:
    """Write the calibration record of a result folder: one page for print.

    project: the project file, whose [record] is taken as it is now; without it that of the
    calibration is. out: the page, by default record.html in the folder of the result. dcc: also
    write a digital calibration certificate, XML beside the page. schema: a dcc.xsd on the disk that
    this XML must validate against, else nothing is written. Raises InputError for what cannot be
    read or written, for readings that changed since, for keys that the certificate needs, and for a
    result that is not saved.
    """
    if not isinstance(getattr(result, "path", result), str | Path):
        raise InputError(
            f"{type(result).__name__} is no folder of a result",
            code="missing-file",
            remedy="save it first: lc.record(result.save(folder).folder)",
        )
    path = Path(getattr(result, "path", result))
    path = path if path.name == "result.json" else path / "result.json"
    saved = read_result(path)
    document = saved.document
    named = None if project is None else Path(project)
    stated = _stated(document, named)
    page = path.with_name(PAGE) if out is None else Path(out)
    files = record_files(path, document, page, named)
    content = record_content(document, stated, files, *_budgets(saved, stated))
    html = record_page(content)
    # Ahead of all writing: what does not validate is not written (docs/decisions/0083).
    xml = _certificate(content, html, schema) if dcc else None
    at = None if xml is None else page.with_suffix(".xml")
    write_all({page: html} if at is None or xml is None else {page: html, at: xml})
    about = content.missing, at, content.cautions
    return Record(page, content.number, content.title, files, *about)


def _budgets(saved: SavedResult, stated: Mapping[str, Any]) -> tuple[tuple[Budget, ...], str]:
    """The budgets of a result; where there are none, why."""
    lengths = LengthErrors(
        **{one.name: stated.get(_KEYS[one.name]) for one in fields(LengthErrors)}
    )
    try:
        made = budgets(saved, lengths)
    except InputError as error:
        return (), error.message
    return made, "" if made else "the result predicts no positions"


_KEYS = {"scale": "instrument_scale", "expansion": "expansion", "temperature_sd": "temperature_sd"}
"""Error of a length -> its key of [record]."""


def _certificate(content: RecordContent, html: str, schema: str | Path | None) -> str:
    """The XML, which validates where a schema is given."""
    from loopcal.companions.record.dcc import VERSION, record_dcc

    xml = record_dcc(content, html)
    if schema is not None:
        version = schema_version(Path(schema))
        # Elements and their order differ from version to version.
        if version != VERSION:
            raise InputError(
                f"this schema is of version {version or 'unknown'}; loopcal writes {VERSION}",
                code="wrong-schema",
                place=str(schema),
                remedy=f"name the dcc.xsd of https://www.ptb.de/dcc/v{VERSION}/",
            )
        check_against(xml, Path(schema))
    return xml


def verify_record(path: str | Path) -> RecordCheck:
    """Check whether a record and the files behind it are as they were when it was written.

    Raises InputError for a file that is no record.
    """
    return check_record(path)


def _stated(document: ResultDocument, project: Path | None) -> dict[str, Any]:
    """[record] of a project file as it is now, else of the project as it was calibrated."""
    from loopcal.files.project.project_schema import ProjectTables
    from loopcal.files.toml.tables import read_tables

    if project is None:
        place, stated = Place("result.json").at("inputs"), document.inputs.get("record") or {}
        data: Mapping[str, Any] = {"schema": 1, "record": stated}
    else:
        place, data = Place(str(project)), read_toml(project)
        checked_schema(data, place)
    return asdict(read_tables(ProjectTables, data, place).made("record"))

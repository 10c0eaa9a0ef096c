"""result.json: the document of a result, to the disk and back."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from loopcal.document.plain import plain
from loopcal.document.result_document import SCHEMA, ResultDocument, WrittenResult
from loopcal.errors import InputError, nearest
from loopcal.estimation.result import Result
from loopcal.files.atomic import write_files
from loopcal.files.json_reader import read_json
from loopcal.files.machines.mechanism_writer import mechanism_to_toml
from loopcal.files.result.pose_table import residuals_csv
from loopcal.files.toml.place import Place

if TYPE_CHECKING:
    from pydantic import TypeAdapter, ValidationError

READ = (1, SCHEMA)
"""Schemas that can be read."""
_ENCODER = json.JSONEncoder(ensure_ascii=False, allow_nan=False)
_REMEDY = "name a result.json that loopcal wrote, or calibrate again"


def result_json(document: ResultDocument) -> str:
    """The text of result.json; floats are written so that they read back as the same bits."""
    return _text(plain(document)) + "\n"


def _text(value: Any, margin: str = "\n") -> str:
    """JSON with one entry on a line, but arrays of plain values on one."""
    inner = f"{margin} "
    if isinstance(value, dict) and value:
        lines = (f"{_text(key)}: {_text(its, inner)}" for key, its in value.items())
        return "{" + inner + f",{inner}".join(lines) + margin + "}"
    if isinstance(value, list) and not {dict, list}.isdisjoint(map(type, value)):
        return "[" + inner + f",{inner}".join(_text(its, inner) for its in value) + margin + "]"
    return _ENCODER.encode(value)


def write_result(
    result: Result,
    document: ResultDocument,
    folder: str | Path,
    *,
    report: Callable[[ResultDocument], str] | None = None,
) -> WrittenResult:
    """Write result.json, residuals.csv and mechanism.toml (calibrated), all or none.

    report: makes report.html of the document; without it an existing one is deleted, because it
    describes another result. The folder is made if need be. Raises InputError, naming the file, the
    reason and a remedy, where they cannot be written.
    """
    files: dict[str, str | bytes] = {
        "result.json": result_json(document),
        "residuals.csv": residuals_csv(result),
        "mechanism.toml": mechanism_to_toml(result.calibrated),
    }
    if report is not None:
        files["report.html"] = report(document)
    write_files(folder, files, remove=() if report else ("report.html",))
    return WrittenResult(Path(folder), tuple(files), document)


def read_result(path: str | Path) -> ResultDocument:
    """The document of a result.json, checked; schema 1 lacks only what schema 2 added.

    Raises InputError, naming the place in the file, for anything else.
    """
    from pydantic import ValidationError

    content = read_json(path, "result.json", *READ) | {"schema": SCHEMA}
    try:
        document = _adapter().validate_json(json.dumps(content).encode())
    except ValidationError as error:
        raise _told(error, content, Place(str(path))) from None
    from loopcal.files.result.matrices import refuse_other_shapes

    refuse_other_shapes(document, Place(str(path)), _REMEDY)
    return document


def _told(error: ValidationError, content: Mapping[str, Any], place: Place) -> InputError:
    """The first complaint in the words of this program; unknown keys come first."""
    from loopcal.files.toml.model import input_error

    details = error.errors(include_url=False)
    for detail in details:
        if detail["type"] == "json_invalid":
            return InputError(
                f"this is not valid JSON: {detail['msg']}",
                code="invalid-syntax",
                place=str(place),
                remedy=_REMEDY,
            )
        if detail["type"] == "unexpected_keyword_argument":
            *path, key = detail["loc"]
            known = _adapter().json_schema()
            names = {*known["properties"]}.union(
                *(d["properties"] for d in known["$defs"].values())
            )
            at = place.at(*path) if path else place
            return InputError(
                f"unknown key {key!r}",
                code="unknown-name",
                place=str(at),
                remedy=nearest(str(key), names),
            )
    told = input_error(details, content, place)
    return InputError(told.message, code=told.code, place=told.place, remedy=_REMEDY)


def result_schema() -> dict[str, Any]:
    """JSON Schema (2020-12) of result.json."""
    schema = _adapter().json_schema()
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


def finite_only(value: Any) -> Any:
    """Plain data without what JSON cannot say: infinity and NaN become text as TOML spells them."""
    if isinstance(value, Mapping):
        return {str(key): finite_only(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [finite_only(inner) for inner in value]
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value


@cache
def _adapter() -> TypeAdapter[ResultDocument]:
    """Built on first use: a calibration writes the document and does not need it."""
    from pydantic import TypeAdapter

    return TypeAdapter(ResultDocument)

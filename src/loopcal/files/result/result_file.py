"""result.json: the document of a result, to the disk and back."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from loopcal.document.plain import plain
from loopcal.document.result_document import SCHEMA, ResultDocument, WrittenResult
from loopcal.errors import InputError, listed, nearest
from loopcal.estimation.result import FitResult
from loopcal.files.atomic import Data, write_all
from loopcal.files.json_files import read_json, sums
from loopcal.files.machines.mechanism_file import read_mechanism
from loopcal.files.machines.mechanism_writer import mechanism_to_toml
from loopcal.files.machines.python_function import Loops
from loopcal.files.outputs import refuse_outside
from loopcal.files.result.pair import MACHINE, RESIDUALS, RESULT, refuse_stale
from loopcal.files.result.pose_table import residuals_csv
from loopcal.files.toml.place import Place
from loopcal.mechanisms.mechanism import Mechanism

if TYPE_CHECKING:
    from pydantic import TypeAdapter, ValidationError


_ROLES = {"gain": "scale"}
"""Roles by the words of earlier files, where these differ."""
READ = (1, 2, SCHEMA)
"""Schemas that can be read."""
NAMES = (RESULT, RESIDUALS, MACHINE)
_REMEDY = "name a result.json that loopcal wrote, or calibrate again"


def result_json(document: ResultDocument) -> str:
    """The text of result.json; floats are written so that they read back as the same bits."""
    from pydantic_core import to_json  # ten times as fast with floats as the standard library

    def text(value: Any, margin: str = "\n") -> str:
        """JSON with one entry on a line, but arrays of plain values on one."""
        inner = f"{margin} "
        if isinstance(value, dict) and value:
            lines = (f"{text(key)}: {text(item, inner)}" for key, item in value.items())
            return "{" + inner + f",{inner}".join(lines) + margin + "}"
        if isinstance(value, list) and not {dict, list}.isdisjoint(map(type, value)):
            return "[" + inner + f",{inner}".join(text(one, inner) for one in value) + margin + "]"
        return to_json(value, inf_nan_mode="null").decode()

    return text(plain(document)) + "\n"


def write_result(
    result: FitResult,
    document: ResultDocument,
    folder: str | Path,
    *,
    report: Callable[[ResultDocument], str] | None = None,
    write: Callable[..., object] = write_all,
) -> WrittenResult:
    """Write result.json, residuals.csv and mechanism.toml (calibrated), all or none.

    report: makes report.html of the document; without it an existing one is deleted, because it
    describes another result. write: does it, as `write_all` does, which may keep more with the
    rest. The folder is made if need be. Raises InputError, naming the file, the
    reason and a remedy, where they cannot be written.
    """
    folder = Path(folder)
    pair: dict[str, Data] = {
        MACHINE: mechanism_to_toml(result.calibrated, folder),
        RESIDUALS: residuals_csv(result),
    }
    document = replace(document, files=sums(pair))
    pages: dict[str, Data] = {} if report is None else {"report.html": report(document)}
    # whoever reads between these renames finds the machine of another result.json
    files: dict[Path, Data] = {
        folder / name: data
        for name, data in {**pair, **pages, RESULT: result_json(document)}.items()
    }
    remove = [] if pages else [folder / "report.html"]
    write(files, remove=remove)
    return WrittenResult(folder, (*NAMES, *pages), document)


def read_result(path: str | Path) -> ResultDocument:
    """The document of a result.json, checked; earlier schemas lack only what later ones
    added.

    Raises InputError, naming the place in the file, for anything else, and where mechanism.toml
    beside it is of another result.
    """
    from pydantic import ValidationError
    from pydantic_core import to_json

    _refuse_elsewhere(Path(path))
    content = _with_roles(read_json(path, "result.json", *READ)) | {"schema": SCHEMA}
    try:
        document = _adapter().validate_json(to_json(content))
    except ValidationError as error:
        raise _first_complaint(error, content, Place(str(path))) from None

    refuse_other_shapes(document, Place(str(path)))
    refuse_stale(Path(path).with_name(MACHINE), document.files)
    if document.verdict is not None and not document.findings:
        return replace(document, findings=document.verdict.findings)
    return document


def _refuse_elsewhere(path: Path) -> None:
    """Raise InputError for a folder that holds no result.json, and for a file in its place.

    The remedy names the only result below it, or for a file below the folder of the command.
    """
    place = path.parent
    refuse_outside(place, str(place), place.name)
    if path.name != RESULT or path.exists() or not place.exists():
        return
    is_folder, is_readings = place.is_dir(), place.is_file() and place.suffix != ".toml"
    patterns = [f"*/{RESULT}", f"*/*/{RESULT}"] if is_readings else [f"*/{RESULT}"]
    below = Path() if is_readings else place if is_folder else place.parent
    folders = [str(one.parent) for pattern in patterns for one in below.glob(pattern)]
    of_project = str(place.parent / f"{place.stem}-result")
    folders = [of_project] if of_project in folders else folders
    error = InputError(
        "there is no result in this folder" if is_folder else "this is a file, not a result",
        code="missing-file",
        place=str(place),
        remedy="name the folder of a result, or calibrate first: loopcal calibrate PROJECT",
    )
    error.then("loopcal calibrate PROJECT")
    if len(folders) == 1:
        error.meaning(str(place), *folders, *([str(place)] if is_readings else []))
    raise error


def _with_roles(content: dict[str, Any]) -> dict[str, Any]:
    """The document with the role of each parameter beside it; earlier ones listed kinds apart."""
    mechanism, parameters = content.get("mechanism"), content.get("parameters")
    if not isinstance(mechanism, dict) or not isinstance(parameters, list):
        return content
    kinds = mechanism.get("kinds")
    if not isinstance(kinds, dict):
        return content
    roles = {name: _ROLES.get(kind, kind) for name, kind in kinds.items() if isinstance(kind, str)}
    return content | {
        "mechanism": {key: value for key, value in mechanism.items() if key != "kinds"},
        "parameters": [
            {"role": roles.get(p.get("name"), ""), **p} if isinstance(p, dict) else p
            for p in parameters
        ],
    }


def _first_complaint(
    error: ValidationError, content: Mapping[str, Any], place: Place
) -> InputError:
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
            json_schema = _adapter().json_schema()
            names = {*json_schema["properties"]}.union(
                *(d["properties"] for d in json_schema["$defs"].values())
            )
            at = place.at(*path) if path else place
            return InputError(
                f"unknown key {key!r}",
                code="unknown-name",
                place=str(at),
                remedy=nearest(str(key), names),
            )
    complaint = input_error(details, content, place)
    return InputError(complaint.message, code=complaint.code, place=complaint.place, remedy=_REMEDY)


def result_schema() -> dict[str, Any]:
    """JSON Schema (2020-12) of result.json."""
    schema = _adapter(documented=True).json_schema()
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


@cache
def _adapter(*, documented: bool = False) -> TypeAdapter[ResultDocument]:
    """Built on first use: a calibration writes the document and does not need it.

    documented: with what stands below each field. It is read from the source files, which takes ten
    times as long as all else.
    """
    from pydantic import TypeAdapter

    ResultDocument.__pydantic_config__["use_attribute_docstrings"] = documented
    return TypeAdapter(ResultDocument)


# The calibrated mechanism beside the result.json that it was found with.


def read_result_mechanism(
    path: Path, document: ResultDocument, function: Loops | Mechanism | None = None
) -> Mechanism:
    """The mechanism beside a result.json with this document.

    function: the loops of a mechanism that is written in Python. Raises InputError where
    mechanism.toml is absent, cannot be read, or has other parameters than result.json.
    """
    mechanism = read_mechanism(path.with_name("mechanism.toml"), function=function)
    names, stated = mechanism.parameters.names, {p.name for p in document.parameters}
    alone = [n for n in names if n not in stated]
    alone += [n for n in document.covariance.names if n not in names]
    if alone:
        raise InputError(
            f"result.json and mechanism.toml differ in the parameters {listed(alone)}",
            code="unknown-name",
            place=str(path.parent),
            remedy="keep the files of one calibration together, or calibrate again",
        )
    return mechanism


# The matrices of a result.json have the rows and columns that their names say.


@dataclass(frozen=True)
class _Matrix:
    """Where a matrix stands, its rows, and the lengths that each of them may have."""

    path: tuple[str | int, ...]
    rows: Sequence[Sequence[Any]]
    lengths: Sequence[tuple[int, ...]]

    @property
    def fits(self) -> bool:
        """Whether it has so many rows of these lengths."""
        return len(self.rows) == len(self.lengths) and all(
            len(row) in lengths for row, lengths in zip(self.rows, self.lengths, strict=True)
        )


def refuse_other_shapes(document: ResultDocument, place: Place) -> None:
    """Raise InputError for the first matrix whose rows do not fit its names."""
    for matrix in _matrices(document):
        if not matrix.fits:
            raise InputError(
                f"a matrix of {len(matrix.rows)} rows does not fit its names",
                code="wrong-shape",
                place=str(place.at(*matrix.path)),
                remedy=_REMEDY,
            )


def _matrices(document: ResultDocument) -> Iterator[_Matrix]:
    covariance, ahead = document.covariance, document.prediction
    n = len(covariance.names)
    lower = [(i + 1, n) for i in range(n)]  # earlier versions wrote whole rows
    yield _Matrix(("covariance", "matrix"), covariance.matrix, [(n,)] * n)
    for name, rows in (("plain", covariance.plain), ("scatter", covariance.scatter)):
        if rows is not None:
            yield _Matrix(("covariance", name), rows, lower)
    for i, rows in enumerate(covariance.slopes):
        yield _Matrix(("covariance", "slopes", i), rows, lower)
    if ahead is not None:
        if ahead.covariance is not None:
            yield _Matrix(("prediction", "covariance"), ahead.covariance, [(n,)] * n)
        steps = ahead.undetermined
        yield _Matrix(("prediction", "undetermined"), steps, [(n,)] * len(steps))
    for i, entry in enumerate(document.noise_covariances):
        m = len(entry.quantities)
        yield _Matrix(("noise_covariances", i, "matrix"), entry.matrix, [(m,)] * m)

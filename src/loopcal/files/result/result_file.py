"""result.json: a result as a document, and back from the disk."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from loopcal.estimation.accuracy import Accuracy, Closure
from loopcal.estimation.on_request import Interval
from loopcal.estimation.result import Result
from loopcal.files.atomic import write_files
from loopcal.files.json_reader import read_json
from loopcal.files.machines.mechanism_writer import mechanism_to_toml
from loopcal.files.result.residuals_file import residuals_csv
from loopcal.files.toml.place import Place
from loopcal.files.versions import versions

SCHEMA = 1


@dataclass(frozen=True, eq=False)
class WrittenResult:
    """The files of a result: their folder, their names, and the content of result.json."""

    folder: Path
    files: tuple[str, ...]
    document: Mapping[str, Any]


def result_document(
    result: Result,
    *,
    title: str | None = None,
    inputs: Mapping[str, Any] | None = None,
    warnings: tuple[str, ...] = (),
    findings: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """The content of result.json: plain values, SI, null for what is unknown.

    inputs: the project as it was read; warnings: more than those the result holds; findings:
    fields, or parts of them, that further statistics fill. The fields are told by
    `result_schema`.
    """
    known = versions()
    chi = result.chi_squared
    before, after = result.accuracy_before, result.accuracy_after
    document = {
        "schema": SCHEMA,
        "loopcal": known["loopcal"],
        "title": title,
        "method": result.method,
        "loss": result.loss,
        "status": {
            "converged": result.status.converged,
            "reason": result.status.reason,
            "message": result.status.message,
            "iterations": result.status.iterations,
        },
        "parameters": _parameters(result),
        "covariance": _covariance(result),
        "noise": [
            {
                "quantities": list(entry.quantities),
                "unit": entry.unit,
                "sd": entry.sd,
                "sd_of_sd": entry.sd_of_sd,
                "source": entry.source,
                "upper": entry.upper,
                "likelihood_ratio": entry.likelihood_ratio,
                "p_value": entry.p_value,
            }
            for entry in result.noise
        ],
        "model_discrepancy": result.model_discrepancy,
        "variance_factor_applied": result.variance_factor_applied,
        "restricted_criterion": result.restricted_criterion,
        "chi_squared": chi
        and {
            "value": chi.value,
            "degrees_of_freedom": chi.degrees_of_freedom,
            "p_value": chi.p_value,
            "variance_factor": chi.variance_factor,
        },
        "closure": {
            "before": _closure(result.closure_before),
            "after": _closure(result.closure_after),
        },
        "accuracy": before
        and after
        and {"unit": before.unit, "before": _distances(before), "after": _distances(after)},
        "validation": _validation(result),
        "models": _models(result),
        "identifiability": _identifiability(result),
        "observability": None,
        "prediction": None,
        "outliers": None,
        "outlier_tests": None,
        "column_faults": None,
        "other_optima": None,
        "data": _data(result),
        "warnings": [*warnings, *result.warnings],
        "inputs": finite_only(inputs or {}),
        "versions": known,
    }
    for key, found in (findings or {}).items():
        own = document[key]
        document[key] = {**own, **found} if isinstance(own, dict) else found
    return document


def result_json(document: Mapping[str, Any]) -> str:
    """The text of result.json; floats are written so that they read back as the same bits."""
    return json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def write_result(
    result: Result,
    folder: str | Path,
    *,
    title: str | None = None,
    inputs: Mapping[str, Any] | None = None,
    warnings: tuple[str, ...] = (),
    findings: Mapping[str, Any] | None = None,
    report: Callable[[Mapping[str, Any]], str] | None = None,
) -> WrittenResult:
    """Write result.json, residuals.csv and mechanism.toml (calibrated), all or none.

    report: makes report.html of the document; without it an earlier report goes, which would
    tell of another result. The folder is made if need be; all the rest goes to result.json as
    `result_document` says. Raises InputError, naming the file, the reason and a remedy, where they
    cannot be written.
    """
    document = result_document(
        result, title=title, inputs=inputs, warnings=warnings, findings=findings
    )
    files: dict[str, str | bytes] = {
        "result.json": result_json(document),
        "residuals.csv": residuals_csv(result),
        "mechanism.toml": mechanism_to_toml(result.calibrated),
    }
    if report is not None:
        files["report.html"] = report(document)
    write_files(folder, files, remove=() if report else ("report.html",))
    return WrittenResult(Path(folder), tuple(files), document)


def read_result(path: str | Path) -> dict[str, Any]:
    """The document of a result.json, checked.

    Raises InputError, naming the place in the file, for what is not one.
    """
    from loopcal.files.result.result_model import ResultDocument
    from loopcal.files.toml.model import validated

    document = read_json(path, "result.json", SCHEMA)
    validated(ResultDocument, document, Place(str(path)))
    return document


def result_schema() -> dict[str, Any]:
    """JSON Schema (2020-12) of result.json."""
    from loopcal.files.result.result_model import ResultDocument

    schema = ResultDocument.model_json_schema(by_alias=True)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


def _parameters(result: Result) -> list[dict[str, Any]]:
    entries = []
    for parameter in result.mechanism.parameters:
        name = parameter.name
        sd = result.sd[name]
        known = sd is not None and math.isfinite(sd)
        errors = result.errors or {}
        entries.append(
            {
                "name": name,
                "unit": parameter.unit,
                "nominal": parameter.nominal,
                "value": result.value[name],
                "sd": sd if known else None,
                "prior_sd": parameter.prior_sd if math.isfinite(parameter.prior_sd) else None,
                "fixed": parameter.fixed,
                "identifiable": None if sd is None else name not in _loose(result),
                "error": errors.get(name),
                "interval": _interval(result.intervals.get(name)),
            }
        )
    return entries


def _interval(interval: Interval | None) -> dict[str, Any] | None:
    if interval is None:
        return None
    return {
        "level": interval.level,
        "covariance": [interval.low, interval.high],
        "profile": [interval.profile_low, interval.profile_high],
        "differs": interval.differs,
    }


def _validation(result: Result) -> dict[str, Any] | None:
    found = result.validation
    if found is None:
        return None
    return {
        "scheme": dict(found.scheme),
        "words": found.words,
        "poses": len(found.poses),
        "accuracy": found.accuracy and _distances(found.accuracy),
        "log_likelihood": found.log_likelihood,
        "parts": found.parts,
        "failed": [asdict(part) for part in found.failed],
    }


def _models(result: Result) -> list[dict[str, Any]] | None:
    if result.models is None:
        return None
    entries = []
    for m in result.models.models:
        accuracy = m.validation and m.validation.accuracy
        entries.append(
            {
                "name": m.name,
                "effects": list(m.effects),
                "fixed": list(m.fixed),
                "parameters": m.parameters,
                "accuracy": accuracy and _distances(accuracy),
                "log_likelihood": m.validation and m.validation.log_likelihood,
                "behind": m.behind,
                "sd_of_behind": None if m.sd is None else _finite(m.sd),
                "recommended": m.name == result.models.recommended,
                "failed": m.failed or None,
            }
        )
    return entries


def _loose(result: Result) -> set[str]:
    """Parameters that no data and no prior determine."""
    return {name for u in result.identifiability.not_identifiable for name in u.combination}


def _covariance(result: Result) -> dict[str, Any]:
    loose = [name in _loose(result) for name in result.estimated]
    rows = result.covariance.tolist()
    matrix = [
        [
            None if loose[i] or loose[j] or not math.isfinite(value) else value
            for j, value in enumerate(row)
        ]
        for i, row in enumerate(rows)
    ]
    return {"names": list(result.estimated), "unit": "SI", "matrix": matrix}


def _closure(closure: Closure) -> dict[str, Any]:
    return {"rms": _finite(closure.rms), "max": _finite(closure.max)}


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _distances(accuracy: Accuracy) -> dict[str, float]:
    return {
        "mean": accuracy.mean,
        "rms": accuracy.rms,
        "p95": accuracy.p95,
        "max": accuracy.max,
    }


def _identifiability(result: Result) -> dict[str, Any]:
    found = result.identifiability
    return {
        "rank": found.rank,
        "parameters": found.parameters,
        "data_rank": found.data_rank,
        "condition_number": found.condition_number,
        "not_identifiable": [
            {"combination": dict(u.combination), "words": u.words} for u in found.not_identifiable
        ],
        "data_condition_number": None,
        "data_versus_prior": None,
        "weak_directions": None,
        "calibration_index": None,
    }


def _data(result: Result) -> dict[str, Any]:
    dataset = result.dataset
    source = dataset.source
    return {
        "file": source.file,
        "sha256": source.sha256,
        "poses": source.rows_read or len(dataset),
        "used": result.solution.poses,
        "excluded": list(source.excluded),
        "every": source.every,
        "joined": [{"file": part.file, "sha256": part.sha256} for part in source.joined],
        "quantities": [q for q in result.mechanism.quantities if q in dataset.readings],
    }


def finite_only(value: Any) -> Any:
    """Plain data without what JSON cannot say: infinity and NaN become text as TOML spells them."""
    if isinstance(value, Mapping):
        return {str(key): finite_only(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [finite_only(inner) for inner in value]
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value

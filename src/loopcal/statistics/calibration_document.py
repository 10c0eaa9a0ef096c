"""The document of a calibration, put together from its parts."""

from __future__ import annotations

from dataclasses import replace

from loopcal.document.accuracy import AccuracyEntry, Distances
from loopcal.document.change_points import ChangePoints
from loopcal.document.fit import ParameterEntry
from loopcal.document.result_document import Parts, ResultDocument
from loopcal.statistics.findings import Findings


def calibration_document(fit: ResultDocument, parts: Parts) -> ResultDocument:
    """The document of a fit, with the parts beside it."""
    validation = parts.validation
    return replace(
        fit,
        title=parts.title,
        method=parts.method or fit.method,
        chosen=parts.chosen,
        culprits=parts.culprits,
        halves=parts.halves,
        parameters=tuple(_parameter(one, parts) for one in fit.parameters),
        accuracy=_accuracy(fit.accuracy, parts.nominal, parts.noise_floor),
        validation=validation,
        models=parts.models,
        change_points=parts.change_points,
        outliers=parts.discarded or None,
        scales=parts.scales or None,
        check=parts.check,
        warnings=(
            *parts.about_readings,
            *fit.warnings,
            *(() if validation is None else validation.warnings),
        ),
        inputs=fit.inputs if parts.inputs is None else parts.inputs,
    )


def _parameter(entry: ParameterEntry, parts: Parts) -> ParameterEntry:
    error = None if parts.errors is None else parts.errors.get(entry.name)
    return replace(entry, error=error, interval=parts.intervals.get(entry.name))


def _accuracy(
    entry: AccuracyEntry | None, nominal: Distances | None, noise_floor: float | None
) -> AccuracyEntry | None:
    """The accuracy beside that of the nominal machine, and beside what noise alone causes."""
    return None if entry is None else replace(entry, nominal=nominal, noise_floor=noise_floor)


def with_findings(document: ResultDocument, findings: Findings) -> ResultDocument:
    """The same with what the equations of the fit tell beyond the parameters."""
    accuracy, covariance, shifts = document.accuracy, document.covariance, findings.shifts
    nominal = (accuracy and accuracy.nominal) or findings.nominal
    predictor, reliability, scatter = findings.predictor, findings.reliability, findings.scatter
    return replace(
        document,
        accuracy=_accuracy(accuracy, nominal, findings.noise_floor),
        covariance=covariance if scatter is None else scatter.added_to(covariance),
        change_points=ChangePoints(
            shifts.found, shifts.level, shifts.tested, findings.toml, shifts.unsure
        ),
        identifiability=findings.identifiability.added_to(document.identifiability),
        observability=findings.observability,
        prediction=None if predictor is None else replace(predictor.entry, region=findings.region),
        outliers=findings.outliers.found,
        outlier_tests=findings.outliers.tests,
        reliability=None if reliability is None else reliability.entry,
        column_faults=findings.outliers.columns,
        other_optima=findings.optima,
        scales=(*(document.scales or ()), *findings.shifts.scales) or None,
        delay=findings.shifts.delay,
        joint_error=findings.shifts.joint_error,
        conflicts=findings.conflicts or None,
        repeats=findings.repeats,
    )

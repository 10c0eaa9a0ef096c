"""What a document holds of a fit alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from loopcal.document.accuracy import AccuracyEntry
from loopcal.document.fit import ClosureEntry, StatusEntry
from loopcal.document.plain import lower
from loopcal.document.result_document import SCHEMA, MechanismEntry, ResultDocument
from loopcal.estimation.accuracy import accuracy_entry
from loopcal.estimation.cameras.at_board import pixel_sizes
from loopcal.estimation.document_parts import (
    coarse_readings,
    covariance_entry,
    inputs_entry,
    noise_entries,
    parameter_entry,
)
from loopcal.estimation.noise.learning import joint_covariances
from loopcal.estimation.noise.prints import weighed
from loopcal.estimation.problem.alignment import sought
from loopcal.estimation.redundancy import Redundancy, redundancy
from loopcal.estimation.result import FitResult
from loopcal.estimation.solve.scratch import one_blas_thread


@one_blas_thread()
def fit_document(result: FitResult) -> ResultDocument:
    """The document of a fit: what was added beside it, and a verdict, are not in it."""
    status = result.status
    spread = result.learnt_covariance, weighed(result.prints, result.spectrum)
    shares, names = result.chi_squared_shares, result.mechanism.tape.quantities
    noise = noise_entries(result.noise, shares, names, _redundancy(result))
    coarse = coarse_readings(result.dataset, noise, result.problem, result.pose_equations())
    entry = MechanismEntry.of(result.mechanism)
    unstated = (*entry.unstated, *sought(result.mechanism))
    return ResultDocument(
        schema=SCHEMA,
        loopcal="",
        title=None,
        mechanism=replace(entry, unstated=tuple(dict.fromkeys(unstated))),
        method=result.method,
        method_label=result.fit.label,
        lens_errors=() if result.lens_errors is None else result.lens_errors.entries,
        loss=result.loss,
        status=StatusEntry(status.converged, status.reason, status.message, status.iterations),
        parameters=tuple(
            parameter_entry(
                p, result.value[p.name], result.sd[p.name], result.degrees_of_freedom[p.name]
            )
            for p in result.mechanism.parameters
        ),
        covariance=replace(
            covariance_entry(result.estimated, *spread, result.identifiability.loose),
            pose_part=None if result.pose_part is None else lower(result.pose_part),
        ),
        noise=noise,
        noise_covariances=() if result.fit.solver.exact else joint_covariances(result.problem),
        terms=result.terms_with_parts(),
        sds_settled=None if result.estimate is None else result.estimate.settled,
        model_discrepancy=result.model_discrepancy,
        variance_factor_applied=result.variance_factor_applied,
        restricted_criterion=result.restricted_criterion,
        chi_squared=result.chi_squared,
        closure=ClosureEntry(result.closure_before.entry, result.closure_after.entry),
        accuracy=_accuracy(result),
        validation=None,
        dependence=result.dependence,
        identifiability=result.identifiability,
        observability=None,
        prediction=None,
        outliers=None,
        column_faults=result.faults or None,
        data=replace(result.data_entry, coarse=coarse),
        warnings=result.warnings,
        inputs=inputs_entry(result.dataset, result.mechanism),
        versions={},
    )


def _accuracy(result: FitResult) -> AccuracyEntry | None:
    entry = accuracy_entry(result.accuracy_before, result.accuracy_after)
    if entry is None or result.all_poses is not None:
        return entry
    end = result.solution
    differences = np.array([result.differences_after[q] for q in result.mechanism.compared])
    places = [sight.place(differences) for sight in result.sights]
    return replace(
        entry,
        pixels=pixel_sizes(result.problem, end.parameters, end.corrections),
        places=tuple(place for place in places if place),
    )


def _redundancy(result: FitResult) -> Redundancy | None:
    """What readings control of each other; None of a stream, a robust loss, exact readings."""
    if result.all_poses is not None or result.fit.robust_loss is not None:
        return None
    if result.fit.solver.exact:
        return None
    return redundancy(result.problem, result.pose_equations(), result.spectrum.covariance())

"""A fit that goes on from where an earlier calibration of the machine ended.

The method "auto" fits every candidate anew, validates and compares them. Here only the candidate
that it took last is fitted again: with the terms that it kept and what it took as changed during
the run, without the poses that it discarded, from the parameters and the learnt sizes of the model
error with which it ended. Learnt sds are learnt again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from loopcal.document.change_points import ChangePoint
from loopcal.document.result_document import ResultDocument
from loopcal.errors import InputError
from loopcal.estimation.result import FitResult
from loopcal.estimation.steps import Near
from loopcal.mechanisms.effects.effect import OF_INSTRUMENTS
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.statistics.case import Case, Entrant, entrants, without_terms
from loopcal.statistics.changes import NUMBER, with_shifts
from loopcal.statistics.validation import NEARLY


@dataclass(frozen=True)
class Ending:
    """Where a calibration ended.

    method: the candidate that "auto" took, empty for a named method; label: of its fit; poses:
    ids of those used; values, nominal, sds: of the parameters [SI], sds of the prior, where it has
    one; terms: names of those that "auto" kept; changes: what it modelled as changed during the
    run; outliers: poses that it discarded.
    """

    method: str
    label: str
    poses: tuple[str, ...]
    values: Mapping[str, float]
    nominal: Mapping[str, float]
    sds: Mapping[str, float]
    terms: tuple[str, ...] = ()
    changes: tuple[ChangePoint, ...] = ()
    outliers: tuple[str, ...] = ()

    @classmethod
    def of(cls, document: ResultDocument, poses: Sequence[str]) -> Ending:
        """From the content of result.json, and the poses of the fit."""
        used, changes = set(poses), document.change_points
        return cls(
            "" if document.chosen is None else document.chosen.method,
            document.method_label or "",
            tuple(poses),
            {p.name: p.value for p in document.parameters},
            {p.name: p.nominal for p in document.parameters},
            {p.name: p.prior_sd for p in document.parameters if p.prior_sd},
            () if document.chosen is None else document.chosen.terms,
            () if changes is None else tuple(p for p in changes.found if p.modelled),
            tuple(o.pose for o in document.outliers or () if o.pose not in used),
        )


def continued(case: Case, ending: Ending) -> FitResult:
    """The calibration by its stated method, or by the candidate that "auto" took last, from where
    an earlier one ended.

    Raises InputError where the machine has other parameters than the calibrated one, and for what
    cannot be calibrated.
    """
    if case.fit.method.choice:
        case = _chosen(_as_modelled(case, ending), ending).case
    machine = case.fit.with_prior(case.mechanism)
    beyond = {name for names in machine.effects.values() for name in names}
    new = [n for n in machine.parameters.names if n not in ending.values and n not in beyond]
    if new:
        raise InputError(
            f"the earlier calibration has no parameter {new[0]!r}",
            code="unsupported",
            remedy="calibrate this machine first",
        )
    machine = _as_it_ended(machine, ending, learnt=case.fit.label == ending.label)
    start = {n: v for n, v in ending.values.items() if n in machine.parameters.names}
    # `near` says that the fit begins near its end: results do not store unread quantities.
    measured = all(q in case.data.readings for q in machine.quantities)
    fit = replace(case.fit, start=start, prior=None, tolerance=case.fit.tolerance or NEARLY)
    near = Near({}) if measured else None
    begun = replace(case, mechanism=machine, fit=fit, trusted=True, near=near)
    return begun.calibrated()


def _chosen(case: Case, ending: Ending) -> Entrant:
    """The candidate that was taken, with the terms that it kept; else the first."""
    if not {*OF_INSTRUMENTS}.isdisjoint(ending.terms):
        # loaded where they are used
        from loopcal.statistics.run_drift import with_run_drift
        from loopcal.statistics.station_scales import with_station_scales

        case = with_station_scales(with_run_drift(case))
    able = [one for one in entrants(case) if not one.drawn]
    taken = next((one for one in able if one.name == ending.method), None)
    if taken is None:
        return able[0]
    left = {term.name for term in taken.case.mechanism.terms} - set(ending.terms)
    return without_terms(case, taken, left) or taken


def _as_it_ended(machine: Mechanism, ending: Ending, *, learnt: bool) -> Mechanism:
    """The machine around the nominal values of the earlier calibration; learnt: with the sds of
    its model error too, which another method would not have."""
    names = machine.parameters.names
    machine = machine.with_nominal({n: v for n, v in ending.nominal.items() if n in names})
    if not learnt:
        return machine
    sds = {n: sd for n, sd in ending.sds.items() if n in names}
    return machine.with_parameters(machine.parameters.with_prior(sds))


def _as_modelled(case: Case, ending: Ending) -> Case:
    """The case with the changes that the earlier calibration modelled, but those that the project
    states by now, and without its outliers."""
    stated = {p.changes for p in case.mechanism.parameters if p.changes}
    poses = case.data.poses
    moved = [_moved(p, ending.poses, set(poses)) for p in ending.changes]
    if case.mechanism.awaiting:
        stated |= {n for p in ending.changes if p.moved == "load" for n in p.names}
    changes = [p for p in moved if p is not None and stated.isdisjoint(p.names)]
    if changes:
        made = with_shifts(case.mechanism, case.data, changes, column=NUMBER)
        case = replace(case, mechanism=made.mechanism, data=made.data)
    return case.discarding(np.flatnonzero(np.isin(poses, ending.outliers)))


def _moved(point: ChangePoint, order: Sequence[str], poses: set[str]) -> ChangePoint | None:
    """A step at its pose, or at the next one where that is left out; a ramp as it is."""
    if point.shape == "ramp":
        return point
    after = order[order.index(point.pose) :] if point.pose in order else ()
    pose = next((pose for pose in after if pose in poses), None)
    return None if pose is None else replace(point, pose=pose)

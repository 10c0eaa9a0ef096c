"""What happened during a run, modelled before methods compete: slips, and poses that do not fit.

A reflector that slipped bends every machine that is fitted to all poses alike. Change points that
are certain become effects, and gross outliers beside them are discarded. Only a fit with a
structured model error is trusted to tell: under a plain fit the error of the machine model itself
changes from region to region, and looks the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.document.change_points import ChangePoint, ChangePoints, when
from loopcal.document.findings import Outlier
from loopcal.errors import InputError, NoTrustworthyResult
from loopcal.estimation.fit import Fit
from loopcal.estimation.model_error import modelled
from loopcal.estimation.result import Result
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.statistics.case import Case, taken
from loopcal.statistics.change_points import Shifts, apart, find_shifts
from loopcal.statistics.outliers import find_poses
from loopcal.statistics.shifted import shift_lines, with_shifts

# CERTAIN and MOST_OUTLIERS: record 0051.
CERTAIN = 1e-6
"""Changes of so small a p-value, corrected for the search, are modelled; such poses discarded."""
# Chosen, not derived: each further search costs a fit.
ROUNDS = 2
"""Searches: the second on the fit with what the first found."""
MOST_OUTLIERS = 0.03
"""Where more of the poses do not fit, none is discarded: the model is at fault, or the sds."""
NUMBER = "pose_of_calibration"
"""The known constant that dates the changes: no file has it, so predictions hold after the last."""


@dataclass(frozen=True, eq=False)
class Changes:
    """A case with what happened during its run.

    case: with effects for the changes, without the outliers; kept: positions of its poses in the
    case as asked for; plain: that case without the effects; points: what was modelled; outliers:
    what was discarded; searched: the last search; toml: the lines that state the changes; whole:
    the fit of the case, made: its machine with the model error, None where nothing happened.
    """

    case: Case
    plain: Case
    kept: NDArray[np.intp]
    points: tuple[ChangePoint, ...] = ()
    outliers: Mapping[str, Outlier] = field(default_factory=dict)
    searched: Shifts | None = None
    toml: str = ""
    whole: Result | None = None
    made: Mechanism | None = None

    @property
    def moved(self) -> tuple[str, ...]:
        """The parameters of the effects."""
        before = self.plain.mechanism.parameters.names
        return tuple(n for n in self.case.mechanism.parameters.names if n not in before)

    def words(self) -> str:
        """For the sentence on the choice."""
        words = ""
        if self.points:
            words += f"; changes modelled {when(self.points)}"
        if self.outliers:
            words += f"; without the outlier{'s' if len(self.outliers) > 1 else ''} "
            words += ", ".join(self.outliers)
        return words

    @property
    def entry(self) -> ChangePoints | None:
        """The changes that were modelled, as a document holds them; None without any."""
        if self.searched is None or not self.points:
            return None
        return ChangePoints(self.points, self.searched.level, self.searched.tested, self.toml)

    @property
    def discarded(self) -> tuple[Outlier, ...]:
        """The outliers that were left out beside modelled changes."""
        return tuple(self.outliers.values()) if self.entry else ()


def unchanged(case: Case) -> Changes:
    """A case in which nothing happened."""
    return Changes(case, case, np.arange(len(case.data)))


def changes(case: Case, way: Fit, whole: Result) -> Changes:
    """What is certain to have happened during the run of a case.

    way: how a structured candidate is fitted; whole: that fit of all poses. Where
    the machine cannot have such effects, or is not fitted better by them, nothing.
    """
    run_changes, way = unchanged(case), way.changed(prior=case.fit.prior)
    for _ in range(ROUNDS):
        searched = find_shifts(whole)
        new = [p for p in searched.told_apart if _certain(p, run_changes.points)]
        if not new:
            break
        try:
            run_changes, whole = _modelled(case, way, replace(run_changes, searched=searched), new)
            run_changes = replace(run_changes, whole=whole)
        except (InputError, NoTrustworthyResult):
            break
    return run_changes


def _certain(point: ChangePoint, points: Sequence[ChangePoint]) -> bool:
    """Whether a change is beyond doubt, and none of these points with its date a little off."""
    return point.p_value < CERTAIN and apart(point, points)


def _modelled(
    case: Case, way: Fit, run_changes: Changes, new: Sequence[ChangePoint]
) -> tuple[Changes, Result]:
    """The case with further changes, without what then does not fit; and the fit of the rest."""
    number = {pose: i + 1 for i, pose in enumerate(case.data.poses)}
    points = (replace(p, modelled=True, number=number[p.pose]) for p in new)
    modelled_points = tuple(sorted((*run_changes.points, *points), key=lambda point: point.number))
    made = with_shifts(case.mechanism, case.data, modelled_points, column=NUMBER)
    full = replace(case, mechanism=made.mechanism, data=made.data)
    run_changes = replace(
        run_changes, points=modelled_points, toml=shift_lines(case.data, modelled_points)
    )
    run_changes = _kept(run_changes, case, full, run_changes.kept)
    machine = modelled(way, way.with_prior(run_changes.case.mechanism), len(run_changes.case.data))
    # The machine has the prior already.
    run_changes, way = replace(run_changes, made=machine), way.changed(prior=None)
    fitted = replace(run_changes.case, mechanism=machine, fit=way).calibrated()
    if not fitted.status.converged:
        raise NoTrustworthyResult("the fit with the changes did not converge", code="not-converged")
    tests = find_poses(fitted)  # columns were tried before
    bad = {one.pose: one for one in tests.found if one.p_value * tests.tested < CERTAIN}
    if not bad or len(bad) + len(run_changes.outliers) > MOST_OUTLIERS * len(case.data):
        return run_changes, fitted
    kept = np.array([i for i in run_changes.kept if case.data.poses[i] not in bad], dtype=np.intp)
    run_changes = _kept(
        replace(run_changes, outliers={**run_changes.outliers, **bad}), case, full, kept
    )
    fitted = replace(run_changes.case, mechanism=machine, fit=way).calibrated()
    return run_changes, fitted


def _kept(run_changes: Changes, case: Case, full: Case, kept: NDArray[np.intp]) -> Changes:
    gone = np.setdiff1d(np.arange(len(case.data)), kept)

    def without(one: Case) -> Case:
        if not gone.size:
            return one
        return replace(one, data=one.data.without_outliers(gone), noise=taken(one.noise, kept))

    return replace(run_changes, case=without(full), plain=without(case), kept=kept)

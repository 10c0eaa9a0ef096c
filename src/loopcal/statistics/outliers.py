"""Outliers: poses that do not fit the others, what is to blame, and what happened to it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from loopcal.document.findings import ColumnFault, Outlier, OutlierTests
from loopcal.document.plain import finite
from loopcal.errors import InputError
from loopcal.estimation.faults.search import column_faults
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.result import FitResult
from loopcal.estimation.solve.scratch import one_blas_thread
from loopcal.presentation.shown import significant
from loopcal.statistics.outlier_search import Search
from loopcal.statistics.pose_tests import Fitted, PoseTests, tail

if TYPE_CHECKING:
    from loopcal.statistics.causes import Cause, Suspect

SCALES = ("auto", "stated", "residual")
# The level that the page states: docs/explanation/outliers.md.
_LEVEL, _SCALE = 0.05, "auto"
COLUMNS = "columns"
"""Under which a result remembers its columns that are wrong."""


@dataclass(frozen=True)
class Outliers:
    """What find_outliers found.

    found: the outliers, worst first; level: probability of naming anything in good data; tested:
    poses that could be tested; scale: factor on the stated sds (least squares: the sd of a loop
    value) that the tests used, from the residuals if `by_residuals`; columns: faults of whole
    columns.
    """

    found: tuple[Outlier, ...]
    level: float
    tested: int
    scale: float
    by_residuals: bool
    columns: tuple[ColumnFault, ...] = ()
    rejected: float | None = None
    """p-value of a chi-squared that rejects the fit as a whole; None where it does not."""

    def __len__(self) -> int:
        return len(self.found)

    @property
    def tests(self) -> OutlierTests:
        """How the poses were tested."""
        return OutlierTests(self.level, self.tested, self.scale, self.by_residuals)

    def __str__(self) -> str:
        return "\n".join(self.lines())

    def lines(self, most: int = 10) -> list[str]:
        """In words: the rule of the tests, what it found, at most so many poses."""
        if self.columns:
            lines = [f"file: {fault}" for fault in self.columns]
            return [*lines, "outliers: not tested until the file is corrected"]
        rule = f"{self.tested} poses tested, family-wise level {100 * self.level:g} %"
        if self.by_residuals:
            rule += f", residuals as scale (factor {significant(self.scale, 3)})"
        if not self.found and self.rejected is not None:
            return [
                f"outliers: no single pose stands out, yet chi-squared rejects the fit (p = "
                f"{self.rejected:.2g}): check the stated sds and the model ({rule})"
            ]
        if not self.found:
            return [f"outliers: none ({rule})"]
        lines = [f"outliers: {len(self.found)} ({rule})"]
        lines += [f"  {outlier}" for outlier in self.found[:most]]
        if len(self.found) > most:
            lines.append(f"  and {len(self.found) - most} more")
        return lines


def find_outliers(result: FitResult, *, level: float = _LEVEL, scale: str = _SCALE) -> Outliers:
    """The poses and readings that do not fit, with what probably happened to them.

    level: probability that anything is named where every reading is good; half of it is spent on
    the chi-squared of the poses, half on Baarda's w of the readings, each shared equally by all of
    them (Bonferroni). scale: "stated" takes the sds as they are; "residual" multiplies them by the
    root of the variance factor of the poses that fit; "auto" does so where the stated sds are
    plainly too small, and for least squares, which states none.

    Every cause is tried: the reading is corrected and the pose tested again at parameters it had no
    part in. Where the fit as a whole is bad, exchanged columns, columns in degrees instead of
    radians and reversed joints are tried on all poses.

    Raises InputError for a level outside (0, 1) or a scale that is none of the three.
    """
    if not 0.0 < level < 1.0:
        raise InputError(
            f"the level of a test is a probability, not {level:g}", code="invalid-value"
        )
    if scale not in SCALES:
        raise InputError(
            f"there is no scale {scale!r}",
            code="unknown-name",
            remedy=f"choose one of {', '.join(SCALES)}",
        )
    columns = find_columns(result)
    return of_file(columns, level) if columns else find_poses(result, level, scale)


def of_file(columns: tuple[ColumnFault, ...], level: float = _LEVEL) -> Outliers:
    """Of a file that is at fault as a whole: no single pose is tested."""
    return Outliers((), level, 0, 1.0, False, columns)


def find_columns(result: FitResult) -> tuple[ColumnFault, ...]:
    """Columns that are wrong as a whole, sought where the fit may be a bad one."""
    if result.faults:
        return result.faults
    with one_blas_thread():
        hopeless = Search(result, _LEVEL, _SCALE).hopeless()
        return column_faults(result.problem) if hopeless else ()


def find_poses(result: FitResult, level: float = _LEVEL, scale: str = _SCALE) -> Outliers:
    """As `find_outliers` where all columns are right."""
    with one_blas_thread():
        search = Search(result, level, scale)
        fit, gone, tests = search.run()
        named = _named(search, fit, gone, tests)
    root = float(np.sqrt(fit.factor))
    chi = result.chi_squared
    rejected = chi.p_value if chi is not None and chi.too_large else None
    named += search.corners.outliers
    return Outliers(named, level, search.tested(tests), root, fit.factor != 1.0, rejected=rejected)


def misfits(result: FitResult) -> set[str]:
    """The poses that `find_poses` names, without asking for the causes."""
    with one_blas_thread():
        search = Search(result, _LEVEL, _SCALE)
        _, gone, _ = search.run()
    poses = {search.problem.poses[i] for i in np.flatnonzero(gone)}
    return poses | {one.pose for one in search.corners.outliers}


def _named(
    search: Search, fit: Fitted, gone: NDArray[np.bool_], tests: PoseTests
) -> tuple[Outlier, ...]:
    """The outliers of a fit, worst first."""
    where = np.flatnonzero(gone)
    if not where.size:
        return ()
    from loopcal.statistics.causes import find_causes
    from loopcal.statistics.suspects import find_suspects

    suspects = find_suspects(search, fit, where, tests)
    causes = find_causes(search.problem, search.result.dataset, fit, suspects)
    worst = np.argsort([-(s.t / max(s.freedom, 1)) for s in suspects], kind="stable")
    denominator, p_shared = tests.denominator, tests.p_shared
    named = [_outlier(search.problem, suspects[i], causes[i], denominator) for i in worst]
    # one reading is named, yet all that an image shares may be wrong with it
    at = [suspects[i].pose for i in worst]
    shared = [float(p_shared[i]) if tests.sharing[i] else 1.0 for i in at]
    return tuple(
        replace(one, p_value=min(one.p_value, p)) for one, p in zip(named, shared, strict=True)
    )


def _outlier(
    problem: Problem, suspect: Suspect, cause: Cause | None, denominator: float
) -> Outlier:
    names = problem.mechanism.tape.quantities
    pose = problem.poses[suspect.pose]
    order = list(suspect.explained)
    if cause is not None and cause.quantity in order:
        order.remove(cause.quantity)
        order.insert(0, cause.quantity)
    words, verified = (None, False) if cause is None else (cause.words, cause.verified)
    whole = finite(suspect.t)
    if not order or (cause is not None and cause.quantity is None):
        p = float(tail(np.array([suspect.t]), np.array([suspect.freedom]), denominator)[0])
        together = tuple(suspect.together) if cause is None else ()
        size = suspect.together[together[0]] if len(together) == 1 else None
        unit = None if size is None else "m"
        outlier = Outlier(pose, None, whole, p, whole, size, unit, (), words, verified)
        return replace(outlier, together=together)
    j = order[0]
    size, left = suspect.explained[j]
    # Leaving a reading out lowers chi-squared by the square of its w.
    w = float(np.copysign(np.sqrt(max(suspect.t - left, 0.0)), size))
    p = float(tail(np.array([w * w]), np.array([1]), denominator)[0])
    others = tuple(names[i] for i in order[1:])
    unit = problem.mechanism.quantities[names[j]]
    read = [f.name for f in problem.mechanism.families if names[j] in f.readings]
    outlier = Outlier(pose, names[j], finite(w), p, whole, size, unit, others, words, verified)
    return replace(outlier, instrument=read[0] if read else None)

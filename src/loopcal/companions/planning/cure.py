"""How many more poses, and which, would raise the verdict of a check.

Poses are added one by one: each time the candidate that most lowers the relative variances of all
parameters, from the readings alone, without prior. After each the condition number is that of a
check (`statistics.identifiability`).
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from loopcal.arrays import Array
from loopcal.companions.planning.candidates import drawn, ranges_of, typical_sds, with_sds
from loopcal.companions.planning.information import information, rows_of
from loopcal.companions.planning.occasions import occasions
from loopcal.companions.planning.plan import as_problem, measured_poses
from loopcal.companions.planning.search import Search
from loopcal.document.plain import finite
from loopcal.errors import InputError
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.solve.scratch import one_blas_thread
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise
from loopcal.measurements.plan_settings import PlanSettings
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.redundancy import distinguished
from loopcal.presentation.shown import SHOWN, columns, significant
from loopcal.statistics.check import FEW
from loopcal.statistics.identifiability import SCHROER
from loopcal.units import from_si
from loopcal.workflow.checking import Checked

# Far fewer candidates than the 3000 of a plan: a cure is a hint beside a check.
MOST, CANDIDATES = 60, 500
_SHOWN = 10


@dataclass(frozen=True, eq=False)
class Cure:
    """Poses to add to those measured, the one that helps most first.

    poses: readings to set [SI]; condition: number of the data with them, None where infinite;
    enough: whether the verdict of a check is then good.
    """

    poses: Dataset
    condition: float | None
    enough: bool

    def document(self) -> dict[str, Any]:
        """As one JSON document, SI."""
        readings: Mapping[str, Array] = self.poses.readings
        return {
            "words": self.words(),
            "enough": self.enough,
            "condition_number": self.condition,
            "poses": [
                {q: finite(float(values[i])) for q, values in readings.items()}
                for i in range(len(self.poses))
            ],
        }

    def words(self) -> str:
        """How many poses, and what they give."""
        count = len(self.poses)
        number = "infinite" if self.condition is None else significant(self.condition, 3)
        if not self.enough:
            return (
                f"{count} more poses within the ranges would not cure this: the condition number "
                f"would be {number}. Widen the ranges ([plan.ranges]), read more quantities, or "
                "state priors."
            )
        poses = "pose" if count == 1 else "poses"
        return f"{count} more {poses} would cure this (condition number {number})"

    def __str__(self) -> str:
        if not self.enough:
            return self.words()
        count = len(self.poses)
        some = range(min(count, _SHOWN))
        units = {q: SHOWN.get(u, u) for q, u in self.poses.units.items()}
        shown = {q: from_si(v, units[q]) for q, v in self.poses.readings.items()}
        rows = [[f"{q} [{units[q]}]" for q in shown]]
        rows += [[significant(float(v[i]), 5) for v in shown.values()] for i in some]
        rest = [f"and {count - _SHOWN} more (--json)"] if count > _SHOWN else []
        return "\n".join([f"{self.words()}:", *columns(rows), *rest])


def cure(mechanism: Mechanism, existing: Dataset, noise: Noise, settings: PlanSettings) -> Cure:
    """The poses to add to readings that a check calls weak or undetermined.

    Raises InputError where nothing says where poses may be.
    """
    with one_blas_thread():
        measured = measured_poses(mechanism, existing, noise)
        ranges = ranges_of(measured.start, settings.ranges, existing)
        kinds = settings.occasions or occasions(measured.start, existing)
        few = replace(settings, number=CANDIDATES, occasions=kinds)
        pool = drawn(measured.start, ranges, few)
        like = with_sds(pool.closed, typical_sds(measured.problem))
        other = as_problem(measured.start, like, noise)
        before = rows_of(measured.problem, measured.problem.start, measured.corrections)
        rows = rows_of(other, other.start, np.zeros(other.readings.shape))
        return _cured(other, rows, before, measured.problem.equations, pool.driven)


def _cured(problem: Problem, rows: Array, before: Array, equations: int, driven: Dataset) -> Cure:
    n = rows.shape[2]
    # A check judges the readings alone, so the cure must not lean on priors.
    flat = replace(problem, prior_sd=np.full(n, np.inf))
    every = np.ones(n, dtype=bool)
    search = Search([information(flat, rows, before, np.empty((0, 1, n)), every)], "A")
    measured = before.reshape(-1, n)
    total = measured.T @ measured
    condition, enough = np.inf, False
    each = sum(p.equations(1) for p in problem.patterns[:1])
    while len(search.chosen) < min(MOST, len(rows)) and not enough:
        i = int(np.argmax(search.gains()))
        search.add(i)
        total = total + rows[i].T @ rows[i]
        condition = _condition(total)
        share = (equations + each * len(search.chosen)) / n
        enough = condition <= SCHROER and share >= FEW
    return Cure(driven.take(search.chosen), finite(condition), enough)


def _condition(total: Array) -> float:
    """Largest over smallest singular value of the column-scaled equations."""
    lengths = np.sqrt(np.diag(total))
    if not lengths.min() > 0.0:
        return float(np.inf)
    values = np.linalg.eigvalsh(total / lengths / lengths[:, None])
    return float(np.sqrt(values[-1] / values[0])) if values[0] > 1e-13 * values[-1] else np.inf


# The poses that would raise the verdict of a check.


def cure_of(checked: Checked) -> Cure | None:
    """The poses that would raise the verdict of a check.

    None where it is good, and where nothing says where poses may be.
    """
    if checked.check.verdict == "good" or checked.noise is None:
        return None
    project = checked.project
    with suppress(InputError):
        return cure(distinguished(project.mechanism), checked.data, checked.noise, project.plan)
    return None

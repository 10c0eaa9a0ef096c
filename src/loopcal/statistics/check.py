"""Before any fit: what these poses and sensors can give, at the nominal parameters.

The sds to expect are those of the implicit loop linearised at the nominal machine, placed where
the instrument sees it, and at the readings as they stand: (sum D^T D + prior)^-1, with the sds of
the sensors as stated. They say nothing of a mistake in the model or in the readings.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from loopcal.document.catalogue import findings
from loopcal.document.findings import Observability, UsualSd
from loopcal.document.plain import finite, plain
from loopcal.document.verdict import Fact, Finding, Where, fact
from loopcal.errors import listed
from loopcal.estimation.dependence.dependence import joint_rows
from loopcal.estimation.faults.misfit import mounted
from loopcal.estimation.fit import Fit, Start
from loopcal.estimation.noise.learning import with_model
from loopcal.estimation.plausible import refuse_contradiction
from loopcal.estimation.problem.problem import Problem, Weighting, build_problem
from loopcal.estimation.problem.starting import start_corrections
from loopcal.estimation.solve.reduction import Spectrum, spectrum, undetermined
from loopcal.estimation.solve.scratch import one_blas_thread
from loopcal.estimation.solve.sweep import NEAR, Sweeper
from loopcal.estimation.steps import started
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise, NoiseLike
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parameters import labels_of
from loopcal.mechanisms.prior import PriorLike
from loopcal.mechanisms.redundancy import distinguished, guessed
from loopcal.presentation.shown import SHOWN, brief, columns, significant
from loopcal.small_samples import LearntCovariance
from loopcal.statistics.folds import repeated, stated_sds
from loopcal.statistics.identifiability import (
    SCHROER,
    WhatDataSay,
    calibration_index,
    observability,
    what_data_say,
)
from loopcal.statistics.predictor import (
    Predictor,
    ReadingNoise,
    largest_by_unit,
    predictor_at,
    usual_words,
)
from loopcal.statistics.run_order import told_by_joints
from loopcal.units import from_si

ORDERED = "order-by-joints"
"""Code of the finding on such an order."""
# Chosen, not derived: a rule of thumb; below, residuals follow the model more than the noise.
FEW = 3.0
"""Loop equations per parameter below which there is little to check the model against."""
# At most so many names in a sentence.
_NAMED = 4


@dataclass(frozen=True)
class Range:
    """Readings of one quantity [SI unit]; sd: the median stated, None where none is."""

    quantity: str
    unit: str
    readings: int
    smallest: float | None
    largest: float | None
    sd: float | None


@dataclass(frozen=True, eq=False)
class Check:
    """What a calibration can be expected to give.

    expected_sd: of every parameter [SI], None where fixed or where no sds of sensors are stated,
    inf where undetermined; predictor: with the covariance to expect, None where no sds are stated
    or nothing is predicted; facts: what these poses determine first; superfluous: parameters that
    do to the readings what others do in any poses, and that their priors alone hold; files: name
    of the project, for command lines.
    """

    __repr__ = brief

    mechanism: Mechanism
    poses: int
    ranges: tuple[Range, ...]
    identifiability: WhatDataSay
    observability: Observability
    expected_sd: Mapping[str, float | None]
    predictor: Predictor | None
    facts: tuple[Fact, ...]
    superfluous: tuple[str, ...] = ()
    files: Mapping[str, str] = field(default_factory=dict)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What was found out, the gravest first."""
        return findings(self.facts, self.files, labels_of(self.mechanism.parameters))

    @property
    def finding(self) -> Finding:
        """What these poses determine."""
        return next(one for one in self.findings if one.question == "valid")

    @property
    def expected_at_poses(self) -> tuple[UsualSd, ...]:
        """The sd that the parameters cause in what each instrument sees, at 95 % of the poses."""
        return () if self.predictor is None else self.predictor.usual

    @property
    def verdict(self) -> str:
        """good, weak (poses alike, or few) or undetermined (a direction that neither readings nor
        prior limit)."""
        return self.finding.code.removeprefix("poses-")

    @property
    def words(self) -> str:
        """The verdict and its remedy."""
        one = self.finding
        return one.words if one.next is None else f"{one.words} {one.next.words}"

    def document(self) -> dict[str, Any]:
        """As one JSON document: SI, null for what is not known."""
        return {
            "verdict": self.verdict,
            "words": self.words,
            "findings": [asdict(one) for one in self.findings],
            "poses": self.poses,
            "quantities": [
                {
                    "name": r.quantity,
                    "unit": r.unit,
                    "readings": r.readings,
                    "smallest": r.smallest,
                    "largest": r.largest,
                    "sd": finite(r.sd),
                }
                for r in self.ranges
            ],
            "parameters": [
                {
                    "name": p.name,
                    "unit": p.unit,
                    "nominal": p.nominal,
                    "role": p.role,
                    "owner": p.owner,
                    "prior_sd": finite(p.prior_sd),
                    "fixed": p.fixed,
                    "same": p.same,
                    "expected_sd": finite(self.expected_sd[p.name]),
                }
                for p in self.mechanism.parameters
            ],
            "identifiability": {
                "data_condition_number": self.identifiability.condition_number,
                "data_versus_prior": plain(self.identifiability.learned),
                "weak_directions": plain(self.identifiability.weak),
                "calibration_index": plain(self.identifiability.index),
            },
            "observability": plain(self.observability),
            "prediction": {
                "sd_at_poses": largest_by_unit(self.expected_at_poses),
                "by": plain(self.expected_at_poses),
            },
            "said": self.said(),
            "remarks": list(self.mechanism.remarks),
        }

    def said(self) -> list[str]:
        """What the poses give, a line each, without the verdict."""
        condition, lines = self.identifiability.condition_number, []
        if condition is not None:
            lines.append(f"condition number of the poses {significant(condition, 3)}")
        lines += [self.observability.words(), self.identifiability.index.words()]
        lines += [
            f"expected prediction: {words} at 95 % of these poses"
            for words in usual_words(self.expected_at_poses)
        ]
        lines += [one.words for one in self.findings if one.question != "valid"]
        if self.superfluous:
            names = listed(self.superfluous, _NAMED)
            lines.append(
                f"only priors hold {names}: no poses distinguish them from other parameters"
            )
        return lines + self.identifiability.words()

    def __str__(self) -> str:
        lines = [*_range_table(self), "", *_parameter_table(self), "", *self.said()]
        if self.mechanism.remarks:
            lines += ["", *self.mechanism.remarks]
        return "\n".join([*lines, "", f"{self.verdict.upper()}  {self.words}"])


def check(
    mechanism: Mechanism,
    data: Dataset | Any,
    *,
    noise: NoiseLike | None = None,
    prior: PriorLike | None = None,
    start: Start = "auto",
) -> Check:
    """What these readings can determine, before any fit.

    noise: without one the sensors are taken as exact, and no sds can be expected; the rest is as
    in `calibrate`. The covariance to expect is (sum D^T D + prior)^-1 at the nominal parameters
    (Wampler, Hollerbach and Arai 1995). Raises InputError for input that cannot be used.
    """
    data = data if isinstance(data, Dataset) else Dataset.from_arrays(data)
    fit, stated_noise = Fit(prior=prior, start=start), Noise.of(noise)
    mechanism = fit.with_prior(mechanism)
    if stated_noise is not None:
        mechanism, data = with_model(mechanism, data, stated_noise)
    with one_blas_thread():
        problem = started(mechanism, data, stated_noise, fit.start)
        if stated_noise is not None:
            refuse_contradiction(problem, data)
        if guessed(problem.mechanism):
            problem = mounted(problem)  # a target on the axis that turns it would seem to tell less
        sweeper = Sweeper(problem)
        # Weighted alike, loops correct only what no sensor reads: the readings stay as they stand.
        exact = Sweeper(problem.weighted(Weighting.ALIKE))
        corrections = start_corrections(exact, problem.start)
        corrections = exact.close(problem.start, corrections, NEAR, 1.0).corrections
        information = sweeper.sweep(problem.start, corrections, triangular=True).data
        system = spectrum(information, np.zeros(len(problem.free)), problem.prior_sd)
        loose = {n for d in undetermined(system, problem.names) for n in d}
        sds = _expected(problem, system, loose, stated=stated_noise is not None)
        predictor: Predictor | None = None
        if mechanism.outputs and stated_noise is not None:
            x = problem.readings + corrections
            covariance = LearntCovariance.certain(system.covariance())
            predictor = predictor_at(
                problem, problem.mechanism, covariance, system, x, ReadingNoise()
            )
        core = distinguished(problem.mechanism)
        judged = problem
        if core is not problem.mechanism:
            judged = build_problem(core, data, stated_noise)
            information = Sweeper(judged).sweep(judged.start, corrections, triangular=True).data
    index = calibration_index(judged, judged.count, judged.equations)
    # Whitened by stated sds, an equation has the sd 1.
    said = what_data_say(
        judged, information, sds, index, unit_sd=None if stated_noise is None else 1.0
    )
    superfluous = tuple(name for name in problem.names if core.parameters[name].fixed)
    return Check(
        problem.mechanism,
        len(data),
        _ranges(problem, data, stated=stated_noise is not None),
        said,
        observability(information, len(data)),
        sds,
        predictor,
        (_determined(judged, said, loose), *_order(problem, mechanism, data, stated_noise)),
        superfluous,
    )


def _expected(
    problem: Problem, system: Spectrum, loose: set[str], *, stated: bool
) -> dict[str, float | None]:
    sds: dict[str, float | None] = dict.fromkeys(problem.mechanism.parameters.names)
    if stated:
        variances = np.diag(system.covariance()).tolist()
        for name, variance in zip(problem.names, variances, strict=True):
            sds[name] = math.inf if name in loose else math.sqrt(max(variance, 0.0))
    return sds


def _ranges(problem: Problem, data: Dataset, *, stated: bool) -> tuple[Range, ...]:
    ranges = []
    shape = problem.readings.shape
    sds = np.broadcast_to(problem.uncertainty.sd, shape)
    for row, (quantity, unit) in enumerate(problem.mechanism.quantities.items()):
        values = data.readings.get(quantity, np.empty(0))
        values = values[~np.isnan(values)]
        low, high = (float(values.min()), float(values.max())) if values.size else (None, None)
        read = np.isfinite(sds[row])
        # Of a whole robot other poses read other things.
        sd = float(np.median(sds[row][read] if read.any() else sds[row])) if stated else None
        ranges.append(Range(quantity, unit, int(values.size), low, high, sd))
    return tuple(ranges)


def _determined(problem: Problem, said: WhatDataSay, loose: set[str]) -> Fact:
    condition, share = said.condition_number, problem.equations / len(problem.free)
    numbers = {} if condition is None else {"condition_number": condition}
    if loose:
        place = Where(parameters=tuple(n for n in problem.names if n in loose))
        return fact("poses-undetermined", place, numbers)
    if condition is None or condition > SCHROER:
        size = "is infinite" if condition is None else f"is {significant(condition, 3)}"
        return fact("poses-alike", numbers=numbers, size=size, limit=f"{SCHROER:.0f}")
    if share < FEW:
        return fact("poses-few", numbers=numbers, share=significant(share, 2))
    return fact("poses-good", numbers=numbers)


def _order(
    problem: Problem, mechanism: Mechanism, data: Dataset, noise: Noise | None
) -> Iterator[Fact]:
    """Whether a drift could be distinguished from an error of the machine before any reading: by
    the order of the poses, or by one that was measured again half a run later."""
    share = told_by_joints(problem.readings[joint_rows(problem)].T)
    if share is None:
        return
    groups = repeated(mechanism, data, stated_sds(noise, mechanism, data))
    _, first, group = np.unique(groups, return_index=True, return_inverse=True)
    later = np.arange(len(groups)) - first[group]
    if 2 * int(later.max()) < len(groups):
        yield fact(ORDERED, numbers={"r_squared": share})


def _range_table(check: Check) -> list[str]:
    rows = [["quantity", "readings", "smallest", "largest", "sd", "unit"]]
    for r in check.ranges:
        unit = SHOWN.get(r.unit, r.unit)
        numbers = [
            "" if v is None else significant(float(from_si(v, unit)), 6)
            for v in (r.smallest, r.largest)
        ]
        sd = "" if r.sd is None else "exact" if r.sd == 0.0 else "not measured"
        if r.sd and math.isfinite(r.sd):
            sd = significant(float(from_si(r.sd, unit)), 3)
        rows.append([r.quantity, str(r.readings), *numbers, sd, unit])
    return columns(rows)


def _parameter_table(check: Check) -> list[str]:
    rows = [["parameter", "nominal", "prior sd", "expected sd", "unit", "role"]]
    for p in (p for p in check.mechanism.parameters if p.role != "corner"):
        unit = SHOWN.get(p.unit, p.unit)
        prior = significant(float(from_si(p.prior_sd, unit)), 3)
        sd = check.expected_sd[p.name]
        expected = "unknown"
        if sd is not None and math.isfinite(sd):
            expected = significant(float(from_si(sd, unit)), 3)
        nominal = f"{round(float(from_si(p.nominal, unit)), 9):.8g}"
        prior_shown = "flat" if math.isinf(p.prior_sd) else prior
        said = f"as {p.same}" if p.same else "fixed"
        sds = ("", said) if p.fixed else (prior_shown, expected)
        rows.append([p.name, nominal, *sds, unit, p.role])
    return columns(rows)

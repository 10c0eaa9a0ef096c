"""Joints and instrument told apart in repeated readings, by the loops they must close together.

An arm that is sent to one pose again and again does not come back exactly, and joints and
instrument both see that. The loops do not: their misclosure J_x dx holds what the sensors add. Its
scatter about a constant offset for each series is split by restricted maximum likelihood.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.estimation.noise.estimation import judged
from loopcal.estimation.noise.linear_model import LinearModel, linear_model
from loopcal.estimation.noise.variance_components import (
    ALIKE,
    Component,
    Estimate,
    estimate_ratios,
)
from loopcal.estimation.prediction import predict_outputs
from loopcal.estimation.problem.alignment import can_be_placed, placed
from loopcal.estimation.problem.problem import Problem, build_problem
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise
from loopcal.mechanisms.mechanism import Mechanism

# Places on one line leave the turn about it open.
_SPREAD = 0.05
"""Places of which one direction spreads less than this beside another show no rotation."""
# Chosen, not derived: drawings and placements are right to centimetres.
_ELSEWHERE = 0.1
"""A machine that misses by more [m] has its directions wrong."""


@dataclass(frozen=True)
class SeparatedSd:
    """The sd [SI unit] that a group of sensors has in common.

    raw: scatter of its readings about their means, real motion included; sd_of_sd: None where sd
    is zero or the readings leave it open; upper: 95 % bound, where sd is zero or unsure, else
    None; p_value: of such readings if this group had no noise, None where the loops could not do
    without it.
    """

    name: str
    quantities: tuple[str, ...]
    unit: str
    raw: float
    sd: float
    sd_of_sd: float | None
    upper: float | None
    p_value: float | None


@dataclass(frozen=True)
class Separation:
    """What the loops say of the sensors.

    groups: of sensors that are told apart; correlation: of their estimated variances; readings:
    rows that were used; miss: largest distance [m] by which the machine as it is described misses
    a measured point (None where its outputs are no point), which is no matter here while small.
    """

    groups: tuple[SeparatedSd, ...]
    correlation: float | None
    readings: int
    miss: float | None

    @property
    def separable(self) -> bool:
        """Whether these readings can say which group is to blame."""
        return self.correlation is None or abs(self.correlation) < ALIKE


def separate(
    mechanism: Mechanism,
    series: Sequence[Dataset],
    raw: Mapping[str, float],
    *,
    elsewhere: Dataset | None = None,
) -> Separation:
    """The sds of the outputs' instrument and of the other sensors, from series of repeats.

    e = J_x dx + offset of the series, dx ~ N(0, Sigma); J_x at the readings and at the nominal
    parameters. raw: scatter [SI] of each quantity about its mean. A spatial machine whose
    placement is not known is placed first. The series place it where these are of three poses or
    more that spread in space, else the readings `elsewhere`.

    Raises InputError where readings are missing, nothing scatters, or the instrument plainly
    stands elsewhere than the machine's placement says.
    """
    whole = [_complete(one, mechanism) for one in series]
    groups = _groups(mechanism, raw)
    first = {q: g.raw for g in groups for q in g.quantities}
    data = Dataset.from_arrays(
        {q: np.concatenate([one[q] for one in whole]) for q in whole[0].quantities}
    )
    noise = Noise({q: first.get(q, 0.0) for q in mechanism.quantities})
    mechanism = _placed(mechanism, data, [len(one) for one in whole], elsewhere)
    # Offsets take the parameters' place: with informative priors any number of poses will do.
    held = mechanism.with_parameters(mechanism.parameters.with_prior({"*": 1.0}))
    problem = build_problem(held, data, noise)
    miss = _miss(problem)
    names = mechanism.tape.quantities
    model = linear_model(
        problem,
        problem.start,
        np.zeros_like(problem.readings),
        [[names.index(q) for q in group.quantities] for group in groups],
        compressed=False,
    )
    lengths = [len(one) for one in whole]
    offsets = _with_offsets(model, np.repeat(np.arange(len(whole)), lengths), len(whole))
    estimate = estimate_ratios(offsets)
    separated = tuple(_judged(offsets, estimate, i, group) for i, group in enumerate(groups))
    return Separation(separated, _correlation(estimate), sum(lengths), miss)


def _placed(
    mechanism: Mechanism, data: Dataset, lengths: Sequence[int], elsewhere: Dataset | None
) -> Mechanism:
    """The machine where the instrument sees it, as far as readings show that."""
    if len(mechanism.outputs) != 3 or not can_be_placed(mechanism):
        return mechanism
    points = np.array([data[q] for q in mechanism.outputs])
    ends = np.cumsum(lengths)[:-1]
    means = np.array([part.mean(axis=1) for part in np.split(points, ends, axis=1)])
    spread = np.linalg.svd(means - means.mean(axis=0), compute_uv=False)
    if len(means) >= 3 and spread[1] > _SPREAD * spread[0]:
        elsewhere = data
    if elsewhere is None:
        return mechanism
    return placed(build_problem(mechanism, elsewhere, None))[0]


def _miss(problem: Problem) -> float | None:
    mechanism = problem.mechanism
    lengths = [q for q in mechanism.outputs if mechanism.quantities[q] == "m"]
    if not lengths or len(lengths) != len(mechanism.outputs):
        return None
    rows = [mechanism.tape.quantities.index(q) for q in mechanism.outputs]
    computed = predict_outputs(mechanism, problem.start, problem.readings, problem.pose_constants)
    miss = float(np.linalg.norm(computed - problem.readings[rows], axis=0).max())
    if miss > _ELSEWHERE:
        raise InputError(
            f"the machine as described misses the measured points by up to {miss:.3g} m: the "
            f"instrument was placed elsewhere, or a column or unit is wrong",
            code="implausible-readings",
            remedy="give the placement of these readings as nominal parameters, or series of three "
            "or more poses that spread in space to determine it; or omit --project",
        )
    return miss


def _complete(one: Dataset, mechanism: Mechanism) -> Dataset:
    """The rows in which every quantity was read."""
    needed = [*mechanism.quantities, *mechanism.pose_constants]
    complete = ~np.isnan([one[q] for q in needed]).any(axis=0)
    if complete.sum() < 3:
        raise InputError(
            f"{int(complete.sum())} rows have all of {', '.join(needed)}",
            code="missing-reading",
            place=one.source.name,
            remedy="read all of them in at least three rows, or omit --project",
        )
    kept = one.take(np.flatnonzero(complete))
    return replace(kept, readings={q: kept[q] for q in needed}, sds={})


def _groups(mechanism: Mechanism, raw: Mapping[str, float]) -> list[SeparatedSd]:
    """Instrument and other sensors by unit, with the rms of their scatter; still ones left out."""
    members: dict[tuple[str, str], list[str]] = {}
    for quantity, unit in mechanism.quantities.items():
        if raw.get(quantity, 0.0) > 0.0:
            role = "instrument" if quantity in mechanism.outputs else "joints"
            members.setdefault((role, unit), []).append(quantity)
    if not members:
        raise InputError(
            "these readings show no scatter",
            code="no-data",
            remedy="omit --project, or give readings with all their digits",
        )
    several = [role for role, _ in members]
    return [
        SeparatedSd(
            f"{role} [{unit}]" if several.count(role) > 1 else role,
            tuple(names),
            unit,
            math.sqrt(sum(raw[q] ** 2 for q in names) / len(names)),
            0.0,
            None,
            None,
            None,
        )
        for (role, unit), names in sorted(members.items(), key=lambda m: m[0][0] == "instrument")
    ]


def _with_offsets(model: LinearModel, owner: NDArray[np.intp], count: int) -> LinearModel:
    """The model with one offset of every loop equation and series for its only parameters."""
    blocks, begin = [], 0
    for block in model.blocks:
        poses, r = block.e.shape
        indicator = np.eye(count)[owner[begin : begin + poses]]
        J = np.einsum("bs,rt->brst", indicator, np.eye(r)).reshape(poses, r, count * r)
        blocks.append(block.by(J))
        begin += poses
    n = blocks[0].J.shape[2]
    return replace(model, blocks=tuple(blocks), precision=np.zeros(n), offset=np.zeros(n))


def _judged(model: LinearModel, estimate: Estimate, which: int, group: SeparatedSd) -> SeparatedSd:
    """The group with what the model says of its sd, of which `raw` is the stated one."""
    learnt = judged(model, estimate, which, Component(group.name, ()), unsure=False)
    sd, bound = learnt.sd_of_ratio, learnt.upper_ratio
    return replace(
        group,
        sd=learnt.ratio * group.raw,
        sd_of_sd=None if sd is None else sd * group.raw,
        upper=None if bound is None else bound * group.raw,
        p_value=learnt.p_value,
    )


def _correlation(estimate: Estimate) -> float | None:
    if len(estimate.ratios) != 2 or not np.all(estimate.ratios > 0.0):
        return None
    spread = np.sqrt(np.diag(estimate.covariance))
    return float(estimate.covariance[0, 1] / (spread[0] * spread[1]))

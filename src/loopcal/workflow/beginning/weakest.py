"""Where poses leave the machine worse known than its drawing, and which to measure beside them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from loopcal.document.findings import RegionRange
from loopcal.estimation.mounted import evenly
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.outputs import output_groups
from loopcal.presentation.shown import in_unit, unit_shown, with_unit
from loopcal.small_samples import LearntCovariance
from loopcal.statistics.check import FEW, ORDERED, Check, check
from loopcal.statistics.region import ranges_of, sds_in

DRAWN = {"length": 1e-3, "angle": 1e-3}
"""How far lengths [m] and angles [rad] of machines usually are from their drawing: the medians of
`structured`."""
_FIRST = 5_000
"""Poses that are checked first."""
_MUCH = 0.5
"""A joint that moves over less of its working range is named."""


def left_open(
    mechanism: Mechanism, dataset: Dataset, noise: Noise | None
) -> tuple[str, tuple[str, ...]]:
    """Where the poses leave the machine open, and whether they do so with a drift, in words."""
    if len(dataset) > _FIRST:
        some = dataset.take(evenly(np.arange(len(dataset)), _FIRST))
        if not any(left_open(mechanism, some, noise)):
            return "", ()  # what some of the poses determine, all determine better
    made = check(mechanism, dataset, noise=noise)
    ordered = tuple(one.words for one in made.findings if one.code == ORDERED)
    return weakest(made, dataset), ordered


def weakest(made: Check, dataset: Dataset) -> str:
    """Where these poses leave the machine worse known than its drawing, and what to measure; empty
    where they do not.

    Compared is what parameters cause in the end point over the working region. Single parameters
    may be open and change no reading, such as a turn of the last joint and of the target on it.
    """
    predictor, machine = made.predictor, made.mechanism
    if predictor is None or not machine.joints:  # of a parallel machine no range is known
        return ""
    # Other dimensions have no usual error: taken as exact, they favour the drawing.
    sds = [DRAWN.get(machine.parameters[name].dimension, 0.0) for name in predictor.names]
    drawing = replace(predictor, covariance=LearntCovariance.certain(np.diag(np.square(sds))))
    ranges = ranges_of(machine, {name: dataset[name] for name in machine.joints}, {})
    constants = {name: float(np.nanmedian(dataset[name])) for name in machine.tape.pose_constants}
    made_sds, drawn_sds = (sds_in(one, ranges, constants) for one in (predictor, drawing))
    both = zip(output_groups(machine), made_sds, drawn_sds, strict=True)
    # Of a machine that is placed alone, nothing is drawn.
    worse = [(group, sd, drawn) for group, sd, drawn in both if sd > drawn > 0.0]
    if not worse:
        return ""
    group, sd, drawn = max(worse, key=lambda one: one[1] / one[2])
    size = with_unit(sd, group.unit, 2) if sd < 1.0 else "more than 1 m"
    still = [r for r in ranges if _moved(dataset, r.quantity) < _MUCH * (r.high - r.low)]
    turned = ", ".join(_span(r, machine.quantities[r.quantity]) for r in still or ranges)
    needed = math.ceil(FEW * len(predictor.names) / max(len(group.outputs), 1))
    return (
        "These poses determine the machine worse than its drawing does. Over the working range "
        f"they predict the end point with an sd of {size}; the drawing predicts it with "
        f"{with_unit(drawn, group.unit, 2)}. Measure at least {needed} poses that move these "
        f"joints over their range: {turned}."
    )


def _moved(dataset: Dataset, quantity: str) -> float:
    return float(np.nanmax(dataset[quantity]) - np.nanmin(dataset[quantity]))


def _span(one: RegionRange, kind: str) -> str:
    low, high = (f"{in_unit(value, kind):.0f}" for value in (one.low, one.high))
    return f"{one.quantity} {low} to {high} {unit_shown(kind)}"

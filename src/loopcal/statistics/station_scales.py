"""Scales of several stations, as a term whose sd is learnt.

Two stations whose scales differ bend every machine that is fitted to both, and which one is right
no reading says. What is common to all scales the lengths of the machine take up, which makes these
as uncertain as one scale is. Predictions are of true lengths.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from loopcal.errors import InputError
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.effects.effect import STATION_SCALES, with_effects
from loopcal.mechanisms.effects.station_scales import SD, StationScales
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.terms import Term
from loopcal.statistics.case import Case

SPREAD = 2.0
"""sd of the logarithm of the learnt sd: from 1 ppm of an interferometer to 100 ppm of cameras."""
COLUMN = "in_calibration"
"""The known constant that is 1 in what is calibrated: no file has it."""


def with_station_scales(case: Case) -> Case:
    """The case with a scale of each station, where there are several.

    Itself elsewhere, under a robust loss, and where an instrument compares two poses or has such a
    scale already.
    """
    if case.fit.robust_loss is not None:
        return case
    try:
        made = with_effects(case.mechanism, [StationScales(COLUMN, STATION_SCALES)])
    except InputError:
        return case
    words = "the stations have scales of {scale} (sd)"
    term = Term(STATION_SCALES, made.effects[STATION_SCALES], SD, SPREAD, words)
    made = made.with_terms(term)
    return replace(case, mechanism=made, data=by_same_stations(made, case.data))


def by_same_stations(mechanism: Mechanism, data: Dataset) -> Dataset:
    """Readings to calibrate with, which have the scales of the stations."""
    if COLUMN not in mechanism.pose_constants:
        return data
    return data.with_readings({COLUMN: np.ones(len(data))}, units={COLUMN: "1"})

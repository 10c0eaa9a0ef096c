"""Images of another day, without the corners that do not fit the others of their images.

A machine that changed moves all corners of an image together. So the readings are fitted with all
that the calibration estimated free, and what is left of single corners is tested as on the first
day (`wrong_corners`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError, NoTrustworthyResult
from loopcal.estimation.calibrate import calibrate
from loopcal.estimation.fit import Fit
from loopcal.estimation.problem.constants import with_latest
from loopcal.estimation.solve.scratch import one_blas_thread
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise
from loopcal.mechanisms.mechanism import PIXELS
from loopcal.statistics.another_day import Day, noise_of
from loopcal.statistics.calibrated import Calibrated
from loopcal.statistics.replacing import Replaced
from loopcal.statistics.wrong_corners import wrong_corners

# Chosen, not derived: what `init` states of a robot that says where its flange is.
_READ = 1e-4
"""sd [m or rad] of readings that the calibration took as exact."""

# Chosen, not derived: a board that slips or a joint's zero that moved spreads less among images.
_FOREIGN = 30.0
"""An image that misses by so many times as much as the median one has another image's pose."""


def fitting_corners(
    calibrated: Calibrated, data: Dataset, noise: Noise | None, remounted: bool | Sequence[str]
) -> Dataset:
    """The readings without wrong corners, which the source counts. Without images they stay.

    noise: theirs, else that of the calibration; remounted: as in `verify`. Raises InputError where
    readings or sds are missing, and for a name that is not there.
    """
    mechanism = calibrated.mechanism
    corners = [q for f in mechanism.families if f.form == PIXELS for q in f.readings]
    if not corners:
        return data
    with one_blas_thread():
        placed = Day.of(calibrated, data, noise, remounted).placed()
    begun = dict(zip(mechanism.parameters.names, placed.parameters.tolist(), strict=True))
    foreign = _foreign(placed)
    if noise is None and calibrated.residual is not None:
        exact = dict.fromkeys(mechanism.tape.quantities, _READ)
        sd = math.sqrt(calibrated.residual.value)
        noise = Noise({**exact, **dict.fromkeys(corners, sd)})
    fit, stated = Fit(method="implicit-loop"), noise or noise_of(calibrated)
    whole = replace(data, source=replace(data.source, judged=True))  # copies stay in their places
    # An image beside a pose that is not its own tells nothing of its corners.
    blind = {q: np.where(foreign, np.nan, whole[q]) for q in corners if q in whole.readings}
    whole = with_latest(mechanism, replace(whole, readings={**whole.readings, **blind}))
    start = replace(mechanism, terms=()).with_nominal(begun)
    try:
        wrong = wrong_corners(calibrate(start, whole, noise=stated, fit=fit, trusted=True))
    except (InputError, NoTrustworthyResult):
        return data  # for the verification to say
    if not wrong.corners:
        return data
    names = wrong.problem.mechanism.tape.quantities
    single = dict(zip(names, wrong.single, strict=True))
    left = {q: np.where(off, np.nan, data[q]) for q, off in single.items() if off.any()}
    images = int(wrong.single.any(axis=0).sum())
    words = (
        f"Left out {wrong.corners} of {wrong.count} corners, in {images} of {len(data)} images: "
        "they do not fit the others of their images."
    )
    source = replace(data.source, read_as=" ".join(filter(None, [data.source.read_as, words])))
    return replace(data, readings={**data.readings, **left}, source=source)


def _foreign(placed: Replaced) -> NDArray[np.bool_]:
    """(N,) whether an image stands beside a pose that is not its own."""
    squares = np.zeros(len(placed.problem.poses))
    for rows in placed.rows:
        squares[rows.poses] = np.mean(np.square(rows.e), axis=1)
    seen = squares[squares > 0.0]
    return squares > _FOREIGN**2 * np.median(seen) if seen.size else squares > 0.0

"""The uncertainty budget of positions that a calibration predicts: what contributes, and how much.

Two contributions are those of `loopcal predict`: the parameters, S_p Cov(p) S_p^T, and the readings
from which a position is predicted, S_x Sigma S_x^T. They are independent, so their variances add up
to the variance that it states. The scale of the instrument and the temperature of the machine are
the same in all readings, so that no residual shows them: they are in no number of the calibration,
and count only as far as [record] states them. Both are errors of a length, s d at a distance d.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.document.result_document import ResultDocument
from loopcal.errors import InputError
from loopcal.mechanisms.model_error import disturbances
from loopcal.mechanisms.outputs import POLAR, OutputGroup, points
from loopcal.small_samples import t_quantile
from loopcal.statistics.prediction import Prediction, predict
from loopcal.statistics.predictor import Predictor, trace_sd
from loopcal.workflow.saved_result import SavedResult

# erf(sqrt(2)) = 2 Phi(2) - 1.
SIGMAS_2 = 0.954499736103642
"""Probability of two sds: k = 2 where sds are known."""

# If squares vary by as much as their mean, an rms of 2000 is sure to 1 / (2 sqrt(2000)) = 1.1 %.
_MOST_POSES = 2000


@dataclass(frozen=True)
class Contribution:
    """name: what contributes; source: where its sd comes from; sd: rms over the measured poses of
    the root of the trace [m], None where it is not stated or not known; inside: whether it is part
    of what `loopcal predict` states."""

    name: str
    source: str
    sd: float | None
    inside: bool


@dataclass(frozen=True)
class BudgetPlace:
    """Where positions are predicted: sd as the calibration states it [m], with what [record]
    states, and U = k times that; source: what states the same sd."""

    name: str
    source: str
    stated: float
    combined: float
    U: float


@dataclass(frozen=True)
class Budget:
    """The budget of the positions that one instrument reads; k: coverage factor."""

    instrument: str
    unit: str
    contributions: tuple[Contribution, ...]
    places: tuple[BudgetPlace, ...]
    k: float
    distance: float | None
    """[m] Rms distance of the measured positions from their middle."""

    def share(self, one: Contribution) -> float | None:
        """Of the combined variance at the measured poses."""
        if one.sd is None or not self.places[0].combined:
            return None
        return (one.sd / self.places[0].combined) ** 2


@dataclass(frozen=True)
class LengthErrors:
    """What [record] states of errors of all lengths, as sds [1, 1/K, K]; None: not stated."""

    scale: float | None = None
    expansion: float | None = None
    temperature_sd: float | None = None

    @property
    def thermal(self) -> float | None:
        """Relative sd of lengths by the temperature of the machine."""
        if self.expansion is None or self.temperature_sd is None:
            return None
        return self.expansion * self.temperature_sd


def budgets(saved: SavedResult, lengths: LengthErrors) -> tuple[Budget, ...]:
    """Of each instrument that reads positions.

    Raises InputError where the result cannot predict positions, or its mechanism is written in
    Python and not at hand.
    """
    poses, predictor = saved.poses, saved.predictor
    if poses is None:
        raise InputError(
            "the result has no residuals.csv, which holds its poses",
            code="missing-file",
            place=str(saved.path.parent),
            remedy="calibrate again",
        )
    poses = poses.take(slice(None, None, -(-len(poses) // _MOST_POSES)))
    prediction = predict(predictor, poses)
    model = _by_model(predictor)
    by_model = None if model is None else predict(model, poses).from_readings
    made = (
        _budget(saved.document, predictor, prediction, by_model, group, lengths)
        for group in prediction.groups
        if group.unit == "m"
    )
    return tuple(one for one in made if one is not None)


def _by_model(predictor: Predictor) -> Predictor | None:
    """The same of which only the model error of each pose is uncertain; None without any."""
    errors = {
        q: sd for q in disturbances(predictor.mechanism) if (sd := predictor.readings.sds.get(q))
    }
    if not errors:
        return None
    sds: Mapping[str, float] = dict.fromkeys(predictor.readings.sds, 0.0) | errors
    return replace(predictor, readings=replace(predictor.readings, sds=sds, slopes={}, joint={}))


def _budget(
    document: ResultDocument,
    predictor: Predictor,
    prediction: Prediction,
    by_model: Array | None,
    group: OutputGroup,
    lengths: LengthErrors,
) -> Budget | None:
    # The same poses for all, so that the squares add up to that of the sum.
    usable = np.isfinite(trace_sd(prediction.covariance, group))
    if not usable.any():
        return None
    from_parameters = _rms(prediction.from_parameters, group, usable)
    poses = f"{document.data.used} poses and the sds of their readings, with placement and effects"
    parts = [Contribution("estimated parameters", poses, from_parameters, True)]
    region = document.region
    valid = None if region is None else region.of("m")
    stated = _rms(prediction.covariance, group, usable)
    if prediction.from_readings is None:
        source = "sds of the readings are not known"
        parts.append(Contribution("readings of a position", source, None, True))
    else:
        readings = prediction.from_readings
        if by_model is not None:
            # Independent by construction: variances of the rest are what is left.
            readings = readings - by_model
            learnt = "learnt from the residuals"
            parts.append(
                Contribution("model error of a pose", learnt, _rms(by_model, group, usable), True)
            )
        exact = prediction.by_residuals or not any(
            predictor.readings.sds.get(q) for q in _driving(predictor)
        )
        name = "what the fit leaves" if exact else "readings of a position"
        source = "residuals; the method takes readings as exact" if exact else _sources(document)
        parts.append(Contribution(name, source, _rms(readings, group, usable), True))
    distance = _distance(predictor, prediction, group)
    parts += [
        _of_length("instrument scale", "instrument_scale of [record]", lengths.scale, distance),
        _of_length(
            "temperature of the machine",
            "expansion and temperature_sd of [record]",
            lengths.thermal,
            distance,
        ),
    ]
    outside = math.hypot(*(one.sd or 0.0 for one in parts if not one.inside))
    k = t_quantile(SIGMAS_2, _freedom(prediction, group, usable))
    places = [_place("measured poses", "loopcal predict", stated, outside, k)]
    if valid is not None and valid.sd is not None:
        places.append(_place("working region", "the answer 'valid'", valid.sd, outside, k))
    return Budget(group.instrument, "m", tuple(parts), tuple(places), k, distance)


def _place(name: str, source: str, stated: float, outside: float, k: float) -> BudgetPlace:
    combined = math.hypot(stated, outside)
    return BudgetPlace(name, source, stated, combined, k * combined)


def _of_length(
    name: str, source: str, relative: float | None, distance: float | None
) -> Contribution:
    if relative is None:
        return Contribution(name, f"not stated: {source}", None, False)
    if distance is None:
        return Contribution(name, f"{source}; not known for these outputs", None, False)
    return Contribution(name, source, relative * distance, False)


def _rms(covariance: Array, group: OutputGroup, poses: NDArray[np.bool_]) -> float:
    """Over these poses."""
    return float(np.sqrt(np.square(trace_sd(covariance, group)[poses]).mean()))


def _freedom(prediction: Prediction, group: OutputGroup, poses: NDArray[np.bool_]) -> float:
    """Degrees of freedom of the mean variance over these poses, whose errors all go together: sds
    v sqrt(2 / nu) of variances v (Satterthwaite 1946) then add up."""
    rows = list(group.rows)
    freedom = prediction.freedom[poses][:, rows]
    variance = np.einsum("nii->ni", prediction.covariance)[poses][:, rows]
    unsure = float((variance / np.sqrt(freedom)).sum())
    return (float(variance.sum()) / unsure) ** 2 if unsure > 0.0 else math.inf


def _distance(predictor: Predictor, prediction: Prediction, group: OutputGroup) -> float | None:
    """Rms distance of the positions from their middle; None where outputs are no coordinates.

    The middle, because the placement of the instrument takes up a common shift.
    """
    family = next((f for f in predictor.mechanism.families if f.name == group.instrument), None)
    outputs = group.outputs
    if family is not None and family.form in POLAR:
        outputs = tuple(q for q in family.readings if q in prediction.outputs)
    at = np.array([prediction.outputs[q] for q in outputs])
    at = at[:, np.isfinite(at).all(axis=0)]
    if len(at) < 2 or not at.size:
        return None
    place = at if family is None else points(family, at)
    offsets = place - place.mean(axis=1, keepdims=True)
    return float(np.sqrt(np.square(offsets).sum(axis=0).mean()))


def _driving(predictor: Predictor) -> list[str]:
    machine = predictor.mechanism
    return [q for q in machine.tape.quantities if q not in machine.outputs]


def _sources(document: ResultDocument) -> str:
    outputs = document.mechanism.outputs if document.mechanism else ()
    kinds = {
        entry.source for entry in document.noise if not set(entry.quantities).issubset(outputs)
    }
    return f"sds of the sensors ({', '.join(sorted(kinds))})" if kinds else "sds of the sensors"

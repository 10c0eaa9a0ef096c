"""What a result predicts where nothing was measured: at one pose, and over the working region."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from loopcal.arrays import Array
from loopcal.companions.app.pictures import look
from loopcal.errors import InputError
from loopcal.figures.figure import axis, names, numbers, spots
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.outputs import levers, point_family, point_outputs, points
from loopcal.presentation.shown import by_sd, factor, unit_shown, with_unit
from loopcal.report.source import Source
from loopcal.statistics.prediction import Prediction, predict
from loopcal.statistics.predictor import Predictor, predictor_of

PLAIN = {"displaylogo": False, "displayModeBar": False, "scrollZoom": True}
POSES = 400
"""Random poses of the map."""


@dataclass(frozen=True, eq=False)
class Map:
    """at: (d, N) points [m]; sd: (N,) predicted there [m]; joints: joint -> (N,) its readings."""

    at: Array
    sd: Array
    joints: Mapping[str, Array]

    def pose(self, index: int) -> dict[str, float]:
        """The joints of one point."""
        return {q: float(values[index]) for q, values in self.joints.items()}


@dataclass(frozen=True, eq=False)
class Probe:
    """Predicts with the result on the disk. spans: joint -> least and largest reading [SI] of the
    working region; units: of the joints."""

    predictor: Predictor
    spans: Mapping[str, tuple[float, float]]
    units: Mapping[str, str]

    @classmethod
    def of(cls, source: Source) -> Probe | None:
        """None where the result states no working region, or cannot predict."""
        prediction = source.document.prediction
        region = None if prediction is None else prediction.region
        if region is None or source.mechanism is None:
            return None
        try:
            predictor = predictor_of(source.document, source.mechanism)
        except InputError:
            return None
        spans = {span.quantity: (span.low, span.high) for span in region.ranges}
        return cls(predictor, spans, {q: source.mechanism.quantities[q] for q in spans})

    def middle(self) -> dict[str, float]:
        """The pose in the middle of the region."""
        return {q: 0.5 * (low + high) for q, (low, high) in self.spans.items()}

    def at(self, joints: Mapping[str, float]) -> Prediction:
        """The outputs of one pose."""
        return self._predicted({q: np.array([value]) for q, value in joints.items()})

    def words(self, joints: Mapping[str, float]) -> list[str]:
        """The outputs of one pose with half widths of their 95 % intervals, a line each."""
        prediction = self.at(joints)
        half = prediction.half_width()
        return [
            _interval(name, float(prediction.outputs[name][0]), float(half[name][0]), unit)
            for name, unit in prediction.units.items()
        ]

    def map(self) -> Map:
        """Random poses of the region, and the sd predicted there."""
        # A fixed seed: the map stays the same while the result does.
        rng = np.random.default_rng(0)
        poses = {q: rng.uniform(low, high, POSES) for q, (low, high) in self.spans.items()}
        prediction = self._predicted(poses)
        family = point_family(self.predictor.mechanism)
        lengths = [n for n, unit in prediction.units.items() if unit == "m"][:3]
        shown = lengths if family is None else point_outputs(self.predictor.mechanism, family)
        at = np.array([prediction.outputs[n] for n in shown])
        sds = np.array([prediction.sd[n] for n in shown])
        if family is not None:
            # An sd of an angle counts by its lever, as a length.
            at, sds = points(family, at), levers(family, at) * sds
        # The root of the trace of the covariance, which is the same along any axes.
        sd = np.sqrt(np.square(sds).sum(axis=0))
        good = np.isfinite(sd) & np.isfinite(at).all(axis=0) if len(at) else np.zeros(0, bool)
        kept = {q: values[good] for q, values in poses.items()} if len(at) else {}
        return Map(at[:, good] if len(at) else np.zeros((0, 0)), sd[good] if len(at) else sd, kept)

    def _predicted(self, joints: Mapping[str, Array]) -> Prediction:
        count = len(next(iter(joints.values())))
        others = {
            q: np.full(count, value)
            for q, value in self.predictor.typical.items()
            if q not in joints
        }
        units = self.predictor.mechanism.units
        readings = {q: v for q, v in {**others, **joints}.items() if q in units}
        return predict(
            self.predictor, Dataset.from_arrays(readings, units={q: units[q] for q in readings})
        )


def map_figure(region_map: Map) -> dict[str, Any] | None:
    """The sd predicted over the working region; None where no point is predicted."""
    if len(region_map.at) < 2 or not len(region_map.sd):
        return None
    scale = factor("m")
    solid = len(region_map.at) == 3
    keys = "xyz"[: len(region_map.at)]
    colour = {"color": numbers(region_map.sd / scale), "colorscale": "Viridis", "size": 5}
    bar = {"title": {"text": f"sd [{unit_shown('m')}]"}, "thickness": 12}
    trace = spots(
        "markers",
        region_map.at,
        marker={**colour, "colorbar": bar},
        customdata=list(range(len(region_map.sd))),
        text=names([with_unit(float(s), "m") for s in region_map.sd]),
        hoverinfo="text",
    )
    titles = {f"{k}axis": axis(f"{k} [m]") for k in keys}
    more = {"scene": {"aspectmode": "data", **titles}} if solid else titles
    return {"data": [trace], "layout": look(440, uirevision="map", **more), "config": PLAIN}


def _interval(name: str, value: float, half: float, unit: str) -> str:
    if not np.isfinite(value):
        return f"{name}: cannot be reached"
    if not np.isfinite(half):
        return f"{name} = {with_unit(value, unit)}, uncertainty unknown"
    return f"{name} = {by_sd(value, half, unit)} ± {with_unit(half, unit, 2)}"

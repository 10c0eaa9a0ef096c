"""What a result predicts where nothing was measured: at one pose, and over the working region."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.app.pictures import look
from loopcal.errors import InputError
from loopcal.figures.figure import axis, names, numbers
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.outputs import levers, point_family, point_outputs, points
from loopcal.presentation.shown import by_sd, factor, unit_shown, with_unit
from loopcal.report.source import Source
from loopcal.statistics.prediction import Prediction, predict
from loopcal.statistics.predictor import Predictor, predictor_of

Array = NDArray[np.float64]
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

    known: Predictor
    spans: Mapping[str, tuple[float, float]]
    units: Mapping[str, str]

    @classmethod
    def of(cls, source: Source) -> Probe | None:
        """None where the result states no working region, or cannot predict."""
        found = source.document.prediction
        region = None if found is None else found.region
        if region is None or source.mechanism is None:
            return None
        try:
            known = predictor_of(source.document, source.mechanism)
        except InputError:
            return None
        spans = {span.quantity: (span.low, span.high) for span in region.ranges}
        return cls(known, spans, {q: source.mechanism.quantities[q] for q in spans})

    def middle(self) -> dict[str, float]:
        """The pose in the middle of the region."""
        return {q: 0.5 * (low + high) for q, (low, high) in self.spans.items()}

    def at(self, joints: Mapping[str, float]) -> Prediction:
        """The outputs of one pose."""
        return self._predicted({q: np.array([value]) for q, value in joints.items()})

    def words(self, joints: Mapping[str, float]) -> list[str]:
        """The outputs of one pose with half widths of their 95 % intervals, a line each."""
        found = self.at(joints)
        half = found.half_width()
        return [
            _interval(name, float(found.outputs[name][0]), float(half[name][0]), unit)
            for name, unit in found.units.items()
        ]

    def map(self) -> Map:
        """Random poses of the region, and the sd predicted there."""
        rng = np.random.default_rng(0)
        poses = {q: rng.uniform(low, high, POSES) for q, (low, high) in self.spans.items()}
        found = self._predicted(poses)
        family = point_family(self.known.mechanism)
        lengths = [n for n, unit in found.units.items() if unit == "m"][:3]
        shown = lengths if family is None else point_outputs(self.known.mechanism, family)
        at = np.array([found.outputs[n] for n in shown])
        sds = np.array([found.sd[n] for n in shown])
        if family is not None:
            at, sds = points(family, at), levers(family, at) * sds
        sd = np.sqrt(np.square(sds).sum(axis=0))
        good = np.isfinite(sd) & np.isfinite(at).all(axis=0) if len(at) else np.zeros(0, bool)
        kept = {q: values[good] for q, values in poses.items()} if len(at) else {}
        return Map(at[:, good] if len(at) else np.zeros((0, 0)), sd[good] if len(at) else sd, kept)

    def _predicted(self, joints: Mapping[str, Array]) -> Prediction:
        count = len(next(iter(joints.values())))
        others = {
            q: np.full(count, value) for q, value in self.known.typical.items() if q not in joints
        }
        own = {**self.known.mechanism.quantities, **self.known.mechanism.known}
        given = {q: v for q, v in {**others, **joints}.items() if q in own}
        return predict(self.known, Dataset.from_arrays(given, units={q: own[q] for q in given}))


def map_figure(found: Map) -> dict[str, Any] | None:
    """The sd predicted over the working region; None where no point is predicted."""
    if len(found.at) < 2 or not len(found.sd):
        return None
    scale = factor("m")
    solid = len(found.at) == 3
    keys = "xyz"[: len(found.at)]
    colour = {"color": numbers(found.sd / scale), "colorscale": "Viridis", "size": 5}
    bar = {"title": {"text": f"sd [{unit_shown('m')}]"}, "thickness": 12}
    trace = {
        "type": "scatter3d" if solid else "scatter",
        "mode": "markers",
        "marker": {**colour, "colorbar": bar},
        "customdata": list(range(len(found.sd))),
        "text": names([with_unit(float(s), "m") for s in found.sd]),
        "hoverinfo": "text",
        **{k: numbers(found.at[i]) for i, k in enumerate(keys)},
    }
    titles = {f"{k}axis": axis(f"{k} [m]") for k in keys}
    more = {"scene": {"aspectmode": "data", **titles}} if solid else titles
    return {"data": [trace], "layout": look(440, uirevision="map", **more), "config": PLAIN}


def _interval(name: str, value: float, half: float, unit: str) -> str:
    if not np.isfinite(value):
        return f"{name}: cannot be reached"
    if not np.isfinite(half):
        return f"{name} = {with_unit(value, unit)}, uncertainty unknown"
    return f"{name} = {by_sd(value, half, unit)} ± {with_unit(half, unit, 2)}"

"""The figures of one result, from what was written of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.figures.accuracy import distance_histogram, over_poses
from loopcal.figures.correlations import correlations
from loopcal.figures.figure import Figure
from loopcal.figures.sensors import drift, normalised
from loopcal.figures.space import arrows
from loopcal.mechanisms.skeleton import skeleton
from loopcal.report.source import Source
from loopcal.report.words import factor, unit_shown

Array = NDArray[np.float64]


def figures(source: Source) -> dict[str, Figure]:
    """By key, those that the result has the numbers for."""
    sensors = {
        quantity: values
        for quantity in source.document["data"]["quantities"]
        if (values := source.columns.normalised(quantity)) is not None
    }
    found = [
        *_of_outputs(source),
        _residuals(source),
        normalised(sensors),
        drift(sensors, source.columns.poses),
        _correlations(source.document),
    ]
    return {figure.key: figure for figure in found if figure is not None}


def _of_outputs(source: Source) -> list[Figure | None]:
    accuracy = source.document["accuracy"]
    before, after = (source.columns.differences(when) for when in ("before", "after"))
    if accuracy is None or not after:
        return []
    unit = accuracy["unit"]
    scale = factor(unit)
    lengths = [_lengths(differences) / scale for differences in (before, after)]
    found = [distance_histogram(lengths[0], lengths[1], unit_shown(unit))]
    points = [source.columns.reading(name) for name in after]
    if unit == "m" and len(points) in (2, 3) and all(point is not None for point in points):
        at = np.array(points)
        differences = np.array(list(after.values()))
        found.append(arrows(at, differences, _skeleton(source, at), unit_shown(unit), scale))
    return found


def _residuals(source: Source) -> Figure | None:
    accuracy = source.document["accuracy"]
    before, after = (source.columns.differences(when) for when in ("before", "after"))
    if accuracy is not None and after:
        scale, unit = factor(accuracy["unit"]), unit_shown(accuracy["unit"])
        scaled = [{name: v / scale for name, v in d.items()} for d in (before, after)]
        return over_poses(
            scaled[0], scaled[1], source.columns.poses, unit, "Computed minus measured"
        )
    # without outputs the loops are all there is; that corrected readings close them says nothing
    told = source.document["method"] == "least-squares"
    loops = source.columns.residuals("after") if told else {}
    what = "Values of the loop equations"
    return over_poses(source.columns.residuals("before"), loops, source.columns.poses, "SI", what)


def _lengths(differences: Mapping[str, Array]) -> Array:
    found: Array = np.linalg.norm(np.array(list(differences.values())), axis=0)
    return found


def _skeleton(source: Source, points: Array) -> Array | None:
    """The machine in the pose whose measured point lies nearest to the middle of all."""
    if source.mechanism is None:
        return None
    middle = np.nanmedian(points, axis=1, keepdims=True)
    away = np.square(points - middle).sum(axis=0)
    names = source.document["data"]["quantities"]
    columns = {q: v for q in names if (v := source.columns.reading(q)) is not None}
    readings = {q: v for q, v in columns.items() if np.isfinite(v).any()}
    away = away + sum(0.0 * values for values in readings.values())
    if not np.isfinite(away).any():
        return None
    pose = int(np.nanargmin(away))
    try:
        return skeleton(source.mechanism, {q: float(v[pose]) for q, v in readings.items()})
    except KeyError:
        return None  # a joint that was never read


def _correlations(document: Mapping[str, Any]) -> Figure | None:
    covariance = document["covariance"]
    names = covariance["names"]
    matrix = np.array(covariance["matrix"], dtype=float).reshape((len(names),) * 2)
    return correlations(matrix, names)

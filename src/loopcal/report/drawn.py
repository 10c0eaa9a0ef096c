"""The figures of one result, from what was written of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.distances import distances, point_outputs, points
from loopcal.figures.accuracy import distance_histogram, over_poses
from loopcal.figures.correlations import correlations
from loopcal.figures.figure import Figure
from loopcal.figures.sensors import drift, normalised
from loopcal.figures.space import arrows
from loopcal.mechanisms.skeleton import skeleton
from loopcal.report.source import Source
from loopcal.presentation.shown import factor, unit_shown

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
    lengths = [_lengths(source, differences) / scale for differences in (before, after)]
    found = [distance_histogram(lengths[0], lengths[1], unit_shown(unit))]
    seen = _points(source, after)
    if unit == "m" and seen is not None:
        at, along = seen
        found.append(arrows(at, along, _skeleton(source, at), unit_shown(unit), scale))
    return found


def _points(source: Source, differences: Mapping[str, Array]) -> tuple[Array, Array] | None:
    """Points (d, N) [m] that one instrument measured, and computed minus measured ones."""
    families = source.mechanism.families if source.mechanism else ()
    # the machine is drawn where the first instrument sees it whose place is known
    for family in sorted(families, key=lambda f: f.placement is None):
        names = point_outputs(source.mechanism, family) if source.mechanism else ()
        read = {n: v for n in names if (v := source.columns.reading(n)) is not None}
        if names and len(read) == len(names) and differences.keys() >= read.keys():
            at = np.array(list(read.values()))
            computed = at + np.array([differences[n] for n in names])
            return points(family, at), points(family, computed) - points(family, at)
    everything = [source.columns.reading(name) for name in differences]
    if families or len(everything) not in (2, 3) or any(v is None for v in everything):
        return None
    return np.array(everything), np.array(list(differences.values()))


def _residuals(source: Source) -> Figure | None:
    accuracy = source.document["accuracy"]
    before, after = (source.columns.differences(when) for when in ("before", "after"))
    if accuracy is not None and after:
        scale, unit = factor(accuracy["unit"]), unit_shown(accuracy["unit"])
        alike = [n for n in after if _unit(source, n) in (None, accuracy["unit"])]
        scaled = [{n: d[n] / scale for n in alike} for d in (before, after)]
        return over_poses(
            scaled[0], scaled[1], source.columns.poses, unit, "Computed minus measured"
        )
    # without outputs the loops are all there is; that corrected readings close them says nothing
    told = source.document["method"] == "least-squares"
    loops = source.columns.residuals("after") if told else {}
    what = "Values of the loop equations"
    return over_poses(source.columns.residuals("before"), loops, source.columns.poses, "SI", what)


def _unit(source: Source, quantity: str) -> str | None:
    """SI unit of a quantity, None where the mechanism is not known."""
    return None if source.mechanism is None else source.mechanism.quantities.get(quantity)


def _lengths(source: Source, differences: Mapping[str, Array]) -> Array:
    """Distances of computed from measured outputs, of every instrument and pose."""
    given = np.array(list(differences.values()))
    found: Array = np.linalg.norm(given, axis=0)
    if source.mechanism is not None and tuple(differences) == source.mechanism.outputs:
        lost = np.full(given.shape[1], np.nan)
        read = [source.columns.reading(name) for name in differences]
        measured = np.array([lost if row is None else row for row in read])
        told = distances(source.mechanism, measured, given)
        found = found if told is None else told.values.ravel()
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

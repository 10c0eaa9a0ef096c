"""The figures of one result, from what was written of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from loopcal.arrays import Array
from loopcal.document.result_document import ResultDocument
from loopcal.document.tables import shown_parameters
from loopcal.estimation.accuracy import Apart, by_pose, deviations, main_distances
from loopcal.figures.figure import Figure, colours
from loopcal.figures.residuals import (
    Change,
    changes,
    correlations,
    distance_histogram,
    drift,
    normalised,
    over_poses,
)
from loopcal.figures.space import Machine, arrows
from loopcal.mechanisms.mechanism import PIXELS, Family
from loopcal.mechanisms.skeleton import skeleton, skeleton_labels
from loopcal.presentation.shown import factor, unit_shown
from loopcal.report.images import image_figures
from loopcal.report.sighted import seen
from loopcal.report.source import Source

_OVER_POSES = ("residuals", "drift")


def figures(source: Source) -> dict[str, Figure]:
    """By key, those that the result has the numbers for."""
    sensors = _sensors(source)
    means = {name: by_image(values) for name, values in sensors.items()}
    shades = colours([*sensors, *source.table.differences_after])
    possible_figures = [
        *_of_outputs(source),
        *image_figures(source, _machine),
        _residuals(source, shades),
        normalised(sensors, shades),
        drift(means, source.table.poses, shades),
        _parameters(source.document),
        _correlations(source.document),
    ]
    marks = _changed(source)
    drawn = [figure for figure in possible_figures if figure is not None]
    return {f.key: f.marked(marks) if f.key in _OVER_POSES else f for f in drawn}


def _sensors(source: Source) -> dict[str, Array]:
    """Corrections over their sds by sensor, (N,); of a camera (points, N), u and v apart."""
    table = source.table.normalised
    images = _images(source)
    pixels = {q for family in images for q in family.readings}
    plain = {q: table[q] for q in source.document.data.quantities if q in table and q not in pixels}
    for family in images:
        for i, axis in enumerate("uv"):
            rows = [table[q] for q in family.readings[i::2] if q in table]
            plain |= {f"{family.name} {axis}": np.array(rows)} if rows else {}
    return plain


def _images(source: Source) -> list[Family]:
    families = source.mechanism.families if source.mechanism else ()
    return [family for family in families if family.form == PIXELS]


def by_image(values: Array) -> Array:
    """(N,) means over the points of an image of (points, N), NaN without any."""
    if values.ndim == 1:
        return values
    count = np.isfinite(values).sum(axis=0)
    return np.where(count, np.nansum(values, axis=0) / np.maximum(count, 1), np.nan)


def _changed(source: Source) -> dict[int, str]:
    """Number from 1 -> id of the poses from which on something was changed at once."""
    points = source.document.change_points
    steps = [] if points is None else [p.pose for p in points.found if p.shape == "step"]
    ids = list(source.table.poses)
    return {ids.index(pose) + 1: pose for pose in dict.fromkeys(steps) if pose in ids}


def _of_outputs(source: Source) -> list[Figure | None]:
    accuracy = source.document.accuracy
    before, after = source.table.differences_before, source.table.differences_after
    if accuracy is None or not after:
        return []
    unit = accuracy.unit
    scale = factor(unit)
    lengths = [distances(source, differences) / scale for differences in (before, after)]
    drawn = [distance_histogram(lengths[0], lengths[1], unit_shown(unit))]
    both = {"before": seen(source, before), "after": seen(source, after)}
    stages = {name: one.along for name, one in both.items() if one is not None}
    if unit == "m" and (last := both["after"]) is not None:
        machine, poses = _machine(source, last.at), source.table.poses
        drawn.append(arrows(last.at, stages, machine, poses, unit_shown(unit), scale))
    return drawn


def _residuals(source: Source, shades: Mapping[str, str]) -> Figure | None:
    accuracy, table = source.document.accuracy, source.table
    before, after = table.differences_before, table.differences_after
    if accuracy is not None and after:
        scale, unit = factor(accuracy.unit), unit_shown(accuracy.unit)
        if accuracy.unit == "px":
            first, last = (by_camera(source, d) for d in (before, after))
            return over_poses(first, last, table.poses, unit, "Rms residual of each image")
        alike = [n for n in after if _unit(source, n) in (None, accuracy.unit)]
        scaled = [{n: d[n] / scale for n in alike} for d in (before, after)]
        what = "Computed minus measured"
        return over_poses(scaled[0], scaled[1], table.poses, unit, what, shades)
    # without outputs the loops are all there is; that corrected readings close them says nothing
    loops = table.residuals_after if source.document.sensors_exact else {}
    return over_poses(
        table.residuals_before, loops, table.poses, "SI", "Values of the loop equations"
    )


def _unit(source: Source, quantity: str) -> str | None:
    """SI unit of a quantity, None where the mechanism is not known."""
    mechanism = source.document.mechanism or source.mechanism
    return None if mechanism is None else mechanism.quantities.get(quantity)


def distances(source: Source, differences: Mapping[str, Array]) -> Array:
    """Distances of computed from measured outputs, of every instrument and pose."""
    apart = by_instrument(source, differences)
    lengths = None if apart is None else main_distances(apart)
    return _length(source, differences) if lengths is None else lengths.ravel()


def pose_distances(source: Source, differences: Mapping[str, Array]) -> Array:
    """(N,) the same of each pose: root mean square over the instruments that read it."""
    apart = by_instrument(source, differences)
    lengths = None if apart is None else by_pose(apart)
    return _length(source, differences) if lengths is None else lengths


def by_camera(source: Source, differences: Mapping[str, Array]) -> dict[str, Array]:
    """By instrument, (N,) rms distances of an image [px]."""
    apart = by_instrument(source, differences) or ()
    return {one.seen.instrument: one.position for one in apart if one.position is not None}


def by_instrument(source: Source, differences: Mapping[str, Array]) -> Sequence[Apart] | None:
    """Distances of each pose by instrument; None where these are no differences of its machine."""
    if source.mechanism is None or tuple(differences) != source.mechanism.compared:
        return None
    rows = np.array([*differences.values()])
    lost = np.full(rows.shape[1], np.nan)
    measured = np.array([source.table.readings.get(name, lost) for name in differences])
    return deviations(source.mechanism, measured, rows)


def _length(source: Source, differences: Mapping[str, Array]) -> Array:
    unit = source.document.accuracy and source.document.accuracy.unit
    alike = [d for name, d in differences.items() if _unit(source, name) in (None, unit)]
    lengths: Array = np.linalg.norm(np.array(alike), axis=0)
    return lengths


def _machine(source: Source, points: Array) -> Machine | None:
    """The machine in the pose whose measured point lies nearest to the middle of all."""
    if source.mechanism is None:
        return None
    # The median, which a lost point far away does not move.
    middle = np.nanmedian(points, axis=1, keepdims=True)
    away = np.square(points - middle).sum(axis=0)
    # Of a tree of bodies the joints say all; what looks at it may be blank in any pose.
    names = tuple(source.mechanism.joints) or source.document.data.quantities
    columns = {q: source.table.readings[q] for q in names if q in source.table.readings}
    readings = {q: v for q, v in columns.items() if np.isfinite(v).any()}
    # 0 * NaN is NaN: poses that lack a reading drop out.
    away = away + sum(0.0 * values for values in readings.values())
    if not np.isfinite(away).any():
        return None
    pose = int(np.nanargmin(away))
    try:
        lines = skeleton(source.mechanism, {q: float(v[pose]) for q, v in readings.items()})
    except KeyError:
        return None  # a joint that was never read
    return None if lines is None else Machine(lines, skeleton_labels(source.mechanism))


def _parameters(document: ResultDocument) -> Figure | None:
    entries = [p for p in shown_parameters(document.parameters, document.terms) if not p.fixed]
    groups = []
    for unit in dict.fromkeys(p.unit for p in entries):
        group = [p for p in entries if p.unit == unit]
        off = np.array([p.value - p.nominal for p in group]) / factor(unit)
        sds = np.array([p.sd for p in group], dtype=float) / factor(unit)
        groups.append(Change(unit_shown(unit), [p.name for p in group], off, sds))
    return changes(groups)


def _correlations(document: ResultDocument) -> Figure | None:
    covariance = document.covariance
    shown = {p.name for p in shown_parameters(document.parameters, document.terms)}
    kept = [i for i, name in enumerate(covariance.names) if name in shown]
    matrix = np.array(covariance.matrix, dtype=float).reshape((len(covariance.names),) * 2)
    return correlations(matrix[np.ix_(kept, kept)], [covariance.names[i] for i in kept])

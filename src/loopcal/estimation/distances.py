"""How far computed outputs are from measured ones, whatever form the instrument reads them in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.mechanisms.mechanism import Family, Mechanism

Array = NDArray[np.float64]
POLAR = ("spherical", "polar")
"""Forms of readings that are a distance and one or two angles."""


@dataclass(frozen=True)
class Distances:
    """values: (i, N) distances [unit] by instrument and pose, NaN where one of the two is missing.

    unit: m where any output tells of lengths; instruments that read angles alone then do not
    count.
    """

    values: Array
    unit: str

    @property
    def by_pose(self) -> Array:
        """(N,) root mean square over the instruments that read the pose."""
        there = np.isfinite(self.values)
        squares = np.where(there, np.square(self.values), 0.0).sum(axis=0)
        count = there.sum(axis=0)
        return np.where(count > 0, np.sqrt(squares / np.maximum(count, 1)), np.nan)


def distances(mechanism: Mechanism, measured: Array, differences: Array) -> Distances | None:
    """From measured outputs (o, N) [SI] and computed minus measured ones; None without outputs.

    Coordinates of one point make one distance, and so do range, azimuth and elevation, whose
    points are compared. Outputs of an own loop count together where they share a unit.
    """
    rows: list[Array] = []
    units: list[str] = []
    for outputs, form in _groups(mechanism):
        index = [mechanism.outputs.index(q) for q in outputs]
        its = {mechanism.quantities[q] for q in outputs}
        if form in POLAR:
            at = measured[index]
            gap = cartesian(at + differences[index]) - cartesian(at)
            its = {"m"}
        else:
            gap = differences[index]
        if len(its) == 1:
            rows.append(np.sqrt(np.square(gap).sum(axis=0)))
            units.append(its.pop())
    if not rows:
        return None
    unit = "m" if "m" in units else units[0]
    return Distances(np.array([r for r, u in zip(rows, units, strict=True) if u == unit]), unit)


def cartesian(readings: Array) -> Array:
    """x, y, z (3, N) of range, azimuth and elevation (3, N), the azimuth from x towards y.

    In a plane x, y (2, N) of range and azimuth.
    """
    distance, azimuth = readings[:2]
    if len(readings) == 2:
        return np.array([distance * np.cos(azimuth), distance * np.sin(azimuth)])
    level = distance * np.cos(readings[2])
    height = distance * np.sin(readings[2])
    return np.array([level * np.cos(azimuth), level * np.sin(azimuth), height])


def point_outputs(mechanism: Mechanism, family: Family) -> tuple[str, ...]:
    """The outputs of a family that say where a point is; none where they do not."""
    if family.form not in ("point", "pose", *POLAR):
        return ()
    its = [q for q in family.readings if q in mechanism.outputs]
    if family.form == "pose":
        its = [q for q in its if mechanism.quantities[q] == "m"]
    return tuple(its)


def measured_points(mechanism: Mechanism) -> list[tuple[str, ...]]:
    """The outputs of each point that is measured; of an own loop, all that are lengths."""
    if mechanism.families:
        return [point_outputs(mechanism, family) for family in mechanism.families]
    return [tuple(q for q in mechanism.outputs if mechanism.quantities[q] == "m")]


def points(family: Family, readings: Array) -> Array:
    """Cartesian points (d, N) of readings (r, N) of the outputs that say where a point is."""
    return cartesian(readings) if family.form in POLAR else readings


def _groups(mechanism: Mechanism) -> list[tuple[tuple[str, ...], str]]:
    """Outputs that are read together, and how."""
    if not mechanism.families:
        return [(mechanism.outputs, "plain")] if mechanism.outputs else []
    read = [
        (
            point_outputs(mechanism, family)
            or tuple(q for q in family.readings if q in mechanism.outputs),
            family.form,
        )
        for family in mechanism.families
    ]
    return [(outputs, form) for outputs, form in read if outputs]

"""The errors of the poses by name, each in its unit."""

from __future__ import annotations

from collections.abc import Mapping

from loopcal.arrays import Array
from loopcal.presentation.shown import factor, unit_shown
from loopcal.report.drawn import by_instrument, pose_distances
from loopcal.report.source import Source

SIZE = "distance"
"""The error of a pose as one number: the length of its differences."""
TURN = "{instrument}: turn"
"""The rotation from the measured to the computed orientation, of one instrument."""


def errors_by_name(
    source: Source, differences: Mapping[str, Array], unit: str
) -> tuple[dict[str, Array], dict[str, str]]:
    """Name -> (N,) errors, and their units: the size of all, that of each instrument where there
    are several or where it turns too, and each output but the corners of images and lone gaps.

    unit: of the size [SI].
    """
    instruments = by_instrument(source, differences) or ()
    # Corners of images are too many, and a gap is the distance of its instrument already.
    counted = {
        q
        for one in instruments
        for q in one.seen.position
        if one.seen.image or (len(instruments) > 1 and len(one.seen.position) == 1)
    }
    si = {SIZE: unit}
    shown = {SIZE: pose_distances(source, differences)}
    for one in instruments:
        name = one.seen.instrument
        if one.position is not None and len(instruments) > 1:
            si.setdefault(name, one.seen.unit)
            shown.setdefault(name, one.position)
        if one.position is not None and one.angle is not None:
            turn = TURN.format(instrument=name)
            si[turn], shown[turn] = "rad", one.angle
    quantities = {} if source.document.mechanism is None else source.document.mechanism.quantities
    for name, values in differences.items():
        if quantities.get(name) == unit and name not in counted:
            si.setdefault(name, unit)
            shown.setdefault(name, values)
    scaled = {name: values / factor(si[name]) for name, values in shown.items()}
    return scaled, {name: unit_shown(one) for name, one in si.items()}

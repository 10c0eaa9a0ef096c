"""Rows of the catalogue on parameters that end far from what was stated of them."""

from __future__ import annotations

from functools import partial

from loopcal.document.verdict import Row

_not_sound = partial(Row, "sound", "refuse")
_CHECK = "loopcal check {project}"
# The order counts, as in the catalogue.
OFF_THE_DRAWING = (
    _not_sound(
        "far-from-nominal",
        "{place.parameters} ended {off} away from its nominal value, {nominal}: no machine is so "
        "far from its drawing.",
        "Check units and columns. State priors from the drawing, or measure other poses.",
        _CHECK,
    ),
    _not_sound(
        "lengths-shrank",
        "The estimated lengths shrank to {share:2} of the nominal ones.",
        "Check units and columns. State priors from the drawing, or measure other poses.",
        _CHECK,
        shared="far-from-nominal",
    ),
    _not_sound(
        "prior-tension",
        "{place.parameters} is {off} off its nominal value, which was known to {prior_sd} "
        "({sds:2} sds).",
        "Check units, signs and joint directions of the columns, and the drawing.",
        _CHECK,
    ),
    _not_sound(
        "gravity-elsewhere",
        "The arm gives way as if gravity pulled {off} off its direction, which is known to {usual} "
        "({sds:2} sds): the robot may stand on a wall, a slope or a gantry.",
        "State in [mechanism] where gravity pulls in the robot's base, such as gravity = [1, 0, 0] "
        "on a wall. If the robot stands upright, check units and signs of the joints.",
        _CHECK,
    ),
)

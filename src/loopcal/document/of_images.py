"""Rows of the catalogue on readings and poses of one moment, on images and on lenses."""

from __future__ import annotations

from functools import partial

from loopcal.document.verdict import Row

_not_sound = partial(Row, "sound", "refuse")
_CHECK, _REPORT = "loopcal check {project}", "loopcal report {result}"
MOMENT = "Read each pose while the machine stands, at the moment of its image or reading."
# The order counts, as in the catalogue.
OF_IMAGES = (
    _not_sound(
        "poses-delayed",
        "{delay} (sd {spread} %).",
        MOMENT,
        _CHECK,
        detail="Machine and instrument were not read at the same moment, or the machine did not "
        "stand.",
    ),
    Row(
        "sound",
        "caution",
        "images-contradict",
        "The images contradict the machine: they are {misfit:2} (rms) off what it says, in "
        "{camera}.",
        f"Look at the images with the largest residuals. {MOMENT}",
        _REPORT,
        detail="An industrial arm is off by a fifth of that before it is calibrated. Unless yours "
        "is that loose, something else is wrong.",
    ),
    _not_sound(
        "halves-disagree",
        "Two halves of the images, fitted apart, disagree: {place.parameters} is {first} by one "
        "and {second} by the other, {sds:2} sds apart.",
        "Measure the board, free what is held of lens and print, and take images at several "
        "distances and tilts.",
        _REPORT,
    ),
)

"""Rows of the catalogue on readings of one moment or of one pose, on images and on lenses."""

from __future__ import annotations

from functools import partial

from loopcal.document.verdict import Row

_not_sound = partial(Row, "sound", "refuse")
_sound_open = partial(Row, "sound", "caution")
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
    Row(
        "sound",
        "caution",
        "focal-length-unsure",
        "The images hardly show the focal length: {place.parameters} is {f} ± {sd:2}. Distances "
        "from the camera are as unsure.",
        "Tilt the board by 20 to 45 deg, or take images at half and at twice the distance.",
        _REPORT,
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
LENS_LEAVES = Row(
    "sound",
    "info",
    "lens-leaves-error",
    "The lens model leaves a smooth error of {rms:2} (rms) over the image of {camera}, alike in "
    "all images: -2 log likelihood is lower by {gain:3} with it. The stated sds allow for it.",
    detail="To know focal length and principal point better, remove a cover before the lens or "
    "state another lens model.",
)
SCALE_BY_ONE = Row(
    "sound",
    "info",
    "scale-decided",
    "Images show no lengths: the {decides} decides how long everything is. {place.parameters} is "
    "{size} % ± {sd} % if the {decides} is as stated. If the {other} is, the {decides} is stated "
    "{percent} % too {way}, and the images fit alike. The two are {sds:2} sds of both apart.",
    detail="Measure the print, and state its size with the sd of your measurement (prior of "
    "{place.names}).",
)
IN_IMAGES = (
    Row(
        "valid",
        "info",
        "valid-in-image",
        "Valid where corners were seen in the image: {rms_in_regions:3} rms in image regions not "
        "used, {rms:3} on images not used.",
        title="Valid where corners were seen.",
    ),
    Row(
        "valid",
        "caution",
        "in-image-if-sound",
        "Where corners were seen in the image errors are {rms_in_regions:3} rms in regions not "
        "used, {rms:3} on images not used. This leaves out what is not sound.",
        "Mend what is not sound first.",
        _CHECK,
        shared="valid-if-sound",
    ),
    Row(
        "valid",
        "refuse",
        "image-covered-in-part",
        "The lens is not known where no corner was seen: {rms_in_regions:3} rms in image regions "
        "not used instead of {rms:3} on images not used.",
        "Take images with the board in all parts of the image, most of all near its corners.",
        _REPORT,
    ),
    Row(
        "valid",
        "caution",
        "image-untested",
        "No region of the image was left out to test the lens there.",
        "Validate on other images (--folds 10), of which there are ten or more.",
        "loopcal calibrate {project} --folds 10",
    ),
)
SHARED_ERRORS = (
    _sound_open(
        "errors-shared",
        "The targets share errors, which the stated regions take as independent: their residuals "
        "in one pose are correlated by {correlation:2}.",
        "State the sds of the joints and of the instruments. The fit then knows what they share.",
        _CHECK,
    ),
    _sound_open(
        "repeats-share-error",
        "Repeats of a pose share an error: they scatter {ratio:2} times less than different poses "
        "({p_value:p}). This method counts each row as independent, so its sds are too small.",
        "Calibrate by the default method, which counts such repeats once, or average them.",
        "loopcal calibrate {project} --method auto",
        title="Repeats of a pose share an error.",
    ),
)

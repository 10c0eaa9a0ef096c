"""Rows of the catalogue on another day: is the machine consistent with its calibration?"""

from __future__ import annotations

from functools import partial

from loopcal.document.of_images import MOMENT
from loopcal.document.verdict import Row

_VERIFY = "loopcal verify {result} {readings}"
_PAGE, _PLAN = f"{_VERIFY} --out verification.html", "loopcal plan {project}"
_UPDATE = "loopcal update {result} {readings}"
_REPORT = "loopcal report {result}"
_NOT_AS_CALIBRATED = "The machine is not as calibrated: {changes}."
_not_consistent = partial(Row, "consistent", "refuse")
_consistent_open = partial(Row, "consistent", "caution")
_consistent = partial(Row, "consistent", "info")
# The order counts, as in the catalogue.
ANOTHER_DAY = (
    _not_consistent(
        "day-at-fault",
        "The file is at fault: {faults}.",
        "Correct the file, then verify again.",
        _VERIFY,
        shared="column-fault",
    ),
    _not_consistent(
        "moved-in-run",
        "Something moved along this run{what}.",
        "Check what moved, then measure and verify again.",
        _VERIFY,
        detail="{details}",
        shared="change-points",
    ),
    _consistent_open(
        "no-redundancy",
        "These poses only determine what was placed anew.",
        "Measure more poses.",
        _PLAN,
    ),
    _consistent("unchanged", "The machine is as calibrated: {statistic}."),
    _consistent_open(
        "drift-or-change",
        "The instrument drifted, or the machine changed: {changes}.",
        "Measure the poses in random order: a drift is then no change of the machine.",
        _PLAN,
        detail="The joints follow the order of these poses, so a drift of the instrument along the "
        "run looks the same.",
        shared="drift-or-model",
    ),
    _not_consistent(
        "more-changed",
        "The machine is not as calibrated: more than {place.parameters} changed, as on another "
        "machine of this type.",
        "Check that these readings are of the machine that was calibrated. If they are, inspect "
        "the worst poses and calibrate anew.",
        _PAGE,
        shared="changed",
    ),
    _not_consistent(
        "re-master",
        _NOT_AS_CALIBRATED,
        "Re-master {joints}, or update the calibration with these poses. Then verify again.",
        _UPDATE,
    ),
    _not_consistent(
        "re-master-slides",
        "The machine is not as calibrated: a spindle, column or leg grew, or {changes}.",
        "Verify at the temperature of the calibration: a spindle, column or leg that grew looks "
        "the same. If it stays, re-master {joints}, or update the calibration with these poses.",
        _VERIFY,
        shared="re-master",
    ),
    _not_consistent(
        "re-master-first",
        _NOT_AS_CALIBRATED,
        "The zero of {joints} explains these poses about as well: re-master it, then verify again. "
        "If the machine is still not as calibrated, calibrate anew.",
        _VERIFY,
        shared="re-master",
    ),
    _not_consistent(
        "conditions-first",
        _NOT_AS_CALIBRATED,
        "Verify with the load and at the temperature of the calibration first: they explain these "
        "poses about as well. If the machine is still not as calibrated, calibrate anew.",
        _VERIFY,
        shared="changed",
    ),
    _not_consistent(
        "mounting-changed",
        _NOT_AS_CALIBRATED,
        "If it was mounted anew, state it (--remounted). Otherwise inspect the mounting, or "
        "calibrate anew.",
        f"{_VERIFY} --remounted",
        shared="changed",
    ),
    _not_consistent(
        "camera-moved",
        _NOT_AS_CALIBRATED,
        "If it was placed anew, state it (--anew {camera}). Otherwise inspect its support, or "
        "calibrate anew.",
        f"{_VERIFY} --anew {{camera}}",
        shared="changed",
    ),
    _not_consistent(
        "camera-exchanged",
        "The machine is not as calibrated: {camera} is another camera, or its lens or resolution "
        "was changed: {changes}.",
        "Check which camera took the images, its lens, its resolution and its focus. Then "
        "calibrate anew.",
        _PAGE,
        shared="changed",
    ),
    _not_consistent(
        "machine-changed",
        _NOT_AS_CALIBRATED,
        "Inspect the worst poses. Calibrate anew.",
        _PAGE,
        shared="changed",
    ),
    _not_consistent(
        "changed",
        _NOT_AS_CALIBRATED,
        "Inspect the worst poses. If the reflector or the board was mounted anew, state it "
        "(--remounted). Otherwise calibrate anew.",
        f"{_VERIFY} --remounted",
    ),
    _not_consistent(
        "images-changed",
        _NOT_AS_CALIBRATED,
        "Check the focus of the lens, and whether the board is the same print. Then calibrate "
        "anew, or update the calibration with these images.",
        _UPDATE,
        shared="changed",
    ),
    _not_consistent(
        "pixels-counted",
        _NOT_AS_CALIBRATED,
        "Check how this file counts pixels: half a pixel each way lies between files where the "
        "centre of the first pixel is 0 and files where it is 0.5. If it is the same as before, "
        "check the focus of the lens.",
        _VERIFY,
        shared="changed",
    ),
    _not_consistent(
        "day-delayed",
        "Poses and readings of this day are not of one moment: {changes}.",
        f"{MOMENT} Then verify again.",
        _VERIFY,
        shared="poses-delayed",
    ),
    _not_consistent(
        "load-changed",
        _NOT_AS_CALIBRATED,
        "Verify with the load of the calibration, or calibrate with this load.",
        _VERIFY,
        shared="changed",
    ),
    _not_consistent(
        "expansion-changed",
        _NOT_AS_CALIBRATED,
        "Let machine and instrument reach the temperature of the calibration, then verify again.",
        _VERIFY,
        detail="Another scale of the instrument looks the same.",
        shared="changed",
    ),
    _not_consistent(
        "slide-changed",
        _NOT_AS_CALIBRATED,
        "Let the slide reach the temperature of the calibration, then verify again. If it stays, "
        "check its pitch or counts in the controller, or calibrate anew.",
        _VERIFY,
        shared="changed",
    ),
    Row(
        "sound",
        "caution",
        "scale-since",
        "The scale of the machine or that of its instrument changed by {ppm:2} ppm "
        "(sd {sd:2} ppm) since the calibration: these poses do not show which.",
        "Check the instrument with a scale bar. If it is off, use the calibration as it was.",
        _REPORT,
        detail="That moves the points by {moves:2} (rms); the stated sds allow for either.",
    ),
    Row(
        "sound",
        "refuse",
        "update-mixed",
        "The update mixes two machines: its readings are not of the one that was calibrated.",
        "Read the warning on what differs. Calibrate anew, or update with other poses.",
        _REPORT,
    ),
    Row(
        "sound",
        "caution",
        "update-moved",
        "The update may follow what happened on one day alone: {words}",
        "Measure the poses in random order, and update with these.",
        _REPORT,
    ),
    _not_consistent(
        "errors-larger",
        "These poses err {times:2} times as much as the calibration states: {rms:3} rms instead of "
        "{expected:3}.",
        "Inspect the worst poses. Calibrate anew.",
        _PAGE,
    ),
    _not_consistent(
        "joints-scatter",
        "{what} scatter {times:2} times as much as the calibration states, in each pose anew"
        "{sizes}.",
        "Check that the machine stands still while a pose is measured, that joints and readings "
        "are of one moment, and that nothing is loose. Far from the poses of the calibration a "
        "machine may err more as well. Then measure and verify again.",
        _VERIFY,
        shared="errors-larger",
    ),
    _not_consistent(
        "readings-scatter",
        "{what} scatter {times:2} times as much as the calibration states{sizes}.",
        "Check the instrument and that its target is firm; of a camera the focus, the light and "
        "how corners are detected. Then measure and verify again.",
        _VERIFY,
        shared="errors-larger",
    ),
    _not_consistent(
        "misfit-larger",
        "An error that no change explains is {times:2} times as large as the calibration states.",
        "Inspect the worst poses. Calibrate anew.",
        _PAGE,
        shared="errors-larger",
    ),
    _consistent_open(
        "moved-or-machine",
        "Something may have moved along this run{what}.",
        "Measure the poses in random order: a drift is then no error of the machine.",
        _PLAN,
        detail="{details} An error of the machine along these poses looks the same.",
        shared="drift-or-model",
    ),
    _consistent_open(
        "calibration-not-sound",
        "The calibration itself is not sound, which these poses cannot mend: {why}",
        "Mend what the calibration says first. Then verify again.",
        "loopcal calibrate {project}",
    ),
    _consistent(
        "calibration-open",
        "The calibration itself leaves open: {why}",
    ),
    _consistent_open(
        "poses-unlike",
        "{count} not fit the others ({named}); accuracies leave {them} out.",
        "Inspect these poses; measure them again or exclude them, then verify again.",
        _VERIFY,
        shared="outliers",
    ),
    _consistent_open(
        "day-copied",
        "{copied} rows copy others; they were left out.",
        "Check how the file was made; delete the copies.",
        _VERIFY,
        shared="rows-copied",
    ),
    _consistent_open(
        "own-poses",
        "{repeated} of these poses are those of the calibration itself, which they cannot test.",
        "Measure other poses.",
        _PLAN,
    ),
    Row(
        "better",
        "caution",
        "accuracy-of-faulty-file",
        "The accuracy is unknown: the file is at fault.",
        "Correct the file, then verify again.",
        _VERIFY,
        shared="unknown-accuracy",
    ),
)


# Rows of the catalogue on two calibrations: are their machines the same?


_remark = partial(Row, None, "info")
# The order counts, as in the catalogue.
TWO_MACHINES = (
    _consistent_open(
        "nothing-common",
        "Both calibrations determine nothing that could differ.",
        "Measure both in the same region, or learn the model error of both.",
        shared="undecided",
    ),
    _consistent_open(
        "undecided",
        "Undecided: the two machines differ by more than noise explains ({where}{p_value:p}), "
        "but they were measured in different regions, where an unmodelled error differs too.",
        "Measure both in the same region, or learn the model error of both "
        '(model_error = "structured").',
    ),
    _consistent(
        "machines-agree",
        "The two machines agree within their stated uncertainty: {where}{p_value:p}.",
    ),
    _not_consistent(
        "machines-differ",
        "The two machines differ by more than their stated uncertainty explains: "
        "{where}{p_value:p}.",
        detail="{blame}",
    ),
    _remark(
        "poses-scatter",
        "The poses scatter {times:2} times as much as their sds allow along what is compared: the "
        "machine model lacks something.",
        detail="The sds of the differences are those of this scatter.",
    ),
    _remark(
        "not-aligned",
        "The parameters are compared without alignment: differences include any move of the "
        "instrument in between.",
    ),
    _remark(
        "same-readings",
        "Both come from the same readings and share their errors: the sds of the differences, "
        "computed as if independent, are too large and p is too close to 1.",
    ),
    _remark(
        "sds-rejected",
        "Chi-squared rejects the sds of {place.files} itself: they count {times:2} times as large "
        "here, as its residuals are.",
    ),
)

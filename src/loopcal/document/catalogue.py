"""The catalogue: a row for each fact, with the question it answers, its severity and its words.

Braces in a sentence name numbers (with a form, as of `Figure`), texts or the place of the fact; in
a command they name texts or files: project, result, readings. Of findings of one severity the row
that stands first is the gravest.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import partial

from loopcal.document.another_day import ANOTHER_DAY, TWO_MACHINES
from loopcal.document.of_images import (
    IN_IMAGES,
    LENS_LEAVES,
    OF_IMAGES,
    SCALE_BY_ONE,
    SHARED_ERRORS,
)
from loopcal.document.off_the_drawing import OFF_THE_DRAWING
from loopcal.document.verdict import SEVERITIES, Fact, Finding, Named, Row

_AGAIN, _CHECK = "loopcal calibrate {project}", "loopcal check {project}"
_FOLDS, _AUTO = f"{_AGAIN} --folds 10", f"{_AGAIN} --method auto"
_PLAN, _REPORT = "loopcal plan {project} --existing {result}", "loopcal report {result}"
_MODEL = "Check the sds of the sensors. If they are right, allow for a model error."
_ALL_OVER = "Measure poses all over the region"
_WITHIN = (
    "95 % of poses {where} are within {error:3} (guard band {low:3} to {high:3}); "
    "the tolerance is {tolerance:3}."
)
_SCALE = "The scale of {subject} differs by {ppm:2} ppm (sd {sd:2} ppm) from that of {other}"
_AT_BOTH = "Check temperature, pressure and units of the instrument at both stations."
_MOVES = "That moves the points by {moves:2} (rms)."
_INSTEAD = "{rms:3} rms on poses not used instead of {rival_rms:3} (sd of the difference {sd:2})."
_PAIRED = "{rms:3} rms instead of {nominal_rms:3} (difference {difference:3}, sd {sd:2})."
_not_sound = partial(Row, "sound", "refuse")
_sound_open = partial(Row, "sound", "caution")
_sound = partial(Row, "sound", "info")
_not_valid = partial(Row, "valid", "refuse")
_valid_open = partial(Row, "valid", "caution")
_valid = partial(Row, "valid", "info")
_not_better = partial(Row, "better", "refuse")
_better_open = partial(Row, "better", "caution")
_better = partial(Row, "better", "info")
_not_within = partial(Row, "tolerance", "refuse")
_within_open = partial(Row, "tolerance", "caution")
_within = partial(Row, "tolerance", "info")
# The order counts: of findings as grave as each other the first is the headline.
_ROWS = (
    _not_sound(
        "column-fault",
        "The file is at fault: {faults}.",
        "Correct the file, or its columns in the project, and calibrate again.",
        _CHECK,
    ),
    _not_sound(
        "not-converged",
        "The fit did not converge ({reason}).",
        "Follow the advice of the message.",
        _CHECK,
        detail="{message}",
    ),
    *OFF_THE_DRAWING,
    *OF_IMAGES,
    _not_sound(
        "change-points",
        "Something moved along the run{what}.",
        "Add the effects that change_points of result.json lists, or measure again.",
        _REPORT,
        detail="{details}",
    ),
    _not_sound(
        "sds-too-small",
        "The corrections are larger than the stated sds allow: chi-squared per degree of freedom "
        "is {variance_factor:2} ({p_value:p}).",
        _MODEL,
        _AUTO,
        detail="{suspects}",
    ),
    _not_sound(
        "model-incomplete",
        "The machine model lacks a term: {shared_variance:1%} of the variance of the residuals of "
        "{instrument} is common to poses that are near in joint space ({p_value:p}).",
        "Add effects (sag, gears), or fit with a structured model error.",
        _AUTO,
    ),
    _not_sound(
        "learnt-terms-incomplete",
        "Learnt terms do not follow the error: {shared_variance:1%} of the variance of the "
        "residuals of {instrument} is common to poses that are near in joint space ({p_value:p}).",
        "Check the instrument: a lens or a board that is not as stated looks the same as the "
        "machine. Then measure more poses.",
        _PLAN,
        shared="model-incomplete",
    ),
    _not_sound(
        "plain-model-wrong",
        "The model without {term} is wrong: {meaning} (-2 log likelihood lower by {gain:2}).",
        "Measure more poses, all over the region, and fit with a structured model error.",
        _PLAN,
    ),
    _not_sound(
        "regions-too-small",
        "Stated {level} regions hold only {share_held:0%} of the poses not used.",
        _MODEL,
        _AUTO,
    ),
    _not_sound(
        "sds-too-large",
        "The readings scatter less than the stated sds: chi-squared per degree of freedom is "
        "{variance_factor:2}.",
        "Check the units of the sds, state smaller ones, or estimate them.",
        _CHECK,
    ),
    _sound_open(
        "changes-modelled",
        "The fit models {subject} along the run{what}.",
        "Check what happened during the run, or measure again. To state the changes yourself, copy "
        "the lines toml of change_points in result.json into the project.",
        _REPORT,
        detail="{details} {hold}",
    ),
    _sound_open(
        "drift-modelled",
        "The fit models a drift of the instrument along the run.",
        "Check what happened during the run, or measure again.",
        _REPORT,
        detail="{details}. Predictions hold for the middle of the run.",
    ),
    _sound_open(
        "changes-small",
        "Something moved a little along the run{what}.",
        "Predictions hold as stated. To be sure, add the effects that change_points lists.",
        _REPORT,
        detail="{details} That moves the end point by {predicted_sds:2} of its predicted sd.",
    ),
    _sound_open(
        "model-lacks-little",
        "The machine model lacks a little: {shared_variance:1%} of the variance of the residuals "
        "of {instrument} is common to poses that are near in joint space ({p_value:p}).",
        "Predictions hold nearly as stated. To predict better, measure more poses or add effects.",
        _PLAN,
    ),
    _sound_open(
        "sds-generous",
        "The readings scatter less than the stated sds: chi-squared per degree of freedom is "
        "{variance_factor:2}.",
        "State smaller sds, or estimate them.",
        _AUTO,
    ),
    _sound_open(
        "observations-conflict",
        "{instrument} contradicts the other observations by {apart:2} rms: its readings miss by "
        "{beside:2} beside them, by {alone:2} by themselves ({p_value:p}).",
        "Check what it assumes: a body, a radius, a plane. Then calibrate without it, and compare.",
        _REPORT,
    ),
    _sound_open(
        "serial-dependence",
        "Residuals of {instrument} depend on the pose order (correlation {correlation:2}).",
        "Look for shifts, or measure in random order.",
        _REPORT,
        detail="The stated sds allow for a drift.",
    ),
    _sound_open(
        "drift-or-model",
        "The instrument may drift: without a smooth model error residuals depend on the pose order "
        "(correlation {evidence:2}).",
        "Measure the poses in random order: a drift is then no model error.",
        "loopcal plan {project}",
        detail="Along a path these two cannot be distinguished.",
    ),
    _sound_open(
        "change-or-model",
        "Something may have changed along the run{what} ({evidence:p}).",
        "Measure the poses in random order: a drift is then no model error.",
        "loopcal plan {project}",
        detail="A slow drift or an error of the machine model explains it as well.",
        shared="drift-or-model",
    ),
    _sound_open(
        "drift-or-machine",
        "Drift or machine: the joints show the order of the poses, and a drift of the instrument "
        "is uncertain by {sd:2} (sd, rms over the run), beside a stated sd of {stated:2}. The "
        "readings {suggest} one.",
        "Measure some poses again at the end, or all in random order.",
        "loopcal plan {project}",
        detail="The stated sds allow for it.",
    ),
    _sound_open(
        "order-by-joints",
        "The joints predict {r_squared:0%} of the pose order: a drift looks like a machine error.",
        "Measure the poses in random order, or repeat some at start, middle and end.",
        "loopcal plan {project}",
    ),
    *SHARED_ERRORS,
    _sound_open(
        "overfitted",
        "Poses not used are predicted much worse than those used ({ratio:2} times the rms).",
        "Measure more poses, or estimate fewer parameters.",
        _PLAN,
    ),
    _sound_open(
        "white-model-error",
        "Besides the sensors, the machine model has an error with an sd of {sd:3}, taken as "
        "independent from pose to pose.",
        "Check for missing effects (compliance, eccentric gears, drift).",
        _AUTO,
    ),
    _sound_open(
        "off-the-drawing",
        "{place.parameters} is off the drawing by {difference:3}; the other {kind} are within "
        "{usual} (rms).",
        "Check this dimension in the drawing, its unit and its sign.",
        _CHECK,
    ),
    _sound_open(
        "another-drawing",
        "The {kind} are off the drawing by {difference:2} (rms): this may be the drawing of "
        "another machine.",
        "Check this dimension in the drawing, its unit and its sign.",
        _CHECK,
        shared="off-the-drawing",
    ),
    _sound_open(
        "mounting-off",
        "{place.parameters} is off the drawing by {difference:3}; what is mounted is usually "
        "within {usual} (sd).",
        "Check this dimension in the drawing, its unit and its sign.",
        _CHECK,
        shared="off-the-drawing",
    ),
    _sound_open("scales-unlike", f"{_SCALE}.", _AT_BOTH, _REPORT, detail=_MOVES),
    _sound_open(
        "scales-modelled",
        f"{_SCALE}; in this fit each station has a scale.",
        _AT_BOTH,
        _REPORT,
        detail="Without these the points would move by {moves:2} (rms).",
    ),
    _sound_open(
        "scale-off-the-drawing",
        f"{_SCALE}.",
        "Check the temperature of the machine, the certificate of the instrument, and the drawing.",
        _REPORT,
        detail=_MOVES,
    ),
    _sound_open(
        "range-zero",
        "{subject} reads distances {zero:2} (sd {sd:2}) too {which}, as by a wrong prism constant.",
        "Correct it in the readings, or add the effect range-zeros, and calibrate again.",
        detail=_MOVES,
    ),
    _sound_open(
        "joint-scale",
        "{subject} turns {percent:2} % (sd {sd:2} %) {which} than read, as by another gear ratio.",
        "Check the ratio, or add the effect scale, and calibrate again.",
        detail="That is {turned:2} (rms) in the measured poses.",
    ),
    _sound_open(
        "sds-contradicted",
        "{contradicted}.",
        "Check the units of the stated sds, or leave them out.",
        _CHECK,
        detail="So no fit used the stated sds.",
        shared="sds-overruled",
    ),
    _sound_open(
        "sds-overruled",
        "The stated sds were not used, because they are about {times} times too {size}: with them "
        "chi-squared per degree of freedom is {variance_factor:2}.",
        "Check the units of the stated sds, or leave them out.",
        _CHECK,
    ),
    _sound_open(
        "outliers",
        "{count} not fit the others ({named}).",
        "Inspect these poses; correct or exclude them.",
        _REPORT,
    ),
    _sound_open(
        "outliers-many",
        "{count} not fit the others ({named}), of {every} in all.",
        "So many are seldom mistakes. Find what they share, such as another form of the arm, a "
        "region or a time, before you exclude any.",
        _REPORT,
        shared="outliers",
    ),
    _sound_open(
        "rows-copied", "{copied}", "Check how the file was made; delete the copies.", _CHECK
    ),
    _sound_open(
        "size-unsure",
        "Priors alone say how large the machine is, to {share}: these readings hardly "
        "determine it, and noise makes such a fit too small.",
        "State one length that was measured (bar, distance of seats, link) with its sd.",
        _CHECK,
    ),
    _sound_open(
        "readings-coarse",
        "Readings are recorded coarsely: {quantities}.",
        "Record more digits. Poses that repeat a coarse value repeat its error.",
        _CHECK,
    ),
    _sound_open(
        "sds-not-converged", "The learnt sds did not converge.", "State more of the sds.", _CHECK
    ),
    _sound_open(
        "sd-not-detectable",
        "The noise of {place.readings} is not detectable: its sd may be 0, or far above the "
        "learnt one.",
        "State its sd, or repeat readings of one pose.",
        _CHECK,
    ),
    _sound_open(
        "mounting-unstated",
        "The mounting on the body is not stated: {groups} are 0 with flat priors.",
        "State where target or reflector is mounted.",
        _CHECK,
    ),
    _sound_open("other-optimum", "{optimum}.", "State priors from the drawing.", _CHECK),
    _sound_open(
        "not-identifiable",
        "These poses do not determine {place.parameters}.",
        "Fix these parameters, give them a prior, or measure other poses.",
        _PLAN,
    ),
    _sound_open(
        "sds-unstated",
        "Least squares states no sds of sensors, so nothing tests them.",
        "State or estimate the sds of the sensors.",
        _FOLDS,
        shared="untested",
    ),
    _sound_open(
        "untested",
        "There are no more equations than parameters, so nothing tests the fit.",
        "State or estimate the sds of the sensors.",
        _PLAN,
    ),
    _sound("sound", "The fit converged; sensors, poses and machine model are consistent."),
    LENS_LEAVES,
    SCALE_BY_ONE,
    _sound(
        "repeats-averaged",
        "{repeats} an earlier pose, with its error: each pose counts once, with the mean of its "
        "readings.",
    ),
    _sound("model-learnt", "The model has learnt: {effects}."),
    _sound(
        "scale-little-off",
        f"{_SCALE}, which moves points by {{moves:2}} (rms), less than half their predicted sd.",
    ),
    _sound(
        "sds-made-good",
        "The readings err {times:2} times as much as the stated sds allow, which a learnt error "
        "makes good: these sds are too small, or something changes from pose to pose.",
    ),
    _valid_open(
        "region-not-judged",
        "No region was judged: the sds of this fit mean nothing.",
        "Mend what is not sound first.",
        _CHECK,
        shared="region-unknown",
    ),
    _valid_open(
        "region-unknown",
        "Nothing says how far the machine works: its working region is unknown.",
        "State the region ([verdict] region).",
        _CHECK,
    ),
    *IN_IMAGES,
    _not_valid(
        "gaps-only",
        "Nothing but gaps was read: no reading says where the machine stands away from the touched "
        "places. Its size, all lengths alike, {size}.",
        "Add an instrument that measures points, or use it near the touched places only.",
        _CHECK,
        shared="near-poses-only",
    ),
    _valid_open(
        "valid-if-sound",
        "The predicted sd{seen} is {sd_in_region:2} in {where} and {sd_at_poses:2} at the measured "
        "poses. It leaves out what is not sound.",
        "Mend what is not sound first.",
        _CHECK,
    ),
    _not_valid(
        "direction-open",
        "The data leave a direction open that moves the end point{seen} in {where}.",
        f"{_ALL_OVER}.",
        _PLAN,
        shared="near-poses-only",
    ),
    _not_valid(
        "near-poses-only",
        "The predicted sd{seen} is {sd_in_region:2} in {where} and {sd_at_poses:2} at the measured "
        "poses.",
        f"{_ALL_OVER}, or state the region in which you work.",
        _PLAN,
    ),
    _valid_open(
        "error-follows-joint",
        "An error follows {joint}, of whose range {covered} % was measured: the machine model does "
        "not explain it; it is as if {parameter} changed with the joint. Beyond, errors may be "
        "larger than the predicted sd{seen}: {sd_in_region:2} in {where} and {sd_at_poses:2} at "
        "the measured poses.",
        "Check coupling, bearing or foundation of this joint. "
        f"{_ALL_OVER}, or state the region in which you work.",
        _PLAN,
        title="An error follows {joint}, of whose range {covered} % was measured.",
    ),
    _valid_open(
        "valid-while-parked",
        "The predicted sd{seen} is {sd_in_region:2} in the working region while {joints} stays as "
        "in all poses, and {sd_at_poses:2} at these; where {joints} moves, it is {moved}.",
        "Keep it there, or measure poses in which it moves.",
        _PLAN,
    ),
    _valid(
        "valid-in-region",
        "Valid: the predicted sd{seen} is {sd_in_region:2} in {where} and {sd_at_poses:2} at the "
        "measured poses.",
    ),
    _better_open(
        "no-outputs",
        "The accuracy is unknown: {reason}.",
        "Add an instrument that measures the end point.",
        _CHECK,
    ),
    _better_open(
        "fit-failed",
        "No other poses were predicted: the fit did not converge.",
        "Make the fit converge first.",
        _CHECK,
        shared="not-validated",
    ),
    _better_open(
        "not-validated",
        "No other poses were predicted.",
        "Validate on other poses (--folds 10).",
        _FOLDS,
        detail="Expect a larger error there.",
    ),
    _not_better(
        "worse",
        "Worse than {rival} on poses not used: {rms:3} rms instead of {rival_rms:3}.",
        "Use the better one, or measure more poses.",
        f"{_AGAIN} --method {{rival}}",
    ),
    _not_better(
        "worse-than-model",
        "Worse than {rival} on poses not used: {rms:3} rms instead of {rival_rms:3}.",
        "Use the better one, or measure more poses.",
        _AUTO,
        shared="worse",
    ),
    _not_better(
        "worse-than-drawing",
        "Worse than {rival} on poses not used: {rms:3} rms instead of {rival_rms:3}.",
        "Use the nominal machine, or measure more poses.",
        _PLAN,
        shared="worse",
    ),
    _better_open(
        "better-near-only",
        f"Better than {{rival}} near the measured poses only: {_INSTEAD}",
        f"{_ALL_OVER}, or use the result near these poses only.",
        _PLAN,
        detail="In regions not used it is worse: {blocked_rms:3} rms instead of "
        "{nominal_blocked_rms:3}.",
    ),
    _better("better", f"Better than {{rival}}: {_INSTEAD}", title="Better than {rival}."),
    _better(
        "nothing-stated",
        "Nothing was stated to compare with, of machine or lens: {rms:3} rms on poses not used.",
        title="Nothing was stated to compare with.",
    ),
    _better_open(
        "no-better",
        f"Not significantly better than {{rival}}: {_INSTEAD}",
        "Measure more poses to decide.",
        _PLAN,
    ),
    _within_open(
        "no-distances",
        "The accuracy is unknown: {reason}.",
        "Add an instrument that measures the end point.",
        _CHECK,
        shared="unknown-accuracy",
    ),
    _within_open(
        "tolerance-untested",
        "No pose was left out to test the tolerance.",
        "Validate on other poses (--folds 10).",
        _FOLDS,
        shared="unknown-accuracy",
    ),
    _within_open(
        "few-distances",
        "There are too few distances {where} for a decision.",
        "Measure more poses.",
        _PLAN,
        shared="unknown-accuracy",
    ),
    _not_within(
        "error-unbounded",
        "The error {where} is unbounded; the tolerance is {limit}.",
        f"{_ALL_OVER}.",
        _PLAN,
        shared="outside-tolerance",
    ),
    _within("within-tolerance", _WITHIN),
    _not_within(
        "outside-tolerance",
        _WITHIN,
        "Improve the model or the sensors, calibrate again, or widen the tolerance.",
        _REPORT,
    ),
    _within_open(
        "near-tolerance",
        _WITHIN,
        "Measure more poses: the tolerance lies within the guard band.",
        _PLAN,
    ),
    *ANOTHER_DAY,
    _better_open("nominal-not-placed", "The nominal machine cannot be placed: {reason}."),
    _better_open(
        "unknown-accuracy", "The accuracy is unknown: too few of these poses have measured outputs."
    ),
    _better_open(
        "like-nominal",
        "The calibrated machine does not predict these poses significantly better than the nominal "
        f"machine: {_PAIRED}",
        "Measure more poses to decide.",
        "loopcal plan {project}",
    ),
    _better(
        "better-than-nominal",
        f"The calibrated machine predicts these poses better than the nominal machine: {_PAIRED}",
    ),
    _not_better(
        "worse-than-nominal",
        f"The calibrated machine predicts these poses worse than the nominal machine: {_PAIRED}",
        "Do not use the calibration at poses like these. Calibrate with such poses.",
        "loopcal plan {project}",
    ),
    _not_valid(
        "poses-undetermined",
        "Neither these readings nor the prior determine {place.parameters}.",
        "Fix a parameter of each combination listed, state how well it is known ([prior]), or "
        "measure poses that distinguish it from the others.",
        "loopcal plan {project}",
    ),
    _valid_open(
        "poses-alike",
        "The condition number of these poses {size}, and poses are good up to {limit}: they are "
        "too alike, or too few quantities are read.",
        "Spread the joints over their whole ranges, above all the joints of the parameters listed; "
        "or state priors from the drawing ([prior]).",
        "loopcal plan {project}",
        detail="The fit will be valid near these poses only.",
        shared="poses-weak",
    ),
    _valid_open(
        "poses-few",
        "There are {share} loop equations per parameter, too few to check the fit against.",
        "Measure more poses.",
        "loopcal plan {project}",
        shared="poses-weak",
    ),
    _valid("poses-good", "These poses determine every parameter."),
    *TWO_MACHINES,
)
CATALOGUE: Mapping[str, Row] = {row.fact: row for row in _ROWS}
"""Code of a fact -> its row."""


def findings(
    facts: Iterable[Fact], files: Mapping[str, Named] = {}, labels: Mapping[str, str] = {}
) -> tuple[Finding, ...]:
    """The findings that facts lead to, the gravest first; files: for their commands; labels: what
    sentences call parameters."""
    order = {code: i for i, code in enumerate(CATALOGUE)}
    by_row = sorted(facts, key=lambda one: order[one.code])
    made = [CATALOGUE[one.code].finding(one, files, labels) for one in by_row]
    # Sorting is stable: within a severity the order of the rows stays.
    return tuple(sorted(made, key=lambda one: SEVERITIES.index(one.severity)))

"""What speaks for and against a result: facts of a calibration's document.

Each function states a fact where there is one to state; `SOUND` lists them all, but for those of
the readings (`judged_readings`). The catalogue says what each amounts to, and
docs/explanation/verdict.md describes every code.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from loopcal.document.accuracy import Coverage
from loopcal.document.change_points import ChangePoint, hold, when
from loopcal.document.choice import DECISIVE, TermEntry
from loopcal.document.findings import ConflictEntry, HalvesEntry, ScaleEntry
from loopcal.document.result_document import ResultDocument
from loopcal.document.verdict import Fact, Figure, Where, fact
from loopcal.mechanisms.effects.effect import RUN_DRIFTS, STATION_SCALES
from loopcal.mechanisms.structure.structured import GEOMETRY_TERMS
from loopcal.presentation.shown import percent, significant
from loopcal.small_samples import t_quantile
from loopcal.statistics.calibrated import rejected_by, residual_factor
from loopcal.statistics.judged_machine import far_from_nominal, off_the_drawing, prior_tension
from loopcal.statistics.judged_readings import (
    LOOSE,
    RARE,
    drift_or_machine,
    errors_beyond_sds,
    not_detectable,
    order_or_model,
    sds_overruled,
    size_unsure,
    suspects,
)

# Chosen, not derived: less is within what single regions differ by.
WORSE = 1.5
"""Rms on poses not used over rms on poses used that is called too large."""
# Record 0054; `analyses.small_changes` counts what the regions then hold.
SMALL = 0.5
"""Predicted sds by which changes may move the end point: 95 % regions then hold at least 90 %."""
# Half an sd beside one in quadrature: 0.25 / (1 + 0.25) = 0.2.
LEAST_SHARE = 0.2
"""The share of the variance that adds half an sd to errors, as in SMALL."""
# Three sds of a normal distribution, both sides.
APART = 0.0027
"""How rarely two halves of honest images may put a parameter so far apart."""
# As for the focal lengths of two halves.
_SCALES_APART = 3.0
"""Sds by which the scale of a print is another one than stated."""
# Chosen, not derived: lenses are sold with such tolerances.
LABEL = 0.05
"""Share of a focal length from which its sd is no better than what is printed on the lens."""
# Five times what poses of an arm are off whose lengths err by 0.5 mm, and zeros by 0.1 degrees.
CONTRADICT = 5e-3
"""Angle [rad] from where images see a board to where the machine says: a result is open."""
# Chosen, not derived: what fits a line.
_NAMED = 3
"""Change points that a finding names."""
# Chosen, not derived: what fits a line.
_MODELLED = 2
"""Learnt effects that a result names."""


def _not_converged(document: ResultDocument) -> Fact | None:
    status = document.status
    if status.converged:
        return None
    return fact("not-converged", reason=status.reason, message=status.message)


def _moved(document: ResultDocument) -> Fact | None:
    """Changes that are not modelled; small ones are significant beside nothing but the noise."""
    points = () if document.change_points is None else document.change_points.found
    points = tuple(point for point in points if not point.modelled)
    if all(point.imitated for point in points):  # `order_or_model`
        return None
    most = max(_beside(document, point) for point in points)
    if most < SMALL:
        return along_the_run("changes-small", points, predicted_sds=most)
    return along_the_run("change-points", points, changes=len(points))


def _beside(document: ResultDocument, point: ChangePoint) -> float:
    """By how many predicted sds, at the measured poses, a change moves the end point.

    The sds are as stated: what residuals add to them may be the change itself.
    """
    region = document.region
    stated = None if region is None else region.of(point.unit)
    if stated is None or point.moves is None or not stated.sd_at_poses:
        return math.inf
    rejected = rejected_by(document.chi_squared, document.variance_factor_applied)
    return point.moves * math.sqrt(residual_factor(rejected)) / stated.sd_at_poses


def _modelled_changes(document: ResultDocument) -> Fact | None:
    points = () if document.change_points is None else document.change_points.found
    points = tuple(point for point in points if point.modelled)
    if points:
        return along_the_run("changes-modelled", points, changes=len(points))
    drifts = [t for t in document.terms if t.name in RUN_DRIFTS and t.sentences]
    if not drifts:
        return None
    details = "; ".join(words for term in drifts for words in term.sentences)
    return fact("drift-modelled", details=details)


def along_the_run(code: str, points: Sequence[ChangePoint], **numbers: float) -> Fact:
    """The title says how often and when; the details name the first of many."""
    more = len(points) - _NAMED
    details = "; ".join(map(str, points[:_NAMED])) + (f"; and {more} more" if more > 0 else "")
    details = f"{details[0].upper()}{details[1:]}."
    subject, what = "changes", f" {when(points)}"
    if len(points) == 1:
        (one,) = points
        subject, what, details = "what changed", f": {one.what}", f"Size: {one.sizes}."
    place = Where(
        poses=tuple(dict.fromkeys(point.pose for point in points)),
        parameters=tuple(dict.fromkeys(name for point in points for name in point.names)),
    )
    texts = {"subject": subject, "what": what, "details": details, "hold": hold(points)}
    return fact(code, place, numbers, **texts)


def _plain_model(document: ResultDocument) -> Fact | None:
    """By terms that the chosen candidate lacks."""
    chosen = document.chosen
    if chosen is None or _errors_shared(document):  # which a term takes for its own
        return None
    modelled = {*chosen.terms, *(name for name, _, _ in GEOMETRY_TERMS.values())}
    by: dict[str, list[TermEntry]] = {}
    for term in (t for one in chosen.over for t in one.terms if t.name not in modelled):
        by.setdefault(term.name, []).append(term)
    # a fit that weighs readings wrongly takes their noise for a term; another one does not
    agreed = [min(terms, key=lambda t: t.gain or 0.0) for terms in by.values()]
    worst = max(agreed, key=lambda t: t.gain or 0.0, default=None)
    if worst is None or worst.gain is None or worst.gain < DECISIVE:
        return None
    numbers = {"gain": worst.gain}
    return fact("plain-model-wrong", numbers=numbers, term=worst.name, meaning=worst.words)


def _goodness_of_fit(document: ResultDocument) -> Fact | None:
    """Both sides of chi-squared."""
    chi = document.chi_squared
    if chi is None or chi.variance_factor is None:
        return None
    numbers = {"variance_factor": chi.variance_factor}
    if chi.p_value is not None and chi.p_value < RARE:
        numbers["p_value"] = chi.p_value
        return fact("sds-too-small", numbers=numbers, suspects=suspects(document))
    if not chi.too_small:
        return None
    wrong = chi.variance_factor < LOOSE
    return fact("sds-too-large" if wrong else "sds-generous", numbers=numbers)


def _spatial(document: ResultDocument) -> Fact | None:
    """What residuals of neighbours in joint space share, as a part of their variance."""
    depends = document.dependence
    if depends is None or not depends.spatial:
        return None
    worst = depends.spatial[0]
    assert worst.spatial is not None
    share = worst.spatial.correlation
    code = "learnt-terms-incomplete" if document.terms else "model-incomplete"
    return fact(
        "model-lacks-little" if _small_and_held(document, share) else code,
        numbers={"shared_variance": share, "p_value": worst.spatial.p_value},
        instrument=repr(worst.instrument),
    )


def _small_and_held(document: ResultDocument, share: float) -> bool:
    """Whether a machine model with learnt terms lacks so little that its regions hold, on poses
    and in whole regions of the joint space that were not used. Images have no such terms."""
    validation, accuracy = document.validation, document.accuracy
    images = accuracy is not None and bool(accuracy.pixels)
    if share >= LEAST_SHARE or not (document.terms or images) or validation is None:
        return False
    if validation.silent or (validation.blocked and validation.blocked.silent):
        return False
    blocked = validation.blocked and validation.blocked.coverage
    tested = [held for held in (validation.coverage, blocked) if held and held.poses]
    return len(tested) == 2 and not any(map(_rarely_hold, tested))


def _serial(document: ResultDocument) -> Fact | None:
    depends = document.dependence
    if depends is None or not depends.serial:
        return None
    worst = depends.serial[0]
    assert worst.serial is not None
    numbers = {"correlation": worst.serial.correlation}
    return fact("serial-dependence", numbers=numbers, instrument=repr(worst.instrument))


def _errors_shared(document: ResultDocument) -> Fact | None:
    depends = document.dependence
    if depends is None or depends.shared is None or not depends.errors_shared:
        return None
    return fact("errors-shared", numbers={"correlation": depends.shared.correlation})


def _repeats(document: ResultDocument) -> Fact | None:
    one = document.repeats
    if one is None:
        return None
    return fact("repeats-share-error", numbers={"ratio": one.ratio, "p_value": one.p_value})


def _coverage(document: ResultDocument) -> Fact | None:
    held = document.validation and document.validation.coverage
    if not held or not held.poses or _errors_shared(document) or not _rarely_hold(held):
        return None
    return fact("regions-too-small", numbers={"share_held": held.share}, level=percent(held.level))


def _rarely_hold(held: Coverage) -> bool:
    """Whether stated regions hold fewer poses than chance leaves them."""
    # The sd of a binomial share.
    spread = math.sqrt(held.level * (1.0 - held.level) / held.poses)
    return held.level - held.share > max(4.0 * spread, 0.05)


def _model_error(document: ResultDocument) -> Fact | None:
    entries = [e for e in document.noise if e.role == "disturbance" and e.sd]
    # learnt terms say what the model lacks; what they leave belongs to the stated regions
    if not entries or document.terms:
        return None
    chance_of_none, sd = entries[0].p_value, entries[0].sd
    if sd is None or (chance_of_none is not None and chance_of_none >= RARE):
        return None
    return fact("white-model-error", numbers={"sd": Figure(sd, entries[0].unit)})


def _overfitted(document: ResultDocument) -> Fact | None:
    """Where no regions are stated: those contain what few poses leave open, and are tested."""
    accuracy, validation = document.accuracy, document.validation
    if validation is not None and validation.coverage is not None and not validation.silent:
        return None
    unseen = None if validation is None else validation.accuracy
    if accuracy is None or unseen is None or unseen.rms <= WORSE * accuracy.after.rms:
        return None
    return fact("overfitted", numbers={"ratio": unseen.rms / accuracy.after.rms})


def _mounting(document: ResultDocument) -> Fact | None:
    if document.mechanism is None:
        return None
    moved = {p.name for p in document.parameters if p.nominal}
    unstated = [names for names in document.mechanism.unstated if moved.isdisjoint(names)]
    if not unstated:
        return None
    place = Where(parameters=tuple(name for group in unstated for name in group))
    return fact("mounting-unstated", place, groups="; ".join(map(", ".join, unstated)))


def _unsettled(document: ResultDocument) -> Fact | None:
    return None if document.sds_settled is not False else fact("sds-not-converged")


def _updated(document: ResultDocument) -> Fact | None:
    """Of an update whose readings differ from the calibration by more than it follows."""
    check = document.check
    if check is None or check.passed:
        return None
    mixed = check.passed is False
    return fact("update-mixed" if mixed else "update-moved", words=check.words)


def _scales(document: ResultDocument) -> Fact | None:
    """Of stations beside the first, or of what measures beside the drawing; or a zero of distances
    that explains more."""
    entries = [one for one in document.scales or () if not one.joint]
    # They share the level (Bonferroni).
    sure = [one for one in entries if one.p_value * len(entries) < RARE]
    if not sure:
        return None
    likeliest = min(sure, key=lambda one: one.p_value)
    if likeliest.unit == "m" and not _little(document, likeliest):
        return _range_zero(likeliest)
    sure = [one for one in sure if one.unit == "1"]
    if not sure:
        return None
    worst = min(sure, key=lambda one: (not one.instruments, one.p_value))
    numbers = {"ppm": Figure(1e6 * worst.size), "sd": Figure(1e6 * worst.sd)}
    numbers["moves"] = Figure(worst.moves, "m")
    little = _little(document, worst)
    modelled = any(term.name == STATION_SCALES for term in document.terms)
    code, other = "scales-modelled" if modelled else "scales-unlike", "the first station"
    subject = ", ".join(map(repr, worst.instruments))
    if not subject:
        if document.updated:
            return fact("scale-since", numbers=numbers)
        code, subject, other = "scale-off-the-drawing", "the instrument", "the drawing"
    return fact(
        "scale-little-off" if little else code, numbers=numbers, subject=subject, other=other
    )


def _joint_scale(document: ResultDocument) -> Fact | None:
    """A joint whose angles are in proportion too large or small."""
    one = next((one for one in document.scales or () if one.joint), None)
    if one is None or one.p_value >= RARE:
        return None
    numbers = {"percent": Figure(100.0 * abs(one.size)), "sd": Figure(100.0 * one.sd)}
    numbers["turned"] = Figure(one.moves, "rad")
    return fact(
        "joint-scale", numbers=numbers, subject=one.joint, which="more" if one.size > 0 else "less"
    )


def _little(document: ResultDocument, one: ScaleEntry) -> bool:
    """Whether it moves the points by less than predictions are uncertain there."""
    stated = None if document.region is None else document.region.of("m")
    return one.moves < SMALL * (0.0 if stated is None else stated.sd_at_poses or 0.0)


def _range_zero(one: ScaleEntry) -> Fact:
    numbers = {
        "zero": Figure(abs(one.size), "m"),
        "sd": Figure(one.sd or 0.0, "m"),
        "moves": Figure(one.moves, "m"),
    }
    subject = ", ".join(map(repr, one.instruments))
    which = "long" if one.size > 0.0 else "short"
    return fact("range-zero", numbers=numbers, subject=subject, which=which)


def _conflict(document: ResultDocument) -> Fact | None:
    """The observation that contradicts the others most, where that is beyond the predicted sd."""
    entries, region = document.conflicts or (), document.region

    def beyond(one: ConflictEntry) -> float:
        stated = None if region is None else region.of(one.unit)
        sd = None if stated is None else stated.sd_at_poses
        return one.apart / (sd or one.alone or math.inf)

    # They share the level (Bonferroni).
    sure = [one for one in entries if one.p_value * len(entries) < RARE and beyond(one) > 1.0]
    if not sure:
        return None
    worst = max(sure, key=beyond)
    sizes = {"apart": worst.apart, "beside": worst.beside, "alone": worst.alone}
    numbers: dict[str, Figure | float] = {n: Figure(v, worst.unit) for n, v in sizes.items()}
    numbers["p_value"] = worst.p_value
    return fact("observations-conflict", numbers=numbers, instrument=repr(worst.instrument))


def _optima(document: ResultDocument) -> Fact | None:
    others = document.other_optima or ()
    if not others:
        return None
    return fact("other-optimum", optimum=f"{others[0].words[0].upper()}{others[0].words[1:]}")


def _halves(document: ResultDocument) -> Fact | None:
    """Lenses that two halves of the images see differently."""
    rest = sum(not one.name.endswith("_f") for one in document.halves)

    def over(one: HalvesEntry) -> float:
        # Each focal length stands alone; the others share the level (Bonferroni).
        level = APART if one.name.endswith("_f") else APART / rest
        return abs(one.sds) / t_quantile(1.0 - level, one.degrees_of_freedom or math.inf)

    worst = max(document.halves, key=over, default=None)
    if worst is None or over(worst) <= 1.0:
        return None
    first, second = (Figure(value, worst.unit) for value in (worst.first, worst.second))
    numbers = {"sds": Figure(abs(worst.sds)), "first": first, "second": second}
    return fact("halves-disagree", Where(parameters=(worst.name,)), numbers)


def _delayed(document: ResultDocument) -> Fact | None:
    one = document.delay
    if one is None or one.p_value >= RARE:
        return None
    numbers, words = {"share": one.share, "sd": one.sd}, one.words()
    delay, spread = f"{words[0].upper()}{words[1:]}", significant(100.0 * one.sd, 2)
    return fact("poses-delayed", numbers=numbers, delay=delay, spread=spread)


def _contradict(document: ResultDocument) -> Fact | None:
    """By the angle between lines of sight: whatever the size of a pixel."""
    focal = {p.name.removesuffix("_f"): p.value for p in document.parameters if p.unit == "px"}
    by = () if document.accuracy is None else document.accuracy.by
    angles = {
        one.instrument: one.position.after.rms / abs(focal[one.instrument])
        for one in by
        if one.position is not None and one.position.unit == "px" and focal.get(one.instrument)
    }
    camera = max(angles, key=lambda name: angles[name], default=None)
    if camera is None or angles[camera] < CONTRADICT:
        return None
    return fact(
        "images-contradict", numbers={"misfit": Figure(angles[camera], "rad")}, camera=camera
    )


def _focal(document: ResultDocument) -> Fact | None:
    """The focal length that is known worst, where the label of a lens says as much."""
    lenses = [p for p in document.parameters if p.unit == "px" and p.name.endswith("_f") and p.sd]
    worst = max(lenses, key=lambda p: (p.sd or 0.0) / abs(p.value), default=None)
    if worst is None or (worst.sd or 0.0) < LABEL * abs(worst.value):
        return None
    numbers = {"f": Figure(worst.value, worst.unit), "sd": Figure(worst.sd or 0.0, worst.unit)}
    return fact("focal-length-unsure", Where(parameters=(worst.name,)), numbers)


def _lens_errors(document: ResultDocument) -> Fact | None:
    """The largest smooth error that images show beside a lens."""
    shown = [one for one in document.lens_errors if one.gain >= DECISIVE and one.rms > 0.0]
    worst = max(shown, key=lambda one: one.rms, default=None)
    if worst is None:
        return None
    numbers: dict[str, Figure | float] = {"rms": Figure(worst.rms, "px"), "gain": worst.gain}
    return fact("lens-leaves-error", numbers=numbers, camera=worst.camera)


def _scale_decided(document: ResultDocument) -> Fact | None:
    """Which of robot and print decided the scale, where they state lengths otherwise.

    A scale of everything, robot, print and places, changes no image. With the prior sd b of the
    print's scale s, and r that of the robot's lengths in proportion, the estimate is the mean of 0
    and the difference d that the images show, by these priors, so that

        1 / sd^2 = 1 / b^2 + 1 / r^2,   s = d b^2 / (b^2 + r^2) = d (1 - sd^2 / b^2),

    and the two are |d| / (b^2 + r^2)^1/2 = |s| / (b^2 - sd^2)^1/2 sds apart.
    """
    by = () if document.accuracy is None else document.accuracy.by
    if any(one.position is None or one.position.unit != "px" for one in by) or not by:
        return None
    apart = {}
    for p in document.parameters:
        if p.role == "print" and p.name.endswith("_scale") and p.sd and p.prior_sd:
            left = p.prior_sd**2 - p.sd**2
            off = abs(p.value - p.nominal)
            if left > 0.0 and off > _SCALES_APART * min(p.sd, math.sqrt(left)):
                apart[off / math.sqrt(left)] = p
    if not apart:
        return None
    sds, one = max(apart.items(), key=lambda item: item[0])
    off, share = one.value - one.nominal, ((one.sd or 0.0) / (one.prior_sd or math.inf)) ** 2
    robot = share < 0.5  # r < b
    difference = off / (1.0 - share)
    # Where the robot decides, the print seems larger because the robot is stated longer than it is.
    longer = (difference > 0.0) == robot
    return fact(
        "scale-decided",
        Where(parameters=(one.name,)),
        {"sds": sds, "difference": difference},
        decides="robot" if robot else "board",
        other="board" if robot else "robot",
        size=significant(100.0 * off, 2),
        sd=significant(100.0 * (one.sd or 0.0), 2),
        percent=significant(100.0 * abs(difference), 2),
        way="long" if longer else "short",
    )


def _undetermined(document: ResultDocument) -> Fact | None:
    loose = tuple(sorted(document.identifiability.loose))
    if not loose:
        return None
    return fact("not-identifiable", Where(parameters=loose), {"parameters": len(loose)})


def _no_test(document: ResultDocument) -> Fact | None:
    if document.sensors_exact and document.validation is None:
        return fact("sds-unstated")
    chi = document.chi_squared
    return fact("untested") if chi is not None and chi.degrees_of_freedom <= 0 else None


def _effects_learnt(document: ResultDocument) -> Fact | None:
    """The largest effects beyond geometry that the data need."""
    needed = sorted((t for t in document.terms if t.sentences), key=lambda t: -(t.gain or 0.0))
    words = "; ".join(term.sentences[0] for term in needed[:_MODELLED])
    return fact("model-learnt", effects=words) if words else None


SOUND: tuple[Callable[[ResultDocument], Fact | None], ...] = (
    _not_converged,
    far_from_nominal,
    prior_tension,
    _updated,
    _moved,
    _modelled_changes,
    _goodness_of_fit,
    _spatial,
    _plain_model,
    _coverage,
    _conflict,
    _serial,
    order_or_model,
    drift_or_machine,
    _errors_shared,
    _repeats,
    _overfitted,
    _model_error,
    off_the_drawing,
    _scales,
    _joint_scale,
    sds_overruled,
    size_unsure,
    _unsettled,
    not_detectable,
    _mounting,
    _delayed,
    _contradict,
    _focal,
    _halves,
    _optima,
    _undetermined,
    _no_test,
    _lens_errors,
    _scale_decided,
    _effects_learnt,
    errors_beyond_sds,
)
"""Whether a result is sound follows from these facts, and from those of its readings."""

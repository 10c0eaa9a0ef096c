"""The verdict: what a calibration's figures amount to, as four answers and a headline.

Each finding is one rule of `SOUND`: a code, whether it makes a result unsound or leaves the
question open, what it says where it applies, and what to do. docs/explanation/verdict.md
describes every code.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from loopcal.document.accuracy import Coverage
from loopcal.document.change_points import ChangePoint, hold, when
from loopcal.document.result_document import ResultDocument
from loopcal.document.terms import DECISIVE, TermEntry
from loopcal.document.verdict import Answer, Verdict
from loopcal.presentation.rounding import significant
from loopcal.presentation.shown import chance, percent, with_unit
from loopcal.presentation.wrapped import shortened
from loopcal.statistics.answers import better, good_enough, valid
from loopcal.statistics.judged_machine import far_from_nominal, off_the_drawing, prior_tension
from loopcal.statistics.judged_readings import (
    beyond_sds,
    coarse,
    first_suspects,
    order_or_model,
    rows_copied,
    sds_overruled,
    size_unsure,
    undetected,
)
from loopcal.statistics.rule import COLUMN_FAULT, LOOSE, RARE, Rule, Said

_CHANCE = 0.01
"""Share of good data sets with a pose so far off; the search for outliers names more."""
_UNLIKE = 1.5
"""Where residuals are the scale, a good pose may have so many times the usual variance: errors of
joints act through lever arms of unlike length. The log of a p-value falls in proportion."""
WORSE = 1.5
"""Rms on poses not used over rms on poses used that is called too large."""
SMALL = 0.5
"""Predicted sds by which changes may move the end point: 95 % regions then hold at least 90 %."""
LEAST_SHARE = 0.2
"""The share of the variance that adds half an sd to errors, as in SMALL."""
_MODELLED = 2
"""Learnt effects that a sound result names."""
_NAMED = 3
"""Change points that a finding names."""
_GEOMETRY = ("lengths", "angles")
"""Terms that give a plain model nothing but priors."""


def _column_faults(document: ResultDocument) -> Said | None:
    faults = document.column_faults or ()
    words = "; ".join(fault.words for fault in faults)
    return Said(f"The file is at fault: {words}.") if faults else None


def _not_converged(document: ResultDocument) -> Said | None:
    status = document.status
    if status.converged:
        return None
    return Said(f"The fit did not converge ({status.reason}). {status.message}")


def _moved(document: ResultDocument) -> Said | None:
    found = _unmodelled(document)
    if all(_beside(document, point) < SMALL for point in found):
        return None
    return Said(_told("Something moved", "Something moved", found), float(len(found)))


def _moved_little(document: ResultDocument) -> Said | None:
    """Significant, yet small beside what the result states anyway."""
    found = _unmodelled(document)
    most = max((_beside(document, point) for point in found), default=math.inf)
    if most >= SMALL:
        return None
    return Said(
        f"{_told('Something moved a little', 'Something moved a little', found)} That moves the "
        f"end point by {significant(most, 2)} of its predicted sd.",
        most,
    )


def _unmodelled(document: ResultDocument) -> list[ChangePoint]:
    points = () if document.change_points is None else document.change_points.found
    return [point for point in points if not point.modelled]


def _beside(document: ResultDocument, point: ChangePoint) -> float:
    """By how many predicted sds, at the measured poses, a change moves the end point."""
    region = None if document.prediction is None else document.prediction.region
    stated = None if region is None else region.of(point.unit)
    if stated is None or point.moves is None or not stated.sd_at_poses:
        return math.inf
    return point.moves / stated.sd_at_poses


def _moved_and_modelled(document: ResultDocument) -> Said | None:
    points = () if document.change_points is None else document.change_points.found
    found = [point for point in points if point.modelled]
    if not found:
        return None
    return Said(
        f"{_told('The fit models what changed', 'The fit models changes', found)} " + hold(found),
        float(len(found)),
    )


def _told(one: str, several: str, found: Sequence[ChangePoint]) -> str:
    """The first sentence says how often and when; the headline has no room for more."""
    details = _first_of(found)
    if len(found) == 1:
        what, _, sizes = details.rpartition(": ")
        return f"{one} along the run: {what}. Size: {sizes}."
    return f"{several} along the run {when(found)}. {details[0].upper()}{details[1:]}."


def _first_of(found: Sequence[ChangePoint]) -> str:
    more = len(found) - _NAMED
    return "; ".join(map(str, found[:_NAMED])) + (f"; and {more} more" if more > 0 else "")


def _plain_model(document: ResultDocument) -> Said | None:
    """By terms that the chosen candidate lacks."""
    chosen = document.chosen
    if chosen is None or _errors_shared(document):  # which a term takes for its own
        return None
    known = {*chosen.terms, *_GEOMETRY}
    by: dict[str, list[TermEntry]] = {}
    for term in (t for one in chosen.over for t in one.terms if t.name not in known):
        by.setdefault(term.name, []).append(term)
    # a fit that weighs readings wrongly takes their noise for a term; another one does not
    agreed = [min(terms, key=lambda t: t.gain or 0.0) for terms in by.values()]
    worst = max(agreed, key=lambda t: t.gain or 0.0, default=None)
    if worst is None or worst.gain is None or worst.gain < DECISIVE:
        return None
    return Said(
        f"The model without {worst.name} is wrong: {worst.words} (-2 log likelihood lower by "
        f"{significant(worst.gain, 2)}).",
        worst.gain,
    )


def _noise_too_small(document: ResultDocument) -> Said | None:
    chi = document.chi_squared
    if chi is None or chi.p_value is None or chi.variance_factor is None or chi.p_value >= RARE:
        return None
    factor = significant(chi.variance_factor, 2)
    return Said(
        f"The corrections are larger than the stated sds allow: chi-squared per degree of freedom "
        f"is {factor} (p = {chance(chi.p_value)}).{first_suspects(document)}",
        chi.variance_factor,
    )


def _scatter_less(document: ResultDocument) -> Said | None:
    chi = document.chi_squared
    if chi is None or not chi.too_small or chi.variance_factor is None:
        return None
    return Said(
        "The readings scatter less than the stated sds: chi-squared per degree of freedom is "
        f"{significant(chi.variance_factor, 2)}.",
        chi.variance_factor,
    )


def _noise_too_large(document: ResultDocument) -> Said | None:
    said = _scatter_less(document)
    return said if said is not None and (said.number or 0.0) < LOOSE else None


def _noise_generous(document: ResultDocument) -> Said | None:
    said = _scatter_less(document)
    return said if said is not None and (said.number or 0.0) >= LOOSE else None


def _spatial(document: ResultDocument) -> Said | None:
    alike = _alike(document)
    if alike is None or _small_and_held(document, alike):
        return None
    return replace(alike, words=f"The machine model lacks a term: {alike.words}.")


def _spatial_small(document: ResultDocument) -> Said | None:
    alike = _alike(document)
    if alike is None or not _small_and_held(document, alike):
        return None
    return replace(alike, words=f"The machine model lacks a little: {alike.words}.")


def _alike(document: ResultDocument) -> Said | None:
    """What residuals of neighbours in joint space share, as a part of their variance."""
    depends = document.dependence
    if depends is None or not depends.spatial:
        return None
    worst = depends.spatial[0]
    assert worst.spatial is not None
    return Said(
        f"{percent(worst.spatial.correlation, 1)} of the variance of the residuals of "
        f"{worst.instrument!r} is common to poses that are near in joint space "
        f"(p = {chance(worst.spatial.p_value)})",
        worst.spatial.correlation,
    )


def _small_and_held(document: ResultDocument, alike: Said) -> bool:
    """Whether a machine model with learnt terms lacks so little that its regions hold, on poses
    and in whole regions of the joint space that were not used."""
    validation = document.validation
    share = 1.0 if alike.number is None else alike.number
    if share >= LEAST_SHARE or not document.terms or validation is None:
        return False
    blocked = validation.blocked and validation.blocked.coverage
    tested = [held for held in (validation.coverage, blocked) if held and held.poses]
    return len(tested) == 2 and not any(map(_rarely_hold, tested))


def _serial(document: ResultDocument) -> Said | None:
    depends = document.dependence
    if depends is None or not depends.serial:
        return None
    worst = depends.serial[0]
    assert worst.serial is not None
    return Said(
        f"Residuals of {worst.instrument!r} depend on the pose order (correlation "
        f"{significant(worst.serial.correlation, 2)}). The stated sds allow for a drift.",
        worst.serial.correlation,
    )


def _errors_shared(document: ResultDocument) -> Said | None:
    depends = document.dependence
    if depends is None or depends.shared is None or not depends.errors_shared:
        return None
    correlation = depends.shared.correlation
    return Said(
        "The targets share errors, which the stated regions take as independent: their residuals "
        f"in one pose are correlated by {significant(correlation, 2)}.",
        correlation,
    )


def _coverage(document: ResultDocument) -> Said | None:
    held = document.validation and document.validation.coverage
    if not held or not held.poses or _errors_shared(document) or not _rarely_hold(held):
        return None
    level, share = percent(held.level), percent(held.share)
    return Said(f"Stated {level} regions hold only {share} of the poses not used.", held.share)


def _rarely_hold(held: Coverage) -> bool:
    """Whether stated regions hold fewer poses than chance leaves them."""
    spread = math.sqrt(held.level * (1.0 - held.level) / held.poses)
    return held.level - held.share > max(4.0 * spread, 0.05)


def _model_error(document: ResultDocument) -> Said | None:
    entries = [e for e in document.noise if e.role == "disturbance" and e.sd]
    # learnt terms say what the model lacks; what they leave belongs to the stated regions
    if not entries or document.terms:
        return None
    chance_of_none = entries[0].p_value
    if chance_of_none is not None and chance_of_none >= RARE:
        return None
    sd = with_unit(entries[0].sd, entries[0].unit)
    return Said(
        f"Besides the sensors, the machine model has an error with an sd of {sd}, taken as "
        "independent from pose to pose.",
        entries[0].sd,
    )


def _overfitted(document: ResultDocument) -> Said | None:
    """Where no regions are stated: those contain what few poses leave open, and are tested."""
    accuracy, validation = document.accuracy, document.validation
    if validation is not None and validation.coverage is not None:
        return None
    unseen = None if validation is None else validation.accuracy
    if accuracy is None or unseen is None or unseen.rms <= WORSE * accuracy.after.rms:
        return None
    ratio = unseen.rms / accuracy.after.rms
    return Said(
        f"Poses not used are predicted much worse than those used ({significant(ratio, 2)} times "
        "the rms).",
        ratio,
    )


def _outliers(document: ResultDocument) -> Said | None:
    """As in `find_outliers`, half of the level goes to the poses and half to their readings."""
    tests = document.outlier_tests
    poses = 0 if tests is None else tests.poses
    whole = 0.5 * _CHANCE / poses if poses else 1.0
    single = whole / max(len(document.data.quantities), 1) if poses else 1.0
    spare = math.inf
    if tests is not None and tests.by_residuals:
        whole, single = whole**_UNLIKE, single**_UNLIKE
        spare = _spare(document)
    found = [
        entry
        for entry in document.outliers or ()
        if _by_few(entry.p_value, spare) <= (whole if entry.quantity is None else single)
    ]
    bad = list(dict.fromkeys(entry.pose for entry in found))
    if not bad or (tests is not None and tests.by_residuals and _too_few(document, len(bad))):
        return None
    named = ", ".join(bad[:5]) + (", ..." if len(bad) > 5 else "")
    count = f"{len(bad)} poses do" if len(bad) > 1 else "1 pose does"
    return Said(f"{count} not fit the others ({named}).", float(len(bad)))


def _too_few(document: ResultDocument, bad: int) -> bool:
    """Whether the poses without the bad ones are too few to tell: any few can be fitted exactly."""
    tested = 0 if document.outlier_tests is None else document.outlier_tests.poses
    return 2 * tested < document.data.used or 2 * bad > tested


def _spare(document: ResultDocument) -> float:
    """Degrees of freedom that the residuals have as a scale; inf: unknown."""
    index, chi = document.identifiability.calibration_index, document.chi_squared
    if chi is not None:
        return max(float(chi.degrees_of_freedom), 1.0)
    left = math.inf if index is None else index.value - document.identifiability.rank
    return max(left, 1.0)


def _by_few(p: float, spare: float) -> float:
    """The p-value of what has p beside a known scale, where the scale has so many degrees of
    freedom: exp(-x / 2) becomes (1 + x / nu)^(-(nu + 1) / 2), as from the normal to Student's t."""
    if math.isinf(spare) or p <= 0.0:
        return p
    return math.exp(-0.5 * (spare + 1.0) * math.log1p(-2.0 * math.log(p) / spare))


def _mounting(document: ResultDocument) -> Said | None:
    unstated = () if document.mechanism is None else document.mechanism.unstated
    if not unstated:
        return None
    names = "; ".join(", ".join(group) for group in unstated)
    return Said(f"The mounting on the body is not stated: {names} are 0 with flat priors.")


def _unsettled(document: ResultDocument) -> Said | None:
    return None if document.sds_settled is not False else Said("The learnt sds did not converge.")


def _optima(document: ResultDocument) -> Said | None:
    others = document.other_optima or ()
    return Said(f"{others[0].words[0].upper()}{others[0].words[1:]}.") if others else None


def _undetermined(document: ResultDocument) -> Said | None:
    loose = sorted(document.identifiability.loose)
    if not loose:
        return None
    return Said(f"These poses do not determine {', '.join(loose)}.", float(len(loose)))


def _no_test(document: ResultDocument) -> Said | None:
    if document.sensors_exact and document.validation is None:
        return Said("Least squares states no sds of sensors, so nothing tests them.")
    chi = document.chi_squared
    if chi is not None and chi.degrees_of_freedom <= 0:
        return Said("There are no more equations than parameters, so nothing tests the fit.")
    return None


_COLUMNS = "Correct the file, or its columns in the project, and calibrate again."
_MODEL = "Check the sds of the sensors. If they are right, allow for a model error."
SOUND: tuple[Rule, ...] = (
    Rule(COLUMN_FAULT, False, _column_faults, _COLUMNS),
    Rule("not-converged", False, _not_converged, "Follow the advice of the message."),
    Rule(
        "far-from-nominal",
        False,
        far_from_nominal,
        "Check units and columns. State priors from the drawing, or measure other poses.",
    ),
    Rule(
        "prior-tension",
        False,
        prior_tension,
        "Check units, signs and joint directions of the columns, and the drawing.",
    ),
    Rule(
        "change-points",
        False,
        _moved,
        "Add the effects that change_points of result.json lists, or measure again.",
    ),
    Rule("sds-too-small", False, _noise_too_small, _MODEL),
    Rule(
        "model-incomplete",
        False,
        _spatial,
        "Add effects (sag, gears), or fit with a structured model error.",
    ),
    Rule(
        "plain-model-wrong",
        False,
        _plain_model,
        "Measure more poses, all over the region, and fit with a structured model error.",
    ),
    Rule("regions-too-small", False, _coverage, _MODEL),
    Rule(
        "sds-too-large",
        False,
        _noise_too_large,
        "Check the units of the sds, state smaller ones, or estimate them.",
    ),
    Rule(
        "changes-modelled",
        None,
        _moved_and_modelled,
        "Check what happened during the run, or measure again.",
    ),
    Rule(
        "changes-small",
        None,
        _moved_little,
        "Predictions hold as stated. To be sure, add the effects that change_points of result.json "
        "lists.",
    ),
    Rule(
        "model-lacks-little",
        None,
        _spatial_small,
        "Predictions hold nearly as stated. To predict better, measure more poses or add effects.",
    ),
    Rule("sds-generous", None, _noise_generous, "State smaller sds, or estimate them."),
    Rule("serial-dependence", None, _serial, "Look for shifts, or measure in random order."),
    Rule(
        "drift-or-model",
        None,
        order_or_model,
        "Measure the poses in random order: a drift is then no model error.",
    ),
    Rule(
        "errors-shared",
        None,
        _errors_shared,
        "State the sds of the joints and of the instruments. The fit then knows what they share.",
    ),
    Rule("overfitted", None, _overfitted, "Measure more poses, or estimate fewer parameters."),
    Rule(
        "white-model-error",
        None,
        _model_error,
        "Check for missing effects (compliance, eccentric gears, drift).",
    ),
    Rule(
        "off-the-drawing",
        None,
        off_the_drawing,
        "Check this dimension in the drawing, its unit and its sign.",
    ),
    Rule(
        "sds-overruled",
        None,
        sds_overruled,
        "Check the units of the stated sds, or leave them out.",
    ),
    Rule("outliers", None, _outliers, "Inspect these poses; correct or exclude them."),
    Rule("rows-copied", None, rows_copied, "Check how the file was made; delete the copies."),
    Rule(
        "size-unsure",
        None,
        size_unsure,
        "State one length that was measured (bar, distance of seats, link) with its sd.",
    ),
    Rule(
        "readings-coarse",
        None,
        coarse,
        "Record more digits. Poses that repeat a coarse value repeat its error.",
    ),
    Rule("sds-not-converged", None, _unsettled, "State more of the sds."),
    Rule("sd-not-detectable", None, undetected, "State its sd, or repeat readings of one pose."),
    Rule("mounting-unstated", None, _mounting, "State where target or reflector is mounted."),
    Rule("other-optimum", None, _optima, "State priors from the drawing."),
    Rule(
        "not-identifiable",
        None,
        _undetermined,
        "Fix these parameters, give them a prior, or measure other poses.",
    ),
    Rule("untested", None, _no_test, "State or estimate the sds of the sensors."),
)
"""Findings that speak against a result, the gravest first."""


def refuses(question: str, answer: Answer) -> bool:
    """Whether an answer stops a run that requires this question: "sound" where it fails, the
    others unless they pass."""
    return answer.passed is False if question == "sound" else answer.passed is not True


def verdict_of(document: ResultDocument, tolerance: float | None = None) -> Verdict:
    """The verdict on a result. tolerance: distance [SI] that 95 % of poses shall keep."""
    sound = _sound(document)
    where, than = valid(document), better(document)
    good = good_enough(document, tolerance)
    return Verdict(sound, where, than, good, _headline((sound, where, than, good)))


@dataclass(frozen=True)
class Finding:
    """One thing that speaks against a result: its rule, and what it found."""

    rule: Rule
    said: Said


def findings_against(document: ResultDocument) -> list[Finding]:
    """All findings of `SOUND`, the gravest first."""
    found = [Finding(rule, said) for rule in SOUND if (said := rule.finds(document))]
    # sorting is stable
    return sorted(found, key=lambda finding: finding.rule.passed is None)


def _sound(document: ResultDocument) -> Answer:
    found = findings_against(document)
    if not found:
        words = "The fit converged; sensors, poses and machine model are consistent."
        told = [words, _modelled(document), beyond_sds(document)]
        return Answer(True, "sound", None, " ".join(filter(None, told)), None)
    if found[0].rule.code == COLUMN_FAULT:
        found = found[:1]  # all else follows from it
    rule, said = found[0].rule, found[0].said
    words = " ".join(finding.said.words for finding in found)
    return Answer(rule.passed, rule.code, said.number, words, rule.next)


def _modelled(document: ResultDocument) -> str:
    """The largest effects beyond geometry that the data need."""
    needed = sorted((t for t in document.terms if t.told), key=lambda t: -(t.gain or 0.0))
    words = "; ".join(term.told[0] for term in needed[:_MODELLED])
    return f"The model has learnt: {words}." if words else ""


_HEADS = {
    "sound": "Do not use this result",
    "valid": "Use it near the measured poses only",
    "better": "Do not use this result",
    "tolerance": "Not good enough",
}


def _headline(answers: Sequence[Answer]) -> str:
    """The worst of the answers in one sentence."""
    named = list(zip(_HEADS, answers, strict=True))
    for name, answer in named:
        if answer.passed is False:
            return f"{_HEADS[name]}: {_first(answer.words)}"
    for _, answer in named:
        if answer.passed is None and answer.code != "no-tolerance":
            return f"Use it with care: {_first(answer.words)}"
    than = _first(answers[2].words).split(":")[0]
    return f"Sound, valid in the working region, and {than}."


def _first(words: str) -> str:
    """The first sentence, to follow a colon; cut where it is long, for the answer has it all."""
    sentence = shortened(words.split(". ")[0].rstrip(".") + ".")
    word = sentence.split()[0]
    # a name stays as it is written
    usual = word.isalpha() and len(word) > 1 and word.istitle()
    return sentence[0].lower() + sentence[1:] if usual else sentence

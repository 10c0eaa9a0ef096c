"""The verdict in one paragraph: converged? trustworthy? how accurate? what to do next?"""

from __future__ import annotations

from dataclasses import dataclass

from loopcal.document.result_document import ResultDocument
from loopcal.presentation.rounding import significant
from loopcal.presentation.shown import chance, size, unit_shown

REJECTED = 0.01
"""p-value of chi-squared below which stated sds and corrections do not go together."""
WORSE = 1.5
"""Ratio of rms on poses not used to rms on poses used that is called too large."""


@dataclass(frozen=True)
class Verdict:
    """grade: "good", "care" or "bad"; headline: in a few words; paragraph: in full."""

    grade: str
    headline: str
    paragraph: str


def verdict(document: ResultDocument) -> Verdict:
    """What result.json amounts to."""
    status = document.status
    steps = f"{status.iterations} iteration" + ("" if status.iterations == 1 else "s")
    used = document.data.used
    faults = "; ".join(fault.words for fault in document.column_faults or [])
    if faults:
        return Verdict(
            "bad",
            "File at fault: do not use this result",
            f"{used:,} poses were read as given, but {faults}. Next: correct the file, or the "
            "columns in the project, and calibrate again.",
        )
    if not status.converged:
        return Verdict(
            "bad",
            "Not converged: do not use this result",
            f"The fit of {used:,} poses stopped after {steps} without an optimum "
            f"({status.reason}). {status.message}",
        )
    doubts = _doubts(document)
    sentences = [f"The fit converged in {steps} on {used:,} poses.", *_accuracy(document)]
    if doubts:
        reasons = "; ".join(reason for reason, _ in doubts)
        todo = "; ".join(dict.fromkeys(remedy for _, remedy in doubts))
        sentences += [f"Take care: {reasons}.", f"Next: {todo}."]
        return Verdict("care", "Usable with care", " ".join(sentences))
    sentences.append("Sds, poses and model are consistent.")
    sentences.append("Next: use the calibrated mechanism.toml, and check it regularly.")
    return Verdict("good", "Converged and trustworthy", " ".join(sentences))


def _accuracy(document: ResultDocument) -> list[str]:
    accuracy = document.accuracy
    if accuracy is None:
        return ["Its accuracy is unknown: the mechanism has no outputs to predict."]
    unit = accuracy.unit
    before, after = (size(d.rms, unit) for d in (accuracy.before, accuracy.after))
    told = (
        f"On these poses the model predicted the measured point to {before} {unit_shown(unit)} rms "
        f"before and to {after} {unit_shown(unit)} rms after"
    )
    validation = document.validation
    if validation is None or validation.accuracy is None:
        return [f"{told}; it was not validated on other poses."]
    unseen = size(validation.accuracy.rms, unit)
    return [f"{told}, and to {unseen} {unit_shown(unit)} rms on held-out poses."]


def _doubts(document: ResultDocument) -> list[tuple[str, str]]:
    """Reasons for care, each with what to do about it."""
    return [*_of_data(document), *_of_model(document), *_of_validation(document)]


def _of_data(document: ResultDocument) -> list[tuple[str, str]]:
    found = []
    poses = list(dict.fromkeys(entry.pose for entry in document.outliers or []))
    if poses:
        named = ", ".join(poses[:5]) + (", ..." if len(poses) > 5 else "")
        count = f"{len(poses)} pose{'s do' if len(poses) > 1 else ' does'} not fit the others"
        worst = ", worst first" if len(poses) > 1 else ""
        found.append((f"{count} ({named}{worst})", "inspect these poses; correct or exclude them"))
    return found


def _of_model(document: ResultDocument) -> list[tuple[str, str]]:
    found = []
    for entry in document.noise:
        if entry.role == "disturbance" and entry.sd:
            unit = entry.unit
            found.append(
                (
                    "besides the sensors, the machine model has an error with an sd of "
                    f"{size(entry.sd, unit, 3)} {unit_shown(unit)}",
                    "check for missing effects (compliance, eccentric gears, drift)",
                )
            )
    for other in document.other_optima or []:
        found.append((other.words, "state priors from the drawing"))
    loose = document.identifiability.not_identifiable
    if loose:
        names = sorted({name for entry in loose for name in entry.combination})
        found.append(
            (
                f"these poses do not determine {', '.join(names)}",
                "fix these or give them a prior, or measure other poses",
            )
        )
    chi = document.chi_squared
    if chi is not None and chi.p_value is not None and chi.p_value < REJECTED:
        more = ""
        extra = document.model_discrepancy
        if extra is not None and document.accuracy:
            unit = document.accuracy.unit
            more = f"; a model error of {size(extra, unit, 3)} {unit_shown(unit)} would explain it"
        found.append(
            (
                "the corrections are larger than the stated sds allow "
                f"(p = {chance(chi.p_value)}{more}), so the sds of the parameters are too small",
                "check the sds of the sensors, estimate them, or allow for a model error",
            )
        )
    if chi is not None and chi.too_small:
        found.append(
            (
                "the readings scatter less than the stated sds allow (chi-squared per degree of "
                f"freedom {significant(chi.variance_factor or 0.0, 2)}), so the sds are too large",
                "check the sds of the sensors and their units, or estimate them",
            )
        )
    if document.sensors_exact:
        found.append(
            (
                "all sensors except the output were taken as exact",
                "compare with the implicit loop, which weights every sensor",
            )
        )
    return found


def _of_validation(document: ResultDocument) -> list[tuple[str, str]]:
    accuracy, validation = document.accuracy, document.validation
    found = []
    if accuracy is not None and accuracy.after.rms >= accuracy.before.rms:
        found.append(("the calibration did not improve the accuracy", "inspect the residuals"))
    if accuracy is not None and validation is None:
        found.append(
            (
                "this is in-sample accuracy; expect worse on other poses",
                "validate it on other poses (--folds 10)",
            )
        )
        return found
    unseen = validation and validation.accuracy
    if accuracy is not None and unseen and unseen.rms > WORSE * accuracy.after.rms:
        found.append(
            (
                "poses not used are predicted much worse than those used",
                "measure more poses, or poses closer to those used in operation",
            )
        )
    return found

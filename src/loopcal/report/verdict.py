"""The verdict in one paragraph: converged? trustworthy? how accurate? what to do next?"""

from __future__ import annotations

from dataclasses import dataclass

from loopcal.document.result_document import ResultDocument
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
            "Columns at fault: do not use this result",
            f"{used:,} poses were read as they stand, and {faults}. Put right, the machine meets "
            "the readings far better. Next: correct the file, or the columns in the project, and "
            "calibrate again.",
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
        return Verdict("care", "Converged, to be used with care", " ".join(sentences))
    sentences.append("Nothing in the data speaks against it: sds, poses and model agree.")
    sentences.append("Next: put the calibrated mechanism.toml to use, and check it now and then.")
    return Verdict("good", "Converged and trustworthy", " ".join(sentences))


def _accuracy(document: ResultDocument) -> list[str]:
    accuracy = document.accuracy
    if accuracy is None:
        return ["Its accuracy is not known, for there are no outputs that it could predict."]
    unit = accuracy.unit
    before, after = (size(d.rms, unit) for d in (accuracy.before, accuracy.after))
    told = (
        f"On these poses the model predicted the measured point to {before} {unit_shown(unit)} rms "
        f"before and to {after} {unit_shown(unit)} rms after"
    )
    validation = document.validation
    if validation is None or validation.accuracy is None:
        return [f"{told}; on poses not used it was not tried."]
    unseen = size(validation.accuracy.rms, unit)
    return [f"{told}, and to {unseen} {unit_shown(unit)} rms on poses that the fit had not seen."]


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
        found.append(
            (f"{count} ({named}{worst})", "look at these poses, and put right or leave out")
        )
    return found


def _of_model(document: ResultDocument) -> list[tuple[str, str]]:
    found = []
    for entry in document.noise:
        if entry.role == "disturbance" and entry.sd:
            unit = entry.unit
            found.append(
                (
                    "apart from every sensor, the model of the machine is off by an sd of "
                    f"{size(entry.sd, unit, 3)} {unit_shown(unit)}",
                    "look for what the model lacks (compliance, eccentric gears, drift)",
                )
            )
    for other in document.other_optima or []:
        found.append((other.words, "say by a prior what the drawing says"))
    loose = document.identifiability.not_identifiable
    if loose:
        names = sorted({name for entry in loose for name in entry.combination})
        found.append(
            (
                f"these poses do not determine {', '.join(names)}",
                "fix or give a prior to what is not determined, or measure other poses",
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
                "check the sds of the sensors, estimate them, or allow for an error of the model",
            )
        )
    if document.sensors_exact:
        found.append(
            (
                "all sensors but the output were taken as exact",
                "compare with the implicit loop, which weighs every sensor",
            )
        )
    return found


def _of_validation(document: ResultDocument) -> list[tuple[str, str]]:
    accuracy, validation = document.accuracy, document.validation
    found = []
    if accuracy is not None and accuracy.after.rms >= accuracy.before.rms:
        found.append(("the calibration did not improve the accuracy", "look at the residuals"))
    if accuracy is not None and validation is None:
        found.append(
            (
                "the accuracy is that of the poses the fit has seen",
                "validate it on others (--folds 10)",
            )
        )
        return found
    unseen = validation and validation.accuracy
    if accuracy is not None and unseen and unseen.rms > WORSE * accuracy.after.rms:
        found.append(
            (
                "poses not used are predicted much worse than those used",
                "measure more poses, or poses more like those the machine shall go to",
            )
        )
    return found

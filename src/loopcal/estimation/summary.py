"""The result in words and one table, the same in Python and on the command line."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from loopcal.estimation.rounding import rounded_by_sd, significant
from loopcal.units import from_si

if TYPE_CHECKING:
    from loopcal.estimation.accuracy import Accuracy
    from loopcal.estimation.on_request import ModelComparison, Validation
    from loopcal.estimation.result import Result

SHOWN = {"m": "mm", "rad": "deg", "m/K": "um/K", "rad/K": "urad/K"}
"""Units in which SI values are printed, because they are the ones drawings and controllers use."""
FINE = {"m": "um", "rad": "urad"}
"""Units in which sds of sensors are printed."""


def summary(result: Result) -> str:
    """Status, fit, accuracy, parameters with change and sd, and whatever needs a warning."""
    loss = "" if result.loss == "gaussian" else f", loss {result.loss}"
    lines = [f"{result.mechanism.name}: {result.fit.method.label}{loss}", ""]
    lines += _state(result)
    lines += ["", *_accuracy(result)]
    rejected = result.chi_squared is not None and (result.chi_squared.p_value or 0.0) < 0.01
    if rejected or any(entry.source == "estimated" for entry in result.noise):
        lines += ["", *sensor_table(result)]
    lines += ["", *parameter_table(result)]
    if result.variance_factor_applied:
        lines.append("(sds multiplied by the root of chi-squared per degree of freedom)")
    if result.errors is not None:
        lines.append("(error: true minus estimate)")
    if result.intervals:
        lines += ["", *interval_table(result)]
    if result.models is not None:
        lines += ["", *model_table(result.models)]
    for warning in result.warnings:
        lines += ["", f"WARNING  {warning}"]
    return "\n".join(lines)


def _state(result: Result) -> list[str]:
    status = result.status
    head = "converged" if status.converged else f"NOT CONVERGED ({status.reason})"
    steps = f"{status.iterations} iteration{'s' if status.iterations != 1 else ''}"
    used = result.solution.poses
    source = result.dataset.source
    poses = f"{used} poses"
    if source.rows_read and source.rows_read != used:
        poses = f"{used} of {source.rows_read} poses"
    lines = [f"{head} in {steps} on {poses}"]
    if not status.converged:
        lines.append(f"  {status.message}")
    chi = result.chi_squared
    if chi is not None and chi.variance_factor is not None and chi.p_value is not None:
        lines.append(
            f"chi-squared {significant(chi.value, 5)} at {chi.degrees_of_freedom} degrees of "
            f"freedom (per degree {significant(chi.variance_factor, 3)}, p = {chi.p_value:.2g})"
        )
    information = result.identifiability
    condition = information.condition_number
    told = f"{information.rank} of {information.parameters} parameters determined"
    lines.append(told + (f", condition number {significant(condition, 3)}" if condition else ""))
    if remarks := len(result.mechanism.remarks):
        lines.append(
            f"{remarks} remark{'s' if remarks > 1 else ''} on the mechanism, such as why a "
            "parameter is fixed: loopcal check tells them"
        )
    before, after = result.closure_before, result.closure_after
    lines.append(
        f"loop equations: rms {before.rms:.3g} before, {after.rms:.3g} after"
        + ("" if result.fit.method.exact else " (closed by correcting the readings)")
    )
    return lines


def _accuracy(result: Result) -> list[str]:
    before, after = result.accuracy_before, result.accuracy_after
    if before is None or after is None:
        if not result.mechanism.outputs:
            return ["accuracy: the mechanism names no outputs that a model could predict"]
        return ["accuracy: unknown, for no pose measures all outputs and what predicts them"]
    unit = SHOWN.get(after.unit, after.unit)
    shown = {"nominal": before, "calibrated": after}
    note = "(computed from the other readings minus measured, on the poses used for the fit)"
    notes = [note]
    if result.validation is not None:
        if result.validation.accuracy is not None:
            shown["on poses not used"] = result.validation.accuracy
            notes = [note[:-1] + f"; poses not used: {result.validation.words})"]
        notes += _likelihood(result.validation)
    return [*_accuracy_table(shown, unit), *notes]


def _accuracy_table(shown: Mapping[str, Accuracy], unit: str) -> list[str]:
    rows = [["accuracy", f"mean [{unit}]", "rms", "95 %", "max"]]
    rows += [[name, *_distances(accuracy, unit)] for name, accuracy in shown.items()]
    return columns(rows)


def _likelihood(validation: Validation) -> list[str]:
    if validation.log_likelihood is None:
        return []
    value = significant(validation.log_likelihood, 6)
    return [f"log-likelihood of poses not used: {value} (only differences count)"]


def validation_table(validations: Mapping[str, Validation]) -> list[str]:
    """One line for each method that was validated on the same poses: accuracy, log-likelihood."""
    units = {v.accuracy.unit for v in validations.values() if v.accuracy is not None}
    unit = SHOWN.get(one, one) if (one := next(iter(units), "")) else ""
    head = ["on poses not used", f"mean [{unit}]", "rms", "95 %", "max", "log-likelihood"]
    rows = [head]
    for name, found in validations.items():
        told = [""] * 4 if found.accuracy is None else _distances(found.accuracy, unit)
        likely = found.log_likelihood
        rows.append([name, *told, "" if likely is None else f"{likely:.1f}"])
    return columns(rows)


def model_table(found: ModelComparison) -> list[str]:
    """One line for each model: its size, rms and log-likelihood on poses not used; which to take.

    behind: by how much less than the best, with the sd of that difference.
    """
    validations = [m.validation for m in found.models if m.validation is not None]
    units = {v.accuracy.unit for v in validations if v.accuracy is not None}
    unit = SHOWN.get(one, one) if (one := next(iter(units), "")) else ""
    rows = [["model", "parameters", f"rms [{unit}]", "log-likelihood", "behind", "sd"]]
    for m in found.models:
        row = [m.name, str(m.parameters), *[""] * 4]
        if m.validation is not None:
            accuracy, likely = m.validation.accuracy, m.validation.log_likelihood
            row[2] = "" if accuracy is None else _distances(accuracy, unit)[1]
            row[3] = "" if likely is None else f"{likely:.1f}"
            row[4] = "best" if not m.behind else f"{m.behind:.1f}"
            row[5] = "" if not m.behind else f"{m.sd:.1f}"
        rows.append(row)
    failed = [f"{m.name}: {m.failed}" for m in found.models if m.failed]
    scheme = f"(on poses not used, {validations[0].words})" if validations else ""
    return [*columns(rows), scheme, *failed, found.words]


def _distances(accuracy: Accuracy, unit: str) -> list[str]:
    values = (accuracy.mean, accuracy.rms, accuracy.p95, accuracy.max)
    return [significant(from_si(value, unit), 4) for value in values]


def sensor_table(result: Result) -> list[str]:
    """One line per sensor: its sd, how sure and from where, and its share in chi-squared."""
    shares = result.chi_squared_shares
    rows = [["sensor", "sd", "sd of sd", "at most", "chi-squared", "from", "unit"]]
    for entry in result.noise:
        unit = FINE.get(entry.unit, entry.unit)
        first, last = entry.quantities[0], entry.quantities[-1]
        rows.append(
            [
                first if first == last else f"{first} ... {last}",
                significant(from_si(entry.sd, unit), 3),
                "" if entry.sd_of_sd is None else significant(from_si(entry.sd_of_sd, unit), 2),
                "" if entry.upper is None else significant(from_si(entry.upper, unit), 2),
                f"{sum(shares.get(q, 0.0) for q in entry.quantities):.0%}",
                entry.source,
                unit,
            ]
        )
    return columns(rows)


def parameter_table(result: Result) -> list[str]:
    """One line per parameter: value, change from nominal and sd, rounded by the sd."""
    head = ["parameter", "value", "change", "sd", "unit"]
    if result.errors is not None:
        head.insert(4, "error")
    rows = [head]
    for parameter in result.mechanism.parameters:
        unit = SHOWN.get(parameter.unit, parameter.unit)
        value = from_si(result.value[parameter.name], unit)
        nominal = from_si(parameter.nominal, unit)
        its_sd = result.sd[parameter.name]
        if its_sd is None:
            row = [parameter.name, significant(value, 9), "", "fixed", unit]
        elif math.isinf(its_sd):
            change = significant(value - nominal, 3)
            row = [parameter.name, significant(value, 9), change, "unknown", unit]
        else:
            sd = from_si(its_sd, unit)
            change = rounded_by_sd(value - nominal, sd, sign=True)
            row = [parameter.name, rounded_by_sd(value, sd), change, significant(sd, 2), unit]
        if result.errors is not None:
            row.insert(4, _error(result.errors.get(parameter.name), its_sd, unit))
        rows.append(row)
    return columns(rows)


def interval_table(result: Result) -> list[str]:
    """Confidence intervals, by covariance and by profile; those that differ are marked."""
    known = [i for i in result.intervals.values() if i is not None]
    level = f"{known[0].level:.0%} " if known else ""
    rows = [[f"{level}interval", "from", "to", "profile from", "to", "", "unit"]]
    for name, its in result.intervals.items():
        parameter = result.mechanism.parameters[name]
        unit = SHOWN.get(parameter.unit, parameter.unit)
        if its is None:
            rows.append([name, "", "", "", "", "fixed" if parameter.fixed else "unbounded", unit])
            continue
        sd = from_si(result.sd[name] or 1.0, unit)
        ends = (its.low, its.high, its.profile_low, its.profile_high)
        told = ["none" if e is None else rounded_by_sd(from_si(e, unit), sd) for e in ends]
        rows.append([name, *told, "differs" if its.differs else "", unit])
    lines = columns(rows)
    if any(i.differs for i in known):
        lines.append("(differs: trust the profile; the covariance misses how the model curves)")
    return lines


def _error(error: float | None, sd: float | None, unit: str) -> str:
    """The error of a parameter, to the digits of its sd; blank where its truth is not known."""
    if error is None:
        return ""
    if sd is None or not math.isfinite(sd):
        return significant(from_si(error, unit), 3)
    return rounded_by_sd(from_si(error, unit), from_si(sd, unit), sign=True)


def columns(rows: Sequence[Sequence[str]]) -> list[str]:
    """Rows as lines, the first column to the left, the others to the right; units stay left."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    last = len(widths) - 1
    left = {0, last} if rows[0][-1] == "unit" else {0}
    lines = []
    for row in rows:
        cells = [
            cell.ljust(width) if i in left else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        lines.append("  ".join(cells).rstrip())
    return lines

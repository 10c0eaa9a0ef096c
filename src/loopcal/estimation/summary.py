"""The result in words and one table, the same in Python and on the command line."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from loopcal.estimation.rounding import rounded_by_sd, significant
from loopcal.units import from_si

if TYPE_CHECKING:
    from loopcal.estimation.result import Accuracy, Result

SHOWN = {"m": "mm", "rad": "deg"}
"""Units in which SI values are printed, because they are the ones drawings and controllers use."""
FINE = {"m": "um", "rad": "urad"}
"""Units in which sds of sensors are printed."""
_METHODS = {
    "implicit-loop": "implicit loop (all sensors uncertain)",
    "implicit-loop-undamped": "implicit loop, the seed's undamped iteration",
    "reweighted": "reweighted least squares (readings weighed by their propagated noise)",
    "least-squares": "least squares (sensors taken as exact)",
}


def summary(result: Result) -> str:
    """Status, fit, accuracy, parameters with change and sd, and whatever needs a warning."""
    lines = [f"{result.mechanism.name}: {_METHODS[result.method]}", ""]
    lines += _state(result)
    lines += ["", *_accuracy(result)]
    rejected = result.chi_squared is not None and (result.chi_squared.p_value or 0.0) < 0.01
    if rejected or any(entry.source == "estimated" for entry in result.noise):
        lines += ["", *sensor_table(result)]
    lines += ["", *parameter_table(result)]
    if result.errors is not None:
        lines.append("(error: true minus estimate)")
    for warning in result.warnings:
        lines += ["", f"WARNING  {warning}"]
    return "\n".join(lines)


def _state(result: Result) -> list[str]:
    status = result.status
    head = "converged" if status.converged else f"NOT CONVERGED ({status.reason})"
    steps = f"{status.iterations} iteration{'s' if status.iterations != 1 else ''}"
    used = len(result.dataset)
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
    before, after = result.closure_before, result.closure_after
    lines.append(
        f"loop equations: rms {before.rms:.3g} before, {after.rms:.3g} after"
        + ("" if result.method == "least-squares" else " (closed by correcting the readings)")
    )
    return lines


def _accuracy(result: Result) -> list[str]:
    before, after = result.accuracy_before, result.accuracy_after
    if before is None or after is None:
        if not result.mechanism.outputs:
            return ["accuracy: the mechanism names no outputs that a model could predict"]
        return ["accuracy: unknown, for no pose measures all outputs and what predicts them"]
    unit = SHOWN.get(after.unit, after.unit)
    rows = [["accuracy", f"mean [{unit}]", "rms", "95 %", "max"]]
    for name, accuracy in (("nominal", before), ("calibrated", after)):
        rows.append([name, *_distances(accuracy, unit)])
    note = "(computed from the other readings minus measured, on the poses used for the fit)"
    return [*columns(rows), note]


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

"""residuals.csv: what became of every reading, pose by pose."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.result import Result
from loopcal.files.tables.writer import Column, table_bytes

Array = NDArray[np.float64]


def residuals_csv(result: Result) -> bytes:
    """The bytes of residuals.csv: `residual_columns` as a table."""
    return table_bytes(residual_columns(result))


def residual_columns(result: Result) -> dict[str, Column]:
    """One row per pose used, SI: its id, loops before and after, readings and corrections.

    Columns: pose; for every loop "residual NAME before [unit]" and "... after [unit]" (at the
    readings and nominal parameters; at the corrected readings and calibrated parameters); for
    every output "NAME computed - measured before [unit]" and "... after [unit]" (computed from
    the uncorrected readings of the rest, with nominal and with calibrated parameters); for every
    quantity "NAME [unit]", the reading, "NAME correction [unit]", estimated true value
    minus reading, and "NAME correction/sd"; for every known constant "NAME [unit]". Empty: not
    measured; the corrections over their sds also where exact.
    """
    columns: dict[str, Column] = {"pose": result.dataset.poses}
    for loop, before in result.residuals_before.items():
        unit = result.mechanism.quantities.get(loop, "SI")
        columns[f"residual {loop} before [{unit}]"] = before
        columns[f"residual {loop} after [{unit}]"] = result.residuals_after[loop]
    for output, before in result.differences_before.items():
        unit = result.mechanism.quantities[output]
        columns[f"{output} computed - measured before [{unit}]"] = before
        columns[f"{output} computed - measured after [{unit}]"] = result.differences_after[output]
    nothing = np.full(len(result.dataset), np.nan)
    for quantity, unit in result.mechanism.quantities.items():
        reading = result.dataset.readings.get(quantity, nothing)
        sd = result.reading_sds[quantity]
        correction = np.where(np.isfinite(sd), result.corrections[quantity], np.nan)
        columns[f"{quantity} [{unit}]"] = reading
        columns[f"{quantity} correction [{unit}]"] = correction
        columns[f"{quantity} correction/sd"] = _over_sd(correction, sd)
    for name, unit in result.mechanism.known.items():
        columns[f"{name} [{unit}]"] = result.dataset.readings.get(name, nothing)
    return columns


def _over_sd(correction: Array, sd: Array) -> Array:
    measured = (sd > 0.0) & np.isfinite(sd)
    return np.where(measured, correction / np.where(measured, sd, 1.0), np.nan)

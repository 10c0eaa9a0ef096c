"""What reaches the robot: the accuracy of each model that can be entered, and corrected targets."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from loopcal.figures.figure import (
    AFTER,
    BEFORE,
    COLOURS,
    Array,
    Bars,
    Figure,
    axis,
    bar_layout,
    layout,
    names,
    trace,
)


def model_bars(models: Sequence[str], rms: Array, most: Array) -> Figure | None:
    """Rms and largest error [mm] at the calibration poses of each model that can be entered."""
    if not np.isfinite(rms).any():
        return None
    series = (Bars("rms", AFTER, rms.tolist()), Bars("largest", BEFORE, most.tolist()))
    errors_text = ", ".join(f"{m} {v:.3g} mm" for m, v in zip(models, rms, strict=True))
    return Figure(
        "models",
        "What each way of entering the calibration reaches",
        "Distance between computed and measured point at the calibration poses. Nominal: the "
        "drawing, placed as well as can be. Geometry: what exported files hold.",
        f"Rms error of each model: {errors_text}.",
        tuple(bars.trace(models) for bars in series),
        bar_layout(300, "distance [mm]"),
    )


def target_errors(
    key: str, program: str, targets: Sequence[str], before: Array, u95: Array
) -> Figure | None:
    """Error before correction and U95 after it [mm] of each target; NaN where it is unknown."""
    if not np.isfinite(before).any():
        return None
    kept = np.isfinite(u95)
    parts = (
        ("error before", before, BEFORE, "circle"),
        ("U95 after", u95, AFTER, "diamond"),
        ("refused, error stays", np.where(kept, np.nan, before), COLOURS[1], "x"),
    )
    data = [
        trace(
            "markers",
            name,
            range(1, len(targets) + 1),
            values,
            text=names(targets),
            marker={"color": shade, "symbol": mark, "size": 7},
        )
        for name, values, shade, mark in parts
        if np.isfinite(values).any()
    ]
    return Figure(
        key,
        f"Targets of {program}",
        "Distance of the reached tool point from the programmed one. Blue bounds it with 95 % "
        "confidence after correction.",
        f"Error before correction and U95 after it of {len(targets)} targets.",
        tuple(data),
        layout(
            320, xaxis=axis("target", rangemode="tozero"), yaxis=axis("distance [mm]", type="log")
        ),
    )

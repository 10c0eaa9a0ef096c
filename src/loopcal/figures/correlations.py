"""Which estimated parameters can hardly be told apart: their correlations as a map."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from loopcal.figures.figure import Array, Figure, axis, layout, names, numbers, shown_text

LABEL = 12
"""Pixels that a label needs."""


def correlations(covariance: Array, parameters: Sequence[str]) -> Figure | None:
    """A map of the correlations of a covariance (n, n), NaN where unknown; None below n = 2."""
    sds = np.sqrt(np.diag(covariance))
    if len(sds) < 2 or not np.isfinite(sds).any():
        return None
    scale = np.where(sds > 0.0, sds, np.nan)
    matrix = covariance / np.outer(scale, scale)
    apart = np.abs(np.where(np.eye(len(sds), dtype=bool), np.nan, matrix))
    told = "no two parameters have one."
    if np.isfinite(apart).any():
        i, j = divmod(int(np.nanargmax(apart)), len(sds))
        pair = f"{shown_text(parameters[i])} and {shown_text(parameters[j])}"
        told = f"the strongest is {matrix[i, j]:.3f} between {pair}."
    labels = names(parameters)
    ticks = {"tickmode": "linear", "type": "category", "tickfont": {"size": 9}}
    data = {
        "type": "heatmap",
        "x": labels,
        "y": labels,
        # hundredths: no eye tells more of a colour
        "z": [numbers(np.round(row, 2)) for row in matrix],
        "zmin": -1,
        "zmax": 1,
        "colorscale": [[0, "#d55e00"], [0.5, "rgba(128,128,128,0.10)"], [1, "#0072b2"]],
        "colorbar": {"thickness": 10, "tickfont": {"size": 9}},
    }
    return Figure(
        "correlations",
        "Correlations of the estimated parameters",
        "Strong colour off the diagonal: these poses determine only the sum or difference of "
        "the two, so each alone is uncertain.",
        f"Map of the correlations of {len(sds)} parameters: {told}",
        (data,),
        layout(
            220 + LABEL * len(sds),
            xaxis=axis("", tickangle=-90, **ticks),
            yaxis=axis("", autorange="reversed", **ticks),
        ),
        least_width=160 + LABEL * len(sds),
    )

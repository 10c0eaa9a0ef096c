"""Everything of an export as one JSON document, and the parameters of any machine as CSV."""

from __future__ import annotations

import json
from typing import Any

from loopcal.document.exported import Exported, ModelAccuracy
from loopcal.document.plain import plain
from loopcal.files.exports.format import ExportFiles, ExportOptions, Format
from loopcal.files.exports.tables import csv_text
from loopcal.files.exports.urdf import decimal
from loopcal.files.versions import versions


def geometry(exported: Exported, options: ExportOptions) -> ExportFiles:
    """geometry.json and parameters.csv."""
    head = ["parameter", "unit", "nominal", "calibrated", "sd", "exported"]
    rows = [head]
    for p in exported.parameters:
        sd = "" if p.sd is None else decimal(p.sd)
        value = decimal(exported.values[p.name])
        rows.append([p.name, p.unit, decimal(p.nominal), decimal(p.value), sd, value])
    text = json.dumps(plain(document(exported)), indent=1, allow_nan=False) + "\n"
    return ExportFiles({"geometry.json": text, "parameters.csv": csv_text(rows)})


def document(exported: Exported) -> dict[str, Any]:
    """The export as plain data: SI, matrices by rows, null for unknown."""
    return {
        "schema": 1,
        "loopcal": versions()["loopcal"],
        "name": exported.name,
        "parameters": [
            {
                "name": p.name,
                "unit": p.unit,
                "nominal": p.nominal,
                "calibrated": p.value,
                "sd": p.sd,
                "exported": exported.values[p.name],
            }
            for p in exported.parameters
        ],
        "chain": plain(exported.chain),
        "zeros": plain(exported.zeros),
        "frames": [
            {
                "frame": placed.name,
                "in": placed.seen_in,
                "model": placed.model,
                "T": plain(placed.T),
                "orientation_measured": placed.turned,
            }
            for placed in exported.frames
        ],
        "accuracy": [accuracy(one) for one in exported.accuracy],
        "omitted": list(exported.omitted),
    }


def accuracy(one: ModelAccuracy) -> dict[str, Any]:
    """What a model reaches, in m."""
    return {
        "model": one.model,
        "unit": "m",
        "measured": plain(one.measured),
        "from_full": plain(one.from_full),
    }


FORMATS = (
    Format(
        "json",
        "all of it (JSON) and the parameters of any machine (CSV)",
        "a parallel machine, or a program of your own",
        "enter `parameters.csv` by name",
        geometry,
        "parameters",
    ),
)

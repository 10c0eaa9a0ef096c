"""What was made of a result, for its report: exports, corrected programs, and planned poses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from loopcal.arrays import Array
from loopcal.figures.figure import (
    AFTER,
    BEFORE,
    COLOURS,
    Bars,
    Figure,
    axis,
    bar_layout,
    layout,
    names,
    trace,
)
from loopcal.figures.planning import Line, by_number
from loopcal.files.result.deployed import CORRECTION, EXPORT, PLAN, Deployed
from loopcal.presentation.shown import Table, factor, size, unit_shown, with_unit
from loopcal.report.source import Source
from loopcal.report.templates import Part, Section

_MM = 1e3
_NOTHING = 1e-9
"""[m] what is left of two models that are the same."""
_MOST = 200
"""Targets in a table; the others are in the figure and in the JSON of the command."""


def deployed(source: Source) -> Section | None:
    """What was exported, corrected and planned; None: nothing."""
    notes, words = source.deployed, _words(source.deployed)
    figures = (
        _models(notes),
        *_corrections(notes),
        *map(planned, (n.document for n in notes if n.kind == PLAN)),
    )
    by_key = {figure.key: figure for figure in figures if figure is not None}
    parts: list[Part] = [*by_key.values(), *_tables(notes)]
    return Section("deployed", "Into the robot", words, parts) if words else None


def _words(notes: Sequence[Deployed]) -> list[str]:
    """One sentence each."""
    words = []
    for note in notes:
        document = note.document
        if note.kind == EXPORT:
            lost = ", ".join(document["omitted"])
            words.append(
                f"Exported as {document['format']}: {', '.join(document['files'])}."
                + (f" Left out, because the format cannot hold it: {lost}." if lost else "")
            )
            words += [str(warning) for warning in document["warnings"]]
        elif note.kind == CORRECTION:
            refused, left = document["refused"], len(document["not_understood"])
            words.append(
                f"{document['file']} ({document['format']}): {document['corrected']} targets "
                f"corrected, {refused} refused, {left} lines not understood."
            )
            words += [str(remark) for remark in document["remarks"]]
        elif note.kind == PLAN:
            last = document["expected"][-1]
            expected = with_unit(last["end_point"], document["unit"])
            words.append(
                f"Planned to add: {last['poses']} poses to {document['existing']} already "
                f"measured. Expected sd of the end point then: {expected} rms."
            )
    return words


def _tables(notes: Sequence[Deployed]) -> list[Table]:
    """Accuracy of the models, targets, and lines that were left alone."""
    exports = [note.document for note in notes if note.kind == EXPORT]
    tables = [_accuracy(exports[-1]["accuracy"])] if exports and exports[-1]["accuracy"] else []
    for note in notes:
        if note.kind == CORRECTION:
            tables += _of_correction(note.document)
    return tables


def _accuracy(models: Sequence[Mapping[str, Any]]) -> Table:
    rows = []
    for one in models:
        measured, away = one["measured"] or {}, one["from_full"] or {}
        cells = [size(measured.get(key), "m") for key in ("rms", "p95", "max")]
        apart = away.get("rms")
        same = apart is not None and apart < _NOTHING
        rows.append((one["model"], *cells, "0" if same else size(apart, "m")))
    head = ("model", *(f"{key} [mm]" for key in ("rms", "95 %", "max", "rms from the full model")))
    caption = "What each model reaches at the calibration poses when it is entered"
    return Table(caption, head, tuple(rows))


def _of_correction(correction: Mapping[str, Any]) -> list[Table]:
    rows = []
    for one in correction["targets"][:_MOST]:
        refused = one["refused"]
        rows.append(
            (
                str(one["target"]),
                str(one["line"]),
                size(_length(one["error_before"]), "m"),
                size(one["u95_point"], "m"),
                size(one["u95_turn"], "rad"),
                refused["reason"] if refused else "outside" if one["extrapolated"] else "",
            )
        )
    more = len(correction["targets"]) - len(rows)
    caption = f"Targets of {correction['file']}" + (f"; {more} more are not listed" if more else "")
    turn = unit_shown("rad")
    head = ("target", "line", "error before [mm]", "U95 [mm]", f"U95 of the turn [{turn}]", "note")
    tables = [Table(caption, head, tuple(rows))]
    lines = [
        (str(one["line"]), f"refused: {one['refused']['words']}")
        for one in correction["targets"]
        if one["refused"]
    ]
    lines += [
        (str(one["line"]), f"not understood: {one['words']}")
        for one in correction["not_understood"]
    ]
    if lines:
        caption = f"Lines of {correction['file']} that stay as they were"
        tables.append(Table(caption, ("line", "why"), tuple(lines[:_MOST])))
    return tables


def _models(notes: Sequence[Deployed]) -> Figure | None:
    exports = [note.document for note in notes if note.kind == EXPORT]
    models = exports[-1]["accuracy"] if exports else []
    measured = [one["measured"] or {} for one in models]
    rms, most = (_MM * _numbers([one.get(key) for one in measured]) for key in ("rms", "max"))
    return model_bars([one["model"] for one in models], rms, most) if models else None


def _corrections(notes: Sequence[Deployed]) -> list[Figure | None]:
    figures = []
    for number, note in enumerate((n for n in notes if n.kind == CORRECTION), 1):
        correction = note.document
        before = _MM * _numbers([_length(one["error_before"]) for one in correction["targets"]])
        u95 = _MM * _numbers([one["u95_point"] for one in correction["targets"]])
        ids = [f"{one['target']}, line {one['line']}" for one in correction["targets"]]
        figures.append(target_errors(f"targets_{number}", correction["file"], ids, before, u95))
    return figures


def planned(plan: Mapping[str, Any]) -> Figure | None:
    """What a plan promises by the number of poses, beside random ones."""
    curve, random, scale = plan["expected"], plan["random"], factor(plan["unit"])
    count = [one["poses"] for one in curve]
    lines = [
        Line(f"planned, {name}", count, _numbers([one[key] for one in curve]) / scale)
        for name, key in (("rms", "end_point"), ("largest", "largest"))
    ]
    if random is not None:
        lines.append(Line("random, rms", random["poses"], _numbers(random["end_point"]) / scale))
    return by_number(lines, unit_shown(plan["unit"]), len(plan["poses"]))


def _length(error: Sequence[float | None]) -> float | None:
    """Of the shift in an error of six components."""
    length = float(np.linalg.norm(_numbers(error[:3])))
    # Null where the joints that the controller takes are unknown.
    return None if np.isnan(length) else length


def _numbers(values: Sequence[float | None]) -> Array:
    return np.array(values, dtype=float)  # NaN for None


# What reaches the robot: the accuracy of each model that can be entered, and corrected targets.


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

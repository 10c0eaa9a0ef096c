"""What stands first in a report: how good it is in bars, where it is valid."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from loopcal.document.result_document import ResultDocument
from loopcal.document.tables import accuracy_stages
from loopcal.presentation.shown import with_unit
from loopcal.report.source import Source
from loopcal.units import to_si

RECORD = ("date", "operator", "instrument", "serial", "note")


@dataclass(frozen=True)
class Bar:
    """A labelled part of a scale; begin, share: in percent of it; words: what to read beside it."""

    label: str
    begin: float
    share: float
    words: str
    kind: str = ""


def record(source: Source) -> dict[str, str]:
    """When, which files and how many poses; what the project's [record] states; the method."""
    document = source.document
    stated: Mapping[str, Any] = document.inputs.get("record") or {}
    entries = {name: str(stated[name]) for name in RECORD if stated.get(name)}
    machine = {} if document.mechanism is None else {"machine": document.mechanism.name}
    return {
        **({} if "date" in entries else {"written": source.written}),
        **entries,
        "readings": readings(document),
        **machine,
        "method": document.method_label or document.method,
    }


def readings(document: ResultDocument) -> str:
    """The files that were read, and how many poses of them were used."""
    data = document.data
    files = [file or "from memory" for file in (data.file, *(one.file for one in data.joined))]
    return f"{', '.join(files)}: {data.used:,} of {data.poses:,} poses used"


def accuracy_bars(document: ResultDocument) -> list[Bar]:
    """Rms distances of nominal, fit and prediction, noise floor and tolerance on one scale."""
    accuracy = document.accuracy
    if accuracy is None:
        return []
    stages = accuracy_stages(accuracy, document.validation, document.updated)
    sizes = [
        (stage.name, stage.distances.rms, with_unit(stage.distances.p95, accuracy.unit))
        for stage in stages.position
        if not stage.instrument
    ]
    # Unplaced, the nominal machine shows mostly where the instrument was put.
    placed = [name for name, _, _ in sizes if name == "nominal, best placed"]
    sizes = [size for size in sizes if not (placed and size[0] == "nominal")]
    if stages.noise_floor is not None:
        sizes.append(("noise floor", stages.noise_floor, ""))
    # The tolerance of what a camera sees is a length at the board.
    limit = _tolerance(document) if accuracy.unit != "px" else None
    if limit is not None:
        sizes.append(("tolerance", limit, ""))
    # Exact readings may leave zeros alone.
    widest = max(size for _, size, _ in sizes) or 1.0
    return [
        Bar(
            name,
            0.0,
            100.0 * size / widest,
            with_unit(size, accuracy.unit) + (f" (95 %: {p95})" if p95 and limit else ""),
            name.split()[0].strip(","),
        )
        for name, size, p95 in sizes
    ]


def _tolerance(document: ResultDocument) -> float | None:
    stated = (document.inputs.get("verdict") or {}).get("tolerance")
    if isinstance(stated, Mapping) and isinstance(stated.get("value"), int | float):
        return to_si(float(stated["value"]), str(stated.get("unit", "m")))
    return float(stated) if isinstance(stated, int | float) else None


def region_bars(source: Source) -> list[Bar]:
    """The measured part of the working range, of each joint or coordinate of the flange."""
    prediction = source.document.prediction
    region = None if prediction is None else prediction.region
    bars = []
    for span in () if region is None else region.ranges:
        read = source.table.readings.get(span.quantity)
        width = span.high - span.low
        if read is None or not np.isfinite(read).any() or width <= 0.0:
            continue
        low, high = float(np.nanmin(read)), float(np.nanmax(read))
        begin = min(max((low - span.low) / width, 0.0), 1.0)
        end = min(max((high - span.low) / width, 0.0), 1.0)
        unit = (source.mechanism and source.mechanism.quantities.get(span.quantity)) or "rad"
        words = (
            f"measured {with_unit(low, unit)} to {with_unit(high, unit)}, "
            f"region {with_unit(span.low, unit)} to {with_unit(span.high, unit)}"
        )
        bars.append(Bar(span.quantity, 100.0 * begin, 100.0 * (end - begin), words))
    return bars

"""The tables of the report, as text: numbers of result.json in the units of the summary."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from loopcal.arrays import Array
from loopcal.document.accuracy import Distances
from loopcal.document.fit import ParameterEntry
from loopcal.document.result_document import ResultDocument
from loopcal.document.tables import (
    TERM_HEAD,
    Stage,
    accuracy_stages,
    culprit_table,
    culprit_words,
    distances_shown,
    place_table,
    shown_parameters,
    term_rows,
)
from loopcal.presentation.shown import (
    NONE,
    Table,
    by_sd,
    chance,
    percent,
    size,
    unit_shown,
    with_unit,
)
from loopcal.report.source import Source


def accuracy_tables(document: ResultDocument) -> list[Table]:
    """Mean, rms, 95 % and largest distance, before, after, and on poses not used.

    One table of positions and one of orientations, with a line per instrument where there are
    several.
    """
    accuracy, validation = document.accuracy, document.validation
    if accuracy is None:
        return []
    caption = "Distance between computed and measured point, the readings not corrected"
    stages = accuracy_stages(accuracy, validation, document.updated)
    floor = stages.noise_floor
    tables = [_distances("accuracy", caption, accuracy.unit, stages.position, floor)]
    if accuracy.orientation is not None:
        caption = "Angle between computed and measured orientation, the readings not corrected"
        unit = accuracy.orientation.unit
        tables.append(_distances("orientation", caption, unit, stages.orientation))
    places = place_table(accuracy, validation, document.region)
    faults = culprit_table(document.culprits, accuracy.unit)
    if faults is not None:
        words = culprit_words(document.culprits, accuracy.unit)
        faults = replace(faults, caption=f"{faults.caption}. {words}")
    return [*tables, *(one for one in (places, faults) if one is not None)]


def _distances(
    what: str, caption: str, unit: str, stages: Sequence[Stage], floor: float | None = None
) -> Table:
    rows = [
        (
            s.name if not s.instrument else f"{s.name}, {s.instrument}",
            *distances_shown(s.distances, unit),
        )
        for s in stages
    ]
    if floor is not None:
        rows.append(("noise floor", NONE, size(floor, unit), NONE, NONE))
    head = (what, *(f"{key} [{unit_shown(unit)}]" for key in ("mean", "rms", "95 %", "max")))
    return Table(caption, head, tuple(rows))


def model_table(document: ResultDocument) -> Table | None:
    """Models compared on the same poses, none of them used for the fit that predicted them."""
    entries = document.models
    if not entries:
        return None
    unit = document.accuracy.unit if document.accuracy else "1"
    rows = []
    for m in entries:
        likely, behind, sd = m.log_likelihood, m.behind, m.sd_of_behind
        rows.append(
            (
                m.name + (" (recommended)" if m.recommended else ""),
                ", ".join(m.effects) or "none",
                str(m.parameters),
                NONE if m.accuracy is None else size(m.accuracy.rms, unit),
                m.failed or NONE if likely is None else f"{likely:.1f}",
                NONE if behind is None else "best" if behind == 0.0 else f"{behind:.1f}",
                NONE if not behind or sd is None else f"{sd:.1f}",
            )
        )
    head = ("model", "effects", "parameters", f"rms [{unit_shown(unit)}]", "log-likelihood")
    caption = "Models on poses not used; behind: log-likelihood less than the best model's, and sd"
    return Table(caption, (*head, "behind", "sd"), tuple(rows))


_MOST_SENSORS = 40
"""Rows of sensors: images have hundreds of corners."""


def sensor_table(source: Source) -> Table | None:
    """The sds that the readings were given, and how large their corrections are beside them."""
    rows = []
    for entry in source.document.noise:
        unit = entry.unit
        parts = [source.table.normalised.get(q) for q in entry.quantities]
        # NaN also where readings are exact (`PoseTable`).
        used = [part[np.isfinite(part)] for part in parts if part is not None]
        values = np.concatenate(used) if used else np.empty(0)
        rms = f"{np.sqrt(np.square(values).mean()):.2f}" if values.size else NONE
        mean = f"{values.mean():+z.2f}" if values.size else NONE
        rows.append(
            (
                entry.label,
                size(entry.sd, unit, 3, fine=True),
                size(entry.sd_of_sd, unit, 2, fine=True),
                size(entry.upper, unit, 2, fine=True),
                unit_shown(unit, fine=True),
                entry.source,
                rms,
                mean,
                NONE if entry.variance_factor is None else f"{entry.variance_factor:.2f}",
            )
        )
    if not rows:
        return None
    head = ("sensor", "sd", "sd of sd", "at most", "unit", "from", "rms corr./sd", "mean corr./sd")
    caption = (
        "Sds of the sensors, and corrections over them; factor: chi-squared of the sensor over its "
        "redundancy, 1 where its sd is right"
    )
    return Table(caption, (*head, "factor"), tuple(rows))


def term_table(document: ResultDocument) -> Table | None:
    """The learnt model error: scale of each term with its interval, and what it means."""
    if not document.terms:
        return None
    caption = (
        "Learnt model error: sd with 95 % interval; degrees of freedom that the data use, of so "
        "many columns; gain in -2 log likelihood (above 10: the machine model is wrong without it)"
    )
    return Table(caption, TERM_HEAD, tuple(term_rows(document.terms)))


def parameter_head(document: ResultDocument) -> tuple[str, ...]:
    """What the cells of a parameter's row are."""
    head = ("parameter", "nominal", "value", "change", "sd", "unit", "change/sd", "prior's share")
    return (*head, "error") if _with_error(document) else head


def _with_error(document: ResultDocument) -> bool:
    return any(entry.error is not None for entry in document.parameters)


def parameter_cells(entry: ParameterEntry, document: ResultDocument) -> tuple[str, ...]:
    """Nominal and calibrated value, sd, change in sds, and how much of it the prior says."""
    unit, sd, change = entry.unit, entry.sd, entry.value - entry.nominal
    cells = [entry.name, by_sd(entry.nominal, sd, unit), by_sd(entry.value, sd, unit)]
    if entry.fixed:
        cells += [NONE, entry.held, unit_shown(unit), NONE, NONE]
    else:
        prior = entry.prior_sd
        # 1/sd^2 = 1/prior^2 + 1/data^2 of a normal prior: its share of the weight is (sd/prior)^2.
        share = None if sd is None else 0.0 if not prior else min((sd / prior) ** 2, 1.0)
        cells += [
            by_sd(change, sd, unit, sign=True),
            "not determined" if sd is None else size(sd, unit, 2),
            unit_shown(unit),
            f"{change / sd:+z.1f}" if sd else NONE,
            percent(share),
        ]
    if _with_error(document):
        error = entry.error
        cells.append(NONE if error is None else by_sd(error, sd, unit, sign=True))
    return tuple(cells)


def outlier_table(document: ResultDocument) -> Table | None:
    """Poses that do not fit the others, the worst first."""
    entries = document.outliers
    if not entries:
        return None
    rows = [
        (
            entry.pose,
            entry.blamed,
            size(entry.statistic, "1", 3),
            chance(entry.p_value),
            NONE if entry.size is None else with_unit(entry.size, entry.unit or "1"),
            (entry.cause or NONE) + (" (verified)" if entry.verified else ""),
        )
        for entry in entries
    ]
    head = ("pose", "reading", "statistic", "p-value", "off by", "probable cause")
    return Table("Poses that do not fit the others", head, tuple(rows))


def reliability_table(document: ResultDocument) -> Table | None:
    """What single readings can hide, by sensor."""
    reliability = document.reliability
    if reliability is None or not reliability.sensors:
        return None
    sensors, which = reliability.sensors, ""
    if len(sensors) > _MOST_SENSORS:
        by_effect = sorted(sensors, key=lambda one: -(one.effect or 0.0))
        sensors = tuple(by_effect[:_MOST_SENSORS])
        which = f", of those {_MOST_SENSORS} sensors whose errors do most"
    rows = [
        (
            one.quantity,
            percent(one.redundancy),
            NONE if one.detectable is None else with_unit(one.detectable, one.unit, 2),
            NONE if one.largest is None else with_unit(one.largest, one.unit, 2),
            NONE if one.effect is None else with_unit(one.effect, reliability.unit or "1", 2),
            one.pose or NONE,
            str(one.uncontrolled),
        )
        for one in sensors
    ]
    caption = (
        "What single readings can hide: smallest error that a test at "
        f"{100 * reliability.alpha:g} % finds with a probability of {percent(reliability.power)} "
        "(median and largest), and how far such an error moves the predictions "
        f"(rms over the measured poses){which}"
    )
    head = ("sensor", "redundancy", "detectable", "largest", "effect", "at pose", "unchecked")
    return Table(caption, head, tuple(rows))


WORST = 10


def worst_table(source: Source, before: Array, after: Array) -> Table | None:
    """The poses whose calibrated machine is farthest from what was measured, with causes.

    before, after: (instruments N,) distances [SI] of nominal and calibrated machine; the largest of
    a pose counts.
    """
    accuracy = source.document.accuracy
    if accuracy is None or not np.isfinite(after).any():
        return None
    count = len(source.table.poses)
    # fmax passes over the instruments that did not read a pose.
    before, after = (np.fmax.reduce(d.reshape(-1, count)) for d in (before, after))
    # inf puts poses that were not read last.
    order = np.argsort(np.where(np.isfinite(after), -after, np.inf))[:WORST]
    named = {entry.pose: entry for entry in source.document.outliers or ()}
    rows = []
    for i in order[np.isfinite(after[order])].tolist():
        pose = source.table.poses[i]
        outlier = named.get(pose)
        cause = "does not fit the others" if outlier else NONE
        cells = [size(float(d[i]), accuracy.unit, 3) for d in (before, after)]
        rows.append((pose, *cells, (outlier and outlier.cause) or cause))
    unit = unit_shown(accuracy.unit)
    head = ("pose", f"nominal [{unit}]", f"calibrated [{unit}]", "probable cause")
    return Table("The poses with the largest error after calibration", head, tuple(rows))


def facts_table(document: ResultDocument) -> Table:
    """Poses, chi-squared, closure and observability."""
    chi, closure, data = document.chi_squared, document.closure, document.data
    rows = [
        ("poses used", f"{data.used:,} of {data.poses:,}"),
        ("poses left out", ", ".join(data.excluded) or "none"),
        ("loop equations, rms before", size(closure.before.rms, "1", 3)),
        ("loop equations, rms after (no accuracy)", size(closure.after.rms, "1", 3)),
    ]
    if data.every > 1:
        rows.append(("thinning", f"one row of {data.every}"))
    if chi is not None:
        rows += [
            ("chi-squared", size(chi.value, "1", 5)),
            ("degrees of freedom", str(chi.degrees_of_freedom)),
            ("chi-squared per degree", size(chi.variance_factor, "1", 3)),
            ("p-value", chance(chi.p_value)),
        ]
    return Table("Fit", ("fact", "value"), tuple(rows))


def comparison_table(sources: Sequence[Source]) -> Table:
    """Several results side by side: what matters of each, and their parameters."""
    documents = [source.document for source in sources]
    rows = [
        ("converged", *("yes" if d.status.converged else "no" for d in documents)),
        ("method", *(d.method for d in documents)),
        ("poses used", *(f"{d.data.used:,}" for d in documents)),
    ]
    before = [None if d.accuracy is None else d.accuracy.before for d in documents]
    rows.append(("rms before", *map(_rms, documents, before)))
    after = [None if d.accuracy is None else d.accuracy.after for d in documents]
    rows.append(("rms after", *map(_rms, documents, after)))
    unseen = [None if d.validation is None else d.validation.accuracy for d in documents]
    rows.append(("rms on poses not used", *map(_rms, documents, unseen)))
    shown = [shown_parameters(d.parameters, d.terms) for d in documents]
    names = dict.fromkeys(entry.name for parameters in shown for entry in parameters)
    entries = [{entry.name: entry for entry in parameters} for parameters in shown]
    for name in names:
        rows.append((name, *(_value(by_name.get(name)) for by_name in entries)))
    head = ("result", *(source.name for source in sources))
    return Table("Results side by side: value ± sd", head, tuple(rows))


def _rms(document: ResultDocument, distances: Distances | None) -> str:
    if distances is None or document.accuracy is None:
        return NONE
    return with_unit(distances.rms, document.accuracy.unit, 4)


def _value(entry: ParameterEntry | None) -> str:
    if entry is None:
        return NONE
    unit, sd = entry.unit, entry.sd
    spread = "" if sd is None else f" ± {size(sd, unit, 2)}"
    return f"{by_sd(entry.value, sd, unit)}{spread} {unit_shown(unit)}"

"""What was found of a result on other days, for its report: update, verifications, history,
fleet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from loopcal.document.accuracy import Distances
from loopcal.document.result_document import ResultDocument
from loopcal.document.tables import distances_shown, shown_parameters
from loopcal.estimation.inherited import UPDATED
from loopcal.figures.figure import Figure
from loopcal.figures.life import narrowed
from loopcal.files.result.deployed import FLEET, HISTORY, VERIFICATION, Deployed
from loopcal.life.fleet import Fleet
from loopcal.life.history import History
from loopcal.presentation.rounding import significant
from loopcal.presentation.shown import by_sd, chance, in_unit, size, unit_shown
from loopcal.report.history_page import history_figures, history_table
from loopcal.report.life_pages import (
    UNITS,
    change_figures,
    fleet_figure,
    fleet_tables,
    fleet_words,
)
from loopcal.report.tables import Table
from loopcal.statistics.changed import WhatChanged


@dataclass(frozen=True, eq=False)
class OtherDays:
    """words: one sentence each; figures: by key; tables: below them."""

    words: Sequence[str]
    figures: Mapping[str, Figure]
    tables: Sequence[Table]


def other_days(document: ResultDocument, notes: Sequence[Deployed]) -> OtherDays:
    """What a result, if it is an update, and its notes say of other days."""
    words, figures = _update(document)
    tables: list[Table] = []
    told = {VERIFICATION: _verification, HISTORY: _history, FLEET: _fleet}
    for number, note in enumerate((n for n in notes if n.kind in told), 1):
        try:
            one = told[note.kind](note.document)
        except (KeyError, TypeError, ValueError):
            words.append(f"A note of this {note.kind} is damaged. Run the command again.")
            continue
        words += one.words
        figures += [replace(its, key=f"{key}_{number}") for key, its in one.figures.items()]
        tables += one.tables
    return OtherDays(words, {figure.key: figure for figure in figures}, tables)


def _update(document: ResultDocument) -> tuple[list[str], list[Figure]]:
    """By how much an update narrowed what the earlier calibration knew."""
    known = [
        (p.name, p.unit, p.prior_sd, p.sd)
        for p in shown_parameters(document.parameters, document.terms)
        if not p.fixed and p.prior_sd and p.sd
    ]
    if document.method_label != UPDATED or not known:
        return [], []
    shares = [sd / before for _, _, before, sd in known]
    words = (
        f"This result updates an earlier calibration: the sds of {len(known)} parameters are "
        f"{significant(min(shares), 2)} to {significant(max(shares), 2)} times those before."
    )
    drawn = []
    for unit in dict.fromkeys(unit for _, unit, _, _ in known):
        its = [one for one in known if one[1] == unit]
        sds = np.array([[in_unit(v, unit) for v in one[2:]] for one in its])
        key = f"sds_{UNITS.get(unit, 'others')}"
        drawn.append(narrowed(key, unit_shown(unit), [one[0] for one in its], *sds.T))
    return [words], [figure for figure in drawn if figure is not None]


def _verification(its: Mapping[str, Any]) -> OtherDays:
    file, answers = its["readings"], its["verdict"]
    words = [f"{file}, {its['poses']} poses: {answers['headline']}"]
    words += [
        f"{file}: {answer['next']}"
        for name, answer in answers.items()
        if name != "headline" and answer["next"] and answer["passed"] is False
    ]
    tables = [_accuracy(file, its["accuracy"])]
    if its["changes"] is None:
        return OtherDays(words, {}, tables)
    found = WhatChanged.from_document(its["changes"], its["chi_squared"])
    drawn = [replace(one, title=f"{one.title}: {file}") for one in change_figures(found)]
    return OtherDays(words, {one.key: one for one in drawn}, [_changes(file, found), *tables])


def _changes(file: str, found: WhatChanged) -> Table:
    rows = [
        (
            one.where,
            by_sd(one.value, one.sd, one.unit),
            size(0.5 * (one.high - one.low), one.unit, 2),
            unit_shown(one.unit),
            chance(one.p_value),
            ", ".join(other.words for other in one.alike),
        )
        for one in found.found
    ]
    if not rows:
        rows = [("no change is seen", "", "", "", chance(found.test.p_value), "")]
    head = ("what changed", "change", "U95", "unit", "p", "not distinguishable at these poses")
    return Table(f"What changed: {file}", head, tuple(rows))


def _accuracy(file: str, its: Mapping[str, Any]) -> Table:
    unit = its["unit"]
    rows = tuple(
        (name, *distances_shown(Distances(**its[name]), unit))
        for name in ("nominal", "calibrated", "expected")
        if its[name] is not None
    )
    head = ("machine", f"mean [{unit_shown(unit)}]", "rms", "95 %", "max")
    return Table(f"Accuracy: {file}", head, rows)


def _history(its: Mapping[str, Any]) -> OtherDays:
    found = History.from_document(its)
    figures = {one.key: one for one in history_figures(found)}
    return OtherDays([], figures, [replace(history_table(found), caption="History of the machine")])


def _fleet(its: Mapping[str, Any]) -> OtherDays:
    found = Fleet.from_document(its)
    figure = fleet_figure(found)
    return OtherDays([fleet_words(found)], {figure.key: figure}, fleet_tables(found))

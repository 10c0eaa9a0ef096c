"""What was found of a result on other days, for its report: update, verifications, history,
fleet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from loopcal.document.accuracy import Distances
from loopcal.document.result_document import ResultDocument
from loopcal.document.tables import shown_parameters
from loopcal.estimation.inherited import UPDATED
from loopcal.figures.figure import Figure
from loopcal.figures.life import narrowed
from loopcal.files.result.deployed import FLEET, HISTORY, VERIFICATION, Deployed
from loopcal.life.fleet import Fleet
from loopcal.life.history import History
from loopcal.presentation.rounding import significant
from loopcal.presentation.shown import by_sd, chance, in_unit, size, unit_shown
from loopcal.presentation.text_table import Table
from loopcal.report.history_page import history_figures, history_table
from loopcal.report.life_pages import (
    UNITS,
    change_figures,
    fleet_figure,
    fleet_tables,
    fleet_words,
)
from loopcal.statistics.changed import WhatChanged
from loopcal.statistics.verified import accuracy_table


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
    section_of = {VERIFICATION: _verification, HISTORY: _history, FLEET: _fleet}
    for number, note in enumerate((n for n in notes if n.kind in section_of), 1):
        try:
            one = section_of[note.kind](note.document)
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError):
            # What a damaged note raises depends on the damage, since its content is not checked.
            words.append(f"A note of this {note.kind} is damaged. Run the command again.")
            continue
        words += one.words
        figures += [replace(figure, key=f"{key}_{number}") for key, figure in one.figures.items()]
        tables += one.tables
    return OtherDays(words, {figure.key: figure for figure in figures}, tables)


def _update(document: ResultDocument) -> tuple[list[str], list[Figure]]:
    """By how much an update narrowed what the earlier calibration knew."""
    estimates = [
        (p.name, p.unit, p.prior_sd, p.sd)
        for p in shown_parameters(document.parameters, document.terms)
        if not p.fixed and p.prior_sd and p.sd
    ]
    if document.method_label != UPDATED or not estimates:
        return [], []
    shares = [sd / before for _, _, before, sd in estimates]
    words = (
        f"This result updates an earlier calibration: the sds of {len(estimates)} parameters are "
        f"{significant(min(shares), 2)} to {significant(max(shares), 2)} times those before."
    )
    drawn = []
    for unit in dict.fromkeys(unit for _, unit, _, _ in estimates):
        group = [one for one in estimates if one[1] == unit]
        sds = np.array([[in_unit(v, unit) for v in one[2:]] for one in group])
        key = f"sds_{UNITS.get(unit, 'others')}"
        drawn.append(narrowed(key, unit_shown(unit), [one[0] for one in group], *sds.T))
    return [words], [figure for figure in drawn if figure is not None]


def _verification(document: Mapping[str, Any]) -> OtherDays:
    file, answers = document["readings"], document["verdict"]
    words = [f"{file}, {document['poses']} poses: {answers['headline']}"]
    words += [
        f"{file}: {answer['next']}"
        for name, answer in answers.items()
        if name != "headline" and answer["next"] and answer["passed"] is False
    ]
    stated = {**document["accuracy"]}
    unit = stated.pop("unit")
    accuracies = {name: one and Distances(**one) for name, one in stated.items()}
    tables = [accuracy_table(f"Accuracy: {file}", accuracies, unit)]
    if document["changes"] is None:
        return OtherDays(words, {}, tables)
    what_changed = WhatChanged.from_document(document["changes"], document["chi_squared"])
    drawn = [replace(one, title=f"{one.title}: {file}") for one in change_figures(what_changed)]
    return OtherDays(
        words, {one.key: one for one in drawn}, [_changes(file, what_changed), *tables]
    )


def _changes(file: str, what_changed: WhatChanged) -> Table:
    rows = [
        (
            one.where,
            by_sd(one.value, one.sd, one.unit),
            size(0.5 * (one.high - one.low), one.unit, 2),
            unit_shown(one.unit),
            chance(one.p_value),
            ", ".join(other.words for other in one.alike),
        )
        for one in what_changed.found
    ]
    if not rows:
        rows = [("no change is seen", "", "", "", chance(what_changed.test.p_value), "")]
    head = ("what changed", "change", "U95", "unit", "p", "not distinguishable at these poses")
    return Table(f"What changed: {file}", head, tuple(rows))


def _history(document: Mapping[str, Any]) -> OtherDays:
    history = History.from_document(document)
    figures = {one.key: one for one in history_figures(history)}
    return OtherDays(
        [], figures, [replace(history_table(history), caption="History of the machine")]
    )


def _fleet(document: Mapping[str, Any]) -> OtherDays:
    fleet = Fleet.from_document(document)
    figure = fleet_figure(fleet)
    return OtherDays([fleet_words(fleet)], {figure.key: figure}, fleet_tables(fleet))

"""What was found of a result on other days, for its report: update, verifications, history,
fleet."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from loopcal.companions.life.fleet import Fleet
from loopcal.companions.life.history import History
from loopcal.companions.life.pages import (
    change_table,
    fleet_figure,
    fleet_tables,
    fleet_words,
    history_figures,
    history_table,
)
from loopcal.document.accuracy import Distances
from loopcal.document.result_document import ResultDocument
from loopcal.document.tables import machine_table, shown_parameters
from loopcal.estimation.result import UPDATED
from loopcal.figures.figure import Figure
from loopcal.figures.life import narrowed
from loopcal.files.result.deployed import FLEET, HISTORY, VERIFICATION
from loopcal.presentation.shown import Table, by_sd, chance, in_unit, significant, size, unit_shown
from loopcal.report.section import Section
from loopcal.report.source import Source
from loopcal.report.verification_page import UNITS, change_figures
from loopcal.statistics.changed import WhatChanged

Parts = tuple[list[str], list[Table | Figure]]


def other_days(source: Source) -> Section | None:
    """What a result, if it is an update, and its notes say of other days; None: nothing."""
    notes = [note for note in source.deployed if note.kind in _OF_KIND]
    if not notes and source.document.method_label != UPDATED:
        return None
    words, parts = _update(source.document)
    for number, note in enumerate(notes, 1):
        try:
            sentences, shown = _OF_KIND[note.kind](note.document)
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError):
            # What a damaged note raises depends on the damage, since its content is not checked.
            words.append(f"A note of this {note.kind} is damaged. Run the command again.")
            continue
        words += sentences
        parts += [
            replace(one, key=f"{one.key}_{number}") if isinstance(one, Figure) else one
            for one in shown
        ]
    parts.sort(key=lambda one: isinstance(one, Figure))
    return Section("later", "Other days", words, parts)


def _update(document: ResultDocument) -> Parts:
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
    drawn: list[Table | Figure] = []
    for unit in dict.fromkeys(unit for _, unit, _, _ in estimates):
        group = [one for one in estimates if one[1] == unit]
        sds = np.array([[in_unit(v, unit) for v in one[2:]] for one in group])
        key = f"sds_{UNITS.get(unit, 'others')}"
        figure = narrowed(key, unit_shown(unit), [one[0] for one in group], *sds.T)
        drawn += [] if figure is None else [figure]
    return [words], drawn


def _verification(document: Mapping[str, Any]) -> Parts:
    file, answers = document["readings"], document["verdict"]
    words = [f"{file}, {document['poses']} poses: {answers['headline']}"]
    words += [
        f"{file}: {answer['next']}"
        for name, answer in answers.items()
        if name != "headline" and answer["next"] and answer["passed"] is False
    ]
    unit, accuracy = document["accuracy"]["unit"], document["accuracy"]
    distances = {
        name: None if accuracy[name] is None else Distances(**accuracy[name])
        for name in ("nominal", "calibrated", "expected")
    }
    reached = machine_table(f"Accuracy: {file}", unit, distances)
    if document["changes"] is None:
        return words, [reached]
    what_changed = WhatChanged.from_document(document["changes"], document["chi_squared"])
    drawn = [replace(one, title=f"{one.title}: {file}") for one in change_figures(what_changed)]
    return words, [_changes(file, what_changed), reached, *drawn]


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


def _history(document: Mapping[str, Any]) -> Parts:
    history = History.from_document(document)
    table = replace(history_table(history), caption="History of the machine")
    changed = change_table(history)
    return [], [table, *([] if changed is None else [changed]), *history_figures(history)]


def _fleet(document: Mapping[str, Any]) -> Parts:
    fleet = Fleet.from_document(document)
    return [fleet_words(fleet)], [*fleet_tables(fleet), fleet_figure(fleet)]


_OF_KIND = {VERIFICATION: _verification, HISTORY: _history, FLEET: _fleet}

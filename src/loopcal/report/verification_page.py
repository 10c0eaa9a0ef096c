"""The page of a verification."""

from __future__ import annotations

from loopcal.figures.figure import Figure
from loopcal.figures.life import (
    Reach,
    changes,
)
from loopcal.presentation.shown import Table, in_unit, unit_shown
from loopcal.report.templates import Part, Section, section_page
from loopcal.statistics.changed import WhatChanged
from loopcal.statistics.verified import Verification

UNITS = {"m": "lengths", "rad": "angles"}


def verification_html(verification: Verification, title: str, files: str) -> str:
    """One self-contained page: the answers, what changed, and the accuracy; files: compared."""
    answers = Table(
        "Answers",
        ("question", "answer", "why", "what to do"),
        tuple(
            (name, {True: "yes", False: "no", None: "open"}[a.passed], a.words, a.next or "")
            for name, a in verification.verdict.items()
        ),
    )
    parts: list[Part] = [table for table in verification.tables if table.rows]
    if verification.changes is not None:
        lines = "\n".join(verification.changes.lines())
        parts = [lines, *change_figures(verification.changes), *parts]
    parts = [answers, *parts]
    section = Section(
        "l", f"Verification of {title}", [verification.headline, *verification.remarks], parts
    )
    return section_page("life", section, {"files": files, "poses": len(verification.poses)})


def change_figures(what_changed: WhatChanged) -> list[Figure]:
    """What changed, and what would not have been seen: one figure for lengths, one for angles."""
    drawn = [
        changes(key, unit_shown(unit), _reaches(what_changed, unit)) for unit, key in UNITS.items()
    ]
    return [figure for figure in drawn if figure is not None]


def _reaches(what_changed: WhatChanged, unit: str) -> list[Reach]:
    changed = {one.name: one for one in what_changed.found}
    reaches = []
    for one in what_changed.candidates:
        if one.unit != unit or one.smallest is None:
            continue
        change = changed.get(one.name)
        value = None if change is None else in_unit(change.value, unit)
        half = None if change is None else in_unit(0.5 * (change.high - change.low), unit)
        reaches.append(Reach(one.words, in_unit(one.smallest, unit), value, half))
    return reaches

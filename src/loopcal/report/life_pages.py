"""The pages of a verification and of machines of one type."""

from __future__ import annotations

import math
from statistics import NormalDist

import numpy as np

from loopcal.figures.figure import Figure
from loopcal.figures.life import Reach, changes, spread
from loopcal.life.fleet import Fleet
from loopcal.presentation.shown import by_sd, chance, in_unit, size, unit_shown
from loopcal.presentation.text_table import Table
from loopcal.report.section import Part, Section, section_page
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
    parts: list[Part] = [answers, *(table for table in verification.tables if table.rows)]
    if verification.changes is not None:
        lines = "\n".join(verification.changes.lines())
        parts = [lines, *change_figures(verification.changes), *parts]
    section = Section("l", f"Verification of {title}", [verification.headline], parts)
    return section_page("life", section, {"files": files, "poses": len(verification.poses)})


def change_figures(what_changed: WhatChanged) -> list[Figure]:
    """What changed, and what would not have been seen: one figure for each unit."""
    units = dict.fromkeys(one.unit for one in what_changed.candidates)
    drawn = [
        changes(UNITS.get(u, "others"), unit_shown(u), _reaches(what_changed, u)) for u in units
    ]
    return [figure for figure in drawn if figure is not None]


def fleet_html(fleet: Fleet, files: str) -> str:
    """One self-contained page: mean and spread of each parameter, and which machine is unusual."""
    about = {"files": files, "poses": ", ".join(str(one.poses) for one in fleet.machines)}
    parts: list[Part] = [fleet_figure(fleet), *fleet_tables(fleet)]
    title = f"Machines of one type: {fleet.machine}"
    return section_page("life", Section("l", title, [fleet_words(fleet)], parts), about)


def fleet_words(fleet: Fleet) -> str:
    """What the next machine needs."""
    return " ".join(str(fleet).split("\n\n")[-1].split())


def fleet_figure(fleet: Fleet) -> Figure:
    """Deviations of each machine."""
    deviations = {
        # inv_cdf is not defined at 0; 1e-300 is 37 sds, beyond any figure.
        one.name: np.array(
            [
                math.copysign(NormalDist().inv_cdf(0.5 * min(max(d.p_value, 1e-300), 1.0)), d.value)
                for d in one.deviations
            ]
        )
        for one in fleet.machines
    }
    unusual = {one.name for one in fleet.unusual}
    return spread([p.name for p in fleet.parameters], deviations, unusual)


def fleet_tables(fleet: Fleet) -> list[Table]:
    """The machines, and the parameters over them."""
    parameters = Table(
        "Parameters over the machines",
        ("parameter", "unit", "mean", "spread", "95 % interval", "prior sd", "poses"),
        tuple(
            (
                p.name,
                unit_shown(p.unit),
                by_sd(p.mean, p.mean_sd, p.unit),
                size(p.spread, p.unit, 2),
                f"{size(p.low, p.unit, 2)} to {size(p.high, p.unit, 2)}",
                size(p.prior_sd, p.unit, 2),
                str(p.poses),
            )
            for p in fleet.parameters
        ),
    )
    machines = Table(
        "Machines",
        ("machine", "poses", "p", "result"),
        tuple(
            (
                one.name,
                str(one.poses),
                chance(one.p_value),
                f"unusual: {', '.join(one.outstanding)}" if one.unusual else "like the others",
            )
            for one in fleet.machines
        ),
    )
    return [machines, parameters]


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

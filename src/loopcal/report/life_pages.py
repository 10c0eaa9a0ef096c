"""The pages of a verification and of machines of one type."""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import NormalDist

import numpy as np

from loopcal.document.tables import distances_shown
from loopcal.figures.figure import Figure, plotly_javascript
from loopcal.figures.life import Reach, changes, spread
from loopcal.files.versions import version
from loopcal.life.fleet import Fleet
from loopcal.presentation.rounding import significant
from loopcal.presentation.shown import by_sd, chance, in_unit, size, unit_shown
from loopcal.report.tables import Table
from loopcal.report.templates import environment, part, sha256
from loopcal.statistics.changed import WhatChanged
from loopcal.statistics.verified import Verification

UNITS = {"m": "lengths", "rad": "angles"}


def verification_html(found: Verification, title: str) -> str:
    """One self-contained page: the answers, what changed, and the accuracy."""
    answers = Table(
        "Answers",
        ("question", "answer", "why", "what to do"),
        tuple(
            (name, {True: "yes", False: "no", None: "open"}[a.passed], a.words, a.next or "")
            for name, a in found.verdict.items()
        ),
    )
    its = found.changes
    lines = [] if its is None else its.lines()
    figures = [] if its is None else change_figures(its)
    tables = [answers, *_tables(found)]
    return _page(f"Verification of {title}", [found.headline], figures, tables, lines)


def change_figures(found: WhatChanged) -> list[Figure]:
    """What changed, and what would not have been seen: one figure for each unit."""
    units = dict.fromkeys(one.unit for one in found.candidates)
    drawn = [changes(UNITS.get(u, "others"), unit_shown(u), _reaches(found, u)) for u in units]
    return [figure for figure in drawn if figure is not None]


def fleet_html(found: Fleet) -> str:
    """One self-contained page: mean and spread of each parameter, and which machine is unusual."""
    title = f"Machines of one type: {found.machine}"
    return _page(title, [fleet_words(found)], [fleet_figure(found)], fleet_tables(found))


def fleet_words(found: Fleet) -> str:
    """What the next machine needs."""
    return " ".join(str(found).split("\n\n")[-1].split())


def fleet_figure(found: Fleet) -> Figure:
    """Deviations of each machine."""
    deviations = {
        one.name: np.array([_normal(d.value, d.p_value) for d in one.deviations])
        for one in found.machines
    }
    unusual = {one.name for one in found.unusual}
    return spread([p.name for p in found.parameters], deviations, unusual)


def fleet_tables(found: Fleet) -> list[Table]:
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
            for p in found.parameters
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
            for one in found.machines
        ),
    )
    return [machines, parameters]


def _normal(value: float, p_value: float) -> float:
    """The normal deviate of the same sign and probability."""
    return math.copysign(-NormalDist().inv_cdf(0.5 * min(max(p_value, 1e-300), 1.0)), value)


def _reaches(found: WhatChanged, unit: str) -> list[Reach]:
    changed = {one.name: one for one in found.found}
    reaches = []
    for one in found.candidates:
        if one.unit != unit or one.smallest is None:
            continue
        its = changed.get(one.name)
        value = None if its is None else in_unit(its.value, unit)
        half = None if its is None else in_unit(0.5 * (its.high - its.low), unit)
        reaches.append(Reach(one.words, in_unit(one.smallest, unit), value, half))
    return reaches


def _tables(found: Verification) -> list[Table]:
    unit = unit_shown(found.unit)
    told = {"nominal": found.nominal, "calibrated": found.calibrated, "expected": found.expected}
    rows = tuple((n, *distances_shown(d, found.unit)) for n, d in told.items() if d is not None)
    tables = [Table("Accuracy", ("machine", f"mean [{unit}]", "rms", "95 %", "max"), rows)]
    placed = tuple(
        (
            one.name,
            by_sd(one.value, one.sd, one.unit),
            "unknown" if one.sd is None else size(one.sd, one.unit, 2),
            unit_shown(one.unit),
        )
        for one in found.placed
    )
    worst = tuple(
        (one.pose, size(one.distance, found.unit), significant(one.chi_squared, 3))
        for one in found.worst
    )
    tables.append(Table("Placed anew", ("parameter", "value", "sd", "unit"), placed))
    tables.append(Table("Worst poses", ("pose", f"distance [{unit}]", "chi-squared"), worst))
    return [table for table in tables if table.rows]


def _page(
    title: str,
    words: Sequence[str],
    figures: Sequence[Figure],
    tables: Sequence[Table],
    lines: Sequence[str] = (),
) -> str:
    program, drawing = plotly_javascript(), part("draw.js")
    return (
        environment()
        .get_template("life.html")
        .render(
            title=title,
            version=version(),
            words=words,
            lines=lines,
            drawn={"id": "l", "figures": {figure.key: figure for figure in figures}},
            tables=tables,
            style=part("style.css"),
            program=program,
            drawing=drawing,
            hashes=" ".join(f"'sha256-{sha256(text)}'" for text in (program, drawing)),
        )
    )

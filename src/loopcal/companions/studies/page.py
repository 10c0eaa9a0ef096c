"""The page of a study: every scenario's distributions, tables, first draw, and what they show."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from loopcal.arrays import Array
from loopcal.companions.studies.draws import first_draw
from loopcal.companions.studies.run import StudyDone
from loopcal.companions.studies.tables import MethodTable, Paired, ScenarioTable
from loopcal.estimation.result import FitResult
from loopcal.figures.figure import COLOURS, Figure, axis, ends, layout, shown_text, trace
from loopcal.figures.residuals import over_poses
from loopcal.figures.space import arrows
from loopcal.files.atomic import write_files
from loopcal.presentation.shown import Table, in_unit, percent, size, unit_shown
from loopcal.report.templates import Section, page

# Distributions of errors over many draws, method beside method, a printed draw among them.


def _bars(methods: Sequence[MethodTable], unit: str) -> Figure | None:
    """Middle 95 % of every error in this unit by method, on one scale; None where there are none.

    Open diamonds are errors of one draw in print.
    """
    every = [(m.method, [s for s in m.spreads if s.unit == unit]) for m in methods]
    shown = [(name, spreads) for name, spreads in every if spreads]
    if not shown:
        return None
    key, title = KINDS[unit]
    in_words = unit_shown(unit, fine=True)

    def at(values: Iterable[float]) -> Array:
        return np.array([in_unit(value, unit, fine=True) for value in values])

    data: list[dict[str, Any]] = []
    widest = {}
    for i, (method, spreads) in enumerate(shown):
        places = [k + 0.3 * (i - 0.5 * (len(shown) - 1)) for k in range(len(spreads))]
        means, low, high = (
            at(getattr(s, name) for s in spreads) for name in ("bias", "low", "high")
        )
        widest[method] = float((high - low).max())
        colour = COLOURS[i % len(COLOURS)]
        marker: dict[str, Any] = {"color": colour, "size": 8}
        lines = ends(means, low, high, thickness=3)
        data.append(trace("markers", method, places, means, error_y=lines, marker=marker))
        printed = [
            (x, s.published.error) for x, s in zip(places, spreads, strict=True) if s.published
        ]
        if printed:
            marker = {"symbol": "diamond-open", "color": colour, "size": 11, "line": {"width": 2}}
            x, errors = zip(*printed, strict=True)
            name = f"{method}, printed draw"
            data.append(trace("markers", name, np.array(x), at(errors), marker=marker))
    names = [s.name for s in shown[0][1]]
    widths_text = ", ".join(
        f"{method} up to {width:.3g} {in_words} wide" for method, width in widest.items()
    )
    return Figure(
        key,
        title,
        "Points are means over the draws, bars contain the middle 95 % of them, open diamonds "
        "are the published draw. A mean away from zero is bias. An invisible bar is too short "
        "for this scale.",
        f"{title} by method: {widths_text}.",
        tuple(data),
        layout(
            340,
            xaxis=axis(
                "",
                tickvals=list(range(len(names))),
                ticktext=[shown_text(name) for name in names],
            ),
            yaxis=axis(f"true minus estimate [{in_words}]", zeroline=True),
        ),
    )


PAGE = "study.html"
ROUNDING = 1e-12
"""Errors below this [SI] tell nothing of a method."""
KINDS = {"m": ("lengths", "Errors of lengths"), "rad": ("angles", "Errors of angles")}


def write_study_page(done: StudyDone) -> None:
    """Write study.html, one self-contained page, into the folder of a study.

    Raises InputError where it cannot be written.
    """
    write_files(done.folder, {PAGE: study_html(done).encode("utf-8")})


def study_html(done: StudyDone) -> str:
    """The page: nothing in it is asked of any network."""
    made = done.tables
    of_name = {scenario.name: scenario for scenario in done.study.scenarios}
    return page(
        "study.html",
        title=made.title,
        about={
            "folder": done.folder.name,
            "poses": ", ".join(dict.fromkeys(str(t.poses) for t in made.scenarios)),
        },
        draws=made.draws,
        seed=made.seed,
        scenarios=[
            _scenario(table, number, first_draw(of_name[table.scenario], made.seed))
            for number, table in enumerate(made.scenarios, 1)
        ],
    )


def _scenario(table: ScenarioTable, number: int, drawn: Mapping[str, FitResult]) -> dict[str, Any]:
    bars = (_bars(table.methods, unit) for unit in KINDS)
    parts = [*bars, *map(_method, table.methods), *map(_paired, table.paired)]
    title = f"{table.scenario} ({table.poses} poses)"
    examples = [
        Section(f"s{number}m{i}", f"First draw, {name}", (), (_residuals(one), _arrows(one)))
        for i, (name, one) in enumerate(drawn.items(), 1)
    ]
    return {"section": Section(f"s{number}", title, words(table), parts), "examples": examples}


def words(table: ScenarioTable) -> list[str]:
    """What the draws show in plain words, where a method does not help as well."""
    if all(s.rms < ROUNDING for method in table.methods for s in method.spreads):
        return [f"Every error is rounding, below {ROUNDING:g} m or rad: all methods are right."]
    sentences = []
    for pair in table.paired:
        first, second = pair.methods
        said = [a for a in pair.advantages if a.ratio is not None and a.ratio_high is not None]
        # The limits are the 5 % of the sentence below.
        better = [a.name for a in said if (a.ratio_high or 0.0) < 0.95]
        worse = [a.name for a in said if (a.ratio_low or 0.0) > 1.05]
        alike = [a.name for a in said if a.name not in (*better, *worse)]
        least = min((a.ratio or 0.0 for a in said if a.name in better), default=None)
        if better:
            sentences.append(
                f"{first} has smaller rms errors than {second} in {', '.join(better)} "
                f"(down to {least:.2g} of them)."
            )
        if alike:
            sentences.append(f"It does not help, within 5 %, in {', '.join(alike)}.")
        if worse:
            sentences.append(f"It is worse in {', '.join(worse)}.")
    for method in table.methods:
        failed = sum(method.failures.values())
        if failed:
            sentences.append(
                f"{method.method} did not converge in {failed} of {method.draws} draws."
            )
        if method.other_optimum:
            sentences.append(f"{method.method} ended at another optimum in {method.other_optimum}.")
        low = [s.name for s in method.spreads if s.held < 0.9 and s.bias != 0.0]
        if low:
            sentences.append(f"Intervals of {method.method} too narrow: {', '.join(low)}.")
        out = [s.name for s in method.spreads if s.published and s.published.outside]
        if out:
            sentences.append(
                f"The published draw of {method.method} is an outlier in {', '.join(out)}."
            )
    return sentences


def _method(table: MethodTable) -> Table:
    rows = []
    for s in table.spreads:
        values = [size(v, s.unit, fine=True) for v in (s.bias, s.sd, s.rms, s.low, s.high)]
        placed = "" if s.published is None else f"{s.published.percentile:.1f} %"
        rows.append((s.name, unit_shown(s.unit, fine=True), *values, percent(s.held, 1), placed))
    head = ("error", "unit", "bias", "sd", "rms", "2.5 %", "97.5 %", "held", "printed draw at")
    converged = table.draws - sum(table.failures.values())
    caption = f"{table.method}: {converged} of {table.draws} draws converged"
    return Table(caption, head, tuple(rows))


def _paired(pair: Paired) -> Table:
    first, second = pair.methods
    rows = []
    for a in pair.advantages:
        ratio = "" if a.ratio is None else f"{a.ratio:.2g} [{a.ratio_low:.2g}, {a.ratio_high:.2g}]"
        closer, low, high = (percent(v, 1) for v in (a.closer, a.closer_low, a.closer_high))
        rows.append((a.name, f"{closer} [{low}, {high}]", ratio))
    caption = f"{first} beside {second} on the same {pair.draws} draws"
    return Table(caption, ("error", "closer in", "rms ratio"), tuple(rows))


def _residuals(result: FitResult) -> Figure | None:
    # corrected readings close the loops to rounding, which shows no accuracy
    after, poses = result.residuals_after if result.fit.solver.exact else {}, result.dataset.poses
    return over_poses(result.residuals_before, after, poses, "SI", "Values of the loop equations")


def _arrows(result: FitResult) -> Figure | None:
    outputs = result.mechanism.outputs
    accuracy = result.accuracy_after
    if accuracy is None or accuracy.unit != "m" or len(outputs) not in (2, 3):
        return None
    points = np.array([result.dataset.readings[q] for q in outputs])
    differences = np.array([result.differences_after[q] for q in outputs])
    if not np.abs(differences).max(initial=0.0) > ROUNDING:
        return None
    return arrows(points, {"after": differences}, None, result.dataset.poses, "mm", 1e-3)

"""The tables of a study as text and as a document."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from loopcal.presentation.rounding import significant
from loopcal.presentation.shown import FINE
from loopcal.presentation.text_table import columns
from loopcal.studies.paired import Paired
from loopcal.studies.tables import END_POINT, MethodTable, ScenarioTable, Spread, StudyTables
from loopcal.units import from_si


def document(tables: StudyTables) -> dict[str, Any]:
    """The tables as plain data [SI], as `loopcal study --json` prints them."""
    return {"schema": 1, **asdict(tables)}


def summary(tables: StudyTables) -> str:
    """All tables, scenario by scenario, for reading."""
    lines = [f"{tables.title}: {tables.draws} draws of each scenario, seed {tables.seed}"]
    for scenario in tables.scenarios:
        lines += ["", *_scenario(scenario)]
    lines += ["", *_legend(tables)]
    return "\n".join(lines)


def _legend(tables: StudyTables) -> list[str]:
    spreads = [s for t in tables.scenarios for m in t.methods for s in m.spreads]
    lines = [
        "Errors are true minus estimate; bias is their mean.",
        "held: draws whose stated 95 % interval holds the truth.",
    ]
    if any(s.name == END_POINT for s in spreads):
        lines += [
            "end point: rms distance of predicted from true end point in a draw, mean under bias;",
            "held: coordinates of the end point within their stated 95 % interval.",
        ]
    if any(s.published is not None for s in spreads):
        lines += [
            "published: percentile of the published draw among these; ! is outside 0.1 to 99.9 %.",
        ]
    return lines


def _scenario(table: ScenarioTable) -> list[str]:
    lines = [f"{table.scenario} ({table.poses} poses)"]
    for method in table.methods:
        lines += ["", *(f"  {line}" for line in _method(method))]
    for pair in table.paired:
        lines += ["", *(f"  {line}" for line in _paired(pair))]
    return lines


def _method(table: MethodTable) -> list[str]:
    failed = sum(table.failures.values())
    head = f"{table.method}: {table.draws - failed} of {table.draws} draws converged"
    if failed:
        reasons = ", ".join(f"{reason} {n}" for reason, n in table.failures.items())
        head += f" (else {reasons})"
    if table.other_optimum:
        head += f"; {table.other_optimum} ended at another optimum than a fit from the truth"
    published = any(spread.published is not None for spread in table.spreads)
    rows = [["", "bias", "sd", "rms", "2.5 %", "97.5 %", "held"]]
    rows[0] += (["published"] if published else []) + ["unit"]
    rows += [_row(spread, published) for spread in table.spreads]
    return [head, *(columns(rows) if table.spreads else [])]


def _row(spread: Spread, published: bool) -> list[str]:
    unit = FINE.get(spread.unit, spread.unit)

    def shown(value: float | None) -> str:
        return "-" if value is None else significant(from_si(value, unit), 3)

    cells = [spread.bias, spread.sd, spread.rms, spread.low, spread.high]
    row = [spread.name, *map(shown, cells), f"{100 * spread.held:.1f} %"]
    if published:
        placed = spread.published
        mark = " !" if placed is not None and placed.outside else ""
        row.append("" if placed is None else f"{placed.percentile:.2f} %{mark}")
    return [*row, unit]


def _paired(pair: Paired) -> list[str]:
    first, second = pair.methods
    head = f"{first} against {second}, {pair.draws} draws in which both converged"
    rows = [["", "closer in", "rms ratio"]]
    for a in pair.advantages:
        share = f"{100 * a.closer:.1f} % [{100 * a.closer_low:.1f}, {100 * a.closer_high:.1f}]"
        ratio = "-"
        if a.ratio is not None and a.ratio_low is not None and a.ratio_high is not None:
            ends = f"{significant(a.ratio_low, 2)}, {significant(a.ratio_high, 2)}"
            ratio = f"{significant(a.ratio, 2)} [{ends}]"
        rows.append([a.name, share, ratio])
    return [head, *(columns(rows) if pair.advantages else [])]

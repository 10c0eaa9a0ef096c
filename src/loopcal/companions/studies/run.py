"""From a study file to its tables: the path behind `loopcal study`."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from loopcal.companions.studies import study_parts
from loopcal.companions.studies.draws import Columns, run_draws
from loopcal.companions.studies.paired import Paired
from loopcal.companions.studies.study_file import Study, read_study
from loopcal.companions.studies.tables import (
    END_POINT,
    MethodTable,
    ScenarioTable,
    Spread,
    StudyTables,
    tables,
)
from loopcal.errors import InputError, Unfinished, UsageError
from loopcal.execution.executor import Executor
from loopcal.execution.local import Processes
from loopcal.files.machines.python_function import load_function
from loopcal.files.outputs import refuse_foreign
from loopcal.presentation.shown import FINE, columns, significant
from loopcal.units import from_si

Progress = Callable[[int, int], None]
"""Called with how many draws are done, and how many were to be done in this run."""


@dataclass(frozen=True, eq=False)
class StudyDone:
    """A study that ran to its end: what it is, its tables, and the folder with all draws."""

    study: Study
    tables: StudyTables
    folder: Path
    text: str
    document: dict[str, Any]


def run_study(
    path: str | Path,
    *,
    draws: int | None = None,
    executor: Executor | None = None,
    sharing: Callable[[Executor], None] | None = None,
    out: str | Path | None = None,
    function: str | None = None,
    progress: Progress | None = None,
) -> StudyDone:
    """Run the draws of a study that its folder does not hold yet, and make its tables.

    draws: of each scenario, instead of the study's; executor: who does them, by default processes,
    one for each core; sharing: called with it once the study can be run; out: the folder, by
    default NAME-study beside the study NAME.toml. Neither the executor nor where a run was stopped
    changes any value.

    Raises InputError for a study or folder that cannot be used, and Unfinished for what goes wrong
    once draws are written, which are kept.
    """
    if draws is not None and draws < 1:
        raise UsageError("draws are counted from 1", remedy="give 1 or more")
    study = read_study(path, mechanism=None if function is None else load_function(function))
    _check(study)
    draws = draws or study.draws
    if executor and sharing:
        sharing(executor)
    folder = _default_folder(study) if out is None else Path(out)
    # Refused before the first draw, not after hours of them.
    refuse_foreign(*(folder / name for name in study_parts.FILES))
    study_parts.open_folder(folder, study)
    try:
        return _drawn(study, draws, folder, executor, progress)
    except InputError as error:
        raise Unfinished.of(error) from None  # the draws until here are kept


def _drawn(
    study: Study, draws: int, folder: Path, executor: Executor | None, progress: Progress | None
) -> StudyDone:
    """Every draw that the folder does not hold yet, and the tables of all."""
    parts = study_parts.parts_of(len(study.scenarios), draws)
    missing = study_parts.missing_parts(folder, parts)
    methods = len(study.methods)
    total, done = sum(part.last - part.first for part in missing), 0
    with closing((executor or Processes()).run(_columns, study, missing)) as finished:
        for piece in finished:
            part = missing[piece.number]
            study_parts.write_part(folder, part, piece.value)
            done += part.last - part.first
            if progress:
                progress(done * methods, total * methods)
    made = tables(study, draws, study_parts.join_parts(folder, parts))
    text, study_document = summary(made), document(made)
    study_parts.write_summary(folder, study_document, text)
    return StudyDone(study, made, folder, text, study_document)


def _default_folder(study: Study) -> Path:
    if study.path is None:
        return Path("loopcal-study")
    return study.path.parent / f"{study.path.stem}-study"


def _check(study: Study) -> None:
    """Meet here, before any work, what would stop the first draw of a scenario."""
    for i, scenario in enumerate(study.scenarios):
        try:
            run_draws(scenario, study.seed, [0])
        except InputError as error:
            raise error.at(f"{study.name}: scenarios[{i + 1}] ({scenario.name})") from None


def _columns(study: Study, part: study_parts.Part) -> Columns:
    scenario = study.scenarios[part.scenario]
    try:
        return run_draws(scenario, study.seed, range(part.first, part.last))
    except InputError as error:
        raise error.at(f"{study.name}: scenarios[{part.scenario + 1}]") from None


# The tables of a study as text and as a document.


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

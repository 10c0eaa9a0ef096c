"""From a study file to its tables: the path behind `loopcal study`."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from loopcal.companions.studies.draws import Columns, run_draws
from loopcal.companions.studies.study_file import Study, read_study
from loopcal.companions.studies.tables import (
    END_POINT,
    MethodTable,
    Paired,
    ScenarioTable,
    Spread,
    StudyTables,
    tables,
)
from loopcal.errors import InputError, Unfinished, UsageError
from loopcal.execution.executor import Executor, Progress
from loopcal.execution.local import Processes
from loopcal.files.atomic import write_atomic, write_files
from loopcal.files.json_files import marked_json
from loopcal.files.machines.python_function import load_function
from loopcal.files.outputs import refuse_foreign
from loopcal.files.tables.writer import table_bytes
from loopcal.presentation.shown import FINE, columns, significant
from loopcal.units import from_si

if TYPE_CHECKING:
    import polars as pl


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
    one for each core; sharing: called with it once the study can be run; progress: with how many
    draws are done, and how many were to be done in this run; out: the folder, by
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
    refuse_foreign(*(folder / name for name in FILES))
    open_folder(folder, study)
    try:
        return _drawn(study, draws, folder, executor, progress)
    except InputError as error:
        raise Unfinished.of(error) from None  # the draws until here are kept


def _drawn(
    study: Study, draws: int, folder: Path, executor: Executor | None, progress: Progress | None
) -> StudyDone:
    """Every draw that the folder does not hold yet, and the tables of all."""
    parts = parts_of(len(study.scenarios), draws)
    missing = missing_parts(folder, parts)
    methods = len(study.methods)
    total, done = sum(part.last - part.first for part in missing), 0
    with closing((executor or Processes()).run(_columns, study, missing)) as finished:
        for piece in finished:
            part = missing[piece.number]
            write_part(folder, part, piece.value)
            done += part.last - part.first
            if progress:
                progress(done * methods, total * methods)
    made = tables(study, draws, join_parts(folder, parts))
    text, study_document = summary(made), document(made)
    write_summary(folder, study_document, text)
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


def _columns(study: Study, part: Part) -> Columns:
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


# The folder of a study: parts written as they are done, so that a study can stop and go on.
#
# study.json states the fingerprint of the study; parts/ holds one Parquet file per piece of work,
# whole or not at all; draws.parquet has all rows, scenario by scenario and draw by draw.


Column = Sequence[str] | NDArray[np.float64]
# The numbers of a draw depend on no part: seed, scenario and number decide (docs/decisions/0007).
CHUNK = 50
"""Draws in a part: a few seconds of work at most, lost when a study is killed."""
MOST_DRAWS = 10_000_000
"""Of all scenarios together."""
FILES = ("study.json", "draws.parquet", "summary.json", "summary.txt", "study.html")
TEXTS = ("scenario", "method", "reason")


@dataclass(frozen=True, order=True)
class Part:
    """Draws first to last, without last, of the scenario at this position."""

    scenario: int
    first: int
    last: int

    @property
    def file(self) -> str:
        """Name of its file."""
        return f"{self.scenario:03d}-{self.first:07d}-{self.last:07d}.parquet"


def parts_of(scenarios: int, draws: int) -> list[Part]:
    """All parts of a study with so many draws of each scenario, in the order of their rows.

    Raises InputError for more draws than can be listed.
    """
    if scenarios * draws > MOST_DRAWS:
        raise InputError(
            f"the study has {scenarios * draws} draws; the limit is {MOST_DRAWS}",
            code="too-large",
            remedy="use fewer draws per scenario or fewer scenarios",
        )
    return [
        Part(scenario, first, min(first + CHUNK, draws))
        for scenario in range(scenarios)
        for first in range(0, draws, CHUNK)
    ]


def open_folder(folder: Path, study: Study) -> None:
    """Make the folder of a study, or find that it is this study's already.

    Raises InputError for a folder of another study, or of this one before it was changed.
    """
    path = folder / "study.json"
    if path.exists():
        try:
            stated = json.loads(path.read_text("utf-8"))["fingerprint"]
        except (OSError, ValueError, KeyError, TypeError):
            stated = None
        if stated != study.fingerprint:
            raise InputError(
                "this folder holds draws of another study, or of another version of this study "
                "or of loopcal",
                code="unreadable-file",
                place=str(folder),
                remedy="choose another folder with --out, or delete this one",
            ).offering("--out", f"{folder}-2")
        return
    about = {"schema": 1, "title": study.title, "fingerprint": study.fingerprint}
    write_atomic(path, marked_json(about))


def missing_parts(folder: Path, parts: Sequence[Part]) -> list[Part]:
    """The parts that have not been written yet."""
    written = {path.name for path in (folder / "parts").glob("*.parquet")}
    return [part for part in parts if part.file not in written]


def write_part(folder: Path, part: Part, columns: Mapping[str, Column]) -> None:
    """Write one part, whole or not at all."""
    write_atomic(folder / "parts" / part.file, table_bytes(columns, ".parquet"))


def join_parts(folder: Path, parts: Sequence[Part]) -> dict[str, Column]:
    """All rows of the parts, in their order, written to draws.parquet and returned.

    Parameters that only some scenarios have are NaN elsewhere. Raises InputError for a part that
    cannot be read.
    """
    import polars as pl

    frames = [_frame(folder / "parts" / part.file) for part in parts]
    frame = pl.concat(frames, how="diagonal")
    out = io.BytesIO()
    frame.with_columns(
        pl.col("draw", "iterations").cast(pl.Int64),
        pl.col("converged", "other_optimum").cast(pl.Boolean),
    ).write_parquet(out)
    write_atomic(folder / "draws.parquet", out.getvalue())
    return {
        name: frame[name].to_list()
        if name in TEXTS
        else frame[name].cast(pl.Float64).fill_null(np.nan).to_numpy()
        for name in frame.columns
    }


def write_summary(folder: Path, document: Mapping[str, Any], text: str) -> None:
    """Write the tables of a study beside its draws: summary.json and summary.txt."""
    words = {"summary.txt": text + "\n"}
    write_files(folder, {**words, "summary.json": marked_json(document, words)})


def _frame(path: Path) -> pl.DataFrame:
    import polars as pl

    try:
        return pl.read_parquet(path, glob=False)
    except (pl.exceptions.PolarsError, OSError) as error:
        raise InputError(
            f"this part of the study cannot be read ({str(error).splitlines()[0]})",
            code="unreadable-file",
            place=str(path),
            remedy="delete the file and run the study again; only this part is recomputed",
        ) from None

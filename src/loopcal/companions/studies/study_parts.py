"""The folder of a study: parts written as they are done, so that a study can stop and go on.

study.json states the fingerprint of the study; parts/ holds one Parquet file per piece of work,
whole or not at all; draws.parquet has all rows, scenario by scenario and draw by draw.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from loopcal.companions.studies.study_file import Study
from loopcal.errors import InputError
from loopcal.files.atomic import write_atomic, write_files
from loopcal.files.json_writer import marked_json
from loopcal.files.tables.writer import table_bytes

if TYPE_CHECKING:
    import polars as pl

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
            )
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

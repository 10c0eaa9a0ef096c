"""No text that we write into CSV is a formula to a spreadsheet, and ids come back as they were."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from loopcal.companions.robot.exports.tables import csv_text
from loopcal.files.tables.readers import read_dataset
from loopcal.files.tables.writer import LARGE, table_bytes
from loopcal.measurements.poses import cell_text, pose_id

EVIL = (
    "=1+1",
    "+1-1",
    "-x",
    "@SUM(A1)",
    "=cmd|' /C calc'!A0",
    "-",
    "--1",
    "+a",
    "@",
    "='=",
    "=a,b",
)
PLAIN = ("-1", "+2.5", "-1e-3", "wall-1", "13", "'quoted'", "'", "1.10", "a=b", "−1")


@pytest.mark.parametrize("ending", [".csv", ".tsv"])
@pytest.mark.parametrize("rows", [len(EVIL), LARGE])
def test_ids_are_no_formulas_and_come_back(ending: str, rows: int, tmp_path: Path) -> None:
    ids = [*EVIL, *PLAIN, *map(str, range(rows - len(EVIL) - len(PLAIN)))]
    values = np.linspace(-1.0, 1.0, len(ids))
    path = tmp_path / f"p{ending}"
    path.write_bytes(table_bytes({"pose": ids, "=q": values}, ending))
    with path.open(encoding="utf-8", newline="") as file:
        cells = list(csv.reader(file, delimiter="\t" if ending == ".tsv" else ","))
    assert not any(cell[0][:1] in "=+@" for cell in cells if cell[0] != "+2.5")
    assert cells[0][1] == "'=q"
    found = read_dataset(path, {"q": "=q"}, pose="pose")
    assert list(found.poses) == [pose_id(one) for one in ids]
    assert list(found.poses[: len(EVIL)]) == list(EVIL)
    assert (found["q"] == values).all()


@pytest.mark.parametrize("text", PLAIN)
def test_what_is_no_formula_stays(text: str) -> None:
    assert cell_text(text) == text


def test_parquet_holds_ids_as_they_are(tmp_path: Path) -> None:
    path = tmp_path / "p.parquet"
    path.write_bytes(table_bytes({"pose": EVIL, "q": np.linspace(0.0, 1.0, len(EVIL))}, ".parquet"))
    assert read_dataset(path, {"q": "q"}, pose="pose").poses == EVIL


def test_names_of_exported_joints_are_no_formulas() -> None:
    assert csv_text([["joint", "zero"], ["=1+1", "-0.5"]]).splitlines()[1] == "'=1+1,-0.5"

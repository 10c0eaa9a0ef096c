"""Units survive saving: later readings of a saved result are read as those of the calibration."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import loopcal as lc
from loopcal.companions.life.update_files import run_update
from loopcal.units import from_si
from loopcal.workflow.checking import run_prediction, run_verification
from tests.reference.simulated import planar_arm
from tests.refusals import refused

ARM = planar_arm(30)
SDS = {"xP": 1e-4, "yP": 1e-4, "phi2": 1e-3, "phi3": 1e-3}
DATA = ARM.read(SDS, 1)
UNITS = {"xP": "mm", "yP": "inch", "phi2": "deg", "phi3": "mrad"}
NAMED = {"xP": "X mm", "yP": "Y", "phi2": "J1", "phi3": "J2"}
WRITTEN = {q: from_si(DATA.readings[q], unit) for q, unit in UNITS.items()}


def written(path: Path, columns: dict[str, Any], mark: str = ",", head: bool = True) -> Path:
    lines = [mark.join(columns)] if head else []
    rows = zip(*columns.values(), strict=True)
    path.write_text("\n".join([*lines, *(mark.join(map(str, row)) for row in rows)]) + "\n")
    return path


def renamed(path: Path) -> lc.Dataset:
    written(path, {NAMED[q]: v for q, v in WRITTEN.items()})
    columns = {q: {"column": NAMED[q], "unit": u} for q, u in UNITS.items()}
    return lc.read_dataset(path, columns)


def in_units(path: Path) -> lc.Dataset:
    return lc.read_dataset(written(path, WRITTEN), units=UNITS)


def by_number(path: Path) -> lc.Dataset:
    written(path, {"id": [f"p{i}" for i in range(30)], **WRITTEN}, ";", head=False)
    columns = {q: i for i, q in enumerate(WRITTEN, 2)}
    return lc.read_dataset(path, columns, pose=1, units=UNITS, header=False, delimiter=";")


def with_sds(path: Path) -> lc.Dataset:
    written(path, {**WRITTEN, "u": np.full(30, 200.0)})
    columns: dict[str, Any] = {q: {"column": q, "unit": u} for q, u in UNITS.items()}
    columns["xP"] |= {"sd_column": "u", "sd_unit": "um", "coverage": 2.0}
    return lc.read_dataset(path, columns)


def arrays(path: Path) -> lc.Dataset:
    written(path, WRITTEN)
    return lc.Dataset.from_arrays(WRITTEN, units=UNITS)


def arrays_with_ids(path: Path) -> lc.Dataset:
    table = {"nr": [f"p{i}" for i in range(30)], **WRITTEN}
    written(path, table)
    return lc.Dataset.from_arrays(table, units=UNITS, poses="nr")


def replaced(path: Path) -> lc.Dataset:
    """A column read as SI by mistake, and then given its unit."""
    written(path, WRITTEN)
    most = {q: u for q, u in UNITS.items() if q != "xP"}
    data = lc.read_dataset(path, units=most)
    return data.with_readings({"xP": data["xP"]}, units={"xP": "mm"})


def some_poses(path: Path) -> lc.Dataset:
    return in_units(path).take(np.arange(30))


def in_si(path: Path) -> lc.Dataset:
    return lc.Dataset.from_arrays(lc.read_dataset(written(path, dict(DATA.readings))).readings)


Reader = Callable[[Path], lc.Dataset]
READERS: list[Reader] = [
    renamed,
    in_units,
    by_number,
    with_sds,
    arrays,
    arrays_with_ids,
    replaced,
    some_poses,
    in_si,
]
WRITERS: dict[str, Callable[[lc.Result, Path], Any]] = {
    "write_result": lc.write_result,
    "save": lambda result, folder: result.save(folder, report=False),
}


@pytest.mark.parametrize(
    ("reader", "writer"),
    list(zip(READERS, cycle(WRITERS), strict=False)),
    ids=lambda one: getattr(one, "__name__", one),
)
def test_the_same_file_says_the_same_of_a_saved_result(
    reader: Reader, writer: str, tmp_path: Path
) -> None:
    file, folder = tmp_path / "poses.csv", tmp_path / "r"
    data = reader(file)
    nominal = ARM.off(2e-3, 2e-3)
    result = lc.calibrate(nominal, data, noise=SDS, method="implicit-loop")
    WRITERS[writer](result, folder)
    there = lc.verify(result, data)
    joints = {q: v for q, v in data.readings.items() if q not in ARM.truth.outputs}
    expected = lc.predict(result, replace(data, readings=joints, sds={}))
    for verified in (lc.verify(folder, file), lc.verify(result, file)):
        assert verified.document()["accuracy"] == there.document()["accuracy"]
    assert run_verification(folder, file).document()["accuracy"] == there.document()["accuracy"]
    for predicted in (
        lc.predict(folder, file),
        run_prediction(folder, file, out=None, function=None),
    ):
        assert all(np.array_equal(v, expected.outputs[q]) for q, v in predicted.outputs.items())
    updated = lc.update(result, data)
    assert dict(lc.update(folder, file).value) == dict(updated.value)
    again = run_update(folder, file, out=tmp_path / "u").result
    assert dict(again.value) == dict(updated.value)
    # and the update knows them too
    assert (
        lc.verify(tmp_path / "u", file).document()["accuracy"]
        == (lc.verify(again, data).document()["accuracy"])
    )


@pytest.mark.parametrize("table", [dict, str], ids=["a table", "a path"])
def test_units_given_to_calibrate_survive(table: type, tmp_path: Path) -> None:
    file = written(tmp_path / "poses.csv", WRITTEN)
    given = WRITTEN if table is dict else str(file)
    result = lc.calibrate(ARM.truth, given, units=UNITS, noise=SDS, method="implicit-loop")
    result.save(tmp_path / "r", report=False)
    data = lc.read_dataset(file, units=UNITS)
    verified = lc.verify(tmp_path / "r", file).document()
    assert verified["accuracy"] == lc.verify(result, data).document()["accuracy"]


def test_a_file_whose_units_nothing_says_is_refused(tmp_path: Path) -> None:
    file = written(tmp_path / "poses.csv", WRITTEN)
    result = lc.calibrate(ARM.truth, DATA, noise=SDS, method="implicit-loop")
    result.save(tmp_path / "r", report=False)
    for use in (lc.verify, lc.update, run_verification):
        with refused("implausible-unit", "xP", "millimetres", "units="):
            use(tmp_path / "r", file)

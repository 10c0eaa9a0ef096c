"""Columns of load, tool and temperature: what a project makes of them, in a sentence each."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import loopcal as lc
from loopcal.workflow.beginning.initial import InitialProject
from tests.reference import dh_arm
from tests.workflow.beginning.test_initial import NAMES, dh, of, table

POSES = 40


@pytest.fixture(scope="module")
def columns() -> dict[str, Any]:
    joints = dh_arm.poses()[:POSES]
    points = dh_arm.seen(joints, sd=5e-5)[:, :3, 3]
    return of(np.degrees(joints), [f"{n} [deg]" for n in NAMES]) | of(1e3 * points, "xyz")


def begun(folder: Path, columns: dict[str, Any], **more: Any) -> InitialProject:
    return lc.init(table(folder / "poses.csv", columns | more), dh=dh(folder), out=folder / "p")


def said(made: InitialProject, column: str) -> str:
    (words,) = [words for words in made.remarks if f"'{column}'" in words]
    return words


STEPS = np.repeat([3.0, 8.0], POSES // 2)
WARM = np.linspace(18.0, 25.0, POSES)


@pytest.mark.parametrize("name", ["payload [kg]", "Traglast", "load_kg", "负载 [kg]", "m_P (kg)"])
def test_a_payload_weighs_in_each_pose(name: str, tmp_path: Path, columns: Any) -> None:
    made = begun(tmp_path, columns, **{name: STEPS})
    assert "is the payload, 3 to 8 kg" in said(made, name)
    project = lc.read_project(tmp_path / "p/project.toml")
    assert project.mechanism.payload == "payload"
    assert lc.load_dataset(project).dataset["payload"].tolist() == STEPS.tolist()
    terms = {term.name: term for term in lc.structured(project.mechanism).terms}
    assert all(name.endswith("_yield") for name in terms["compliance"].parameters)


@pytest.mark.parametrize(
    ("name", "zero"),
    [("T_amb [°C]", 0.0), ("Temperatur", 0.0), ("temp_c", 0.0), ("Lufttemp. [K]", 273.15)],
)
def test_lengths_expand_with_a_temperature(
    name: str, zero: float, tmp_path: Path, columns: Any
) -> None:
    made = begun(tmp_path, columns, **{name: WARM + zero})
    assert "is the temperature" in said(made, name)
    assert not any("worse than its drawing" in words for words in made.remarks)
    project = lc.read_project(tmp_path / "p/project.toml")
    assert project.mechanism.pose_constants == {"temperature": "K"}
    assert project.mechanism.effects == {"thermal": ("thermal_expansion",)}
    assert "temperature [degC]" in str(made)
    read = lc.load_dataset(project).dataset["temperature"]
    assert read == pytest.approx(WARM + 273.15)


def test_tools_are_counted(tmp_path: Path, columns: Any) -> None:
    made = begun(tmp_path, columns, tool=["A", "B"] * (POSES // 2))
    assert "names 2 tools and takes no part" in said(made, "tool")
    assert not lc.read_project(tmp_path / "p/project.toml").mechanism.pose_constants


@pytest.mark.parametrize(
    ("name", "values", "words"),
    [
        ("payload [kg]", 0.0 * STEPS + 5.0, "is 5 kg in every row"),
        ("payload [kg]", STEPS - 5.0, "takes no part"),
        ("payload [kg]", np.where(np.arange(POSES) == 3, np.nan, STEPS), "takes no part"),
        ("temp", 10.0 * WARM, "takes no part"),
        ("temp", 0.0 * WARM + 21.0, "is 21 degC in every row"),
    ],
)
def test_what_varies_not_or_is_none_takes_no_part(
    name: str, values: Any, words: str, tmp_path: Path, columns: Any
) -> None:
    cells = ["" if np.isnan(v) else f"{v:.9f}" for v in values]
    made = begun(tmp_path, columns, **{name: cells})
    assert words in said(made, name)
    mechanism = lc.read_project(tmp_path / "p/project.toml").mechanism
    assert not mechanism.pose_constants


def test_a_share_of_the_largest_load_is_no_mass(tmp_path: Path, columns: Any) -> None:
    made = begun(tmp_path, columns, **{"load [%]": STEPS})
    assert not [words for words in made.remarks if "payload" in words]

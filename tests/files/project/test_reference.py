"""The references of project and study files: each table is made of its declaration."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from loopcal.companions.studies.study_file import MethodTable, Published, ScenarioTable, StudyTables
from loopcal.files.machines.parameter_entries import StatedParameter, StatedPrior
from loopcal.files.project.data_table import DataColumn, DataTable, SourceInstrument, SourceTable
from loopcal.files.project.fit_table import FitTable, Validation
from loopcal.files.project.noise_table import StatedNoise
from loopcal.files.project.plan_table import PlanTable, VerdictTable, sight, span
from loopcal.files.project.project_schema import ModelTable, ProjectTables, RecordTable
from loopcal.files.project.simulation_table import SimulationTable, driven_range
from loopcal.keys import arguments
from loopcal.measurements.datasheet import Tracker, encoder_sd
from tests.key_tables import REFERENCE, assert_stated, named

MAKERS: dict[str, dict[str, Callable[..., Any]]] = {
    "project-file.md": {
        "data": DataTable,
        "column": DataColumn,
        "source": SourceTable,
        "source-instrument": SourceInstrument,
        "noise": StatedNoise,
        "tracker": Tracker.of,
        "encoder": encoder_sd,
        "parameters": StatedParameter,
        "prior": StatedPrior,
        "fit": FitTable,
        "validation": Validation,
        "verdict": VerdictTable,
        "range": span,
        "plan": PlanTable,
        "sight": sight,
        "record": RecordTable,
        "model": ModelTable,
        "simulation": SimulationTable,
        "driven": driven_range,
    },
    "study-file.md": {
        "study": StudyTables,
        "scenario": ScenarioTable,
        "method": MethodTable,
        "published": Published,
    },
}
ALL = [(page, name) for page, makers in MAKERS.items() for name in makers]


@pytest.mark.parametrize(("page", "name"), ALL)
def test_a_table_of_the_reference_is_its_declaration(page: str, name: str) -> None:
    assert_stated(page, name, MAKERS[page][name])


@pytest.mark.parametrize("page", MAKERS)
def test_every_table_of_the_page_is_declared(page: str) -> None:
    assert sorted(named(page)) == sorted(MAKERS[page])


def test_every_table_of_a_project_has_a_section() -> None:
    text = (REFERENCE / "project-file.md").read_text("utf-8")
    stated = [a.written for a in arguments(ProjectTables)]
    tables = [key for key in stated if key not in ("schema", "title")]
    assert [key for key in tables if f"[{key}" not in text] == []

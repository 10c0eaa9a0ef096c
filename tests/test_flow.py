"""The picture of how a calibration flows is what the code does."""

from __future__ import annotations

import inspect
import os
import sys
from fnmatch import fnmatch
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import pytest

from loopcal.estimation import steps
from loopcal.workflow.calibration import Request, run_calibration
from tests.documented_rows import DOCS
from tests.flow_picture import ABOVE, BELOW, COMPANIONS, STEPS, VALUES, Step, drawing, named
from tests.test_architecture import MODULES, PACKAGE, imported_by, reached_from

PICTURE = DOCS / "explanation/how-a-calibration-flows.svg"
PROJECT = DOCS.parent / "examples/planar/project.toml"


def parts(step: Step) -> list[Any]:
    """The functions of a step, properties and tables of functions opened."""
    made: list[Any] = []
    for one in map(named, step.functions):
        opened = one.fget if isinstance(one, property) else one
        made += opened if isinstance(opened, tuple) else [opened]
    return made


def written_types(function: Any) -> tuple[str, str]:
    """What a function takes, and what it returns, as they are written."""
    signature = inspect.signature(function)
    taken = " ".join(str(one.annotation) for one in signature.parameters.values())
    return taken, str(signature.return_annotation)


@pytest.mark.parametrize("number", range(len(STEPS)))
def test_a_step_leads_from_one_value_to_the_next(number: int) -> None:
    before, after = (named(value.type).__name__ for value in VALUES[number : number + 2])
    written = [written_types(function) for function in parts(STEPS[number])]
    assert any(before in taken for taken, _ in written), f"no function takes {before}"
    assert any(after in given for _, given in written), f"no function returns {after}"


def test_the_steps_before_a_fit_are_those_of_the_picture() -> None:
    (step,) = (step for step in STEPS if "{steps}" in step.words)
    assert set(steps.STEPS) <= set(parts(step))


def test_a_calibration_ends_the_steps_in_this_order(tmp_path: Path) -> None:
    first = [parts(step)[0] for step in STEPS]
    codes = [getattr(function, "__func__", function).__code__ for function in first]
    ended: list[CodeType] = []

    def note(frame: FrameType, event: str, _: object) -> None:
        if event == "return" and frame.f_code in codes and frame.f_code not in ended:
            ended.append(frame.f_code)

    sys.setprofile(note)
    try:
        request = Request(method="implicit-loop")
        run_calibration(PROJECT, request, out=tmp_path / "result")
    finally:
        sys.setprofile(None)
    assert [code.co_qualname for code in ended] == [code.co_qualname for code in codes]


def companions_in(modules: set[str]) -> set[str]:
    """The companions among some modules, named by their dots."""
    stems = [f.replace("/", ".") for every in COMPANIONS.values() for f in every]
    patterns = [p for stem in stems for p in (stem, f"{stem}.*")]
    return {module for module in modules if any(fnmatch(module, p) for p in patterns)}


def test_the_core_does_not_import_its_companions() -> None:
    imported = imported_by(MODULES)
    for step in STEPS:
        for name in step.functions:
            reached = reached_from(name.partition(":")[0].removeprefix("loopcal."), imported)
            assert companions_in(reached) == set(), name
    assert companions_in({"companions.planning.plan", "companions", "report.page"}) == {
        "companions.planning.plan"
    }


def test_every_folder_is_on_the_picture() -> None:
    shown = {f.split("/")[0] for step in STEPS for f in step.folders} | {*BELOW, *ABOVE}
    shown |= {f.split("/")[0] for every in COMPANIONS.values() for f in every}
    folders = {path.name for path in PACKAGE.iterdir() if (path / "__init__.py").exists()}
    assert shown == folders, "draw it in tests/flow_picture.py"


def test_the_picture_is_drawn_from_the_code() -> None:
    if os.environ.get("LOOPCAL_REMAKE_GOLDEN"):
        PICTURE.write_text(drawing(), "utf-8")
    assert PICTURE.read_text("utf-8") == drawing()

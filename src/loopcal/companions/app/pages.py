"""The pages of the app in their order: a row for each step of the work."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from loopcal.companions.app import steps
from loopcal.companions.app.steps import Light, State
from loopcal.companions.app.view import View
from loopcal.companions.app.views import (
    check,
    data,
    deploy,
    diagnose,
    fit,
    history,
    plan,
    robot,
    validate,
)


@dataclass(frozen=True)
class Page:
    """words: what is done there; light: how its step stands; show: draws it."""

    label: str
    words: str
    light: Light
    show: Callable[[View], None]

    @property
    def key(self) -> str:
        """Its name in the code."""
        return self.label.lower()


PAGES = (
    Page(
        "Robot",
        "Describe the robot: a URDF, a table of Denavit-Hartenberg parameters, or a type.",
        steps.made("a robot"),
        robot.show,
    ),
    Page(
        "Data",
        "Give the readings. loopcal recognises columns and units; correct what is wrong.",
        steps.data,
        data.show,
    ),
    Page(
        "Plan",
        "Choose which poses to measure. Skip this step if you have measured already.",
        steps.ran("plan", "which poses to measure"),
        plan.show,
    ),
    Page(
        "Check",
        "See what the readings can determine, before a fit.",
        steps.checked,
        check.show,
    ),
    Page(
        "Fit",
        "Calibrate, and read whether you can use the result.",
        steps.fit,
        fit.show,
    ),
    Page(
        "Diagnose",
        "Find what does not fit. Drag over points to select poses; all figures follow.",
        steps.diagnose,
        diagnose.show,
    ),
    Page(
        "Validate",
        "See how good the calibration is where nothing was measured.",
        steps.validate,
        validate.show,
    ),
    Page(
        "Deploy",
        "Take the result to the robot: files for its controller, and corrected programs.",
        steps.deploy,
        deploy.show,
    ),
    Page(
        "History",
        "See what was done here, undo it, and follow the machine over the years.",
        steps.ran("history", "the machine over time"),
        history.show,
    ),
)
BY_KEY = {page.key: page for page in PAGES}


@dataclass(frozen=True)
class Step:
    """How a step stands; light: of `LIGHTS`; words: why."""

    key: str
    label: str
    light: str
    words: str


def stand(state: State) -> list[Step]:
    """All steps in their order."""
    return [
        Step(page.key, page.label, *steps.never_better(page.light(state), state)) for page in PAGES
    ]

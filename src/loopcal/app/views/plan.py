"""Which poses to measure."""

from __future__ import annotations

from nicegui import ui

from loopcal.app import words
from loopcal.app.view import View


def show(view: View) -> None:
    """The step."""
    if view.session.project() is None:
        ui.label(view.session.objection() or words.NO_PROJECT).classes("printed")
        return
    poses = ui.number("Poses to measure", value=30, min=4, max=500, step=1).classes("w-48")
    goal = {
        "I": "mean accuracy",
        "G": "worst accuracy",
        "D": "all parameters",
        "A": "mean sd of the parameters",
    }
    criterion = ui.select(goal, value="I", label="Best for").classes("w-64")

    async def plan() -> None:
        line = (
            "plan",
            view.project_name(),
            "--poses",
            str(int(poses.value)),
            "--criterion",
            str(criterion.value),
        )
        await view.run_to_end("Choose poses", *line)

    ui.button("Choose poses", on_click=plan).props("unelevated")
    for file in view.session.folder.listed():
        if "plan" in file.name and file.name.endswith(".csv"):
            ui.link(f"Download {file.name}", f"/file/{file.name}")

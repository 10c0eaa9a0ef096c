"""Files for the robot, and its corrected targets."""

from __future__ import annotations

from nicegui import ui

from loopcal.app import words
from loopcal.app.uploads import uploader
from loopcal.app.view import View

FORMATS = ("urdf", "xacro", "ur", "dh", "mdh", "mjcf", "sdf", "zeros", "frames", "json")


def show(view: View) -> None:
    """The step."""
    if view.session.source() is None:
        ui.label(words.NO_RESULT)
        return
    result = view.session.folder.result.name
    chosen = ui.select(list(FORMATS), value="urdf", label="Format").classes("w-48")

    async def export() -> None:
        await view.run_to_end("Export", "export", result, "--to", str(chosen.value))

    ui.button("Export", on_click=export).props("unelevated")
    ui.label("Files of the project").classes("text-h6")
    for file in view.session.folder.listed():
        ui.link(f"{file.name} ({file.size:,} bytes)", f"/file/{file.name}")
    uploader(view, "Hand in targets or a program to correct")

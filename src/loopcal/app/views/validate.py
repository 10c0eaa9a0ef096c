"""How good the calibration is on poses not used, and where."""

from __future__ import annotations

from nicegui import ui

from loopcal.app import words
from loopcal.app.view import View, figure
from loopcal.report import top
from loopcal.report.drawn import figures


def show(view: View) -> None:
    """The step."""
    source = view.session.source()
    if source is None:
        ui.label(words.NO_RESULT)
        return
    document = source.document
    bars = top.accuracy_bars(document)
    for bar in bars:
        with ui.row().classes("w-full items-center no-wrap"):
            ui.label(bar.label).classes("w-48")
            ui.linear_progress(value=bar.share / 100.0, show_value=False).classes("col-grow")
            ui.label(bar.words).classes("w-48")
    drawn = figures(source)
    for key in ("histogram", "arrows", "parameters"):
        if key in drawn:
            figure(drawn[key])

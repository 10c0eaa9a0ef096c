"""Calibrate, and read the verdict."""

from __future__ import annotations

from nicegui import ui

from loopcal.app import words
from loopcal.app.view import View, table
from loopcal.document.result_document import ResultDocument
from loopcal.document.tables import shown_parameters
from loopcal.estimation.methods.registry import METHODS
from loopcal.presentation.shown import in_unit, unit_shown
from loopcal.report.page import QUESTIONS

AUTO = "as the project says"
MARKS = {"yes": "good", "open": "care", "no": "bad"}


def show(view: View) -> None:
    """The step."""
    if view.session.project() is None:
        ui.label(view.session.objection() or words.NO_PROJECT).classes("printed")
        return
    method = ui.select([AUTO, *METHODS], value=AUTO, label="Method").classes("w-80")

    async def calibrate() -> None:
        asked = () if method.value == AUTO else ("--method", str(method.value))
        await view.run_to_end("Calibrate", "calibrate", view.project_name(), *asked)

    ui.button("Calibrate", on_click=calibrate).props("unelevated")
    source = view.session.source()
    if source is None:
        ui.label(words.NO_RESULT)
        return
    _verdict(source.document)
    rows = [
        [
            p.name,
            f"{in_unit(p.value, p.unit):.6g}",
            f"{in_unit(p.value - p.nominal, p.unit):+.4g}",
            "" if p.sd is None else f"{in_unit(p.sd, p.unit):.2g}",
            "" if p.unit == "1" else unit_shown(p.unit),
        ]
        for p in shown_parameters(source.document.parameters, source.document.terms)
    ]
    table(["parameter", "calibrated", "change", "sd", "unit"], rows)
    ui.link("Open the whole report", "/report", new_tab=True)


def _verdict(document: ResultDocument) -> None:
    if document.verdict is None:
        return
    with ui.card().classes("w-full"):
        ui.label(document.verdict.headline).classes(f"text-h6 {document.verdict.grade}")
        with ui.grid(columns="auto auto 1fr").classes("items-start"):
            for name, answer in document.verdict.answers.items():
                ui.label(QUESTIONS[name]).classes("text-weight-medium")
                ui.label(answer.mark).classes(MARKS[answer.mark])
                ui.label(f"{answer.words} {answer.next or ''}")
    if document.method_label:
        ui.label(f"Method: {document.method_label}")

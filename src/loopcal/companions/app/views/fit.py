"""Calibrate, read the verdict, and compare methods side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from nicegui import ui

from loopcal.companions.app import words
from loopcal.companions.app.controls import as_number, choice, offer, page, written
from loopcal.companions.app.view import View, heading, stale, table
from loopcal.companions.app.views.findings import verdict
from loopcal.document.fit import ParameterEntry
from loopcal.document.result_document import ResultDocument
from loopcal.document.tables import shown_parameters
from loopcal.errors import LoopcalError
from loopcal.estimation.methods.registry import METHODS, method_named
from loopcal.files.result.result_file import read_result
from loopcal.presentation.shown import by_sd, in_unit, unit_shown
from loopcal.report.tables import accuracy_tables, model_table
from loopcal.units import to_si
from loopcal.workflow.projects import Refit

PARAMETER_HEAD = ("parameter", "nominal", "calibrated", "change", "sd", "unit")


def show(view: View) -> None:
    """The step."""
    if view.session.project() is None:
        ui.label(view.session.objection() or words.NO_PROJECT).classes("printed")
        return
    _offer_fit(view)
    source = view.session.source()
    if source is None:
        ui.label(view.session.unreadable() or words.NO_RESULT).classes("printed-lines")
    else:
        stale(view)
        document = source.document
        view.part(view.session.refit, lambda: _provisional(view.session.refit(), document))
        verdict(document)
        if document.method_label:
            ui.label(words.BY_METHOD.format(label=document.method_label))
        with ui.row():
            page(f"{view.result_name()}/report.html", words.OPEN_WHOLE_REPORT)
        for accuracy_table in accuracy_tables(document):
            heading(accuracy_table.caption)
            table(accuracy_table.head, accuracy_table.rows)
        models = model_table(document)
        if models is not None:
            heading(models.caption)
            table(models.head, models.rows)
        _parameters(document, words.PARAMETERS)
    _side_by_side(view)


def _provisional(refit: Refit | None, document: ResultDocument) -> None:
    """The parameters that the first fit of a changed project found."""
    if refit is not None:
        _parameters(refit.shown_in(document), words.PROVISIONAL_PARAMETERS)
        heading(words.LAST_RESULT)


def _offer_fit(view: View) -> None:
    """The button that calibrates, with method and validation."""
    with ui.row().classes("items-end"):
        named = {name: _labelled(name) for name in METHODS}
        choice(view, "fit.method", words.METHOD, {"": words.AS_STATED, **named})
        choice(view, "fit.folds", words.VALIDATE_ON, words.FOLDS)
        _tolerance(view)
    offer(view, words.CALIBRATE, lambda: fit_line(view))


def fit_line(view: View) -> Sequence[str]:
    """The calibration by the method and validation that the step Fit says."""
    asked = ["calibrate", view.project_name()]
    for name, option in (("fit.method", "--method"), ("fit.folds", "--folds")):
        if view.kept.get(name):
            asked += [option, str(view.kept[name])]
    return asked


def _tolerance(view: View) -> None:
    """What the user demands, which the verdict then answers."""
    project = view.session.project()
    stated = {} if project is None else project.inputs.get("verdict") or {}
    demand = stated.get("tolerance")
    value = (
        in_unit(to_si(demand["value"], demand["unit"]), "m") if isinstance(demand, dict) else None
    )
    box = ui.number(words.TOLERANCE, value=value, min=0.0, step=0.1).classes("w-72")

    def state(said: str) -> None:
        demanded = as_number(said)
        if demanded != value:
            tolerance = {"value": demanded, "unit": "mm"} if demanded else None
            keys = ["verdict", "tolerance"]
            view.act(lambda: view.session.changed(keys, tolerance, "what is demanded"))

    written(box, state)


def _labelled(method: str) -> str:
    return f"{method}: {method_named(method).label}"


def _parameters(document: ResultDocument, caption: str) -> None:
    """Those that the fit estimates, and folded those that are fixed."""
    shown = shown_parameters(document.parameters, document.terms)
    fitted, fixed = [p for p in shown if not p.fixed], [p for p in shown if p.fixed]
    heading(caption)
    table(PARAMETER_HEAD, [_row(p) for p in fitted])
    if fixed:
        label = words.FIXED.format(count=len(fixed))
        with ui.expansion(label).classes("w-full why"):
            table([*PARAMETER_HEAD[:2], "unit"], [[*_row(p)[:2], _row(p)[-1]] for p in fixed])


def _row(p: ParameterEntry) -> list[str]:
    return [
        p.name,
        by_sd(p.nominal, p.sd, p.unit),
        by_sd(p.value, p.sd, p.unit),
        by_sd(p.value - p.nominal, p.sd, p.unit, sign=True),
        "" if p.sd is None else f"{in_unit(p.sd, p.unit):.2g}",
        "" if p.unit == "1" else unit_shown(p.unit),
    ]


def _side_by_side(view: View) -> None:
    """Methods tried beside each other, each in a folder of its own."""
    session = view.session
    heading(words.SIDE_BY_SIDE)
    ui.label(words.COMPARED).classes("text-body2")
    single = [name for name in METHODS if not method_named(name).choice]
    choice(view, "fit.beside", words.ANOTHER_METHOD, {name: _labelled(name) for name in single})

    def line() -> Sequence[str]:
        method = str(view.kept["fit.beside"])
        beside = f"{view.project_name().removesuffix('.toml')}-{method}"
        asked = ("calibrate", view.project_name(), "--method", method, "--folds", "10")
        return (*asked, "--no-report", "--out", beside)

    offer(view, words.TRY_IT, line, what=words.CALIBRATE_OTHERWISE)
    folders = [session.folder.result, *session.folder.tried]
    rows = [row for row in map(_tried, folders) if row is not None]
    if len(rows) > 1:
        head = ("folder", "method", "rms in the fit", "rms on poses not used", "verdict")
        table(head, rows)


def _tried(folder: Path) -> list[str] | None:
    try:
        document = read_result(folder / "result.json")
    except LoopcalError:
        return None
    accuracy, held = document.accuracy, document.validation
    unit = "m" if accuracy is None else accuracy.unit
    return [
        folder.name,
        document.method_label or document.method,
        "" if accuracy is None or accuracy.after is None else _rms(accuracy.after.rms, unit),
        "" if held is None or held.accuracy is None else _rms(held.accuracy.rms, unit),
        "" if document.verdict is None else document.verdict.grade,
    ]


def _rms(value: float, unit: str) -> str:
    return f"{in_unit(value, unit):.3g} {unit_shown(unit)}"

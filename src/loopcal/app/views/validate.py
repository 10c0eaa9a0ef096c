"""How good the calibration is on poses not used, and where."""

from __future__ import annotations

from functools import partial
from typing import Any

from nicegui import ui

from loopcal.app import words
from loopcal.app.pictures import look
from loopcal.app.predicting import Probe, map_figure
from loopcal.app.view import View, figure
from loopcal.presentation.shown import in_unit, unit_shown
from loopcal.report import top
from loopcal.report.drawn import figures
from loopcal.report.source import Source


def show(view: View) -> None:
    """The step."""
    source = view.session.source()
    if source is None:
        ui.label(words.NO_RESULT)
        return
    with ui.grid(columns="auto 1fr auto").classes("w-full items-center"):
        for bar in top.accuracy_bars(source.document):
            ui.label(bar.label)
            ui.linear_progress(value=bar.share / 100.0, show_value=False)
            ui.label(bar.words)
    _region(source)
    drawn = figures(source)
    for key in ("histogram", "arrows", "parameters"):
        if key in drawn:
            figure(drawn[key])


def _region(source: Source) -> None:
    """The sd over the working region, and one pose of it."""
    probe = Probe.of(source)
    if probe is None:
        ui.label(words.NO_REGION)
        return
    at, sd = probe.map()
    drawn = map_figure(at, sd)
    if drawn is not None:
        ui.label("Sd of the predicted point over the working region").classes("text-h6")
        layout: Any = drawn["layout"]
        ui.plotly({**drawn, "layout": look(460, **layout)}).classes("w-full")
    ui.label("Predict one pose").classes("text-h6")
    joints = probe.middle()
    told = ui.label().classes("printed")

    def predicted() -> None:
        told.set_text("\n".join(probe.words(joints)))

    def moved(name: str, shown: Any, event: Any) -> None:
        joints[name] = float(event.value)
        unit = probe.units[name]
        shown[0].set_text(f"{in_unit(joints[name], unit):.2f} {unit_shown(unit)}")
        predicted()

    with ui.grid(columns="auto 1fr auto").classes("w-full items-center"):
        for name, (low, high) in probe.spans.items():
            ui.label(name)
            shown: list[Any] = []
            slider = ui.slider(min=low, max=high, step=(high - low) / 400.0, value=joints[name])
            slider.on_value_change(partial(moved, name, shown)).props(f'aria-label="{name}"')
            unit = probe.units[name]
            shown.append(ui.label(f"{in_unit(joints[name], unit):.2f} {unit_shown(unit)}"))
    predicted()

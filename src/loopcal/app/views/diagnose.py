"""One selection of poses in all figures; what is found is left out, or taken as moved."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from nicegui import ui

from loopcal.app import words
from loopcal.app.pictures import Errors
from loopcal.app.view import View, table
from loopcal.document.result_document import ResultDocument
from loopcal.report.tables import outlier_table

POSES = "(event) => emit((event?.points ?? []).map((point) => point.customdata))"
"""Of an event of plotly only the positions travel, not the figure."""
LISTED = 200
"""Rows of the table of selected poses."""


class _Linked:
    """The figures of one page; plots: with the trace whose points can be selected."""

    def __init__(self, view: View, errors: Errors) -> None:
        self.view, self.errors = view, errors
        self.plots: list[Any] = []
        self.space: Any = None
        self.where = {int(i): n for n, i in enumerate(errors.drawn)}

    def plot(self, drawn: dict[str, Any]) -> None:
        """Draw a figure that takes part."""
        plot = ui.plotly(drawn).classes("w-full")
        for event in ("plotly_selected", "plotly_click"):
            plot.on(event, lambda e: self.select([int(i) for i in e.args or ()]), js_handler=POSES)
        plot.on("plotly_deselect", lambda: self.select([]), js_handler="() => emit()")
        if drawn["data"][0]["type"] == "scatter3d":
            self.space = plot
        else:
            self.plots.append(plot)

    def select(self, positions: Sequence[int]) -> None:
        """Select these poses in every figure."""
        self.view.selected[:] = sorted(set(positions))
        self.draw()

    def draw(self) -> None:
        """Show the selection: only marks travel to the browser, not the figures."""
        chosen = [self.where[i] for i in self.view.selected if i in self.where]
        for plot in self.plots:
            marks: list[Any] = [chosen] if self.view.selected else [None]
            plot.run_plot_method("restyle", {"selectedpoints": marks}, [0])
        if self.space is not None:
            self.space.run_plot_method("restyle", self.errors.space_of(self.view.selected), [1])
        _selected.refresh(self.view, self.errors)


def show(view: View) -> None:
    """The step."""
    source = view.session.source()
    errors = None if source is None else Errors.of(source)
    if source is None or errors is None:
        ui.label(words.NO_RESULT)
        return
    if len(errors.drawn) < len(errors.size):
        ui.label(words.NOT_WHOLE.format(shown=len(errors.drawn), all=len(errors.size)))
    _found(source.document)
    linked = _Linked(view, errors)
    with ui.row().classes("w-full no-wrap items-start"):
        with ui.column().classes("col-grow").style("min-width: 0; flex: 2"):
            linked.plot(errors.over_poses())
            space = errors.in_space()
            if space is not None:
                linked.plot(space)
            with ui.grid(columns=2).classes("w-full"):
                for name in errors.joints:
                    linked.plot(errors.over_joint(name))
        with ui.column().style("min-width: 280px; flex: 1"):
            _selected(view, errors)
            ui.button("Select none", on_click=partial(linked.select, [])).props("outline")


def _found(document: ResultDocument) -> None:
    points = document.change_points
    for point in () if points is None else points.found:
        ui.label(f"{str(point)[0].upper()}{str(point)[1:]}.").classes("text-body2")
    told = outlier_table(document)
    if told is not None:
        table(told.head, told.rows)


@ui.refreshable
def _selected(view: View, errors: Errors) -> None:
    """The selected poses, and what can be done with them."""
    if not view.selected:
        ui.label(words.NONE_SELECTED)
        return
    poses = [errors.source.table.poses[i] for i in view.selected]
    ui.label(words.SELECTED.format(count=len(poses), all=len(errors.size))).classes(
        "text-subtitle1"
    )
    ui.label(f"from {poses[0]} to {poses[-1]}, rms {_rms(errors, view.selected):.3g} {errors.unit}")
    reason = ui.input(words.REASON).classes("w-full")

    def because(do: Any) -> None:
        if not reason.value:
            ui.notify(words.ASK_REASON, type="warning")
        elif view.act(lambda: do(str(reason.value))):
            view.selected.clear()

    ui.button(
        "Leave out", on_click=lambda: because(lambda why: view.session.excluded(poses, why))
    ).props("unelevated")
    targets = view.session.moved()
    for label, names in targets.items():
        ui.button(
            f"{label} moved here",
            on_click=lambda names=names: because(
                lambda why: view.session.shifted(names, poses[0], poses[-1], why)
            ),
        ).props("outline")
    rows = [
        [p, f"{errors.size[i]:.3g}"] for p, i in zip(poses[:LISTED], view.selected, strict=False)
    ]
    table(["pose", f"error [{errors.unit}]"], rows)


def _rms(errors: Errors, positions: Sequence[int]) -> float:
    return float(np.sqrt(np.nanmean(np.square(errors.size[list(positions)]))))

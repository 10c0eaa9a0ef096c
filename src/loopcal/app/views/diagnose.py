"""One selection of poses in all figures; what is found is left out, or taken as moved."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from nicegui import ui

from loopcal.app import words
from loopcal.app.controls import reason
from loopcal.app.pictures import SIZE, Errors
from loopcal.app.view import View, heading, table
from loopcal.app.views.fit import offer_fit
from loopcal.document.change_points import ChangePoints
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
        self.selection = ui.refreshable(lambda: _selected(self))

    def plot(self, drawn: dict[str, Any], label: str) -> None:
        """Draw a figure that takes part."""
        plot = ui.plotly(drawn).classes("w-full").props(f'aria-label="{label}"')
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
        self.selection.refresh()


def show(view: View) -> None:
    """The step."""
    source = view.session.source()
    if source is None:
        ui.label(words.NO_RESULT)
        return
    errors = Errors.of(source, view.session.steps())
    if errors is None:
        ui.label(words.NO_OUTPUTS)
        return
    view.select_among(source.table.poses)
    if view.session.state().stale:
        ui.label(words.STALE).classes("care")
    if len(errors.drawn) < len(errors.size):
        ui.label(words.NOT_WHOLE.format(shown=len(errors.drawn), all=len(errors.size)))
    linked = _Linked(view, errors)
    what = view.kept.setdefault("diagnose.shown", SIZE)
    what = what if what in errors.shown else SIZE
    with ui.element("div").classes("beside"):
        with ui.column().classes("figures"):
            shown = ui.toggle(list(errors.shown), value=what, on_change=partial(_show, view))
            shown.props('no-caps aria-label="error shown"')
            linked.plot(errors.over_poses(what), "error over the poses")
            space = errors.in_space()
            if space is not None:
                linked.plot(space, "error in space")
            with ui.element("div").classes("tiles"):
                for name in errors.joints:
                    linked.plot(errors.over_joint(name, what), f"error over {name}")
        with ui.column().classes("acts"):
            linked.selection()
            ui.button("Select none", on_click=partial(linked.select, [])).props("outline")
            _undo(view)
            heading("Fit again")
            offer_fit(view)
            _found(view, source.document, linked)
    if view.selected:
        linked.draw()


def _show(view: View, event: Any) -> None:
    view.keep("diagnose.shown", event.value)
    view.refresh()


def _undo(view: View) -> None:
    edits = view.session.folder.log().edits()
    if edits:
        label = f"Undo: {edits[-1].what[:60]}"
        undo = partial(view.act, view.session.folder.undo)
        ui.button(label, on_click=undo, icon="undo").props("outline")


def _found(view: View, document: ResultDocument, linked: _Linked) -> None:
    """What loopcal has found by itself, with the poses to look at."""
    changes = document.change_points
    found = () if changes is None else changes.found
    outliers = outlier_table(document)
    if not found and outliers is None:
        return
    heading("Found by loopcal")
    poses = linked.errors.source.table.poses
    for point in found:
        words_ = str(point)
        ui.label(f"{words_[0].upper()}{words_[1:]}.").classes("text-body2")
        if point.shape == "step" and point.pose in poses:
            positions = list(range(poses.index(point.pose), len(poses)))
            label = f"Select from pose {point.pose} on"
            ui.button(label, on_click=partial(linked.select, positions)).props("flat")
    if changes is not None and changes.toml:
        _state(view, changes)
    if outliers is not None:
        odd = [poses.index(str(row[0])) for row in outliers.rows if str(row[0]) in poses]
        ui.label(f"{outliers.caption}: pose {', '.join(str(row[0]) for row in outliers.rows[:12])}")
        if odd:
            ui.button("Select these poses", on_click=partial(linked.select, odd)).props("flat")
        with ui.expansion("Details").classes("w-full"):
            table(outliers.head, outliers.rows)


def _state(view: View, changes: ChangePoints) -> None:
    state = partial(view.session.modelled, changes, "found by loopcal")
    button = ui.button("Put these changes into the project", on_click=partial(view.act, state))
    button.props("outline")


def _ends(linked: _Linked) -> None:
    """Move the ends of a run by one pose: a finger is not as exact as a number."""
    first, last = linked.view.selected[0], linked.view.selected[-1]
    if len(linked.view.selected) != last - first + 1:
        return
    with ui.row().classes("q-gutter-xs"):
        for label, begin, end in (
            ("first −", first - 1, last),
            ("first +", first + 1, last),
            ("last −", first, last - 1),
            ("last +", first, last + 1),
        ):
            if 0 <= begin <= end < len(linked.errors.size):
                poses = range(begin, end + 1)
                ui.button(label, on_click=partial(linked.select, poses)).props("flat")


def _selected(linked: _Linked) -> None:
    """The selected poses, and what can be done with them."""
    view, errors = linked.view, linked.errors
    heading("Selected poses")
    if not view.selected:
        ui.label(words.NONE_SELECTED)
        return
    poses = [errors.source.table.poses[i] for i in view.selected]
    told = words.SELECTED.format(count=len(poses), all=len(errors.size))
    ui.label(told).classes("text-subtitle1")
    ui.label(f"pose {poses[0]} to {poses[-1]}, rms {errors.rms(view.selected):.3g} {errors.unit}")
    _ends(linked)

    def do(act: Callable[[str], Any], kept: str) -> None:
        chosen = list(view.selected)
        view.selected.clear()
        if not view.act(partial(act, str(view.kept[kept] or words.REASONS[kept][0]))):
            view.selected[:] = chosen

    reason(view, "shifted", words.REASONS["shifted"])
    for label, names in view.session.moved().items():
        act = partial(view.session.shifted, names, poses)
        ui.button(f"{label} moved here", on_click=partial(do, act, "shifted")).props("unelevated")
    reason(view, "excluded", words.REASONS["excluded"])
    exclude = partial(view.session.excluded, poses)
    ui.button("Exclude", on_click=partial(do, exclude, "excluded")).props("unelevated")
    rows = [
        [p, *(f"{values[i]:.3g}" for values in errors.shown.values())]
        for p, i in zip(poses[:LISTED], view.selected, strict=False)
    ]
    table(["pose", *(f"{name} [{errors.unit}]" for name in errors.shown)], rows, pagination=10)

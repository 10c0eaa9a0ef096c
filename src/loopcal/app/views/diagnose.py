"""One selection of poses in all figures; what is found is left out, or taken as moved."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from nicegui import background_tasks, ui

from loopcal.app import words
from loopcal.app.controls import reason
from loopcal.app.pictures import SIZE, Errors, Framed
from loopcal.app.view import View, heading, stale, table
from loopcal.app.views.fit import offer_fit
from loopcal.document.change_points import ChangePoints
from loopcal.report.tables import outlier_table

TAKE = "(event) => linked.take(event, emit)"
"""The page marks what an event of plotly selects (linked.js); its positions and range travel."""
NONE = "() => linked.none(emit)"
NEXT = 0.02
"""Seconds between figures that are drawn again."""
LISTED = 200
"""Rows of the table of selected poses."""


class _Linked:
    """The figures of one page, and the panel of what is selected in them."""

    def __init__(self, view: View, errors: Errors) -> None:
        self.view, self.errors = view, errors
        self.panel = ui.refreshable(lambda: _selected(self))
        self.around = ui.refreshable(lambda place: place(self))
        self._plots: list[tuple[Any, Callable[[Errors], dict[str, Any] | None]]] = []

    @property
    def what(self) -> str:
        """The error that is shown."""
        kept = str(self.view.kept.setdefault("diagnose.shown", SIZE))
        return kept if kept in self.errors.shown else SIZE

    def plot(
        self,
        make: Callable[[Errors], dict[str, Any] | None],
        label: str,
        of: Callable[[], Framed] | None = None,
    ) -> None:
        """Draw a figure that takes part, if it can be drawn; of: what its axes show, where a frame
        can be drawn."""
        drawn = make(self.errors)
        if drawn is None:
            return
        plot = ui.plotly(drawn).classes("w-full linked").props(f'aria-label="{label}"')
        self._plots.append((plot, make))

        def taken(event: Any) -> None:
            positions, frame = [int(i) for i in event.args[0]], event.args[1]
            if frame is not None:
                axes = self.errors.seen(frame) if of is None else of()
                positions = self.errors.framed(axes, frame) or positions
            self.keep(positions)

        for event in ("plotly_selected", "plotly_click"):
            plot.on(event, taken, js_handler=TAKE)
        plot.on("plotly_deselect", lambda: self.keep([]), js_handler=NONE)

    def keep(self, positions: Sequence[int]) -> None:
        """Remember the poses that the figures mark already."""
        self.view.selected[:] = sorted(set(positions))
        self.panel.refresh()

    def select(self, positions: Sequence[int]) -> None:
        """Select these poses in every figure."""
        self.mark(positions)
        self.keep(positions)

    def mark(self, positions: Sequence[int], *, space: bool = True) -> None:
        """Mark these poses in every figure; space: also in space, which is slow to draw."""
        drawn = np.intersect1d(self.errors.drawn, list(positions)).tolist()
        ui.run_javascript(f"linked.select({drawn}, {str(space).lower()})")

    def follow(self, errors: Errors) -> bool:
        """Show other errors in the figures that are there; False where these cannot."""
        own = self.errors
        if list(errors.shown) != list(own.shown) or errors.joints != own.joints:
            return False
        self.errors = errors
        if errors.source.table is own.source.table and errors.steps == own.steps:
            soon = self.view.session.refits.going  # then all is drawn again
            self.mark(self.view.selected, space=not soon)
        else:
            self.draw()
        self.panel.refresh()
        self.around.refresh()
        return True

    def draw(self) -> None:
        """Draw the figures that are there again with what is selected, the first ones first.

        The browser shows each before it draws the next."""
        errors = self.errors
        drawn = np.intersect1d(errors.drawn, self.view.selected).tolist()
        ui.run_javascript(f"linked.chosen = {drawn}")

        async def each() -> None:
            for plot, make in self._plots:
                if self.errors is errors and not plot.is_deleted:
                    plot.update_figure(make(errors))
                    await asyncio.sleep(NEXT)

        background_tasks.create(each())


def show(view: View) -> None:
    """The step."""
    errors = _errors(view)
    if errors is None:
        ui.label(words.NO_RESULT if view.session.source() is None else words.NO_OUTPUTS)
        return
    linked = _Linked(view, errors)

    def follow() -> bool:
        now = _errors(view)
        return now is not None and linked.follow(now)

    view.follows = follow
    linked.around(_head)
    with ui.element("div").classes("beside"):
        with ui.column().classes("figures"):
            _figures(linked)
        with ui.column().classes("acts"):
            _acts(linked)


def _errors(view: View) -> Errors | None:
    """Those of the result, or of the first fit since the project has changed."""
    source, refit = view.session.source(), view.refit()
    if source is None:
        return None
    if refit is not None:
        source = replace(source, table=refit.table, document=refit.shown_in(source.document))
    view.select_among(source.table.poses)
    return Errors.of(source, view.session.steps(), view.selected)


def _head(linked: _Linked) -> None:
    stale(linked.view)
    errors = linked.errors
    if len(errors.drawn) < len(errors.size):
        ui.label(words.NOT_WHOLE.format(shown=len(errors.drawn), all=len(errors.size)))


def _figures(linked: _Linked) -> None:
    view, errors = linked.view, linked.errors

    def other(event: Any) -> None:
        view.keep("diagnose.shown", event.value)
        linked.draw()

    shown = ui.toggle(list(errors.shown), value=linked.what, on_change=other)
    shown.props('no-caps aria-label="error shown"')

    def over(name: str | None) -> Framed:
        across = linked.errors.numbers if name is None else linked.errors.joint(name)
        return across, linked.errors.shown[linked.what]

    linked.plot(lambda e: e.over_poses(linked.what), "error over the poses", partial(over, None))
    if errors.solid:
        ways = {False: words.DRAG_TURNS, True: words.DRAG_SELECTS}
        turn = ui.toggle(ways, value=False).props(f'no-caps aria-label="{words.DRAG}"')
        turn.on_value_change(lambda e: ui.run_javascript(f"linked.framing({str(e.value).lower()})"))
    linked.plot(lambda e: e.in_space(), "error in space")
    with ui.element("div").classes("tiles"):
        for name in errors.joints:

            def make(e: Errors, name: str = name) -> dict[str, Any]:
                return e.over_joint(name, linked.what)

            linked.plot(make, f"error over {name}", partial(over, name))


def _acts(linked: _Linked) -> None:
    view = linked.view
    heading(words.SELECTED_POSES)
    _from_to(linked)
    linked.panel()
    ui.button(words.SELECT_NONE, on_click=partial(linked.select, [])).props("outline")
    linked.around(lambda _: _undo(view))
    heading(words.FIT_AGAIN)
    offer_fit(view)
    linked.around(_found)


def _undo(view: View) -> None:
    edits = view.session.folder.log().edits()
    if edits:
        label = words.UNDO.format(what=edits[-1].what[:60])
        undo = partial(view.act, view.session.folder.undo)
        ui.button(label, on_click=undo, icon="undo").props("outline")


def _found(linked: _Linked) -> None:
    """What loopcal has found by itself, with the poses to look at."""
    view, source = linked.view, linked.view.session.source()
    if source is None:
        return
    document = source.document
    changes = document.change_points
    found = () if changes is None else changes.found
    outliers = outlier_table(document)
    if not found and outliers is None:
        return
    heading(words.FOUND_BY_LOOPCAL)
    poses = linked.errors.source.table.poses
    for point in found:
        words_ = str(point)
        ui.label(f"{words_[0].upper()}{words_[1:]}.").classes("text-body2")
        if point.shape == "step" and point.pose in poses:
            positions = list(range(poses.index(point.pose), len(poses)))
            label = words.SELECT_FROM.format(pose=point.pose)
            ui.button(label, on_click=partial(linked.select, positions)).props("flat")
    if changes is not None and changes.toml:
        _state(view, changes)
    if outliers is not None:
        odd = [poses.index(str(row[0])) for row in outliers.rows if str(row[0]) in poses]
        ui.label(f"{outliers.caption}: pose {', '.join(str(row[0]) for row in outliers.rows[:12])}")
        if odd:
            ui.button(words.SELECT_THESE_POSES, on_click=partial(linked.select, odd)).props("flat")
        with ui.expansion(words.DETAILS).classes("w-full"):
            table(outliers.head, outliers.rows)


def _state(view: View, changes: ChangePoints) -> None:
    state = partial(view.session.modelled, changes, "found by loopcal")
    button = ui.button(words.STATE_CHANGES, on_click=partial(view.act, state))
    button.props("outline")


def _from_to(linked: _Linked) -> None:
    """The brush by keyboard: a run of poses by the ids of its ends."""
    poses = linked.errors.source.table.poses
    at = {pose: i for i, pose in enumerate(poses)}
    with ui.row().classes("items-center no-wrap w-full"):
        named = zip(words.ENDS, (poses[0], poses[-1]), strict=True)
        ends = [ui.input(label, value=pose).classes("col") for label, pose in named]

        def select() -> None:
            given = [str(end.value).strip() for end in ends]
            unknown = [pose for pose in given if pose not in at]
            if unknown:
                ui.notify(words.NO_SUCH_POSE.format(pose=unknown[0]), type="negative")
                return
            first, last = sorted(at[pose] for pose in given)
            linked.select(range(first, last + 1))

        for end in ends:
            end.on("keydown.enter", select)
        ui.button(words.SELECT, on_click=select).props("outline")


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
    if not view.selected:
        ui.label(words.NONE_SELECTED)
        return
    poses = [errors.source.table.poses[i] for i in view.selected]
    told = words.SELECTED.format(count=len(poses), all=len(errors.size))
    ui.label(told).classes("text-subtitle1")
    ui.label(f"pose {poses[0]} to {poses[-1]}, rms {errors.rms(view.selected):.3g} {errors.unit}")
    _ends(linked)

    async def do(act: Callable[[str], Any], kept: str) -> None:
        chosen = list(view.selected)
        view.selected.clear()
        if not await view.act_aside(partial(act, str(view.kept[kept] or words.REASONS[kept][0]))):
            view.selected[:] = chosen

    reason(view, "shifted", words.REASONS["shifted"])
    for label, names in view.session.moved().items():
        act = partial(view.session.shifted, names, poses)
        ui.button(f"{label} moved here", on_click=partial(do, act, "shifted")).props("unelevated")
    reason(view, "excluded", words.REASONS["excluded"])
    exclude = partial(view.session.excluded, poses)
    ui.button(words.EXCLUDE, on_click=partial(do, exclude, "excluded")).props("unelevated")
    rows = [
        [p, *(f"{values[i]:.3g}" for values in errors.shown.values())]
        for p, i in zip(poses[:LISTED], view.selected, strict=False)
    ]
    table(["pose", *(f"{name} [{errors.unit}]" for name in errors.shown)], rows, pagination=10)

"""The figures of one page that share one selection of poses."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from nicegui import background_tasks, ui

from loopcal.companions.app import words
from loopcal.companions.app.beside import SIZE
from loopcal.companions.app.controls import reason, written
from loopcal.companions.app.pictures import Errors, Framed
from loopcal.companions.app.view import Part, Place, View, heading, table
from loopcal.companions.app.view import plot as view_plot

TAKE = "(event) => linked.take(event, emit)"
"""The page marks what an event of plotly selects (linked.js); its positions and range travel."""
NONE = "() => linked.none(emit)"
POINT, AWAY = "(event) => linked.point(event, emit)", "() => linked.point(null, emit)"
OVER_POSES = "error over the poses"
NEXT = 0.02
"""Seconds between what the browser draws again."""
BESIDE = 0.15
"""Share of a run that a zoomed figure shows on either side of it."""
FEWEST = 5
"""Poses that it shows there at least."""


class Linked:
    """The figures of one page. heard: called where another selection, or its figure, is shown;
    later: called once the browser has shown what these have changed; pointed: called with the pose
    that is pointed at, or with those selected."""

    def __init__(self, view: View, errors: Errors) -> None:
        self.view, self.errors = view, errors
        self.heard: list[Callable[[], Any]] = []
        self.later: list[Callable[[], Any]] = []
        self.pointed: list[Callable[[Sequence[int]], Any]] = []
        self._latest = 0
        self._plots: dict[str, tuple[Any, Callable[[Errors], dict[str, Any] | None]]] = {}

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
        plot = view_plot(drawn, label).classes("linked")
        self._plots[label] = plot, make

        def taken(event: Any) -> None:
            positions, frame = [int(i) for i in event.args[0]], event.args[1]
            if frame is not None:
                axes = self.errors.seen(frame) if of is None else of()
                positions = self.errors.framed(axes, frame) or positions
            self.keep(positions)

        for event in ("plotly_selected", "plotly_click"):
            plot.on(event, taken, js_handler=TAKE)
        plot.on("plotly_deselect", lambda: self.keep([]), js_handler=NONE)
        for event, handler in (("plotly_hover", POINT), ("plotly_unhover", AWAY)):
            plot.on(event, lambda e: self._pointed(e.args), js_handler=handler)

    def keep(self, positions: Sequence[int]) -> None:
        """Remember the poses that the figures mark already."""
        self.view.selected[:] = sorted(set(positions))
        self._tell()

    def _pointed(self, position: int | None) -> None:
        """Show the machine in the pose that is pointed at, else in the selected one."""
        for point in self.pointed:
            point([*self.view.selected] if position is None else [int(position)])

    def _tell(self) -> None:
        for hear in self.heard:
            hear()
        self._latest += 1
        background_tasks.create(self._tell_later(self._latest))

    async def _tell_later(self, number: int) -> None:
        await asyncio.sleep(NEXT)
        # A brush makes many selections; what takes long follows the last of them.
        if number == self._latest:
            for hear in self.later:
                hear()
            self.view.addressed()

    def select(self, positions: Sequence[int]) -> None:
        """Select these poses in every figure."""
        ui.run_javascript(f"linked.select({self._drawn(positions)})")
        self.keep(positions)

    def _drawn(self, positions: Sequence[int]) -> list[int]:
        """Which of these poses some figure draws."""
        drawn_poses = np.union1d(self.errors.drawn, self.zoomed(self.errors).drawn)
        drawn: list[int] = np.intersect1d(drawn_poses, list(positions)).tolist()
        return drawn

    @property
    def span(self) -> tuple[float, float] | None:
        """The numbers of the poses between which the first figure is zoomed; None: it shows all."""
        return self.view.kept.get("diagnose.span")

    def zoomed(self, errors: Errors) -> Errors:
        """What the first figure shows."""
        zoom = None if self.span is None else errors.between(*self.span)
        return errors if zoom is None else zoom

    def zoom(self, positions: Sequence[int]) -> None:
        """Show these poses, and some beside them, in the whole width of the first figure; of none,
        all poses."""
        span = None
        if len(positions):
            first, last = min(positions), max(positions)
            beside = max(FEWEST, round(BESIDE * (last - first)))
            ends = max(first - beside, 0), min(last + beside, len(self.errors.size) - 1)
            span = tuple(float(self.errors.numbers[i]) for i in ends)
        self.view.kept["diagnose.span"] = span
        self.draw([OVER_POSES])
        self._tell()

    def pose(self, label: str, positions: Sequence[int] | None = None) -> None:
        """Move the machine of the figure in space to the first of these poses, else of those
        selected."""
        plot, _ = self._plots.get(label, (None, None))
        shown = self.view.selected if positions is None else positions
        posing = self.errors.posing(min(shown, default=0))
        if plot is not None and posing is not None and not plot.is_deleted:
            plot.run_plot_method("restyle", *posing)

    def follow(self, errors: Errors) -> bool:
        """Show other errors in the figures that are there; False where these cannot."""
        before = self.errors
        if list(errors.shown) != list(before.shown) or errors.joints != before.joints:
            return False
        self.errors = errors
        self.draw()
        self._tell()
        return True

    def draw(self, labels: Sequence[str] = ()) -> None:
        """Draw the figures that are there again with what is selected, the first ones first.

        labels: of these figures alone. The browser shows each before it draws the next."""
        errors = self.errors
        ui.run_javascript(f"linked.chosen = {self._drawn(self.view.selected)}")

        async def each() -> None:
            for plot, make in [self._plots[label] for label in labels or self._plots]:
                # Other errors may have come while the browser drew.
                if self.errors is errors and not plot.is_deleted:
                    plot.update_figure(make(errors))
                    await asyncio.sleep(NEXT)

        background_tasks.create(each())


# The poses selected in the linked figures: the ends of their run, and what is done with them.

LISTED = 200
"""Rows of the table of selected poses."""


def offer_selection(linked: Linked) -> None:
    """The panel."""
    heading(words.SELECTED_POSES)
    count_label = ui.label().classes("text-subtitle1")

    def count() -> None:
        chosen, every = linked.view.selected, len(linked.errors.size)
        some = words.SELECTED.format(count=len(chosen), all=every)
        count_label.set_text(some if chosen else words.NONE_SELECTED)

    _ends(linked)
    _zoom(linked)
    acts = Place(partial(_acts, linked))
    listed = Place(partial(_listed, linked))

    def of() -> object:
        return bool(linked.view.selected), linked.view.session.moved()

    linked.heard += [count, Part(of, acts.refresh).update]
    linked.later.append(listed.refresh)
    count()


def _chosen(linked: Linked) -> list[str]:
    """Ids of the selected poses."""
    poses = linked.errors.source.table.poses
    return [poses[i] for i in linked.view.selected]


def _run(linked: Linked) -> tuple[int, int] | None:
    """Positions of the ends of the selected run, of all poses where none is selected; None where
    the selection is no run."""
    chosen = linked.view.selected or range(len(linked.errors.size))
    first, last = chosen[0], chosen[-1]
    return (first, last) if last - first + 1 == len(chosen) else None


def _ends(linked: Linked) -> None:
    """The ends of the run by their ids, or moved by one pose: a finger is not as exact."""
    boxes: list[Any] = []
    buttons: list[Any] = []

    def poses() -> tuple[str, ...]:
        return linked.errors.source.table.poses

    def move(end: int, position: int) -> None:
        """Put one end there; the other one stays, as far as it can."""
        other = (_run(linked) or (0, len(poses()) - 1))[1 - end]
        if 0 <= position < len(poses()):
            ends = (
                (position, max(position, other)) if end == 0 else (min(position, other), position)
            )
            linked.select(range(ends[0], ends[1] + 1))

    def step(end: int, by: int) -> None:
        run = _run(linked)
        if run is not None:
            move(end, run[end] + by)

    def named(end: int, said: str) -> None:
        pose, run = said.strip(), _run(linked)
        if not pose or (run is not None and pose == poses()[run[end]]):
            return
        if pose in poses():
            move(end, poses().index(pose))
        else:
            ui.notify(words.NO_SUCH_POSE.format(pose=pose), type="negative")

    def show() -> None:
        run = _run(linked)
        for end, box in enumerate(boxes):
            box.set_value("" if run is None else poses()[run[end]])
        for button in buttons:
            button.set_enabled(run is not None)

    def stepper(end: int, by: int) -> None:
        icon, said = words.STEPPERS[by]
        button = ui.button(icon=icon, on_click=partial(step, end, by)).props("outline")
        buttons.append(button.props(f'aria-label="{words.ENDS[end]}: {said}"'))

    with ui.element("div").classes("ends"):
        for end, label in enumerate(words.ENDS):
            with ui.row().classes("items-center no-wrap q-gutter-x-xs"):
                stepper(end, -1)
                box = ui.input(label).classes("col").props("dense")
                boxes.append(written(box, partial(named, end)))
                stepper(end, +1)
    linked.heard.append(show)
    show()


def _zoom(linked: Linked) -> None:
    """What the figure over the poses shows in its whole width."""
    with ui.row().classes("small"):
        near = ui.button(words.ZOOM_IN).props("outline")
        near.on_click(lambda: linked.zoom(linked.view.selected))
        far = ui.button(words.ZOOM_OUT).props("outline")
        far.on_click(lambda: linked.zoom([]))
        none = ui.button(words.SELECT_NONE, on_click=partial(linked.select, [])).props("outline")

    def show() -> None:
        for button in (near, none):
            button.set_enabled(bool(linked.view.selected))
        far.set_enabled(linked.span is not None)

    linked.heard.append(show)
    show()


def _acts(linked: Linked) -> None:
    """What can be done with the poses that are selected when it is asked for."""
    view = linked.view
    if not view.selected:
        return

    async def do(act: Callable[[Sequence[str], str], Any], kept: str) -> None:
        chosen, poses = list(view.selected), _chosen(linked)
        why = str(view.kept[kept] or words.REASONS[kept][0])
        linked.select([])
        if not await view.act_aside(partial(act, poses, why)):
            linked.select(chosen)

    reason(view, "shifted", words.REASONS["shifted"])
    for what, names in view.session.moved().items():
        act = partial(view.session.shifted, names)
        moved = ui.button(words.PARAMETERS_MOVED.format(what=what)).props("unelevated")
        moved.on_click(partial(do, act, "shifted"))
    reason(view, "excluded", words.REASONS["excluded"])
    exclude = partial(do, view.session.excluded, "excluded")
    ui.button(words.EXCLUDE, on_click=exclude).props("unelevated")


def _listed(linked: Linked) -> None:
    """The errors of the selected poses."""
    view, errors, poses = linked.view, linked.errors, _chosen(linked)
    if not poses:
        return
    rms = f"{errors.rms(view.selected):.3g} {errors.unit}"
    ui.label(words.RUN_RMS.format(first=poses[0], last=poses[-1], rms=rms))
    rows = [
        [p, *(f"{values[i]:.3g}" for values in errors.shown.values())]
        for p, i in zip(poses[:LISTED], view.selected, strict=False)
    ]
    table(
        ["pose", *(f"{name} [{errors.units[name]}]" for name in errors.shown)], rows, pagination=10
    )

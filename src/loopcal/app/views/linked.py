"""The figures of one page that share one selection of poses."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from nicegui import background_tasks, ui

from loopcal.app.pictures import SIZE, Errors, Framed
from loopcal.app.view import View

TAKE = "(event) => linked.take(event, emit)"
"""The page marks what an event of plotly selects (linked.js); its positions and range travel."""
NONE = "() => linked.none(emit)"
OVER_POSES = "error over the poses"
NEXT = 0.02
"""Seconds between what the browser draws again."""
BESIDE = 0.15
"""Share of a run that a zoomed figure shows on either side of it."""
FEWEST = 5
"""Poses that it shows there at least."""


class Linked:
    """The figures of one page. heard: called where another selection, or its figure, is shown;
    later: called once the browser has shown what these have changed."""

    def __init__(self, view: View, errors: Errors) -> None:
        self.view, self.errors = view, errors
        self.heard: list[Callable[[], Any]] = []
        self.later: list[Callable[[], Any]] = []
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
        plot = ui.plotly(drawn).classes("w-full linked").props(f'aria-label="{label}"')
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

    def keep(self, positions: Sequence[int]) -> None:
        """Remember the poses that the figures mark already."""
        self.view.selected[:] = sorted(set(positions))
        self._tell()

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

"""One page in one browser: what it shows and has selected, and the parts that steps share."""

from __future__ import annotations

import json
import logging
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from nicegui import background_tasks, run, ui
from nicegui.element import Element

from loopcal.companions.app import words
from loopcal.companions.app.addresses import Address
from loopcal.companions.app.pictures import GRID
from loopcal.companions.app.session import Session
from loopcal.errors import LoopcalError
from loopcal.presentation.shown import NONE, with_unit

NUMBER = re.compile(r"[+-]?[\d,]+(\.\d*)?(e[+-]?\d+)?( .{1,4})?")
"""A number as tables write it, with a unit or not."""
WHOLE = 100
"""Rows of a table that is shown without turning its pages."""
MOST_LINES = 400
"""Lines of a difference that are shown."""


@dataclass(eq=False)
class Part:
    """A part of a page. draw: called where `of` says something else than at the last drawing."""

    of: Callable[[], object]
    draw: Callable[[], Any]
    drawn: object = field(init=False)

    def __post_init__(self) -> None:
        self.drawn = self.of()

    def update(self) -> None:
        """Draw it anew where what it shows has changed."""
        now = self.of()
        if now != self.drawn:
            self.drawn = now
            self.draw()


@dataclass(eq=False)
class View:
    """step: the one shown; selected: positions of poses in the result; kept: what was chosen in
    the controls, by their names; refresh: draws the step anew."""

    session: Session
    step: str = "robot"
    entry: int | None = None
    """Number of the entry of the log that is shown."""
    selected: list[int] = field(default_factory=list)
    kept: dict[str, Any] = field(default_factory=dict)
    poses: tuple[str, ...] = ()
    """Ids of the poses of the result that is shown."""
    refresh: Callable[[], Any] = lambda: None
    run_script: Callable[[str], Any] = lambda _: None
    """Runs a program in the browser, also from a task that draws nothing."""
    boxes: dict[str, Any] = field(default_factory=dict)
    """The control of each name as it was drawn last."""
    follow: list[Callable[[], Any]] = field(default_factory=list)
    """What is called when a control changes."""
    parts: list[Part] = field(default_factory=list)
    """Of the step."""
    shown: str = ""
    """The step that is drawn; `step` is the one asked for."""
    went: int = 0
    """How often the browser had gone back or forth when it last said so."""
    acts: int = 0
    """Acts of this page that are being done."""
    uploading: bool = False
    """Whether the step takes in files: it stays as it is until it has them all."""
    noticed: int = 0
    """The last version of the folder that the user of this page knows."""

    def begin(self) -> None:
        """Begin to show a step: all of it is drawn anew where the folder or the run changes."""
        self.follow.clear()
        self.parts.clear()
        self.boxes.clear()
        self.shown, self.uploading = self.step, False
        self.anew_when(lambda: self.session.version)

    def anew_when(self, of: Callable[[], object]) -> None:
        """Draw the step as a whole anew only where `of` says something else than now."""
        # refresh is looked up when it is called: the first drawing comes ahead of it.
        self.parts[:1] = [Part(lambda: (self.step, of()), lambda: self.refresh())]

    def part(self, of: Callable[[], object], show: Callable[[], Any]) -> None:
        """Show a part of the step, and anew where `of` says something else; the rest stays."""
        self.parts.append(Part(of, Place(show).refresh))

    def update(self) -> None:
        """Draw anew the parts of the step that show something else by now."""
        if self.uploading and self.step == self.shown:
            return
        for part in tuple(self.parts):
            # Where one part draws the step anew, those behind it in the copy are gone.
            if part in self.parts:
                part.update()

    def keep(self, name: str, value: Any) -> None:
        """Remember what a control says, and say the same in the one drawn since."""
        self.kept[name] = value
        box = self.boxes.get(name)
        if box is not None and box.value != value:
            box.set_value(value)
        for follower in self.follow:
            follower()

    def address(self) -> Address:
        """Of what it shows."""
        if self.entry is not None:
            return Address(self.step, run=self.entry)
        return Address.selecting(self.step, self.selected, self.poses)

    def go(self, address: Address) -> None:
        """Show what an address says, in the result as it stands."""
        self.step, self.entry = address.step or self.step, address.run
        if address.poses and (source := self.session.source()) is not None:
            self.poses = source.table.poses
            self.selected[:] = address.selected(self.poses)

    def addressed(self, title: str = "") -> None:
        """Name the address to the browser."""
        said = f"{json.dumps(self.address().text)}, {json.dumps(title)}, {self.went}"
        self.run_script(f"addresses.show({said})")

    def select_among(self, poses: Sequence[str]) -> None:
        """Keep the selected poses, by their ids, where the result has others than before."""
        ids = {self.poses[i] for i in self.selected}
        if tuple(poses) != self.poses:
            self.selected[:] = [i for i, pose in enumerate(poses) if pose in ids]
        self.poses = tuple(poses)

    def act(self, do: Callable[[], Any]) -> bool:
        """Do something that a user asked for, and show why where it cannot be done."""
        return self._done(_complaint(do))

    async def act_aside(self, do: Callable[[], Any]) -> bool:
        """The same in a thread: what reads many rows keeps no other page waiting."""
        self.acts += 1
        try:
            return self._done(await run.io_bound(_complaint, do))
        finally:
            self.acts -= 1

    def _done(self, complaint: str | None) -> bool:
        if complaint is not None:
            _tell(complaint)
            return False
        # A change by this page is no news to its user.
        self.noticed = self.session.version
        self.session.look()
        return True

    def run(self, what: str, *line: str) -> bool:
        """Begin a run of `loopcal LINE`."""
        return self.act(lambda: self.session.start(self.session.action(what, line)))

    def files(self, ends: tuple[str, ...], step: str = "") -> list[str]:
        """Files of the folder itself that end so; those handed in at a step first, the last one
        ahead of all."""
        names = (file.name for file in self.session.folder.listed())
        kept = [name for name in names if "/" not in name and name.lower().endswith(ends)]
        handed_in = self.session.folder.handed_in(step) if step else []
        return sorted(kept, key=lambda name: -handed_in.index(name) if name in handed_in else 1)

    def project_name(self) -> str:
        """Of the project file in the folder."""
        return self.session.folder.named(self.session.folder.project)

    def result_name(self) -> str:
        """Of the folder of its result."""
        return self.session.folder.named(self.session.folder.result)

    def plan_name(self) -> str:
        """Of the folder of its plan."""
        return self.session.folder.named(self.session.folder.plan)


def _complaint(do: Callable[[], Any]) -> str | None:
    """Why something cannot be done; None where it is."""
    try:
        do()
    except LoopcalError as error:
        return error.text
    except Exception as error:
        logging.getLogger(__name__).exception("cannot be done")
        return words.NOT_DONE.format(fault=f"{type(error).__name__}: {error}")
    return None


def _tell(why: str) -> None:
    """Show why something was not done."""
    ui.notify(why, type="negative", multi_line=True, timeout=15_000, close_button=True)


def stale(view: View) -> None:
    """Whether the result is of the project as it stands; where not, what a first fit of it says."""
    session = view.session

    def of() -> object:
        return session.stale, session.refit(), session.refits.going, session.worker.busy

    view.part(of, lambda: _stale(session))


def _stale(session: Session) -> None:
    source, refit = session.source(), session.refit()
    if refit is None or source is None or source.document.accuracy is None:
        if session.stale:
            message = words.FITTING if session.refits.going else words.STALE
            ui.label(message).classes("care")
        return
    sizes = source.document.accuracy.after.rms, refit.accuracy.rms
    before, after = (with_unit(size or 0.0, refit.unit) for size in sizes)
    with ui.element("div").classes("provisional"):
        message = words.PROVISIONAL.format(before=before, after=after, label=refit.label)
        ui.label(message).classes("care")
        if not refit.converged:
            ui.label(words.NOT_CONVERGED).classes("bad")
        ui.label(words.JUDGING if session.worker.busy else words.UNJUDGED)


def title(label: str, words: str) -> None:
    """The head of a step, and what is done there."""
    ui.label(label).classes("text-h5").props("role=heading aria-level=1")
    ui.label(words).classes("text-body1")


def heading(text: str) -> None:
    """The head of a part of a step."""
    ui.label(text).classes("text-h6 q-mt-md").props("role=heading aria-level=2")


def text_block(text: str) -> None:
    """Printed text as it was printed."""
    ui.label(text).classes("printed")


def table(columns: Sequence[str], rows: Sequence[Sequence[str]], **more: Any) -> Any:
    """A table of texts; more: of `ui.table`."""
    made = [
        {
            **{"name": str(i), "label": name, "field": str(i), "sortable": True},
            "align": "right" if i > 0 and _numbers(row[i] for row in rows) else "left",
        }
        for i, name in enumerate(columns)
    ]
    content = [
        {"row": at, **{str(i): cell for i, cell in enumerate(row)}} for at, row in enumerate(rows)
    ]
    settled = {"pagination": 50 if len(rows) > WHOLE else 0, **more}
    made_table = ui.table(columns=made, rows=content, row_key="row", **settled)
    hidden = "" if len(rows) > (settled["pagination"] or len(rows)) else "hide-pagination"
    return made_table.props(f"dense flat {hidden}").classes("w-full")


def _numbers(cells: Iterable[str]) -> bool:
    """Whether a column holds numbers, which line up at their last digit."""
    written = [cell for cell in cells if cell not in ("", "-", NONE)]
    return bool(written) and all(NUMBER.fullmatch(cell) for cell in written)


def command(line: str) -> Any:
    """A command line, with a button that copies it."""
    made = ui.code(line, language="text").classes("command")
    made.markdown.props("tabindex=0")  # a long one is scrolled
    made.copy_button.props(f'aria-label="{words.COPY}"')
    return made


def difference(lines: Sequence[str]) -> None:
    """Lines of a difference, marked; so many of them."""
    with ui.element("div").classes("printed difference").props('tabindex="0" role=region'):
        for one in lines[:MOST_LINES]:
            ui.label(one or " ").classes(_kind(one))
        if len(lines) > MOST_LINES:
            ui.label(f"and {len(lines) - MOST_LINES:,} lines more")


def _kind(line: str) -> str:
    if line.startswith(("---", "+++", "@@")):
        return "none"
    return "gone" if line.startswith("-") else "come" if line.startswith("+") else ""


def figure(drawn: Any) -> Any:
    """A figure of the report, drawn by plotly in the page's own colours."""
    layout = {
        **drawn.layout,
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "rgba(0,0,0,0)",
        "font": {"color": "#6b7280"},
    }
    for name in layout:
        if name.startswith(("xaxis", "yaxis")):
            layout[name] = {**layout[name], "gridcolor": GRID, "zerolinecolor": GRID}
    heading(drawn.title)
    ui.label(drawn.caption).classes("text-caption")
    content = {"data": list(drawn.data), "layout": layout, "config": {"displaylogo": False}}
    return plot(content, drawn.label)


def plot(drawn: Mapping[str, Any], label: str) -> Any:
    """A figure of plotly in its place, which is as high as it will be; label: of its picture."""
    solid = "scene" in drawn["layout"]
    made = (Space if solid else ui.plotly)(dict(drawn)).classes("w-full plot")
    made.style(f"--high: {drawn['layout'].get('height', 300)}px")
    plain = label.replace('"', "'").replace("<", "").replace(">", "")
    return made.props(f'role=figure aria-label="{plain}"')


# Parts of a page that are drawn anew without losing what a user does meanwhile.

LONGEST = 60.0
"""Seconds that a browser may take to show a drawing."""


class Place:
    """A part of a page that can be drawn anew.

    The browser shows a new drawing a while after it was made. Until then clicks and keys go to the
    one before it, which therefore answers until the browser has shown the new one.
    """

    def __init__(self, draw: Callable[[], Any]) -> None:
        self._draw = draw
        self._box = ui.element("div").classes("contents")
        with self._box:
            draw()

    def refresh(self) -> None:
        """Draw it anew."""
        if self._box.is_deleted:
            return
        before = [*self._box.descendants()]
        # Cleared but not removed: elements that are removed answer no click (docs/decisions/0117).
        self._box.default_slot.children.clear()
        self._box.update()
        background_tasks.create(self._forget(before))
        with self._box:
            self._draw()

    async def _forget(self, before: list[Any]) -> None:
        client = self._box.client
        with suppress(TimeoutError):
            await client.run_javascript("true", timeout=LONGEST)  # after all that was sent before
        client.remove_elements([one for one in before if not one.is_deleted])


class Space(Element, component="scripts/space.js"):
    """Traces as plotly names them, drawn by `scripts/space.js`; with the methods of `ui.plotly`
    that the app uses."""

    def __init__(self, figure: Mapping[str, Any]) -> None:
        super().__init__()
        self.update_figure(figure)

    def update_figure(self, figure: Mapping[str, Any]) -> None:
        """Draw other traces; the eye stays where it is."""
        self.props["options"] = dict(figure)

    def run_plot_method(self, name: str, *args: Any) -> Any:
        """`restyle` alone: move the points of some traces."""
        return self.run_method("run_plot_method", name, *args)

"""One page in one browser: what it shows and has selected, and the parts that steps share."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from nicegui import ui

from loopcal.app import words
from loopcal.app.action import Action
from loopcal.app.session import Session
from loopcal.errors import LoopcalError


@dataclass(eq=False)
class View:
    """step: the one shown; selected: positions of poses in the result; refresh: draws all anew."""

    session: Session
    step: str = "robot"
    selected: list[int] = field(default_factory=list)
    refresh: Callable[[], Any] = lambda: None

    def act(self, do: Callable[[], Any]) -> bool:
        """Do something that a user asked for, and show why where it cannot be done."""
        try:
            do()
        except LoopcalError as error:
            ui.notify(
                str(error), type="negative", multi_line=True, timeout=15_000, close_button=True
            )
            return False
        self.refresh()
        return True

    def run(self, what: str, *line: str) -> bool:
        """Begin a run of `loopcal LINE`."""
        return self.act(lambda: self.session.start(Action(what, line)))

    async def run_to_end(self, what: str, *line: str) -> bool:
        """Run, and wait; whether it ended well."""
        if not self.run(what, *line):
            return False
        run = self.session.worker.run
        while run is not None and run.code is None:
            await asyncio.sleep(0.1)
        return run is not None and run.code == 0

    def project_name(self) -> str:
        """Of the project file in the folder."""
        return self.session.folder.project.name


def title(step: str, label: str) -> None:
    """The head of a step."""
    ui.label(label).classes("text-h5").props("role=heading aria-level=1")
    ui.label(words.STEPS[step]).classes("text-body1 q-mb-md")


def command_line(action: Action) -> None:
    """The command that does the same, to copy."""
    with ui.row().classes("items-center no-wrap q-gutter-xs"):
        ui.label(words.SAME).classes("text-caption")
        ui.code(action.command, language="bash").classes("text-caption")


def text_block(text: str) -> None:
    """Printed text as it was printed."""
    ui.label(text).classes("printed")


def table(columns: Sequence[str], rows: Sequence[Sequence[str]], key: str = "0") -> Any:
    """A table of texts; the first column names a row."""
    made = [
        {"name": str(i), "label": name, "field": str(i), "align": "left", "sortable": True}
        for i, name in enumerate(columns)
    ]
    content = [{str(i): cell for i, cell in enumerate(row)} for row in rows]
    return ui.table(columns=made, rows=content, row_key=key, pagination=25).props("dense flat")


def figure(drawn: Any) -> Any:
    """A figure of the report, drawn by plotly in the page's own colours."""
    layout = {
        **drawn.layout,
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "rgba(0,0,0,0)",
        "font": {"color": "#6b7280"},
    }
    ui.label(drawn.title).classes("text-h6").props("role=heading aria-level=2")
    ui.label(drawn.caption).classes("text-caption")
    content = {"data": list(drawn.data), "layout": layout, "config": {"displaylogo": False}}
    return ui.plotly(content).classes("w-full").props(f'aria-label="{_plain(drawn.label)}"')


def _plain(text: str) -> str:
    return text.replace('"', "'").replace("<", "").replace(">", "")

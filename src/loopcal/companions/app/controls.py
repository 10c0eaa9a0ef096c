"""Inputs of a step that outlive its redrawing, and commands whose lines follow them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from nicegui import ui

from loopcal.companions.app import words
from loopcal.companions.app.guard import LARGEST
from loopcal.companions.app.view import View, command
from loopcal.companions.app.worker import Action

Options = Sequence[str] | Mapping[str, str]


def choice(view: View, name: str, label: str, options: Options, **more: Any) -> Any:
    """A list to choose from; without a choice yet the first option.

    more: of `ui.select`; on_change_too: called after a change.
    """
    too = more.pop("on_change_too", None)
    shown = dict(options) if isinstance(options, Mapping) else list(options)
    if view.kept.get(name) not in options and not more.get("multiple"):
        view.kept[name] = next(iter(options), None)
    box = view.boxes[name] = ui.select(
        shown, value=view.kept.get(name), label=label, on_change=_kept(view, name), **more
    )
    if too is not None:
        box.on_value_change(lambda: too())
    return box.classes("w-72")


def number(view: View, name: str, label: str, first: float, **more: Any) -> Any:
    """A number; more: of `ui.number`."""
    view.kept.setdefault(name, first)
    box = ui.number(label, value=view.kept[name], on_change=_kept(view, name), **more)
    view.boxes[name] = box
    return box.classes("w-56")


def text(view: View, name: str, label: str, first: str = "") -> Any:
    """A line of text."""
    view.kept.setdefault(name, first)
    box = ui.input(label, value=view.kept[name], on_change=_kept(view, name))
    view.boxes[name] = box
    return box.classes("w-96 max-w-full")


def written(box: Any, then: Callable[[str], Any]) -> Any:
    """Call with what a user wrote into a field, at Enter and where it is left (fields.js)."""
    # The field's value on the server may be that of a late update (docs/decisions/0117).
    return box.on("commit", lambda event: then(event.args), js_handler="(e) => emit(e.detail)")


def folded(view: View, name: str, label: str, *, opened: bool = False) -> Any:
    """A part that opens and closes, and stays so where the step is drawn anew."""
    view.kept.setdefault(name, opened)
    box = view.boxes[name] = ui.expansion(
        label, value=view.kept[name], on_value_change=_kept(view, name)
    )
    return box.classes("w-full")


def as_number(said: str) -> float | None:
    """What a field for a number says, a whole one as it was written; None where it is empty."""
    number = float(said) if said else None
    return int(number) if number is not None and number.is_integer() else number


def pulses(view: View) -> list[str]:
    """The option that states pulses per degree, where the control does."""
    said = str(view.kept.get("pulses") or "").replace(" ", "")
    return ["--pulses-per-degree", said] if said else []


def pulses_field(view: View, program: str) -> None:
    """The control that states them, shown where the program chosen by `program` is a Yaskawa's."""
    box = text(view, "pulses", words.PULSES)

    def follow() -> None:
        box.set_visibility(str(view.kept.get(program) or "").lower().endswith(".jbi"))

    view.follow.append(follow)
    follow()


def reason(view: View, name: str, choices: Sequence[str]) -> Any:
    """Why something is done, chosen or typed."""
    box = text(view, name, words.REASON, choices[0]).classes("w-full", remove="w-96")
    with box.add_slot("append"), ui.button(icon="arrow_drop_down").props("flat round") as button:
        button.props(f'aria-label="{words.COMMON_REASONS}"')
        with ui.menu():
            for usual_reason in choices:
                ui.menu_item(usual_reason, partial(box.set_value, usual_reason))
    return box


def offer(
    view: View,
    label: str,
    line: Callable[[], Sequence[str]],
    *,
    what: str | None = None,
    look: str = "unelevated",
) -> None:
    """A button that runs a command, and the line that does the same; it follows the controls."""

    def action() -> Action:
        return view.session.action(what or label, line())

    def run() -> None:
        view.run(what or label, *line())

    with ui.row().classes("items-center w-full"):
        ui.button(label, on_click=run).props(look)
        shown = command(action().command).classes("text-caption")
        shown.props(f'role=group aria-label="{words.SAME}"')
    view.follow.append(lambda: shown.set_content(action().command))


def download(name: str, label: str | None = None) -> None:
    """A link that saves a file of the folder."""
    with ui.link(target=f"/file/{name}").classes("file"):
        ui.icon("download")
        ui.label(label or name)


def page(name: str, label: str) -> None:
    """A link that opens a page that loopcal wrote."""
    with ui.link(target=f"/page/{name}", new_tab=True).classes("file"):
        ui.icon("open_in_new")
        ui.label(label)


def printed(view: View, command: str) -> None:
    """What the last run of a command printed, since the server started."""
    run = view.session.last.get(command)
    if run is not None and run.text:
        ui.label(run.text).classes("printed")


def _kept(view: View, name: str) -> Callable[[Any], None]:
    return lambda event: view.keep(name, event.value)


# Files handed in through the page: kept in the folder, never executed.

FILES = "document.querySelector('#{box} input[type=file]')"


def uploader(
    view: View,
    label: str,
    then: Callable[[str], Any] = lambda _: None,
    check: Callable[[Path], Any] = lambda _: None,
) -> None:
    """A place to drop files, and a button to choose them; then: called with the name of each;
    check: called with its path, raises for one that is not taken."""

    async def taken(event: Any) -> None:
        content = await event.file.read()

        def take() -> None:
            then(view.session.folder.take(event.file.name, content, view.shown, check).name)

        await view.act_aside(take)

    def going(on: bool) -> None:
        view.uploading = on
        view.session.news.tell()

    with ui.element("div").classes("drop"):
        box = ui.upload(
            label=label,
            multiple=True,
            auto_upload=True,
            max_file_size=LARGEST,
            on_upload=taken,
            on_rejected=lambda: ui.notify(words.TOO_LARGE, type="negative"),
        )
        box.on("start", lambda: going(True)).on("finish", lambda: going(False)).props("flat")
        button = ui.button(words.CHOOSE_FILES, icon="upload_file").props("outline")
        button.props(f'aria-label="{label}: {words.CHOOSE_FILES}"')
        # Every act has a way by keyboard (docs/decisions/0095).
        button.on("click", js_handler=f"() => {FILES.format(box=box.html_id)}.click()")

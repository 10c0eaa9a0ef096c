"""Files for the robot, seen as a difference before they are written; corrected targets; record."""

from __future__ import annotations

from collections.abc import Sequence
from difflib import unified_diff
from pathlib import Path

from nicegui import ui

from loopcal.app import words
from loopcal.app.controls import choice, download, offer, page, printed, pulses, text
from loopcal.app.uploads import uploader
from loopcal.app.view import View, heading
from loopcal.files.exports.format import VENDORS
from loopcal.files.exports.registry import EXPORTS
from loopcal.files.project.project_folder import PREVIEW

PROGRAMS = (".csv", ".tsv", ".txt", ".src", ".dat", ".ls", ".mod", ".jbi", ".script", ".xlsx")
LONGEST = 400
"""Lines of a difference that are shown."""


def show(view: View) -> None:
    """The step."""
    if view.session.source() is None:
        ui.label(words.NO_RESULT)
        return
    if view.session.state().stale:
        ui.label(words.STALE).classes("care")
    _export(view)
    _correct(view)
    _record(view)
    heading(words.FILES_PROJECT)
    for file in view.session.folder.listed():
        download(file.name, f"{file.name} ({_bytes(file.size)})")


def _export(view: View) -> None:
    folder = view.session.folder
    heading(words.EXPORT)
    own = ["", *_named(view, (".urdf", ".xml", ".conf", ".yaml"))]
    with ui.row().classes("items-end"):
        choice(view, "export.to", words.FORMAT, _formats(view), on_change_too=view.refresh)
        one = EXPORTS[str(view.kept["export.to"])]
        if one.source:
            choice(view, "export.source", words.YOUR_OWN_FILE, own if one.optional else own[1:])
        if one.needs == "origins":
            places = {"origin": "into the origins", "file": "into offsets.csv"}
            choice(view, "export.offsets", words.ZERO_OFFSETS_JOINTS, places)
        if one.name == "frames":
            vendors = {k: words.VENDORS[k] for k in ("", *VENDORS)}
            choice(view, "export.vendor", words.ORIENTATIONS, vendors)

    def line(*more: str) -> Sequence[str]:
        asked = ["export", folder.result.name, "--to", one.name]
        if one.source and view.kept.get("export.source"):
            asked += ["--source", str(view.kept["export.source"])]
        if one.needs == "origins" and view.kept["export.offsets"] != "origin":
            asked += ["--offsets", str(view.kept["export.offsets"])]
        if one.name == "frames" and view.kept["export.vendor"]:
            asked += ["--vendor", str(view.kept["export.vendor"])]
        return [*asked, *more]

    ui.label(words.EXPORT_FIRST).classes("text-body2")
    preview = f"{PREVIEW}/{one.name}"
    offer(view, words.PREVIEW, lambda: line("--force", "--out", preview), what=words.PREVIEW_EXPORT)
    ran = view.session.last.get("export")
    if ran is not None and ran.code == 0 and preview in ran.action.words:
        printed(view, "export")
        before = str(view.kept.get("export.source") or "")
        for name in folder.inside_of(preview):
            there = f"{folder.result.name}/export/{name}"
            old = there if folder.content(there) is not None else before
            _difference(view, old, f"{preview}/{name}", name)
        offer(view, words.WRITE, lambda: line("--force"), what=words.EXPORT)
    written = [f.name for f in folder.listed() if f.name.startswith(f"{folder.result.name}/export")]
    for name in written:
        download(name)


def _formats(view: View) -> dict[str, str]:
    """The formats; first that of the robot's own description."""
    project = view.session.project()
    kind = "" if project is None else str((project.mechanism.description or {}).get("type"))
    first = "urdf" if kind == "urdf" else "dh" if project and project.mechanism.chain else "json"
    return {name: words.FORMATS[name] for name in (first, *EXPORTS)}


def _correct(view: View) -> None:
    heading(words.CORRECT_PROGRAM)
    ui.label(words.CORRECT).classes("text-body2")
    uploader(view, words.DROP_PROGRAM)
    files = _named(view, PROGRAMS)
    if not files:
        return
    with ui.row().classes("items-end"):
        choice(view, "correct.file", words.PROGRAM_OR_TARGETS, files)
        choice(view, "correct.tool", words.TOOL_PROGRAM, words.TOOLS)
        text(view, "correct.frame", words.PROGRAM_FRAME)
        text(view, "pulses", words.PULSES)

    def target() -> str:
        path = Path(str(view.kept["correct.file"]))
        return f"{path.stem}-corrected{path.suffix}"

    def line() -> Sequence[str]:
        asked = ["correct", view.session.folder.result.name, str(view.kept["correct.file"])]
        if view.kept["correct.tool"] != "calibrated":
            asked += ["--tool", str(view.kept["correct.tool"])]
        if view.kept["correct.frame"].strip():
            asked += [f"--frame={view.kept['correct.frame'].replace(' ', '')}"]
        return [*asked, *pulses(view), "--force"]

    offer(view, words.CORRECT_IT, line)
    printed(view, "correct")
    if view.session.folder.content(target()) is not None:
        _difference(view, str(view.kept["correct.file"]), target(), target())
        download(target())


def _record(view: View) -> None:
    session = view.session
    heading(words.RECORD_HEAD)
    ui.label(words.RECORD).classes("text-body2")
    project = session.project()
    stated = {} if project is None else project.inputs.get("record") or {}
    with ui.element("div").classes("tiles"):
        for key, label in words.STATED.items():
            box = ui.input(label, value=str(stated.get(key) or "")).classes("w-full")

            def keep(key: str = key, box: object = box) -> None:
                value = str(getattr(box, "value", "") or "").strip()
                if value != str(stated.get(key) or ""):
                    view.act(lambda: session.changed(["record", key], value or None, "record"))

            box.on("blur", keep)
    result = session.folder.result.name
    offer(view, words.WRITE_RECORD, lambda: ("record", result, "--project", view.project_name()))
    if session.folder.content(f"{result}/record.html") is not None:
        page(f"{result}/record.html", words.OPEN_RECORD)


def _difference(view: View, before: str, after: str, name: str) -> None:
    """The lines that change, marked."""
    old = (view.session.folder.content(before) or "").splitlines() if before else []
    new = (view.session.folder.content(after) or "").splitlines()
    lines = list(unified_diff(old, new, before or "nothing", name, lineterm="", n=1))
    with ui.expansion(name, value=True).classes("w-full"):
        ui.label(words.DIFFERENCE if lines else words.NO_DIFFERENCE).classes("text-caption")
        with ui.element("div").classes("printed difference").props('tabindex="0"'):
            for one in lines[:LONGEST]:
                ui.label(one or " ").classes(_kind(one))
            if len(lines) > LONGEST:
                ui.label(f"and {len(lines) - LONGEST:,} lines more")


def _kind(line: str) -> str:
    if line.startswith(("---", "+++", "@@")):
        return "none"
    return "gone" if line.startswith("-") else "come" if line.startswith("+") else ""


def _named(view: View, ends: tuple[str, ...]) -> list[str]:
    """Files of the folder itself that end so."""
    files = [f.name for f in view.session.folder.listed() if "/" not in f.name]
    return [name for name in files if name.lower().endswith(ends)]


def _bytes(size: int) -> str:
    return f"{size:,} bytes" if size < 10_000 else f"{size / 1000:,.0f} kB"

"""Files for the robot, seen as a difference before they are written; corrected targets; record."""

from __future__ import annotations

from collections.abc import Sequence
from difflib import unified_diff
from pathlib import Path

from nicegui import ui

from loopcal.companions.app import words
from loopcal.companions.app.controls import (
    choice,
    download,
    folded,
    offer,
    page,
    printed,
    pulses,
    pulses_field,
    text,
    uploader,
    written,
)
from loopcal.companions.app.view import View, difference, heading
from loopcal.companions.app.views.findings import headline
from loopcal.companions.robot.exports.registry import EXPORTS
from loopcal.companions.robot.exports.tables import ORIENTATIONS
from loopcal.companions.robot.programs.registry import BY_ENDING
from loopcal.files.result.deployed import PREVIEW


def show(view: View) -> None:
    """The step."""
    source = view.session.source()
    if source is None:
        ui.label(view.session.unreadable() or words.NO_RESULT).classes("printed-lines")
        return
    headline(view, source.document)
    _export(view)
    _correct(view)
    _record(view)
    heading(words.FILES_PROJECT)
    for file in view.session.folder.listed():
        download(file.name, f"{file.name} ({_bytes(file.size)})")


def _export(view: View) -> None:
    folder = view.session.folder
    heading(words.EXPORT)
    sources = ["", *view.files((".urdf", ".xml", ".conf", ".yaml"))]
    with ui.row().classes("items-end"):
        choice(view, "export.to", words.FORMAT, _formats(view), on_change_too=view.refresh)
        one = EXPORTS[str(view.kept["export.to"])]
        if one.source:
            choice(
                view, "export.source", words.SOURCE_FILE, sources if one.optional else sources[1:]
            )
        if "offsets" in one.options:
            places = {"origin": "into the origins", "file": "into offsets.csv"}
            choice(view, "export.offsets", words.ZERO_OFFSETS_JOINTS, places)
        if "vendor" in one.options:
            vendors = {name: orientation.label for name, orientation in ORIENTATIONS.items()}
            choice(view, "export.vendor", words.ORIENTATIONS, vendors)
        limbs = limbs_of(view) if one.needs == "chain" else ()
        if limbs:
            choice(view, "export.limb", words.LIMB, limbs)

    def line(*more: str) -> Sequence[str]:
        asked = ["export", view.result_name(), "--to", one.name]
        if one.source and view.kept.get("export.source"):
            asked += ["--source", str(view.kept["export.source"])]
        if "offsets" in one.options and view.kept["export.offsets"] != "origin":
            asked += ["--offsets", str(view.kept["export.offsets"])]
        if "vendor" in one.options and view.kept["export.vendor"]:
            asked += ["--vendor", str(view.kept["export.vendor"])]
        if limbs:
            asked += ["--limb", str(view.kept["export.limb"])]
        return [*asked, *more]

    ui.label(words.EXPORT_FIRST).classes("text-body2")
    # Only Write writes where the robot reads (docs/decisions/0095).
    preview = f"{PREVIEW}/{one.name}"
    offer(view, words.PREVIEW, lambda: line("--force", "--out", preview), what=words.PREVIEW_EXPORT)
    ran = view.session.last.get("export")
    current = not view.session.outdated("export")
    if ran is not None and ran.code == 0 and current and preview in ran.action.words:
        printed(view, "export")
        before = str(view.kept.get("export.source") or "")
        for name in folder.inside_of(preview):
            path = f"{folder.named(folder.export)}/{name}"
            old = path if folder.content(path) is not None else before
            _difference(view, old, f"{preview}/{name}", name)
        offer(view, words.WRITE, lambda: line("--force"), what=words.EXPORT)
    export = folder.named(folder.export)
    written = [f.name for f in folder.listed() if f.name.startswith(export)]
    for name in written:
        _made(view, name)


def _formats(view: View) -> dict[str, str]:
    """The formats; first that of the robot's own description."""
    project = view.session.project()
    kind = "" if project is None else str((project.mechanism.description or {}).get("type"))
    first = "urdf" if kind == "urdf" else "dh" if project and project.mechanism.chain else "json"
    return {name: EXPORTS[name].label for name in (first, *EXPORTS)}


def limbs_of(view: View) -> tuple[str, ...]:
    """The bodies at the ends of a robot of several limbs; none of an arm."""
    project = view.session.project()
    tree = None if project is None or project.mechanism.chain else project.mechanism.tree
    return () if tree is None else tree.leaves


def _correct(view: View) -> None:
    heading(words.CORRECT_PROGRAM)
    ui.label(words.CORRECT).classes("text-body2")
    uploader(view, words.DROP_PROGRAM)
    files = view.files(tuple(BY_ENDING), "deploy")
    if not files:
        return
    with ui.row().classes("items-end"):
        choice(view, "correct.file", words.PROGRAM_OR_TARGETS, files)
        limbs = limbs_of(view)
        if limbs:
            choice(view, "correct.limb", words.LIMB, limbs)
        choice(view, "correct.tool", words.TOOL_PROGRAM, words.TOOLS)
        text(view, "correct.frame", words.PROGRAM_FRAME)
        pulses_field(view, "correct.file")

    def target() -> str:
        path = Path(str(view.kept["correct.file"]))
        return f"{path.stem}-corrected{path.suffix}"

    def line() -> Sequence[str]:
        asked = ["correct", view.result_name(), str(view.kept["correct.file"])]
        if limbs:
            asked += ["--limb", str(view.kept["correct.limb"])]
        if view.kept["correct.tool"] != "calibrated":
            asked += ["--tool", str(view.kept["correct.tool"])]
        if view.kept["correct.frame"].strip():
            # One word: a frame that begins with a minus would be taken for an option.
            asked += [f"--frame={view.kept['correct.frame'].replace(' ', '')}"]
        return [*asked, *pulses(view), "--force"]

    offer(view, words.CORRECT_IT, line)
    if not view.session.outdated("correct"):
        printed(view, "correct")
    if view.session.folder.content(target()) is not None:
        _difference(view, str(view.kept["correct.file"]), target(), target())
        _made(view, target())


def _record(view: View) -> None:
    session = view.session
    heading(words.RECORD_HEAD)
    ui.label(words.RECORD).classes("text-body2")
    project = session.project()
    stated = {} if project is None else project.inputs.get("record") or {}
    count = sum(bool(stated.get(key)) for key in words.STATED)
    label = words.RECORD_FIELDS.format(count=count, all=len(words.STATED))
    with folded(view, "deploy.record", label), ui.element("div").classes("tiles"):
        for key, label in words.STATED.items():
            # A default binds the key of this round; a closure would see that of the last one.
            def keep(said: str, key: str = key) -> None:
                value = said.strip()
                if value != str(stated.get(key) or ""):
                    view.act(lambda: session.changed(["record", key], value or None, "record"))

            box = ui.input(label, value=str(stated.get(key) or "")).classes("w-full")
            written(box, keep)
    result = view.result_name()
    offer(view, words.WRITE_RECORD, lambda: ("record", result, "--project", view.project_name()))
    if session.folder.content(f"{result}/record.html") is not None:
        page(f"{result}/record.html", words.OPEN_RECORD)
        _old(view, f"{result}/record.html")


def _made(view: View, name: str) -> None:
    """A link to a file for the robot, and whether it is of this result."""
    with ui.row().classes("items-center"):
        download(name)
        _old(view, name)


def _old(view: View, name: str) -> None:
    if not view.session.deployed().get(name, True):
        ui.label(words.NOT_OF_RESULT).classes("care")


def _difference(view: View, before: str, after: str, name: str) -> None:
    """The lines that change, marked."""
    old = (view.session.folder.content(before) or "").splitlines() if before else []
    new = (view.session.folder.content(after) or "").splitlines()
    lines = list(unified_diff(old, new, before or "nothing", name, lineterm="", n=1))
    with ui.expansion(name, value=True).classes("w-full"):
        ui.label(words.DIFFERENCE if lines else words.NO_DIFFERENCE).classes("text-caption")
        difference(lines)


def _bytes(size: int) -> str:
    return f"{size:,} bytes" if size < 10_000 else f"{size / 1000:,.0f} kB"

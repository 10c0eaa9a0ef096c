"""The one judgement on a page: the verdict in four lines, and a card for each objection."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from typing import Any

from nicegui import ui

from loopcal.companions.app import words
from loopcal.companions.app.cards import Card, begins, cards, lines
from loopcal.companions.app.view import View, command, table
from loopcal.companions.app.views.linked import Linked
from loopcal.document.change_points import ChangePoints
from loopcal.document.result_document import ResultDocument
from loopcal.document.verdict import Finding
from loopcal.presentation.shown import shortened
from loopcal.report.page import QUESTIONS
from loopcal.report.tables import outlier_table

NAMED = 6
"""Poses that the label of a button names."""


def verdict(document: ResultDocument) -> None:
    """The headline, a line for each question, and behind them what it rests on."""
    if document.verdict is None:
        return
    with ui.element("section").classes(f"card {document.verdict.grade}-edge"):
        head = ui.label(shortened(document.verdict.headline)).classes(document.verdict.grade)
        head.classes("headline").props("role=heading aria-level=2")
        with ui.element("div").classes("answers"):
            for line in lines(document):
                ui.label(QUESTIONS[line.question])
                ui.label(line.mark or words.UNASKED).classes(f"mark {line.grade}")
                ui.label(line.words)
        with ui.expansion(words.WHY).classes("why"):
            for one in document.findings:
                _whole(one)


def _whole(finding: Finding) -> None:
    """All sentences of a finding, what to do, and the command line that does it."""
    then = finding.next
    ui.label(f"{finding.words} {then.words if then else ''}")
    if then and then.command:
        command(then.command)


def offer_findings(linked: Linked, document: ResultDocument, switch: Callable[[], Any]) -> None:
    """A card for each objection, with what can be done about it; switch: shows the errors before
    the changes along the run are taken up, or after."""
    with ui.element("div").classes("cards"):
        for card in cards(document):
            with ui.element("section").classes(f"card {card.grade}-edge"):
                title = ui.label(card.title).classes(f"{card.grade} card-title")
                title.props("role=heading aria-level=2")
                if card.changes is not None and len(card.changes.found) > 1:
                    for point in card.changes.found:
                        ui.label(f"{point}.").classes("detail sentence")
                elif card.details:
                    ui.label(card.details).classes("detail")
                with ui.element("div").classes("deeds"):
                    _deeds(linked, card, switch)
                with ui.expansion(words.WHY).classes("why"):
                    _whole(card.finding)
                    outliers = outlier_table(document) if card.poses else None
                    if outliers is not None:
                        table(outliers.head, outliers.rows)


def _deeds(linked: Linked, card: Card, switch: Callable[[], Any]) -> None:
    view = linked.view
    if card.changes is not None:
        _changes(linked, card.changes, absorbed=card.absorbed, switch=switch)
    excluded = set(view.session.left_out())
    poses = [pose for pose in card.poses if pose not in excluded]
    if poses:
        every = linked.errors.source.table.poses
        places = [every.index(pose) for pose in poses if pose in every]
        if places:
            ui.button(words.SELECT_THESE_POSES, on_click=partial(linked.select, places)).props(
                "outline"
            )
        more = "" if len(poses) <= NAMED else " ..."
        label = words.EXCLUDE_NAMED.format(poses=", ".join(poses[:NAMED]) + more)
        exclude = partial(view.session.excluded, poses, card.title)
        ui.button(label, on_click=partial(view.act_aside, exclude)).props("unelevated")


def _changes(
    linked: Linked, changes: ChangePoints, *, absorbed: bool, switch: Callable[[], Any]
) -> None:
    """Accept them, see them, select the runs between them."""
    view = linked.view
    poses = linked.errors.source.table.poses
    starts = begins(changes.found, poses)
    stated = set(view.session.steps())
    if starts and set(starts) <= stated:
        ui.label(words.ACCEPTED).classes("good")
    elif changes.toml:
        accept = partial(view.session.modelled, changes, words.BY_LOOPCAL)
        ui.button(words.ACCEPT, on_click=partial(view.act_aside, accept)).props("unelevated")
    if absorbed:
        shown = bool(view.kept.get("diagnose.before"))
        toggle = ui.toggle(words.BEFORE_AFTER, value=shown).props("no-caps")
        toggle.props(f'aria-label="{words.BEFORE_AFTER_NAME}"')

        def switched(event: Any) -> None:
            view.keep("diagnose.before", bool(event.value))
            switch()

        toggle.on_value_change(switched)
    steps = [poses.index(p.pose) for p in changes.found if p.shape == "step" and p.pose in poses]
    _runs(linked, steps)


def _runs(linked: Linked, steps: Sequence[int]) -> None:
    """The runs of poses between positions where something has changed."""
    if not steps:
        return
    poses = linked.errors.source.table.poses
    with ui.button(words.RUNS, icon="arrow_drop_down").props("outline"), ui.menu():
        for first, end in pairwise(sorted({0, *steps, len(poses)})):
            label = words.RUN.format(first=poses[first], last=poses[end - 1])
            ui.menu_item(label, partial(linked.select, range(first, end)))


def headline(view: View, document: ResultDocument) -> None:
    """The verdict in one line, where the result is used."""
    if document.verdict is not None:
        ui.label(shortened(document.verdict.headline)).classes(f"headline {document.verdict.grade}")
    if view.session.stale:
        ui.label(words.STALE).classes("care")

"""What pages say first: the findings of the one judgement, and what can be done about each."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

from loopcal.document.change_points import ChangePoint, ChangePoints
from loopcal.document.result_document import ResultDocument
from loopcal.document.verdict import QUESTIONS, Finding, Question
from loopcal.presentation.shown import shortened, with_unit
from loopcal.statistics.changes import ids_are_numbers

GRADES = {"yes": "good", "open": "care", "no": "bad"}
"""The light of an answer."""
CHANGES = {"change-points": False, "changes-small": False, "changes-modelled": True}
"""Codes of findings on changes along the run -> whether the result models these."""


@dataclass(frozen=True)
class Card:
    """One finding; title, details: its sentences, as report and command line print them.

    poses: of those it names, the ones to exclude; changes: those along the run that it names, with
    the lines that state them; absorbed: whether the result models these already.
    """

    finding: Finding
    title: str
    details: str
    poses: tuple[str, ...] = ()
    changes: ChangePoints | None = None
    absorbed: bool = False

    @property
    def grade(self) -> str:
        """Its light."""
        return GRADES[self.finding.mark]


def cards(document: ResultDocument) -> list[Card]:
    """A card for each finding for which the result is not sound, the gravest first."""
    against = [f for f in document.findings if f.question == "sound" and f.severity != "info"]
    return [_card(document, one) for one in against]


def _card(document: ResultDocument, finding: Finding) -> Card:
    title = finding.title or finding.words
    card = Card(finding, title, finding.words.removeprefix(title).strip())
    if finding.code == "outliers":
        return replace(card, poses=finding.place.poses)
    absorbed, changes = CHANGES.get(finding.code), document.change_points
    if absorbed is None or changes is None:
        return card
    points = tuple(p for p in changes.found if p.modelled == absorbed)
    return replace(card, changes=replace(changes, found=points), absorbed=absorbed)


@dataclass(frozen=True)
class Line:
    """The answer to one question; words: one line, with the number that it rests on."""

    question: Question
    mark: str
    grade: str
    words: str


def lines(document: ResultDocument) -> list[Line]:
    """The verdict: a line for each question."""
    verdict = document.verdict
    if verdict is None:
        return []
    answers = verdict.answers
    first = {q: next((f for f in document.findings if f.question == q), None) for q in QUESTIONS}
    return [
        Line(
            question,
            answer.mark if answer.asked else "",
            GRADES[answer.mark] if answer.asked else "none",
            _beside(verdict.headline, first[question], _short(first[question], answer.words)),
        )
        for question, answer in answers.items()
    ]


def _beside(headline: str, finding: Finding | None, line: str) -> str:
    """What a line says below the headline: what follows it where the headline says it already."""
    if finding is None or line.rstrip(".").lower() not in headline.lower():
        return line
    rest = finding.words.removeprefix(finding.title or line).strip()
    return shortened(rest) or line


def _short(finding: Finding | None, otherwise: str) -> str:
    """The title of a finding; the figure that decides follows where the title has none."""
    if finding is None or not finding.title:
        return shortened(otherwise)
    title = shortened(finding.title)
    figure = next(iter(finding.numbers.items()), None)
    if figure is None or re.search(r"\d", title):
        return title
    name, number = figure
    return f"{title.rstrip('.')}: {name.replace('_', ' ')} {with_unit(number.value, number.unit)}."


def begins(points: Collection[ChangePoint], poses: Sequence[str]) -> dict[float, ChangePoint]:
    """The numbers of the poses from which on something has changed at once.

    They are ids where these are rising numbers, else the position in the run.
    """
    steps = [p for p in points if p.shape == "step"]
    numbered = ids_are_numbers(poses)
    return {float(p.pose) if numbered else float(p.number): p for p in steps}

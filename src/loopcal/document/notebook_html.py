"""A result as notebooks show it: verdict, accuracy, and parameters coloured by validity."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from loopcal.document.fit import ParameterEntry, Validity, validity
from loopcal.document.result_document import ResultDocument
from loopcal.document.tables import accuracy_stages, distances_shown, shown_parameters
from loopcal.document.verdict import Verdict
from loopcal.presentation.html import FIRST, framed, row
from loopcal.presentation.shown import NONE, by_sd, size, unit_shown

_GREEN, _AMBER, _RED, _GREY = "#2c9a62", "#b8860b", "#c8304b", "#8d8f96"
"""Legible on light and on dark; words stand beside every colour."""
_GRADES = {"good": _GREEN, "care": _AMBER, "bad": _RED}
_MARKS = {"yes": _GREEN, "open": _AMBER, "no": _RED}
_VALIDITY: dict[Validity, tuple[str, str]] = {
    "determined": (_GREEN, "determined"),
    "prior": (_AMBER, "mostly prior"),
    "undetermined": (_RED, "not determined"),
    "fixed": (_GREY, "fixed"),
}


def result_html(document: ResultDocument) -> str:
    """The verdict, the accuracies, the parameters and the warnings of a result."""
    name = document.mechanism.name if document.mechanism else document.title or ""
    parts = [f"<p><b>{escape(name)}</b>: {escape(document.method_label or document.method)}</p>"]
    if document.verdict is not None:
        parts.append(_verdict(document.verdict))
    if not document.status.converged:
        parts.append(f"<p {_ink(_RED)}>Not converged: {escape(document.status.message)}</p>")
    parts += [_accuracy(document)]
    parts += [parameters_html(shown_parameters(document.parameters, document.terms))]
    parts += [f"<p>Warning: {escape(words)}</p>" for words in document.warnings]
    return f"<div>{''.join(parts)}</div>"


def parameters_html(entries: Sequence[ParameterEntry]) -> str:
    """A table of parameters; the colour and the word of the last column say how far to trust."""
    rows = []
    for entry in entries:
        colour, words = _VALIDITY[validity(entry)]
        sd, unit = entry.sd, entry.unit
        change = NONE if entry.fixed else by_sd(entry.value - entry.nominal, sd, unit, sign=True)
        shown = [entry.name, by_sd(entry.value, sd, unit), change]
        shown += [NONE if sd is None else size(sd, unit, 2), unit_shown(unit)]
        rows.append(row(shown, f"<td {_ink(colour, FIRST)}>&#9679; {words}</td>"))
    return framed(("parameter", "value", "change", "sd", "unit", "validity"), rows)


def _verdict(verdict: Verdict) -> str:
    colour = _GRADES[verdict.grade]
    lines = [f"<b {_ink(colour)}>{escape(verdict.headline)}</b>"]
    for question, answer in verdict.answers.items():
        mark = f"<span {_ink(_MARKS[answer.mark])}>{answer.mark}</span>"
        after = f" <i>{escape(answer.next)}</i>" if answer.next and answer.asked else ""
        lines.append(f"{question}: {mark}. {escape(answer.words)}{after}")
    style = f"border-left:4px solid {colour};padding-left:8px"
    return f'<p style="{style}">{"<br>".join(lines)}</p>'


def _accuracy(document: ResultDocument) -> str:
    accuracy = document.accuracy
    if accuracy is None:
        return "<p>Accuracy unknown: no pose predicts an output.</p>"
    stages = accuracy_stages(accuracy, document.validation, document.updated)
    tables = []
    for what, unit, rows in (
        ("accuracy", accuracy.unit, stages.position),
        ("orientation", "rad", stages.orientation),
    ):
        cells = [
            row([f"{s.name} {s.instrument}".strip(), *distances_shown(s.distances, unit)])
            for s in rows
        ]
        if cells and what == "accuracy" and stages.noise_floor is not None:
            cells.append(row(["noise floor", "", size(stages.noise_floor, unit), "", ""]))
        if cells:
            tables.append(framed((f"{what} [{unit_shown(unit)}]", *_HEAD), cells))
    return "".join(tables)


_HEAD = ("mean", "rms", "95 %", "max")


def _ink(colour: str, more: str = "") -> str:
    return f'style="color:{colour};{more}"' if more else f'style="color:{colour}"'

"""A row of the catalogue: the question that a fact answers, its severity and its words."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import dataclass, fields
from string import Formatter
from types import SimpleNamespace

from loopcal.document.judgement import Fact, Figure, Finding, NextStep, Question, Severity, Where


@dataclass(frozen=True)
class Row:
    """What a fact amounts to, and how it reads."""

    question: Question | None
    """That it answers; None: a remark."""
    severity: Severity
    fact: str
    """Code of the fact."""
    sentence: str
    remedy: str | None = None
    command: str | None = None
    """A command line that does what the remedy advises, or shows what it speaks of."""
    detail: str = ""
    """What follows the sentence."""
    title: str | None = None
    """The finding in one line, where that is not the sentence."""
    shared: str | None = None
    """Code of the finding, where several facts lead to it; else that of the fact."""

    @property
    def code(self) -> str:
        """Of the finding."""
        return self.shared or self.fact

    @property
    def page(self) -> str:
        """Its page of the documentation."""
        return f"reference/codes/{self.code}.html"

    @property
    def example(self) -> Finding:
        """The finding with made-up numbers and names."""
        templates = "".join((self.sentence, self.detail, self.remedy or ""))
        named = [(str(name), form) for _, name, form, _ in Formatter().parse(templates) if name]
        # In a template numbers have a format and names have none.
        numbers = {name: Figure(0.0123) for name, form in named if form}
        place = Where(*(("example",) for _ in fields(Where)))
        return self.finding(
            Fact(self.fact, numbers, place, {n: "example" for n, f in named if not f})
        )

    def finding(self, fact: Fact, files: Mapping[str, str] = {}) -> Finding:
        """The finding that a fact leads to; files: for the command."""
        place = {one.name: ", ".join(getattr(fact.place, one.name)) for one in fields(Where)}
        values = {**fact.texts, **fact.numbers, "place": SimpleNamespace(**place)}
        sentence = self.sentence.format_map(values)
        return Finding(
            self.code,
            self.severity,
            self.question,
            fact.place,
            fact.numbers,
            " ".join(filter(None, (sentence, self.detail.format_map(values)))),
            NextStep(self.remedy.format_map(values), self._line(files)) if self.remedy else None,
            sentence if self.title is None else self.title.format_map(values),
        )

    def _line(self, files: Mapping[str, str]) -> str | None:
        """The command for these files; None where one that it names is not at hand."""
        if not self.command:
            return None
        if not {name for _, name, _, _ in Formatter().parse(self.command) if name} <= {*files}:
            return None
        # Quoted, because the line is pasted into a shell and paths may have blanks.
        return self.command.format_map({k: shlex.quote(path) for k, path in files.items()})

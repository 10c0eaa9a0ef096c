"""The verdict on a calibration: four questions, each with an answer, a number and a next step.

Facts and findings: what was found out, which question it answers, and what to do.

An analysis states facts: a code, numbers with units, a place. `loopcal.document.catalogue` holds a
row for each code, which turns a fact into a finding with its sentence and its next step.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from string import Formatter
from types import SimpleNamespace
from typing import Literal

from loopcal.presentation.shown import p_words, percent, shortened, significant, with_unit, wrapped

QUESTIONS: tuple[Question, ...] = ("sound", "valid", "better", "tolerance")
"""The four questions, in the order in which they are asked."""
UNASKED = "no-tolerance"
"""The code of the one question that a user need not ask."""
_ALONE = "column-fault"
"""The finding from which all others on its question follow."""


@dataclass(frozen=True)
class Answer:
    """The answer to one of the four questions."""

    passed: bool | None
    """Null: undecided, or not asked."""
    code: str
    """The kind of the answer: stable, for programs."""
    number: float | None
    """What the answer rests on [SI, or a ratio]; null: no number."""
    words: str
    """The answer in a sentence."""
    next: str | None
    """What to do next; null: nothing."""
    codes: tuple[str, ...] = ()
    """Of the findings that it rests on, the gravest first."""
    command: str | None = None
    """The command line that does what is next, for the user's files; null: none."""

    @property
    def asked(self) -> bool:
        """False for the tolerance where none is stated."""
        return self.code != UNASKED

    @property
    def mark(self) -> str:
        """yes, no or open."""
        return "open" if self.passed is None else "yes" if self.passed else "no"

    @classmethod
    def of(cls, findings: Iterable[Finding], question: Question) -> Answer:
        """What the findings, the gravest first, answer to a question."""
        every = [one for one in findings if one.question == question]
        if not every:
            return cls(None, UNASKED, None, "No tolerance is stated.", "State a tolerance.")
        first, shown = every[0], [one for one in every if one.severity != "info"] or every
        step = first.next or NextStep("")
        # All else on the question follows from a file at fault: only that is named (record 0054).
        words = " ".join(one.words for one in (every[:1] if first.code == _ALONE else shown))
        codes, remedy = tuple(one.code for one in every), step.words or None
        passed, command = answered(every), step.command
        return cls(passed, first.code, first.number, words, remedy, codes, command)


@dataclass(frozen=True)
class Verdict:
    """Whether a calibration can be used, and for what."""

    sound: Answer
    """Converged, and noise and model are consistent."""
    valid: Answer
    """Where: the predicted sd in the working region beside that at the measured poses."""
    better: Answer
    """Better than the nominal machine, placed and mounted, and than plain least squares."""
    tolerance: Answer
    """Good enough for the stated tolerance."""
    headline: str
    """The worst of the answers in one sentence."""

    @classmethod
    def of(cls, findings: Sequence[Finding], project: str | None = None) -> Verdict:
        """The verdict that the findings on a calibration, the gravest first, amount to.

        project: file in which a tolerance can be stated, for the command line that does it.
        """
        answers = {question: Answer.of(findings, question) for question in QUESTIONS}
        if project is not None and not answers["tolerance"].asked:
            line = f"loopcal calibrate {shlex.quote(project)} --tolerance 0.5"
            answers["tolerance"] = replace(answers["tolerance"], command=line)
        return cls(**answers, headline=_headline(answers, findings))

    @property
    def findings(self) -> tuple[Finding, ...]:
        """One for each answer, of a verdict that an earlier version wrote without findings."""
        severities: dict[bool | None, Severity] = {False: "refuse", None: "caution", True: "info"}
        made = [
            Finding(
                answer.code,
                severities[answer.passed],
                question,
                Where(),
                {},
                answer.words,
                None if answer.next is None else NextStep(answer.next),
                answer.words,
            )
            for question, answer in zip(QUESTIONS, self.answers.values(), strict=True)
            if answer.asked
        ]
        return tuple(sorted(made, key=lambda one: SEVERITIES.index(one.severity)))

    @property
    def grade(self) -> str:
        """good, care or bad: of the worst answer."""
        asked = [a.passed for a in self.answers.values() if a.asked]
        return "bad" if False in asked else "care" if None in asked else "good"

    @property
    def ok(self) -> bool:
        """Whether all that was asked is answered yes; the truth value of a verdict is the same."""
        return self.grade == "good"

    def __bool__(self) -> bool:
        return self.ok

    def __repr__(self) -> str:
        answers = ", ".join(f"{name} {answer.mark}" for name, answer in self.answers.items())
        return f"<Verdict: {self.headline} ({answers})>"

    @property
    def answers(self) -> dict[Question, Answer]:
        """By question."""
        return {name: getattr(self, name) for name in QUESTIONS}

    def lines(self) -> list[str]:
        """The headline, and a line for each question with what to do."""
        return [*wrapped(self.headline), *answer_lines(self.answers)]


def answer_lines(answers: Mapping[Question, Answer]) -> list[str]:
    """A line for each question, what to do, and the command line that does it."""
    lines = []
    wide = max(map(len, answers))
    for name, answer in answers.items():
        head, margin = f"  {name:<{wide}}  {answer.mark:<4}  ", " " * (wide + 10)
        lines += wrapped(answer.words, head, margin)
        if answer.next and (answer.asked or answer.command):
            lines += wrapped(answer.next, margin, margin)
        if answer.command:  # in one line, to be copied
            lines.append(margin + answer.command)
    return lines


_NOT_JUDGED = Answer(None, "not-judged", None, "Not judged.", "Calibrate again.")
UNJUDGED = Verdict(
    _NOT_JUDGED,
    _NOT_JUDGED,
    _NOT_JUDGED,
    Answer.of((), "tolerance"),
    "Not judged: an earlier version of loopcal wrote this result. Calibrate again.",
)
"""Of a result without a verdict."""

_HEADS = {
    "sound": "Do not use this result",
    "valid": "Use it near the measured poses only",
    "better": "Do not use this result",
    "tolerance": "Not good enough",
}


def _headline(answers: Mapping[Question, Answer], findings: Sequence[Finding]) -> str:
    """The worst of the answers in one sentence."""
    # The gravest come first: reversed, the title that stays is that of the gravest.
    titles = {one.question: _after_colon(one.title) for one in reversed(findings)}
    for question, answer in answers.items():
        if answer.passed is False:
            return f"{_HEADS[question]}: {titles[question]}"
    for question, answer in answers.items():
        if answer.passed is None and answer.asked:
            return f"Use it with care: {titles[question]}"
    return f"Sound, valid in the working region, and {titles['better']}"


def _after_colon(title: str) -> str:
    """A sentence as it follows a colon, cut where it is long: a name stays as it is written."""
    word = title.split()[0]
    usual = word.isalpha() and len(word) > 1 and word.istitle()
    return shortened(title[0].lower() + title[1:] if usual else title)


Named = str | Sequence[str]
"""What stands for a file in a command: its name, or the names of several."""

# A row of the catalogue: the question that a fact answers, its severity and its words.


# Chosen, not derived: what fits a line.
_LABELLED = 2
"""Of so many parameters at most a sentence says what they are."""


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

    def finding(
        self, fact: Fact, files: Mapping[str, Named] = {}, labels: Mapping[str, str] = {}
    ) -> Finding:
        """The finding that a fact leads to; files: for the command; labels: by name of a parameter,
        what a sentence that names few calls it."""
        place = {one.name: ", ".join(getattr(fact.place, one.name)) for one in fields(Where)}
        place["names"] = place["parameters"]
        if len(fact.place.parameters) <= _LABELLED:
            place["parameters"] = " and ".join(labels.get(n, n) for n in fact.place.parameters)
        values = {**fact.texts, **fact.numbers, "place": SimpleNamespace(**place)}
        sentence = self.sentence.format_map(values)
        return Finding(
            self.code,
            self.severity,
            self.question,
            fact.place,
            fact.numbers,
            " ".join(filter(None, (sentence, self.detail.format_map(values)))),
            NextStep(self.remedy.format_map(values), self._line(fact, files))
            if self.remedy
            else None,
            sentence if self.title is None else self.title.format_map(values),
        )

    def _line(self, fact: Fact, files: Mapping[str, Named]) -> str | None:
        """The command for these files; None where one that it names is not at hand."""
        if not self.command:
            return None
        words: Mapping[str, Named] = {**fact.texts, **files}
        if not {name for _, name, _, _ in Formatter().parse(self.command) if name} <= {*words}:
            return None
        # Quoted, because the line is pasted into a shell and paths may have blanks.
        each = {k: [one] if isinstance(one, str) else one for k, one in words.items()}
        return self.command.format_map({k: shlex.join(some) for k, some in each.items()})


Severity = Literal["refuse", "caution", "info"]
Question = Literal["sound", "valid", "better", "tolerance", "consistent"]
SEVERITIES: tuple[Severity, ...] = ("refuse", "caution", "info")
"""The gravest first."""


@dataclass(frozen=True)
class Figure:
    """A number behind a finding."""

    value: float
    unit: str = "1"
    """SI unit, "1" for a ratio or a count."""

    def __format__(self, form: str) -> str:
        """For people: "3" significant digits, "1%" decimals of a percentage, "p" a probability.

        >>> f"{Figure(0.00123456, 'm'):2}, {Figure(0.512):1%}, {Figure(3e-9):p}"
        '1.2 mm, 51.2 %, p < 1e-6'
        """
        if form == "p":
            return p_words(self.value)
        if form.endswith("%"):
            return percent(self.value, int(form[:-1] or 0))
        digits = int(form or 3)
        if self.unit == "1":
            return significant(self.value, digits)
        return with_unit(self.value, self.unit, digits)


@dataclass(frozen=True)
class Where:
    """What a finding speaks of, by names; all empty: the calibration as a whole."""

    poses: tuple[str, ...] = ()
    readings: tuple[str, ...] = ()
    parameters: tuple[str, ...] = ()
    targets: tuple[str, ...] = ()
    files: tuple[str, ...] = ()


@dataclass(frozen=True)
class Fact:
    """What an analysis found out; the first number is the one that decides."""

    code: str
    numbers: Mapping[str, Figure] = field(default_factory=dict)
    place: Where = Where()
    texts: Mapping[str, str] = field(default_factory=dict)
    """Names and phrases for its sentence."""


def fact(
    code: str, place: Where = Where(), numbers: Mapping[str, float | Figure] = {}, **texts: str
) -> Fact:
    """A fact; plain numbers are ratios or counts."""
    figures = {n: v if isinstance(v, Figure) else Figure(v) for n, v in numbers.items()}
    return Fact(code, figures, place, texts)


@dataclass(frozen=True)
class NextStep:
    """What to do about a finding."""

    words: str
    command: str | None = None
    """A command line to copy; null: none does it alone."""


@dataclass(frozen=True)
class Finding:
    """One thing that was found out about a result."""

    code: str
    """Stable, for programs; docs/explanation/verdict.md describes each."""
    severity: Severity
    """refuse: the answer is no; caution: it stays open; info: no objection."""
    question: Question | None
    """The question that it answers; null: none."""
    place: Where
    numbers: Mapping[str, Figure]
    words: str
    next: NextStep | None
    """Null: nothing is to be done."""
    title: str = ""
    """The finding in one line; empty: written by an earlier version."""

    @property
    def mark(self) -> str:
        """no, open or yes: the answer that it leads to."""
        return {"refuse": "no", "caution": "open", "info": "yes"}[self.severity]

    @property
    def number(self) -> float | None:
        """The figure that decides."""
        return next((figure.value for figure in self.numbers.values()), None)


def answered(findings: Iterable[Finding]) -> bool | None:
    """What the findings on a question answer: False where one refuses, None where one leaves it
    open, else True."""
    severities = {one.severity for one in findings}
    return False if "refuse" in severities else None if "caution" in severities else True

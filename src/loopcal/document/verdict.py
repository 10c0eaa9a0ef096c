"""The verdict on a calibration: four questions, each with an answer, a number and a next step."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from loopcal.document.judgement import (
    SEVERITIES,
    Finding,
    NextStep,
    Question,
    Severity,
    Where,
    answered,
)
from loopcal.presentation.wrapped import shortened, wrapped

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
        # All else on the question follows from a file at fault: only that is named (record 0054).
        words = " ".join(one.words for one in (every[:1] if first.code == _ALONE else shown))
        remedy, codes = first.next.words if first.next else None, tuple(one.code for one in every)
        return cls(answered(every), first.code, first.number, words, remedy, codes)


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
    def of(cls, findings: Sequence[Finding]) -> Verdict:
        """The verdict that the findings on a calibration, the gravest first, amount to."""
        answers = {question: Answer.of(findings, question) for question in QUESTIONS}
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

    @property
    def answers(self) -> dict[Question, Answer]:
        """By question."""
        return {name: getattr(self, name) for name in QUESTIONS}

    def lines(self) -> list[str]:
        """The headline, and a line for each question with what to do."""
        return [*wrapped(self.headline), *answer_lines(self.answers)]


def answer_lines(answers: Mapping[Question, Answer]) -> list[str]:
    """A line for each question, and what to do."""
    lines = []
    wide = max(map(len, answers))
    for name, answer in answers.items():
        head, margin = f"  {name:<{wide}}  {answer.mark:<4}  ", " " * (wide + 10)
        lines += wrapped(answer.words, head, margin)
        if answer.next and answer.asked:
            lines += wrapped(answer.next, margin, margin)
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

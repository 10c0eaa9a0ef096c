"""The findings on a calibration, from all facts of its document, and the verdict they amount to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from loopcal.document import catalogue
from loopcal.document.catalogue import CATALOGUE
from loopcal.document.judgement import Finding, fact
from loopcal.document.result_document import ResultDocument
from loopcal.document.verdict import Answer, Verdict
from loopcal.estimation.fit_document import fit_document
from loopcal.estimation.result import Result
from loopcal.statistics.answers import better, good_enough, valid
from loopcal.statistics.calibration_document import calibration_document, with_findings
from loopcal.statistics.findings import Findings, findings
from loopcal.statistics.region import Span
from loopcal.statistics.sound import SOUND

if TYPE_CHECKING:
    from loopcal.statistics.validation import Validation


def refuses(question: str, answer: Answer) -> bool:
    """Whether an answer stops a run that requires this question: "sound" where it fails, the
    others unless they pass."""
    return answer.passed is False if question == "sound" else answer.passed is not True


def judged(
    document: ResultDocument, tolerance: float | None = None, files: Mapping[str, str] = {}
) -> ResultDocument:
    """The document with all findings and its verdict.

    tolerance: distance [SI] that 95 % of poses shall keep; files: names of project and result, for
    command lines.
    """
    made = findings_of(document, tolerance, files)
    return replace(document, verdict=Verdict.of(made), findings=made)


def findings_of(
    document: ResultDocument, tolerance: float | None = None, files: Mapping[str, str] = {}
) -> tuple[Finding, ...]:
    """All findings on a result, the gravest first; arguments as in `judged`."""
    facts = [one for analysis in SOUND if (one := analysis(document))]
    if all(CATALOGUE[one.code].severity == "info" for one in facts):
        facts.append(fact("sound"))
    others = (valid(document), better(document), good_enough(document, tolerance))
    return catalogue.findings([*facts, *(one for one in others if one)], files)


def verdict(
    result: Result,
    *,
    validation: Validation | None = None,
    tolerance: float | None = None,
    region: Mapping[str, Span] | None = None,
    found: Findings | None = None,
) -> Verdict:
    """Whether a calibration can be used, and for what: four answers and a headline.

    validation: of the same calibration, without which nothing says what it is better than;
    tolerance: distance [SI] that 95 % of poses in the working region shall keep; region: reading ->
    range [SI] where the machine works, by default its joints' limits; found: the `findings` of the
    result, if they are at hand.
    """
    parts = result.parts
    if validation is not None:
        parts = replace(parts, validation=validation.entry)
    document = calibration_document(fit_document(result), parts)
    document = with_findings(document, found or findings(result, region))
    return Verdict.of(findings_of(document, tolerance))

"""The verdict on a document, and the one finding that a fact leads to."""

from __future__ import annotations

from loopcal.document.catalogue import CATALOGUE
from loopcal.document.result_document import ResultDocument
from loopcal.document.verdict import Fact, Finding, Verdict
from loopcal.statistics.verdict import findings_of


def verdict_of(document: ResultDocument, tolerance: float | None = None) -> Verdict:
    """What all findings on a document amount to."""
    return Verdict.of(findings_of(document, tolerance))


def finding_of(fact: Fact | None) -> Finding:
    """By the catalogue."""
    assert fact is not None
    return CATALOGUE[fact.code].finding(fact)

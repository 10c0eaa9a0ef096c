"""The verdict on a result in memory: its findings are computed first."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from loopcal.document.verdict import Verdict
from loopcal.estimation.result import Result
from loopcal.statistics.findings import Findings, findings
from loopcal.statistics.region import Span
from loopcal.statistics.verdict import verdict_of

if TYPE_CHECKING:
    from loopcal.statistics.validation import Validation


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
    document = (found or findings(result, region)).added_to(result.document)
    if validation is not None:
        document = validation.added_to(document)
    return verdict_of(document, tolerance)

"""Whether the dates of a record agree with each other: what does not is a caution."""

from __future__ import annotations

import re
from collections.abc import Mapping

from loopcal.document.result_document import ResultDocument
from loopcal.measurements.days import Days

_DAY = re.compile(r"(?<!\d)\d{4}-\d{2}-\d{2}(?!\d)")
KEYS = ("date", "received", "issued", "instrument_calibrated", "instrument_due")
"""Keys of [record] that state days."""


def date_cautions(document: ResultDocument, texts: Mapping[str, str]) -> tuple[str, ...]:
    """What does not agree, with both dates; texts: those of [record]."""
    days = {key: Days.of_text(texts[key]) for key in KEYS if key in texts}
    cautions = [
        f'[record] {key} is "{texts[key]}", which is no day: its order is not checked. '
        "Write it as 2026-11-02."
        for key, day in days.items()
        if day is None
    ]
    stated, read = days.get("date"), document.data.measured
    if stated is not None and read is not None and stated != read:
        cautions.append(f"The readings are dated {read}, but [record] date is {stated}.")
    measured = read or stated
    certificate = days.get("instrument_calibrated") or _in_text(texts.get("traceability", ""))
    due = days.get("instrument_due")
    if measured is None:
        if certificate is not None or due is not None:
            cautions.append(
                "The day of the measurement is not stated: whether the certificate of the "
                "instrument covers it is not known. State [record] date."
            )
        return tuple(cautions)
    if certificate is not None and measured.first < certificate.first:
        cautions.append(
            f"The instrument was calibrated on {certificate}, after the measurement of {measured}: "
            "its certificate does not cover the measurement. State the certificate before it."
        )
    if due is not None and due.last < measured.last:
        cautions.append(
            f"The certificate of the instrument expired on {due}, before the measurement of "
            f"{measured}. Have the instrument calibrated."
        )
    for key, late in (("received", False), ("issued", True)):
        day = days.get(key)
        if day is None:
            continue
        wrong = day.last < measured.last if late else measured.first < day.first
        if wrong:
            order = "before" if late else "after"
            cautions.append(
                f"[record] {key} is {day}, {order} the measurement of {measured}. Correct one."
            )
    return tuple(cautions)


def _in_text(text: str) -> Days | None:
    """The only day in a text; which of several is that of a certificate is not guessed."""
    days = {day for day in map(Days.of_text, _DAY.findall(text)) if day is not None}
    return days.pop() if len(days) == 1 else None

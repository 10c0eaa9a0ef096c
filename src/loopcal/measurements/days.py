"""Days of a measurement, as files and people write them."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import UTC, date, datetime

_DAY = r"(\d{4}-\d{2}-\d{2})"
_SPAN = re.compile(rf"\s*{_DAY}(?:\s*(?:/|to|–|until)\s*{_DAY})?\s*")
_MOMENT = re.compile(rf"\s*{_DAY}(?:[T ]\s*\d{{1,2}}:\d{{2}}.*)?", re.DOTALL)

_FORMS = ("%d.%m.%Y %H:%M:%S", "%d/%m/%Y %H:%M:%S", "%Y/%m/%d %H:%M:%S", "%H:%M:%S", "%H:%M:%S.%f")
"""Of moments, besides those of ISO 8601."""


@dataclass(frozen=True)
class Days:
    """The first and the last day, as ISO 8601 writes them."""

    first: str
    last: str

    @classmethod
    def of_text(cls, text: str) -> Days | None:
        """Of "2026-11-02" or "2026-11-02 to 2026-11-04"; None for any other text.

        >>> Days.of_text("2026-11-02 to 2026-11-04").last
        '2026-11-04'
        >>> Days.of_text("in November") is None
        True
        """
        match = _SPAN.fullmatch(text)
        if match is None:
            return None
        first, last = match[1], match[2] or match[1]
        return cls(first, last) if _is_day(first) and _is_day(last) and first <= last else None

    @classmethod
    def of_moments(cls, texts: Iterable[str]) -> Days | None:
        """Of dates or times such as "2026-11-02T08:30:00"; None where one of them is none."""
        days = set()
        for text in texts:
            match = _MOMENT.fullmatch(text)
            if match is None or not _is_day(match[1]):
                return None
            days.add(match[1])
        return cls(min(days), max(days)) if days else None

    def __str__(self) -> str:
        return self.first if self.first == self.last else f"{self.first} to {self.last}"


def _is_day(text: str) -> bool:
    try:
        date.fromisoformat(text)
    except ValueError:
        return False
    return True


def seconds_of(texts: Iterable[str]) -> list[float] | None:
    """Moments or times of day [s], as UTC where they name no zone; None where one text is none.

    >>> seconds_of(["1970-01-01 00:01:00", "01.01.1970 00:02:00"])
    [60.0, 120.0]
    """
    try:
        return [_moment(text.strip()).timestamp() for text in texts]
    except (ValueError, OverflowError):
        return None


def _moment(text: str) -> datetime:
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        for form in _FORMS:
            try:
                moment = datetime.strptime(text, form)
            except ValueError:
                continue
            break
        else:
            raise
    return moment if moment.tzinfo else moment.replace(tzinfo=UTC)

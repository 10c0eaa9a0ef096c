"""What a report says beyond the calibration: what was made of it, and what other days showed."""

from __future__ import annotations

from collections.abc import Iterator

from loopcal.files.result.deployed import OTHER_DAYS
from loopcal.report.source import Source
from loopcal.report.templates import Section


def sections(source: Source) -> Iterator[Section]:
    """In the order of the report. Most results have none, and then nothing is loaded for them."""
    kinds = {note.kind for note in source.deployed}
    every = []
    if kinds.difference(OTHER_DAYS):
        from loopcal.companions.robot.report_section import deployed

        every.append(deployed(source))
    if kinds.intersection(OTHER_DAYS) or source.document.updated:
        from loopcal.companions.life.pages import other_days

        every.append(other_days(source))
    yield from (section for section in every if section is not None)

"""What a user reads is plain English: standard words, and sentences that need no second reading."""

from __future__ import annotations

import re

import pytest

from tests.prose import Sentence, sentences

LONGEST = 40
"""Words of a sentence, up to a colon or semicolon."""
INSTEAD = {
    r"tells?|told(?!:)": "determine, distinguish, show, state, report",
    r"nobody": "no sensor, unknown",
    r"broken off": "interrupted",
    r"put right": "correct",
    r"speaks? against": "contradict, object to",
    r"worth a look": "inspect",
    r"all but nothing": "nearly all",
    r"foretold": "predict",
    r"of one's own": "your own",
    r"which of it": "name it",
    r"who only": "if you only",
    r"whoever": "name the reader or the program",
    r"does not suffice|do not suffice": "too few, too small, out of memory",
    r"-0\.0+": "0",
    r"\d+k um": "mm",
}
"""Pattern -> what to write instead."""


@pytest.fixture(scope="module")
def read() -> list[Sentence]:
    """Every sentence that a user may read; not at import, which every process of the suite does."""
    return list(sentences())


def long_ones(read: list[Sentence]) -> list[str]:
    return [f"{sentence.words} words, {sentence}" for sentence in read if sentence.words > LONGEST]


def riddles(read: list[Sentence], pattern: str) -> list[str]:
    found = re.compile(rf"(?<![\w-])(?:{pattern})(?!\w)", re.IGNORECASE)
    return [str(sentence) for sentence in read if found.search(sentence.text)]


def test_no_sentence_is_too_long(read: list[Sentence]) -> None:
    assert long_ones(read) == []


@pytest.mark.parametrize("pattern", INSTEAD)
def test_the_standard_word_is_used(pattern: str, read: list[Sentence]) -> None:
    assert riddles(read, pattern) == [], f"write instead: {INSTEAD[pattern]}"


def test_pages_sources_and_the_report_are_read(read: list[Sentence]) -> None:
    files = {sentence.file for sentence in read}
    assert {"README.md", "docs/how-to/first-robot.md", "src/loopcal/cli/commands.py"} <= files
    assert "src/loopcal/report/template/report.html" in files
    assert len(read) > 3000


def test_a_long_sentence_and_a_riddle_are_found() -> None:
    read = [Sentence(" ".join(["word"] * 41) + ".", "page.md", 1)]
    read.append(Sentence("Nobody told us.", "page.md", 3))
    assert len(long_ones(read)) == 1
    assert riddles(read, "nobody") == ["page.md:3: Nobody told us."]

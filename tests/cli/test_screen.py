"""What one screen shows of a long result: verdict and accuracy ahead of causes and warnings."""

from __future__ import annotations

import pytest

from loopcal.cli.output import SCREEN, screen

TITLE, ACCURACY = "serial, data", "accuracy   mean\nnominal    1.0\ncalibrated 0.1"


def verdict(lines: int) -> str:
    return "\n".join(["Use it with care.", *(f"  answer {i}" for i in range(lines - 1))])


def rest(lines: int) -> list[str]:
    table = "\n".join(["parameter   value", *("x  1" for _ in range(lines))])
    return ["WARNING  two poses\n         do not fit", "WARNING  another", table]


@pytest.mark.parametrize("length", [5, 20, 28])
@pytest.mark.parametrize("following", [0, 2])
def test_accuracy_stands_below_the_verdict_however_long(length: int, following: int) -> None:
    causes = rest(30)
    text = "\n\n".join([TITLE, verdict(length), *causes[:2], ACCURACY, causes[2]])
    shown = screen(text, following)
    assert shown.split("\n\n")[:3] == [TITLE, verdict(length), ACCURACY]
    assert shown.count("\n") + 1 + following <= SCREEN
    assert shown.endswith("parameter; all: --full)")


def test_a_short_result_is_shown_as_it_is() -> None:
    text = "\n\n".join([TITLE, verdict(5), *rest(3), ACCURACY])
    assert screen(text) == text


def test_a_verdict_is_whole() -> None:
    text = "\n\n".join([TITLE, verdict(60), *rest(30)])
    assert verdict(60) in screen(text)


def test_a_verdict_longer_than_a_screen_hides_no_accuracy() -> None:
    shown = screen("\n\n".join([TITLE, verdict(45), rest(3)[0], ACCURACY]))
    assert shown.split("\n\n")[:3] == [TITLE, verdict(45), ACCURACY]
    assert shown.endswith("(not shown: warnings; all: --full)")


def test_of_many_instruments_the_accuracy_of_all_together_is_kept() -> None:
    table = "accuracy   mean\nnominal    1.0" + "\n  touch    2.0" * 20 + "\ncalibrated 0.1"
    shown = screen("\n\n".join([TITLE, verdict(25), table, *rest(30)]))
    assert ACCURACY in shown.split("\n\n")
    assert "(not shown: accuracy of each instrument, " in shown
    assert shown.count("\n") + 1 <= SCREEN


def test_a_table_below_a_few_lines_fits_with_them() -> None:
    table = "\n".join(["sd after  1", *(f"row_{i}  {i}" for i in range(37))])
    shown = screen(f"{TITLE}\n\n{table}", 2)
    assert len(shown.splitlines()) + 2 <= 40
    assert "more rows of sd after; all: --full)" in shown

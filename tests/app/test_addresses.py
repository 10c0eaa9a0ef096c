"""An address says what a page shows, and nothing else: what is wrong in it counts as unsaid."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from loopcal.companions.app.addresses import LONGEST, Address

STEPS = ("fit", "diagnose", "history")
IDS = st.lists(st.text(min_size=1, max_size=8), min_size=1, max_size=30, unique=True)


@given(IDS, st.data())
def test_a_selection_survives_its_address(poses: list[str], data: st.DataObject) -> None:
    chosen = sorted(data.draw(st.sets(st.integers(0, len(poses) - 1))))
    text = Address.selecting("diagnose", chosen, poses).text
    assert text.isascii()
    path, _, query = text.partition("?")
    address = Address.of(path, query, STEPS)
    assert address.step == "diagnose"
    assert address.selected(poses) == (chosen if len(query) <= LONGEST else [])


@pytest.mark.parametrize(
    ("path", "query"),
    [
        ("/", ""),
        ("/etc/passwd", "poses=1"),
        ("/nowhere", "poses=::,&run=-3&poses"),
        ("//fit/../", "run=²&run=1e3&token=x"),
    ],
)
def test_what_no_page_has_counts_as_unsaid(path: str, query: str) -> None:
    address = Address.of(path, query, STEPS)
    assert (address.step, address.run) == ("", None)
    assert address.selected(["1", "2"]) == []


def test_poses_that_the_result_does_not_have_are_not_selected() -> None:
    address = Address.of("/diagnose", "poses=1:3,7:9&run=12", STEPS)
    assert address.run == 12
    assert address.selected(["1", "2", "3", "9"]) == [0, 1, 2]

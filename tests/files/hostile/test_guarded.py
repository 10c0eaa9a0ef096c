"""Whatever a reader of others' code does to its process, this process goes on."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from loopcal.errors import InputError
from loopcal.files import guarded as module
from loopcal.files.guarded import Stopped, guarded

READING = "tests.files.hostile.reading"


@pytest.fixture(autouse=True)
def from_another_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The child never imports from the working directory, where the readers of these tests lie."""
    module._CHILDREN.end()
    monkeypatch.chdir(tmp_path)
    yield
    module._CHILDREN.end()


def test_arguments_go_in_and_bytes_come_back() -> None:
    given = {"a": "µ", "b": [1, None]}
    assert guarded(f"{READING}:echoed", given, 0) == repr(sorted(given.items())).encode()


def test_the_child_stays_warm_and_is_another_process() -> None:
    first = guarded(f"{READING}:process", {}, 0)
    assert first == guarded(f"{READING}:process", {}, 0)
    assert int(first) != os.getpid()


def test_an_error_with_place_remedy_and_command_comes_back_as_it_was() -> None:
    with pytest.raises(InputError) as caught:
        guarded(f"{READING}:refused", {}, 0)
    assert str(caught.value) == "a.xlsx: no sheet\n  What to do: name one"
    assert caught.value.follows == "pip install it"


@pytest.mark.parametrize("name", ["failed", "panicked", "aborted", "touched_nothing"])
def test_a_reader_that_crashes_stops_alone(name: str) -> None:
    with pytest.raises(Stopped) as caught:
        guarded(f"{READING}:{name}", {}, 0)
    assert 0 < len(str(caught.value)) < 400
    assert guarded(f"{READING}:echoed", {}, 0) == b"[]"


def test_a_reader_without_end_is_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "SECONDS", 0.2)
    with pytest.raises(Stopped, match="longer than"):
        guarded(f"{READING}:endless", {}, 0)


@pytest.mark.skipif(sys.platform != "linux", reason="memory is limited on Linux")
def test_a_reader_without_measure_is_stopped_at_its_share(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MEMORY", 50_000_000)
    with pytest.raises(Stopped, match=r"more than 0\.1 GB"):
        guarded(f"{READING}:insatiable", {}, 0)
    monkeypatch.undo()
    assert guarded(f"{READING}:echoed", {}, 0) == b"[]", "the next call has its own share"

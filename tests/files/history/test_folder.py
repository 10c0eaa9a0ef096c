"""A history loses no entry, whatever interrupts it; `analyses/history_kills.py` at full size."""

from __future__ import annotations

import hashlib
import json
import os
from datetime import UTC, datetime
from pathlib import Path

import pytest

from analyses.history_kills import killed
from loopcal.companions.life.history_folder import append_entries, read_entries
from loopcal.files.tables import raw
from tests.refusals import refused

NOON = datetime(2026, 5, 4, 12, 0, tzinfo=UTC)


def test_entries_are_read_in_their_order_and_without_loopcal(tmp_path: Path) -> None:
    for words in ("belt changed", "collision"):
        append_entries(tmp_path / "m.history", [("event", {"words": words})], time=NOON)
    found = read_entries(tmp_path / "m.history")
    assert [entry.content["words"] for entry in found.whole] == ["belt changed", "collision"]
    assert [entry.file for entry in found.whole] == [
        "20260504T120000Z-0001.json",
        "20260504T120000Z-0002.json",
    ]
    plain = json.loads((tmp_path / "m.history" / found.whole[0].file).read_text())
    stated = plain.pop("sha256")
    text = json.dumps(plain, sort_keys=True, separators=(",", ":"))
    assert stated == hashlib.sha256(text.encode()).hexdigest()


@pytest.mark.parametrize("damage", ["", "{", "[]", "5", "[" * 100_000, '{"schema": 1}'])
def test_damaged_entries_are_named_and_skipped(tmp_path: Path, damage: str) -> None:
    entries = [
        append_entries(tmp_path, [("event", {"words": str(i)})], time=NOON).whole[-1]
        for i in range(3)
    ]
    (tmp_path / entries[1].file).write_text(damage)
    found = read_entries(tmp_path)
    assert [entry.sequence for entry in found.whole] == [1, 3]
    assert [one.file for one in found.skipped] == [entries[1].file]
    assert (
        append_entries(tmp_path, [("event", {"words": "next"})], time=NOON).whole[-1].sequence == 4
    )
    assert (tmp_path / entries[1].file).read_text() == damage


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes here")
def test_a_device_and_a_silent_pipe_among_the_entries_are_skipped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(raw, "PATIENCE", 0.1)
    (tmp_path / "a.json").symlink_to("/dev/zero")
    os.mkfifo(tmp_path / "b.json")
    assert [one.file for one in read_entries(tmp_path).skipped] == ["a.json", "b.json"]


def test_a_changed_number_is_noticed(tmp_path: Path) -> None:
    entry = append_entries(tmp_path, [("event", {"words": "5"})], time=NOON).whole[-1]
    path = tmp_path / entry.file
    path.write_text(path.read_text().replace('"5"', '"6"'))
    assert "SHA-256" in read_entries(tmp_path).skipped[0].reason


def test_there_must_be_a_folder(tmp_path: Path) -> None:
    with refused("missing-file"):
        read_entries(tmp_path / "nowhere")


def test_a_kill_at_any_moment_loses_no_entry_and_leaves_none_half(tmp_path: Path) -> None:
    assert killed(tmp_path, kills=6, seed=1) == 0

"""A part of the gauntlet, and how it counts: the whole of it is `python -m analyses.gauntlet`."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from analyses.gauntlet import STAMP, run
from analyses.gauntlet_kinds import KINDS
from analyses.kept import kept
from analyses.rates import interval, table, wrong

CLEAN, FAULT = "planar arm, 40 poses", "points in mm"


def test_a_clean_arm_is_sound_and_right() -> None:
    found = run(CLEAN, 0)
    assert found["sound"]
    assert not wrong(found)
    assert "named" not in found
    assert not [k.name for k in KINDS.values() if k.cause and re.search(k.cause, found["told"])]


@pytest.mark.parametrize("name", ["points in mm", "a joint reversed", "left-handed frame"])
def test_a_fault_of_the_file_is_named_and_not_sound(name: str) -> None:
    found = run(name, 0)
    assert found["named"]
    assert not found.get("sound")


def test_sag_in_a_corner_is_right_inside_and_refused_outside() -> None:
    found = run("small region, sag, no sd stated", 0)
    assert found["sound"]
    assert found["valid"] is False
    assert not wrong(found)
    assert found["inside"]["held"] > 0.85
    assert found["outside"]["sd"] > 2.0 * found["inside"]["sd"]


def draw(kind: str, number: int, **rest: Any) -> dict[str, Any]:
    return {"kind": kind, "draw": number, "stamp": STAMP, "sound": True, **rest}


FAR, NEAR = {"ratio": 3.0}, {"ratio": 0.9}


def test_a_region_that_is_not_called_valid_cannot_be_wrong() -> None:
    assert wrong(draw(CLEAN, 0, inside=NEAR, outside=FAR, valid=True))
    assert not wrong(draw(CLEAN, 0, inside=NEAR, outside=FAR, valid=False))
    assert wrong(draw(CLEAN, 0, inside=FAR, outside=None, valid=False))


def test_draws_of_other_code_and_broken_lines_do_not_count(tmp_path: Path) -> None:
    path = tmp_path / "kept.jsonl"
    draws = [draw(CLEAN, 0), draw(CLEAN, 0, sound=False), draw(CLEAN, 1) | {"stamp": "older"}]
    path.write_text("".join(json.dumps(d) + "\n" for d in draws) + '{"kind": "pla', "utf-8")
    assert kept(path, STAMP) == [draws[1]]
    assert kept(tmp_path / "absent.jsonl", STAMP) == []


def test_the_table_counts_alarms_misses_and_names() -> None:
    assert KINDS[CLEAN].clean
    draws = [
        draw(CLEAN, 0, inside=NEAR),
        draw(CLEAN, 1, inside=NEAR, sound=None),
        draw(FAULT, 0, inside=FAR, named=False),
        draw(FAULT, 1, refused="unit", sound=None, named=True),
    ]
    text = table(draws)
    assert "false alarms on clean sets      50.0 %  of    2" in text
    assert "called sound, yet wrong         25.0 %  of    4" in text
    assert "cause named                     50.0 %  of    2" in text
    assert "(95 % interval 1.3 to 98.7 %)" in text


def test_an_error_of_its_own_counts_and_does_not_end_the_run(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def broken(*_: Any, **__: Any) -> None:
        raise ZeroDivisionError("of its own")

    monkeypatch.setattr("loopcal.calibrate", broken)
    found = run(FAULT, 0)
    assert (found["failed"], found["named"]) == ("ZeroDivisionError('of its own')", False)
    assert f"ended by an error of loopcal's own: {FAULT}" in table([found])


def test_a_rate_has_the_interval_of_its_number_of_draws() -> None:
    assert interval(0, 60) == pytest.approx((0.0, 1.0 - 0.025 ** (1 / 60)))
    assert interval(10, 10) == pytest.approx((0.025**0.1, 1.0))

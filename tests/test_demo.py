"""The demo prints true errors that it computes, finds its fault, and goes the whole loop."""

from __future__ import annotations

import os
import re
import runpy
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]
TABLE = re.compile(r"(?<=<!-- true errors -->\n).*?(?=<!-- end -->)", re.S)
NUMBER = re.compile(r"\d+(?:\.\d+)?")


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory: pytest.TempPathFactory) -> list[Any]:
    """What the demo finds, written elsewhere."""
    demo = runpy.run_path(os.fspath(ROOT / "examples" / "demo.py"))
    out = tmp_path_factory.mktemp("demo")
    return [demo["calibrated"](arm, out) for arm in demo["arms"]()]


def test_loopcal_comes_several_times_nearer_to_the_truth_than_least_squares(outcomes) -> None:
    planar, six_axis, slipped = (done.basic / done.ours for done in outcomes)
    assert planar > 6.0
    assert six_axis > 3.0
    assert slipped > 10.0
    assert outcomes[2].ours < 0.06


def test_the_slipped_reflector_is_found_at_its_pose_and_nothing_else_anywhere(outcomes) -> None:
    planar, six_axis, slipped = (done.faults for done in outcomes)
    assert planar == six_axis == ()
    assert len(slipped) == 1
    assert "from pose 51 on the target" in slipped[0]
    assert "tool_y by 1.4" in slipped[0] or "tool_y by 1.5" in slipped[0]


def test_there_is_a_report_of_every_arm_to_open(outcomes) -> None:
    for done in outcomes:
        assert done.arm.title in done.report.read_text("utf-8")


def test_a_line_states_both_errors_and_their_ratio(outcomes) -> None:
    for done in outcomes:
        basic, ours, times = map(float, NUMBER.findall(done.line))
        assert basic == pytest.approx(done.basic, rel=0.05)
        assert ours == pytest.approx(done.ours, rel=0.05)
        assert times == pytest.approx(basic / ours, rel=0.15)


def test_the_readme_states_the_errors_that_the_demo_finds(outcomes) -> None:
    readme = ROOT / "README.md"
    rows = ["| simulated arm | least squares | loopcal |", "| --- | --- | --- |"]
    for done in outcomes:
        basic, ours = done.shown
        rows.append(f"| {done.arm.title} | {basic} mm | {ours} mm |")
    told = "\n".join(rows) + "\n"
    text = readme.read_text("utf-8")
    if os.environ.get("LOOPCAL_REMAKE_GOLDEN"):
        text = TABLE.sub(told.replace("\\", r"\\"), text)
        readme.write_text(text, "utf-8")
    found = TABLE.search(text)
    assert found is not None
    assert NUMBER.sub("N", found[0]) == NUMBER.sub("N", told)
    # another processor, or a change within the noise, rounds another way
    numbers = [[float(n) for n in NUMBER.findall(part)] for part in (found[0], told)]
    assert numbers[0] == pytest.approx(numbers[1], rel=0.15)


def test_the_whole_loop_brings_a_sagging_arm_to_its_targets(tmp_path: Path) -> None:
    """Plan, measure, calibrate, verify, export, correct, measure again; the README states both."""
    loop = runpy.run_path(os.fspath(ROOT / "examples" / "whole_loop.py"))
    done = loop["whole_loop"](tmp_path)
    assert done.before > 1.0
    assert done.after < 0.1 * done.before
    assert [step.split(":")[0].split(",")[0] for step in done.steps] == [
        *("plan", "calibrate", "verify", "export", "correct")
    ]
    assert "The machine is as calibrated" in done.steps[2]
    assert "50 of 50 targets" in done.steps[4]
    assert loop["TITLE"] in done.report.read_text("utf-8")
    told = re.search(
        r"by (\S+) mm before\b.*?by (\S+) mm after", (ROOT / "README.md").read_text("utf-8"), re.S
    )
    assert told is not None
    assert [float(n) for n in told.groups()] == pytest.approx([done.before, done.after], rel=0.15)

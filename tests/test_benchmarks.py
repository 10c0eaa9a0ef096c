"""The benchmark compares what agrees, or nothing: no time is checked here."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from html import escape
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]
BENCHMARKS = ROOT / "benchmarks"
DOCUMENT = "Before.\n\n<!-- measured: begin -->\nold\n<!-- measured: end -->\n\nAfter.\n"


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """benchmarks/run.py as a module; it and its neighbours are forgotten afterwards."""
    if not BENCHMARKS.is_dir():
        pytest.skip("the benchmarks are not here")
    monkeypatch.syspath_prepend(BENCHMARKS)
    before = set(sys.modules)
    yield import_module("run")
    for name in set(sys.modules) - before:
        if (getattr(sys.modules[name], "__file__", None) or "").startswith(str(BENCHMARKS)):
            del sys.modules[name]


def shifted(program: Any) -> Any:
    """The same program, its first parameter wrong by a micrometre."""

    def prepare(problem: Any) -> Any:
        fit = program.prepare(problem)()
        fit.parameters[0] += 1e-6
        return lambda: fit

    return replace(program, name="shifted", prepare=prepare)


def unknown(program: Any) -> Any:
    return replace(program, name="unknown", needs="no_such_package")


def use(run: Any, programs: list[Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run, "PROGRAMS", programs)
    monkeypatch.setattr(run.report, "PROGRAMS", programs)


def test_all_programs_agree_and_are_told_side_by_side(
    run: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    programs = [*run.PROGRAMS, unknown(run.PROGRAMS[0])]
    use(run, programs, monkeypatch)
    monkeypatch.setattr(run.flatness, "FROM", 30)
    document = tmp_path / "speed.md"
    document.write_text(DOCUMENT, "utf-8")
    asked = ["--only", "programs", "--poses", "30", "60", "--rounds", "1"]

    assert run.main([*asked, "--document", str(document)]) == 0

    printed, ran = capsys.readouterr().out, [p.name for p in programs if p.installed]
    assert "unknown (no_such_package)" in printed
    assert "at 30, " in printed
    assert " at 60; flat within " in printed
    for name in ran:  # times, ratios and evaluations of two problems
        assert printed.count(f"\n| {name} ") == 6
    assert document.read_text("utf-8") == DOCUMENT.replace("old", printed.strip())
    for problem in run.PROBLEMS:
        svg = (tmp_path / "speed" / f"{problem}.svg").read_text("utf-8")
        assert svg.count("<polyline ") == len(ran)
        assert svg.count("<circle ") == 2 * len(ran)
        assert all(f">{escape(name)}</text>" in svg for name in ran)
        assert f"](speed/{problem}.svg)" in printed


def test_nothing_is_told_of_programs_that_disagree(
    run: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    use(run, [run.PROGRAMS[0], shifted(run.PROGRAMS[0])], monkeypatch)
    document = tmp_path / "speed.md"
    document.write_text(DOCUMENT, "utf-8")
    asked = ["--only", "programs", "--problems", "planar", "--poses", "30"]

    assert run.main([*asked, "--document", str(document)]) == 1

    told = capsys.readouterr()
    assert "planar, 30 poses: shifted differs from" in told.err
    assert told.out == ""
    assert document.read_text("utf-8") == DOCUMENT
    assert [path.name for path in tmp_path.iterdir()] == ["speed.md"]


def test_a_program_that_finds_nothing_ends_the_run(
    run: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails() -> None:
        raise RuntimeError("no convergence")

    lost = replace(run.PROGRAMS[0], name="lost", prepare=lambda problem: fails)
    use(run, [run.PROGRAMS[0], lost], monkeypatch)

    assert run.main(["--only", "programs", "--problems", "planar", "--poses", "30"]) == 1
    assert "lost finds nothing: no convergence" in capsys.readouterr().err


@pytest.mark.parametrize("part", ["--only memory", "--problems planar", "--rounds 1"])
def test_a_part_never_replaces_what_a_whole_run_wrote(
    run: Any, capsys: pytest.CaptureFixture[str], part: str
) -> None:
    before = run.DOCUMENT.read_bytes()
    with pytest.raises(SystemExit) as ended:
        run.main([*part.split(), "--document"])

    assert ended.value.code == 2
    assert "written by whole runs" in capsys.readouterr().err
    assert run.DOCUMENT.read_bytes() == before


def test_short_runs_fill_their_turn(run: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    measuring = import_module("measuring")
    now = iter(range(1_000))
    monkeypatch.setattr(measuring.time, "perf_counter", lambda: 0.01 * next(now))
    done: list[str] = []

    times = measuring.in_turns({name: partial(done.append, name) for name in "ab"}, 2)

    assert done == [*"aaaa", *"bbbb"] * 2
    assert {len(t.seconds) for t in times.values()} == {8}


def test_long_runs_are_measured_once(run: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    measuring = import_module("measuring")
    monkeypatch.setattr(measuring, "TURN", 0.0)
    done: list[str] = []
    programs = {name: partial(done.append, name) for name in "abc"}

    times = measuring.in_turns(programs, {"a": 2, "b": 1, "c": measuring.rounds_for(6.0)})

    assert done == ["a", "b", "a"]
    assert {name: len(t.seconds) for name, t in times.items()} == {"a": 2, "b": 1, "c": 0}


def test_flatness_is_the_longest_time_per_pose_beside_the_shortest(run: Any) -> None:
    times = import_module("measuring").Times
    found = run.flatness.Flatness({10: times((20.0, 30.0, 90.0)), 100: times((200.0,))})
    assert found.ratio == 1.5


def test_the_default_call_is_told_beside_plain_least_squares(run: Any) -> None:
    default = import_module("default_call")
    cases = [default.Default("a call", 12.34, 1234.5), default.Default("a stream", 9.0, 3.5, 4.0)]
    told = run.report.defaults(cases)
    assert "| a call | 12.3 | 1,234 |" in " ".join(told.split())
    assert "| a stream | 9.0 | 3.5 | 4: met |" in " ".join(told.split())
    stream = default.InMemory(
        default._readings(import_module("loopcal").motoman_ma1400(), 30), None
    )
    assert (stream.poses, stream.count, len(stream.chunk(0).data)) == (30, 1, 30)


@pytest.mark.usefixtures("run")
def test_small_fits_are_compared_only_where_odrpack_finds_the_same() -> None:
    pytest.importorskip("odrpack")
    small, problems = import_module("small_fits"), import_module("problems")
    ours, programs = import_module("ours"), import_module("programs")
    drawn = [problems.planar(small.POSES, seed) for seed in (1, 2)]
    mine = [ours.solver(problem) for problem in drawn]
    theirs = [programs.odrpack_on_tape(problem) for problem in drawn]
    assert small.compared("two fits", mine, theirs, rounds=0).ours.seconds == ()
    with pytest.raises(import_module("measuring").DisagreementError, match="two fits"):
        small.compared("two fits", mine, theirs[::-1], rounds=0)


def test_a_tree_is_measured_beside_the_same_arm_as_a_chain(run: Any, tmp_path: Path) -> None:
    robots = import_module("whole_robots")
    chain, tree = (robots.arm(tmp_path, kind) for kind in ("chain", "tree"))
    assert len(chain.parameters.free) == len(tree.parameters.free)
    one, other = (robots.readings(machine, 30, 1e-3)[0] for machine in (chain, tree))
    for q in chain.joints:
        assert (one[q] == other[q]).all()
    robot = robots.humanoid(tmp_path)
    assert len(robot.parameters.free) >= 200
    told = run.report.trees(robots.Trees({200: 1.01}, len(robot.parameters.free), 6.0))
    assert "1.010 of a chain" in told
    assert "6.0 s" in told


def test_images_are_told_beside_ceres(run: Any) -> None:
    images = import_module("images")
    told = run.report.images(images.Images(1_000, 100, 0.7, 30.0, 9.0, 6.0))
    assert "1,000 images of 100 corners" in told
    assert "without its callbacks in Python" in told
    measured = images.measure(12)
    assert measured.stated > 0.0
    assert measured.learnt > 0.0


def test_pixels_change_as_their_derivatives_say(run: Any) -> None:
    assert run
    images = import_module("images")
    P, step = np.array([[0.05, -0.03, 0.4], [-0.1, 0.08, 0.35]]), 1e-6
    _, by_point, by_lens = images.projected(P, images.LENS)
    for axis in range(3):
        ahead, behind = (
            images.projected(P + s * np.eye(3)[axis], images.LENS)[0] for s in (step, -step)
        )
        assert np.allclose((ahead - behind) / (2 * step), by_point[..., axis], rtol=1e-6, atol=1e-4)
    for i in range(9):
        ahead, behind = (
            images.projected(P, images.LENS + s * np.eye(9)[i])[0] for s in (step, -step)
        )
        assert np.allclose((ahead - behind) / (2 * step), by_lens[..., i], rtol=1e-6, atol=1e-4)

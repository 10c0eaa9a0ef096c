"""A study gives the same numbers however it is run, and these are the right ones."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import loopcal as lc
from loopcal.companions.studies import run as study_run
from loopcal.companions.studies.draws import run_draws, seed_of
from loopcal.companions.studies.run import run_study
from loopcal.companions.studies.study_file import read_study
from loopcal.execution.executor import InProcess
from loopcal.execution.local import Processes
from loopcal.simulation.simulate import simulate
from tests.command_line import environment, run_here
from tests.refusals import refused

STUDY = """schema = 1
title = "Poor second joint"
draws = 60
seed = 5
[mechanism]
type = "planar-two-link"
[noise]
xPyP = 1e-4
"phi*" = 1e-3
[simulation.ranges]
phi2 = { from = 0, to = 90, step = 30, unit = "deg" }
phi3 = { from = 0, to = 90, step = 30, unit = "deg" }
[[scenarios]]
name = "base"
[[scenarios]]
name = "random"
[scenarios.simulation]
poses = 12
perturb = { "*" = 1e-3 }
[scenarios.simulation.ranges]
phi2 = { from = 0, to = 90, unit = "deg" }
phi3 = { from = 0, to = 90, unit = "deg" }
[scenarios.noise]
phi3 = 1e-2
[[methods]]
method = "implicit-loop"
[[methods]]
method = "least-squares"
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "s.toml"
    path.write_text(STUDY, "utf-8")
    return path


def test_workers_and_interruptions_change_no_value(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(study_run, "CHUNK", 10)
    path.write_text(STUDY.replace("draws = 60", "draws = 20"), "utf-8")
    one = run_study(path, executor=InProcess(), out=tmp_path / "one")
    two = run_study(path, executor=Processes(2), out=tmp_path / "two")
    assert two.text == one.text
    assert two.document == one.document

    fewer = run_study(path, draws=10, executor=InProcess(), out=tmp_path / "three")
    assert fewer.document != one.document
    left = sorted((tmp_path / "one" / "parts").iterdir())
    (tmp_path / "one" / "draws.parquet").unlink()
    left[1].unlink()  # as if it had been stopped before this part
    again = run_study(path, executor=InProcess(), out=tmp_path / "one")
    more = run_study(path, executor=InProcess(), out=tmp_path / "three")
    assert again.document == more.document == one.document
    rows = [pl.read_parquet(tmp_path / d / "draws.parquet") for d in ("one", "two", "three")]
    assert rows[0].equals(rows[1])
    assert rows[0].equals(rows[2])
    assert rows[0].height == 2 * 2 * 20
    assert rows[0].select("scenario", "method", "draw").is_unique().all()


def test_a_killed_study_goes_on(path: Path, tmp_path: Path) -> None:
    path.write_text(STUDY.replace("draws = 60", "draws = 110"), "utf-8")
    out = tmp_path / "out"
    command = [sys.executable, "-m", "loopcal", "study", str(path), "--out", str(out)]
    with subprocess.Popen(
        [*command, "--workers", "2"],
        env=environment(),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    ) as killed:
        while killed.poll() is None and len(list(out.glob("parts/*.parquet"))) < 2:
            time.sleep(0.01)
        killed.send_signal(signal.SIGKILL)
    assert killed.returncode == -signal.SIGKILL
    done = {part: part.stat().st_mtime_ns for part in out.glob("parts/*.parquet")}
    resumed = run_here("study", path, "--out", out, "--workers", "1", "--json")
    whole = run_study(path, executor=InProcess(), out=tmp_path / "whole")
    assert json.loads(resumed.stdout) == json.loads(json.dumps(whole.document))
    assert {part: part.stat().st_mtime_ns for part in done} == done  # nothing was done twice
    assert len(list(out.glob("parts/*.parquet"))) == 2 * 3


def test_a_changed_study_is_refused(path: Path, tmp_path: Path) -> None:
    run_study(path, draws=2, executor=InProcess(), out=tmp_path / "out")
    path.write_text(STUDY.replace("phi3 = 1e-2", "phi3 = 2e-2"), "utf-8")
    with refused("unreadable-file"):
        run_study(path, draws=2, executor=InProcess(), out=tmp_path / "out")
    path.write_text(STUDY.replace("Poor", "Bad"), "utf-8")  # a title changes no number
    assert "Bad" in run_study(path, draws=2, executor=InProcess(), out=tmp_path / "out").text


def test_a_part_that_cannot_be_read_is_named(path: Path, tmp_path: Path) -> None:
    run_study(path, draws=2, executor=InProcess(), out=tmp_path)
    part = next((tmp_path / "parts").iterdir())
    part.write_bytes(b"PAR1")
    with refused("unreadable-file"):
        run_study(path, draws=2, executor=InProcess(), out=tmp_path)


MORE_METHODS = """[[methods]]
method = "reweighted"
[[methods]]
name = "robust"
method = "reweighted"
loss = "huber"
[[methods]]
name = "learnt"
method = "implicit-loop"
noise = { "phi*" = { sd = 1e-3, estimate = "group" } }
[[methods]]
name = "model"
method = "implicit-loop"
noise = { model = { sd = 1e-4, unit = "m", estimate = "group" } }
[[methods]]
name = "aligned"
method = "implicit-loop"
start = "align"
tolerance = 1e-6
"""


def test_a_draw_is_what_calibrate_makes_of_it(path: Path) -> None:
    path.write_text(STUDY + MORE_METHODS, "utf-8")
    scenario = read_study(path).scenarios[1]
    told = [(m.fit.loss, m.fit.start, m.noise.estimate) for m in scenario.methods[3:]]
    assert told == [
        ("huber", "nominal", {}),
        ("gaussian", "nominal", {"phi*": "group"}),
        ("gaussian", "nominal", {"model": "group"}),
        ("gaussian", "align", {}),
    ]
    columns = run_draws(scenario, 5, [6])
    own = seed_of(5, "random", 6)
    truth = scenario.simulation.machine(scenario.mechanism.parameters, own)
    poses = scenario.simulation.driven(seed_of(5, "random", "poses"))
    made = simulate(scenario.mechanism, poses, noise=scenario.noise, seed=own, truth=truth)
    assert len(columns["reason"]) == len(scenario.methods) == 7
    for i, method in enumerate(scenario.methods):
        found = lc.calibrate(method.mechanism, made.dataset, noise=method.noise, fit=method.fit)
        assert columns["reason"][i] == found.status.reason
        assert found.status.converged
        assert columns["chi_squared"][i] == found.solution.chi_squared
        for name in found.estimated:
            assert columns[f"error.{name}"][i] == truth[name] - found.value[name]
            assert columns[f"sd.{name}"][i] == found.sd[name]


def test_a_method_may_hold_a_parameter_fixed(path: Path, tmp_path: Path) -> None:
    fixing = '[[methods]]\nname = "fixing"\nmethod = "implicit-loop"\nprior = { l2 = 0 }\n'
    path.write_text(STUDY + fixing, "utf-8")
    scenario = run_study(
        path, draws=3, executor=InProcess(), out=tmp_path / "out"
    ).tables.scenarios[0]
    by_name = {spread.name: spread for spread in scenario.methods[2].spreads}
    assert (by_name["l2"].rms, by_name["l2"].held) == (0.0, 1.0)  # the nominal value is true
    assert by_name["l3"].rms > 0.0
    assert [a.name for a in scenario.paired[1].advantages] == list(by_name)


def test_streams_belong_to_draws(path: Path) -> None:
    whole = read_study(path).scenarios[0]
    scenario = replace(whole, methods=whole.methods[:1])
    several, alone = (run_draws(scenario, 5, draws) for draws in (range(4), [3]))
    assert several["error.l2"][3] == alone["error.l2"][0]
    assert len(np.unique(several["error.l2"])) == 4
    assert run_draws(scenario, 6, [3])["error.l2"][0] != alone["error.l2"][0]


def test_the_implicit_loop_holds_its_intervals_and_least_squares_is_further_off(
    path: Path, tmp_path: Path
) -> None:
    before, _, rest = STUDY.partition('[[scenarios]]\nname = "base"\n')
    path.write_text(before + rest, "utf-8")
    done = run_study(path, draws=400, executor=InProcess(), out=tmp_path / "out")
    (scenario,) = done.tables.scenarios
    held = [spread.held for spread in scenario.methods[0].spreads]
    # 400 draws: the share of a 95 % interval has the sd 0.011
    np.testing.assert_allclose(held, 0.95, atol=0.045)
    ratios = {a.name: a.ratio for a in scenario.paired[0].advantages}
    assert all(ratio is not None and ratio < 1.0 for ratio in ratios.values())
    assert "implicit-loop against least-squares, 400 draws" in done.text


LEVER = """
import multiprocessing

assert multiprocessing.parent_process() is None  # the tape travels, the file need not


def loops(x, p):
    return (p.a * x.u - x.v,)
"""


def test_workers_need_neither_the_study_nor_the_loops(tmp_path: Path) -> None:
    (tmp_path / "lever.py").write_text(LEVER, "utf-8")
    study = tmp_path / "study.toml"
    study.write_text(
        "schema = 1\ndraws = 60\n[mechanism]\ntype = 'function'\noutputs = ['v']\n"
        "[mechanism.quantities]\nu = 'm'\nv = 'm'\n"
        "[parameters]\na = { value = 2, unit = '1' }\n[noise]\n'*' = 1e-3\n"
        "[simulation.ranges]\nu = { from = 1, to = 5, step = 1 }\n"
        "[[scenarios]]\nname = 's'\n[[methods]]\nmethod = 'implicit-loop'\n",
        "utf-8",
    )
    named = f"{tmp_path / 'lever.py'}:loops"
    done = run_study(study, executor=Processes(2), out=tmp_path / "out", function=named)
    assert [spread.name for spread in done.tables.scenarios[0].methods[0].spreads] == [
        "a",
        "end point",
    ]

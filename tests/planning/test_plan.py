"""Plans on machines: better than random, and as sure as they say; the full size is in analyses."""

from __future__ import annotations

import csv
import json
import math
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import loopcal as lc
from analyses.planning import beside_random, cases, kept
from loopcal.companions.robot.programs.coordinates import JointAxes
from loopcal.companions.robot.programs.registry import read_program
from loopcal.files.project.project_data import load_dataset
from loopcal.files.project.project_file import read_project
from loopcal.mechanisms.planar import planar_two_link
from tests.command_line import run_here as run
from tests.refusals import refused

ARM = {"phi2": (-1.0, 1.0), "phi3": (0.3, 2.0)}
SD = {"phi*": 1e-4, "xP": 1e-5, "yP": 1e-5}


@cache
def planned(poses: int = 10, **options: Any) -> lc.Plan:
    settings = lc.PlanSettings(ARM, number=150, model_error="none")
    return lc.plan(planar_two_link(), poses, noise=SD, settings=settings, **options)


@pytest.mark.parametrize("name", ["UR10", "MA1400", "Stewart-Gough"])
def test_thirty_planned_poses_are_worth_forty_eight_random_ones(name: str) -> None:
    found = beside_random(cases()[name], 500, 30, 48, 8)
    assert found.planned <= found.random
    assert 0.8 < found.efficiency <= 1.0


def test_calibrations_scatter_as_the_plan_promises() -> None:
    """Four standard errors of 40 draws."""
    found = kept(cases()["UR10"], 200, 30, 40)
    assert abs(found.ratio - 1.0) < 4.0 * found.error
    assert found.error < 0.05


def test_a_plan_has_as_many_poses_as_asked_a_fifth_to_validate() -> None:
    made = planned()
    assert made.count == 10
    assert len(made.poses) == len(made.use) == 12
    assert made.use.count("validate") == 2
    assert len(set(made.poses.poses)) == 12
    for q, (low, high) in ARM.items():
        assert (made.poses[q] >= low - 1e-4).all()
        assert (made.poses[q] <= high + 1e-4).all()


def test_the_first_pose_is_measured_again_in_the_middle_and_at_the_end() -> None:
    made = planned()
    at = [i for i, use in enumerate(made.use) if use == "repeat"]
    assert at == [5, 11]
    assert [made.poses.poses[i] for i in at] == ["151", "152"]  # after the candidates
    assert all((v[at] == v[0]).all() for v in made.poses.readings.values())
    without = lc.PlanSettings(ARM, number=150, model_error="none", repeats=False)
    assert "repeat" not in lc.plan(planar_two_link(), 10, noise=SD, settings=without).use


def test_more_poses_promise_more() -> None:
    sds = [p.end_point for p in planned().curve if p.end_point is not None]
    assert len(sds) >= 6
    assert all(after <= before for before, after in pairwise(sds))
    fitted, every = planned().fitted.end_point, planned().expected.end_point
    assert fitted is not None
    assert every is not None
    assert fitted >= every


def test_promised_sds_are_those_that_check_expects() -> None:
    """At the very poses of the plan, without placements or model error in between."""
    made, machine = planned(), planar_two_link()
    once = [i for i, use in enumerate(made.use) if use != "repeat"]
    poses = {q: v[once] for q, v in made.poses.readings.items()}
    read = lc.simulate(machine, poses, noise={"*": 0.0}, seed=1)
    expected = lc.check(machine, read.dataset, noise=SD).expected_sd
    for name, sd in made.expected.parameters.items():
        assert sd == pytest.approx(expected[name], rel=1e-4)


def test_poses_already_measured_count() -> None:
    machine = planar_two_link()
    before = lc.simulate(machine, lc.random_poses(ARM, 20, seed=2), noise=SD, seed=2).dataset
    made = planned(5, existing=before)
    assert made.existing == 20
    assert made.curve[0].end_point is not None
    alone = lc.check(machine, before, noise=SD).expected_sd["l2"]
    assert (made.curve[0].parameters["l2"] or math.inf) < (alone or 0.0)
    result = lc.calibrate(machine, before, noise=SD, method="implicit-loop")
    again = lc.plan(
        machine, 5, existing=result, settings=lc.PlanSettings(ARM, number=150, model_error="none")
    )
    assert again.expected.end_point == pytest.approx(made.expected.end_point, rel=0.02)


def test_the_learnt_error_of_single_poses_is_promised_too() -> None:
    machine, sd = planar_two_link(), 1e-3
    noise = lc.Noise({**SD, "model": sd})
    settings = lc.PlanSettings(ARM, number=60, model_error="none")
    made = lc.plan(machine, 8, noise=noise, settings=settings)
    promised = made.expected.end_point
    assert promised is not None
    assert promised > math.sqrt(2.0) * sd
    before = lc.simulate(machine, lc.random_poses(ARM, 40, seed=2), noise=SD, seed=2).dataset
    rough = before.with_readings(
        {q: before[q] + sd * np.random.default_rng(4).standard_normal(40) for q in ("xP", "yP")}
    )
    result = lc.calibrate(
        machine, rough, noise=SD, method="implicit-loop", model_error="structured"
    )
    learnt = next(entry.sd for entry in result.noise if entry.role == "disturbance")
    assert learnt == pytest.approx(sd, rel=0.3)
    again = lc.plan(machine, 5, existing=result, settings=settings)
    assert again.expected.end_point is not None
    assert math.sqrt(2.0) * learnt < again.expected.end_point < 1.5 * math.sqrt(2.0) * learnt


def test_what_a_machine_without_model_error_would_keep_stands_beside() -> None:
    settings = lc.PlanSettings(ARM, number=30)
    made = lc.plan(planar_two_link(), 8, noise=SD, settings=settings)
    assert made.rigid is not None
    assert made.rigid.end_point is not None
    assert made.expected.end_point is not None
    assert made.rigid.end_point < made.expected.end_point
    assert "of a machine without any model error" in str(made)
    assert planned().rigid is None  # geometry is all that was asked


def test_every_criterion_is_best_at_its_own() -> None:
    found = {how: planned(criterion=how).document()["expected"][-1] for how in "GI"}
    assert found["G"]["largest"] <= found["I"]["largest"] * (1.0 + 1e-9)
    assert found["I"]["end_point"] <= found["G"]["end_point"] * (1.0 + 1e-9)


def test_what_geometry_does_not_explain_is_planned_for() -> None:
    """Such poses hold the end point better if the arm does sag, at the same test poses."""
    case = cases()["UR10"]
    promised = {}
    for model_error in ("none", "structured"):
        settings = lc.PlanSettings(case.ranges, case.ranges, number=80, model_error=model_error)
        made = lc.plan(case.mechanism, 12, noise=case.noise, settings=settings)
        sagging = lc.PlanSettings(region=case.ranges)
        whole = lc.plan(
            case.mechanism, 12, noise=case.noise, candidates=made.poses, settings=sagging
        )
        promised[model_error] = whole.expected.end_point or math.inf
    assert promised["structured"] < promised["none"]


def test_the_mean_over_the_prior_counts_where_equations_depend_on_it() -> None:
    machine = planar_two_link()
    wide = machine.with_parameters(machine.parameters.with_prior({"phi30": 0.5, "l3": 0.2}))
    settings = lc.PlanSettings(ARM, number=60, model_error="none")
    assert lc.plan(wide, 8, noise=SD, settings=settings).draws > 1
    assert planned().draws == 1


def test_own_loops_are_planned_without_an_end_point() -> None:
    machine = lc.Mechanism.from_function(
        lambda x, p: x.a * p.gain + p.zero - x.b,
        {"a": "m", "b": "m"},
        {"gain": (1.0, "1"), "zero": (0.0, "m")},
    )
    settings = lc.PlanSettings({"a": (0.0, 1.0)}, number=50)
    made = lc.plan(machine, 4, noise={"*": 1e-3}, settings=settings)
    assert made.criterion == "D"
    ends = np.sort(made.poses["a"])
    assert ends[1] < 0.1
    assert ends[2] > 0.9
    with refused("no-outputs"):
        lc.plan(machine, 4, noise={"*": 1e-3}, criterion="I", settings=settings)


def test_mistakes_are_refused() -> None:
    with refused("unknown-name", "E"):
        planned(criterion="E")
    with refused("too-few-poses", "150"):
        planned(151)
    with refused("invalid-value"):
        planned(0)
    with refused("missing-sd"):
        lc.plan(planar_two_link(), 5)


def test_the_command_writes_a_plan_that_reads_as_candidates(tmp_path: Path) -> None:
    run("new", "arm", "--mechanism", "planar-two-link", cwd=tmp_path)
    project = tmp_path / "arm" / "project.toml"
    with project.open("a") as file:
        file.write('\n[plan]\ncandidates = 100\nmodel_error = "none"\n')
    done = run("plan", str(project), "--poses", "8", "--json", cwd=tmp_path)
    document = json.loads(done.stdout)
    folder = tmp_path / "arm" / "project-plan"
    written = json.loads((folder / "plan.json").read_text())
    assert written == document
    assert len(document["poses"]) == 8
    with (folder / "plan.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["pose"] for row in rows] == [p["pose"] for p in document["poses"]]
    assert {row["use"] for row in rows} == {"calibrate", "validate"}
    degrees = math.degrees(document["poses"][0]["readings"]["phi2"])
    assert float(rows[0]["phi2"]) == pytest.approx(degrees)
    page = (folder / "plan.html").read_text()
    assert "by_number" in page
    again = run(
        "plan",
        str(project),
        "--poses",
        "8",
        "--candidates",
        str(folder / "plan.csv"),
        "--no-report",
        "--force",
        "--json",
        cwd=tmp_path,
    )
    same = json.loads(again.stdout)
    assert {p["pose"] for p in same["poses"]} == {p["pose"] for p in document["poses"]}
    assert not (folder / "plan.html").exists()
    assert (folder / "plan.csv.bak").exists()  # it was read


def test_the_end_point_of_a_platform_that_nobody_reads_follows_from_its_legs() -> None:
    """Its sd is what `check` expects at the same poses, less what a placement makes up for."""
    case = cases()["Stewart-Gough"]
    made = lc.plan(case.mechanism, 20, noise=case.noise, settings=case.settings(60))
    driven = {q: made.poses[q] for q in case.ranges}
    read = lc.simulate(case.mechanism, driven, noise={"*": 0.0}, seed=1)
    usual = lc.check(case.mechanism, read.dataset, noise=case.noise).expected_at_poses[0].sd
    assert made.expected.end_point is not None
    assert 0.2 * usual < made.expected.end_point < usual


def test_planned_poses_are_written_as_a_program_where_joints_are_driven(tmp_path: Path) -> None:
    arm = lc.serial_arm([lc.Joint("a", "dh"), lc.Joint("b", "dh")], {"a_1": 0.4, "a_2": 0.3})
    settings = lc.PlanSettings(dict.fromkeys("ab", (-1.0, 1.0)), number=60, model_error="none")
    made = lc.plan(
        arm, 6, noise={"a": 1e-4, "b": 1e-4, **dict.fromkeys("xyz", 1e-5)}, settings=settings
    )
    path = lc.plan_program(arm, made, tmp_path / "go.src")
    driven = read_program(path, JointAxes({"a": "rad", "b": "rad"}))
    q = np.array([t.joints for t in driven.targets]).T
    assert q == pytest.approx(np.array([made.poses["a"], made.poses["b"]]), abs=1e-7)
    assert [line.split(", ")[1] for line in path.read_text().splitlines() if "; pose" in line] == [
        *made.use
    ]
    with refused("unwritable-file", "go.src"):
        lc.plan_program(arm, made, path)
    lc.plan_program(arm, made, path, force=True)
    with refused("unsupported", "planar"):
        lc.plan_program(planar_two_link(), planned(), tmp_path / "no.src")
    assert not (tmp_path / "no.src").exists()


def test_missing_ranges_are_asked_for_with_the_lines_to_add() -> None:
    with refused("missing-key", "[plan.ranges]", 'phi2 = { from = -90, to = 90, unit = "deg" }'):
        lc.plan(planar_two_link(), 5, noise=SD)


@pytest.mark.parametrize("kind", ["five-bar", "three-rrr", "four-bar", "stewart-gough"])
def test_closed_loops_are_planned_from_their_measured_poses(kind: str, tmp_path: Path) -> None:
    """Without stated ranges, and with the measured poses as candidates: joints as platform stay
    within what was measured, and what no sensor reads follows."""
    assert run("new", "m", "--mechanism", kind, cwd=tmp_path).returncode == 0
    folder = tmp_path / "m"
    project = folder / "project.toml"
    drawn = ["simulate", str(project), "--out", str(folder / "poses.csv"), "--seed", "1"]
    assert run(*drawn, cwd=tmp_path).returncode == 0
    stated, _, _ = project.read_text("utf-8").partition("\n[simulation]")
    project.write_text(stated, "utf-8")
    request = ["plan", str(project), "--poses", "8", "--json", "--no-report", "--force"]
    done = run(*request, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    measured = load_dataset(read_project(project)).dataset.readings
    planned = [one["readings"] for one in json.loads(done.stdout)["poses"]]
    for q in measured.keys() & planned[0].keys():
        v = [one[q] for one in planned]
        assert np.nanmin(measured[q]) - 1e-3 <= min(v)
        assert max(v) <= np.nanmax(measured[q]) + 1e-3
    again = run(*request, "--candidates", str(folder / "poses.csv"), cwd=tmp_path)
    assert again.returncode == 0, again.stderr

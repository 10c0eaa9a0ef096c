"""`loopcal compare`, and validation and profiles on the command line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.command_line import run_here as run

PROJECT = """
schema = 1
[mechanism]
type = "planar-two-link"
[data]
file = "{data}.csv"
pose = "pose"
[noise]
"?P" = {{ sd = 0.1, unit = "mm" }}
"phi?" = {{ sd = 1, unit = "mrad" }}
[fit]
method = "implicit-loop"
{fit}
[simulation]
poses = 40
[simulation.ranges]
phi2 = {{ from = -90, to = 90, unit = "deg" }}
phi3 = {{ from = -90, to = 90, unit = "deg" }}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two calibrations, the first validated in every way."""
    here = tmp_path_factory.mktemp("compare")
    asked = 'validation = { folds = 4, seed = 1 }\nprofile = ["l*"]'
    for name, fit in (("a", asked), ("b", 'validation = { file = "a.csv" }')):
        project = here / f"{name}.toml"
        project.write_text(PROJECT.format(data=name, fit=fit))
        seed = str(ord(name))
        made = run("simulate", str(project), "--out", str(here / f"{name}.csv"), "--seed", seed)
        assert made.returncode == 0, made.stderr
    for name in "ab":
        done = run("calibrate", str(here / f"{name}.toml"))
        assert done.returncode == 0, done.stderr
        (here / f"{name}.txt").write_text(done.stdout)
    return here


def test_what_the_project_asks_for_is_in_summary_and_result(folder: Path) -> None:
    text = (folder / "a.txt").read_text()
    assert "on poses not used" in text
    assert "4 folds of 40 poses" in text
    assert "95 % interval" in text
    document = json.loads((folder / "a-result" / "result.json").read_text())
    assert document["validation"]["scheme"] == {"folds": 4, "seed": 1}
    assert document["validation"]["accuracy"]["rms"] > document["accuracy"]["after"]["rms"]
    asked = [p["name"] for p in document["parameters"] if p["interval"]]
    assert asked == ["l2", "l3"]
    other = json.loads((folder / "b-result" / "result.json").read_text())["validation"]
    assert other["poses"] == 40
    assert other["log_likelihood"] > 0


def test_two_results_are_compared(folder: Path) -> None:
    a, b = str(folder / "a-result"), str(folder / "b-result" / "result.json")
    done = run("compare", a, b)
    assert done.returncode == 0, done.stderr
    assert "The two machines agree within their stated uncertainty" in done.stdout
    told = json.loads(run("compare", a, b, "--json").stdout)
    assert told["chi_squared"]["degrees_of_freedom"] == 3
    assert told["common_poses"]["poses"] == 80
    still = json.loads(run("compare", a, b, "--json", "--same-frame").stdout)
    assert still["chi_squared"]["degrees_of_freedom"] == 6
    (folder / "at.csv").write_text("pose,phi2,phi3\n1,0.1,0.2\n2,0.3,-0.4\n3,1,1\n")
    at = json.loads(run("compare", a, b, "--json", "--poses", str(folder / "at.csv")).stdout)
    assert at["common_poses"]["poses"] == 3


def test_what_cannot_be_compared_is_bad_input(folder: Path) -> None:
    done = run("compare", str(folder / "a-result"), str(folder / "nowhere"))
    assert done.returncode == 3
    assert "nowhere" in done.stderr


@pytest.mark.parametrize(
    ("fit", "words"),
    [
        ("validation = { seed = 1 }", "no way to leave poses out"),
        ("validation = { folds = 3, hold_out = 0.2 }", "folds and hold_out"),
        ("validation = { folds = 300 }", "folds is 300"),
        ('validation = { file = "c.csv" }', "c.csv"),
        ('profile = ["l9"]', "l9"),
    ],
)
def test_a_validation_that_cannot_be_is_bad_input(folder: Path, fit: str, words: str) -> None:
    (folder / "c.toml").write_text(PROJECT.format(data="a", fit=fit))
    done = run("calibrate", str(folder / "c.toml"))
    assert done.returncode == 3
    assert words in done.stderr


def test_a_column_of_groups_alone_leaves_out_whole_groups(folder: Path) -> None:
    head, *rows = (folder / "a.csv").read_text().splitlines()
    lines = [f"{head},day", *(f"{row},{n // 10}" for n, row in enumerate(rows))]
    (folder / "days.csv").write_text("\n".join(lines))
    fit = 'validation = { group = "day" }'
    (folder / "days.toml").write_text(PROJECT.format(data="days", fit=fit))
    done = run("calibrate", str(folder / "days.toml"))
    assert done.returncode == 0, done.stderr
    document = json.loads((folder / "days-result" / "result.json").read_text("utf-8"))
    assert document["validation"]["scheme"] == {"groups": 4, "place_anew": True}
    assert document["validation"]["parts"] == 4


def test_a_result_beside_another_ones_mechanism_is_refused(folder: Path, tmp_path: Path) -> None:
    document = json.loads((folder / "a-result" / "result.json").read_text("utf-8"))
    document["parameters"][0]["name"] = "else"
    (tmp_path / "result.json").write_text(json.dumps(document), "utf-8")
    (tmp_path / "mechanism.toml").write_bytes((folder / "a-result" / "mechanism.toml").read_bytes())
    done = run("compare", tmp_path, folder / "b-result")
    assert done.returncode == 3
    assert "differ in the parameters 'xA'" in done.stderr


def test_a_result_is_verified_against_a_file_and_against_another_result(folder: Path) -> None:
    a, b = str(folder / "a-result"), str(folder / "b-result")
    day = str(folder / "a.csv")
    done = run("verify", b, day, "--tolerance", "5")
    assert done.returncode == 0, done.stderr
    assert "The machine is as calibrated" in done.stdout
    told = json.loads(run("verify", b, day, "--json").stdout)
    assert told["poses"] == 40
    assert told["accuracy"]["nominal"]["rms"] > 0
    assert {"value", "degrees_of_freedom", "p_value"} <= set(told["chi_squared"])
    assert {q["name"] for q in told["placed"]} >= {"xA", "yA"}
    other = json.loads(run("verify", b, a, "--json").stdout)
    assert other["chi_squared"]["value"] == pytest.approx(told["chi_squared"]["value"], rel=1e-6)


def test_a_tolerance_that_fails_is_no_trustworthy_result(folder: Path) -> None:
    done = run("verify", str(folder / "a-result"), str(folder / "b.csv"), "--tolerance", "0.01")
    assert done.returncode == 4
    assert "tolerance" in done.stderr
    assert run("verify", str(folder / "a-result"), "nowhere.csv").returncode == 3
    wrong = run("verify", str(folder / "a-result"), str(folder / "b.csv"), "--anew", "reflector")
    assert wrong.returncode == 3
    assert "'reflector'" in wrong.stderr
    said, _, after = wrong.stderr.partition("Next command")
    assert "b.csv" not in said
    assert "b.csv" in after
    negative = run("verify", str(folder / "a-result"), str(folder / "b.csv"), "--tolerance", "-1")
    assert negative.returncode == 3
    assert "the tolerance is -0.001" in negative.stderr
    assert "b.csv" not in negative.stderr.partition("Next command")[0].partition("Then run")[0]
    both = run(
        "verify", str(folder / "a-result"), str(folder / "b.csv"), "--remounted", "--anew", "l2"
    )
    assert both.returncode == 3
    assert "nothing says what is mounted" in both.stderr


TURNING = """
schema = 1
[mechanism]
type = "function"
quantities = { motor = "rad", turn = "rad" }
outputs = ["turn"]
[parameters]
gain = { value = 2, unit = "1" }
[data]
file = "a.csv"
[noise]
"*" = { sd = 1, unit = "mrad" }
[fit]
method = "implicit-loop"
"""


def test_a_tolerance_in_millimetres_is_refused_for_a_machine_without_lengths(
    tmp_path: Path,
) -> None:
    (tmp_path / "loops.py").write_text("def loops(x, p):\n    return [x.turn - p.gain * x.motor]\n")
    rows = "\n".join(f"{0.05 * i},{0.1 * i + 1e-3 * (i * i % 7 - 3)}" for i in range(20))
    (tmp_path / "a.csv").write_text("motor,turn\n" + rows)
    (tmp_path / "a.toml").write_text(TURNING)
    function = ("--mechanism", f"{tmp_path / 'loops.py'}:loops")
    made = run("calibrate", str(tmp_path / "a.toml"), *function, "--no-report")
    assert made.returncode == 0, made.stderr
    asked = ("verify", str(tmp_path / "a-result"), str(tmp_path / "a.csv"))
    done = run(*asked, *function, "--tolerance", "0.1")
    assert done.returncode == 3
    assert "has no output that is a length" in done.stderr

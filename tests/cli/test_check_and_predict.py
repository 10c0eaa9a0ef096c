"""`loopcal check` and `loopcal predict` as a user runs them."""

from __future__ import annotations

import csv
import io
import json
import math
from pathlib import Path

import numpy as np
import pytest

import loopcal as lc
from tests.cli.conftest import PROJECT, Run, contents

NEW = "pose,a,b\nnear,10,60\nfar,170,-120\n"


def test_check_fits_nothing_and_writes_nothing(folder: Path, run: Run) -> None:
    before = contents(folder)
    done = run("check", "project.toml")
    assert done.code == 0
    assert done.out.startswith("A planar arm: 42 poses, nothing fitted\n")
    assert done.out.rstrip().endswith("GOOD  These poses determine every parameter.")
    assert contents(folder) == before


def test_check_expects_what_the_fit_then_gives(folder: Path, run: Run) -> None:
    document = json.loads(run("check", "project.toml", "--json").out)
    result = json.loads((folder / "project-result/result.json").read_text())
    for expected, found in zip(document["parameters"], result["parameters"], strict=True):
        assert expected["expected_sd"] == pytest.approx(found["sd"], rel=0.05)
    at_poses = document["prediction"]["sd_at_poses"]["m"]
    assert at_poses == pytest.approx(result["prediction"]["sd_at_poses"]["m"], rel=0.05)
    assert document["observability"]["O2"] == pytest.approx(result["observability"]["O2"], rel=0.05)
    ranges = {q["name"]: (q["smallest"], q["largest"]) for q in document["quantities"]}
    assert ranges["phi2"] == pytest.approx((-math.pi / 2, math.pi / 2), abs=0.01)


def test_check_states_the_role_of_each_parameter(folder: Path, run: Run) -> None:
    document = json.loads(run("check", "project.toml", "--json").out)
    assert {p["name"]: p["role"] for p in document["parameters"]} == {
        "xA": "placement", "yA": "placement", "phi20": "placement",
        "l2": "length", "l3": "length", "phi30": "zero",
    }  # fmt: skip


def test_check_of_poses_that_are_all_alike(folder: Path, run: Run) -> None:
    rows = (folder / "readings.csv").read_text().splitlines()
    (folder / "readings.csv").write_text("\n".join([rows[0], *[rows[5]] * 8]) + "\n")
    done = run("check", "project.toml", "--json")
    document = json.loads(done.out)
    assert done.code == 0
    assert document["verdict"] == "undetermined"
    assert document["observability"]["O3"] == 0.0
    assert any(p["expected_sd"] is None for p in document["parameters"])


def test_check_knows_no_sds_where_the_project_states_none(folder: Path, run: Run) -> None:
    start, rest = PROJECT.split("[noise]")
    text = start + "[prior]" + rest.split("[prior]")[1].replace("implicit-loop", "least-squares")
    (folder / "project.toml").write_text(text)
    done = run("check", "project.toml", "--json")
    document = json.loads(done.out)
    assert done.code == 0
    assert {p["expected_sd"] for p in document["parameters"]} == {None}
    assert document["verdict"] == "good"


def test_check_refuses_bad_input(folder: Path, run: Run) -> None:
    (folder / "project.toml").write_text(PROJECT.replace('"deg"', '"mm"', 1))
    done = run("check", "project.toml")
    assert done.code == 3
    assert "phi2" in done.err


@pytest.mark.parametrize("place", ["project-result", "project-result/result.json"])
def test_predict_from_files_is_predict_in_python(folder: Path, run: Run, place: str) -> None:
    (folder / "new.csv").write_text(NEW)
    done = run("predict", place, "new.csv", "--out", "there.csv")
    assert done.code == 0
    assert done.out.startswith("2 of 2 poses predicted\n")
    rows = list(csv.DictReader(io.StringIO((folder / "there.csv").read_text())))
    assert [row["pose"] for row in rows] == ["near", "far"]
    project = lc.read_project("project.toml")
    loaded = lc.load_dataset(project)
    result = lc.calibrate(
        project.mechanism, loaded.dataset, noise=loaded.noise, method="implicit-loop"
    )
    angles = {"phi2": np.radians([10, 170]), "phi3": np.radians([60, -120])}
    same = lc.predict(result, angles)
    for name in ("xP", "yP"):
        assert [float(row[f"{name} [m]"]) for row in rows] == pytest.approx(
            same.outputs[name].tolist(), rel=1e-9
        )
        sds = same.sd[name].tolist()
        assert [float(r[f"{name} sd [m]"]) for r in rows] == pytest.approx(sds, rel=1e-9)
    entries = [float(row["covariance xP yP [m m]"]) for row in rows]
    assert entries == pytest.approx(same.covariance[:, 0, 1].tolist(), rel=1e-6)


def test_without_out_the_table_is_all_of_stdout(folder: Path, run: Run) -> None:
    (folder / "new.csv").write_text(NEW)
    done = run("predict", "project-result", "new.csv")
    rows = list(csv.DictReader(io.StringIO(done.out)))
    assert len(rows) == 2
    assert {row["extrapolated"] for row in rows} <= {"yes", "no"}
    assert "2 of 2 poses predicted" in done.err


def test_the_alarm_is_in_words_and_in_json(folder: Path, run: Run) -> None:
    text = PROJECT.replace("from = -90, to = 90, step = 30", "from = 0, to = 10, step = 2")
    text = text.replace("from = 10, to = 150, step = 28", "from = 60, to = 70, step = 2")
    (folder / "project.toml").write_text(text)
    assert run("simulate", "project.toml", "--out", "readings.csv", "--seed", "2").code == 0
    assert run("calibrate", "project.toml").code == 0
    (folder / "new.csv").write_text("pose,a,b\nnear,5,65\nfar,170,-120\n")
    document = json.loads(run("predict", "project-result", "new.csv", "--json").out)
    assert [p["extrapolated"] for p in document["poses"]] == [False, True]
    assert "EXTRAPOLATION  in 1 of 2 poses" in document["words"]


def test_a_file_without_a_column_and_a_folder_without_a_result(folder: Path, run: Run) -> None:
    (folder / "new.csv").write_text("pose,a\n1,10\n")
    done = run("predict", "project-result", "new.csv")
    assert done.code == 3
    assert "'b'" in done.err
    (folder / "new.csv").write_text(NEW)
    assert run("predict", "nowhere", "new.csv").code == 3
    (folder / "project-result/mechanism.toml").unlink()
    done = run("predict", "project-result", "new.csv")
    assert done.code == 3
    assert "mechanism.toml" in done.err


def test_a_result_of_no_outputs_predicts_nothing(folder: Path, run: Run) -> None:
    path = folder / "project-result/result.json"
    document = json.loads(path.read_text())
    document["prediction"] = None
    path.write_text(json.dumps(document))
    (folder / "new.csv").write_text(NEW)
    done = run("predict", "project-result", "new.csv")
    assert done.code == 3
    assert "no outputs to predict" in done.err


def test_a_result_written_from_python_is_read_in_si(folder: Path, run: Run) -> None:
    arm, noise = lc.planar_two_link(), lc.Noise({"?P": 1e-4, "phi?": 1e-4})
    poses = lc.random_poses({"phi2": (-1.0, 1.0), "phi3": (0.3, 2.0)}, 30, seed=2)
    data = lc.simulate(arm, poses, noise=noise, seed=2).dataset
    lc.write_result(lc.calibrate(arm, data, noise=noise, method="implicit-loop"), "own")
    (folder / "new.csv").write_text("phi2,phi3\n0.1,0.5\n")
    done = run("predict", "own", "new.csv", "--json")
    assert done.code == 0
    assert json.loads(done.out)["poses"][0]["pose"] == "1"


def test_check_says_why_parameters_of_a_urdf_are_fixed(
    tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for command in (
        ("new", "arm", "--mechanism", "urdf"),
        ("simulate", "arm/project.toml", "--out", "arm/poses.csv", "--seed", "1"),
    ):
        assert run(*command).code == 0
    said = run("check", "arm/project.toml", "--full")
    reason = "'flange_z' is fixed: indistinguishable from 'tool_z'."
    assert reason in said.out
    document = json.loads(run("check", "arm/project.toml", "--json").out)
    assert reason in document["remarks"]
    fixed = [p["name"] for p in document["parameters"] if p["fixed"]]
    assert len(document["remarks"]) == len(fixed) == 24
    told = run("calibrate", "arm/project.toml", "--full").out
    assert "24 remarks on the mechanism, such as why a parameter is fixed" in told
    assert reason in (tmp_path / "arm/project-result/mechanism.toml").read_text()

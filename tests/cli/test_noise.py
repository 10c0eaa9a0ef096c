"""`loopcal noise`, and makers' figures in a project, as a user meets them."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from loopcal.files.project.project_file import read_project
from tests.cli.conftest import PROJECT, Run

SIX_AXIS = Path(__file__).resolve().parents[2] / "examples" / "six_axis" / "mechanism.toml"
SETS = [
    f"motoman_ma1400_leica/right_arm_repeat_{name}.csv" for name in ("table1", "wall1", "self1")
]


@pytest.fixture
def repeats(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a.csv and b.csv, poses of the planar arm read 25 times, and project.toml."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "project.toml").write_text(PROJECT)
    rng = np.random.default_rng(1)
    for name, (a, b) in {"a": (0.3, 1.1), "b": (-0.7, 1.9)}.items():
        true = np.array([a, b])[:, None] + 3e-4 * rng.normal(size=(2, 25))
        x = 800 * np.cos(true[0]) + 600 * np.cos(true[0] + true[1])
        y = 800 * np.sin(true[0]) + 600 * np.sin(true[0] + true[1])
        tip = np.array([x, y]) + 0.04 * rng.normal(size=(2, 25))
        read = np.degrees(true + 5e-5 * rng.normal(size=(2, 25)))
        rows = np.column_stack([np.arange(1, 26), *tip, *read])
        text = "\n".join(",".join(f"{v:.6f}" for v in row) for row in rows)
        (tmp_path / f"{name}.csv").write_text(f"pose,x,y,a,b\n{text}\n")
    return tmp_path


def test_every_column_but_the_ids_is_a_sensor(repeats: Path, run: Run) -> None:
    done = run("noise", "a.csv", "b.csv", "--json")
    assert done.code == 0
    document = json.loads(done.out)
    assert [s["name"] for s in document["sensors"]] == ["x", "y", "a", "b"]
    assert document["series"] == [{"file": f"{n}.csv", "readings": 25} for n in "ab"]
    assert document["separation"] is None
    assert document["sensors"][0]["about_mean"]["degrees"] == 48


def test_headers_state_units(repeats: Path, run: Run) -> None:
    rows = (repeats / "a.csv").read_text().split("\n", 1)[1]
    (repeats / "a.csv").write_text(f"pose,x [mm],y [mm],a [deg],b_rad\n{rows}")
    document = json.loads(run("noise", "a.csv", "--json").out)
    assert [s["unit"] for s in document["sensors"]] == ["m", "m", "rad", "rad"]
    assert document["sensors"][0]["about_mean"]["sd"] < 0.01
    plain = json.loads(run("noise", "b.csv", "--json").out)
    assert not any(s["unit"] for s in plain["sensors"])


def test_the_loops_of_a_project_tell_joints_from_instrument(repeats: Path, run: Run) -> None:
    done = run("noise", "a.csv", "b.csv", "--project", "project.toml", "--json")
    assert done.code == 0
    document = json.loads(done.out)
    joints, instrument = document["separation"]["groups"]
    assert joints["quantities"] == ["phi2", "phi3"]
    assert abs(joints["sd"] - 5e-5) < 4 * joints["sd_of_sd"]
    assert abs(instrument["sd"] - 4e-5) < 4 * instrument["sd_of_sd"]
    assert instrument["raw"] > 4 * instrument["sd"]
    table = tomllib.loads(document["toml"])["noise"]
    assert table["phi2"]["sd"] == pytest.approx(1e6 * joints["sd"], rel=0.01)


def test_the_lines_to_paste_are_a_project_s_noise(repeats: Path, run: Run) -> None:
    done = run("noise", "a.csv", "--columns", "x=mm,y=mm,a=deg,b=deg")
    assert done.code == 0
    pasted = done.out[done.out.index("[noise]") :]
    names = {"x": "xP", "y": "yP", "a": "phi2", "b": "phi3"}
    for column, quantity in names.items():
        pasted = pasted.replace(f"\n{column} =", f"\n{quantity} =")
    start, end = PROJECT.index("[noise]"), PROJECT.index("[prior]")
    Path("pasted.toml").write_text(PROJECT[:start] + pasted + "\n" + PROJECT[end:])
    assert len(read_project("pasted.toml").noise.entries) == 4
    for name in names:
        assert f"\n{name}: sd = " in done.out


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["missing.csv"], 3, "no such file"),
        (["a.csv", "--columns", "q=rad"], 3, "no column 'q'"),
        (["a.csv", "--columns", "x=furlong"], 3, "furlong"),
        (["a.csv", "--columns", "x,x"], 2, "twice"),
        (["a.csv", "--columns", ","], 2, "empty"),
        (["a.csv", "--columns", "x=m", "--project", "project.toml"], 2, "--columns"),
        (["a.csv", "short.csv"], 3, "2 times"),
        (["a.csv", "other.csv"], 3, "different quantities"),
        (["a.csv", "--project", "moved.toml"], 3, "elsewhere"),
        (["a.csv", "--project", "bare.toml"], 3, "names no columns"),
    ],
)
def test_mistakes_are_told(
    repeats: Path, run: Run, arguments: list[str], code: int, words: str
) -> None:
    (repeats / "short.csv").write_text("pose,x,y,a,b\n1,1,2,3,4\n2,1,2,3,4\n")
    (repeats / "other.csv").write_text("pose,x,y\n1,1,2\n2,1,2\n3,1,3\n")
    (repeats / "moved.toml").write_text(PROJECT + '[parameters]\nxA = { value = 3, unit = "m" }\n')
    (repeats / "bare.toml").write_text('schema = 1\n[mechanism]\ntype = "planar-two-link"\n')
    done = run("noise", *arguments)
    assert done.code == code
    assert words in done.err
    assert "What to do" in done.err
    assert "Traceback" not in done.err


NOISE = """
[noise]
"theta_*" = {{ encoder = {{ bits = 20, accuracy = "4 arcsec" }}, rounded_to = 1e-4, unit = "deg" }}
xyz = {tracker}

[prior]
"*" = {{ sd = inf }}

[simulation]
poses = 60
[simulation.ranges]
"""


@pytest.mark.parametrize(
    "tracker",
    [
        '{ tracker = "leica-at500", station = [0, -3000, 500], unit = "mm" }',
        '{ tracker = { range = "10 um + 0.3 um/m", transverse = "15 um + 6 um/m" }, '
        "station = [0, -3, 0.5] }",
    ],
)
def test_makers_figures_serve_simulation_and_calibration(
    tmp_path: Path, run: Run, tracker: str
) -> None:
    ranges = "".join(f"q{i} = {{ from = -1.2, to = 1.1 }}\n" for i in range(1, 4))
    joints = "".join(
        f'[[mechanism.joint]]\nname = "q{i}"\nform = "hayati"\na = 0.4\nbeta = 0.3\nalpha = 1.2\n'
        for i in range(1, 4)
    )
    text = (
        f'schema = 1\n[data]\nfile = "poses.csv"\n{NOISE.format(tracker=tracker)}{ranges}'
        f'[mechanism]\ntype = "serial"\n{joints}'
    ).replace("theta_", "q")
    project = tmp_path / "project.toml"
    project.write_text(text)
    assert run("simulate", project, "--out", tmp_path / "poses.csv", "--seed", "3").code == 0
    done = run("calibrate", project, "--method", "implicit-loop", "--json")
    assert done.code == 0, done.err
    document = json.loads(done.out)
    assert {entry["source"] for entry in document["noise"]} == {"datasheet"}
    assert 0.001 < document["chi_squared"]["p_value"] < 0.999
    sds = {q: entry["sd"] for entry in document["noise"] for q in entry["quantities"]}
    assert sds["q1"] == pytest.approx(
        np.sqrt(
            (2 * np.pi / 2**20) ** 2 / 12 + np.radians(2 / 3600) ** 2 + np.radians(1e-4) ** 2 / 12
        )
    )
    assert 5e-6 < sds["y"] < sds["x"] < 4e-5


def test_real_repeats(
    shared_data: Callable[[str], Path], run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = [shared_data(name) for name in SETS]
    monkeypatch.setenv("LOOPCAL_DATA", str(files[0].parents[1]))
    project = SIX_AXIS.parents[1] / "motoman" / "right_arm_workspace.toml"
    done = run("noise", *files, "--project", project, "--json")
    assert done.code == 0, done.err
    document = json.loads(done.out)
    by_series = {s["name"]: s["by_series"] for s in document["sensors"]}
    encoders = [sd for name, its in by_series.items() if name.startswith("theta") for sd in its]
    tracker = [sd for name in "xyz" for sd in by_series[name]]
    assert min(encoders) > 8e-6
    assert max(encoders) < 1e-4
    assert min(tracker) > 6e-6
    assert max(tracker) < 6e-5
    steps = {s["name"]: s["resolution"] for s in document["sensors"]}
    assert steps["theta_1"] == pytest.approx(12.13e-6, abs=1e-7)  # counts behind 1 urad decimals
    assert steps["theta_6"] == pytest.approx(50e-6, abs=1e-6)
    assert steps["x"] == pytest.approx(1e-6)
    # the arm moves, and both see it: what is left is far less than either scatters
    strongest = max(document["correlations"], key=lambda c: abs(c["value"]))
    assert set(strongest["sensors"]) == {"theta_1", "x"}
    joints, instrument = document["separation"]["groups"]
    assert 1e-5 < joints["sd"] < 2e-5
    assert joints["raw"] > 2 * joints["sd"]
    assert instrument["sd"] < 5e-6
    assert instrument["upper"] < 1e-5


def test_one_real_series_far_from_the_project_s_instrument_is_refused(
    shared_data: Callable[[str], Path], run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = shared_data(SETS[0])
    monkeypatch.setenv("LOOPCAL_DATA", str(file.parents[1]))
    project = SIX_AXIS.parents[1] / "motoman" / "right_arm_workspace.toml"
    done = run("noise", file, "--project", project)
    assert done.code == 3
    assert "elsewhere" in done.err

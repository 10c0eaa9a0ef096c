"""A type with nominal values and a point of its own is begun from whatever instrument sees it."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import loopcal as lc
from analyses.machines import LINEAR_DELTA
from loopcal.cli.run import main
from loopcal.estimation.mounted import bodies_of
from loopcal.mechanisms.frame import ChainFrame
from loopcal.mechanisms.instruments.length import draw_wire
from loopcal.mechanisms.instruments.point import point
from loopcal.mechanisms.parallel.delta import linear_delta
from loopcal.mechanisms.planar import motoman_ma1400
from tests.refusals import refused

NOISE = 5e-5
REFLECTORS = np.array([[0.02, -0.07, -0.35], [-0.1, 0.06, -0.3]])
MOUNTED = dict(zip(["x6B", "y6B", "z6B"], REFLECTORS[0].tolist(), strict=True))
DRAWN = {"x4": motoman_ma1400().parameters["x4"].nominal + 2e-4}
"""What a user's own file states [m]."""
ANCHOR, ZERO = np.array([1.4, 0.9, -0.8]), 0.25


@pytest.fixture(scope="module")
def flange() -> dict[str, np.ndarray]:
    """Joints, and T_base_flange in 80 poses, of a machine 0.3 mm and 0.3 mrad off its drawing."""
    rng = np.random.default_rng(4)
    mechanism = motoman_ma1400()
    limits = np.radians([100, 60, 60, 120, 90, 150])
    joints = {f"theta_{i + 1}": rng.uniform(-a, a, 80) for i, a in enumerate(limits)}
    values = {
        p.name: 0.0 if p.name.endswith("6B") else p.nominal + 3e-4 * rng.standard_normal()
        for p in mechanism.parameters
    }
    bodies = bodies_of(ChainFrame(mechanism.chain, joints, values), 80)
    return {**joints, "R": bodies.rotations, "p": bodies.origins}


def seen(points: np.ndarray, seed: int) -> np.ndarray:
    """From a tracker that stands askew, with noise."""
    R = Rotation.from_euler("xyz", [0.02, -0.03, 1.2]).as_matrix()
    noise = NOISE * np.random.default_rng(seed).standard_normal(points.shape)
    return np.asarray(points @ R.T + np.array([2.0, -1.0, 0.4]) + noise)


def points(flange: dict[str, np.ndarray]) -> list[np.ndarray]:
    return [flange["p"] + flange["R"] @ r for r in REFLECTORS]


def angles(flange: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {n: flange[n] for n in flange if n.startswith("theta")}


def left(folder: Path) -> float:
    """Rms of a least-squares fit of the project [m]."""
    found = lc.calibrate(lc.read_project(folder / "project.toml"), method="least-squares")
    assert found.status.converged
    assert found.accuracy_after is not None
    return found.accuracy_after.rms


def test_two_reflectors(tmp_path: Path, flange: dict[str, np.ndarray]) -> None:
    columns = angles(flange)
    for i, its in enumerate(points(flange), 1):
        columns |= dict(zip([f"x{i}", f"y{i}", f"z{i}"], seen(its, i).T, strict=True))
    made = lc.init(columns, machine="motoman-ma1400", out=tmp_path / "o")
    assert made.mechanism.outputs == ("x_1", "y_1", "z_1", "x_2", "y_2", "z_2")
    assert left(tmp_path / "o") < 2.0 * NOISE


def test_a_wire(tmp_path: Path, flange: dict[str, np.ndarray]) -> None:
    noise = NOISE * np.random.default_rng(3).standard_normal(80)
    wire = np.linalg.norm(points(flange)[0] - ANCHOR, axis=1) - ZERO + noise
    made = lc.init({**angles(flange), "L": wire}, machine="motoman-ma1400", out=tmp_path / "o")
    assert made.mechanism.outputs == ("wire",)
    assert left(tmp_path / "o") < 1.5 * NOISE


def test_a_pose(tmp_path: Path, flange: dict[str, np.ndarray]) -> None:
    turned = Rotation.from_matrix(flange["R"]).as_quat()
    columns = angles(flange) | dict(zip("xyz", flange["p"].T, strict=True))
    columns |= dict(zip(["qx", "qy", "qz", "qw"], turned.T, strict=True))
    made = lc.init(columns, machine="motoman-ma1400", out=tmp_path / "o")
    assert {"x", "y", "z"} <= set(made.mechanism.outputs)
    assert made.rms < 3e-3


def test_one_point_is_that_of_the_type(tmp_path: Path, flange: dict[str, np.ndarray]) -> None:
    columns = angles(flange) | dict(zip("xyz", seen(points(flange)[0], 1).T, strict=True))
    lc.init(columns, machine="motoman-ma1400", out=tmp_path / "o")
    assert "x6B" in (tmp_path / "o" / "project.toml").read_text("utf-8")
    assert left(tmp_path / "o") < 2.0 * NOISE


@pytest.mark.parametrize("instrument", ["point", "two points", "wire"])
def test_a_file_of_the_type_states_what_the_drawing_does_not(
    tmp_path: Path, flange: dict[str, np.ndarray], instrument: str
) -> None:
    file = tmp_path / "arm.toml"
    drawn = "\n".join(f"{n} = {{ value = {v!r} }}" for n, v in {**DRAWN, **MOUNTED}.items())
    file.write_text(f'schema = 1\ntype = "motoman-ma1400"\n[parameters]\n{drawn}\n')
    columns = angles(flange)
    for i, its in enumerate(points(flange)[: 1 + (instrument == "two points")], 1):
        columns |= dict(zip([f"x{i}", f"y{i}", f"z{i}"], seen(its, i).T, strict=True))
    if instrument == "wire":
        noise = NOISE * np.random.default_rng(3).standard_normal(80)
        wire = np.linalg.norm(points(flange)[0] - ANCHOR, axis=1) - ZERO + noise
        columns = angles(flange) | {"L": wire}
    made = lc.init(columns, machine=str(file), out=tmp_path / "o")
    nominal = {p.name: p.nominal for p in made.mechanism.parameters}
    assert {n: nominal[n] for n in DRAWN} == pytest.approx(DRAWN)
    if instrument == "point":
        assert {n: nominal[n] for n in MOUNTED} == pytest.approx(MOUNTED)
        assert "a guess, found by placing" not in made.text
    assert left(tmp_path / "o") < 2.0 * NOISE


def test_readings_of_one_station_are_not_those_of_a_controller(
    flange: dict[str, np.ndarray],
) -> None:
    """Rows from a second place that follow the drawing are of another robot, not commanded."""
    drawn = motoman_ma1400()
    nominal = {p.name: 0.0 if p.name.endswith("6B") else p.nominal for p in drawn.parameters}
    bodies = bodies_of(ChainFrame(drawn.chain, angles(flange), nominal), 80)
    measured = seen(points(flange)[0], 1)
    measured[40:] = (seen(bodies.at(REFLECTORS[0]), 2) + np.array([1.0, 2.0, 0.0]))[40:]
    columns = angles(flange) | dict(zip("xyz", measured.T, strict=True))
    made = lc.init(columns | {"station": np.repeat([1.0, 2.0], 40)}, machine="motoman-ma1400")
    assert len(made.mechanism.families) == 2


@pytest.mark.parametrize(
    ("kind", "columns"),
    [
        ("linear-delta", ("h1", "h2", "h3")),
        ("rotary-delta", ("q1", "q2", "q3")),
        ("stewart-gough", tuple(f"L{i}" for i in range(1, 7))),
    ],
)
def test_a_parallel_machine(tmp_path: Path, kind: str, columns: tuple[str, ...]) -> None:
    assert main(["new", str(tmp_path / "new"), "--mechanism", kind]) == 0
    poses = tmp_path / "poses.csv"
    assert main(["simulate", str(tmp_path / "new/project.toml"), "--out", str(poses)]) == 0
    head, *rows = poses.read_text().splitlines()
    names = head.split(",")
    renamed = ["pose", *columns, *names[1 + len(columns) :]]
    poses.write_text("\n".join([",".join(renamed), *rows]) + "\n")
    for machine in (kind, str(tmp_path / "new/mechanism.toml")):
        made = lc.init(poses, machine=machine, out=tmp_path / "out")
        read = [n for n in made.dataset.readings if not n.startswith("platform")]
        assert read[: len(columns)] == list(made.mechanism.tape.quantities[: len(columns)])
        assert left(tmp_path / "out") < 2e-4
        for name in ("project.toml", "readings.csv"):
            (tmp_path / "out" / name).unlink(missing_ok=True)
    assert "tool_x" not in made.text or kind == "stewart-gough"


def test_what_a_drawing_leaves_out_is_a_guess(tmp_path: Path) -> None:
    """It is named, and known to a fifth of the machine's size only."""
    truth = {"rod_2": 0.33}
    made = lc.assemble(linear_delta(), [point(readings=("x", "y", "z"))])
    noise = lc.Noise({"slide_*": 1e-5, "[xyz]": 1e-5, "platform_*": math.inf})
    poses = lc.random_poses(LINEAR_DELTA, 30, seed=1)
    read = lc.simulate(made, poses, noise=noise, seed=51290, truth=truth).dataset.readings
    columns = {f"S{i} [m]": read[f"slide_{i}"] for i in (1, 2, 3)}
    columns |= {f"{axis} [m]": read[axis] for axis in "xyz"}
    drawn = {p.name: p.nominal for p in linear_delta().parameters.values() if p.nominal}
    assert drawn.pop("rod_2") == 0.3
    lines = [f"{name} = {value!r}" for name, value in drawn.items()]
    drawing = tmp_path / "delta.toml"
    drawing.write_text("\n".join(["schema = 1", 'type = "linear-delta"', "[parameters]", *lines]))
    begun = lc.init(columns, machine=str(drawing))
    (guess,) = (words for words in begun.remarks if words.startswith("guesses"))
    assert "rod_2 = 300 mm" in guess
    assert "rod_1" not in guess
    assert begun.mechanism.parameters["rod_2"].prior_sd == pytest.approx(0.06)
    assert math.isinf(begun.mechanism.parameters["rod_1"].prior_sd)
    everything = lc.init(columns, machine="linear-delta")
    assert any("no dimension is stated" in words for words in everything.remarks)


def test_wires_of_a_platform_that_never_turns_begin_at_their_anchors() -> None:
    """Its targets are held on it; anchors and zeros of wires are begun where readings put them."""
    wires = [draw_wire(f"w{i}", anchor=f"a_w{i}", target=f"t{i}") for i in (1, 2, 3)]
    made = lc.assemble(linear_delta(), wires)
    anchors = np.array([[0.9, 0.1, 1.0], [-0.7, 0.8, 1.1], [-0.5, -0.9, 0.9]])
    truth = {f"w{i}_offset": 0.1 * i for i in (1, 2, 3)}
    for i, at in enumerate(anchors, 1):
        truth |= dict(zip([f"a_w{i}_{axis}" for axis in "xyz"], at, strict=True))
    driven = lc.random_poses(LINEAR_DELTA, 60, seed=1)
    noise = lc.Noise({"slide_*": 1e-5, "w*": 5e-5, "platform_*": math.inf})
    read = lc.simulate(made, driven, noise=noise, seed=2, truth=truth).dataset.readings
    columns = {f"S{i} [m]": read[f"slide_{i}"] for i in (1, 2, 3)}
    columns |= {f"wire {i} [m]": read[f"w{i}"] for i in (1, 2, 3)}
    started = lc.init(columns, machine="linear-delta").mechanism
    values = {p.name: p.nominal for p in started.parameters}
    for i, at in enumerate(anchors, 1):
        begun = [values[f"wire_{i}_{axis}"] for axis in "xyz"]
        assert np.linalg.norm(begun - at) < 0.02
        assert values[f"wire_{i}_offset"] == pytest.approx(0.1 * i, abs=0.02)
        assert all(started.parameters[f"tool_{i}_{axis}"].fixed for axis in "xyz")


def test_an_own_loop_in_a_plane_has_the_command_that_begins_it() -> None:
    with refused("unsupported", "moves in a plane", "loopcal new"):
        lc.init({"a": np.arange(9.0)}, machine="planar-two-link")

"""An inclinometer reads the angles of two axes against the horizontal, wherever it is mounted."""

from __future__ import annotations

from math import asin

import numpy as np
import pytest

import loopcal as lc
from loopcal.errors import Code
from loopcal.files.machines.mechanism_file import mechanism_from_data
from loopcal.files.machines.mechanism_writer import mechanism_to_toml
from loopcal.files.toml.place import Place
from loopcal.files.toml.reader import toml_data
from loopcal.mechanisms.mechanism import Mechanism
from tests.reference import frames
from tests.refusals import refused

ARM = """
type = "serial"
joint = [
    { name = "q1", d = 0.4, alpha = 1.5708 },
    { name = "q2", a = 0.5, alpha = 1.2 },
    { name = "q3", a = 0.3, d = 0.1, alpha = -1.4 },
]
[[instrument]]
type = "point"
station = "tracker"
"""
MOUNTED = {"level_rz": 0.3, "level_ry": -0.2, "level_rx": 0.1}
TILTED = {"level_tilt_1": 0.02, "level_tilt_2": -0.03}


def read(text: str) -> Mechanism:
    data = {k: v for k, v in toml_data(text, "arm.toml").items() if k != "schema"}
    return mechanism_from_data(data, Place("arm.toml"))


def turned(rz: float, ry: float, rx: float) -> np.ndarray:
    T = frames.turn("z", rz) @ frames.turn("y", ry) @ frames.turn("x", rx)
    return np.asarray(T)[:3, :3]


def simulated(arm: Mechanism, poses: int, sd: float, seed: int = 1) -> lc.Simulation:
    joints = [q for q in arm.quantities if q[0] == "q"]
    given = lc.random_poses(dict.fromkeys(joints, (-1.5, 1.5)), poses, seed=seed)
    return lc.simulate(arm, given, noise=lc.Noise({"*": sd}), seed=seed)


def test_it_reads_the_arcsine_of_the_component_upwards() -> None:
    arm = lc.assemble(
        lc.machines.serial([lc.Joint("q1"), lc.Joint("q2")]),
        [lc.instruments.inclinometer()],
        {"alpha_1": 0.7, "alpha_2": -1.1, "offset_2": 0.4} | MOUNTED | TILTED,
    )
    a, b = TILTED.values()
    # down is -z tilted towards x and y: e_1 and e_2 of the nominal direction, by hand
    up = np.array([0.0, 0.0, 1.0])
    data = simulated(arm, 20, 0.0).dataset
    for i in range(20):
        R = np.asarray(
            frames.turn("z", data["q1"][i])
            @ frames.turn("x", 0.7)
            @ frames.turn("z", data["q2"][i] + 0.4)
            @ frames.turn("x", -1.1)
        )[:3, :3]
        axes = R @ turned(*MOUNTED.values())
        up = np.array([-np.sin(a) * np.cos(b), np.sin(b), np.cos(a) * np.cos(b)])
        assert data["level_x"][i] == pytest.approx(asin(axes[:, 0] @ up), abs=1e-12)
        assert data["level_y"][i] == pytest.approx(asin(axes[:, 1] @ up), abs=1e-12)


def test_on_the_base_it_reads_the_same_in_every_pose() -> None:
    level = lc.instruments.inclinometer(on="base")
    arm = lc.assemble(lc.machines.serial([lc.Joint("q1")]), [level], MOUNTED | TILTED)
    data = simulated(arm, 5, 0.0).dataset
    assert np.ptp(data["level_x"]) == pytest.approx(0.0, abs=1e-15)
    assert abs(data["level_x"][0]) > 0.1


def test_in_a_plane_it_reads_the_angle_of_its_axis_over_the_horizontal() -> None:
    links = lc.machines.planar_two_link()
    level = lc.instruments.inclinometer(dimension=2)
    arm = lc.assemble(links, [level], {"level_rz": 0.2})
    made = lc.simulate(
        arm, {"phi2": [1.0, 2.5], "phi3": [0.5, 2.0]}, noise=lc.Noise({"*": 0.0}), seed=1
    )
    expected = np.array([1.7, 4.7 - 2 * np.pi])
    np.testing.assert_allclose(made.dataset["level_x"], expected, atol=1e-12)


def test_in_the_frame_of_a_levelled_tracker_gravity_is_exact() -> None:
    levelled = '[[instrument]]\ntype = "inclinometer"\nstation = "tracker"\n'
    arm = read(ARM + levelled)
    assert "level_tilt_1" not in arm.parameters.names
    assert set(MOUNTED) <= set(arm.parameters.names)
    turned_station = arm.with_nominal({"tracker_rz": 1.0, "tracker_ry": 0.1})
    plain = simulated(arm, 3, 0.0).dataset
    other = simulated(turned_station, 3, 0.0).dataset
    assert not np.allclose(plain["level_x"], other["level_x"], atol=1e-3)
    about_gravity = arm.with_nominal({"tracker_rz": 1.0})
    np.testing.assert_allclose(
        simulated(about_gravity, 3, 0.0).dataset["level_x"], plain["level_x"], atol=1e-12
    )


def test_its_mounting_and_the_tilt_of_the_base_are_recovered() -> None:
    arm = read(ARM + '[[instrument]]\ntype = "inclinometer"\ngravity = [0, 0, -2]\n')
    fixed = arm.with_parameters(arm.parameters.with_fixed(["[ad]_*", "alpha_*", "offset_*"]))
    truth = fixed.with_nominal(MOUNTED | TILTED)
    data = simulated(truth, 60, 1e-5).dataset
    result = lc.calibrate(fixed, data, noise=lc.Noise({"*": 1e-5}), method="implicit-loop")
    assert result.status.converged
    assert result.identifiability.data_rank == len(fixed.parameters.free) == 6 + 3 + 5
    for name, true in (MOUNTED | TILTED).items():
        sd = result.sd[name]
        assert sd is not None
        assert sd < 1e-4
        assert abs(result.value[name] - true) < 5 * sd, name


@pytest.mark.parametrize(
    "keys", ["", 'on = "base"', 'station = "tracker"', 'readings = ["a", "b"]\ngravity = [1, 0, 0]']
)
def test_it_is_written_again_bit_for_bit(keys: str) -> None:
    arm = read(f'{ARM}[[instrument]]\ntype = "inclinometer"\n{keys}\n')
    assert read(mechanism_to_toml(arm)) == arm


@pytest.mark.parametrize(
    ("keys", "code", "stated"),
    [
        ('readings = ["a"]', "wrong-shape", ("1", "'level'")),
        ("gravity = [0, 0, 0]", "invalid-value", ("'level'",)),
        ('on = "table"', "unknown-name", ("'table'",)),
    ],
)
def test_what_does_not_fit_is_refused(keys: str, code: Code, stated: tuple[str, ...]) -> None:
    with refused(code, *stated) as caught:
        read(f'{ARM}[[instrument]]\ntype = "inclinometer"\n{keys}\n')
    assert "instrument[2]" in str(caught.value)

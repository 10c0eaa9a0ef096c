"""What instruments read of a body, against matrices written out by hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import atan2, hypot, pi

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import loopcal as lc
from loopcal.errors import Code
from loopcal.mechanisms.chain import Step
from loopcal.mechanisms.instruments.contact import ball_bar, plane, socket, sphere
from loopcal.mechanisms.instruments.length import distance, draw_wire, relative_distance
from loopcal.mechanisms.instruments.point import point
from loopcal.mechanisms.instruments.pose import pose
from loopcal.mechanisms.instruments.spherical import spherical
from loopcal.mechanisms.machine import Instrument, Machine, assemble
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.serial import chain_machine
from loopcal.mechanisms.station import Target
from tests.reference import frames
from tests.reference.plain_tape import loop_values
from tests.refusals import refused

Array = NDArray[np.float64]
STEPS = (Step("rz", None, "q1"), Step("tx", "a"), Step("ry", None, "q2"), Step("tz", "h"))
ARM = {"a": 0.4, "h": 0.7, "tool_x": 0.05, "tool_y": -0.1, "tool_z": 0.2}
T_STATION = {"x": 1.1, "y": -0.7, "z": 0.3, "rz": 2.8, "ry": 0.3, "rx": -0.2}
CASES = np.random.default_rng(2).uniform(-pi, pi, (20, 2))


def machine() -> Machine:
    return chain_machine(STEPS, name="two turns")


def standing(name: str) -> dict[str, float]:
    return {f"{name}_{key}": value for key, value in T_STATION.items()}


def body(q1: float, q2: float) -> Array:
    """T_base_body."""
    T: Array = (
        frames.turn("z", q1)
        @ frames.move(ARM["a"], 0, 0)
        @ frames.turn("y", q2)
        @ frames.move(0, 0, ARM["h"])
    )
    return T


def station() -> Array:
    """T_station_base."""
    x, y, z, rz, ry, rx = T_STATION.values()
    T: Array = (
        frames.move(x, y, z) @ frames.turn("z", rz) @ frames.turn("y", ry) @ frames.turn("x", rx)
    )
    return T


def tool(q1: float, q2: float) -> Array:
    """The tool point in the base."""
    p: Array = body(q1, q2) @ [ARM["tool_x"], ARM["tool_y"], ARM["tool_z"], 1.0]
    return p[:3]


def made(instruments: Sequence[Instrument], values: Mapping[str, float] | None = None) -> Mechanism:
    mechanism = assemble(machine(), instruments)
    known = {n: v for n, v in ARM.items() if n in mechanism.parameters.names}
    return mechanism.with_nominal(known | dict(values or {}))


def values(mechanism: Mechanism, readings: Mapping[str, float]) -> dict[str, float]:
    """Loop values by name."""
    tape = mechanism.tape
    x = [readings.get(q, 0.0) for q in tape.quantities]
    p = [parameter.nominal for parameter in mechanism.parameters]
    known = [readings[name] for name in tape.pose_constants]
    return dict(zip(tape.loops, loop_values(tape, x, p, known).tolist(), strict=True))


def test_a_tracker_reads_distance_and_two_angles() -> None:
    mechanism = made([spherical("T", offsets=True)], standing("T") | {"T_range_offset": 0.01})
    for q1, q2 in CASES:
        x, y, z = (station() @ [*tool(q1, q2), 1.0])[:3]
        read = {
            "q1": q1,
            "q2": q2,
            "T_range": np.sqrt(x * x + y * y + z * z) + 0.01,
            "T_azimuth": atan2(y, x),
            "T_elevation": atan2(z, hypot(x, y)),
        }
        closed = values(mechanism, read)
        assert np.abs(list(closed.values())).max() < 1e-14
        # an angle is an angle, wherever it is counted from, and as much off as it reads off
        for turns, off in ((1, 0.0), (-3, 0.3), (0, -3.0), (2, 1.5)):
            read_off = values(mechanism, read | {"T_azimuth": atan2(y, x) + 2 * pi * turns + off})
            assert read_off["T_azimuth"] == pytest.approx(-off, abs=1e-12)
            assert read_off["T_range"] == pytest.approx(0.0, abs=1e-14)


@pytest.mark.parametrize(
    ("form", "write"),
    [
        ("quaternion", lambda R: -3.0 * R.as_quat()[[3, 0, 1, 2]]),
        ("rotation-vector", lambda R: R.as_rotvec()),
        ("rz ry rx", lambda R: R.as_euler("ZYX")),
        ("rx ry rz", lambda R: R.as_euler("XYZ")),
        ("rz ry rz", lambda R: R.as_euler("ZYZ")),
    ],
)
def test_a_pose_is_off_by_small_turns_about_the_axes_measured(form: str, write: object) -> None:
    turned = {"tool_rz": 0.4, "tool_ry": -1.0, "tool_rx": 2.0}
    mechanism = made([pose("P", orientation=form)], standing("base") | turned)
    columns = mechanism.tape.pose_constants
    own = Rotation.from_euler("ZYX", list(turned.values())).as_matrix()
    rng = np.random.default_rng(6)
    for q1, q2 in CASES:
        true = Rotation.from_matrix((station() @ body(q1, q2))[:3, :3] @ own)
        for size in (0.0, 1e-5, 2.0):
            off = rng.normal(size=3)
            off *= size / np.linalg.norm(off)
            assert callable(write)
            numbers = write(true * Rotation.from_rotvec(-off))
            read = {"q1": q1, "q2": q2, **dict(zip(columns, numbers, strict=True))}
            read |= dict(zip("xyz", (station() @ [*tool(q1, q2), 1.0])[:3], strict=True))
            found = values(mechanism, read)
            assert [found[a] for a in "xyz"] == pytest.approx([0.0] * 3, abs=1e-14)
            w = [found[f"P_w{a}"] for a in "xyz"]
            angle = 2 * np.tan(size / 2) / size if size else 1.0
            assert w == pytest.approx(angle * off, abs=1e-13)


def test_x_and_y_alone_in_space() -> None:
    flat = {name: v for name, v in standing("base").items() if name != "base_z"}
    mechanism = made([point("grid", readings=("u", "v"))], flat)
    assert "base_z" not in mechanism.parameters.names
    for q1, q2 in CASES:
        x, y = (station() @ [*tool(q1, q2), 1.0])[:2]
        assert values(mechanism, {"q1": q1, "q2": q2, "u": x, "v": y}) == pytest.approx(
            {"u": 0.0, "v": 0.0}, abs=1e-14
        )
    with refused("wrong-shape", "1 coordinates"):
        point("grid", readings=("u",))
    with refused("wrong-shape", "2 coordinates"):
        pose("grid", readings=("u", "v"))


def test_no_turn_at_all_is_a_rotation_vector_too() -> None:
    mechanism = made([pose("P", orientation="rotation-vector", station=None, target=Target(()))])
    read = dict.fromkeys(("q1", "q2", "rvx", "rvy", "rvz"), 0.0)
    found = values(mechanism, read | {"x": 0.4, "y": 0.0, "z": 0.7})
    assert list(found.values()) == pytest.approx([0.0] * 6, abs=1e-15)


def test_lengths_and_gaps_are_those_of_the_points() -> None:
    A, n = np.array([1.3, -0.4, 0.8]), np.array([0.3, -0.5, 0.9])
    at = dict(zip(("pin_x", "pin_y", "pin_z"), A.tolist(), strict=True))
    instruments = [
        distance("d", anchor="pin"),
        draw_wire("w", anchor="pin"),
        ball_bar("bar", centre="pin"),
        sphere("ball", centre="pin"),
        plane("wall", normal=(0.0, 2.0, 0.0)),
        plane("floor", normal=n.tolist()),
        socket("seat"),
        relative_distance("span"),
    ]
    a, b = 0.3, -0.2
    given = {"w_offset": 0.2, "bar_length": 0.5, "ball_radius": 0.6, "wall_distance": 0.1}
    given |= {"wall_tilt_1": a, "wall_tilt_2": b, "floor_distance": -0.3}
    given |= {"seat_x": 0.1, "seat_y": 0.2, "seat_z": 0.3}
    mechanism = made(instruments, at | given)
    wall = np.array([np.sin(a) * np.cos(b), np.cos(a) * np.cos(b), -np.sin(b)])
    for (q1, q2), (r1, r2) in zip(CASES, CASES[::-1], strict=True):
        p, other = tool(q1, q2), tool(r1, r2)
        far = np.linalg.norm(p - A)
        expected = {
            "d": far - 1.0,
            "w": far + 0.2 - 1.0,
            "bar_gap": far - 0.5,
            "ball_gap": far - 0.6,
            "wall_gap": wall @ p - 0.1,
            "floor_gap": n @ p / np.linalg.norm(n) + 0.3,
            **{f"seat_gap_{axis}": p[i] - 0.1 * (i + 1) for i, axis in enumerate("xyz")},
            "span": np.linalg.norm(p - other) - 1.0,
        }
        joints = {"q1": q1, "q2": q2, "q1_b": r1, "q2_b": r2}
        found = values(mechanism, joints | {"d": 1.0, "w": 1.0, "span": 1.0})
        assert found == pytest.approx(expected, abs=1e-14)
    assert mechanism.implied == dict.fromkeys(
        ("bar_gap", "ball_gap", "wall_gap", "floor_gap", *(f"seat_gap_{a}" for a in "xyz")), 0.0
    )


def test_the_normal_of_a_plane_is_a_unit_vector_at_any_tilt() -> None:
    rng = np.random.default_rng(4)
    for _ in range(20):
        tilts = rng.uniform(-pi, pi, 2)
        given = {"P_tilt_1": tilts[0], "P_tilt_2": tilts[1]}
        mechanism = made([plane("P", normal=rng.normal(size=3).tolist())], given)
        still = {"a": 0.0, "h": 0.0, "tool_x": 0.0, "tool_y": 0.0, "tool_z": 0.0}
        n = [
            values(mechanism.with_nominal(still | {f"tool_{axis}": 1.0}), {})["P_gap"]
            for axis in "xyz"
        ]
        assert np.linalg.norm(n) == pytest.approx(1.0, abs=1e-14)


def flat() -> Machine:
    steps = (Step("rz", None, "q1"), Step("tx", "a"), Step("rz", None, "q2"))
    return replace(chain_machine(steps, name="two links"), dimension=2)


def test_instruments_of_a_plane_read_in_it() -> None:
    at = {"A_x": 0.9, "A_y": 0.2, "L_distance": 0.3, "L_tilt_1": 0.1, "C_radius": 0.1}
    given = {"a": 0.5, "tool_x": 0.3, "tool_y": 0.1, "tool_rz": 0.2, "T_x": 2.0, "T_rz": 3.0}
    instruments = [
        spherical("T", dimension=2),
        pose("P", readings=("x", "y"), station="T", dimension=2),
        draw_wire("w", anchor="A", dimension=2),
        sphere("C", centre="A", dimension=2),
        plane("L", normal=(0.0, 1.0, 0.0), dimension=2),
        socket("S", dimension=2),
    ]
    mechanism = assemble(flat(), instruments, at | given)
    for q1, q2 in CASES:
        p = 0.5 * np.exp(1j * q1) + (0.3 + 0.1j) * np.exp(1j * (q1 + q2))
        seen = 2.0 + p * np.exp(3j)
        found = values(mechanism, {"q1": q1, "q2": q2})
        turned = q1 + q2 + 0.2 + 3.0
        far = abs(p - (0.9 + 0.2j))
        expected = {
            "T_range": abs(seen),
            "T_azimuth": atan2(seen.imag, seen.real),
            "x": seen.real,
            "y": seen.imag,
            "P_phi": atan2(np.sin(turned), np.cos(turned)),
            "w": far,
            "C_gap": far - 0.1,
            "L_gap": np.cos(0.1) * p.imag - np.sin(0.1) * p.real - 0.3,
            "S_gap_x": p.real,
            "S_gap_y": p.imag,
        }
        assert found == pytest.approx(expected, abs=1e-13)


def test_instruments_that_share_a_name_share_its_parameters() -> None:
    two = [spherical("east"), spherical("west")]
    assert len(assemble(machine(), two).parameters) == 2 + 12 + 3
    same = [spherical("east"), spherical("again", station="east", target="other")]
    assert len(assemble(machine(), same).parameters) == 2 + 6 + 6
    pinned = [distance("d", anchor="pin"), sphere("ball", centre="pin")]
    assert len(assemble(machine(), pinned).parameters) == 2 + 3 + 1 + 3


@pytest.mark.parametrize(
    ("instruments", "code", "stated"),
    [
        ([spherical("T"), draw_wire("w", anchor="T")], "duplicate-name", ("'T_x'",)),
        ([spherical("T"), spherical("other", target="T")], "duplicate-name", ("'T_x'",)),
        (
            [spherical("T"), point("p", station="T", readings=("q1", "y", "z"))],
            "duplicate-name",
            ("'q1'",),
        ),
        (
            [spherical("T", readings=("r", "a", "e")), point(readings=("r", "y", "z"))],
            "duplicate-name",
            ("'r'",),
        ),
        ([draw_wire("w"), draw_wire("w", reading="other")], "duplicate-name", ("'w'",)),
        ([socket("S", dimension=2)], "unsupported", ("'S'", "2")),
    ],
)
def test_what_does_not_go_together_is_refused(
    instruments: list[Instrument], code: Code, stated: tuple[str, ...]
) -> None:
    with refused(code, *stated) as error:
        assemble(machine(), instruments)
    assert error.value.remedy


def test_the_name_of_a_joint_is_none_of_an_instrument() -> None:
    """tool_x of a joint called "tool" is no coordinate of a target."""
    for mine in (point(target="q"), point(station="q")):
        with refused("duplicate-name", "'q_x'") as error:
            assemble(chain_machine([Step("tx", "q_x"), Step("rz", joint="q")], name="arm"), [mine])
        assert "differently" in str(error.value.remedy)


def test_what_no_file_can_describe_is_a_function_to_it() -> None:
    assert assemble(machine(), [point()]).description is None
    listed = lc.machines.serial([lc.Joint("q")])
    assert assemble(listed, [point()]).description is not None
    assert assemble(listed, [replace(point(), description={})]).description is None


def test_a_wire_of_no_length_is_told_what_to_do() -> None:
    at = {"a": 0.5, "h": 0.75, "wire_x": 0.5, "wire_z": 0.75, "tool_x": 0.0, "tool_y": 0.0}
    mechanism = made([draw_wire()], at | {"tool_z": 0.0})
    data = {"q1": [0.1, 0.0], "q2": [0.2, 0.0], "wire": [0.5, 0.6]}
    noise, prior = lc.Noise({"*": 1e-4}), lc.Prior({"*": 0.1})
    with refused("outside-domain", "'wire'", "pose '2'") as error:
        lc.calibrate(mechanism, data, noise=noise, prior=prior, method="implicit-loop")
    assert "wire_x, wire_y, wire_z" in (error.value.remedy or "")


def test_a_tracker_below_its_target_is_told_what_to_do() -> None:
    overhead = {"a": 0.0, "h": 0.75, "tool_x": 0.0, "tool_y": 0.0, "tool_z": 0.0}
    mechanism = made([spherical("T")], overhead)
    angles = {"T_azimuth": [0.1, 0.2, 0.3], "T_elevation": [1.0, 1.1, 0.9]}
    data = {"q1": [0.1, 0.0, 0.4], "q2": [0.2, 0.0, 0.1], "T_range": [0.5, 0.6, 0.7], **angles}
    noise, prior = lc.Noise({"*": 1e-4}), lc.Prior({"*": 0.1})
    with refused("outside-domain", "'T_azimuth'", "pose '2'") as error:
        lc.calibrate(mechanism, data, noise=noise, prior=prior, method="implicit-loop")
    assert "straight above it" in (error.value.remedy or "")

"""The structured model error: kinds and priors, sag, smooth discrepancy, gears and slides."""

from __future__ import annotations

import math
import pickle
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import ive

import loopcal as lc
from loopcal.files.machines.mechanism_file import mechanism_from_data, read_mechanism
from loopcal.files.machines.mechanism_writer import mechanism_to_toml
from loopcal.files.machines.urdf import urdf_machine
from loopcal.mechanisms.chain import Step, product
from loopcal.mechanisms.effects.effect import with_effects
from loopcal.mechanisms.effects.harmonics import Harmonics
from loopcal.mechanisms.instruments.contact import ball_bar, plane, socket, sphere
from loopcal.mechanisms.instruments.inclinometer import inclinometer
from loopcal.mechanisms.instruments.length import distance, draw_wire, relative_distance
from loopcal.mechanisms.instruments.point import point
from loopcal.mechanisms.instruments.pose import pose
from loopcal.mechanisms.instruments.spherical import spherical
from loopcal.mechanisms.machine import Instrument, Machine, assemble
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.model_error import with_model_error
from loopcal.mechanisms.parallel.delta import linear_delta
from loopcal.mechanisms.parallel.stewart_gough import stewart_gough
from loopcal.mechanisms.parallel.three_rrr import three_rrr
from loopcal.mechanisms.parameters import Parameter
from loopcal.mechanisms.planar import (
    motoman_joints,
    motoman_ma1400,
    planar_machine,
    planar_two_link,
)
from loopcal.mechanisms.serial import Joint, serial_machine
from loopcal.mechanisms.structure.smooth import FEATURES, harmonics
from loopcal.mechanisms.structure.structured import structured, unstated_mountings
from tests.reference.machines import MA1400_TOOL
from tests.reference.plain_tape import loop_values
from tests.refusals import refused

Array = NDArray[np.float64]
Numbers = Mapping[str, float]
TEMPLATE = Path(__file__).parents[2] / "src/loopcal/files/project/template_files/urdf/robot.urdf"
REFLECTOR = {"tool_x": 0.05, "tool_y": -0.02, "tool_z": 0.12}


def loops(mechanism: Mechanism, x: Numbers, /, **p: float) -> Array:
    values = {q.name: q.nominal for q in mechanism.parameters} | p
    assert values.keys() == {*mechanism.parameters.names}
    tape = mechanism.tape
    return loop_values(
        tape, [x[q] for q in tape.quantities], [values[n] for n in tape.parameters],
        [x[k] for k in tape.pose_constants],
    )  # fmt: skip


def readings(mechanism: Mechanism, seed: int = 1) -> dict[str, float]:
    rng = np.random.default_rng(seed)
    names = (*mechanism.quantities, *mechanism.pose_constants)
    return {q: float(v) for q, v in zip(names, rng.uniform(0.2, 1.5, len(names)), strict=True)}


def scara() -> Machine:
    return serial_machine(
        [Joint("q1"), Joint("q2"), Joint("q3", kind="prismatic"), Joint("q4")], name="SCARA"
    )


SCARA = {"d_1": 0.4, "a_1": 0.35, "a_2": 0.3, "alpha_2": math.pi}


def arms() -> dict[str, tuple[Mechanism, Sequence[Step], tuple[float, float, float], list[str]]]:
    """Arm, the steps ahead of which gravity is stated, gravity, and the tool's coordinates."""
    tool = list(REFLECTOR)
    urdf = assemble(urdf_machine(TEMPLATE, "base_link", "tool0"), [point()], REFLECTOR)
    flat = assemble(scara(), [point()], SCARA | REFLECTOR)
    gantry = serial_machine(
        [Joint("a", kind="prismatic"), Joint("b", kind="prismatic"), Joint("c"), Joint("d")]
    )
    turned = {"alpha_1": math.pi / 2, "alpha_2": 1.1, "a_3": 0.2, "alpha_3": 0.9, "a_4": 0.3}
    down, side = (0.0, 0.0, -1.0), (0.6, 0.0, 0.8)
    placed = {"x0": 0.7, "y0": -0.4, "phix0": 0.3, "phiy0": -0.2, "phiz1": 0.4, "z1": 0.9}
    arm = motoman_ma1400(MA1400_TOOL | placed)
    return {
        "MA1400": (arm, arm.chain[:4], down, ["x6B", "y6B", "z6B"]),
        "URDF": (urdf, (), down, tool),
        "SCARA": (flat, (), down, tool),
        "gantry": (assemble(gantry, [point()], turned | REFLECTOR), (), side, tool),
    }


def bent(
    arm: Mechanism, ahead: Sequence[Step], gravity: Sequence[float], tool: list[str],
    x: Numbers, parameter: str, c: float,
) -> Array:  # fmt: skip
    """The tool of an arm that truly turns about one of its axes, all frames as matrices."""
    p = {q.name: q.nominal for q in arm.parameters}
    where, axis, load = parameter.split("_sag_")[0], *parameter.split("_sag_")[1].split("_")
    moved = [i for i, step in enumerate(arm.chain) if step.joint]
    names = ["base", *(arm.chain[i].joint for i in moved)]
    ends = [len(ahead), *(i + 1 for i in moved)]
    frames = [product(arm.chain[:end], x, p) for end in ends]
    tip = (product(arm.chain, x, p) @ [*(p[t] for t in tool), 1.0])[:3]
    n = len(moved)
    at = {"elbow": (n + 1) // 2, "wrist": n - 1}.get(load)
    m = tip if at is None else frames[at][:3, 3]
    T = frames[names.index(where)]
    e, o = T[:3, "xyz".index(axis)], T[:3, 3]
    if len(ahead) and where in names[:2]:  # level with the second joint, the base below
        up, second, third = frames[1][:3, 2], frames[2][:3, 3], frames[3][:3, 3]
        o = o + up * float(up @ (second - o))
        o = o - up * float(np.linalg.norm(third - second)) * (where == "base")
    g = product(ahead, {}, p)[:3, :3] @ np.array(gravity)
    angle = c * float(e @ np.cross(m - o, g))
    r = tip - o
    turned = r * math.cos(angle) + np.cross(e, r) * math.sin(angle)
    bent_tip: Array = o + turned + e * (e @ r) * (1.0 - math.cos(angle))
    return bent_tip


@pytest.mark.parametrize("name", ["MA1400", "URDF", "SCARA", "gantry"])
def test_every_column_of_sag_turns_the_arm_where_it_gives_way(name: str) -> None:
    arm, ahead, gravity, tool = arms()[name]
    made = structured(arm.with_gravity(gravity))
    columns = [n for n in made.effects["structure"] if "_sag_" in n]
    assert len(columns) > 8
    step = 1e-6
    for parameter in columns:
        for seed in (1, 2):
            x = readings(made, seed)
            own = (loops(made, x, **{parameter: step}) - loops(made, x)) / step
            if name != "MA1400":  # seen from a station, which stands at zero
                assert made.parameters["base_rx"].nominal == 0.0
            both = [bent(arm, ahead, gravity, tool, x, parameter, c) for c in (step, -step)]
            assert own == pytest.approx((both[0] - both[1]) / (2 * step), abs=2e-9)


@pytest.mark.parametrize("name", ["MA1400", "URDF", "SCARA", "gantry"])
def test_columns_that_do_nothing_or_the_same_are_left_out(name: str) -> None:
    arm, _, gravity, _ = arms()[name]
    made = structured(arm.with_gravity(gravity))
    columns = [n for n in made.effects["structure"] if "_sag_" in n]
    made = made.with_nominal(dict.fromkeys(("gravity_tilt_1", "gravity_tilt_2"), 0.05))
    poses = [readings(made, seed) for seed in range(8)]
    still = [loops(made, x) for x in poses]
    change = np.array(
        [
            np.concatenate(
                [loops(made, x, **{n: 1.0}) - f for x, f in zip(poses, still, strict=True)]
            )
            for n in columns
        ]
    )
    size = np.linalg.norm(change, axis=1)
    assert size.min() > 1e-6
    if name == "MA1400":  # some depend on where it stands
        return
    alike = np.abs(change @ change.T / np.outer(size, size)) - np.eye(len(columns))
    same = np.abs(size[:, None] / size - 1.0) < 1e-9
    assert alike[same].max() < 1.0 - 1e-9


def test_a_tilt_of_gravity_turns_its_direction() -> None:
    arm, _, _, _ = arms()["URDF"]
    x = readings(arm)
    made, tilted = structured(arm), structured(arm.with_gravity((0.0, 0.6, -0.8)))
    assert made.parameters["gravity_tilt_1"].prior_sd == pytest.approx(math.radians(5.0))
    given = dict.fromkeys([n for n in made.parameters.names if n.endswith("_sag_y_tool")], 1e-3)
    angle = math.asin(0.6)
    turned = [
        loops(made, x, **given, **{f"gravity_tilt_{i}": sign * angle})
        for i in (1, 2)
        for sign in (1, -1)
    ]
    other = loops(tilted, x, **given)
    assert min(np.abs(found - other).max() for found in turned) < 1e-12


@cache
def machines() -> dict[str, Mechanism]:
    """Every instrument, on arms, parallel machines and machines in a plane."""

    def on(machine: Machine, *looking: Instrument, **nominal: float) -> Mechanism:
        return assemble(machine, looking, nominal)

    arm = urdf_machine(TEMPLATE, "base_link", "tool0")
    three = [point(f"p{i}", readings=[f"{a}{i}" for a in "xyz"], target=f"ball_{i}") for i in "123"]
    return {
        "point": on(arm, point(), **REFLECTOR),
        "three points": on(arm, *three),
        "pose": on(arm, pose()),
        "spherical": on(arm, spherical(offsets=True)),
        "wire": on(arm, draw_wire()),
        "distance": on(arm, distance()),
        "two poses": on(arm, relative_distance()),
        "sphere": on(arm, sphere()),
        "bar": on(arm, ball_bar()),
        "plane": on(arm, plane()),
        "socket": on(arm, socket()),
        "level": on(arm, point(), inclinometer()),
        "level of the base": on(arm, point(), inclinometer(on="base")),
        "MA1400": motoman_ma1400(),
        "planar": planar_two_link(),
        "planar arm": on(planar_machine(), distance(dimension=2)),
        "hexapod": on(stewart_gough(), pose()),
        "delta": on(linear_delta(), point()),
        "3-RRR": on(three_rrr(), pose(dimension=2)),
    }


@pytest.mark.parametrize("name", machines())
def test_structure_at_zero_leaves_the_loops_as_they_were(name: str) -> None:
    plain = machines()[name]
    made = structured(plain, discrepancy=True)
    x = readings(plain)
    assert loops(made, x) == pytest.approx(loops(plain, x), abs=1e-15)
    assert made.parameters.names[: len(plain.parameters)] == plain.parameters.names
    added = made.effects["structure"]
    assert made.parameters.names == (*plain.parameters.names, *added)
    assert all(made.parameters[n].nominal == 0.0 for n in added)
    assert structured(made) is made


@pytest.mark.parametrize("name", machines())
def test_every_added_parameter_has_a_finite_prior_and_moves_a_loop(name: str) -> None:
    plain = machines()[name]
    targets = {
        p.name: 0.1 + 0.02 * i
        for i, p in enumerate(plain.parameters)
        if p.role in ("mounting", "placement")
    }
    made = structured(plain.with_nominal(targets), discrepancy=True)
    x = readings(plain)
    added = made.effects["structure"]
    assert added
    assert all(math.isfinite(made.parameters[n].prior_sd) for n in added)
    learnt = {n for term in made.terms for n in term.parameters}
    assert {n for n in added if n not in learnt} <= {"gravity_tilt_1", "gravity_tilt_2"}
    terms = [t.parameters for t in made.terms if t.parameters[0] in added]
    tilted = {n: 0.05 for n in added if "tilt" in n}
    for n in [names[i] for names in terms for i in (0, len(names) // 2, -1)]:
        change = loops(made, x, **tilted, **{n: 1e-2}) - loops(made, x, **tilted)
        assert np.abs(change).max() > 0.0, n


def test_roles_are_what_parameters_say() -> None:
    all_of = machines()
    roles = all_of["spherical"].roles
    assert roles["tracker_x"] == roles["tracker_rx"] == "placement"
    assert roles["tracker_range_offset"] == "placement"
    assert roles["tool_x"] == "mounting"
    assert roles["joint_2_x"] == "length"
    assert roles["joint_2_ry"] == "zero"
    assert roles["joint_2_rz"] == "twist"
    assert all_of["pose"].roles["tool_rx"] == "mounting"
    assert {all_of["wire"].roles[n] for n in ("wire_x", "wire_offset")} == {"placement"}
    assert all_of["bar"].roles["bar_length"] == "placement"
    assert all_of["level"].roles["level_rx"] == "mounting"
    assert all_of["level of the base"].roles["level_rx"] == "placement"
    assert all_of["MA1400"].roles["z1"] == all_of["MA1400"].roles["phix0"] == "placement"
    assert all_of["MA1400"].roles["x6B"] == "mounting"
    assert all_of["planar"].roles == {
        "xA": "placement", "yA": "placement", "phi20": "placement",
        "l2": "length", "l3": "length", "phi30": "zero",
    }  # fmt: skip
    assert with_effects(all_of["MA1400"], [Harmonics()]).roles["theta_1_cos1"] == "effect"
    own = Mechanism.from_function(
        lambda x, p: [p.a + p.b * x.u + p.c], {"u": "rad"},
        {"a": (1.0, "m"), "b": (1.0, "m"), "c": (0.0, "m")},
    )  # fmt: skip
    assert own.roles == dict.fromkeys("abc", "length")


def test_priors_follow_the_roles_and_stated_ones_stay() -> None:
    arm = assemble(
        urdf_machine(TEMPLATE, "base_link", "tool0"),
        [point()],
        REFLECTOR | {"joint_2_x": Parameter("joint_2_x", 0.15, "m", 2e-4)},
    )
    arm = arm.with_parameters(arm.parameters.with_fixed(["joint_3_*"]))
    made = structured(arm)
    assert made.parameters["base_x"].prior_sd == math.inf
    assert made.parameters["tool_z"].prior_sd == 5e-3
    assert made.parameters["joint_2_x"].prior_sd == 2e-4
    lengths, zeros, twists = made.terms[:3]
    assert [(t.name, t.sd) for t in made.terms[:3]] == [
        ("lengths", 1e-3),
        ("zeros", 3e-3),
        ("twists", 1e-3),
    ]
    assert {made.parameters[n].role for n in zeros.parameters} == {"zero"}
    assert "joint_2_x" not in lengths.parameters
    geometry = (*lengths.parameters, *zeros.parameters, *twists.parameters)
    assert not any(n.startswith("joint_3") for n in geometry)
    assert {made.parameters[n].unit for n in lengths.parameters} == {"m"}
    turned = structured(assemble(stewart_gough(), [pose()], {"tool_z": 0.1}))
    assert turned.parameters["tool_rx"].prior_sd == 50e-3


def test_a_mounting_that_nobody_stated_stays_flat() -> None:
    unknown = assemble(urdf_machine(TEMPLATE, "base_link", "tool0"), [pose()])
    names = tuple(f"tool_{m}" for m in ("x", "y", "z", "rz", "ry", "rx"))
    assert unstated_mountings(unknown) == (names,)
    assert structured(unknown).parameters["tool_x"].prior_sd == math.inf
    stated = unknown.with_nominal({"tool_z": 0.1})
    assert unstated_mountings(stated) == ()
    assert structured(stated).parameters["tool_x"].prior_sd == 5e-3


def test_points_of_one_body_share_its_displacement() -> None:
    """Three balls keep their distances, to second order, whatever sags or remains."""
    nominal = {"ball_1_x": 0.1, "ball_2_y": 0.12, "ball_3_z": 0.15}
    plain = machines()["three points"].with_nominal(nominal)
    made = structured(plain, discrepancy=True)
    assert [t.name for t in made.terms][-3:] == ["discrepancy", "discrepancy_turns", "harmonics"]
    x = readings(plain) | dict.fromkeys(plain.outputs, 0.0)
    rng = np.random.default_rng(3)
    added = [n for n in made.effects["structure"] if "sag" in n or "discrepancy" in n]
    errors = {n: 1e-5 * rng.normal() for n in added}
    before, after = (loops(made, x, **p).reshape(3, 3) for p in ({}, errors))
    assert np.abs(after - before).max() > 2e-5
    turn = np.abs((after - before) - (after - before)[0]).max()
    assert turn > 1e-6
    for i, j in ((0, 1), (0, 2), (1, 2)):
        lengths = [np.linalg.norm(balls[i] - balls[j]) for balls in (before, after)]
        assert lengths[1] == pytest.approx(lengths[0], abs=1e-8)


def test_orientations_turn_with_the_body() -> None:
    """A pose and a point on one body: the turn seen is that which moves the point."""
    arm = assemble(
        urdf_machine(TEMPLATE, "base_link", "tool0"),
        [pose(), point("far", readings=("u", "v", "w"), target="far")],
        {"far_x": 0.4, "tool_z": 1e-9},
    )
    made = structured(arm)
    x = readings(arm) | {"qw": 1.0, "qx": 0.0, "qy": 0.0, "qz": 0.0}
    name, c = "joint_2_sag_y_tool", 1e-6
    change = (loops(made, x, **{name: c}) - loops(made, x, **{name: -c})) / (2 * c)
    p = {q.name: q.nominal for q in arm.parameters}
    R = product(arm.chain, x, p)[:3, :3]
    turn = product(arm.chain[:12], x, p)[:3, 1]  # whatever its size, about this axis
    moved = change[6:9] - change[:3]
    lever = float(np.linalg.norm(moved) / np.linalg.norm(np.cross(turn, R @ [0.4, 0.0, 0.0])))
    assert np.abs(np.cross(lever * turn, R @ [0.4, 0.0, 0.0])) == pytest.approx(np.abs(moved))


def test_the_smooth_features_are_those_of_largest_weight() -> None:
    scales = (1.0, 1.0, 1.0, 3.0, 3.0, 3.0)
    grid = np.stack(np.meshgrid(*[np.arange(-4, 5)] * 3, *[np.arange(-1, 2)] * 3), -1).reshape(
        -1, 6
    )
    z = 1.0 / np.square(scales)
    weights = np.prod(ive(np.abs(grid), z), axis=1)
    weights = np.sort(weights[np.any(grid != 0, axis=1)])[::-1]
    found = harmonics(scales)
    assert len({h.orders for h in found}) == 30
    assert not {tuple(-k for k in h.orders) for h in found} & {h.orders for h in found}
    squares = np.array([h.amplitude**2 for h in found])
    assert squares == pytest.approx(weights[:60:2] / weights[:60:2].sum(), rel=1e-12)
    assert squares.sum() == pytest.approx(1.0)
    assert [h.orders for h in harmonics((1.0,), 3)] == [(1,), (2,), (3,)]


def test_a_discrepancy_has_the_sd_of_its_coefficients_in_every_pose() -> None:
    made = structured(motoman_ma1400(), sag=False, harmonics=False, discrepancy=True)
    (names,) = (t.parameters for t in made.terms if t.name == "discrepancy")
    for seed in (1, 2):
        x = readings(made, seed)
        still = loops(made, x)
        columns = np.array([loops(made, x, **{n: 1.0}) - still for n in names])
        assert columns.T @ columns == pytest.approx(np.eye(3), abs=1e-12)


def test_structured_mechanisms_travel_to_workers() -> None:
    made = structured(machines()["pose"], discrepancy=True)
    assert pickle.loads(pickle.dumps(made)) == made
    plain = pickle.loads(pickle.dumps(machines()["pose"]))
    assert structured(plain, discrepancy=True) == made


def test_gravity_needs_a_direction() -> None:
    with refused("invalid-value", "gravity"):
        motoman_ma1400().with_gravity((0.0, 0.0, 0.0))


def test_sag_that_an_arm_cannot_have_is_refused() -> None:
    with refused("unknown-name", "theta_6_sag_x_tool"):
        structured(motoman_ma1400(), sag=("theta_6_sag_x_tool",))
    with refused("unsupported", "theta_1_sag_x_tool"):
        structured(planar_two_link(), sag=("theta_1_sag_x_tool",))


def test_effects_stated_by_the_user_are_not_added_again() -> None:
    arm = with_effects(motoman_ma1400(), [Harmonics(("theta_2",), (1.0,))])
    made = structured(arm)
    (names,) = (t.parameters for t in made.terms if t.name == "harmonics")
    assert len(names) == 20
    assert made.parameters["theta_2_cos1"].prior_sd == arm.parameters["theta_2_cos1"].prior_sd
    assert made.effects.keys() == {"harmonics", "structure"}


@pytest.mark.parametrize("name", ["MA1400", "URDF, mounted anywhere", "delta", "planar"])
def test_a_file_gives_back_the_structured_mechanism(name: str, tmp_path: Path) -> None:
    anywhere = assemble(urdf_machine(TEMPLATE, "base_link", "tool0"), [pose()])
    plain = {"URDF, mounted anywhere": anywhere.with_gravity((0.0, 0.0, 1.0)), **machines()}[name]
    made = structured(plain, discrepancy=True)
    rng = np.random.default_rng(5)
    moved = made.with_nominal({p.name: p.nominal + 1e-3 * rng.normal() for p in made.parameters})
    moved = moved.with_parameters(moved.parameters.with_fixed([moved.terms[0].parameters[0]]))
    path = tmp_path / "mechanism.toml"
    path.write_text(mechanism_to_toml(moved), "utf-8")
    again = read_mechanism(path)
    x = readings(made)
    assert list(loops(again, x)) == list(loops(moved, x))
    assert [p.name for p in again.parameters] == [p.name for p in moved.parameters]
    assert [p.fixed for p in again.parameters] == [p.fixed for p in moved.parameters]
    assert [t.name for t in again.terms] == [t.name for t in moved.terms]
    assert again.terms[1:] == moved.terms[1:]
    assert again.gravity == moved.gravity
    sds = {p.name: p.prior_sd for p in moved.parameters if p.name != moved.terms[0].parameters[0]}
    assert {n: again.parameters[n].prior_sd for n in sds} == sds
    assert mechanism_to_toml(again) == mechanism_to_toml(read_mechanism(path))


def test_a_file_states_gravity_and_the_model_error(tmp_path: Path) -> None:
    path = tmp_path / "arm.toml"
    path.write_text(
        'schema = 1\ntype = "motoman-ma1400"\ngravity = [0, 0, 2]\n[structure]\n'
        'sag = ["theta_2_*_tool"]\nharmonics = false\n[parameters]\nz2 = { sd = 1e-4 }\n',
        "utf-8",
    )
    made = read_mechanism(path)
    assert made.gravity == (0.0, 0.0, 2.0)
    assert [n for n in made.effects["structure"] if "sag" in n] == [
        f"theta_2_sag_{axis}_tool" for axis in "xyz"
    ]
    assert made.parameters["z2"].prior_sd == 1e-4
    assert "z2" not in made.terms[0].parameters
    path.write_text('schema = 1\ntype = "motoman-ma1400"\ngravity = [0, 0, 0]\n', "utf-8")
    with refused("invalid-value", "gravity"):
        read_mechanism(path)


def test_loops_of_ones_own_are_returned_as_they_are() -> None:
    own = Mechanism.from_function(
        lambda x, p: [p.a + x.u - x.v], {"u": "m", "v": "m"}, {"a": (1.0, "m")}
    )
    assert structured(own) is own


def test_a_disturbed_mechanism_is_structured_alike() -> None:
    plain = motoman_ma1400()
    made, other = with_model_error(structured(plain)), structured(with_model_error(plain))
    x = readings(other)
    errors = dict.fromkeys(made.effects["structure"], 1e-4)
    assert loops(made, x, **errors) == pytest.approx(loops(other, x, **errors), abs=1e-15)


def test_how_an_arm_stands_does_not_change_how_it_sags() -> None:
    """Moved rigidly, the MA1400 sags along its own first axis, as much as before."""
    plain = motoman_ma1400(MA1400_TOOL)
    made = structured(plain)
    R = product([Step("rx", constant=0.4), Step("rz", constant=1.1)], {}, {})[:3, :3]
    assert made.placement is not None
    values = {p.name: p.nominal for p in plain.parameters}
    moved = made.placement.moved(values, R, np.array([0.2, -0.5, 0.7]))
    x = readings(made)
    (own,) = (t.parameters for t in made.terms if t.name == "sag")
    across = [[f"{where}_sag_{a}_tool" for a in "xy"] for where in ("base", "theta_1")]
    for names in ([n] for n in own), across:
        for errors in (dict.fromkeys(its, 1e-4) for its in names):
            here = loops(made, x, **values, **errors) - loops(made, x, **values)
            there = loops(made, x, **moved, **errors) - loops(made, x, **moved)
            assert np.abs(here).max() > 1e-7
            assert there == pytest.approx(R @ here, abs=1e-12)


def test_features_without_weight_are_left_out() -> None:
    for scales in ((1.0,), (1.0, 1.0), (3.0,)):
        found = harmonics(scales)
        assert 0 < len(found) <= FEATURES
        assert sum(h.amplitude**2 for h in found) == pytest.approx(1.0)


def test_an_arm_of_transitions_sags_alike_seen_by_one_instrument_or_by_two() -> None:
    """Gravity is stated in the arm's own base, which its transitions place."""
    joints = [{"name": j.name, "form": j.form, "direction": j.direction} for j in motoman_joints()]
    second = {"name": "second", "readings": ["x_2", "y_2", "z_2"], "target": ["a_x", "a_y", "a_z"]}
    first = {"readings": ["x", "y", "z"], "target": ["x6B", "y6B", "z6B"]}
    seen = [{"type": "point", "station": False, **one} for one in (first, second)]
    data = {"type": "serial", "joint": joints, "fix_redundant": False, "instrument": seen}
    single = mechanism_from_data({"type": "motoman-ma1400"}, "one")
    drawn = {p.name: p.nominal for p in single.parameters}
    rng = np.random.default_rng(0)
    q = {joint["name"]: rng.uniform(-1.0, 1.0, 10) for joint in joints}
    arms = [structured(m) for m in (single, mechanism_from_data(data, "two").with_nominal(drawn))]
    more = [n for n in arms[0].parameters.names if n not in drawn]
    truth = dict(zip(more, 1e-3 * rng.standard_normal(len(more)), strict=True))
    made = [
        lc.simulate(
            arm,
            q,
            noise={"*": 0.0},
            seed=0,
            truth={p.name: p.nominal for p in arm.parameters} | truth,
        )
        for arm in arms
    ]
    for axis in "xyz":
        assert made[1].dataset[axis] == pytest.approx(made[0].dataset[axis], abs=1e-12)

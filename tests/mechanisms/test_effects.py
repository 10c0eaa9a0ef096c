"""Effects beyond geometry: what they change, what gravity does, and what they refuse."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from analyses.instruments import ARM_VALUES, six_axis
from loopcal.errors import Code
from loopcal.mechanisms.chain import Step, product
from loopcal.mechanisms.effects.backlash import Backlash
from loopcal.mechanisms.effects.compliance import Compliance
from loopcal.mechanisms.effects.drift import Drift, Shift
from loopcal.mechanisms.effects.effect import Effect, with_effects
from loopcal.mechanisms.effects.gravity import ACCELERATION, Load, end_of, unit_forces
from loopcal.mechanisms.effects.harmonics import Harmonics
from loopcal.mechanisms.effects.scale import Scale
from loopcal.mechanisms.exponentials import ScrewJoint, exponentials
from loopcal.mechanisms.instruments.length import draw_wire, relative_distance
from loopcal.mechanisms.instruments.point import point
from loopcal.mechanisms.machine import assemble
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parallel.stewart_gough import stewart_gough
from loopcal.mechanisms.planar import motoman_ma1400, planar_two_link
from loopcal.mechanisms.serial import Joint, serial_machine
from loopcal.mechanisms.structure.structured import structured
from tests.reference.machines import MA1400_TOOL, dh_arm, mixed_arm
from tests.reference.plain_tape import difference, loop_values
from tests.refusals import refused

Array = NDArray[np.float64]
WRIST, ELBOW = Load("wrist", "theta_5"), Load("elbow", "theta_3", (0.1, 0.0, -0.2))


def arm() -> Mechanism:
    return motoman_ma1400(MA1400_TOOL)


def loops(
    mechanism: Mechanism,
    x: Mapping[str, float],
    known: Mapping[str, float] | None = None,
    /,
    **p: float,
) -> Array:
    values = {q.name: q.nominal for q in mechanism.parameters} | p
    assert values.keys() == {*mechanism.parameters.names}
    return loop_values(
        mechanism.tape,
        [x[q] for q in mechanism.tape.quantities],
        [values[name] for name in mechanism.tape.parameters],
        [(known or {})[name] for name in mechanism.tape.pose_constants],
    )


def readings(mechanism: Mechanism, seed: int = 1) -> dict[str, float]:
    rng = np.random.default_rng(seed)
    return {q: float(v) for q, v in zip(mechanism.quantities, rng.uniform(-2, 2, 9), strict=False)}


EVERY: list[Effect] = [
    Harmonics(),
    Scale(),
    Compliance((WRIST, ELBOW)),
    Backlash(),
    Drift(("?6B", "phi*")),
    Shift(("?6B",), (14.0, 86.0)),
]


def test_effects_at_zero_leave_a_mechanism_as_it_was() -> None:
    plain, changed = arm(), with_effects(arm(), EVERY)
    x, known = readings(plain), dict.fromkeys(changed.pose_constants, 0.7)
    assert loops(changed, x, known) == pytest.approx(loops(plain, x), abs=1e-15)
    names = [name for own in changed.effects.values() for name in own]
    assert changed.parameters.names == (*plain.parameters.names, *names)
    for name in names:
        assert changed.parameters[name].nominal == 0.0
        assert np.isfinite(changed.parameters[name].prior_sd)


def test_harmonics_turn_a_joint_by_their_sum() -> None:
    plain, x = arm(), readings(arm())
    changed = with_effects(plain, [Harmonics(("theta_2",), (1, 2, 0.5))])
    amplitudes = {"theta_2_cos1": 0.1, "theta_2_sin2": -0.2, "theta_2_cos0.5": 0.3}
    t = x["theta_2"]
    turned = t + 0.1 * np.cos(t) - 0.2 * np.sin(2 * t) + 0.3 * np.cos(t / 2)
    assert loops(changed, x, **amplitudes) == pytest.approx(loops(plain, x | {"theta_2": turned}))


def test_scale_and_backlash_follow_one_another() -> None:
    plain, x = arm(), readings(arm())
    changed = with_effects(plain, [Scale(("theta_1",)), Backlash(("theta_[12]",), "d_{joint}")])
    p = {"theta_1_scale": 0.01, "theta_1_backlash": 0.2, "theta_2_backlash": 0.3}
    moved = {
        "theta_1": x["theta_1"] * 1.01 - 0.2,
        "theta_2": x["theta_2"] + 0.3,
    }
    known = {"d_theta_1": 1.0, "d_theta_2": -1.0}
    assert loops(changed, x, known, **p) == pytest.approx(loops(plain, x | moved))


def test_a_length_that_an_instrument_reads_has_a_scale_where_it_is_named() -> None:
    plain = assemble(six_axis(), [draw_wire("wire")], ARM_VALUES)
    x = readings(plain) | {"wire": 1.2}
    scaled = with_effects(plain, [Scale(("wire",))])
    assert loops(scaled, x, wire_scale=0.02) == pytest.approx(
        loops(plain, x | {"wire": 1.2 * 1.02})
    )
    assert "wire_scale" not in with_effects(plain, [Scale()]).parameters.names


def test_a_drift_and_shifts_move_parameters_with_their_column() -> None:
    plain, x = arm(), readings(arm())
    changed = with_effects(
        plain,
        [Drift(("x6B",), "t", "s", since=10.0, over=60.0), Shift(("x6B", "phix0"), (14, 86))],
    )
    p = {"x6B_drift": 0.006, "x6B_from14": 0.1, "x6B_from86": 0.2, "phix0_from86": 0.3}
    nominal = plain.parameters["x6B"].nominal
    for pose, shifted, tilt in ((13.0, 0.0, 0.0), (14.0, 0.1, 0.0), (86.0, 0.2, 0.3)):
        there = {"x6B": nominal + 0.003 + shifted, "phix0": tilt}
        found = loops(changed, x, {"t": 40.0, "pose": pose}, **p)
        assert found == pytest.approx(loops(plain, x, **there))


@pytest.mark.parametrize(("changing", "what"), [(("x6B",), "x6B"), (("lengths",), "lengths")])
def test_the_bends_of_a_drift_follow_chebyshev_and_vanish_at_both_ends(
    changing: tuple[str, ...], what: str
) -> None:
    plain, x = arm(), readings(arm())
    drift = Drift(changing, "t", "s", since=10.0, over=60.0, until=70.0, bends=3)
    changed = with_effects(plain, [drift])
    assert changed.effects["drift"] == tuple(f"{what}_drift{k}" for k in ("", 1, 2, 3))
    bends = np.array([0.01, -0.02, 0.03])
    p = {f"{what}_drift": 0.006} | {f"{what}_drift{k + 1}": float(b) for k, b in enumerate(bends)}
    nominal = {q.name: q.nominal for q in plain.parameters if q.dimension == "length"}
    for t, bent in ((10.0, 0.0), (22.0, 1.0), (55.0, 1.0), (70.0, 0.0), (99.0, 0.0)):
        s = min((t - 10.0) / 60.0, 1.0)
        curve = 4.0 * s * (1.0 - s) * np.polynomial.chebyshev.chebval(2.0 * s - 1.0, bends)
        assert (curve != 0.0) == bool(bent) or abs(curve) < 1e-15
        change = 0.006 * s + float(curve)
        grown = {name: value * (1.0 + change) for name, value in nominal.items()}
        moved = {"x6B": plain.parameters["x6B"].nominal + change} if what == "x6B" else grown
        assert loops(changed, x, {"t": t}, **p) == pytest.approx(loops(plain, x, **moved))


def test_by_default_it_is_the_station_that_drifts() -> None:
    plain, x = dh_arm(), readings(dh_arm())
    changed = with_effects(plain, [Drift(over=2.0)])
    there = {"base_x": plain.parameters["base_x"].nominal + 0.1}
    found = loops(changed, x, {"t": 1.0}, base_x_drift=0.2)
    assert found == pytest.approx(loops(plain, x, **there))
    assert len(changed.effects["drift"]) == 6


def test_the_legs_of_a_platform_have_scales_as_joints_have() -> None:
    platform = assemble(stewart_gough(), [point(station=None)])
    changed = with_effects(platform, [Scale(("leg_*",))])
    assert len(changed.effects["scale"]) == 6
    x = {q: 0.1 * (i + 1) for i, q in enumerate(platform.quantities)}
    found = loops(changed, x, leg_2_scale=0.01)
    assert found == pytest.approx(loops(platform, x | {"leg_2": 1.01 * x["leg_2"]}))


def test_segments_of_large_numbers_keep_their_own_parameters() -> None:
    changed = with_effects(arm(), [Shift(("x6B",), (1234567.0, 1234568.0), "second", "s")])
    assert changed.effects["shift"] == ("x6B_from1234567", "x6B_from1234568")


def potential(
    chain: tuple[Step, ...], load: Load, down: Array, x: Mapping[str, float], p: Mapping[str, float]
) -> float:
    """down . r [m]: what gravity gains per weight, from 4x4 matrices."""
    T = product(chain[: end_of(chain, load)], x, p)
    return float(down @ (T @ [*load.point, 1.0])[:3])


def exponential_arm() -> Mechanism:
    joints = [
        ScrewJoint("q1", (0.0, 0.6, 0.8), (0.1, 0.0, 0.2)),
        ScrewJoint("q2", (1.0, 0.0, 0.0), (0.0, 0.3, 0.1), kind="prismatic"),
        ScrewJoint("q3", (0.0, 0.0, -1.0), (0.4, 0.3, 0.1)),
    ]
    machine = exponentials(joints, home=((0.5, 0.1, 0.2), (0.1, 0.2, 0.3)))
    return assemble(machine, [point()])


@pytest.mark.parametrize("make", [dh_arm, mixed_arm, arm, exponential_arm])
def test_gravity_acts_as_the_gradient_of_its_potential(make: object) -> None:
    mechanism: Mechanism = make()  # type: ignore[operator]
    chain, x = mechanism.chain, readings(mechanism)
    rng = np.random.default_rng(3)
    p = {q.name: q.nominal + rng.normal(0, 0.1) for q in mechanism.parameters}
    joints = [q for q in x if any(step.joint == q for step in chain)]
    load = Load("there", joints[-1], (0.1, -0.2, 0.3))
    down = np.array([0.2, -0.3, -0.9])
    down /= np.linalg.norm(down)
    movers = dict.fromkeys(n for s in chain for n in (s.joint, s.parameter) if n)
    forces = unit_forces(chain, list(movers), load, list(down), x, p)
    for name, force in forces.items():
        whose = x if name in x else p

        def energy(value: float, name: str = name, whose: Mapping[str, float] = whose) -> float:
            moved = {**whose, name: value}
            pair = (moved, p) if whose is x else (x, moved)
            return potential(chain, load, down, *pair)

        assert force == pytest.approx(difference(energy, whose[name], 1e-2), abs=1e-12)


def test_known_masses_and_lumps_are_one_law() -> None:
    plain, x = arm(), readings(arm())
    masses = (Load("wrist", "theta_5", mass=20.0), Load("elbow", "theta_3", ELBOW.point, 60.0))
    known = with_effects(plain, [Compliance(masses, ("theta_2", "phiy0"))])
    lumped = with_effects(plain, [Compliance((WRIST, ELBOW), ("theta_2", "phiy0"))])
    c = {"theta_2": 3e-6, "phiy0": 2e-6}
    products = {
        f"{name}_sag_{load.name}": c[name] * load.mass * ACCELERATION
        for name in c
        for load in masses
        if load.mass
    }
    found = loops(known, x, **{f"{name}_yield": v for name, v in c.items()})
    assert found == pytest.approx(loops(lumped, x, **products), rel=1e-12)
    assert not np.allclose(found, loops(plain, x), atol=1e-5)


def test_a_level_link_sags_by_its_lever() -> None:
    machine = motoman_ma1400({"z1": 0.0, "z2": 0.0, "x1": 0.0, "z3": 0.0, "x4": 0.5, "x5": 0.0})
    drive = with_effects(machine, [Compliance((Load("hand", "theta_5"),), ("theta_2",))])
    x = dict.fromkeys(machine.quantities, 0.0)
    level = loops(machine, x)
    sagged = loops(drive, x, theta_2_sag_hand=1e-3)
    # the lever is 0.5 m, and about y a positive turn lowers what is ahead
    down = loops(machine, x | {"theta_2": 0.5e-3})
    assert sagged == pytest.approx(down, abs=1e-12)
    assert sagged[2] < level[2]


def test_turning_base_and_gravity_together_changes_nothing_inside_the_arm() -> None:
    upright, x = dh_arm(), readings(dh_arm())
    p = dict.fromkeys(("q2_sag_hand", "q3_sag_hand"), 0.001)
    hand = Load("hand", "q6", (0.1, 0.0, 0.2))
    one = with_effects(upright, [Compliance((hand,), ("q2", "q3"))])
    # gravity along -x of the base, and all joints behind the first as they were: another sag
    other = with_effects(upright, [Compliance((hand,), ("q2", "q3"), gravity=(-2.0, 0.0, 0.0))])
    assert not np.allclose(loops(one, x, **p), loops(other, x, **p), atol=1e-6)
    scaled = with_effects(upright, [Compliance((hand,), ("q2", "q3"), gravity=(0.0, 0.0, -5.0))])
    assert loops(one, x, **p) == pytest.approx(loops(scaled, x, **p), abs=1e-15)


def test_a_load_on_an_axis_of_its_own_weighs_nothing_on_it() -> None:
    changed = with_effects(arm(), [Compliance((WRIST,))])
    assert changed.parameters.names[27:] == tuple(f"theta_{i}_sag_wrist" for i in (1, 2, 3, 4))


def test_both_poses_of_a_row_are_changed() -> None:
    plain = assemble(
        serial_machine([Joint("q1"), Joint("q2")]),
        [relative_distance()],
        {"a_1": 0.5, "a_2": 0.4, "tool_x": 0.1},
    )
    changed = with_effects(plain, [Scale(("q1",)), Backlash(("q2",))])
    assert changed.parameters.names[-2:] == ("q1_scale", "q2_backlash")
    x = readings(plain)
    moved = x | {"q1": 1.1 * x["q1"], "q1_b": 1.1 * x["q1_b"], "q2_b": x["q2_b"] - 0.2}
    found = loops(
        changed, x, {"q2_direction": 0.0, "q2_direction_b": 1.0}, q1_scale=0.1, q2_backlash=0.2
    )
    assert found == pytest.approx(loops(plain, moved))
    with refused("unsupported", "'drift'"):
        with_effects(plain, [Drift(("tool_*",))])


@pytest.mark.parametrize(
    ("effect", "code", "stated"),
    [
        (lambda: Harmonics(orders=(0,)), "invalid-value", ("orders",)),
        (lambda: Harmonics(orders=(1, 1 + 1e-14)), "duplicate-name", ("twice",)),
        (lambda: Harmonics(("theta_7",)), "unknown-name", ("theta_7",)),
        (lambda: Harmonics(("x",)), "unknown-name", ("'x'",)),
        (lambda: Drift(("base_*",)), "unknown-name", ("base_",)),
        (lambda: Drift(over=0.0), "invalid-value", ("0", "'drift'")),
        (lambda: Drift(bends=9), "invalid-value", ("9", "'drift'")),
        (lambda: Shift(("x6B",), ()), "invalid-value", ("shifts",)),
        (lambda: Shift(("x6B",), (3, 3)), "invalid-value", ("shifts",)),
        (lambda: Backlash(direction="d"), "duplicate-name", ("'d'",)),
        (lambda: Compliance(()), "duplicate-name", ("loads",)),
        (lambda: Compliance((WRIST, WRIST)), "duplicate-name", ("loads",)),
        (
            lambda: Compliance((WRIST, Load("hand", "theta_6", mass=2.0))),
            "conflicting-keys",
            ("'compliance'",),
        ),
        (lambda: Compliance((Load("hand", "theta_9"),)), "unknown-name", ("theta_9",)),
        (lambda: Compliance((WRIST,), ("elbow",)), "unknown-name", ("elbow",)),
        (lambda: Compliance((WRIST,), gravity=(0.0, 0.0, 0.0)), "invalid-value", ("gravity",)),
        (lambda: Load("hand", "theta_6", mass=-1.0), "invalid-value", ("mass",)),
        (
            lambda: Compliance((Load("hand", "theta_5", (150.0, 0.0, 0.0)),)),
            "implausible-readings",
            ("'hand'",),
        ),
        (
            lambda: Compliance((Load("hand", "theta_5", (9e9, 0.0, 0.0)),)),
            "implausible-readings",
            ("'hand'",),
        ),
    ],
)
def test_what_cannot_be_is_refused(effect: object, code: Code, stated: tuple[str, ...]) -> None:
    with refused(code, *stated) as error:
        with_effects(arm(), [effect()])  # type: ignore[operator]
    assert error.value.remedy


def test_two_effects_may_not_share_a_name_or_a_parameter() -> None:
    with refused("duplicate-name"):
        with_effects(arm(), [Scale(), Scale()])
    with refused("duplicate-name", "theta_1_scale"):
        with_effects(arm(), [Scale(), Scale(name="again")])
    with refused("unsupported", "'planar two-link arm'"):
        with_effects(planar_two_link(), [Compliance((WRIST,))])


def test_effects_added_one_by_one_are_those_added_together() -> None:
    first: Effect = Scale(("theta_1",))
    steps = [Harmonics(("theta_1",)), first]
    together = with_effects(arm(), steps)
    assert [e["name"] for e in (together.description or {})["effect"]] == ["harmonics", "scale"]
    assert list(together.effects) == ["harmonics", "scale"]
    for one, after in pairwise(together.effects.values()):
        assert not {*one} & {*after}


def test_the_same_order_twice_is_refused() -> None:
    with refused("duplicate-name"):
        Harmonics(orders=(1, 2, 1.0))


def test_another_load_waits_for_the_sag_of_the_arm_that_carries_it() -> None:
    plain, x = dh_arm(), readings(dh_arm())
    at = {"pose": 30.0}
    waiting = with_effects(plain, [Shift(("load",), (30.0,))])
    assert waiting.parameters.names == plain.parameters.names
    assert loops(waiting, x, at) == pytest.approx(loops(plain, x))
    with refused("duplicate-name", "'shift'"):
        with_effects(waiting, [Shift(("load",), (40.0,))])
    sags, changed = structured(plain), structured(waiting)
    assert sags.structure is not None
    tool = sags.structure.loaded
    assert tool
    assert all(name.endswith("_tool") for name in tool)
    before = dict.fromkeys(tool, 3e-4)
    more = {f"{name}_from30": 1e-4 * (i + 1) for i, name in enumerate(tool)}
    after = {name: 3e-4 + 1e-4 * (i + 1) for i, name in enumerate(tool)}
    for pose, gives in ((29.0, before), (30.0, after), (50.0, after)):
        found = loops(changed, x, {"pose": pose}, **before, **more)
        assert found == pytest.approx(loops(sags, x, **gives), rel=1e-12)
    assert {*changed.parameters.names} == {*sags.parameters.names, *more}
    terms = {
        term.name: {*term.parameters} for term in changed.terms if term.name[-8:] == "_changed"
    }
    assert terms.keys() == {"sag_changed", "sag_across_changed"}
    assert set().union(*terms.values()) == more.keys()
    assert changed.latest == at
    assert not changed.awaiting

"""Placing anew is a rigid motion, whatever the machine and its model error."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import loopcal as lc
from analyses.instruments import setup
from loopcal.document.change_points import Change, ChangePoint, Moved
from loopcal.estimation.prediction import output_differences
from loopcal.estimation.problem.problem import Problem
from loopcal.files.machines.further_points import with_points
from loopcal.files.machines.mechanism_file import mechanism_from_data
from loopcal.files.machines.mechanism_writer import mechanism_to_toml
from loopcal.files.machines.urdf import urdf_machine
from loopcal.mechanisms.effects.compliance import Compliance
from loopcal.mechanisms.effects.effect import with_effects
from loopcal.mechanisms.effects.gravity import Load
from loopcal.mechanisms.mechanism import Family, Mechanism
from loopcal.mechanisms.outputs import cartesian
from loopcal.mechanisms.station import Station, stationed
from loopcal.mechanisms.structure.structured import structured
from loopcal.small_samples import LearntCovariance
from loopcal.statistics.another_day import Day
from loopcal.statistics.calibrated import Calibrated
from loopcal.statistics.verification import verify
from tests.reference.machines import MA1400_TOOL, gantry, mixed_arm
from tests.reference.simulated import Simulated
from tests.reference.simulated import ma1400 as simulated_ma1400
from tests.refusals import refused
from tests.statistics.test_comparison import elsewhere, sds_of

Array = NDArray[np.float64]
Rows = dict[str, Array]
TEMPLATE = Path(__file__).parents[2] / "src/loopcal/files/project/template_files/urdf/robot.urdf"
POSES, EXACT = 16, lc.Noise({"*": 0.0})
TOOL = {"tool_x": 0.05, "tool_y": -0.02, "tool_z": 0.12}


@dataclass(frozen=True)
class Driven:
    """A machine, and true values (N,) of what drives it."""

    truth: Mechanism
    driven: Mapping[str, Array]


def turning(truth: Mechanism) -> Driven:
    """An arm anywhere within its reach."""
    read = {q: u for q, u in truth.quantities.items() if q not in truth.outputs}
    spans = {q: (-1.2, 1.2) if unit == "rad" else (0.0, 0.4) for q, unit in read.items()}
    return Driven(truth, lc.random_poses(spans, POSES, seed=3))


def platform(machine: lc.Machine) -> Driven:
    """A platform near its home, whose drives follow."""
    instrument = lc.instruments.point(dimension=machine.dimension)
    truth = lc.assemble(machine, [instrument], {"base_x": 0.4, "base_rz": 0.3, "tool_y": 0.1})
    its = {q: v for q, v in machine.home.items() if q.startswith("platform_")}
    spans = {q: (v - 0.04, v + 0.04) for q, v in its.items()}
    return Driven(truth, lc.random_poses(spans, POSES, seed=3))


def of_setup(name: str) -> Driven:
    given = setup(name)
    return Driven(given.truth, {q: v[:POSES] for q, v in given.driven.items()})


def ma1400() -> Driven:
    """Of transitions, which hold the placement themselves."""
    placed = {"x0": 0.7, "y0": -0.4, "phix0": 0.3, "phiy0": -0.2, "phiz1": 0.4, "z1": 0.9}
    return turning(lc.motoman_ma1400(MA1400_TOOL | placed, before={"rz": 0.5}))


def transitions() -> Driven:
    """Another arm described in that way, with a slide, on a wall."""
    axes = {"q1": "z", "q2": "y", "q3": "x", "q4": "y"}
    joints = [
        lc.Joint(q, f"transition-{axis}", "prismatic" if q == "q2" else "revolute")
        for q, axis in axes.items()
    ]
    nominal = {"x1": 0.2, "z1": 0.5, "phix1": 0.2, "y2": 0.3, "phiy2": 0.1, "x3": 0.4, "z4B": 0.2}
    return turning(lc.serial_arm(joints, nominal).with_gravity((0.6, 0.0, -0.8)))


def urdf() -> Driven:
    machine = urdf_machine(TEMPLATE, "base_link", "tool0")
    return turning(lc.assemble(machine, [lc.instruments.point()], TOOL))


MACHINES: Mapping[str, Callable[[], Driven]] = {
    "Motoman MA1400": ma1400,
    "transitions": transitions,
    "two links": lambda: turning(lc.planar_two_link()),
    "mixed forms": lambda: turning(mixed_arm()),
    "gantry": lambda: turning(gantry()),
    "URDF": urdf,
    "delta": lambda: platform(lc.machines.linear_delta()),
    "3-RRR": lambda: platform(lc.machines.three_rrr()),
} | {
    name: lambda name=name: of_setup(name)
    for name in (
        "six-axis spherical",
        "six-axis two trackers, two reflectors",
        "six-axis pose",
        "two-link spherical",
        "two-link pose",
        "origins, two prismatic, point",
        "platform pose",
    )
}


def yielding(mechanism: Mechanism) -> Mechanism:
    """With springs that gravity loads."""
    turning_joints = [q for q, unit in mechanism.quantities.items() if unit == "rad"]
    joint = next((s.joint for s in reversed(mechanism.chain) if s.joint in turning_joints), None)
    if joint is None:
        return mechanism
    return with_effects(mechanism, [Compliance((Load("load", joint, (0.1, 0.05, 0.2)),))])


TERMS: Mapping[str, Callable[[Mechanism], Mechanism]] = {
    "sag": lambda m: structured(m, harmonics=False),
    "gears": lambda m: structured(m, sag=False),
    "discrepancy": lambda m: structured(m, sag=False, harmonics=False, discrepancy=2),
    "compliance": yielding,
    "all": lambda m: structured(yielding(m), discrepancy=1),
}
MOTIONS = {
    "any": Rotation.from_rotvec([0.7, -2.0, 1.1]),
    "half a turn about x": Rotation.from_rotvec([math.pi, 0.0, 0.0]),
    "half a turn about y": Rotation.from_rotvec([0.0, math.pi, 0.0]),
    "half a turn about z": Rotation.from_rotvec([0.0, 0.0, math.pi]),
    "on its side": Rotation.from_rotvec([0.0, math.pi / 2, 0.0]),
}


def calibrated(made: Mechanism, seed: int = 1) -> Calibrated:
    """With values of every term that are large: centimetres at the tool."""
    rng = np.random.default_rng(seed)
    # orientations are displaced by small turns, so that poses are exact only for smaller ones
    small = 1e-4 if any(f.form == "pose" for f in made.families) else 1.0
    sizes = {"rad/m": 5e-3 * small, "m": 3e-3, "rad": 3e-3 * small, "1": 1e-3}
    own = {
        p.name: p.nominal + rng.normal(0.0, sizes[p.unit]) for p in made.parameters if not p.fixed
    }
    made, n = made.with_nominal(own), len(made.parameters)
    nominal = np.array([p.nominal for p in made.parameters])
    sds = LearntCovariance.certain(1e-10 * np.diag([float(not p.fixed) for p in made.parameters]))
    flat, none = np.full(n, np.inf), np.zeros((n, 0))
    return Calibrated("", made, sds, none, nominal, flat, None, None, None, ())


def seen(made: Mechanism, driven: Mapping[str, Array]) -> Rows:
    """Readings without noise."""
    data = lc.simulate(made, driven, noise=EXACT, seed=0).dataset
    return {q: v for q, v in data.readings.items() if not q.startswith("platform_")}


def moved(made: Mechanism, rows: Rows, turn: Rotation, shift: Array) -> Rows:
    """What instruments read that stand elsewhere: p -> turn p + shift; in a plane about z."""
    found = dict(rows)
    for family in made.families or (Family("", (), made.outputs),):
        its = [q for q in family.readings if q in made.outputs]
        first = np.array([rows[q] for q in its])
        planar = len(its) == 2 or (family.form == "pose" and "pose_phi" in its)
        count = 2 if planar else 3
        R, t = turn.as_matrix()[:count, :count], shift[:count, None]
        if family.form in ("spherical", "polar"):
            p = R @ cartesian(first) + t
            level = np.hypot(p[0], p[1])
            polar = [np.linalg.norm(p, axis=0), np.arctan2(p[1], p[0])]
            polar += [] if planar else [np.arctan2(p[2], level)]
            found |= dict(zip(its, polar, strict=True))
            continue
        found |= dict(zip(its[:count], R @ first[:count] + t, strict=True))
        if family.form == "pose" and planar:
            found["pose_phi"] = rows["pose_phi"] + turn.as_rotvec()[2]
        elif family.form == "pose":
            names = ("qx", "qy", "qz", "qw")
            there = turn * Rotation.from_quat(np.array([rows[q] for q in names]).T)
            found |= dict(zip(names, there.as_quat().T, strict=True))
    return found


def motion(name: str, made: Mechanism) -> Rotation:
    """That in space, or of a planar machine the same angle about z."""
    planar = made.outputs[:2] == made.outputs or "pose_phi" in made.outputs
    turn = MOTIONS[name]
    return Rotation.from_rotvec([0.0, 0.0, turn.magnitude()]) if planar else turn


SHIFT = np.array([1.3, -0.8, 0.6])


def noise_of(made: Mechanism, rows: Rows) -> lc.Noise:
    sds = {q: 1e-5 if q in rows else np.inf for q in made.quantities}
    return lc.Noise(sds)


@cache
def machine(name: str) -> Driven:
    return MACHINES[name]()


def off(problem: Problem, parameters: Array, corrections: Array) -> float:
    """By how much predictions differ from what is read [m, rad]."""
    return float(np.nanmax(np.abs(output_differences(problem, parameters, corrections))))


@pytest.mark.parametrize("name", MACHINES)
def test_a_machine_placed_anew_is_the_calibrated_one_moved_rigidly(name: str) -> None:
    given = machine(name)
    terms = {"all": [*MOTIONS]}
    if name in ("Motoman MA1400", "transitions"):
        terms |= {term: [how] for term, how in zip(TERMS, MOTIONS, strict=True) if term != "all"}
    for term, motions in terms.items():
        known = calibrated(TERMS[term](given.truth))
        rows = seen(known.mechanism, given.driven)
        noise = noise_of(known.mechanism, rows)
        for how in motions:
            there = moved(known.mechanism, rows, motion(how, known.mechanism), SHIFT)
            day = Day.of(known.stationed, lc.Dataset.from_arrays(there), noise)
            placed = day.placed()
            assert off(placed.problem, placed.parameters, placed.corrections) < 1e-10, (term, how)


@pytest.mark.parametrize(
    ("name", "how"),
    [
        ("Motoman MA1400", "any"),
        ("two links", "half a turn about z"),
        ("six-axis two trackers, two reflectors", "half a turn about y"),
    ],
)
def test_an_update_and_a_check_are_those_of_the_machine_moved_rigidly(name: str, how: str) -> None:
    given = machine(name)
    known = calibrated(TERMS["all"](given.truth))
    made, rows = known.mechanism, seen(known.mechanism, given.driven)
    noise = noise_of(made, rows)
    data = lc.Dataset.from_arrays(moved(made, rows, motion(how, made), SHIFT))
    checked = verify(known, data, noise=noise)
    assert checked.calibrated is not None
    assert checked.calibrated.max < 1e-10
    found = lc.update(known, data, noise=noise)
    values = np.array([p.nominal for p in found.calibrated.parameters])
    assert off(found.problem, values, np.zeros_like(found.problem.readings)) < 1e-10
    kept = [p for p in made.parameters if p.role != "placement" and not p.fixed]
    assert max(abs(found.value[p.name] - p.nominal) for p in kept) < 1e-10


@pytest.mark.parametrize("make", [ma1400, transitions])
def test_an_updated_arm_of_transitions_is_written_with_its_station(
    make: Callable[[], Driven],
) -> None:
    """Bit for bit, and points of its body are seen from that station as well."""
    made = stationed(calibrated(TERMS["all"](make().truth)).mechanism)
    made = made.with_nominal({"base_x": 0.3, "base_rz": 0.4, "base_rx": 1.0})
    data = tomllib.loads(mechanism_to_toml(made))
    data.pop("schema")
    again = mechanism_from_data(data, "mechanism.toml")
    assert (again.tape, again.parameters, again.terms) == (made.tape, made.parameters, made.terms)
    assert again.roles == made.roles
    assert stationed(again) is again
    driven = make().driven
    tip = tuple(made.families[0].mounted)
    further = with_points(made, {"tip": tip}, "base").with_nominal(
        {p.name: p.nominal for p in made.parameters}
    )
    both = (lc.simulate(m, driven, noise=EXACT, seed=0).quantities for m in (made, further))
    first, second = both
    for axis in "xyz":
        assert np.abs(first[axis] - second[f"tip_{axis}"]).max() < 1e-12


def test_a_station_is_refused_for_a_machine_that_has_one() -> None:
    data = {"type": "serial", "joint": [{"name": "q1"}, {"name": "q2"}], "station": "elsewhere"}
    with refused("conflicting-keys", "elsewhere"):
        mechanism_from_data(data, "mechanism.toml")


def test_an_update_is_compared_with_calibrations_that_have_no_station() -> None:
    arm = simulated_ma1400(40)
    noise = lc.Noise(sds_of(arm))

    def found(which: Simulated, seed: int) -> lc.Result:
        data = which.read(sds_of(which), seed)
        return lc.calibrate(which.truth, data, noise=noise, start="nominal", method="implicit-loop")

    first, there = found(arm, 1), elsewhere(arm, 3, 40)
    later = lc.update(first, there.read(sds_of(arm), 2).take(np.arange(20)))
    assert "base_x" in later.value
    for a, b in ((first, later), (later, found(there, 3)), (found(there, 4), later)):
        made = lc.compare(a, b)
        assert made.p_value is not None
        assert made.p_value > 1e-3
        assert made.points is not None
        assert made.points.inside > 0.9


@pytest.mark.parametrize("make", [ma1400, transitions])
@pytest.mark.parametrize("first", [True, False])
def test_a_station_that_changes_along_the_run_moves_the_machine_rigidly(
    first: bool, make: Callable[[], Driven]
) -> None:
    """With all model error; first: the change is there before the model error is."""
    given, half = make(), POSES // 2
    station = Station("base").parameters
    data = lc.Dataset.from_arrays(seen(given.truth, given.driven))
    moved_there = point_of("station", station, data.poses[half])
    terms = TERMS["all"]
    made = terms(given.truth)
    if first:
        shifted = lc.with_shifts(given.truth, data, [moved_there])
        changing = terms(shifted.mechanism)
    else:
        shifted = lc.with_shifts(made, data, [moved_there])
        changing = shifted.mechanism
    known = calibrated(made).mechanism
    turn = MOTIONS["any"]
    steps = {f"{n}_from{half + 1}": v for n, v in stated(turn, SHIFT).items()}
    values = {p.name: p.nominal for p in known.parameters} | steps
    changing = changing.with_nominal(values)
    assert {n for n in station if changing.parameters[n].fixed} == {*station}
    driven = {**given.driven, "pose": np.arange(1.0, POSES + 1.0)}
    before, after = seen(known, given.driven), seen(changing, driven)
    there = moved(known, before, turn, SHIFT)
    for q in known.outputs:
        assert np.abs(after[q][:half] - before[q][:half]).max() < 1e-10
        assert np.abs(after[q][half:] - there[q][half:]).max() < 1e-10


def stated(turn: Rotation, shift: Array) -> dict[str, float]:
    """Of a motion the parameters of a station named base, which stood at the origin."""
    station = Station("base")
    return station.moved(dict.fromkeys(station.parameters, 0.0), turn.as_matrix(), shift)


def point_of(moved: Moved, names: tuple[str, ...], pose: str) -> ChangePoint:
    changes = {name: Change(0.01, 1e-4, "m") for name in names}
    return ChangePoint("step", pose, pose, 1, moved, changes, 1e4, 0.0, ())


@pytest.mark.parametrize("name", ["Motoman MA1400", "transitions", "gantry", "3-RRR", "URDF"])
def test_a_plan_promises_the_same_wherever_the_instrument_stands(name: str) -> None:
    """With all model error: points and their noise move rigidly, and nothing else changes."""
    given = machine(name)
    made = calibrated(TERMS["all"](given.truth)).stationed.mechanism
    assert made.placement is not None
    values = {p.name: p.nominal for p in made.parameters}
    d = len(made.families[0].readings)
    turn = motion("any", made).as_matrix()[:d, :d]
    there = made.with_nominal(made.placement.moved(values, turn, SHIFT[:d]))
    noise, settings = lc.Noise({"*": 1e-5}), lc.PlanSettings(model_error="none")
    promised = [
        lc.plan(m, POSES, noise=noise, candidates=given.driven, settings=settings).expected
        for m in (made, there)
    ]
    first, second = promised
    assert first.end_point == pytest.approx(second.end_point, rel=1e-6)
    assert first.largest == pytest.approx(second.largest, rel=1e-6)

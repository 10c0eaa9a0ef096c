"""Parallel machines close where the drawing says, and show as many parameters as derived."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import loopcal as lc
from analyses.machines import CASES, OWN, STEWART_GOUGH, Case
from loopcal.expressions.engine import engine_for
from loopcal.mechanisms.instruments.length import draw_wire
from loopcal.mechanisms.instruments.point import point
from loopcal.mechanisms.machine import Instrument, Machine, assemble
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parallel.delta import linear_delta, rotary_delta
from loopcal.mechanisms.parallel.five_bar import five_bar
from loopcal.mechanisms.parallel.four_bar import four_bar
from loopcal.mechanisms.parallel.stewart_gough import stewart_gough
from loopcal.mechanisms.parallel.three_rrr import three_rrr
from tests.reference.parallel import READINGS, spatial
from tests.reference.plain_tape import loop_values
from tests.refusals import refused

ALONE = {
    "four-bar": lambda: assemble(four_bar(passive=["theta_2", "phi_1"])),
    "four-bar unread": lambda: assemble(four_bar()),
    "five-bar": lambda: assemble(five_bar(passive=["phi_1", "phi_2"])),
    "five-bar unread": lambda: assemble(five_bar()),
    "3-RRR": lambda: assemble(three_rrr(passive=["phi_2"])),
    "linear delta": lambda: assemble(linear_delta()),
    "rotary delta": lambda: assemble(rotary_delta()),
    "Stewart-Gough": lambda: assemble(stewart_gough(passive=["alpha_1", "beta_1", "alpha_2"])),
}
RANGES = {name.split(",")[0]: case.driven for name, case in CASES.items()}


def _axes(i: int) -> tuple[str, ...]:
    return tuple(f"{axis}_{i}" for axis in "xyz")


def off_nominal(mechanism: Mechanism, seed: int, by: float = 0.01) -> dict[str, float]:
    draw = np.random.default_rng(seed)
    return {p.name: p.nominal + by * draw.uniform(-1, 1) for p in mechanism.parameters}


@pytest.mark.parametrize("name", ALONE)
def test_loops_close_where_trigonometry_says(name: str) -> None:
    mechanism = ALONE[name]()
    driven = RANGES[name.removesuffix(" unread")]
    for seed in range(20):
        p = off_nominal(mechanism, seed)
        x = {q: float(v[0]) for q, v in lc.random_poses(driven, 1, seed=seed).items()}
        x |= READINGS[mechanism.name](p, x)
        quantities = [x[q] for q in mechanism.tape.quantities]
        values = loop_values(mechanism.tape, quantities, list(p.values()))
        np.testing.assert_allclose(values, 0.0, atol=1e-12)


def jacobian(mechanism: Mechanism, case: Case, poses: int = 150) -> np.ndarray:
    """What parameters do to the loops that are left once the unread is eliminated, by SVD."""
    p = off_nominal(mechanism, 5, by=2e-3)
    driven = lc.random_poses(case.driven, poses, seed=6)
    made = lc.simulate(mechanism, driven, noise=lc.Noise({"*": 0.0}), seed=7, truth=p)
    tape = mechanism.tape
    engine = engine_for(tape, mechanism.parameters.free, poses)
    x = np.array([made.quantities[q] for q in tape.quantities])
    known = np.array([made.dataset[q] for q in tape.pose_constants]).reshape(
        len(tape.pose_constants), poses
    )
    values = engine.evaluate(np.array(list(p.values())), x, known)
    unread = [tape.quantities.index(q) for q in case.unread(mechanism)]
    rows = []
    for by_quantity, by_parameter in zip(
        values.by_quantity[unread].T, values.by_parameter.T, strict=True
    ):
        left = np.linalg.svd(by_quantity)[0][:, len(unread) :]
        rows.append(left.T @ by_parameter)
    J = np.vstack(rows)
    return np.asarray(J / np.maximum(np.linalg.norm(J, axis=0), 1e-300))


@pytest.mark.parametrize("name", CASES)
def test_the_default_parameters_are_identifiable_and_no_others_besides(name: str) -> None:
    case = CASES[name]
    mechanism = case.made()
    assert len(mechanism.parameters.free) == case.identifiable
    singular = np.linalg.svd(jacobian(mechanism, case), compute_uv=False)
    assert singular[-1] > 1e-5 * singular[0]
    freed = mechanism.with_parameters(mechanism.parameters.with_fixed(["*"], False))
    singular = np.linalg.svd(jacobian(freed, case), compute_uv=False)
    assert int((singular > 1e-9 * singular[0]).sum()) == case.identifiable


def moved_base(p: dict[str, float], turn: Rotation, shift: np.ndarray) -> dict[str, float]:
    """The same machine described from another base frame; joints that are read turn with it."""
    new = dict(p)
    for i in range(1, 7):
        new |= coordinates(f"a{i}", turn.apply(spatial(p, f"a{i}")) + shift)
        if f"joint_{i}_rz" in p:
            mount = Rotation.from_euler("ZY", [p[f"joint_{i}_rz"], p[f"joint_{i}_ry"]])
            rz, ry, rx = (turn * mount).as_euler("ZYX")
            new |= {f"joint_{i}_rz": rz, f"joint_{i}_ry": ry}
            new[f"alpha_{i}_offset"] += rx
    return new


def coordinates(name: str, point: np.ndarray) -> dict[str, float]:
    return {f"{name}_{axis}": float(v) for axis, v in zip("xyz", point, strict=True)}


@pytest.mark.parametrize("body", ["base", "platform"])
def test_what_reads_itself_cannot_see_where_its_frames_lie(body: str) -> None:
    """12 freedoms of 49 parameters; by its rank the Jacobian has no others."""
    mechanism = CASES["Stewart-Gough, three angles"].made()
    assert len(mechanism.parameters) - len(mechanism.parameters.free) == 12
    p = off_nominal(mechanism, 3)
    turn, shift = Rotation.from_euler("ZYX", [0.3, -0.2, 0.1]), np.array([0.4, -0.3, 0.2])
    driven = lc.random_poses(STEWART_GOUGH, 10, seed=4)
    for pose in range(10):
        x = {q: float(v[pose]) for q, v in driven.items()}
        here = spatial(x, "platform")
        turned = Rotation.from_euler("ZYX", [x[f"platform_r{axis}"] for axis in "zyx"])
        if body == "base":
            other = moved_base(p, turn, shift)
            here, turned = turn.apply(here) + shift, turn * turned
        else:
            other = dict(p)
            for i in range(1, 7):
                other |= coordinates(f"b{i}", turn.apply(spatial(p, f"b{i}")) + shift)
            turned = turned * turn.inv()
            here = here - turned.apply(shift)
        angles = turned.as_euler("ZYX")
        y = coordinates("platform", here)
        y |= {f"platform_r{axis}": float(v) for axis, v in zip("zyx", angles, strict=True)}
        read, still = READINGS[mechanism.name](p, x), READINGS[mechanism.name](other, y)
        assert read == pytest.approx(still, abs=1e-12)


@pytest.mark.parametrize("name", CASES)
def test_calibration_finds_the_truth(name: str) -> None:
    """From 1 mm and 1 mrad off, 60 poses at 10 um and 50 urad."""
    case = CASES[name]
    mechanism = case.made()
    draw = np.random.default_rng(8)
    truth = {
        p.name: p.nominal + 1e-3 * draw.standard_normal()
        for p in mechanism.parameters
        if not p.fixed
    }
    sds = {q: 1e-5 if unit == "m" else 5e-5 for q, unit in mechanism.quantities.items()}
    noise = lc.Noise(sds | dict.fromkeys(case.unread(mechanism), np.inf))
    poses = lc.random_poses(case.driven, 60, seed=9)
    made = lc.simulate(mechanism, poses, noise=noise, seed=10, truth=truth)
    found = lc.calibrate(mechanism, made.dataset, noise=noise, method="implicit-loop")
    assert found.status.converged
    assert found.identifiability.rank == case.identifiable
    assert found.chi_squared is not None
    assert 1e-3 < (found.chi_squared.p_value or 0.0) < 1 - 1e-3
    error = np.array([truth[n] - found.value[n] for n in found.estimated])
    whitened = error @ np.linalg.solve(found.covariance, error)
    assert chi2.sf(whitened, len(error)) > 1e-3


@pytest.mark.parametrize(
    ("instruments", "held"),
    [
        ([draw_wire(f"w{i}", target=f"t{i}") for i in (1, 2)], ["t1", "t2"]),
        ([draw_wire(f"w{i}", target="t") for i in (1, 2)], ["t"]),
        ([point(f"p{i}", target=f"t{i}", readings=_axes(i)) for i in (1, 2)], ["t1"]),
        ([point(target="t1"), draw_wire("w", target="t2")], ["t1", "t2"]),
        ([point(target="t", station=None), draw_wire("w", target="t")], ["t"]),
    ],
)
def test_a_body_that_never_turns_holds_one_target_of_what_stands_or_hangs_together(
    instruments: list[Instrument], held: list[str]
) -> None:
    """Of each other target its place against the first is seen, or against its own anchor."""
    parameters = assemble(linear_delta(), instruments).parameters
    fixed = {p.name for p in parameters if p.fixed and p.name.startswith("t")}
    assert fixed == {f"{target}_{axis}" for target in held for axis in "xyz"}


def test_unread_passive_joints_are_refused_by_name() -> None:
    with refused("unknown-name", "did you mean 'alpha_1'"):
        stewart_gough(passive=["alfa_1"])
    with refused("unknown-name", "platform_zz"):
        stewart_gough(home={"platform_zz": 1.0})


def test_a_length_reading_ties_the_size_and_a_frame_that_is_read_ties_itself() -> None:
    alone = assemble(five_bar(passive=["phi_1", "phi_2"]))
    assert alone.parameters["a2_x"].fixed
    assert not CASES["five-bar, point"].made().parameters["a2_x"].fixed
    own = CASES["Stewart-Gough, own pose"].made().parameters
    assert own.free == own.names
    assert OWN.parameters == ()


@pytest.mark.parametrize("name", [n for n in CASES if "own" not in n and "four-bar" not in n])
def test_joints_may_be_driven_as_well_as_the_platform(name: str) -> None:
    """Where the platform puts the joints, the joints put the platform."""
    case = CASES[name]
    mechanism, exact = case.made(), lc.Noise({"*": 0.0})
    poses = lc.random_poses(case.driven, 20, seed=3)
    first = lc.simulate(mechanism, poses, noise=exact, seed=1)
    joints = ("leg_", "theta_", "slide_")
    driven = {q: v for q, v in first.quantities.items() if q.startswith(joints)}
    again = lc.simulate(mechanism, driven, noise=exact, seed=1)
    for q in case.driven:
        np.testing.assert_allclose(again.quantities[q], first.quantities[q], atol=1e-9)


@pytest.mark.parametrize("name", ["five-bar, point", "3-RRR, elbows read", "Stewart-Gough, pose"])
def test_least_squares_finds_exact_machines_and_needs_no_word_of_what_nobody_reads(
    name: str,
) -> None:
    case = CASES[name]
    mechanism = case.made()
    draw = np.random.default_rng(3)
    free = mechanism.parameters.free
    truth = {n: mechanism.parameters[n].nominal + 1e-3 * draw.standard_normal() for n in free}
    exact = lc.Noise({"*": 0.0} | dict.fromkeys(case.unread(mechanism), np.inf))
    poses = lc.random_poses(case.driven, 60, seed=4)
    made = lc.simulate(mechanism, poses, noise=exact, seed=5, truth=truth)
    found = lc.calibrate(mechanism, made.dataset, method="least-squares")
    assert found.status.converged
    for parameter in free:
        assert found.value[parameter] == pytest.approx(truth[parameter], abs=1e-8)


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize(
    ("machine", "ties"),
    [(stewart_gough, "ab"), (three_rrr, "ab"), (five_bar, "a"), (four_bar, "a")],
)
def test_what_is_held_ties_the_frame_however_a_drawing_turns_and_numbers_the_joints(
    machine: Callable[[], Machine], ties: str, seed: int
) -> None:
    """No motion of the frame leaves all held coordinates where they are.

    A rigid motion moves a joint at r by v + w x r; the rows of what is held have full rank.
    """
    made = machine()
    rng = np.random.default_rng(seed)
    plane = made.dimension == 2
    turn = Rotation.from_euler("z", [90.0, -90.0, 180.0, 45.0][seed % 4], degrees=True)
    if seed >= 8 and not plane:
        turn = Rotation.random(random_state=seed)
    nominal: dict[str, float] = {}
    for body in ties:
        joints = sorted({n[:2] for n in made.parameters if n[0] == body and n[1].isdigit()})
        at = np.array([_joint_at(made, joint) for joint in joints])[rng.permutation(len(joints))]
        for joint, place in zip(joints, turn.apply(at), strict=True):
            nominal |= {n: v for n, v in coordinates(joint, place).items() if n in made.parameters}
    # A point from a station somewhere sees lengths, and ties neither frame.
    parameters = assemble(
        made, [point(readings=tuple("xyz"[: made.dimension]), dimension=made.dimension)], nominal
    ).parameters
    for body in ties:
        rows, size = [], max(abs(v) for n, v in nominal.items() if n[0] == body)
        for n, value in nominal.items():
            if n[0] == body and parameters[n].fixed:
                assert value == parameters[n].nominal
                joint, axis = n.split("_")
                r = [nominal.get(f"{joint}_{a}", 0.0) / size for a in "xyz"]
                e = np.eye(3)["xyz".index(axis)]
                motion = np.concatenate([e, np.cross(r, e)])
                rows.append(motion[[0, 1, 5]] if plane else motion)
        assert np.shape(rows) == ((3, 3) if plane else (6, 6))
        assert np.linalg.cond(rows) < 100.0


def _joint_at(machine: Machine, joint: str) -> list[float]:
    names = [f"{joint}_{axis}" for axis in "xyz"]
    return [machine.parameters[n].nominal if n in machine.parameters else 0.0 for n in names]

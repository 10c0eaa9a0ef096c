"""Known masses: each joint yields to the moment of what hangs on it, a payload pose by pose."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import loopcal as lc
from loopcal.errors import Code
from loopcal.files.machines.mechanism_file import mechanism_from_data, read_mechanism
from loopcal.files.machines.mechanism_writer import mechanism_to_toml
from loopcal.files.machines.urdf import read_masses, read_urdf
from loopcal.mechanisms.effects.drift import Shift
from loopcal.mechanisms.effects.effect import with_effects
from loopcal.mechanisms.effects.gravity import ACCELERATION, Load
from loopcal.mechanisms.instruments.point import point
from loopcal.mechanisms.machine import assemble
from loopcal.mechanisms.masses import with_payload
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.origins import joint_chain
from loopcal.mechanisms.structure.sag import LOAD, Sag
from loopcal.mechanisms.structure.structured import structured, without
from loopcal.statistics.change_points import find_shifts
from tests.reference.robots import CHAINS, urdf_of
from tests.refusals import refused

# A turn about z, an upper arm and a forearm about y, a wrist; the hand is fixed to the last link.
URDF = """<robot name="arm">
<link name="base"><inertial><mass value="50"/></inertial></link>
{links}
{joints}
</robot>"""
LINKS = {"pan": (3.0, "0 0 0.1"), "upper": (8.0, "0 0 0.2"), "fore": (4.0, "0.2 0 0"),
         "wrist": (1.0, "0 0 0.05"), "hand": (2.0, "0 0.01 0.03")}  # fmt: skip
JOINTS = {"q1": ("base", "pan", "0 0 0", "0 0 1"), "q2": ("pan", "upper", "0 0 0.2", "0 1 0"),
          "q3": ("upper", "fore", "0 0 0.45", "0 1 0"),
          "q4": ("fore", "wrist", "0.4 0 0", "0 -1 0")}  # fmt: skip
YIELDS = {"q2_yield": 5e-5, "q3_yield": 4e-5, "q4_yield": 9e-5}
STATED: dict[str, Any] = {"type": "urdf", "base": "base", "tip": "hand"}
RANGES = {"q1": (-2.5, 2.5), "q2": (-1.5, 1.5), "q3": (-2.0, 1.0), "q4": (-2.0, 2.0)}
NOISE = lc.Noise({"x": 1e-5, "y": 1e-5, "z": 1e-5, "q*": 5e-6})


def urdf(folder: Path) -> Path:
    links = [
        f'<link name="{name}"><inertial><origin xyz="{at}"/><mass value="{mass}"/></inertial>'
        "</link>"
        for name, (mass, at) in LINKS.items()
    ]
    joints = [
        f'<joint name="{name}" type="revolute"><parent link="{above}"/><child link="{link}"/>'
        f'<origin xyz="{xyz}"/><axis xyz="{axis}"/></joint>'
        for name, (above, link, xyz, axis) in JOINTS.items()
    ]
    fixed = (
        '<joint name="mount" type="fixed"><parent link="wrist"/><child link="hand"/>'
        '<origin xyz="0 0 0.1"/></joint>'
    )
    path = folder / "arm.urdf"
    path.write_text(URDF.format(links="\n".join(links), joints="\n".join([*joints, fixed])))
    return path


def arm(folder: Path, **more: Any) -> Mechanism:
    data = {**STATED, "file": str(urdf(folder)), **more}
    return mechanism_from_data(data, "arm").with_nominal({"tool_x": 0.05, "tool_z": 0.1})


def sag(made: Mechanism) -> Sag:
    assert made.structure is not None
    assert made.structure.sag is not None
    return made.structure.sag


def moments(made: Mechanism, x: Mapping[str, float]) -> dict[str, float]:
    """Size of the moment [N m] of gravity about each joint's axis."""
    assert made.structure is not None
    p = {q.name: q.nominal for q in made.parameters}
    p |= {c.parameter: 1.0 for c in made.structure.columns if c.term == "compliance"}
    columns = [c for c in made.structure.columns if c.term == "compliance"]
    turns = sag(made).link_turns(columns, x, p)
    return {name: float(np.linalg.norm(turn.astype(float))) for name, turn in turns.items()}


def test_links_that_are_fixed_together_are_one_mass(tmp_path: Path) -> None:
    loads = {load.joint: load for load in arm(tmp_path).masses}
    assert {name: load.mass for name, load in loads.items()} == {
        "q1": 3.0, "q2": 8.0, "q3": 4.0, "q4": 3.0,
    }  # fmt: skip
    # 1 kg at 0.05 and 2 kg at 0.1 + 0.03
    assert loads["q4"].point == pytest.approx((0.0, 0.02 / 3.0, (0.05 + 0.26) / 3.0))


def test_moments_are_those_of_statics(tmp_path: Path) -> None:
    x = {"q1": 0.3, "q2": 0.5, "q3": 0.4, "q4": 0.0, "payload": 5.0}
    made = structured(arm(tmp_path, payload="payload"))
    a, b = 0.5, 0.9  # of upper arm and forearm, turned about y from z and from x
    fore = 8.0 * 0.2 * math.sin(a)
    elbow = 0.45 * math.sin(a)
    wrist = 0.4 * math.cos(b)
    hand = 1.0 * 0.05 * math.sin(b) + 2.0 * 0.13 * math.sin(b)  # q4 counts against y, and is 0
    tool = elbow + wrist + 0.05 * math.cos(b) + (0.1 + 0.1) * math.sin(b)
    about = fore + 4.0 * (elbow + 0.2 * math.cos(b)) + 3.0 * (elbow + wrist) + hand + 5.0 * tool
    assert moments(made, x)["q2"] == pytest.approx(ACCELERATION * about)
    assert moments(made, x | {"payload": 0.0})["q2"] == pytest.approx(
        ACCELERATION * (about - 5.0 * tool)
    )
    assert moments(made, x).get("q1", 0.0) < 1e-9  # gravity runs along its axis


@pytest.mark.parametrize("name", ["UR5", "Panda", "iiwa", "KR210"])
def test_moments_are_pinocchios(name: str) -> None:
    pin = pytest.importorskip("pinocchio", reason="pin is not installed (make partners)")
    robot, base, tip = CHAINS[name]
    path = urdf_of(robot)
    masses = read_masses(path, base, tip)
    made = structured(assemble(joint_chain(read_urdf(path, base, tip), masses=masses), [point()]))
    model = pin.buildModelFromUrdf(str(path))
    model.gravity.linear = np.array([0.0, 0.0, -ACCELERATION])
    data = model.createData()
    up = pin.neutral(model)
    pin.framesForwardKinematics(model, data, up)
    turned = data.oMf[model.getFrameId(base)].rotation.T @ [0.0, 0.0, -1.0]
    assert turned == pytest.approx([0.0, 0.0, -1.0])
    rng = np.random.default_rng(3)
    for _ in range(5):
        x = {q: float(rng.uniform(-1.5, 1.5)) for q in made.quantities}
        q = pin.neutral(model)
        for joint, value in x.items():
            if model.existJointName(joint):
                index = model.joints[model.getJointId(joint)]
                own = [value] if index.nq == 1 else [math.cos(value), math.sin(value)]
                q[index.idx_q : index.idx_q + index.nq] = own
        torque = pin.computeGeneralizedGravity(model, data, q)
        for joint, moment in moments(made, x).items():
            if joint == "base":
                continue
            index = model.joints[model.getJointId(joint)]
            assert moment == pytest.approx(abs(torque[index.idx_v]), abs=1e-9)


def test_a_file_gives_masses_and_payload_back(tmp_path: Path) -> None:
    stated = [{"name": "q4", "joint": "q4", "mass": 7.0, "point": [0.0, 0.0, 0.1]}]
    made = structured(arm(tmp_path, mass=stated, payload="load"))
    assert next(m for m in made.masses if m.name == "q4") == Load("q4", "q4", (0, 0, 0.1), 7.0)
    assert made.pose_constants == {"load": "kg"}
    (tmp_path / "again.toml").write_text(mechanism_to_toml(made, tmp_path), "utf-8")
    again = read_mechanism(tmp_path / "again.toml")
    assert (again.masses, again.payload) == (made.masses, "load")
    assert again.tape == made.tape
    assert again.terms == made.terms


def test_another_load_is_another_mass_where_masses_are_known(tmp_path: Path) -> None:
    made = structured(with_effects(arm(tmp_path), [Shift(("load",), (30.0,))]))
    assert made.structure is not None
    assert made.structure.loaded == (LOAD,)
    parameter = made.parameters[f"{LOAD}_from30"]
    assert (parameter.unit, parameter.prior_sd, parameter.changes) == ("kg", 5.0, LOAD)
    (tmp_path / "again.toml").write_text(mechanism_to_toml(made, tmp_path), "utf-8")
    again = read_mechanism(tmp_path / "again.toml")
    assert (again.parameters, again.tape) == (made.parameters, made.tape)


def test_another_load_changes_the_sag_where_the_masses_explain_nothing(tmp_path: Path) -> None:
    waiting = with_effects(arm(tmp_path), [Shift(("load",), (30.0,))])
    fewer = without(waiting, structured(waiting), {"compliance"})
    assert fewer.structure is not None
    assert LOAD not in fewer.parameters.names
    assert all(name.endswith("_tool") for name in fewer.structure.loaded)
    assert {f"{name}_from30" for name in fewer.structure.loaded} <= {*fewer.parameters.names}
    assert fewer.structure.loaded


def test_without_masses_nothing_yields_to_them(tmp_path: Path) -> None:
    made = structured(replace(arm(tmp_path), masses=()))
    assert [t.name for t in made.terms if t.name == "compliance"] == []
    assert LOAD not in made.parameters.names


@pytest.mark.parametrize(
    ("code", "more", "words"),
    [
        ("missing-key", {"mass": [{"name": "a", "joint": "q2"}]}, "'a'"),
        ("unknown-name", {"mass": [{"name": "a", "joint": "q9", "mass": 1}]}, "'q9'"),
        ("duplicate-name", {"payload": "q1"}, "'q1'"),
    ],
)
def test_what_cannot_weigh_is_refused(
    code: Code, more: dict[str, Any], words: str, tmp_path: Path
) -> None:
    with refused(code, words):
        arm(tmp_path, **more)


def test_only_arms_in_space_carry_a_payload() -> None:
    with refused("unsupported"):
        with_payload(lc.planar_two_link(), "payload")


def test_compliances_and_an_unstated_load_are_recovered(tmp_path: Path) -> None:
    made = structured(arm(tmp_path), harmonics=False, sag=("*_yield",))
    assert [t.name for t in made.terms][-1] == "compliance"
    truth = YIELDS | {LOAD: 2.0}
    poses = lc.random_poses(RANGES, 80, seed=4)
    read = lc.simulate(made, poses, noise=NOISE, seed=5, truth=truth).dataset
    result = lc.calibrate(made, read, noise=NOISE, method="implicit-loop")
    assert result.status.converged
    for name, true in truth.items():
        sd = result.sd[name]
        assert sd is not None
        assert abs(result.value[name] - true) < 4.0 * sd, name


def test_a_load_that_changes_along_the_run_is_named(tmp_path: Path) -> None:
    carrying = structured(arm(tmp_path, payload="payload"), harmonics=False, sag=("*_yield",))
    poses = {**lc.random_poses(RANGES, 60, seed=6), "payload": np.repeat([0.0, 5.0], 30)}
    read = lc.simulate(carrying, poses, noise=NOISE, seed=7, truth=YIELDS).dataset
    plain = structured(arm(tmp_path), harmonics=False, sag=("*_yield",))
    data = {name: read[name] for name in plain.quantities}
    result = lc.calibrate(plain, data, noise=NOISE, method="implicit-loop")
    step = max(find_shifts(result).found, key=lambda one: one.gain)
    assert (step.moved, step.number, step.names) == ("load", 31, (LOAD,))
    # One step of Newton's method, from a fit that the step has bent.
    assert step.changes[LOAD].size == pytest.approx(5.0, rel=0.5)
    assert "the load on the tool changed" in str(step)


def test_another_load_is_as_sure_as_the_masses_it_is_weighed_against(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    true = structured(arm(tmp_path, payload="payload"), harmonics=False, sag=("*_yield",))
    held = 0
    for seed in range(4):
        rng = np.random.default_rng(seed)
        days = []
        for number, (count, load) in enumerate(((60, 0.0), (25, 5.0))):
            poses = {**lc.random_poses(RANGES, count, seed=2 * seed + number)}
            poses["payload"] = np.full(count, load)
            read = lc.simulate(true, poses, noise=NOISE, seed=2 * seed + number, truth=YIELDS)
            days.append(read.dataset)
        stated = {k: (m * math.exp(0.2 * rng.normal()), at) for k, (m, at) in LINKS.items()}
        with monkeypatch.context() as patch:
            patch.setitem(globals(), "LINKS", stated)
            drawn = structured(arm(tmp_path), harmonics=False, sag=("*_yield",))
        first, later = (
            lc.Dataset.from_arrays({name: day[name] for name in drawn.quantities}) for day in days
        )
        result = lc.calibrate(drawn, first, noise=NOISE, method="implicit-loop")
        changes = lc.verify(result, later).changes
        assert changes is not None
        (change,) = (one for one in changes.found if one.kind == "load")
        assert change.unit == "kg"
        held += change.low < 5.0 < change.high
    assert held >= 3


@pytest.mark.parametrize(
    ("column", "words"),
    [
        ("q1_sag_y_tool", "q1 across its axis or q2 about its axis gives way"),
        ("q2_sag_y_tool", "q2 gives way about its axis"),
        ("q2_sag_x_tool", "q2 gives way across its axis"),
    ],
)
def test_what_readings_hardly_tell_apart_is_named_as_a_group(
    column: str, words: str, tmp_path: Path
) -> None:
    made = structured(replace(arm(tmp_path), masses=()), harmonics=False, sag=(column,))
    poses = lc.random_poses(RANGES, 50, seed=8)
    read = lc.simulate(made, poses, noise=NOISE, seed=9, truth={column: 1e-3}).dataset
    result = lc.calibrate(made, read, noise=NOISE, method="implicit-loop")
    (term,) = [term for term in result.document.terms if term.parts]
    assert [words in part.words for part in term.parts] == [True]

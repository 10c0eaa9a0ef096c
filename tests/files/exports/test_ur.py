"""Universal Robots: published hashes and origins, the documented controller table, and refusals."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
import yaml

from loopcal.companions.robot.exports.format import ExportOptions
from loopcal.companions.robot.exports.ur import (
    LINKS,
    MODELS,
    UrOrigins,
    UrTable,
    controller_hash,
    drawing,
    nominal_origins,
    read_calibration,
    table_hash,
    ur,
    ur_origins,
)
from loopcal.document.exported import Exported
from loopcal.files.machines.urdf import read_urdf
from loopcal.mechanisms.chain import Step, product
from loopcal.mechanisms.origins import joint_chain
from loopcal.mechanisms.rest import RestChain, rest_chain, roll_pitch_yaw
from tests.reference.robots import CHAINS, urdf_of
from tests.refusals import refused

HASHES = {
    "ur3": 9122066269688285636, "ur3e": 16756443741236045476, "ur5": 209549117540498681,
    "ur5e": 12788084448423163542, "ur10": 17227329492635474227, "ur16e": 1935737212149401527,
    "ur15": 16739373764049705779, "ur20": 4890363623803256388, "ur10e": 5119701370761913513,
}  # fmt: skip
"""Of default_kinematics.yaml in Universal_Robots_ROS2_Description and universal_robot."""
DOCUMENTED = UrTable(
    (-2.4147806894359e-07, 1.60233952386695, -1.68607190752171,
     0.0837331147700119, -1.01260355871158e-07, 3.91986209186124e-08),
    (0.180539811714259, 439.140974079901, -446.027059806332,
     7.0603368964236, 0.119811341150314, 0.115670917257426),
    (2.12234865571206e-05, 0.0193171326277006, -0.569251663611088,
     -4.61409023720934e-05, -6.39280053471802e-05, 0.0),
    (1.57014608044242, 0.0013941666682559, 0.00693818880325995,
     1.56998468543761, -1.57038520649543, 0.0),
)  # fmt: skip
"""A real UR10e: the example of the documentation of ur_calibration, "Calibration correction"."""
DELTAS = """[mounting]
delta_theta = [ -7.290070070824746e-05, -0.01713897289704999, -0.03707159413492756, 0.054279462160583214, 1.488984257025741e-07, 1.551499479707493e-05]
delta_a = [ 4.6311376834935676e-05, -0.00012568315331862312, 0.00186216581161458, 9.918593870679266e-05, 4.215462720453189e-06, 0]
delta_d = [ 0.00065609212979853, 1.4442162376284788, 0.854147723854608, -2.2989425877563705, -1.573498686836816e-05, 1.9072435590711256e-05]
delta_alpha = [ 0.000211987863869334, -0.0072553625957652995, -0.013483226769541364, 0.0013495820227329425, -0.001263136163679901, 0]
calibration_status = 2
"""  # noqa: E501
"""A UR10, of calibration_test.cpp of ur_calibration."""


def steps_of(table: UrTable) -> tuple[Step, ...]:
    """The arm of a controller's table as elementary steps; its joints are called by `LINKS`."""
    rows = zip(LINKS, table.theta, table.d, table.a, table.alpha, strict=True)
    return tuple(
        step
        for link, theta, d, a, alpha in rows
        for step in (
            Step("rz", joint=link, constant=theta),
            Step("tz", constant=d),
            Step("tx", constant=a),
            Step("rx", constant=alpha),
        )
    )


def pose_of(arm: UrOrigins, readings: Sequence[float]) -> np.ndarray:
    """T_base_tip (4, 4) at six readings [rad]."""
    T = arm.base
    for L, q in zip(arm.origins.values(), readings, strict=True):
        T = T @ L @ product([Step("rz", constant=float(q))], {}, {})
    return T @ arm.tool


def written(tmp_path, text, name="calibration.conf"):
    path = tmp_path / name
    path.write_text(text)
    return path


def poses(count=1000):
    return np.random.default_rng(0).uniform(-2 * np.pi, 2 * np.pi, (count, 6))


@pytest.mark.parametrize("model", HASHES)
def test_hashes_are_the_published_ones(model):
    assert table_hash(drawing(model)) == f"calib_{HASHES[model]}"


@pytest.mark.parametrize("model", MODELS)
def test_a_drawing_gives_its_own_origins(model):
    arm = ur_origins(rest_chain(steps_of(drawing(model)), {}))
    assert arm.model == model
    for L, N in zip(arm.origins.values(), nominal_origins(model), strict=True):
        np.testing.assert_allclose(L, N, atol=1e-9)
    np.testing.assert_allclose(arm.base, np.eye(4), atol=1e-9)


def test_the_origins_of_a_ur5e_are_the_published_ones():
    published = {
        "shoulder": (0, 0, 0.1625, 0, 0, 0),
        "upper_arm": (0, 0, 0, 1.570796327, 0, 0),
        "forearm": (-0.425, 0, 0, 0, 0, 0),
        "wrist_1": (-0.3922, 0, 0.1333, 0, 0, 0),
        "wrist_2": (0, -0.0997, 0, 1.570796327, 0, 0),
        "wrist_3": (0, 0.0996, 0, math.pi / 2, math.pi, math.pi),
    }
    arm = ur_origins(rest_chain(steps_of(drawing("ur5e")), {}))
    for link, (x, y, z, *rpy) in published.items():
        L = arm.origins[link]
        np.testing.assert_allclose(L[:3, 3], (x, y, z), atol=1e-9)
        np.testing.assert_allclose(roll_pitch_yaw(L[:3, :3], rpy), rpy, atol=1e-9)


@pytest.mark.parametrize("table", [DOCUMENTED, None])
def test_a_controllers_table_comes_back_from_439_m_with_the_same_kinematics(table, tmp_path):
    if table is None:
        table = read_calibration(written(tmp_path, DELTAS), "ur10")
    steps = steps_of(table)
    arm = ur_origins(rest_chain(steps, {}))
    assert arm.model == ("ur10e" if table is DOCUMENTED else "ur10")
    for L, N in zip(arm.origins.values(), nominal_origins(arm.model), strict=True):
        assert np.abs(L[:3, 3] - N[:3, 3]).max() < 0.005
    for q in poses():
        expected = product(steps, dict(zip(LINKS, q, strict=True)), {})
        np.testing.assert_allclose(pose_of(arm, q), expected, atol=1e-9)


@pytest.mark.parametrize("name", ["UR5", "UR10"])
def test_a_calibrated_urdf_keeps_base_and_tool_outside_the_six(name, tmp_path):
    machine = joint_chain(read_urdf(urdf_of(CHAINS[name][0]), *CHAINS[name][1:]))
    rng = np.random.default_rng(2)
    values = {n: p.nominal + 5e-4 * rng.normal() for n, p in machine.parameters.items()}
    chain = rest_chain(machine.chain, values)
    arm = ur_origins(chain)
    assert arm.model == name.lower()
    shoulder = arm.origins["shoulder"]
    np.testing.assert_allclose(shoulder, nominal_origins(arm.model)[0], atol=1e-12)
    for q in poses(50):
        readings = dict(zip(machine.quantities, q, strict=True))
        np.testing.assert_allclose(pose_of(arm, q), chain.pose(readings), atol=1e-12)
    moved = {n: v + (0.3 if n.endswith("fixed_joint_x") else 0.0) for n, v in values.items()}
    again = ur_origins(rest_chain(machine.chain, moved))
    for link in LINKS:
        np.testing.assert_allclose(again.origins[link], arm.origins[link], atol=1e-12)


def test_the_file_holds_the_origins_and_the_controllers_hash(tmp_path):
    conf = written(tmp_path, DELTAS)
    table = read_calibration(conf, "ur10")
    chain = rest_chain(steps_of(table), {})
    exported = Exported("arm", chain, (), (), {})
    done = ur(exported, ExportOptions(conf))
    text = done.files["kinematics.yaml"]
    stated = yaml.safe_load(text)["kinematics"]
    assert list(stated) == [*LINKS, "hash"]
    assert stated["hash"] == table_hash(table)
    assert "movel" in text
    arm = ur_origins(chain)
    for link in LINKS:
        np.testing.assert_allclose([stated[link][k] for k in "xyz"], arm.origins[link][:3, 3])
    own = written(tmp_path, text, "mine.yaml")
    assert controller_hash(own, "ur10") == table_hash(table)
    alone = ur(exported, ExportOptions())
    assert "hash" not in yaml.safe_load(alone.files["kinematics.yaml"])["kinematics"]
    assert alone.warnings


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("joints = 6", "wrong-file-type"),
        ("[mounting]\ndelta_theta = [1,2,3,4,5,6]\n", "missing-key"),
        (DELTAS.replace("-7.29", "x"), "invalid-number"),
        (DELTAS.replace("-0.01713897289704999,", ""), "invalid-number"),
        ("\0" * 200_000, "wrong-file-type"),
    ],
)
def test_a_file_that_is_no_calibration_is_refused(text, code, tmp_path):
    with refused(code, "calibration.conf"):
        controller_hash(written(tmp_path, text), "ur5")


def test_another_arm_is_refused():
    panda = rest_chain(steps_of(drawing("ur5e"))[:-8], {})
    with refused("unsupported", "six turning joints"):
        ur_origins(panda)
    wrong = UrTable(*(tuple(3 * v for v in row) for row in vars(drawing("ur5e")).values()))
    with refused("unsupported", "nearest"):
        ur_origins(rest_chain(steps_of(wrong), {}))
    joints = rest_chain(steps_of(drawing("ur5e")), {}).joints
    chain = RestChain((*joints[:2], replaced(joints[2]), *joints[3:]), np.eye(4))
    with refused("unsupported", "signs"):
        ur_origins(chain)


def replaced(joint):
    """The joint with its reading reversed."""
    from dataclasses import replace

    return replace(joint, factor=-joint.factor)

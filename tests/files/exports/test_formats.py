"""Every format of an export, read back by the program it is for."""

from __future__ import annotations

import csv
import io
import json
import math
from dataclasses import replace

import numpy as np
import pytest
from lxml import etree
from scipy.spatial.transform import Rotation

from loopcal.document.exported import Exported, Placed, ZeroOffset
from loopcal.files.exports.format import ExportOptions, place_files
from loopcal.files.exports.registry import EXPORTS, format_named
from loopcal.files.exports.tables import ORIENTATIONS
from loopcal.files.machines.urdf import read_urdf
from loopcal.files.outputs import command
from loopcal.mechanisms.origins import LinkJoint, calibrated_origins, joint_chain
from loopcal.mechanisms.placement import rigid
from loopcal.mechanisms.rest import rest_chain, rotation
from tests.reference.robots import CHAINS, urdf_of
from tests.refusals import refused

ARM = tuple(
    LinkJoint(f"j{i}", kind, (0.1 * i, 0.2, 0.3), (0.2 * i, 0.1, -0.3), axis)
    for i, (kind, axis) in enumerate(
        [
            ("revolute", (0.0, 0.0, 1.0)),
            ("continuous", (0.0, -1.0, 0.0)),
            ("prismatic", (0.6, 0.0, 0.8)),
            ("fixed", (1.0, 0.0, 0.0)),
            ("revolute", (1.0, 0.0, 0.0)),
        ]
    )
)


def machine_of(joints, *, seed=0, **more):
    machine = joint_chain(joints)
    rng = np.random.default_rng(seed)
    values = {n: p.nominal + 1e-3 * rng.normal() for n, p in machine.parameters.items()}
    origins = calibrated_origins(joints, values, axes=False, apart=False)
    chain = rest_chain(machine.chain, values)
    return Exported("an <arm> & more", chain, origins, (), values, **more)


def files_of(name, machine, **options):
    done = format_named(name).write(machine, ExportOptions(**options))
    return {n: c if isinstance(c, str) else c.decode() for n, c in done.files.items()}


def rows_of(text):
    return list(csv.DictReader(io.StringIO(text)))


def configurations(machine, count=1000):
    rng = np.random.default_rng(1)
    names = dict.fromkeys(j.reads for j in machine.chain.joints)
    return [{n: rng.uniform(-2, 2) for n in names} for _ in range(count)]


ROBOTS = {"every kind of joint": None, "Panda": "Panda", "KR210": "KR210", "UR10": "UR10"}


def robot(name):
    return machine_of(
        ARM if ROBOTS[name] is None else read_urdf(urdf_of(CHAINS[name][0]), *CHAINS[name][1:])
    )


@pytest.mark.parametrize("name", ROBOTS)
def test_mujoco_moves_the_arm_as_we_do(name):
    mujoco = pytest.importorskip("mujoco", reason="mujoco is not installed (make partners)")
    machine = robot(name)
    model = mujoco.MjModel.from_xml_string(files_of("mjcf", machine)["robot.xml"])
    data = mujoco.MjData(model)
    for q in configurations(machine):
        for joint, reading in q.items():
            data.joint(joint).qpos[:] = reading
        mujoco.mj_kinematics(model, data)
        site = data.site("tip")
        found = rigid(site.xmat.reshape(3, 3), site.xpos)
        np.testing.assert_allclose(found, machine.chain.pose(q), atol=1e-12)


@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.parametrize("form", ["dh", "mdh"])
def test_roboticstoolbox_moves_the_tables_as_we_do(name, form):
    rtb = pytest.importorskip("roboticstoolbox", reason="roboticstoolbox is not installed")
    machine = robot(name)
    files = files_of(form, machine)
    frames = {r["frame"]: placed(r) for r in rows_of(files[f"{form}_frames.csv"])}
    kinds = {
        ("dh", "revolute"): rtb.RevoluteDH, ("dh", "prismatic"): rtb.PrismaticDH,
        ("mdh", "revolute"): rtb.RevoluteMDH, ("mdh", "prismatic"): rtb.PrismaticMDH,
    }  # fmt: skip
    links = []
    for row in rows_of(files[f"{form}.csv"]):
        a, alpha, d, theta = (
            float(row[k]) for k in ("a [m]", "alpha [rad]", "d [m]", "theta [rad]")
        )
        moving = (
            {"d": d, "offset": theta}
            if row["type"] == "revolute"
            else {"theta": theta, "offset": d}
        )
        links.append(kinds[form, row["type"]](a=a, alpha=alpha, **moving))
    arm = rtb.DHRobot(links)
    for q in configurations(machine):
        inner = np.array(arm.fkine([q[j.reads] for j in machine.chain.joints]).A)
        found = frames["base"] @ inner @ frames["tool"]
        np.testing.assert_allclose(found, machine.chain.pose(q), atol=1e-9)


def placed(row):
    x, y, z, roll, pitch, yaw = (float(v) for v in list(row.values())[1:])
    turns = [rotation(a, v) for a, v in zip(np.eye(3).tolist(), (roll, pitch, yaw), strict=True)]
    return rigid(turns[2] @ turns[1] @ turns[0], np.array([x, y, z]))


def test_urchin_reads_the_patched_urdf_as_we_mean_it(tmp_path):
    urchin = pytest.importorskip("urchin", reason="urchin is not installed (make partners)")
    links = "".join(f'<link name="l{i}"/>' for i in range(len(ARM) + 1))
    joints = "".join(
        f'<joint name="{j.name}" type="{j.kind}"><parent link="l{i}"/><child link="l{i + 1}"/>'
        f'<limit lower="-9" upper="9" effort="1" velocity="1"/>'
        f'<origin xyz="{" ".join(map(repr, j.xyz))}" rpy="{" ".join(map(repr, j.rpy))}"/>'
        f'<axis xyz="{" ".join(map(repr, j.axis))}"/></joint>'
        for i, j in enumerate(ARM)
    )
    path = tmp_path / "arm.urdf"
    path.write_text(f'<robot name="arm">{links}{joints}</robot>')
    machine = machine_of(read_urdf(path, "l0", "l5"))
    path.write_text(files_of("urdf", machine, source=path)["arm.urdf"])
    loaded = urchin.URDF.load(str(path))
    for q in configurations(machine):
        found = loaded.link_fk(cfg=q, link="l5")
        np.testing.assert_allclose(found, machine.chain.pose(q), atol=1e-12)


def test_xacro_loads_the_origins(tmp_path):
    xacro = pytest.importorskip("xacro", reason="xacro is not installed (make partners)")
    machine = machine_of(ARM)
    for name, content in files_of("xacro", machine).items():
        (tmp_path / name).write_text(content)
    joints = "".join(
        f'<joint name="{j.name}" type="{j.kind}"><xacro:calibrated_origin joint="{j.name}"/>'
        f'<parent link="l{i}"/><child link="l{i + 1}"/><axis xyz="{" ".join(map(repr, j.axis))}"/>'
        "</joint>"
        for i, j in enumerate(ARM)
    )
    links = "".join(f'<link name="l{i}"/>' for i in range(len(ARM) + 1))
    source = tmp_path / "arm.urdf.xacro"
    source.write_text(
        '<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro">'
        f'<xacro:include filename="calibration.xacro"/>{links}{joints}</robot>'
    )
    expanded = tmp_path / "arm.urdf"
    expanded.write_text(xacro.process_file(str(source)).toxml())
    found = joint_chain(read_urdf(expanded, "l0", "l5"))
    chain = rest_chain(found.chain, {n: p.nominal for n, p in found.parameters.items()})
    for q in configurations(machine):
        np.testing.assert_allclose(chain.pose(q), machine.chain.pose(q), atol=1e-14)


def test_sdf_states_each_frame_in_the_one_before():
    """Read with the equations of the SDF format: relative poses, quaternions with w last."""
    from lxml import etree

    machine = machine_of(ARM)
    model = etree.fromstring(files_of("sdf", machine)["robot.sdf"].encode()).find("model")
    for q in configurations(machine, 5):
        T = {"base": np.eye(4)}
        for joint in model.iter("joint"):
            parent, child = joint.findtext("parent"), joint.findtext("child")
            pose = model.find(f"link[@name='{child}']/pose")
            assert pose.get("relative_to") == parent
            axis = np.array([float(v) for v in joint.findtext("axis/xyz").split()])
            value = q[joint.get("name")]
            if joint.get("type") == "prismatic":
                moved = rigid(np.eye(3), value * axis)
            else:
                moved = rigid(rotation(axis.tolist(), value), np.zeros(3))
            T[child] = T[parent] @ quat_pose(pose.text) @ moved
        tip = model.find("frame")
        found = T[tip.get("attached_to")] @ quat_pose(tip.findtext("pose"))
        np.testing.assert_allclose(found, machine.chain.pose(q), atol=1e-13)


@pytest.mark.parametrize("name", ROBOTS)
def test_drake_reads_the_sdf_and_moves_the_arm_as_we_do(name):
    parsing = pytest.importorskip(
        "pydrake.multibody.parsing", reason="drake is not installed (make partners)"
    )
    from pydrake.multibody.plant import MultibodyPlant

    machine, plant = robot(name), MultibodyPlant(0.0)
    parsing.Parser(plant).AddModelsFromString(files_of("sdf", machine)["robot.sdf"], "sdf")
    plant.Finalize()
    context = plant.CreateDefaultContext()
    base, tip = plant.GetFrameByName("base"), plant.GetFrameByName("tip")
    for q in configurations(machine):
        positions = plant.GetPositions(context)
        for joint, reading in q.items():
            positions[plant.GetJointByName(joint).position_start()] = reading
        plant.SetPositions(context, positions)
        found = plant.CalcRelativeTransform(context, base, tip).GetAsMatrix4()
        np.testing.assert_allclose(found, machine.chain.pose(q), atol=1e-12)


def quat_pose(text):
    from scipy.spatial.transform import Rotation

    numbers = [float(v) for v in text.split()]
    return rigid(Rotation.from_quat(numbers[3:]).as_matrix(), np.array(numbers[:3]))


A, B, C = 0.3, -0.4, 0.7
TURNED = rotation((0, 0, 1), A) @ rotation((0, 1, 0), B) @ rotation((1, 0, 0), C)


def framed():
    frames = (
        Placed("tool", "flange", rigid(TURNED, np.array([0.1, 0.2, 0.3])), True, "geometry"),
        Placed("ball", "flange", rigid(np.eye(3), np.array([0.0, 0.0, 0.25])), False, "geometry"),
    )
    zeros = (ZeroOffset("j0", "rad", math.radians(0.5), math.radians(0.01), True),
             ZeroOffset("j2", "m", -1e-3, None, False))  # fmt: skip
    return machine_of(ARM, frames=frames, zeros=zeros)


@pytest.mark.parametrize("vendor", ORIENTATIONS)
def test_orientations_follow_the_vendor(vendor):
    """KUKA turns about moving z, y, x; Fanuc and Yaskawa about fixed x, y, z; ABB is w first."""
    row, ball = rows_of(files_of("frames", framed(), vendor=vendor)["tcp.csv"])
    numbers = [float(v) for v in list(row.values())[6:]]
    a, b, c = (math.degrees(v) for v in (A, B, C))
    w, x, y, z = numbers if vendor == "abb" else (0, 0, 0, 0)
    if vendor == "abb":
        axis = np.array([x, y, z]) / math.hypot(x, y, z)
        found = rotation(axis.tolist(), 2 * math.acos(w))
        np.testing.assert_allclose(found, TURNED, atol=1e-8)
    else:
        expected = (a, b, c) if vendor == "kuka" else (c, b, a)
        np.testing.assert_allclose(numbers, expected, atol=1e-6)
    assert set(list(ball.values())[6:]) == {""}
    assert float(ball["z [mm]"]) == 250.0


def test_static_transforms_are_the_frames_of_the_geometry():
    """Tools on the flange and stations in the base, as tf2_ros reads its arguments."""
    T = rigid(TURNED, np.array([1.0, -2.0, 0.5]))
    machine = framed()
    frames = (
        *machine.frames,
        Placed("a tracker", "base", T, True, "geometry"),
        Placed("base", "a tracker", T, True, "geometry"),
        Placed("old", "base", T, True, "zeros and tool"),
    )
    text = files_of("tf", replace(machine, frames=frames))["static_transforms.launch.xml"]
    read = {}
    for node in etree.fromstring(text):
        words = iter(node.get("args").split())
        stated = {word.removeprefix("--"): next(words) for word in words}
        R = Rotation.from_quat([float(stated[f"q{a}"]) for a in "xyzw"]).as_matrix()
        place = rigid(R, np.array([float(stated[a]) for a in "xyz"]))
        read[stated["child-frame-id"], stated["frame-id"]] = place
    assert read.keys() == {("tool", "flange"), ("ball", "flange"), ("a_tracker", "base")}
    np.testing.assert_allclose(read["a_tracker", "base"], T, atol=1e-15)
    np.testing.assert_allclose(read["tool", "flange"], frames[0].T, atol=1e-15)


def test_zeros_are_told_as_the_pendant_reads_them():
    first, second = rows_of(files_of("zeros", framed(), counts={"j0": 1000.0})["zeros.csv"])
    assert (first["correction"], first["pendant reads at the true zero"]) == (
        "0.500000",
        "-0.500000",
    )
    assert (first["U95"], first["counts"], first["determined"]) == ("0.01", "500", "yes")
    assert (second["unit"], second["correction"], second["U95"]) == ("mm", "-1.000000", "")
    assert second["determined"] == "no"
    with refused("unknown-name", "j9"):
        files_of("zeros", framed(), counts={"j9": 1.0})


def test_the_json_holds_the_chain():
    machine = framed()
    stated = json.loads(files_of("json", machine)["geometry.json"])
    q = configurations(machine, 1)[0]
    T = np.eye(4)
    for own, joint in zip(stated["chain"]["joints"], machine.chain.joints, strict=True):
        assert own["name"] == joint.name
        T = T @ np.array(own["before"]) @ joint.motion(q[joint.reads])
    np.testing.assert_allclose(
        T @ np.array(stated["chain"]["tip"]), machine.chain.pose(q), atol=1e-15
    )


def test_a_file_is_replaced_only_by_force_and_kept(tmp_path):
    place_files(tmp_path, {"a": b"1", "b": b"1"})
    done = place_files(tmp_path, {"a": b"1"})
    assert (done.written, done.unchanged, done.backups) == ((), ("a",), ())
    with refused("unwritable-file", "--force"):
        place_files(tmp_path, {"a": b"1", "b": b"2", "c": b"2"})
    assert not (tmp_path / "c").exists()
    for content, backup in ((b"2", "b.bak"), (b"3", "b.bak2")):
        old = (tmp_path / "b").read_bytes()
        with command(force=True):
            done = place_files(tmp_path, {"b": content})
        assert done.backups == (backup,)
        assert (tmp_path / backup).read_bytes() == old


def test_an_unknown_format_names_the_nearest():
    with refused("unknown-name", "'urdf'"):
        format_named("urd")
    assert all(format_named(name).name == name for name in EXPORTS)

"""URDF files: forward kinematics as Pinocchio's, and messages for everything malformed."""

from __future__ import annotations

import numpy as np
import pytest

from loopcal.errors import InputError
from loopcal.files.machines.mechanism_file import mechanism_from_data
from loopcal.files.machines.urdf import read_urdf, urdf_machine
from loopcal.mechanisms.origins import LinkJoint, Mimic, joint_chain
from tests.reference.robots import CHAINS, urdf_of
from tests.refusals import refused

POSES = 1000


@pytest.mark.parametrize("name", CHAINS)
def test_it_reaches_what_pinocchio_reaches(name):
    pin = pytest.importorskip("pinocchio", reason="pin is not installed (make partners)")
    robot, base, tip = CHAINS[name]
    path = urdf_of(robot)
    machine = joint_chain(read_urdf(path, base, tip))
    p = {n: v.nominal for n, v in machine.parameters.items()}
    rng = np.random.default_rng(7)
    q = {n: rng.uniform(-np.pi, np.pi, POSES) for n in machine.quantities}
    body = machine.frame(q, p)
    turned = [body.direction(np.outer(unit, np.ones(POSES))) for unit in np.eye(3)]
    ours = np.array([*turned, body.point(np.zeros((3, POSES)))]).transpose(2, 1, 0)
    model = pin.buildModelFromUrdf(str(path), mimic=True)
    data = model.createData()
    frames = [model.getFrameId(link) for link in (base, tip)]
    theirs = []
    for i in range(POSES):
        pin.framesForwardKinematics(model, data, configuration(pin, model, q, i))
        bottom, top = (data.oMf[frame] for frame in frames)
        theirs.append((bottom.inverse() * top).homogeneous[:3])
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-12)


def configuration(pin, model, q, i):
    vector = pin.neutral(model)
    for name, values in q.items():
        value = float(values[i])
        joint = model.joints[model.getJointId(name)]
        # a continuous joint is a point on the circle there
        own = [np.cos(value), np.sin(value)] if joint.nq == 2 else [value]
        vector[joint.idx_q : joint.idx_q + joint.nq] = own
    return vector


def link(name):
    return f'<link name="{name}"/>'


def joint(name, parent, child, inside="", kind="revolute"):
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f"{inside}</joint>"
    )


LINKS = "".join(map(link, "abcd"))
JOINTS = (
    joint("ab", "a", "b", '<origin xyz="1 2 3" rpy="0.1 0.2 0.3"/><axis xyz="0 0 1"/>')
    + joint("bc", "b", "c", '<limit lower="-1" upper="0.5"/>', "prismatic")
    + joint("cd", "c", "d", '<axis xyz="0 0 1"/><mimic joint="ab" multiplier="2"/>', "continuous")
)


def written(tmp_path, text):
    path = tmp_path / "robot.urdf"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def robot(inside, head=""):
    return f'{head}<robot name="r" xmlns:xacro="http://ros.org/wiki/xacro">{inside}</robot>'


def test_what_is_left_out_is_what_urdf_says(tmp_path):
    joints = read_urdf(written(tmp_path, robot(LINKS + JOINTS)), "a", "d")
    assert joints == (
        LinkJoint("ab", "revolute", (1, 2, 3), (0.1, 0.2, 0.3), (0, 0, 1)),
        LinkJoint("bc", "prismatic", limits=(-1.0, 0.5)),
        LinkJoint("cd", "continuous", axis=(0, 0, 1), mimic=Mimic("ab", 2.0)),
    )


def test_a_mimic_of_a_mimic_follows_the_joint_that_is_read(tmp_path):
    more = joint("ce", "c", "e", '<mimic joint="cd" multiplier="3" offset="0.5"/>')
    path = written(tmp_path, robot(LINKS + link("e") + JOINTS + more))
    assert read_urdf(path, "a", "e")[-1].mimic == Mimic("ab", 6.0, 0.5)


def test_elsewhere_a_joint_may_be_of_any_type(tmp_path):
    more = link("world") + joint("wa", "world", "a", "", "floating")
    path = written(tmp_path, robot(LINKS + more + JOINTS))
    assert [j.name for j in read_urdf(path, "b", "d")] == ["bc", "cd"]


def changed(old, new):
    return robot(LINKS + JOINTS.replace(old, new))


BOMB = '<!DOCTYPE r [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;">]>'
MALFORMED = {
    "no XML": ("joints:\n  - a", "XML", "URDF"),
    "cut off": (robot(LINKS)[:-9], "XML", "URDF"),
    "another kind": ("<sdf><model/></sdf>", "<sdf>, not <robot>", "URDF"),
    "entities": (robot(LINKS + JOINTS, BOMB), "document type", "DOCTYPE"),
    "entities in UTF-16": (robot(LINKS, BOMB).encode("utf-16"), "document type", "DOCTYPE"),
    "external": (robot(LINKS, '<!DOCTYPE r SYSTEM "http://[::1]/r">'), "document", "DOCTYPE"),
    "xacro macro": (robot('<xacro:arm name="x"/>' + LINKS + JOINTS), "xacro", "expand it"),
    "xacro formula": (changed("1 2 3", "${height} 0 0"), "formula of xacro", "expand it"),
    "no link d": (robot(LINKS.replace('"d"', '"e"') + JOINTS), "'d'", "'e'"),
    "two links": (robot(LINKS + link("a") + JOINTS), "two links are called 'a'", "unique name"),
    "two joints": (changed('"bc"', '"ab"'), "two joints are called 'ab'", "unique name"),
    "no name": (robot(LINKS + "<link/>" + JOINTS), "a link has no name", "give it one"),
    "planar": (changed("prismatic", "planar"), "'bc' has the type 'planar'", "revolute"),
    "no type": (changed(' type="prismatic"', ""), "'bc' has no type", "revolute"),
    "no child": (changed('<child link="c"/>', ""), "'bc' names no child", "<child"),
    "zero axis": (changed("0 0 1", "0 0 0"), "(0, 0, 0)", "unit vector"),
    "long axis": (changed("0 0 1", "0 3 4"), "norm 5", "0 0.6 0.8"),
    "two numbers": (changed("1 2 3", "1 2"), "xyz='1 2' is not 3", "m and rad"),
    "comma": (changed("1 2 3", "1,5 2 3"), "is not 3 finite", "m and rad"),
    "not finite": (changed("0.1 0.2 0.3", "0 nan 0"), "is not 3 finite", "m and rad"),
    "mimic of none": (changed('joint="ab"', 'joint="ob"'), "mimics 'ob'", "'ab'"),
    "mimic of itself": (changed('joint="ab"', 'joint="cd"'), "mimics itself", "mimic"),
    "mimic of a fixed": (
        changed('joint="ab"', 'joint="x"').replace("</robot>", joint("x", "d", "e", "", "fixed"))
        + link("e") + "</robot>", "which is fixed", "moves",
    ),
    "two parents": (
        robot(LINKS + JOINTS + joint("ad", "a", "d")), "'cd' and 'ad'", "tree"
    ),
    "circle": (
        robot(LINKS + JOINTS.replace('parent link="a"', 'parent link="d"')), "'d'", "parent"
    ),
    "circle through the base": (
        robot(LINKS + JOINTS + joint("da", "d", "a")), "lead back to it", "parent"
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", MALFORMED)
def test_what_is_malformed_is_told(case, tmp_path):
    text, words, remedy = MALFORMED[case]
    with pytest.raises(InputError) as raised:
        read_urdf(written(tmp_path, text), "a", "d")
    assert words in str(raised.value)
    assert remedy in str(raised.value)
    assert "robot.urdf" in str(raised.value.place)
    assert raised.value.remedy


@pytest.mark.parametrize(
    ("base", "tip", "code", "stated", "remedy"),
    [
        ("base", "d", "unknown-name", ("'base'",), "known are 'a'"),
        ("a", "D", "unknown-name", ("'D'",), "did you mean 'd'"),
        ("d", "a", "unknown-name", ("'a'", "'d'"), "below 'd'"),
        ("b", "b", "conflicting-keys", ("'b'",), "moving joints"),
    ],
)
def test_links_that_make_no_chain_are_told(base, tip, code, stated, remedy, tmp_path):
    path = written(tmp_path, robot(LINKS + JOINTS))
    with refused(code, *stated) as raised:
        read_urdf(path, base, tip)
    assert remedy in str(raised.value.remedy)


def test_whatever_is_broken_it_is_told_or_read(tmp_path):
    """Bytes changed, lost and put in: no other error comes out."""
    whole, random = robot(LINKS + JOINTS).encode(), np.random.default_rng(1)
    pieces = [b"<", b'"', b"nan", b"${x}", b"</joint>", b"\0", b"<axis/>", b"1e999", b"<mimic/>"]
    told = []
    for _ in range(400):
        text = bytearray(whole)
        for at in random.integers(len(whole) - 40, size=random.integers(1, 4)).tolist():
            match random.integers(3):
                case 0:
                    text[at] = int(random.integers(256))
                case 1:
                    del text[at : at + int(random.integers(1, 30))]
                case _:
                    text[at:at] = pieces[random.integers(len(pieces))]
        try:
            read_urdf(written(tmp_path, bytes(text)), "a", "d")
        except InputError as error:
            told.append(error.remedy)
    assert len(told) > 300
    assert all(told)


def test_an_entity_is_never_expanded_nor_a_file_read(tmp_path):
    (tmp_path / "secret").write_text("0 0 1")
    head = f'<!DOCTYPE robot [<!ENTITY s SYSTEM "file://{tmp_path}/secret">]>'
    with refused("wrong-file-type"):
        read_urdf(written(tmp_path, robot(LINKS + JOINTS.replace("0 0 1", "&s;"), head)), "a", "d")


def test_a_machine_of_a_file_is_that_of_its_joints(tmp_path):
    path = written(tmp_path, robot(LINKS + JOINTS))
    machine = urdf_machine(path, "a", "d")
    assert machine.name == path.stem
    assert dict(machine.parameters) == dict(joint_chain(read_urdf(path, "a", "d")).parameters)
    tilted = urdf_machine(path, "a", "d", axes=True, name="Rob")
    assert tilted.name == "Rob"
    assert {n for n in tilted.parameters if "_axis_" in n} == {*tilted.parameters} - {
        *machine.parameters
    }
    with refused("unknown-name", "'nowhere'"):
        urdf_machine(path, "a", "nowhere")


def test_a_joint_may_have_the_name_of_the_usual_target(tmp_path):
    axis = '<axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/>'
    inside = link("base") + link("arm") + link("tip")
    inside += joint("j1", "base", "arm", axis) + joint("tool", "arm", "tip", kind="fixed")
    (tmp_path / "robot.urdf").write_text(f'<robot name="r">{inside}</robot>', "utf-8")
    table = {"type": "urdf", "file": "robot.urdf", "base": "base", "tip": "tip"}
    mechanism = mechanism_from_data(table, str(tmp_path / "mechanism.toml"))
    assert {"tool_x", "target_x"} <= {*mechanism.parameters.names}

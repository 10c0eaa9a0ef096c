"""A URDF patched in place: its author's bytes, and only the numbers of the origins changed."""

from __future__ import annotations

import codecs
import re
from dataclasses import replace

import numpy as np
import pytest

from loopcal.companions.robot.exports.urdf import UrdfSource, by_prefix, decimal
from loopcal.files.machines.urdf import read_urdf
from loopcal.mechanisms.chain import product
from loopcal.mechanisms.origins import calibrated_origins, joint_chain
from tests.reference.robots import CHAINS, urdf_of
from tests.refusals import refused

HOSTILE = """<?xml version="1.0" encoding="utf-8"?>
<!-- made by xacro <joint name="ab"><origin xyz="9 9 9"/></joint> -->
<u:robot name="r&amp;d" xmlns:u="http://example.org/u" xmlns:xacro="http://ros.org/wiki/xacro">
\t<material name='grey > "black"'/>
  <u:link name="a"/><link name="b"/><link name = "c" /><link name="d"/><link name="e"/>
  <link name="f"/><link name="&#103;"/>
  <joint name="ab" type="revolute">
    <!-- <origin xyz="8 8 8" rpy="0 0 0"/> --><![CDATA[ <origin xyz="7 7 7"/> ]]>
    <origin rpy = '0.1\t0.2  3e-1' xyz='1.50 2 3'   unknown="4 5 6" />
    <parent link="a"/><child link="b"/><axis xyz="0 0 1"/><calibration rising="0.5"/>
  </joint>
  <u:joint name="bc" type="revolute"><parent link="b"/><child link="c"/>
    <axis xyz="0 1 0"/></u:joint>
  <joint type="prismatic" name="cd"><origin xyz="0 0 &#49;"/><parent link="c"/>
    <child link="d"/></joint>
  <joint name="de" type="continuous"><origin/><parent link="d"/><child link="e"/>
    <mimic joint="ab" multiplier="2"/></joint>
  <joint name="ef" type="fixed"><origin rpy="0 1.57079632679 0"></origin><parent link="e"/>
    <child link="f"/></joint>
  <joint name="ag" type="revolute"><origin xyz="6 6 6" rpy="1 1 1"/><parent link="a"/>
    <child link="&#103;"/></joint>
  <transmission name="t"><joint name="ab"><origin xyz="5 5 5"/></joint></transmission>
</u:robot>
"""


def calibrated(path, base="a", tip="f", *, seed=0, apart=False, only=None):
    joints = read_urdf(path, base, tip)
    machine = joint_chain(joints)
    rng = np.random.default_rng(seed)
    values = {n: p.nominal for n, p in machine.parameters.items()}
    for name in values:
        if only is None or name in only:
            values[name] += 1e-3 * rng.normal()
    origins = calibrated_origins(joints, values, axes=False, apart=apart)
    return machine, values, origins


def written(folder, content, name="robot.urdf"):
    path = folder / name
    path.write_bytes(content)
    return path


ENCODED = {
    "LF": HOSTILE.encode(),
    "CRLF": HOSTILE.replace("\n", "\r\n").encode(),
    "BOM": codecs.BOM_UTF8 + HOSTILE.encode(),
    "blank lines ahead": b"\n\n" + HOSTILE.encode(),
    "Latin-1": HOSTILE.replace("utf-8", "iso-8859-1").replace("grey", "gr\xfcn").encode("latin-1"),
    "UTF-16": HOSTILE.replace("utf-8", "utf-16").encode("utf-16"),
}


@pytest.mark.parametrize("name", ENCODED)
def test_the_patched_file_is_the_calibrated_robot_and_a_fixed_point(name, tmp_path):
    path = written(tmp_path, ENCODED[name])
    machine, values, origins = calibrated(path)
    done = UrdfSource.of(path).patched(origins)
    after = written(tmp_path, done.content, "new.urdf")
    new = joint_chain(read_urdf(after, "a", "f"))
    nominal = {n: p.nominal for n, p in new.parameters.items()}
    q = {"ab": 0.3, "cd": 0.2, "bc": -0.7}
    expected = product(machine.chain, q, values)
    np.testing.assert_allclose(product(new.chain, q, nominal), expected, atol=1e-15 * 8)
    assert UrdfSource.of(after).patched(origins).content == done.content
    assert UrdfSource.of(after).patched(origins).changed == ()
    assert done.changed == ("ab", "bc", "cd", "de", "ef")
    assert any("<calibration>" in warning for warning in done.warnings)


@pytest.mark.parametrize("name", ["LF", "CRLF", "BOM"])
def test_all_bytes_but_the_values_of_changed_origins_stay(name, tmp_path):
    path = written(tmp_path, ENCODED[name])
    done = UrdfSource.of(path).patched(calibrated(path)[2])
    number = rb"[-+.\deE]+"
    three = rb"[ \t]+".join([number] * 3)
    xyz, rpy = rb'xyz="' + three + rb'"', rb'rpy="' + three + rb'"'
    expected = ENCODED[name]
    for old, new in [
        (b"rpy = '0.1\t0.2  3e-1' xyz='1.50 2 3'", rb"rpy = '%b' xyz='%b'" % (three, three)),
        (b'type="revolute"><parent link="b"',
         rb'type="revolute"><u:origin %b %b/><parent link="b"' % (xyz, rpy)),
        (b'xyz="0 0 &#49;"', xyz + b" " + rpy),
        (b"<origin/>", rb"<origin %b %b/>" % (xyz, rpy)),
        (b'rpy="0 1.57079632679 0"', rpy + b" " + xyz),
    ]:  # fmt: skip
        assert expected.count(old) == 1
        head, tail = expected.split(old)
        found = re.match(re.escape(head) + b"(" + new + b")", done.content)
        assert found, (old, done.content)
        expected = head + found[1] + tail
    assert done.content == expected


def test_numbers_that_did_not_change_keep_their_digits(tmp_path):
    path = written(tmp_path, ENCODED["LF"])
    done = UrdfSource.of(path).patched(calibrated(path, only={"ab_y"})[2])
    assert done.changed == ("ab",)
    head, tail = ENCODED["LF"].split(b"1.50 2 3")
    found = re.fullmatch(re.escape(head) + rb"1\.50 (\S+) 3" + re.escape(tail), done.content)
    assert found
    assert float(found[1]) != 2.0


def test_nothing_changes_where_nothing_was_calibrated(tmp_path):
    path = written(tmp_path, ENCODED["CRLF"])
    assert UrdfSource.of(path).patched(calibrated(path, only=())[2]).content == ENCODED["CRLF"]


def test_offsets_apart_leave_what_only_a_zero_changes(tmp_path):
    path = written(tmp_path, ENCODED["LF"])
    origins = calibrated(path, only={"bc_ry"}, apart=True)[2]
    assert [o.joint.name for o in origins if o.offset] == ["bc"]
    assert UrdfSource.of(path).patched(origins).content == ENCODED["LF"]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('xyz=\'1.50 2 3\'', 'xyz=\'1.51 2 3\''),
        ('<axis xyz="0 0 1"/>', '<axis xyz="0 0 -1"/>'),
        ('multiplier="2"', 'multiplier="3"'),
        ('name="ef" type="fixed"', 'name="ef" type="revolute"'),
        ('<joint type="prismatic" name="cd">', '<joint type="prismatic" name="xy">'),
    ],
)  # fmt: skip
def test_another_robot_is_refused(old, new, tmp_path):
    path = written(tmp_path, ENCODED["LF"])
    origins = calibrated(path)[2]
    other = written(tmp_path, ENCODED["LF"].replace(old.encode(), new.encode()), "other.urdf")
    with refused("unknown-name" if '"xy"' in new else "conflicting-keys"):
        UrdfSource.of(other).patched(origins)


def prefixed(one, prefix):
    mimic = one.joint.mimic and replace(one.joint.mimic, joint=prefix + one.joint.mimic.joint)
    joint = replace(one.joint, name=prefix + one.joint.name, mimic=mimic)
    return replace(one, joint=joint)


def test_each_of_two_robots_of_one_file_has_a_file_of_its_own(tmp_path):
    path = written(tmp_path, HOSTILE.encode())
    joints = ["ab", "bc", "cd", "de", "ef", "ag"]
    left, right = (calibrated(path, seed=seed)[2] for seed in (1, 2))
    both = [*(prefixed(one, "l_") for one in left), *(prefixed(one, "r_") for one in right)]
    mount = prefixed(replace(left[0], joint=replace(left[0].joint, name="mount")), "r_")
    robots = by_prefix([*both, mount], joints)
    assert list(robots) == ["l_", "r_"]
    for mine, alone in zip(robots.values(), (left, right), strict=True):
        written_alone = UrdfSource.of(path).patched(alone).content
        assert UrdfSource.of(path).patched(mine).content == written_alone
    assert by_prefix(left, joints) == {"": tuple(left)}
    assert by_prefix(both, ["other"]) == {"": tuple(both)}


def test_decimals_are_the_shortest_that_read_back():
    rng = np.random.default_rng(0)
    for value in (*rng.normal(size=200), *rng.normal(size=50) * 1e-12, 0.1, 1e22, -0.0, 3.0):
        assert float(decimal(value)) == value
        assert len(decimal(value)) <= len(repr(float(value)))


@pytest.mark.parametrize("name", ["Panda", "Tiago, from a lifting torso", "KR210", "UR5"])
@pytest.mark.parametrize("apart", [False, True])
def test_pinocchio_moves_the_patched_robot_as_we_do(name, apart, tmp_path):
    """Of robots of the description packages; `analyses/exports.py` does it for all of them."""
    pin = pytest.importorskip("pinocchio", reason="pin is not installed (make partners)")
    robot, base, tip = CHAINS[name]
    machine, values, origins = calibrated(urdf_of(robot), base, tip, apart=apart)
    path = written(tmp_path, UrdfSource.of(urdf_of(robot)).patched(origins).content)
    offsets = {one.joint.name: one.offset for one in origins}
    model = pin.buildModelFromUrdf(str(path), mimic=True)
    data = model.createData()
    bottom, top = (model.getFrameId(link) for link in (base, tip))
    rng = np.random.default_rng(5)
    for _ in range(20):
        q = {n: rng.uniform(-3, 3) for n in machine.quantities}
        configuration = pin.neutral(model)
        for joint, reading in q.items():
            value = reading + offsets.get(joint, 0.0)
            its = model.joints[model.getJointId(joint)]
            own = [np.cos(value), np.sin(value)] if its.nq == 2 else [value]
            configuration[its.idx_q : its.idx_q + its.nq] = own
        pin.framesForwardKinematics(model, data, configuration)
        found = (data.oMf[bottom].inverse() * data.oMf[top]).homogeneous
        np.testing.assert_allclose(found, product(machine.chain, q, values), atol=1e-12)

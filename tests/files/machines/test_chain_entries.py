"""Machines of the types urdf and exponentials: read, written, read again, and refused."""

from __future__ import annotations

import tomllib
from typing import Any

import pytest

from loopcal.errors import InputError
from loopcal.files.machines.mechanism_file import mechanism_from_data, read_mechanism
from loopcal.files.machines.mechanism_writer import mechanism_to_toml
from loopcal.files.project.project_file import read_project
from loopcal.files.project.templates import template_files

PROJECT = tomllib.loads(template_files("urdf", "NAME")["project.toml"])
ROBOT = PROJECT["mechanism"]
SCREWS = {
    k: v
    for k, v in tomllib.loads(template_files("exponentials", "NAME")["mechanism.toml"]).items()
    if k != "schema"
}
LISTED: dict[str, Any] = {
    "type": "urdf",
    "units": {"length": "mm", "angle": "deg"},
    "joint": [
        {"name": "lift", "kind": "prismatic", "axis": [0, 0, 1], "limits": [0, 350]},
        {"name": "elbow", "xyz": [1, 2, 3], "rpy": [0, 90, 0], "axis": [0.6, 0, 0.8]},
        {"name": "plate", "kind": "fixed", "xyz": [0, 0, 100]},
        {"name": "wrist", "axis": [0, 1, 0], "mimic": {"joint": "elbow", "multiplier": -0.5}},
        {"name": "turn", "xyz": [0, 200, 0], "axis": [0, 0, -1]},
    ],
}


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "robot.urdf").write_text(template_files("urdf", "NAME")["robot.urdf"])
    return tmp_path


def made(folder, data):
    return mechanism_from_data(data, str(folder / "project.toml"))


DESCRIBED = {
    "URDF": ROBOT,
    "URDF with axes": ROBOT | {"axes": True},
    "everything free": ROBOT | {"fix_redundant": False},
    "listed": LISTED,
    "exponentials": SCREWS,
    "effects": ROBOT
    | {
        "effect": [{"type": "harmonics", "joints": ["joint_1"]}],
        "parameters": {"joint_1_sin*": {"sd": 1e-4}, "joint_2_x": {"sd": 1e-3}},
    },
    "pose": ROBOT | {"instrument": [{"type": "pose", "station": "tracker"}]},
}


@pytest.mark.parametrize("name", DESCRIBED)
def test_what_is_written_is_the_same_machine_in_any_folder(name, folder, tmp_path_factory):
    arm = made(folder, DESCRIBED[name])
    other = tmp_path_factory.mktemp("other") / "mechanism.toml"
    moved = arm.with_nominal({p.name: p.nominal + 1 / 3 for p in arm.parameters})
    other.write_text(mechanism_to_toml(moved))
    again = read_mechanism(other)
    assert again.tape == arm.tape
    assert again.parameters == moved.parameters
    assert again.remarks == arm.remarks
    assert again.name == arm.name
    assert mechanism_to_toml(again) == other.read_text()


def test_by_itself_the_identifiable_parameters_are_free(folder):
    arm = made(folder, ROBOT)
    assert len(arm.parameters.free) == 27
    assert len(arm.remarks) == len(arm.parameters) - 27
    assert all(p.name in arm.remarks[0] for p in arm.parameters if p.name == "joint_1_x")
    assert len(made(folder, ROBOT | {"fix_redundant": False}).parameters.free) == 51
    assert len(made(folder, SCREWS).parameters.free) == 27


def test_what_the_file_says_of_parameters_is_heeded(folder):
    stated = {"base_*": {"fixed": True}, "joint_6_z": {"fixed": False}}
    arm = made(folder, ROBOT | {"parameters": ROBOT["parameters"] | stated})
    assert len(arm.parameters.free) == 27
    assert {"joint_1_x", "joint_1_rz", "joint_6_z"} <= set(arm.parameters.free)
    assert not [r for r in arm.remarks if r.startswith("'base_")]
    every = made(folder, ROBOT | {"parameters": {"*": {"fixed": False}}})
    assert len(every.parameters.free) == 51
    assert every.remarks == ()


@pytest.mark.parametrize("apart", [False, True])
def test_what_a_project_says_of_parameters_is_heeded_as_well(apart, folder):
    text = template_files("urdf", "NAME")["project.toml"]
    if apart:  # the mechanism in a file of its own
        at, end = text.index("[mechanism]"), text.index("[data]")
        mechanism = text[at:end].replace("[mechanism]\n", "schema = 1\n", 1)
        (folder / "arm.toml").write_text(mechanism.replace("[mechanism.", "["))
        text = text[:at] + '[mechanism]\nfile = "arm.toml"\n' + text[end:]
    text = text.replace("[prior]", '[parameters]\n"base_*" = { fixed = true }\n[prior]')
    text = text[: text.index("\n[simulation]")] + "\n[prior.tool_z]\nsd = 1e-3\n"
    (folder / "project.toml").write_text(text)
    free = read_project(folder / "project.toml").mechanism.parameters.free
    assert not [n for n in free if n.startswith("base_")]
    assert {"joint_1_x", "joint_1_rx"} <= set(free)
    assert len(free) == 28  # 27, and one that the prior makes room for


def test_a_target_left_at_nothing_is_taken_to_be_off_the_last_axis(folder):
    unsaid = {k: v for k, v in ROBOT.items() if k != "parameters"}
    assert len(made(folder, unsaid).parameters.free) == 27
    # one that is said to stand on the last axis sees two directions of that axis less
    on_axis = {f"tool_{a}": {"value": 0.0} for a in "xyz"}
    assert len(made(folder, unsaid | {"parameters": on_axis}).parameters.free) == 25


@pytest.mark.parametrize(("kind", "whole"), [("socket", 23), ("draw-wire", 25), ("pose", 30)])
def test_whatever_looks_at_it_what_it_tells_is_estimated(kind, whole, folder):
    arm = made(folder, ROBOT | {"instrument": [{"type": kind}]})
    assert len(arm.parameters.free) == whole


def test_an_arm_by_denavit_and_hartenberg_can_have_it_too(tmp_path):
    text = template_files("serial", "NAME")["mechanism.toml"]
    data = {k: v for k, v in tomllib.loads(text).items() if k != "schema"}
    by_hand = mechanism_from_data(data, "")
    assert by_hand.remarks == ()
    bare = {k: v for k, v in data.items() if k != "parameters"}
    assert len(mechanism_from_data(bare, "").parameters.free) == 33
    chosen = mechanism_from_data(bare | {"fix_redundant": True}, "")
    assert chosen.parameters == by_hand.parameters
    assert len(chosen.remarks) == 6
    (tmp_path / "arm.toml").write_text(mechanism_to_toml(chosen))
    again = read_mechanism(tmp_path / "arm.toml")
    assert (again.parameters, again.remarks) == (chosen.parameters, chosen.remarks)


def test_numbers_listed_are_in_the_units_of_the_file(folder):
    arm = made(folder, LISTED)
    assert arm.parameters["elbow_z"].nominal == pytest.approx(0.003, abs=1e-18)
    assert arm.quantities["lift"] == "m"
    assert set(arm.quantities) == {"lift", "elbow", "turn", "x", "y", "z"}
    joints = arm.description["joints"]
    assert joints[0].limits == pytest.approx((0.0, 0.35))
    assert joints[1].rpy[1] == pytest.approx(1.5707963267948966)


def without(data, *keys):
    return {k: v for k, v in data.items() if k not in keys}


def joint(**changes):
    first = LISTED["joint"][0] | changes
    return LISTED | {"joint": [first, *LISTED["joint"][1:]]}


def screw(**changes):
    return SCREWS | {"joint": [SCREWS["joint"][0] | changes, *SCREWS["joint"][1:]]}


MALFORMED = {
    "no file": (without(ROBOT, "file"), "file", "neither a file nor joints", "robot.urdf"),
    "both": (ROBOT | {"joint": LISTED["joint"]}, "joint", "a file and joints", "robot.urdf"),
    "no base": (without(ROBOT, "base"), "project", "'base'", "base ="),
    "missing file": (ROBOT | {"file": "robo.urdf"}, "robo.urdf", "no such file", "robot.urdf"),
    "variable": (ROBOT | {"file": "${NOWHERE_SET}/r.urdf"}, "file", "NOWHERE_SET", "export"),
    "wrong link": (ROBOT | {"tip": "tool1"}, "robot.urdf", "no link 'tool1'", "'tool0'"),
    "only fixed": (ROBOT | {"base": "link_6"}, "project", "fixed", "moving joints"),
    "no axis": (joint(axis=None), "joint[1]", "'lift' has no axis", "axis ="),
    "long axis": (joint(axis=[0, 0, 10]), "joint[1]", "norm 10", "0 0 1"),
    "limits": (joint(limits=[2, 1]), "joint[1].limits", "from 2 to 1", "lower one first"),
    "one name": (joint(name="elbow"), "project", "'elbow'", "unique name"),
    "station": (joint(name="base"), "instrument", "of a joint and", "differently"),
    "target": (
        joint(name="tool") | {"instrument": [{"type": "point"}]},
        "instrument",
        "of a joint and",
        "differently",
    ),
    "screw": (screw(axis=[1, 1, 1]), "joint[1]", "norm 1.73205", "0.577350269"),
    "screw limits": (screw(limits=[1, 1]), "joint[1].limits", "from 1 to 1", "lower"),
    "unknown key": (screw(pont=[0, 0, 0]), "joint[1].pont", "unknown key 'pont'", "'point'"),
    "two numbers": (screw(point=[0, 0]), "joint[1].point", "3", ""),
    "parameter": (ROBOT | {"parameters": {"joint_9_x": 1.0}}, "parameters", "joint_9_x", "joint_"),
}


@pytest.mark.parametrize("case", MALFORMED)
def test_what_does_not_fit_is_told_with_its_place(case, folder):
    data, place, words, remedy = MALFORMED[case]
    data = {k: v for k, v in data.items() if v is not None}
    if isinstance(data.get("joint"), list):
        listed = [{k: v for k, v in j.items() if v is not None} for j in data["joint"]]
        data["joint"] = listed
    with pytest.raises(InputError) as raised:
        made(folder, data)
    assert place in str(raised.value.place)
    assert words in str(raised.value)
    assert remedy in str(raised.value.remedy)

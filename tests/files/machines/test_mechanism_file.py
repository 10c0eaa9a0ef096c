"""Mechanism files as people write them: forms, units, defaults, and every way to be wrong."""

from __future__ import annotations

import math
import tomllib
from pathlib import Path

import pytest

from loopcal.errors import InputError
from loopcal.files.machines.mechanism_file import mechanism_from_data, read_mechanism
from loopcal.files.machines.mechanism_writer import mechanism_to_toml
from loopcal.files.toml.place import Place
from loopcal.files.toml.reader import toml_data
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.planar import NOMINAL, motoman_ma1400, planar_two_link
from loopcal.mechanisms.serial import Joint, serial_arm
from tests.refusals import refused

SERIAL = """
type = "serial"
name = "two joints"
units = { length = "mm", angle = "deg" }
base = { x = 10, rz = 90 }
tool = { z = { value = 0.1, unit = "m" } }
[[joint]]
name = "q1"
form = "dh"
a = 150
alpha = { value = 0.5, unit = "rad" }
before = { rx = 90, tz = 10 }
[[joint]]
name = "q2"
form = "mdh"
kind = "prismatic"
direction = -1
d = { value = 2, unit = "in" }
after = { ry = { value = 1, unit = "mrad" } }
[parameters]
"alpha_*" = { sd = 1, fixed = true }
"a_*" = { sd = 0.5 }
a_1 = { value = 0.151, unit = "m" }
offset_2 = 180
"""


def read(text: str, **options) -> Mechanism:
    return mechanism_from_data(toml_data(text, "arm.toml"), Place("arm.toml"), **options)


def refusal(text: str, **options) -> InputError:
    with pytest.raises(InputError) as caught:
        read(text, **options)
    assert caught.value.remedy
    return caught.value


def test_every_number_may_have_its_own_unit_or_the_files():
    arm = read(SERIAL)
    nominal = {p.name: p.nominal for p in arm.parameters}
    assert arm.name == "two joints"
    assert nominal["base_x"] == pytest.approx(0.01)
    assert nominal["base_rz"] == pytest.approx(math.pi / 2)
    assert nominal["alpha_1"] == 0.5
    assert nominal["d_2"] == pytest.approx(0.0508)
    assert nominal["tool_z"] == 0.1
    assert nominal["offset_2"] == pytest.approx(math.pi)
    assert nominal["d_1"] == nominal["tool_x"] == 0.0


def test_the_parameters_table_wins_over_the_joints_and_later_lines_win():
    parameters = read(SERIAL).parameters
    assert parameters["a_1"].nominal == 0.151
    assert parameters["a_1"].prior_sd == pytest.approx(0.0005)
    assert parameters["alpha_1"].fixed
    assert parameters["alpha_2"].prior_sd == pytest.approx(math.radians(1))
    assert not parameters["a_2"].fixed
    assert math.isinf(parameters["d_2"].prior_sd)


def test_joints_have_their_form_kind_direction_and_fixed_motions():
    joints = [
        Joint("q1", "dh", before={"rx": math.radians(90), "tz": 10 * 1e-3}),
        Joint("q2", "mdh", "prismatic", -1, after={"ry": 1e-3}),
    ]
    assert read(SERIAL).tape == serial_arm(joints, {}, name="two joints").tape


def test_without_units_numbers_are_si():
    arm = read('type = "serial"\n[[joint]]\nname = "q"\na = 0.1\nalpha = 1\n')
    assert arm.parameters["a_1"].nominal == 0.1
    assert arm.parameters["alpha_1"].nominal == 1.0


@pytest.mark.parametrize(
    ("base", "form", "expected"),
    [
        ("", "dh", True),
        ("base = false", "dh", False),
        ("base = true", "dh", True),
        ("base = {}", "dh", True),
        ("", "transition-z", False),
        ("base = { x = 1 }", "transition-z", True),
    ],
)
def test_a_base_is_there_unless_transitions_hold_the_placement(base, form, expected):
    arm = read(f'type = "serial"\n{base}\n[[joint]]\nname = "q"\nform = "{form}"\n')
    assert ("base_x" in arm.parameters.names) == expected


def test_the_measured_point_may_have_other_names():
    arm = read('type = "serial"\npoint = ["u", "v", "w"]\n[[joint]]\nname = "q"\n')
    assert arm.outputs == ("u", "v", "w")


def test_the_tool_of_transitions_has_the_seeds_names():
    arm = read('type="serial"\ntool={x=1}\n[[joint]]\nname="q"\nform="transition-z"\n')
    assert arm.parameters["x1B"].nominal == 1.0


def test_the_motoman_is_ready_made():
    arm = read('type = "motoman-ma1400"')
    assert arm.tape == motoman_ma1400().tape
    assert arm.parameters == motoman_ma1400().parameters
    assert len(arm.parameters) == 27
    assert {n: arm.parameters[n].nominal for n in NOMINAL} == NOMINAL


def test_the_motoman_may_be_turned_before_its_first_joint():
    arm = read('type = "motoman-ma1400"\nunits = { angle = "deg" }\nbefore = { rz = 90 }')
    assert arm.tape == motoman_ma1400(before={"rz": math.radians(90)}).tape


def test_the_planar_arm_takes_its_values_from_the_parameters():
    arm = read('type = "planar-two-link"\n[parameters]\nl2 = { value = 700, unit = "mm" }\n')
    assert arm.parameters == planar_two_link({"l2": 700 * 1e-3}).parameters
    assert arm.tape == planar_two_link().tape


FUNCTION = """
type = "function"
quantities = { a = "mm", b = "m" }
outputs = ["b"]
loops = ["balance"]
[parameters]
gain = { value = 2, unit = "1", sd = 0.1 }
shift = { value = 3, unit = "mm" }
"s*" = { fixed = true }
"""


def balance(x, p):
    return [x.a * p.gain + p.shift - x.b]


def test_a_function_is_declared_and_given_beside():
    made = read(FUNCTION, function=balance)
    assert dict(made.quantities) == {"a": "m", "b": "m"}
    assert made.tape.loops == ("balance",)
    assert made.parameters["gain"].prior_sd == 0.1
    assert made.parameters["shift"].nominal == pytest.approx(0.003)
    assert made.parameters["shift"].fixed


def test_a_function_may_be_a_whole_mechanism_whose_values_the_file_replaces():
    whole = Mechanism.from_function(
        balance, {"a": "m", "b": "m"}, {"gain": (1.0, "1"), "shift": (0.0, "m")}, ("b",)
    )
    made = read(FUNCTION, function=whole)
    assert made.tape == whole.tape
    assert made.parameters["gain"].nominal == 2.0


@pytest.mark.parametrize(
    ("text", "place", "words"),
    [
        ("", "arm.toml", "type is missing"),
        ('type = "seril"', "arm.toml: type", "'seril'"),
        ("type = 3", "arm.toml: type", "3"),
        ('type = "serial"', "arm.toml", "'joint' is missing"),
        ('type = "serial"\njoint = []', "arm.toml: joint", "too few"),
        ('type = "serial"\njoint = 3', "arm.toml: joint", "list"),
        ('type = "serial"\n[[joint]]', "arm.toml: joint[1]", "'name' is missing"),
        ('type="serial"\njoint=[{name="q"},{name="r",form="hd"}]', "joint[2].form", "'hd'"),
        ('type="serial"\njoint=[{name="q",kind="rotary"}]', "joint[1].kind", "'rotary'"),
        ('type="serial"\njoint=[{name="q",direction=2}]', "joint[1].direction", "2"),
        ('type="serial"\njoint=[{name="q",offst=2}]', "joint[1].offst", "unknown key"),
        ('type="serial"\njoint=[{name="q",beta=2}]', "joint[1].beta", "has no 'beta'"),
        ('type="serial"\njoint=[{name="q",a="1 mm"}]', "joint[1].a", "'1 mm'"),
        ('type="serial"\njoint=[{name="q",a=nan}]', "joint[1].a", "nan"),
        ('type="serial"\njoint=[{name="q",a=inf}]', "joint[1].a", "inf"),
        ('type="serial"\njoint=[{name="q",a=true}]', "joint[1].a", "True"),
        ('type="serial"\njoint=[{name="q",a={value=1,unit="deg"}}]', "joint[1].a", "angle"),
        ('type="serial"\njoint=[{name="q",a={unit="mm"}}]', "joint[1].a", "'value' is missing"),
        ('type="serial"\njoint=[{name="q",a={value=1,unit="mn"}}]', "joint[1].a.unit", "'mn'"),
        ('type="serial"\njoint=[{name="q",before={rq=1}}]', "joint[1].before.rq", "'rq'"),
        ('type="serial"\njoint=[{name="q"},{name="q"}]', "joint[2].name", "'q'"),
        ('type="serial"\njoint=[{name="x"}]', "arm.toml: point", "'x'"),
        ('type="serial"\njoint=[{name="q*"}]', "arm.toml", "'q*'"),
        ('type="serial"\npoint=["x","y"]\njoint=[{name="q"}]', "arm.toml: point", "too few"),
        ('type="serial"\nbase=3\njoint=[{name="q"}]', "arm.toml: base", "3"),
        ('type="serial"\nbase={rr=1}\njoint=[{name="q"}]', "arm.toml: base.rr", "unknown key"),
        ('type="serial"\nunits={length="deg"}\njoint=[{name="q"}]', "units.length", "angle"),
        ('type="serial"\nunits={mass="kg"}\njoint=[{name="q"}]', "units.mass", "unknown key"),
        ('type="planar-two-link"\nparameters={l4=1}', "parameters.l4", "'l4'"),
        ('type="planar-two-link"\nparameters={"k*"=1}', 'parameters."k*"', "'k*'"),
        ('type="planar-two-link"\nparameters={l2=nan}', "parameters.l2", "nan"),
        ('type="planar-two-link"\nparameters={l2={sd=-1}}', "parameters.l2.sd", "-1"),
        ('type="planar-two-link"\nparameters={l2={sd=nan}}', "parameters.l2.sd", "nan"),
        ('type="planar-two-link"\nparameters={l2={sd=0,fixed=false}}', "parameters.l2", "fixes"),
        ('type="planar-two-link"\nparameters={l2={fixed=1}}', "parameters.l2.fixed", "true or"),
        ('type="planar-two-link"\nparameters={phi20={value=1,unit="m"}}', "phi20.unit", "length"),
        ('type="planar-two-link"\nname=1', "arm.toml: name", "text in quotes"),
        ('type="planar-two-link"\nparameters={l2=' + "9" * 400 + "}", "parameters.l2", "64 bits"),
        ('type="planar-two-link"\njoint=[]', "arm.toml: joint", "unknown key"),
    ],
)
def test_what_does_not_fit_is_refused_at_its_place(text, place, words):
    error = refusal(text)
    assert place in str(error.place)
    assert words in str(error)


@pytest.mark.parametrize(
    ("text", "remedy"),
    [
        ('type = "seril"', "'serial'"),
        ('type="serial"\njoint=[{name="q",offst=2}]', "'offset'"),
        ('type="serial"\njoint=[{name="q",form="haiati"}]', "'hayati'"),
        ('type="planar-two-link"\nparameters={phi2=1}', "'phi20'"),
        ('type="planar-two-link"\nunits={lenght="mm"}', "'length'"),
    ],
)
def test_the_nearest_known_spelling_is_named(text, remedy):
    assert f"did you mean {remedy}" in str(refusal(text).remedy)


def test_several_mistakes_are_counted_in_one_message():
    error = refusal('type="serial"\nname=1\njoint=[{name=3},{name="q",form="x"}]')
    assert error.place == "arm.toml: name"
    assert "also wrong: joint[1].name, joint[2].form" in error.message


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (FUNCTION.replace('unit = "1", ', ""), "without a unit"),
        (FUNCTION.replace('quantities = { a = "mm", b = "m" }\n', ""), "no quantity is declared"),
        (FUNCTION.replace("gain", "gian"), "gain"),
        (FUNCTION.replace('["b"]', '["c"]'), "'c'"),
    ],
)
def test_a_function_that_does_not_fit_its_declaration_is_refused(text, words):
    assert words in str(refusal(text, function=balance))


def test_a_function_has_to_be_named_and_only_where_it_is_asked_for():
    assert "--mechanism FILE.py:FUNCTION" in refusal(FUNCTION).text
    assert "mechanism=FILE.py:FUNCTION" in str(refusal(FUNCTION))
    assert "a function is named" in str(refusal('type = "motoman-ma1400"', function=balance))


def test_a_mechanism_with_other_quantities_than_declared_is_refused():
    other = Mechanism.from_function(
        lambda x, p: x.a * p.gain - x.c, {"a": "rad", "c": "m"}, {"gain": (1.0, "1")}
    )
    error = refusal(FUNCTION, function=other)
    assert error.place == "arm.toml: quantities.a"


def test_a_file_is_read_from_the_disk(tmp_path: Path):
    path = tmp_path / "arm.toml"
    path.write_text('schema = 1\ntype = "planar-two-link"\n', "utf-8")
    assert read_mechanism(path).tape == planar_two_link().tape
    path.write_text('type = "planar-two-link"\n', "utf-8")
    with refused("wrong-schema"):
        read_mechanism(path)


ROD = """
type = "function"
quantities = { slide = "m", height = "m" }
home = { height = { value = 400, unit = "mm" } }
parameters = { rod = { value = 0.5, unit = "m" } }
"""


def rod(x, p):
    return x.slide * x.slide + x.height * x.height - p.rod * p.rod


def test_a_function_says_where_what_nobody_reads_usually_stands():
    made = read(ROD, function=rod)
    assert made.home == {"height": 0.4}
    data = tomllib.loads(mechanism_to_toml(made))
    data.pop("schema")
    again = mechanism_from_data(data, Place("x"), function=rod)
    assert again.home == made.home
    whole = Mechanism.from_function(
        rod, {"slide": "m", "height": "m"}, {"rod": (1.0, "m")}, home={"height": -0.1}
    )
    assert whole.home == {"height": -0.1}
    assert read(ROD, function=whole).home == {"height": 0.4}


def test_a_home_names_quantities():
    text = ROD.replace("home = { height", "home = { heigth")
    for function in (rod, read(ROD, function=rod)):
        with pytest.raises(InputError, match="height") as caught:
            read(text, function=function)
        assert caught.value.code == "unknown-name"

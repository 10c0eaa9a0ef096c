"""Project files: what is read becomes our types, and what does not fit is refused at its place."""

from __future__ import annotations

import io
import json
import math
import subprocess
import sys
from pathlib import Path

import pytest

from loopcal.errors import InputError
from loopcal.estimation.fit import STARTS, Fit
from loopcal.estimation.methods.registry import METHODS
from loopcal.files.project.project_file import Project, read_project
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.planar import planar_two_link

PLANAR = 'schema = 1\n[mechanism]\ntype = "planar-two-link"\n'


def read(text: str, **options) -> Project:
    return read_project("-", text=text, **options)


def planar(text: str) -> Project:
    return read(PLANAR + text)


def refused(text: str, **options) -> InputError:
    with pytest.raises(InputError) as caught:
        read(text, **options)
    assert caught.value.remedy
    return caught.value


def test_the_shortest_project():
    project = planar("")
    assert project.mechanism.tape == planar_two_link().tape
    assert project.title == "planar two-link arm"
    assert (project.data, project.simulation, project.path) == (None, None, None)
    assert project.fit.settings == Fit(method="auto", start="auto")


def test_the_project_of_the_contract(tmp_path: Path):
    (tmp_path / "ma1400.toml").write_text('schema = 1\ntype = "motoman-ma1400"\n', "utf-8")
    path = tmp_path / "left.toml"
    columns = "\n".join(f'theta_{i} = {{ column = "{c}" }}' for i, c in enumerate("LURBT", 2))
    path.write_text(
        f"""
schema = 1
title = "MA1400 left arm, Leica tracker"
[mechanism]
file = "ma1400.toml"
[data]
file = "left_arm_grid.csv"
pose = "pose"
exclude = [13]
[data.columns]
theta_1 = {{ column = "S", unit = "rad" }}
{columns}
x = {{ column = "x", unit = "m", sd_column = "u_x" }}
y = "y"
z = 10
[noise]
"theta_*" = {{ sd = 5e-5, unit = "rad" }}
"xyz" = {{ sd = 10e-6, unit = "m" }}
[prior]
"*" = {{ sd = inf }}
"z*" = {{ sd = 1.0, unit = "mm" }}
[parameters]
"z6B" = {{ value = 0.35, unit = "m", fixed = false }}
[fit]
method = "least-squares"
""",
        "utf-8",
    )
    project = read_project(path)
    assert project.title == "MA1400 left arm, Leica tracker"
    assert (project.path, project.folder) == (path, tmp_path)
    assert project.mechanism.parameters["z6B"].nominal == 0.35
    assert project.mechanism.parameters["z2"].prior_sd == pytest.approx(1e-3)
    assert math.isinf(project.mechanism.parameters["x1"].prior_sd)
    assert project.data is not None
    assert project.data.file == "left_arm_grid.csv"
    assert project.data.exclude == (13,)
    assert project.data.columns["x"].sd_column == "u_x"
    assert project.data.columns["z"].column == 10
    assert project.noise.sd_of("theta_3") == 5e-5
    assert project.noise.sd_of("y") == 10e-6
    assert project.fit.settings.method.name == "least-squares"


def test_without_columns_each_quantity_has_its_own_name_and_the_files_unit():
    project = planar('[data]\nfile = "p.csv"\nunits = { angle = "deg" }\n')
    assert project.data is not None
    columns = project.data.columns
    assert {q: c.column for q, c in columns.items()} == {q: q for q in planar_two_link().quantities}
    assert (columns["phi2"].unit, columns["xP"].unit) == ("deg", None)


def test_a_column_may_state_another_unit_than_the_file():
    table = 'xP = "a"\nyP = "b"\nphi3 = "c"\nphi2 = { column = 4, unit = "mrad" }\n'
    units = 'units = { length = "mm", angle = "deg" }'
    project = planar(f'[data]\nfile = "p.csv"\n{units}\n[data.columns]\n{table}')
    assert project.data is not None
    assert {q: c.unit for q, c in project.data.columns.items()} == {
        "xP": "mm",
        "yP": "mm",
        "phi2": "mrad",
        "phi3": "deg",
    }


def test_what_nobody_measures_needs_no_column():
    project = planar('[noise]\nphi3 = inf\n[data]\nfile="p"\ncolumns={xP="x",yP="y",phi2="a"}')
    assert project.data is not None
    assert set(project.data.columns) == {"xP", "yP", "phi2"}


def test_priors_and_overrides_go_by_name_or_glob_and_later_lines_win():
    parameters = planar(
        '[prior]\n"*" = inf\n"l?" = { sd = 2, unit = "mm" }\nl3 = 0.5\n'
        '[parameters]\n"phi*" = { fixed = true }\nl2 = { value = 700, unit = "mm", sd = 9 }\n'
    ).mechanism.parameters
    assert parameters["l2"].prior_sd == pytest.approx(2e-3)
    assert parameters["l3"].prior_sd == 0.5
    assert parameters["l2"].nominal == pytest.approx(0.7)
    assert parameters.free == ("xA", "yA", "l2", "l3")


def test_an_sd_of_zero_fixes_a_parameter():
    assert planar("[prior]\nl2 = 0").mechanism.parameters["l2"].fixed


def test_the_project_as_read_fits_into_json():
    inputs = planar('[prior]\n"*" = { sd = inf }\n[parameters]\nl2 = 1\n').inputs
    assert json.loads(json.dumps(inputs, allow_nan=False)) == {
        "schema": 1,
        "mechanism": {"type": "planar-two-link"},
        "prior": {"*": {"sd": "inf"}},
        "parameters": {"l2": 1},
    }


def test_standard_input_is_a_project_too(monkeypatch):
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(PLANAR.encode())))
    project = read_project("-")
    assert (project.name, project.folder) == ("standard input", Path())


def test_a_file_gives_its_name_where_there_is_no_title(tmp_path):
    path = tmp_path / "left.toml"
    path.write_text(PLANAR, "utf-8")
    assert read_project(path).title == "left"
    assert read_project(str(path)).name == str(path)


def test_an_inline_serial_arm():
    text = 'schema=1\n[mechanism]\ntype="serial"\n[[mechanism.joint]]\nname="q"\n'
    assert "a_1" in read(text).mechanism.parameters.names


FUNCTION = """schema = 1
[mechanism]
type = "function"
quantities = { a = "m", b = "m" }
outputs = ["b"]
[parameters]
gain = { value = 2, unit = "1" }
shift = { value = 5, unit = "mm", fixed = true }
"g*" = { sd = 0.25 }
"""


def loops(x, p):
    return [x.a * p.gain + p.shift - x.b]


def test_a_function_may_declare_its_parameters_in_the_project():
    mechanism = read(FUNCTION, mechanism=loops).mechanism
    assert mechanism.parameters["gain"].prior_sd == 0.25
    assert mechanism.parameters["shift"].nominal == pytest.approx(0.005)
    assert mechanism.outputs == ("b",)


def test_a_project_without_mechanism_takes_a_whole_one():
    assert read("schema = 1\n", mechanism=planar_two_link()).mechanism == planar_two_link()


@pytest.mark.parametrize(
    ("text", "given", "place", "words"),
    [
        ("schema = 1", None, "standard input", "describes no mechanism"),
        ("schema = 1", loops, "standard input", "declares no quantities"),
        (PLANAR, loops, "mechanism", "a function is named"),
        (FUNCTION, None, "mechanism", "Python function"),
        (FUNCTION.replace("gain", "gian"), loops, "mechanism", "gain"),
        (FUNCTION.replace('unit = "mm", ', ""), loops, "parameters.shift", "without a unit"),
        (FUNCTION.replace("value = 2, ", ""), loops, "parameters.gain", "without a value"),
    ],
)
def test_a_mechanism_is_described_once(text, given, place, words):
    error = refused(text, mechanism=given)
    assert place in str(error.place)
    assert words in error.message


@pytest.mark.parametrize(
    ("text", "place", "words"),
    [
        ("[dta]", "dta", "unknown key"),
        ("[data]", "data", "'file' is missing"),
        ("[data]\nfile = 3", "data.file", "text in quotes"),
        ('[data]\nfile = "p"\ncolunms = {}', "data.colunms", "unknown key"),
        ('[data]\nfile = "p"\nevery = 0', "data.every", "too small"),
        ('[data]\nfile = "p"\nevery = 1.5', "data.every", "whole number"),
        ('[data]\nfile = "p"\nexclude = 3', "data.exclude", "list"),
        ('[data]\nfile = "p"\nexclude = [1, 2.5]', "data.exclude[2]", "2.5"),
        ('[data]\nfile = "p"\nheader = 1', "data.header", "true or false"),
        ('[data]\nfile = "p"\ndecimal = ";"', "data.decimal", "';'"),
        ('[data]\nfile = "p"\nunits = { angle = "mm" }', "data.units.angle", "length"),
        ('[data]\nfile="p"\ncolumns={phi4="a"}', "data.columns.phi4", "no quantity 'phi4'"),
        ('[data]\nfile="p"\ncolumns={xP=true}', "data.columns.xP", "True"),
        ('[data]\nfile="p"\ncolumns={xP={unit="m"}}', "data.columns.xP", "'column' is missing"),
        ('[data]\nfile="p"\ncolumns={xP={column=1,unit="deg"}}', "data.columns.xP.unit", "angle"),
        ('[data]\nfile="p"\ncolumns={xP={column=1,unit="mn"}}', "data.columns.xP.unit", "'mn'"),
        ('[data]\nfile="p"\ncolumns={xP={column=1,sd_unit="m"}}', "data.columns.xP", "sd_unit"),
        ('[data]\nfile="p"\ncolumns={xP={column=1,sd_at_least=1}}', "data.columns.xP", "sd_at"),
        ("[noise]\nphi2 = -1", "noise.phi2", "negative"),
        ("[noise]\nphi2 = nan", "noise.phi2", "nan"),
        ("[noise]\nphi2 = { sd = -0.1 }", "noise.phi2.sd", "-0.1"),
        ('[noise]\nphi2 = "1 mrad"', "noise.phi2", "'1 mrad'"),
        ('[noise]\nphi2 = { sd = 1, unit = "mm" }', "noise.phi2.unit", "length"),
        ('[noise]\n"*" = { sd = 1, unit = "mm" }', 'noise."*".unit', "angle"),
        ("[noise]\nphi9 = 1", "noise.phi9", "'phi9'"),
        ("[noise]\nphi2 = { unit = 'rad' }", "noise.phi2", "no sd is stated"),
        ("[noise]\nphi2 = { sd = 1, estimates = 'each' }", "noise.phi2.estimates", "unknown key"),
        ("[prior]\nl2 = -1", "prior.l2", "negative"),
        ("[prior]\nl9 = 1", "prior.l9", "'l9'"),
        ("[prior]\nl2 = { sd = 1, unit = 'deg' }", "prior.l2.unit", "angle"),
        ("[prior]\nl2 = { value = 1 }", "prior.l2.value", "unknown key"),
        ("[parameters]\nl2 = nan", "parameters.l2", "nan"),
        ("[parameters]\nl2 = { value = inf }", "parameters.l2.value", "inf"),
        ("[parameters]\nl2 = { fixed = 'yes' }", "parameters.l2.fixed", "true or false"),
        ("[parameters]\nl9 = 1", "parameters.l9", "'l9'"),
        ("[fit]\nmethod = 'implicit'", "fit.method", "'implicit'"),
        ("[fit]\nstart = 'guess'", "fit.start", "'guess'"),
        ("[fit]\nmax_iterations = 0", "fit.max_iterations", "too small"),
        ("[fit]\nloss = 'hubert'", "fit.loss", "'hubert'"),
        ("[fit]\nvalidations = { folds = 10 }", "fit.validations", "unknown key"),
        ("[fit]\nrequire_identifiable = 1", "fit.require_identifiable", "true or false"),
    ],
)
def test_what_does_not_fit_is_refused_at_its_place(text, place, words):
    error = refused(PLANAR + text)
    assert error.place == f"standard input: {place}"
    assert words in str(error)


@pytest.mark.parametrize(
    ("text", "remedy"),
    [
        ("[nois]", "'noise'"),
        ('[data]\nfile = "p"\nevry = 2', "'every'"),
        ("[fit]\nmethod = 'least-square'", "'least-squares'"),
        ("[noise]\nphi_2 = 1", "'phi2'"),
        ("[prior]\nphi2 = 1", "'phi20'"),
        ("[noise]\nphi2 = { sd = 1, unit = 'rda' }", "'rad'"),
    ],
)
def test_the_nearest_known_spelling_is_named(text, remedy):
    assert f"did you mean {remedy}" in str(refused(PLANAR + text).remedy)


@pytest.mark.parametrize(
    ("text", "place", "words"),
    [
        ("", "standard input", "schema"),
        ("schema = 2", "standard input: schema", "schema is 2"),
        ("schema = 1\nmechanism = 3", "standard input: mechanism", "table"),
        ('schema = 1\n[mechanism]\ntype = "seril"', "standard input: mechanism", "'serial'"),
        ('schema = 1\n[mechanism]\nfile = "a"\ntype = "serial"', "mechanism.file", "unknown key"),
        ('schema = 1\n[mechanism]\nfile = "no.toml"', "no.toml", "no such file"),
        ('schema = 1\n[mechanism]\nfile = "${NOT_SET}/a.toml"', "mechanism.file", "NOT_SET"),
        (
            'schema = 1\n[mechanism]\ntype="serial"\njoint=[{name="q",form="x"}]',
            "joint[1].form",
            "x",
        ),
        ("schema = 1\na.b = 1\na = 2\n", "line 3", "TOML"),
        ("schema = 1\n\0", "line 2", "NUL"),
    ],
)
def test_what_is_no_project_is_refused(text, place, words):
    error = refused(text)
    assert place in str(error.place)
    assert words in str(error)


def test_a_mistake_in_the_mechanism_file_is_placed_there(tmp_path):
    (tmp_path / "arm.toml").write_text('schema = 1\ntype = "serial"\njoint = 3\n', "utf-8")
    (tmp_path / "p.toml").write_text('schema = 1\n[mechanism]\nfile = "arm.toml"\n', "utf-8")
    with pytest.raises(InputError) as caught:
        read_project(tmp_path / "p.toml")
    assert caught.value.place == f"{tmp_path / 'arm.toml'}: joint"


def test_a_path_may_name_the_environment(tmp_path, monkeypatch):
    (tmp_path / "arm.toml").write_text('schema = 1\ntype = "planar-two-link"\n', "utf-8")
    monkeypatch.setenv("MACHINES", str(tmp_path))
    project = read('schema = 1\n[mechanism]\nfile = "${MACHINES}/arm.toml"\n')
    assert isinstance(project.mechanism, Mechanism)


def test_the_choices_are_those_of_the_estimator():
    for method in METHODS:
        assert planar(f'[fit]\nmethod = "{method}"').fit.settings.method.name == method
    for start in STARTS:
        assert planar(f'[fit]\nstart = "{start}"').fit.settings.start == start


def test_heavy_libraries_wait_until_a_project_is_read():
    code = (
        "import sys, loopcal.files.project.project_data;"
        "print({'pydantic', 'polars'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"

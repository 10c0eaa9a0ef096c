"""Study files: what scenarios and methods share, and complaints at their place."""

from __future__ import annotations

import math

import pytest

from loopcal.companions.studies.study_file import Study, read_study
from loopcal.errors import InputError

HEAD = """schema = 1
[mechanism]
type = "planar-two-link"
[noise]
xPyP = 1e-4
"phi*" = 1e-3
[simulation.ranges]
phi2 = { from = 0, to = 90, step = 30, unit = "deg" }
phi3 = { from = 0, to = 90, step = 30, unit = "deg" }
"""
METHODS = '[[methods]]\nmethod = "implicit-loop"\n[[methods]]\nmethod = "least-squares"\n'


def study(text: str, head: str = HEAD, methods: str = METHODS) -> Study:
    return read_study("-", text=head + methods + text)


def test_a_scenario_replaces_what_all_share():
    made = study(
        '[[scenarios]]\nname = "a"\n[[scenarios]]\nname = "b"\n[scenarios.noise]\nphi3 = 0.1\n'
        "[scenarios.simulation.ranges]\nphi3 = { from = 1, to = 1 }\n"
        "[scenarios.simulation.noise]\nxP = 0.5\n"
    )
    a, b = made.scenarios
    assert (a.simulation.poses, b.simulation.poses) == (16, 4)
    assert a.noise.entries["phi3"] == 1e-3
    assert b.noise.entries["phi3"] == 0.1
    assert b.noise.entries["xP"] == 0.5
    assert b.methods[0].noise.entries["xP"] == 1e-4


def test_a_parameter_that_a_scenario_knows_exactly_does_not_deviate():
    head = HEAD + "[simulation.perturb]\n'l*' = 1e-3\n"
    made = study("[[scenarios]]\nname = 'a'\nprior = { l2 = 0 }\n[[scenarios]]\nname = 'b'\n", head)
    assert [list(one.simulation.perturb) for one in made.scenarios] == [["l3"], ["l2", "l3"]]


def test_a_method_may_be_told_something_else():
    methods = (
        '[[methods]]\nname = "wrong"\nmethod = "implicit-loop"\n[methods.noise]\nphi3 = 2\n'
        '[methods.prior]\nl2 = { sd = 1, unit = "mm" }\n[[methods]]\nmethod = "reweighted"\n'
    )
    made = study('[[scenarios]]\nname = "a"\n', methods=methods)
    wrong, other = made.scenarios[0].methods
    assert made.methods == ("wrong", "reweighted")
    assert (wrong.noise.entries["phi3"], other.noise.entries["phi3"]) == (2.0, 1e-3)
    assert made.scenarios[0].noise.entries["phi3"] == 1e-3
    assert wrong.mechanism.parameters["l2"].prior_sd == 1e-3
    assert other.mechanism.parameters["l2"].prior_sd == math.inf


def test_published_errors_become_si():
    made = study(
        '[[scenarios]]\nname = "a"\n[scenarios.published]\nunits = { length = "um" }\n'
        "errors = { least-squares = { l2 = -14300, phi20 = 0.5 } }\n"
    )
    assert made.scenarios[0].published == {
        "least-squares": {"l2": pytest.approx(-0.0143), "phi20": 0.5}
    }


def test_the_fingerprint_knows_what_changes_numbers_and_only_that():
    base = study('[[scenarios]]\nname = "a"\n').fingerprint
    same = study(
        '[[scenarios]]\nname = "a"\npublished = { errors = { least-squares = { l2 = 1 } } }\n',
        head=HEAD.replace("schema = 1", 'schema = 1\ntitle = "T"\ndraws = 7'),
    )
    assert same.fingerprint == base
    seeded = study(
        '[[scenarios]]\nname = "a"\n', head=HEAD.replace("schema = 1", "schema = 1\nseed = 2")
    )
    assert seeded.fingerprint != base
    assert study('[[scenarios]]\nname = "b"\n').fingerprint != base


@pytest.mark.parametrize(
    ("text", "methods", "place"),
    [
        ('[[scenarios]]\nname = "a"\n[[scenarios]]\nname = "a"\n', METHODS, "scenarios[2].name"),
        ('[[scenarios]]\nname = "a"\nnose = 1\n', METHODS, "scenarios[1].nose"),
        ('[[scenarios]]\nname = "a"\n', METHODS + '[[methods]]\nmethod = "best"\n', "methods[3]"),
        ('[[scenarios]]\nname = "a"\n', METHODS + "[methods.noise]\nxP = 1\n", "methods[2].noise"),
        ('[[scenarios]]\nname = "a"\n', METHODS * 2, "methods[3].name"),
        ('[[scenarios]]\nname = "a"\n[scenarios.noise]\nx = 1\n', METHODS, "scenarios[1].noise.x"),
        (
            '[[scenarios]]\nname = "a"\n[scenarios.noise]\nxP = { sd = 1, estimate = "each" }\n',
            METHODS,
            "scenarios[1].noise.xP",
        ),
        (
            '[[scenarios]]\nname = "a"\npublished = { errors = { basic = { l2 = 1 } } }\n',
            METHODS,
            "scenarios[1].published.errors.basic",
        ),
        (
            '[[scenarios]]\nname = "a"\npublished = { errors = { least-squares = { l9 = 1 } } }\n',
            METHODS,
            "scenarios[1].published.errors.least-squares.l9",
        ),
    ],
)
def test_a_complaint_names_its_place(text: str, methods: str, place: str) -> None:
    with pytest.raises(InputError) as caught:
        study(text, methods=methods)
    assert place in str(caught.value)
    assert caught.value.remedy

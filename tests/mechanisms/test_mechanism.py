"""A user's own function is a mechanism like the ready made ones."""

from __future__ import annotations

from typing import Any

import pytest

from loopcal.errors import Code
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parameters import Parameter
from loopcal.mechanisms.planar import planar_two_link
from tests.reference.machines import two_link
from tests.refusals import refused

NOMINAL = {
    "xA": (0.0, "m"),
    "yA": (0.0, "m"),
    "l2": (800.0, "mm"),
    "l3": (0.6, "m"),
    "phi20": (0.0, "deg"),
    "phi30": Parameter("phi30", 0.0, "rad", prior_sd=0.1),
}


def own_arm(**changes: Any) -> Mechanism:
    arguments: dict[str, Any] = {
        "quantities": {"xP": "m", "yP": "m", "phi2": "rad", "phi3": "rad"},
        "parameters": NOMINAL,
        "outputs": ("xP", "yP"),
        "loops": ("xP", "yP"),
    }
    return Mechanism.from_function(two_link, **(arguments | changes))


def test_the_same_loops_make_the_same_tape_as_the_ready_made_arm() -> None:
    own, ready = own_arm(), planar_two_link()
    assert own.tape == ready.tape
    assert own.quantities == ready.quantities
    assert own.outputs == ready.outputs
    assert [(p.name, p.nominal, p.unit) for p in own.parameters] == [
        (p.name, p.nominal, p.unit) for p in ready.parameters
    ]


def test_a_function_has_no_file_description_and_no_placement() -> None:
    own = own_arm()
    assert own.description is None
    assert own.placement is None
    assert own.name == "two_link"
    assert repr(own) == ("<Mechanism 'two_link': 2 loop equations, 4 quantities, 6 parameters>")


def test_priors_in_the_declaration_are_kept() -> None:
    assert own_arm().parameters["phi30"].prior_sd == 0.1


def test_other_nominal_values_make_a_new_mechanism() -> None:
    own = own_arm()
    longer = own.with_nominal({"l2": 0.9})
    assert longer.parameters["l2"].nominal == 0.9
    assert own.parameters["l2"].nominal == pytest.approx(0.8)
    assert longer.tape is own.tape


def test_parameters_of_another_machine_are_refused() -> None:
    own = own_arm()
    with refused("wrong-shape"):
        own.with_parameters(own.parameters.__class__(own.parameters.items[:-1]))


@pytest.mark.parametrize(
    ("key", "group"),
    [
        ("phi2", ("phi2",)),
        ("phi*", ("phi2", "phi3")),
        ("?P", ("xP", "yP")),
        ("xPyP", ("xP", "yP")),
    ],
)
def test_quantities_are_found_by_name_glob_or_joined_outputs(
    key: str, group: tuple[str, ...]
) -> None:
    assert own_arm().quantity_group(key) == group


def test_an_unknown_quantity_names_the_nearest() -> None:
    with refused("unknown-name", "'ph2'", "'phi2'"):
        own_arm().quantity_group("ph2")


@pytest.mark.parametrize(
    ("changes", "code", "stated"),
    [
        ({"outputs": ("xQ",)}, "unknown-name", ("'xQ'", "'xP'")),
        ({"outputs": ("xP", "yP", "phi2")}, "undetermined-quantities", ("3", "2")),
        (
            {"quantities": {"xP": "m", "yP": "m", "phi2": "rad"}},
            "untraceable-function",
            ("'phi3'",),
        ),
        (
            {"quantities": {"xP": "m", "yP": "m", "phi2": "rad", "phi3": "grad"}},
            "unknown-unit",
            ("grad",),
        ),
        (
            {"quantities": {"xP": "m", "yP": "m", "phi2": "rad", "phi 3": "rad"}},
            "invalid-value",
            ("'phi 3'",),
        ),
        (
            {"quantities": {"x*": "m", "yP": "m", "phi2": "rad", "phi3": "rad"}},
            "invalid-value",
            ("'x*'",),
        ),
        ({"pose_constants": {"xP": "m"}}, "duplicate-name", ()),
        ({"parameters": {**NOMINAL, "xA": ("far", "m")}}, "invalid-value", ("'xA'", "'far'")),
        ({"parameters": {"xA": (0.0, "m")}}, "untraceable-function", ("'phi20'",)),
        ({"loops": ("xP",)}, "untraceable-function", ("2", "1")),
    ],
)
def test_what_cannot_be_a_mechanism_is_named(
    changes: dict[str, Any], code: Code, stated: tuple[str, ...]
) -> None:
    with refused(code, *stated):
        own_arm(**changes)


def test_a_branch_in_the_function_is_explained() -> None:
    with refused("untraceable-function", "compared"):
        Mechanism.from_function(
            lambda x, p: [x["a"] if x["a"] > 0 else p["k"]], {"a": "m"}, {"k": (1.0, "m")}
        )

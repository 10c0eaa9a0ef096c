"""Parallel machines in mechanism files: read, refused and written as they were."""

from __future__ import annotations

import pytest

from loopcal.errors import Code
from loopcal.files.machines.mechanism_file import mechanism_from_data
from loopcal.files.machines.mechanism_writer import mechanism_to_toml
from loopcal.files.toml.place import Place
from loopcal.files.toml.reader import toml_data
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parallel.registry import PARALLEL
from tests.refusals import refused

PASSIVE = {"four-bar": "theta_2", "five-bar": "phi_1", "three-rrr": "phi_3"}
PASSIVE["stewart-gough"] = "alpha_2"


def read(text: str) -> Mechanism:
    data = {k: v for k, v in toml_data(text, "machine.toml").items() if k != "schema"}
    return mechanism_from_data(data, Place("machine.toml"))


@pytest.mark.parametrize("kind", [k for k in PARALLEL if k != "free-body"])  # no parameters
@pytest.mark.parametrize("instrument", ["", '[[instrument]]\ntype = "point"\n'])
def test_they_are_written_again_bit_for_bit_also_where_held_parameters_are_freed(
    kind: str, instrument: str
) -> None:
    passive = f'passive = ["{PASSIVE[kind]}"]\n' if kind in PASSIVE else ""
    x = "platform_rz" if kind == "four-bar" else "platform_x"
    text = f'type = "{kind}"\nname = "mine"\nunits = {{ length = "mm", angle = "deg" }}\n{passive}'
    text += f"home = {{ {x} = 12.3 }}\n{instrument}"
    text += "[parameters]\na1_x = { value = 3.1, fixed = false }\na2_x = { sd = 0.5 }\n"
    machine = read(text)
    assert machine.parameters["a1_x"].nominal == pytest.approx(0.0031)
    assert not machine.parameters["a1_x"].fixed
    assert machine.parameters["a1_y"].fixed
    again = read(mechanism_to_toml(machine))
    assert again == machine
    assert dict(again.home) == dict(machine.home)


def test_what_is_held_follows_the_drawing_of_the_file_and_is_read_again_as_it_was() -> None:
    """Joints a1 and a2 one beside the other along y: their x cannot say how the base is turned."""
    text = 'type = "five-bar"\n[parameters]\na1_y = -0.1\n"a?_x" = 0.2\na2_y = 0.1\n'
    machine = read(text + '[[instrument]]\ntype = "point"\n')
    held = [p.name for p in machine.parameters if p.fixed]
    assert held == ["a1_x", "a1_y", "a2_x"]
    turned = machine.with_nominal({"a2_x": 0.5})  # as if a calibration had turned the drawing
    assert [p.name for p in read(mechanism_to_toml(turned)).parameters if p.fixed] == held


@pytest.mark.parametrize(
    ("text", "code", "stated"),
    [
        ('type = "five-bar"\npassive = ["phi_3"]', "unknown-name", ("'phi_3'",)),
        ('type = "five-bar"\nhome = { platform_u = 1 }', "unknown-name", ("'platform_u'",)),
        (
            'type = "five-bar"\nhome = { platform_x = { value = 3, unit = "deg" } }',
            "wrong-unit",
            ("home.platform_x:",),
        ),
        ('type = "linear-delta"\npassive = ["theta_1"]', "unknown-name", ("'passive'",)),
        ('type = "stewart-gough"\n[parameters]\ncrank = 1', "unknown-name", ("'crank'",)),
        ('type = "stewart-gouch"', "unknown-name", ("'stewart-gough'",)),
        (
            'type = "five-bar"\n[[instrument]]\ntype = "point"\nreadings = ["x", "y", "z"]',
            "wrong-shape",
            ("3", "2", "'point'"),
        ),
        (
            'type = "stewart-gough"\n[[instrument]]\ntype = "point"\n'
            'readings = ["leg_1", "y", "z"]',
            "duplicate-name",
            ("'leg_1'",),
        ),
    ],
)
def test_what_does_not_fit_is_told_where_it_stands(
    text: str, code: Code, stated: tuple[str, ...]
) -> None:
    with refused(code, *stated):
        read(text)

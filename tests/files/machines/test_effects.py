"""Effects in mechanism files: read, refused and written as they were."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Any

import pytest

from loopcal.errors import Code
from loopcal.files.machines.mechanism_file import mechanism_from_data, read_mechanism
from loopcal.files.machines.mechanism_writer import mechanism_to_toml
from loopcal.files.machines.registry import kinds, table_of
from loopcal.files.project.project_file import read_project
from loopcal.files.toml.place import Place
from loopcal.files.toml.reader import toml_data
from loopcal.mechanisms.effects.drift import Drift
from loopcal.mechanisms.effects.effect import with_effects
from loopcal.mechanisms.effects.harmonics import Harmonics
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.planar import planar_two_link
from tests.refusals import refused

MOTOMAN = """
type = "motoman-ma1400"
units = { length = "mm" }
"""
EVERY = """
[[effect]]
type = "harmonics"
joints = ["theta_1"]
orders = [1, 2.5, 100]
[[effect]]
type = "scale"
[[effect]]
type = "compliance"
name = "elastic"
yielding = ["theta_2", "phiy0"]
loads = [
    { name = "wrist", joint = "theta_5", mass = { value = 2000, unit = "g" } },
    { name = "elbow", joint = "theta_3", point = [100, 0, { value = 0.2, unit = "m" }], mass = 60 },
]
[[effect]]
type = "backlash"
direction = "d_{joint}"
[[effect]]
type = "drift"
changing = ["?6B"]
unit = "K"
since = 293
over = 10
[[effect]]
type = "shift"
changing = ["z6B"]
at = [14, 86]
[parameters]
theta_2_yield = { value = 2, unit = "urad/(N m)", sd = 1 }
z6B_drift = 0.5
"""


def read(text: str, function: Any = None) -> Mechanism:
    data = {k: v for k, v in toml_data(text, "arm.toml").items() if k != "schema"}
    return mechanism_from_data(data, Place("arm.toml"), function=function)


def test_effects_are_read_in_their_units_and_written_again_bit_for_bit() -> None:
    mechanism = read(MOTOMAN + EVERY)
    assert list(mechanism.effects) == [
        *("harmonics", "scale", "elastic", "backlash", "drift", "shift"),
    ]
    assert mechanism.effects["elastic"] == ("theta_2_yield", "phiy0_yield")
    assert mechanism.parameters["theta_2_yield"].nominal == pytest.approx(2e-6)
    assert mechanism.parameters["theta_2_yield"].prior_sd == pytest.approx(1e-6)
    assert mechanism.parameters["z6B_drift"].nominal == pytest.approx(0.5e-3)
    assert mechanism.pose_constants["t"] == "K"
    loads = (mechanism.description or {})["effect"][2]["loads"]
    assert [load["mass"] for load in loads] == pytest.approx([2.0, 60.0])
    assert loads[1]["point"] == pytest.approx([0.1, 0.0, 0.2])
    again = read(mechanism_to_toml(mechanism))
    assert again == mechanism
    assert mechanism_to_toml(again) == mechanism_to_toml(mechanism)


@pytest.mark.parametrize("kind", kinds())
def test_mechanisms_of_every_type_may_have_effects(kind: str) -> None:
    assert "effect" in table_of(kind).model_fields


def test_a_project_may_state_other_effects_than_its_mechanism_file(tmp_path: Path) -> None:
    (tmp_path / "arm.toml").write_text("schema = 1" + MOTOMAN + EVERY.split("[parameters]")[0])
    project = 'schema = 1\n[mechanism]\nfile = "arm.toml"\n'
    (tmp_path / "a.toml").write_text(project)
    (tmp_path / "b.toml").write_text(project + "effect = []\n")
    (tmp_path / "c.toml").write_text(project + '[[mechanism.effect]]\ntype = "scale"\n')
    found = [list(read_project(tmp_path / f"{name}.toml").mechanism.effects) for name in "abc"]
    assert [len(names) for names in found] == [6, 0, 1]


def planar() -> Mechanism:
    return planar_two_link()


def test_effects_of_loops_in_python_come_back_with_their_function(tmp_path: Path) -> None:
    def loops(x: Any, p: Any) -> Any:
        return x.a * p.gain - x.b

    plain = Mechanism.from_function(
        loops, {"a": "m", "b": "m"}, {"gain": (1.0, "1")}, outputs=("b",)
    )
    made = with_effects(plain, [Drift(("gain",), "t", "s", over=60.0)])
    made = made.with_nominal({"gain_drift": 0.25})
    path = tmp_path / "made.toml"
    path.write_text(mechanism_to_toml(made))
    for function in (loops, plain, made):
        again = read_mechanism(path, function=function)
        assert again.tape == made.tape
        assert again.parameters == made.parameters
        assert again.effects == made.effects


def test_effects_of_a_machine_without_a_chain() -> None:
    changed = with_effects(planar(), [Harmonics()])
    assert read(mechanism_to_toml(changed)) == changed


@pytest.mark.parametrize(
    ("text", "code", "stated", "place"),
    [
        ('[[effect]]\ntype = "harmonic"\n', "unknown-name", ("harmonic",), "effect"),
        ('[[effect]]\ntype = "scale"\njoint = ["a"]\n', "unknown-name", ("'joint'",), "effect"),
        (
            '[[effect]]\ntype = "scale"\njoints = ["theta_9"]\n',
            "unknown-name",
            ("theta_9",),
            "effect[0]",
        ),
        (2 * '[[effect]]\ntype = "scale"\n', "duplicate-name", ("'scale'",), "effect[1]"),
        ('[[effect]]\ntype = "drift"\nunit = "kg m"\n', "unknown-unit", ("'kg m'",), "effect[0]"),
        ('[[effect]]\ntype = "compliance"\nloads = []\n', "invalid-value", ("loads",), "effect[0]"),
        (
            '[[effect]]\ntype = "compliance"\nloads = [{ name = "a", joint = "theta_5", '
            'mass = { value = 1, unit = "m" } }]\n',
            "wrong-unit",
            ("mass",),
            "effect[0]",
        ),
    ],
)
def test_effects_that_do_not_fit_are_refused(
    text: str, code: Code, stated: tuple[str, ...], place: str
) -> None:
    with refused(code, *stated) as caught:
        read(MOTOMAN + text)
    assert "arm.toml" in str(caught.value)
    assert place.split("[")[0] in str(caught.value)
    assert caught.value.remedy


@pytest.mark.parametrize("kind", ["serial", "motoman-ma1400"])
def test_the_effect_that_templates_propose_is_one(kind: str) -> None:
    text = (
        resources.files("loopcal.files.project") / "template_files" / kind / "mechanism.toml"
    ).read_text("utf-8")
    lines = text.splitlines()
    start = lines.index("# [[effect]]")
    lines[start : start + 4] = [line.removeprefix("# ") for line in lines[start : start + 4]]
    assert read("\n".join(lines)).effects == {
        "compliance": ("theta_2_sag_wrist", "theta_3_sag_wrist")
    }

"""The name of a quantity says nothing of its role: names like ours are the user's to choose."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import loopcal as lc
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.model_error import disturbances, with_model_error
from tests.refusals import refused

NOISE = lc.Noise({"*": 1e-4})
KELVIN = {"model_t": "K"}


def two_joints() -> Mechanism:
    """A reading q, and a quantity of the user's own called q_b."""

    def loops(x: Any, p: Any) -> Any:
        return (p.l * np.sin(x.q) + p.k * np.cos(x.q_b) - x.y,)

    return Mechanism.from_function(
        loops,
        {"q": "rad", "q_b": "rad", "y": "m"},
        {"l": (0.8, "m"), "k": (0.5, "m")},
        outputs=("y",),
    )


def warm() -> Mechanism:
    """A length that a quantity called model_t stretches, and outputs x, y."""

    def loops(x: Any, p: Any) -> Any:
        reach = p.l * (1.0 + p.c * x.model_t)
        return reach * np.cos(x.q) - x.x, reach * np.sin(x.q) - x.y

    return Mechanism.from_function(
        loops,
        {"q": "rad", "model_t": "K", "x": "m", "y": "m"},
        {"l": (0.8, "m"), "c": (1e-3, "1")},
        outputs=("x", "y"),
    )


def readings(number: int = 40) -> dict[str, np.ndarray]:
    draw = np.random.default_rng(3)
    return {"q": draw.uniform(-2.0, 2.0, number), "model_t": draw.uniform(0.0, 30.0, number)}


def test_an_effect_on_q_leaves_a_quantity_called_q_b_alone() -> None:
    made = lc.with_effects(two_joints(), [lc.effects.Scale(("q",))])
    at = {"q": np.array([0.3]), "q_b": np.array([0.7])}
    plain = lc.simulate(two_joints(), at, noise=lc.Noise({"*": 0.0}), seed=1).dataset
    scaled = made.with_nominal({"q_scale": 0.1})
    found = lc.simulate(scaled, at, noise=lc.Noise({"*": 0.0}), seed=1).dataset
    assert found["y"][0] == pytest.approx(0.8 * np.sin(0.33) + 0.5 * np.cos(0.7), abs=1e-15)
    assert plain["y"][0] == pytest.approx(0.8 * np.sin(0.3) + 0.5 * np.cos(0.7), abs=1e-15)


def test_every_joint_is_found_whatever_it_is_called() -> None:
    made = lc.with_effects(two_joints(), [lc.effects.Scale(("*",))])
    assert made.effects["scale"] == ("q_scale", "q_b_scale")


def test_a_known_constant_of_an_effect_is_not_read_twice_for_a_quantity_called_q_b() -> None:
    made = lc.with_effects(two_joints(), [lc.effects.Backlash(("q",))])
    assert list(made.pose_constants) == ["q_direction"]


def test_of_two_poses_in_a_row_an_effect_acts_on_both() -> None:
    span = lc.instruments.relative_distance()
    arm = lc.assemble(lc.machines.serial([lc.Joint("q1"), lc.Joint("q2")]), [span], {"a_1": 0.5})
    made = lc.with_effects(arm, [lc.effects.Backlash(("q2",))])
    assert list(made.pose_constants) == ["q2_direction", "q2_direction_b"]
    firsts = {v.name: v.first for v in made.variables}
    assert firsts["q2_direction_b"] == "q2_direction"
    assert firsts["q1_b"] == "q1"
    assert firsts["span"] is None


def test_a_quantity_called_model_t_is_predicted_from_its_reading() -> None:
    at = readings()
    made = lc.simulate(warm(), at, noise=NOISE, seed=1, units=KELVIN)
    result = lc.calibrate(warm(), made.dataset, noise=NOISE, method="implicit-loop")
    cold, hot = (
        lc.predict(result, {"q": np.array([0.5]), "model_t": np.array([t])}, units=KELVIN).outputs[
            "x"
        ][0]
        for t in (0.0, 30.0)
    )
    assert hot / cold == pytest.approx(1.0 + 30.0 * result.value["c"], rel=1e-12)
    with refused("missing-reading", "model_t"):
        lc.predict(result, {"q": np.array([0.5])})


def test_a_quantity_called_model_t_is_no_group_model() -> None:
    with refused("unknown-name", "'model'"):
        warm().quantity_group("model")


def test_errors_of_the_model_get_names_that_are_free() -> None:
    def loops(x: Any, p: Any) -> Any:
        return (p.l * x.model_y - x.y,)

    own = Mechanism.from_function(
        loops, {"model_y": "m", "y": "m"}, {"l": (2.0, "1")}, outputs=("y",)
    )
    assert own.disturbances == ()
    made = with_model_error(own)
    assert made.disturbances == disturbances(own) == ("model_y_",)
    assert with_model_error(made) == made
    assert made.quantity_group("model") == ("model_y_",)

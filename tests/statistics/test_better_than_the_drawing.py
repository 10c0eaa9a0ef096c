"""Whether a calibration is better is judged beside the nominal machine, for own loops too."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import loopcal as lc
from loopcal.document.choice import Chosen
from loopcal.statistics.verdict import better
from tests.reference.verdicts import finding_of

N = 40
RNG = np.random.default_rng(4)


def two_link(x: Any, p: Any) -> Any:
    a = x.s + p.s0
    b = a + x.e + p.e0
    return (
        p.bx + p.l1 * np.cos(a) + p.l2 * np.cos(b) - x.px,
        p.by + p.l1 * np.sin(a) + p.l2 * np.sin(b) - x.py,
    )


def crank(x: Any, p: Any) -> Any:
    return p.r * np.cos(x.s) + np.sqrt(p.l**2 - (p.r * np.sin(x.s) - p.o) ** 2) - x.px


def scale(x: Any, p: Any) -> Any:
    return p.gain * x.s + p.zero - x.px


LOOPS: dict[str, tuple[Any, dict[str, str], dict[str, tuple[float, str]], tuple[str, ...]]] = {
    "two_link": (
        two_link,
        {"s": "rad", "e": "rad", "px": "m", "py": "m"},
        {
            **{"bx": (0.0, "m"), "by": (0.0, "m"), "l1": (0.8, "m"), "l2": (0.6, "m")},
            **{"s0": (0.0, "rad"), "e0": (0.0, "rad")},
        },
        ("px", "py"),
    ),
    "crank": (
        crank,
        {"s": "rad", "px": "m"},
        {"r": (0.1, "m"), "l": (0.3, "m"), "o": (0.0, "m")},
        ("px",),
    ),
    "scale": (scale, {"s": "m", "px": "m"}, {"gain": (1.0, "1"), "zero": (0.0, "m")}, ("px",)),
}


def read(
    name: str, off: float, gaps: bool = False, sd: float = 2e-5
) -> tuple[lc.Mechanism, lc.Dataset]:
    """An own machine and readings of one whose parameters are off by so much."""
    loops, quantities, parameters, outputs = LOOPS[name]
    own = lc.Mechanism.from_function(loops, quantities, parameters, outputs=outputs)
    rng = np.random.default_rng(7)
    joints = {q: rng.uniform(0.2, 2.0, N) for q in quantities if q not in outputs}
    truth = {
        p: value + off * (1.0 + 0.3 * i) for i, (p, (value, _)) in enumerate(parameters.items())
    }
    made = lc.simulate(own, joints, noise=lc.Noise({"*": sd}), seed=3, truth=truth).dataset
    if not gaps:
        return own, made
    values = {q: np.array(made[q]) for q in made.readings}
    for i, output in enumerate(outputs):
        values[output][np.arange(N) % len(outputs) != i] = np.nan
    return own, lc.Dataset.from_arrays(values)


@pytest.mark.parametrize("gaps", [False, True])
@pytest.mark.parametrize("name", LOOPS)
def test_an_own_machine_is_judged_beside_its_nominal_values(name: str, gaps: bool) -> None:
    own, data = read(name, 1e-3, gaps)
    result = lc.calibrate(own, data)
    assert result.verdict is not None
    assert result.verdict.better.code == "better"
    assert "the nominal machine" in result.verdict.better.words
    assert "nominal (" not in str(result)
    accuracy, validation = result.document.accuracy, result.document.validation
    assert accuracy is not None
    assert validation is not None
    assert validation.accuracy is not None
    gain = accuracy.before.rms - validation.accuracy.rms
    assert result.verdict.better.number == pytest.approx(gain, rel=1e-9)


def test_an_own_machine_that_is_as_drawn_is_about_as_good() -> None:
    own, data = read("two_link", 0.0)
    verdict = lc.calibrate(own, data).verdict
    assert verdict is not None
    assert verdict.better.code == "no-better"
    assert verdict.better.words.startswith("Not significantly better than the nominal machine")


@pytest.mark.parametrize("name", ["two_link", "crank"])
@pytest.mark.parametrize(("less", "code"), [(0.0, "better"), (1e-7, "better"), (-1e-3, "worse")])
def test_methods_that_predict_alike_are_no_caution(name: str, less: float, code: str) -> None:
    """less: by how much another method's rms is larger than that of the chosen one."""
    own, data = read(name, 1e-3)
    result = lc.calibrate(own, data)
    chosen = result.document.chosen
    assert chosen is not None
    first = chosen.over[0]
    alike = replace(first, name="reweighted", difference=less, sd=1e-6)
    over = Chosen(first.name, (), first.name, (first, alike))
    answer = finding_of(better(replace(result.document, chosen=over)))
    assert answer.code == code
    assert ("reweighted" in answer.words) is (code == "worse")

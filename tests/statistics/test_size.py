"""A ball-bar of unknown length says nothing of the machine's size, and noise shrinks the fit."""

from __future__ import annotations

import pytest

import loopcal as lc
from analyses.instruments import setup
from tests.reference.verdicts import verdict_of

BAR = setup("six-axis ball-bar")
NOISE = lc.Noise(dict.fromkeys(BAR.truth.quantities, 2e-5))


def calibrated(prior):
    """The document of a calibration whose bar is known to so much [m]."""
    data = lc.simulate(BAR.truth, BAR.driven, noise=NOISE, seed=1, start=BAR.start).dataset
    start = BAR.nominal(2)
    held = [name for name in BAR.held if name != "bar_length"]
    parameters = start.parameters.with_fixed(held).with_prior({"bar_length": prior})
    machine = start.with_parameters(parameters)
    result = lc.calibrate(machine, data, noise=NOISE, method="implicit-loop")
    return result.document


@pytest.mark.parametrize(("prior", "passed"), [(2e-4, True), (1e-2, None)])
def test_the_size_of_a_machine_is_named_where_only_a_rough_prior_determines_it(prior, passed):
    document = calibrated(prior)
    worst = document.identifiability.weak_directions[0]
    assert worst.size == pytest.approx(0.16, rel=0.1)
    assert worst.words.startswith("the size of the machine")
    assert all(other.size is None for other in document.identifiability.weak_directions[1:])
    (bar,) = (p for p in document.parameters if p.name == "bar_length")
    off = (bar.value - BAR.truth.parameters["bar_length"].nominal) / prior
    found = verdict_of(document).sound
    assert found.passed is passed
    if passed:
        assert abs(off) < 0.1
    else:  # the bias that makes it a finding
        assert off < -1.0
        assert found.code == "size-unsure"
        assert found.number == pytest.approx(prior / bar.value, rel=0.5)

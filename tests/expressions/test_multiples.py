"""Which columns of derivatives are seen as multiples of a common one."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from loopcal.expressions.derivative import linearise
from loopcal.expressions.engine import NumpyEngine
from loopcal.expressions.multiples import multiples
from loopcal.mechanisms.planar import motoman_ma1400
from loopcal.mechanisms.structure.structured import structured
from tests.reference.simulated import ma1400


def test_waves_of_a_smooth_error_are_multiples_of_what_moves_the_body() -> None:
    mechanism = structured(motoman_ma1400(), discrepancy=6)
    names = tuple(p.name for p in mechanism.parameters)
    linearised = linearise(mechanism.tape, mechanism.tape.quantities, names)
    shared = multiples(linearised)
    waves = [
        {names[parameter] for parameter, _ in members}
        for members in shared.members
        if names[members[0][0]].startswith("discrepancy")
    ]
    parts = [f"{part}{i}" for i in range(1, 7) for part in ("cos", "sin")]
    assert waves == [{f"discrepancy_{axis}_{part}" for part in parts} for axis in "xyz"]

    x = np.random.default_rng(1).uniform(-1, 1, (len(mechanism.tape.quantities), 7))
    p = np.array([one.nominal + 0.01 for one in mechanism.parameters])
    columns = NumpyEngine(linearised, 7).evaluate(p, x).by_parameter.copy()
    apart = linearise(shared.tape, (), ())  # the same operations, and all outputs as loops
    values = NumpyEngine(apart, 7).evaluate(p, x).f
    common = values[list(shared.places[len(linearised.tape.outputs) :])]
    factors = common[len(common) - shared.factors :]
    m = linearised.loops
    for c, members in enumerate(shared.members):
        for parameter, factor in members:
            expected = factors[factor] * common[c * m : (c + 1) * m]
            assert_allclose(columns[parameter], expected, rtol=1e-12, atol=1e-12)


def test_an_arm_without_model_error_has_no_common_columns() -> None:
    tape = ma1400().truth.tape
    assert multiples(linearise(tape, tape.quantities, tape.parameters)).members == ()

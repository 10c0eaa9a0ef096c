"""A coordinate that reads the same in all poses does not drive the sd of its sensor to nothing."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import loopcal as lc

STATED = 1e-3


def loops(x: Any, p: Any) -> Any:
    return p.gain * x.s + p.zero - x.px, p.flat - x.py


def test_an_sd_ends_at_a_ten_thousandth_of_the_stated_one() -> None:
    machine = lc.Mechanism.from_function(
        loops,
        {"s": "rad", "px": "m", "py": "m"},
        {"gain": (1.0, "1"), "zero": (0.0, "m"), "flat": (0.0, "m")},
        outputs=("px", "py"),
    )
    rng = np.random.default_rng(1)
    s = rng.uniform(0.0, 1.0, 20)
    data = lc.Dataset.from_arrays(
        {"s": s, "px": s + rng.normal(0.0, STATED, 20), "py": np.zeros(20)}
    )
    noise = lc.Noise({"s": STATED, "p?": STATED}, estimate={"s": "group", "p?": "group"})
    result = lc.calibrate(machine, data, noise=noise, method="implicit-loop")
    assert result.status.converged
    assert result.document.sds_settled
    (sd,) = (entry.sd for entry in result.noise if "py" in entry.quantities)
    assert sd == pytest.approx(1e-4 * STATED)

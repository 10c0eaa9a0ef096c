"""The search for changes: which sizes are named."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from loopcal.statistics.change_tests import _System
from loopcal.statistics.possible_changes import Possible, impossible


@pytest.mark.parametrize(
    ("size", "sds", "far"),
    [(2.1e-2, 4.0, True), (2.1e-2, 6.0, False), (1e-4, 4.0, False), (1.1, 1e3, True)],
)
def test_a_large_change_must_be_seen_with_the_stated_power(
    size: float, sds: float, far: bool
) -> None:
    """A tool was named with 21 mm, 4 sds, where 50 mm are seen with 90 %."""
    causes = SimpleNamespace(causes=(Possible("mounting", ("tool_z",)),))
    system = cast(
        Any,
        SimpleNamespace(
            causes=causes,
            unit=lambda _: "m",
            scale=1.0,
            _size=lambda *_: (size, size / sds, np.zeros(1)),
            _reach=lambda *_: 5.0,
            beside=lambda *_: SimpleNamespace(gain=sds**2, rank=1),
        ),
    )
    assert _System.too_far(system, (0,)) == ((0,) if far else ())


@pytest.mark.parametrize(
    ("kind", "size", "unit", "no"),
    [
        ("load", 4.14, "rad/m", True),
        ("load", 0.01, "rad/m", False),
        ("expansion", 2.8e-3, "1", True),
        ("target", 2.5, "m", True),
        ("station", 2.5, "m", False),
    ],
)
def test_no_change_of_a_size_that_no_machine_has_is_named_during_a_run(
    kind: str, size: float, unit: str, no: bool
) -> None:
    assert impossible(kind, -size, 0.01 * size, unit) is no
    assert not impossible(kind, size, size, unit)

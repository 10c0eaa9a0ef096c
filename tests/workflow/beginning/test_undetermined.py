"""What readings lack that determine no place: said only where it is true."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from loopcal.files.recognition.fields import Field
from loopcal.files.recognition.layouts import Layout
from loopcal.workflow.beginning.understanding import undetermined

MOVING = np.linspace(-1.0, 1.0, 20)


@pytest.mark.parametrize(
    ("columns", "units", "said"),
    [
        ({"q1": MOVING[:4], "q2": MOVING[:4]}, ("rad", "rad"), "at least 5 poses"),
        ({"q1": MOVING, "rail": 0.3 + 0.0 * MOVING}, ("rad", "m"), "'rail' stands still"),
        ({"x": MOVING, "y": MOVING**2}, ("m", "m"), "no joint turns"),
        ({"q1": MOVING, "rail": MOVING**2}, ("rad", "m"), "20 poses were tried"),
        ({"q1": MOVING, "rail": np.where(MOVING > 0, np.nan, 0.3)}, ("rad", "m"), "'rail' stands"),
    ],
)
def test_what_is_missing_is_said_where_it_is_true(
    columns: dict[str, np.ndarray], units: tuple[str, ...], said: str
) -> None:
    fields = tuple(Field(0, i, None, np.asarray(v)) for i, v in enumerate(columns.values()))
    machine: Any = SimpleNamespace(joints=tuple(columns), units=units, frame=None)
    words = str(undetermined(machine, [Layout(fields, (), (), "names")]))
    assert said in words
    assert "every joint" not in words
    assert ("at least 5" in words) == (said == "at least 5 poses")

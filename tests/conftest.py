"""What every test may ask for: the measured data outside the project, and the command line."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import hypothesis
import pytest

from loopcal.expressions.choice import AVAILABLE, ENGINES
from tests import command_line

ROOT = Path(__file__).resolve().parents[1]

# The same examples in every run, and no clock that could fail a slow machine.
hypothesis.settings.register_profile("loopcal", derandomize=True, deadline=None, database=None)
hypothesis.settings.load_profile("loopcal")


@pytest.fixture(scope="session")
def shared_data() -> Callable[[str], Path]:
    """Finds a measured data set, say "motoman_ma1400_leica/left_arm_grid.csv", or skips."""

    def find(name: str) -> Path:
        folder = os.environ.get("LOOPCAL_DATA")
        path = (Path(folder) if folder else ROOT.parent / "shared" / "data") / name
        if not path.exists():
            pytest.skip(f"{path} is absent; LOOPCAL_DATA names the folder of measured data")
        return path

    return find


@pytest.fixture(scope="session")
def run_loopcal() -> Callable[..., object]:
    """Runs `loopcal ARGUMENTS` in a process of its own; see `command_line.run`."""
    return command_line.run


@pytest.fixture(params=ENGINES)
def each_engine(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """The test runs on one engine after the other; on NumPy alone where there is no other."""
    name: str = request.param
    if name == "compiled" and not AVAILABLE:
        pytest.skip("the compiled engine was not built")
    monkeypatch.setenv("LOOPCAL_ENGINE", name)
    return name

"""What every test may ask for: the measured data outside the project, and each engine."""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import Any

import hypothesis
import numpy as np
import pytest
from _pytest.approx import ApproxNumpy
from _pytest.doctest import DoctestModule

from loopcal.expressions.choice import AVAILABLE, ENGINES, cores

_COMPARED = ApproxNumpy.__eq__


def _compared(expected: Any, actual: Any) -> bool:
    """`pytest.approx` of arrays, number by number only where they are not all within tolerance."""
    own, other = expected.expected, np.asarray(actual)
    if own.dtype.kind == other.dtype.kind == "f" and own.shape == other.shape:
        absolute = 1e-12 if expected.abs is None else expected.abs
        relative = 1e-6 if expected.rel is None and expected.abs is None else expected.rel or 0.0
        with np.errstate(all="ignore"):
            near = np.abs(own - other) <= np.maximum(relative * np.abs(own), absolute)
        if np.all((own == other) | (near & np.isfinite(own))):
            return True
    return bool(_COMPARED(expected, actual))


ApproxNumpy.__eq__ = _compared  # type: ignore[method-assign]
ROOT = Path(__file__).resolve().parents[1]
# What PYTHONDONTWRITEBYTECODE spares the disk, each of some hundred processes would compile anew.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False
# Processes of the suite share the cores already; what tests of threads need, they say.
if int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1")) >= cores():
    os.environ.setdefault("LOOPCAL_THREADS", "1")

# The same examples in every run, and no clock that could fail a slow machine.
hypothesis.settings.register_profile("loopcal", derandomize=True, deadline=None, database=None)
hypothesis.settings.load_profile("loopcal")


class _Prompts:
    """Doctests only of files that show a prompt: to look for them, pytest imports a file and goes
    through all that it holds."""

    @pytest.hookimpl(wrapper=True)
    def pytest_collect_file(
        self, file_path: Path
    ) -> Generator[None, list[pytest.Collector], list[pytest.Collector]]:
        made = yield
        if file_path.suffix == ".py" and b">>> " not in file_path.read_bytes():
            made = [one for one in made if not isinstance(one, DoctestModule)]
        return made


def pytest_configure(config: pytest.Config) -> None:
    """Also for files beside this folder."""
    config.pluginmanager.register(_Prompts())


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


def pytest_collection_finish() -> None:
    """What is loaded now stays to the end: the garbage collector need not look at it again.

    And it looks less often: at every 700 new objects it takes 2 % of the suite's time, at every
    20,000 still 1 %.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(100_000, 20, 20)


@pytest.fixture
def restored() -> Iterator[None]:
    """Width and threads of the compiled engine are afterwards as they were."""
    from loopcal.expressions import _compiled

    width, threads = _compiled.width(), _compiled.threads()
    yield
    _compiled.use_width(width)
    _compiled.use_threads(threads)


@pytest.fixture(params=ENGINES)
def each_engine(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """The test runs on one engine after the other; on NumPy alone where there is no other."""
    name: str = request.param
    if name == "compiled" and not AVAILABLE:
        pytest.skip("the compiled engine was not built")
    monkeypatch.setenv("LOOPCAL_ENGINE", name)
    return name

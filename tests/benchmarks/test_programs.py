"""The programs of `make benchmark` find what loopcal finds; one that is absent skips."""

from __future__ import annotations

import importlib
import importlib.util
import shutil
from types import ModuleType

import numpy as np
import pytest

from tests.conftest import ROOT

POSES = 60
APART = 1e-6
"""Largest difference of parameters, in sds."""
PROGRAMS = {
    "odrpack_explicit": "odrpack",
    "seed_program": "",
    "octave_program": "octave-cli",
    "scipy_least_squares": "",
    "sparse_kkt": "",
    "gtsam_factors": "gtsam",
    "pyceres_costs": "pyceres",
}
"""Modules of benchmarks/, and what each needs."""


@pytest.fixture
def benchmarks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its modules can be imported by the names they have among themselves."""
    monkeypatch.syspath_prepend(ROOT / "benchmarks")


def _module(name: str) -> ModuleType:
    return importlib.import_module(name)


@pytest.mark.usefixtures("benchmarks")
@pytest.mark.parametrize("problem", ["planar", "six-axis"])
@pytest.mark.parametrize("program", PROGRAMS)
def test_finds_what_loopcal_finds(program: str, problem: str) -> None:
    programs = _module("programs")
    needs = PROGRAMS[program]
    if not programs.Program(program, POSES, lambda given: given, needs=needs).installed:
        pytest.skip(f"{needs} is not installed; `make benchmark` tries to install packages")
    given, ours = _module("problems").PROBLEMS[problem](POSES), _module("ours")
    expected, sds = ours.solver(given)(), ours.sds(given)
    found = _module(program).calibrate(given)
    assert np.abs((found.parameters - expected.parameters) / sds).max() <= APART
    assert found.chi_squared == pytest.approx(expected.chi_squared, rel=1e-9)
    assert found.evaluations >= 3


@pytest.mark.usefixtures("benchmarks")
def test_octave_tells_its_own_time() -> None:
    octave = _module("octave_program")
    if not shutil.which(octave.COMMAND):
        pytest.skip("GNU Octave is not installed")
    found = octave.calibrate(_module("problems").planar(10))
    assert _module("measuring").taken(0.0, found) == found.seconds > 0


@pytest.mark.usefixtures("benchmarks")
def test_octave_names_its_error(monkeypatch: pytest.MonkeyPatch) -> None:
    octave = _module("octave_program")
    if not shutil.which(octave.COMMAND):
        pytest.skip("GNU Octave is not installed")
    monkeypatch.setattr(octave, "_as_matrices", lambda problem: {"joints": problem.joints})
    with pytest.raises(RuntimeError, match=r"Octave: .*points"):
        octave.calibrate(_module("problems").planar(3))


@pytest.mark.usefixtures("benchmarks")
@pytest.mark.parametrize("problem", ["planar", "six-axis"])
def test_a_chain_is_the_same_arm_as_the_model_by_hand(problem: str) -> None:
    given, one_pose = _module("problems").PROBLEMS[problem](3), _module("chain").one_pose
    model, coordinates = given.model, len(given.points)
    expected = (
        model.point(given.joints, given.truth),
        model.by_joint(given.joints, given.truth),
        model.by_parameter(given.joints, given.truth),
    )
    for i, joints in enumerate(given.joints.T):
        pose = one_pose(model.chain, joints.tolist(), given.truth.tolist())
        found = pose.point, pose.by_joint, pose.by_parameter
        for ours, theirs in zip(found, expected, strict=True):
            np.testing.assert_allclose(np.array(ours).T[:coordinates], theirs[..., i], atol=1e-15)


@pytest.mark.usefixtures("benchmarks")
def test_a_program_that_is_absent_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    programs, report = _module("programs"), _module("report")
    there, absent = (
        programs.Program(name, 1, lambda given: given, needs=needs)
        for name, needs in (("present", "numpy"), ("wanted", "no-such-program"))
    )
    monkeypatch.setattr(report, "PROGRAMS", [there, absent])
    assert "wanted (no-such-program)" in report.absent()
    assert "present" not in report.absent()


@pytest.mark.usefixtures("benchmarks")
def test_ceres_ends_where_loopcal_does_on_images() -> None:
    if importlib.util.find_spec("pyceres") is None:
        pytest.skip("pyceres is not installed; `make benchmark` tries to install packages")
    measured = _module("images").measure(30)  # raises where they are apart
    assert measured.ceres > measured.callbacks > 0.0

"""What users do with a project begun from a template: take a length away, add a tracker."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import loopcal as lc
from loopcal.workflow.calibration import Request, run_calibration
from loopcal.workflow.checking import run_simulation
from loopcal.workflow.projects import new_project
from tests.refusals import refused


def test_lengths_that_the_rest_makes_up_for_set_no_size(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The template holds d_1, which shifts the base, and [ad]_6, which shift the tool."""
    monkeypatch.chdir(tmp_path)
    new_project("arm", "serial-socket")
    run_simulation("arm/project.toml", out="arm/poses.csv", seed=1)
    file = tmp_path / "arm" / "mechanism.toml"
    text = file.read_text()
    assert '"a_2" = { fixed = true }' in text
    file.write_text(text.replace('"a_2" = { fixed = true }', ""))
    for method in (None, "implicit-loop"):
        with refused("unknown-size"):
            run_calibration("arm/project.toml", Request(method=method))


@pytest.mark.parametrize("machine", [lc.machines.stewart_gough(), lc.machines.linear_delta()])
def test_a_tracker_over_a_platform_is_placed_from_anywhere(machine: lc.Machine) -> None:
    """Its nominal station is the base's origin, straight below the platform's home."""
    mechanism = lc.assemble(machine, [lc.instruments.spherical()])
    unread = {q for q in mechanism.quantities if q.startswith("platform_")}
    ranges = dict.fromkeys(unread, (-0.1, 0.1))
    home = mechanism.home["platform_z"]
    ranges["platform_z"] = (home - 0.1, home + 0.1)
    noise = lc.Noise({"*": 1e-5} | dict.fromkeys(sorted(unread), np.inf))
    truth = {"tracker_x": 2.0, "tracker_y": -1.0, "tracker_rz": 2.0}
    poses = lc.random_poses(ranges, 60, seed=1)
    made = lc.simulate(mechanism, poses, noise=noise, seed=1, truth=truth)
    result = lc.calibrate(mechanism, made.dataset, noise=noise, method="implicit-loop")
    assert result.status.converged
    assert result.accuracy_before is not None
    assert result.accuracy_before.rms < 1e-3
    sd = result.sd["tracker_x"]
    assert sd is not None
    assert abs(result.value["tracker_x"] - 2.0) < 4.5 * sd


def test_distances_of_two_poses_of_a_platform_start_apart() -> None:
    mechanism = lc.assemble(lc.machines.stewart_gough(), [lc.instruments.relative_distance()])
    unread = sorted(q for q in mechanism.quantities if q.startswith("platform_"))
    ranges = {q: (0.6, 0.8) if "_z" in q and "r" not in q[9:] else (-0.15, 0.15) for q in unread}
    noise = lc.Noise({"*": 1e-5} | dict.fromkeys(unread, np.inf))
    made = lc.simulate(mechanism, lc.random_poses(ranges, 80, seed=1), noise=noise, seed=1)
    assert lc.check(mechanism, made.dataset, noise=noise) is not None
    assert lc.calibrate(
        mechanism, made.dataset, noise=noise, method="implicit-loop"
    ).status.converged

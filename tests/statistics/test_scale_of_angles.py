"""A machine of which angles alone are read: its scale is not seen, and so did not change."""

from __future__ import annotations

import numpy as np
import pytest

import loopcal as lc

NOISE = lc.Noise({"theta_*": 5e-5, "phi_*": 1e-4, "platform_*": np.inf})
WHERE = {"platform_x": (0.0, 0.25), "platform_y": (0.3, 0.5)}


@pytest.fixture(scope="module")
def machine() -> lc.Mechanism:
    """A five-bar that calibrates itself."""
    return lc.assemble(lc.machines.five_bar(passive=("phi_1", "phi_2")))


def read(machine: lc.Mechanism, truth: dict[str, float], poses: int, seed: int) -> lc.Dataset:
    """The angles of a day."""
    every = lc.random_poses(WHERE, poses, seed=seed)
    made = lc.simulate(machine, every, noise=NOISE, seed=seed, truth=truth)
    kept = {q: made.dataset[q] for q in machine.quantities if not q.startswith("platform")}
    return lc.Dataset.from_arrays(kept)


@pytest.mark.parametrize("zero", [0.0, 2e-3])
def test_the_scale_of_a_machine_that_reads_angles_alone_does_not_drift(
    machine: lc.Mechanism, zero: float
) -> None:
    """By Euler its column is the misclosure: it "drifted by -1068024 ppm", p < 1e-6."""
    draw = np.random.default_rng(61146)
    truth = {
        n: machine.parameters[n].nominal + 4e-4 * draw.standard_normal()
        for n in machine.parameters.free
    }
    fit = lc.calibrate(machine, read(machine, truth, 50, 1), noise=NOISE, method="implicit-loop")
    later = truth | {"phi_2_offset": truth["phi_2_offset"] + zero}
    checked = lc.verify(fit, read(machine, later, 20, 2))
    expected = "re-master" if zero else "unchanged"
    assert checked.verdict["consistent"].code == expected

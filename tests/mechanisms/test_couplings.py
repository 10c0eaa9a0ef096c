"""Joints that follow others by bars: waves of their angle take up what the bars are off by."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import loopcal as lc
from analyses.lives_parallel import PALLETISER, PALLETISER_BOX, PALLETISER_URDF

READINGS = ("J1", "J2", "J3", "J4")
BARS = 3e-4
"""sd of the lengths of cranks, bars and horns [m]."""


def arm(folder: Path) -> lc.Mechanism:
    path = folder / "robot.urdf"
    path.write_text(PALLETISER_URDF)
    return lc.assemble(lc.load_urdf(path, "base", "flange"), [lc.instruments.point("tracker")])


def columns(mechanism: lc.Mechanism) -> list[str]:
    return [n for term in mechanism.terms if term.name == "couplings" for n in term.parameters]


def test_only_joints_that_follow_another_are_coupled(tmp_path: Path) -> None:
    # The plate at the elbow follows J2 and carries J3 on its axis; the wrist follows J3.
    waves = ["cos1", "sin1", "cos2", "sin2"]
    elbow = [f"J2_2_coupling_{ahead}{wave}" for ahead in ("", "J3_") for wave in waves]
    wrist = [f"J3_2_coupling_{wave}" for wave in waves]
    assert columns(lc.structured(arm(tmp_path))) == elbow + wrist
    alone = PALLETISER_URDF.replace('<mimic joint="J2" multiplier="-1"/>', "")
    alone = alone.replace('<mimic joint="J3" multiplier="-1"/>', "")
    path = tmp_path / "serial.urdf"
    path.write_text(alone)
    serial = lc.assemble(lc.load_urdf(path, "base", "flange"), [lc.instruments.point("tracker")])
    assert not columns(lc.structured(serial))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_bars_of_other_lengths_are_predicted(tmp_path: Path, seed: int) -> None:
    """Of fresh poses less than a third is left of what the lengths and zeros of the arm leave."""
    rng = np.random.default_rng(seed)
    bars = PALLETISER.linkages + BARS * rng.standard_normal((3, 3))
    true = replace(PALLETISER, linkages=bars, yielding=0.0, bending=0.0)
    low, high = PALLETISER_BOX.T
    q = rng.uniform(low, high, (160, 4))
    seen = true.flange(q)[1] + 1e-5 * rng.standard_normal((160, 3))
    read = {
        **dict(zip(READINGS, q.T, strict=True)),
        **dict(zip("xyz", seen.T, strict=True)),
    }
    noise = lc.Noise(dict.fromkeys(READINGS, 1e-5) | dict.fromkeys("xyz", 1e-5))
    plain = arm(tmp_path)
    off = {}
    for name, sag in (("lengths", ()), ("coupled", ("*_coupling_*",))):
        made = lc.structured(plain, sag=sag, harmonics=False, discrepancy=False)
        first = {k: v[:60] for k, v in read.items()}
        result = lc.calibrate(made, first, noise=noise, method="implicit-loop")
        predicted = lc.predict(result, {k: read[k][60:] for k in READINGS})
        points = np.column_stack([predicted.outputs[k] for k in "xyz"])
        off[name] = np.sqrt(np.square(points - true.flange(q[60:])[1]).sum(axis=1).mean())
    assert off["coupled"] < off["lengths"] / 3.0

"""Rows copied from others count once; readings that agree by chance do not."""

from __future__ import annotations

import numpy as np
import pytest

import loopcal as lc
from loopcal.estimation.fit import Fit
from loopcal.measurements.copies import copies
from loopcal.statistics.case import Case
from tests.reference.simulated import planar_arm

ARM = planar_arm(40)
SDS = dict.fromkeys(ARM.exact, 1e-4)
QUANTITIES, OUTPUTS = tuple(ARM.exact), ARM.truth.outputs


def doubled(data: lc.Dataset, number: int) -> lc.Dataset:
    return lc.Dataset.from_arrays({q: np.append(v, v[:number]) for q, v in data.readings.items()})


def test_copied_rows_count_once_and_are_said() -> None:
    data = ARM.read(SDS, 1)
    # sds of each reading are those of the rows that are kept
    sds = {q: np.full(60, sd) for q, sd in SDS.items()}
    noise = lc.Noise({**sds, OUTPUTS[0]: np.append(np.full(40, 1e-4), np.full(20, 1e-6))})
    once = lc.calibrate(ARM.truth, data, noise=lc.Noise(SDS), method="implicit-loop")
    again = lc.calibrate(ARM.truth, doubled(data, 20), noise=noise, method="implicit-loop")
    assert dict(again.value) == dict(once.value)
    assert (again.sd, again.chi_squared) == (once.sd, once.chi_squared)
    assert again.document.data.copied == tuple(str(i) for i in range(41, 61))
    assert (again.document.data.poses, again.document.data.used) == (60, 40)
    assert any(w.startswith("20 rows copy others") for w in again.warnings)
    sound = lc.verdict(again).sound
    assert (sound.passed, sound.code, sound.number) == (None, "rows-copied", 20.0)
    assert not once.document.data.warnings()


def test_a_validation_counts_copied_rows_once() -> None:
    data = doubled(ARM.read(SDS, 1), 20)
    found = lc.validate(ARM.truth, data, noise=lc.Noise(SDS), method="implicit-loop")
    assert len(found.poses) == 40
    assert found.accuracy is not None
    assert found.accuracy.poses == 40


def test_copies_are_judged_by_all_rows_once() -> None:
    """A part of the rows may look otherwise than all of them."""
    case = Case(ARM.truth, doubled(ARM.read(SDS, 1), 20), lc.Noise(SDS), Fit())
    part = case.calibrated(np.arange(10, 60))
    assert len(part.dataset) == 30
    assert part.document.data.copied == ()


def test_methods_compete_on_rows_that_count_once() -> None:
    result = lc.calibrate(
        ARM.truth, doubled(ARM.read(SDS, 1), 20), noise=lc.Noise(SDS), method="auto"
    )
    assert len(result.dataset) == 40
    assert len(result.document.data.copied) == 20


def test_poses_taken_several_times_on_purpose_are_no_copies() -> None:
    data = ARM.read(SDS, 1).take(np.repeat(np.arange(40), 2))
    assert not copies(data, QUANTITIES, OUTPUTS).size
    assert not copies(data.take(slice(0, 70)), QUANTITIES, OUTPUTS).size


def test_poses_without_readings_of_instruments_are_no_copies() -> None:
    data = {q: np.zeros(10) for q in QUANTITIES} | {q: np.full(10, np.nan) for q in OUTPUTS}
    assert not copies(lc.Dataset.from_arrays(data), QUANTITIES, OUTPUTS).size


@pytest.mark.parametrize("step", [0.5, 1.0, 3.0])
def test_coarse_readings_of_repeated_poses_agree_by_chance(step: float) -> None:
    """Of one coordinate on a grid of `step` sds, 100 poses measured three times."""
    named = 0
    for seed in range(50):
        rng = np.random.default_rng(seed)
        u = np.repeat(np.round(rng.uniform(-1, 1, 100), 3), 3)
        data = {"u": u, "y": np.round((u / 1e-3 + rng.normal(size=300)) / step) * step * 1e-3}
        named += copies(lc.Dataset.from_arrays(data), ("u", "y"), ("y",)).size > 0
    assert named == 0


def test_copies_among_repeated_poses_are_found() -> None:
    rng = np.random.default_rng(1)
    u = np.repeat(np.round(rng.uniform(-1, 1, 100), 3), 3)
    read = {a: np.round(u / 1e-3 + rng.normal(size=300), 2) * 1e-3 for a in "xyz"}
    data = {q: np.append(v, v[:30]) for q, v in {"u": u, **read}.items()}
    found = copies(lc.Dataset.from_arrays(data), ("u", *"xyz"), tuple("xyz"))
    assert found.tolist() == list(range(300, 330))

"""Rows copied from others count once; readings that agree by chance do not."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

import loopcal as lc
from loopcal.estimation.fit import Fit
from loopcal.measurements.copies import Copies, copies
from loopcal.statistics.case import Case
from tests.reference.simulated import planar_arm

ARM = planar_arm(40)
Array = NDArray[np.float64]
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
    assert part.data_entry.copied == ()


def test_methods_compete_on_rows_that_count_once() -> None:
    result = lc.calibrate(
        ARM.truth, doubled(ARM.read(SDS, 1), 20), noise=lc.Noise(SDS), method="auto"
    )
    assert len(result.dataset) == 40
    assert len(result.document.data.copied) == 20


def test_poses_taken_several_times_on_purpose_are_no_copies() -> None:
    data = ARM.read(SDS, 1).take(np.repeat(np.arange(40), 2))
    assert not copies(data, QUANTITIES, OUTPUTS).rows.size
    assert not copies(data.take(slice(0, 70)), QUANTITIES, OUTPUTS).rows.size


def test_poses_without_readings_of_instruments_are_no_copies() -> None:
    data = {q: np.zeros(10) for q in QUANTITIES} | {q: np.full(10, np.nan) for q in OUTPUTS}
    assert not copies(lc.Dataset.from_arrays(data), QUANTITIES, OUTPUTS).rows.size


SCALES: dict[str, Callable[[Array], Array]] = {
    "as read": lambda y: y,
    "in another unit": lambda y: y * 0.0254,
    "counts of an encoder": lambda y: y * (2.0 * np.pi / 2**13),
    "a logarithm": np.log,
    "a reciprocal": lambda y: 1.0 / y,
}


def repeated(
    seed: int, poses: int, times: int, outputs: int, step: float, spread: float = 0.0
) -> tuple[Array, Array]:
    """Poses (N,) and readings (outputs, N), noise 1 (or 10^spread times as much) on a grid."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1.0, 1.0, poses), times)
    place = np.repeat(rng.uniform(100.0, 2100.0, (outputs, poses)), times, axis=1)
    sd = np.repeat(10.0 ** rng.uniform(-spread, spread, poses), times)
    read = place + sd * rng.normal(size=place.shape)
    return u, np.round(read / step) * step if step else read


def sought(u: Array, read: Array) -> Copies:
    names = [f"y{i}" for i in range(len(read))]
    data = lc.Dataset.from_arrays({"u": u, **dict(zip(names, read, strict=True))})
    return copies(data, ("u", *names), names)


@pytest.mark.parametrize(("poses", "times"), [(40, 2), (100, 3), (10, 20)])
@pytest.mark.parametrize("outputs", [1, 2, 3])
@pytest.mark.parametrize("step", [0.3, 1.0, 3.0])
def test_coarse_readings_of_repeated_poses_agree_by_chance(
    step: float, outputs: int, poses: int, times: int
) -> None:
    """Whatever the unit; the scatter may differ from pose to pose."""
    for spread in (0.0, 0.3):
        for seed in range(3):
            u, read = repeated(seed, poses, times, outputs, step, spread)
            for convert in ("as read", "in another unit", "counts of an encoder"):
                assert not sought(u, SCALES[convert](read)).copied.size


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize(("poses", "times"), [(100, 3), (300, 2)])
def test_the_grid_may_be_uneven(scale: str, poses: int, times: int) -> None:
    """As where a file holds a function of what was read, or so many significant digits."""
    for seed in range(3):
        for outputs in (1, 3):
            for step in (0.3, 1.0):
                u, read = repeated(seed, poses, times, outputs, step)
                assert not sought(u, SCALES[scale](read)).copied.size


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("step", [0.0, 1e-3, 0.03])
@pytest.mark.parametrize("outputs", [2, 3])
def test_copies_are_found_where_readings_are_fine(outputs: int, step: float, scale: str) -> None:
    """Beside poses that were measured again, of any number."""
    for poses, times, number in ((60, 1, 1), (60, 1, 20), (40, 2, 20), (100, 3, 30), (10, 20, 50)):
        u, read = repeated(poses, poses, times, outputs, step)
        read = SCALES[scale](read)
        found = sought(np.append(u, u[:number]), np.hstack([read, read[:, :number]]))
        assert found.copied.tolist()[-number:] == list(range(len(u), len(u) + number))


@pytest.mark.parametrize("scale", SCALES)
def test_copies_of_a_single_output_are_found(scale: str) -> None:
    """Few repeated poses cannot tell fine readings from coarse ones; many can."""
    for poses, times, number in ((60, 1, 1), (60, 1, 20), (100, 3, 300)):
        u, read = repeated(poses, poses, times, 1, 1e-3)
        read = SCALES[scale](read)
        found = sought(np.append(u, u[:number]), np.hstack([read, read[:, :number]]))
        assert found.copied.size >= number


def test_rows_that_agree_by_chance_are_kept_and_said() -> None:
    rng = np.random.default_rng(1)
    u = np.repeat(np.linspace(0.0, 1.0, 20), 4)
    data = {"u": u, "y": np.round(3.0 * u + 0.1 * rng.normal(size=80), 1)}
    line = lc.Mechanism.from_function(
        lambda x, p: (x.y - p.a * x.u,), {"u": "1", "y": "1"}, {"a": (3.0, "1")}, outputs=("y",)
    )
    result = lc.calibrate(line, data, noise={"u": 0.0, "y": 0.1}, method="implicit-loop")
    kept = result.document.data
    assert (kept.used, kept.copied) == (80, ())
    assert len(kept.agreeing) == len(u) - len(np.unique(np.array([u, data["y"]]), axis=1).T)
    assert any(w.startswith(f"{len(kept.agreeing)} rows equal others") for w in result.warnings)
    assert lc.verdict(result).sound.code != "rows-copied"

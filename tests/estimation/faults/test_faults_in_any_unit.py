"""The search for faults of a file knows no unit: neither what it finds nor what it lets pass."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import loopcal as lc
from analyses.instruments import SIX
from loopcal.estimation.faults.misfit import misfit
from loopcal.estimation.faults.search import column_faults
from loopcal.estimation.steps import started
from loopcal.mechanisms.origins import joint_chain
from tests.reference.cameras import camera

PIXELS = [(1.0, 1.0), (1e-6, 1e-6), (1e6, 1e6), (1e6, 1e-3)]
JOINTS = ["q1", "q2", "q3"]


@dataclass(frozen=True)
class Seen:
    """Readings of an arm by a camera whose u and v count in units of so many pixels."""

    arm: lc.Mechanism
    data: lc.Dataset
    sds: dict[str, float]


def seen(pixels: tuple[float, float], off: float, seed: int, focal: float = 2000.0) -> Seen:
    """Off the drawing by so much [m, rad]; sds: 0.3 pixels, 20 urad."""
    nominal = {"camera_x": 0.3, "camera_y": 0.1, "camera_z": 3.0, "camera_rx": 0.1, "mark_x": 0.04}
    made = lc.assemble(joint_chain(SIX[:3]), [camera(pixels=pixels, focal=focal)], nominal)
    arm = lc.fix_redundant(made)
    rng = np.random.default_rng(seed)
    truth = {
        n: arm.parameters[n].nominal + rng.normal(0.0, off)
        for n in arm.parameters.free
        if arm.parameters[n].unit != "1"
    }
    read = dict(zip("uv", (0.3 * focal / 2000.0 * unit for unit in pixels), strict=True))
    sds = {**dict.fromkeys(JOINTS, 2e-5), **read}
    poses = lc.random_poses(dict.fromkeys(JOINTS, (-0.7, 0.7)), 30, seed=seed)
    noise = lc.Noise(sds)
    return Seen(arm, lc.simulate(arm, poses, noise=noise, seed=seed, truth=truth).dataset, sds)


def faults(its: Seen, **changed: NDArray[np.float64]) -> tuple[lc.ColumnFault, ...]:
    """Whether or not anything but the drawing speaks for one."""
    read = {q: changed.get(q, np.asarray(its.data[q])) for q in its.arm.quantities}
    data = lc.Dataset.from_arrays(read)
    return column_faults(started(its.arm, data, lc.Noise(its.sds), "nominal"), suspected=True)


@pytest.mark.parametrize(("off", "focal"), [(0.0, 2000.0), (5e-3, 0.004)])
def test_perfect_readings_of_any_unit_and_steepness_show_no_fault(off: float, focal: float) -> None:
    shares = []
    for pixels in PIXELS:
        its = seen(pixels, off, seed=1, focal=focal)
        if pixels in (PIXELS[0], PIXELS[3]):
            assert faults(its) == ()
        shares.append(misfit(started(its.arm, its.data, lc.Noise(its.sds), "nominal")).share)
    assert shares[:3] == pytest.approx([shares[0]] * 3, rel=1e-3)


@pytest.mark.parametrize("pixels", PIXELS[1:3])
def test_a_fault_is_found_and_its_size_is_in_the_unit_of_the_reading(
    pixels: tuple[float, float],
) -> None:
    its = seen(pixels, 1e-3, seed=2)
    (reversed_,) = faults(its, q2=-np.asarray(its.data["q2"]))
    assert reversed_.code == "reversed"
    assert "q2" in reversed_.quantities
    assert reversed_.unit == "1"
    assert reversed_.after is not None
    assert reversed_.before is not None
    assert reversed_.after < 5 * pixels[0] < reversed_.before  # in pixels of u
    assert "deg" not in str(reversed_)
    assert " m " not in str(reversed_)


def test_another_machine_is_said_to_miss_by_so_much_in_the_unit_of_the_reading() -> None:
    its = seen((1.0, 1.0), 1e-3, seed=3)
    rng = np.random.default_rng(3)
    (other,) = faults(its, **{q: rng.uniform(-0.7, 0.7, 30) for q in JOINTS})
    assert other.code in ("wrong-machine", "rows-shuffled")
    assert other.unit == "1"
    assert "deg" not in other.words


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_a_function_of_ones_own_shows_no_fault_in_any_unit(unit: float) -> None:
    def scale(x: Any, p: Any) -> Any:
        far = p.height + np.cos(x.tilt) * p.arm
        return [unit * p.gain * np.sin(x.tilt + p.zero) / far - x.shown]

    own = lc.Mechanism.from_function(
        scale,
        {"tilt": "rad", "shown": "1"},
        {"height": (0.5, "m"), "arm": (0.3, "m"), "gain": (900.0, "1"), "zero": (0.0, "rad")},
        outputs=("shown",),
    )
    own = own.with_parameters(own.parameters.with_fixed(["height"]))
    sds = {"tilt": 1e-5, "shown": 0.5 * unit}
    poses = {"tilt": np.linspace(-1.2, 1.2, 40)}
    truth = {"arm": 0.301, "zero": 2e-3, "gain": 905.0}
    made = lc.simulate(own, poses, noise=lc.Noise(sds), seed=1, truth=truth)
    for method in ("implicit-loop", "least-squares"):
        result = lc.calibrate(own, made.dataset, noise=sds, method=method)
        assert result.status.converged
        assert lc.find_outliers(result).columns == ()
    problem = started(own, made.dataset, lc.Noise(sds), "nominal")
    assert column_faults(problem, suspected=True) == ()
    read = {**made.dataset.readings, "tilt": np.degrees(made.dataset["tilt"])}
    wrong = started(own, lc.Dataset.from_arrays(read), lc.Noise(sds), "nominal")
    (fault,) = column_faults(wrong, suspected=True)
    assert (fault.code, fault.quantities, fault.unit) == ("unit", ("tilt",), "1")

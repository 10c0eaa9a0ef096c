"""Accuracy: a distance for positions, an angle for orientations, for each instrument."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import loopcal as lc
from analyses.instruments import ARM_VALUES, six_axis
from loopcal.estimation.accuracy import AccuracyTally, accuracy, deviations
from loopcal.mechanisms.instruments.point import point
from loopcal.mechanisms.instruments.pose import pose
from loopcal.mechanisms.machine import assemble
from tests.estimation.test_contacts import READINGS
from tests.reference.robots import urdf_of

EXACT = lc.Noise({"*": 0.0})
ANGLE = 0.02


def turned(angle: float) -> lc.Result:
    """A perfect arm whose measured orientations are all off by an angle, about changing axes."""
    arm = assemble(six_axis(), [pose()], ARM_VALUES)
    data = lc.simulate(arm, READINGS, noise=EXACT, seed=1).dataset
    columns = ("qx", "qy", "qz", "qw")
    axes = np.random.default_rng(3).standard_normal((len(data), 3))
    off = Rotation.from_rotvec(angle * axes / np.linalg.norm(axes, axis=1, keepdims=True))
    seen = Rotation.from_quat(np.array([data[q] for q in columns]).T) * off
    read = data.with_readings(dict(zip(columns, seen.as_quat().T, strict=True)))
    noise = lc.Noise({"q*": 1e-5, "xyz": 1e-4, "pose_w*": 1e-2})
    prior = lc.Prior({"*": 1e-9})
    return lc.calibrate(
        arm, read, noise=noise, prior=prior, start="nominal", method="implicit-loop"
    )


def test_the_accuracy_of_an_orientation_is_the_angle_between_computed_and_measured() -> None:
    found = turned(ANGLE).accuracy_before
    assert found is not None
    assert found.unit == "m"
    assert found.max < 1e-12
    assert found.orientation is not None
    assert found.orientation.unit == "rad"
    assert found.orientation.mean == pytest.approx(ANGLE, rel=1e-9)
    assert found.orientation.max == pytest.approx(ANGLE, rel=1e-9)
    (camera,) = found.by
    assert (camera.instrument, camera.station) == ("pose", "base")
    assert camera.orientation == found.orientation


def test_the_summary_and_the_document_show_the_orientation_beside_the_position() -> None:
    result = turned(ANGLE)
    entry = result.document.accuracy
    assert entry is not None
    assert entry.orientation is not None
    assert entry.orientation.before.rms == pytest.approx(ANGLE, rel=1e-9)
    lines = str(result.document).splitlines()
    (head,) = [i for i, line in enumerate(lines) if line.startswith("orientation")]
    assert "mean [deg]" in lines[head]
    assert lines[head + 1].split()[:2] == ["nominal", "1.146"]


def test_outputs_in_metres_and_radians_have_an_accuracy_each() -> None:
    """Formerly called unknown: a loop of one's own with outputs of two units."""
    flat = lc.Mechanism.from_function(
        lambda x, p: (p.a * np.cos(x.q) - x.u, p.a * np.sin(x.q) - x.v, x.q + p.b - x.phi),
        {"q": "rad", "u": "m", "v": "m", "phi": "rad"},
        {"a": (1.0, "m"), "b": (0.0, "rad")},
        outputs=("u", "v", "phi"),
    )
    q = np.linspace(0.0, 2.0, 30)
    data = {"q": q, "u": 1.003 * np.cos(q), "v": 1.003 * np.sin(q), "phi": q + 0.01 + 2 * np.pi}
    result = lc.calibrate(
        flat,
        data,
        noise=lc.Noise({"q": 0.0, "u": 1e-4, "v": 1e-4, "phi": 1e-4}),
        method="implicit-loop",
        units={"phi": "rad"},
    )
    found = result.accuracy_before
    assert found is not None
    assert found.unit == "m"
    assert found.mean == pytest.approx(0.003, rel=1e-9)
    assert found.orientation is not None
    assert found.orientation.mean == pytest.approx(0.01, rel=1e-9)


def test_every_instrument_and_station_has_its_own_accuracy() -> None:
    instruments = [
        point(name, readings=[f"{a}_{name}" for a in "xyz"], station=name, target="tool")
        for name in ("left", "right")
    ]
    arm = assemble(six_axis(), instruments, ARM_VALUES)
    data = lc.simulate(arm, READINGS, noise=EXACT, seed=1).dataset
    off = data.with_readings({"x_right": data["x_right"] + 2e-3})
    noise = lc.Noise({"q*": 1e-5, "?_left": 1e-4, "?_right": 1e-4})
    prior = lc.Prior({"*": 1e-9})
    result = lc.calibrate(
        arm, off, noise=noise, prior=prior, start="nominal", method="implicit-loop"
    )
    found = result.accuracy_before
    assert found is not None
    left, right = found.by
    assert (left.station, right.station) == ("left", "right")
    assert left.position is not None
    assert right.position is not None
    assert left.position.max < 1e-12
    assert right.position.mean == pytest.approx(2e-3, rel=1e-9)
    assert found.poses == left.position.poses + right.position.poses
    lines = str(result.document).splitlines()
    assert any(line.startswith("  right") for line in lines)


@pytest.mark.parametrize("whole", [True, False])
def test_instruments_whose_poses_have_gaps_have_an_accuracy_each(whole: bool) -> None:
    """Each reads poses of its own; where not whole, it reads one coordinate in each of them."""
    instruments = [
        point(name, readings=[f"{a}_{name}" for a in "xyz"], station=name, target="tool")
        for name in ("left", "right")
    ]
    arm = assemble(six_axis(), instruments, ARM_VALUES)
    data = lc.simulate(arm, READINGS, noise=EXACT, seed=1).dataset
    numbers = np.arange(len(data))
    values = {}
    for i, name in enumerate(("left", "right")):
        for k, axis in enumerate("xyz"):
            there = numbers % 2 == i if whole else numbers % 6 == 2 * k + i
            error = 1e-3 * (1 + i)
            values[f"{axis}_{name}"] = np.where(there, data[f"{axis}_{name}"] + error, np.nan)
    noise = lc.Noise({"q*": 1e-5, "?_left": 1e-4, "?_right": 1e-4})
    result = lc.calibrate(
        arm,
        data.with_readings(values),
        noise=noise,
        prior=lc.Prior({"*": 1e-9}),
        start="nominal",
        method="implicit-loop",
    )
    found = result.accuracy_before
    assert found is not None
    for i, one in enumerate(found.by):
        assert one.position is not None
        each = np.sqrt(3.0) if whole else 1.0
        assert one.position.rms == pytest.approx(1e-3 * (1 + i) * each, rel=1e-6)
        assert one.position.poses == np.sum(numbers % 2 == i)
    assert "accuracy unknown" not in str(result.document)


def test_sums_over_chunks_are_the_accuracy_of_all_poses() -> None:
    result = turned(ANGLE)
    mechanism = result.mechanism
    rows = [mechanism.tape.quantities.index(q) for q in mechanism.compared]
    random = np.random.default_rng(2)
    measured = result.problem.readings[rows]
    differences = 1e-3 * random.standard_normal(measured.shape)
    whole = accuracy(deviations(mechanism, measured, differences))
    half = measured.shape[1] // 2
    tally = AccuracyTally()
    for part in (slice(None, half), slice(half, None)):
        chunk = AccuracyTally()
        chunk.add(deviations(mechanism, measured[:, part], differences[:, part]))
        tally.add_other(chunk)
    found = tally.accuracy()
    assert whole is not None
    assert found is not None
    assert whole.orientation is not None
    assert found.orientation is not None
    for one, other in ((whole, found), (whole.orientation, found.orientation)):
        assert (one.unit, one.max, one.poses) == (other.unit, other.max, other.poses)
        assert other.rms == pytest.approx(one.rms, rel=1e-12)
        assert other.p95 == pytest.approx(one.p95, rel=0.05)
    assert [by.instrument for by in found.by] == [by.instrument for by in whole.by]


def test_a_camera_on_a_real_arm_has_both(shared_data: Callable[[str], Path]) -> None:
    path = shared_data("franka_camera/poses.csv")
    machine = lc.machines.urdf(urdf_of("Panda"), "panda_link0", "panda_link8")
    arm = assemble(machine, [pose("camera", target="camera")])
    arm = lc.fix_redundant(arm)
    named = {f"panda_joint{i}": f"q{i}" for i in range(1, 8)}
    named |= {name: name for name in ("x", "y", "z", "qw", "qx", "qy", "qz")}
    data = lc.read_dataset(path, named, pose="pose")
    noise = lc.Noise({"panda_joint*": 1e-4, "xyz": 1e-3, "camera_w*": 2e-3})
    prior = lc.Prior({"*": np.inf, "panda*": 1e-3})
    result = lc.calibrate(arm, data, noise=noise, prior=prior, method="implicit-loop")
    found = result.accuracy_after
    assert found is not None
    assert found.orientation is not None
    assert found.rms < 2e-3
    assert found.orientation.rms < 5e-3
    # the independent value: each turn from the loops at the uncorrected readings
    off = np.array([result.differences_after[f"camera_w{a}"] for a in "xyz"])
    angles = 2.0 * np.arctan(0.5 * np.linalg.norm(off, axis=0))
    assert found.orientation.max == pytest.approx(angles.max(), rel=1e-12)

"""Hand-eye samples without pixels: which end the camera is on, and where it is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import loopcal as lc
from loopcal.arrays import Array
from loopcal.mechanisms.placement import inverse, rigid
from tests.refusals import refused


def place(angles: tuple[float, float, float], at: tuple[float, float, float]) -> Array:
    return rigid(Rotation.from_euler("xyz", angles, degrees=True).as_matrix(), np.array(at))


EYE = {
    True: place((3, -4, 92), (0.03, -0.06, 0.05)),  # in the flange
    False: place((-115, 3, 95), (1.2, 0.2, 0.7)),  # in the base
}
MARKER = {
    True: place((180, 2, 40), (0.55, 0.1, 0.02)),  # in the base
    False: place((5, 3, 60), (0.02, -0.04, 0.08)),  # on the flange
}


def samples(*, on_hand: bool, count: int = 15, seed: int = 1) -> tuple[Array, Array]:
    """Poses of the flange, and of a marker in the camera with 0.3 mm and 1 mrad of noise."""
    random = np.random.default_rng(seed)
    turns = Rotation.from_euler("xyz", random.uniform(-35, 35, (count, 3)), degrees=True)
    hand = np.tile(np.eye(4), (count, 1, 1))
    hand[:, :3, :3] = Rotation.from_euler("x", 180, degrees=True).as_matrix() @ turns.as_matrix()
    hand[:, :3, 3] = random.uniform((0.3, -0.3, 0.3), (0.6, 0.3, 0.7), (count, 3))
    between = inverse(hand) if on_hand else hand
    seen = inverse(EYE[on_hand]) @ between @ MARKER[on_hand]
    noise = np.tile(np.eye(4), (count, 1, 1))
    noise[:, :3, :3] = Rotation.from_rotvec(random.normal(0, 1e-3, (count, 3))).as_matrix()
    seen = seen @ noise
    seen[:, :3, 3] += random.normal(0, 3e-4, (count, 3))
    return hand, seen


def motion(T: Array) -> str:
    numbers = dict(zip("xyzw", Rotation.from_matrix(T[:3, :3]).as_quat().tolist(), strict=True))
    at = dict(zip("xyz", T[:3, 3].tolist(), strict=True))
    return str({"translation": at, "rotation": numbers}).replace("'", "")


def easy_handeye(path: Path, robot: Array, seen: Array) -> Path:
    """As easy_handeye 2 keeps them."""
    rows = [
        f"- robot: {motion(A)}\n  tracking: {motion(C)}\n" for A, C in zip(robot, seen, strict=True)
    ]
    path.write_text("samples:\n" + "".join(rows), encoding="utf-8")
    return path


@pytest.mark.parametrize("on_hand", [True, False])
def test_samples_of_easy_handeye_are_calibrated(tmp_path: Path, on_hand: bool) -> None:
    hand, seen = samples(on_hand=on_hand)
    # It keeps the base in the flange where the camera stands beside the robot.
    robot = hand if on_hand else inverse(hand)
    project = lc.init(easy_handeye(tmp_path / "eye.samples", robot, seen), out=tmp_path / "out")
    where = "on the flange" if on_hand else "beside the robot"
    assert f"taken to be {where}:" in project.remarks[1]
    np.testing.assert_allclose(project.dataset["x"], hand[:, 0, 3], atol=1e-9)
    result = lc.calibrate(tmp_path / "out/project.toml")
    assert result.verdict is not None
    assert result.verdict.better.code == "nothing-stated"
    lc.export(result, "easy_handeye", out=tmp_path / "exported")
    path = tmp_path / f"exported/camera_eye_on_{'hand' if on_hand else 'base'}.yaml"
    stated = dict(
        row.strip().split(": ") for row in path.read_text("utf-8").splitlines() if ": " in row
    )
    at = np.array([float(stated[axis]) for axis in "xyz"])
    np.testing.assert_allclose(at, EYE[on_hand][:3, 3], atol=2e-3)
    # Of another day, and with the camera knocked by 20 mm. One beside the robot is placed anew.
    hand, seen = samples(on_hand=on_hand, seed=2)
    robot = hand if on_hand else inverse(hand)
    day = easy_handeye(tmp_path / "day.samples", robot, seen)
    assert lc.verify(result, day).verdict["consistent"].passed
    seen = place((0, 0, 0), (0.02, 0, 0)) @ seen
    day = easy_handeye(tmp_path / "day.samples", robot, seen)
    assert lc.verify(result, day).verdict["consistent"].passed != on_hand


def test_what_is_stated_beside_the_samples_says_where_the_camera_is(tmp_path: Path) -> None:
    hand, seen = samples(on_hand=True)
    easy_handeye(tmp_path / "eye.samples", hand, seen)
    for kind, remark in (("eye_in_hand", "on the flange, as"), ("eye_on_base", "beside the robot")):
        text = f"parameters:\n  calibration_type: {kind}\ntransform: {motion(np.eye(4))}\n"
        (tmp_path / "eye.calib").write_text(text, encoding="utf-8")
        assert remark in " ".join(lc.init(tmp_path).remarks)


def test_two_tables_of_poses(tmp_path: Path) -> None:
    """With turns A, B, C of the flange, and a matrix of the marker, in another order."""
    hand, seen = samples(on_hand=False)
    angles = Rotation.from_matrix(hand[:, :3, :3]).as_euler("ZYX", degrees=True)
    rows = [
        f"{i}," + ",".join(f"{v:.6f}" for v in (*(1e3 * hand[i, :3, 3]), *angles[i]))
        for i in range(len(hand))
    ]
    table = "\n".join(["pose,X [mm],Y [mm],Z [mm],A [deg],B [deg],C [deg]", *rows])
    (tmp_path / "flange.csv").write_text(table + "\n", encoding="utf-8")
    names = [f"T{i}{j}" for i in range(4) for j in range(4)]
    rows = [f"{i}," + ",".join(map(repr, seen[i].ravel().tolist())) for i in range(14, -1, -1)]
    table = "\n".join([",".join(["pose", *names]), *rows])
    (tmp_path / "target.csv").write_text(table + "\n", encoding="utf-8")
    project = lc.init(tmp_path)
    assert "beside the robot" in " ".join(project.remarks)
    np.testing.assert_allclose(project.dataset["z"], hand[:, 2, 3], atol=1e-8)
    np.testing.assert_allclose(project.dataset["seen_x"], seen[:, 0, 3], atol=1e-9)


def test_samples_of_different_moments_are_refused(tmp_path: Path) -> None:
    hand, seen = samples(on_hand=True)
    with refused("mismatched-poses", "no place of camera and marker"):
        lc.init(easy_handeye(tmp_path / "eye.samples", hand, np.roll(seen, 1, axis=0)))
    with refused("not-identifiable", "2 hand-eye samples"):
        lc.init(easy_handeye(tmp_path / "eye.samples", hand[:2], seen[:2]))

"""What the figure in space shows of whole robots and cameras: limbs, places, errors as arrows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import loopcal as lc
from loopcal.companions.app.pictures import machine_figure, moved
from loopcal.companions.app.scene import Scene
from loopcal.estimation.prediction import predict_outputs
from loopcal.mechanisms.cameras.lens import project
from loopcal.mechanisms.instruments.camera import all_cameras
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.skeleton import tree_poses
from loopcal.report.sighted import camera_places, joined, sightings
from tests.mechanisms.test_branches import JOINTS, dual_arm
from tests.mechanisms.test_camera import hands, pixels, readings
from tests.mechanisms.test_camera import mechanism as camera_of

POINTS = {str(i): (0.02 * x, 0.02 * y, 0.0) for i, (x, y) in enumerate(np.ndindex(3, 3))}
NOMINAL = {"tracker_x": 2.0, "tracker_rz": 0.5, "ball_x": 0.1, "touch_1_x": 0.05}
NOMINAL |= {"touch_2_y": 0.04, "eye_f": 900.0, "eye_cx": 640.0, "eye_cy": 480.0}
NOMINAL |= {"eye_rx": np.pi / 2.0}
"""The camera looks from one hand to the other one."""


def robot(folder: Path) -> Mechanism:
    """Two hands that touch, a tracker that sees the left one, a camera on that one that sees the
    right one."""
    machine = lc.machines.tree(str(dual_arm(folder)), use=["left_hand", "right_hand"])
    touch = lc.instruments.contact("touch", between=("left_hand", "right_hand"))
    ball = lc.instruments.point("point", on="left_hand", station="tracker", target="ball")
    eye = lc.instruments.camera("eye", points=POINTS, on="left_hand", sees="right_hand")
    return lc.assemble(machine, [touch, ball, eye], NOMINAL)


def poses(count: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(5)
    return {q: rng.uniform(-0.15, 0.15, count) for q in JOINTS}


def placed(made: Mechanism, q: dict[str, np.ndarray], body: str) -> np.ndarray:
    """T_drawn_body (N, 4, 4)."""
    T = tree_poses(made, q, body)
    assert T is not None
    return T


def outputs(made: Mechanism, q: dict[str, np.ndarray], **changed: float) -> dict[str, np.ndarray]:
    """What is computed with some parameters changed by so much."""
    count = len(q[JOINTS[0]])
    tape = made.tape
    values = np.array([p.nominal + changed.get(p.name, 0.0) for p in made.parameters])
    asked = np.array([q.get(name, np.zeros(count)) for name in tape.quantities])
    rows = predict_outputs(made, values, asked, np.zeros((len(tape.pose_constants), count)))
    return dict(zip(made.outputs, rows, strict=True))


def test_arrows_lead_where_the_machine_computes_what_was_seen(tmp_path: Path) -> None:
    made, q = robot(tmp_path), poses(6)
    true = outputs(made, q, ball_z=1e-3, board_x=2e-4, board_y=-1e-4)
    off = {name: computed - true[name] for name, computed in outputs(made, q).items()}
    gap = np.array([1e-3, -2e-3, np.nan, 1e-3, 1e-3, 1e-3])
    read = {**q, **true, "touch_gap": np.zeros(6)}
    every = {s.instrument: s for s in sightings(made, read, {**off, "touch_gap": gap})}
    hands = {side: placed(made, q, f"{side}_hand") for side in ("left", "right")}

    point = every["point"]
    R = hands["left"][:, :3, :3]
    assert pytest.approx(-1e-3 * R[:, :, 2], abs=1e-9) == point.along.T
    assert pytest.approx((hands["left"] @ [0.1, 0.0, 1e-3, 1.0])[:, :3], abs=1e-9) == point.at.T

    touch = every["touch"]
    ends = [
        (hands["left"] @ [0.05, 0.0, 0.0, 1.0])[:, :3],
        (hands["right"] @ [0.0, 0.04, 0.0, 1.0])[:, :3],
    ]
    away = (ends[0] - ends[1]) / np.linalg.norm(ends[0] - ends[1], axis=1)[:, None]
    assert np.isnan(touch.at[:, 2]).all()  # not read there
    kept = np.isfinite(gap)
    assert touch.at.T[kept] == pytest.approx(ends[0][kept])
    assert touch.along.T[kept] == pytest.approx((gap[:, None] * away)[kept])

    image = every["eye"]
    # board_x, ... is where the hand is before the board, so that the board is the other way.
    shift = np.einsum("nij,j->ni", hands["right"][:, :3, :3], [2e-4, -1e-4, 0.0])
    eye = hands["left"][:, :3, :3]
    eye = eye @ np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])  # eye_rx = 90 deg
    # An image shows a shift along the view as one across it, more so beside the middle.
    moved_by = np.einsum("nji,nj->ni", eye, shift)
    P = np.einsum("nji,nj->ni", eye, image.at.T - hands["left"][:, :3, 3])
    seen = moved_by[:, :2] - P[:, :2] / P[:, 2:] * moved_by[:, 2:]
    expected = np.einsum("nij,nj->ni", eye[:, :, :2], seen)
    miss = np.linalg.norm(image.along.T - expected, axis=1) / np.linalg.norm(shift, axis=1)
    assert miss.max() < 0.03  # the lens is not linear over the shift
    whole = joined([*every.values()])
    assert whole is not None
    assert np.isfinite(whole.at + whole.along).all()


def test_a_scene_moves_and_an_arm_that_is_not_read_is_left_out(tmp_path: Path) -> None:
    scene = Scene(robot(tmp_path))
    at = {q: float(v[0]) for q, v in poses(1).items()}
    figure = machine_figure(scene, at)
    assert figure is not None
    kinds = [trace.get("name") for trace in figure["data"]]
    assert [kind for kind in kinds if kind] == ["camera", "board", "touch"]
    half = {q: v for q, v in at.items() if not q.startswith("right")}
    for joints in (at, half):
        update, which = moved(scene, joints)
        assert which == list(range(len(which)))
        lengths = [len(trace["x"]) for trace in figure["data"][: len(which)]]
        assert [len(x) for x in update["x"]] == lengths
    limbs = scene.limbs(half)
    assert limbs is not None
    whole = scene.limbs(at)
    assert whole is not None
    read = np.isfinite(limbs).all(axis=1)
    assert 6 < read.sum() < np.isfinite(whole).all(axis=1).sum()
    np.testing.assert_array_equal(limbs[read], whole[read])


@pytest.mark.parametrize("on", ["base", "body"])
def test_a_camera_without_a_robot_is_drawn_before_its_board(on: str) -> None:
    made, T = camera_of(on), hands(5, 1)
    read = {k: v for k, v in readings(T, pixels(T, on=on)).items() if len(k) < 3}
    ((entry, family),) = [(c, f) for c in all_cameras(made) for f in made.families]
    T_camera, T_board = camera_places(made, entry, family, read)
    X = np.column_stack([entry.board.xyz, np.ones(len(entry.board.points))]).T
    seen = (np.linalg.inv(T_camera) @ T_board @ X).transpose(1, 0, 2)[:3]
    uv = np.array(project(entry.intrinsics.lens, seen, entry.intrinsics.values))
    assert uv.transpose(2, 0, 1) == pytest.approx(pixels(T, on=on), abs=1e-6)
    figure = machine_figure(Scene(made), {name: float(v[0]) for name, v in read.items()})
    assert figure is not None
    assert [t["name"] for t in figure["data"] if "name" in t] == ["camera", "board"]

"""`init` of whole robots with cameras: corners in folders and files among other observations."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import loopcal as lc
from analyses import trees
from loopcal.errors import Code
from tests.refusals import refused

Array = NDArray[np.float64]
BODIES = """body,parent,joint,a [mm],d [mm],alpha [deg],theta [deg]
l1,base,lq1,60,350,90,0
l2,l1,lq2,420,0,0,0
lh,l2,,0,100,0,0
r0,base,,1500,0,0,0
r1,r0,rq1,60,350,90,190
r2,r1,rq2,400,0,0,0
rh,r2,,0,100,0,0
"""
CAMERA = "camera name=sight on=lh sees=rh"
POINT = "point name=tracker on=rh columns=x,y,z file=points"
F, CENTRE, SD = 1200.0, np.array([640.0, 480.0]), 0.2
ZERO = 3e-3
"""How far rq2 is off."""


def row(theta: float, a: float, d: float, alpha: float) -> Array:
    """A row of Denavit and Hartenberg [m, rad]."""
    c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
    return np.array(
        [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]]
    )


def hands(q: Array) -> tuple[Array, Array]:
    """T_base_lh and T_base_rh of the true robot."""
    left = row(q[0], 0.06, 0.35, np.pi / 2) @ row(q[1], 0.42, 0.0, 0.0)
    right = row(0.0, 1.5, 0.0, 0.0) @ row(q[2] + np.radians(190), 0.06, 0.35, np.pi / 2)
    right = right @ row(q[3] + ZERO, 0.40, 0.0, 0.0)
    flange = row(0.0, 0.0, 0.1, 0.0)
    return left @ flange, right @ flange


def facing(T: Array, at: Array) -> Array:
    """T_body_thing of a thing whose z axis points from the body's origin to a place in the base."""
    z = np.linalg.inv(T)[:3, :3] @ (at - T[:3, 3])
    z /= np.linalg.norm(z)
    x = np.cross([0.3, 1.0, 0.2], z)
    x /= np.linalg.norm(x)
    made = np.eye(4)
    made[:3, :3] = np.column_stack([x, np.cross(z, x), z])
    made[:3, 3] = [0.01, -0.02, 0.03]
    return made


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """images/ with joints, corners and a board; points.csv of poses in which no camera looked."""
    (tmp_path / "bodies.csv").write_text(BODIES, "utf-8")
    draw = np.random.default_rng(4)
    points = {f"{i}": np.array([i % 4 * 0.02, i // 4 * 0.02, 0.0, 1.0]) for i in range(12)}
    left, right = hands(np.zeros(4))
    T_lh_camera = facing(left, right[:3, 3] + [0.0, 0.0, 0.0])
    T_rh_board = facing(right, 2.0 * right[:3, 3] - left[:3, 3])
    images = tmp_path / "images"
    images.mkdir()
    boards = ["board,point,x_m,y_m,z_m"]
    boards += [f"plate,{n},{x:.3f},{y:.3f},0" for n, (x, y, _, _) in points.items()]
    joints, corners = ["pose,lq1,lq2,rq1,rq2"], ["pose,camera,board,point,u_px,v_px"]
    for k in range(30):
        q = draw.uniform(-0.35, 0.35, 4)
        joints.append(f"{k}," + ",".join(f"{v:.7f}" for v in q + draw.normal(0.0, 2e-5, 4)))
        left, right = hands(q)
        T = np.linalg.inv(left @ T_lh_camera) @ right @ T_rh_board
        for name, X in points.items():
            P = T @ X
            uv = F * P[:2] / P[2] + CENTRE + draw.normal(0.0, SD, 2)
            corners.append(f"{k},front,plate,{name},{uv[0]:.4f},{uv[1]:.4f}")
    seen = ["pose,rq1,rq2,x [m],y [m],z [m]"]
    for k in range(25):
        q = np.append([0.0, 0.0], draw.uniform(-1.2, 1.2, 2))
        point = hands(q)[1][:3, 3] + [0.5, -0.2, 0.1] + draw.normal(0.0, 3e-5, 3)
        values = [*(q[2:] + draw.normal(0.0, 2e-5, 2)), *point]
        seen.append(f"{k}," + ",".join(f"{v:.7f}" for v in values))
    (images / "poses.csv").write_text("\n".join(joints) + "\n", "utf-8")
    (images / "readings.csv").write_text("\n".join(corners) + "\n", "utf-8")
    (images / "board.csv").write_text("\n".join(boards) + "\n", "utf-8")
    (tmp_path / "points.csv").write_text("\n".join(seen) + "\n", "utf-8")
    return tmp_path


def begun(folder: Path, *observe: str, one_by_one: bool = False) -> lc.InitialProject:
    """The project of the folder with these observations."""
    images = sorted((folder / "images").iterdir()) if one_by_one else [folder / "images"]
    files = [*images, folder / "points.csv"]
    return lc.init(*files, dh=folder / "bodies.csv", observe=observe, out=folder / "cell")


@pytest.mark.parametrize("one_by_one", [False, True])
def test_corners_join_the_observations_and_sds_are_learnt_where_no_camera_looked(
    folder: Path, one_by_one: bool
) -> None:
    made = begun(folder, CAMERA, POINT, one_by_one=one_by_one)
    assert len(made.dataset) == 30 + 25
    pixels = [q for q in made.mechanism.quantities if q.endswith((":u", ":v"))]
    assert len(pixels) == 24
    assert np.isfinite(made.dataset[pixels[0]]).sum() == 30
    result = lc.calibrate(folder / "cell" / "project.toml", method="implicit-loop")
    assert result.status.converged
    sds = result.reading_sds
    assert np.nanmin(sds[pixels[0]]) == pytest.approx(SD, rel=0.1)
    assert np.nanmin(sds["tracker_x"]) == pytest.approx(3e-5, rel=0.4)
    for name, true in (("offset_r2", ZERO), ("front_f", F), ("d_r2", 0.0)):
        assert abs(result.value[name] - true) < 3.5 * (result.sd[name] or 0.0)
    assert (result.sd["front_f"] or 0.0) < 0.02 * F


def test_one_camera_stands_at_one_place_for_boards_of_two_bodies(folder: Path) -> None:
    corners = (folder / "images" / "readings.csv").read_text("utf-8").splitlines()
    # the same plate, turned by nothing, as if the other body of the right arm held it
    more = [line.replace(",plate,", ",other,") for line in corners[1:]]
    (folder / "images" / "readings.csv").write_text("\n".join([*corners, *more]) + "\n", "utf-8")
    board = (folder / "images" / "board.csv").read_text("utf-8").splitlines()
    others = [line.replace("plate,", "other,") for line in board[1:]]
    (folder / "images" / "board.csv").write_text("\n".join([*board, *others]) + "\n", "utf-8")
    made = begun(
        folder, f"{CAMERA} board=plate", "camera name=second on=lh sees=r2 board=other", POINT
    )
    parameters = made.mechanism.parameters
    assert {"front_x", "plate_x", "other_x"} <= {*parameters.names}
    # boards are placed for the one place of the camera: both begin within a few pixels
    off = made.mechanism.loop_values(made.dataset)
    for name in ("plate", "other"):
        pixels = np.array([f for loop, f in off.items() if f":{name}:" in loop])
        assert np.sqrt(np.nanmean(np.square(pixels))) < 10.0


@pytest.mark.parametrize(
    ("observe", "code", "message"),
    [
        (f"{CAMERA} camera=left", "no-data", "camera='front', board='plate'"),
        (f"{CAMERA} file=elsewhere", "no-data", "corners of what 'sight' sees"),
        (POINT, "missing-key", "no observation is of these corners"),
        ("camera name=sight on=lh sees=rh joints=lq1:Q", "missing-column", ""),
    ],
)
def test_what_no_file_has_is_refused(folder: Path, observe: str, code: Code, message: str) -> None:
    poses = folder / "images" / "poses.csv"
    if message == "":
        poses.write_text(poses.read_text("utf-8").replace("lq1", "first"), "utf-8")
    with refused(code, message or "no column holds the joint 'lq1'"):
        begun(folder, *dict.fromkeys((observe, POINT)))


def test_images_of_two_folders_are_of_one_camera(folder: Path) -> None:
    images, more = folder / "images", folder / "more"
    more.mkdir()
    for name in ("poses.csv", "readings.csv", "board.csv"):
        text = (images / name).read_text("utf-8")
        (more / name).write_text(text, "utf-8")
    corners = (images / "readings.csv").read_text("utf-8").splitlines()
    some = [line for line in corners if ",plate,0," not in line]  # a point that one of them lacks
    (images / "readings.csv").write_text("\n".join(some) + "\n", "utf-8")
    made = lc.init(
        images, more, folder / "points.csv", dh=folder / "bodies.csv", observe=[CAMERA, POINT]
    )
    seen = made.dataset["front:plate:0:u"], made.dataset["front:plate:5:u"]
    assert [int(np.isfinite(one).sum()) for one in seen] == [30, 60]


def test_a_file_of_corners_may_hold_the_joints_in_every_row(folder: Path) -> None:
    images = folder / "images"
    header, *rows = (images / "poses.csv").read_text("utf-8").splitlines()
    joints = {row.split(",")[0]: row.split(",", 1)[1] for row in rows}
    first, *seen = (images / "readings.csv").read_text("utf-8").splitlines()
    both = [f"{first},{header.split(',', 1)[1]}"]
    both += [f"{row},{joints[row.split(',')[0]]}" for row in seen]
    (folder / "flat.csv").write_text("\n".join(both) + "\n", "utf-8")
    apart = lc.init(images, dh=folder / "bodies.csv", observe=[CAMERA], out=folder / "apart")
    (folder / "board.csv").write_bytes((images / "board.csv").read_bytes())
    made = lc.init(
        folder / "flat.csv",
        folder / "board.csv",
        dh=folder / "bodies.csv",
        observe=[CAMERA],
        out=folder / "flat",
    )
    for name in apart.mechanism.quantities:
        np.testing.assert_allclose(made.dataset[name], apart.dataset[name])


def test_a_camera_without_corners_is_refused(folder: Path) -> None:
    with refused("no-data", "'sight' sees"):
        lc.init(folder / "points.csv", dh=folder / "bodies.csv", observe=[CAMERA, POINT])


def test_boards_that_are_exchanged_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What one hand carries moves as that hand does, wherever boards and camera sit."""
    monkeypatch.setattr(trees, "POSES", 40)
    monkeypatch.setattr(trees, "FRESH", 2)
    world = trees.watching(np.random.default_rng([4, 3]))
    (tmp_path / "images").mkdir()
    for name, text in {"bodies.csv": world.bodies + "\n", **world.files}.items():
        (tmp_path / name).write_text(text, "utf-8")
    other = {"board=l": "board=r", "board=r": "board=l"}
    observe = [" ".join(other.get(word, word) for word in one.split()) for one in world.observe]
    with refused("mismatched-poses", "what 'left' saw moves as 'r_6' does, not as 'l_6'"):
        lc.init(tmp_path / "images", dh=tmp_path / "bodies.csv", observe=observe)


def test_a_later_day_is_read_from_images_beside_other_files(folder: Path) -> None:
    """The layout of the first day: joints that moved since are found by what the camera sees."""
    begun(folder, CAMERA, POINT)
    project = folder / "cell" / "project.toml"
    lc.calibrate(project, method="implicit-loop").save(folder / "cell" / "result")
    images, points = folder / "images", folder / "points.csv"
    same = lc.verify(folder / "cell" / "result", [images, points])
    assert "no change is seen" in str(same)
    lines = (images / "poses.csv").read_text("utf-8").splitlines()
    rows = [line.split(",") for line in lines[1:]]
    moved = [",".join([*row[:4], f"{float(row[4]) + 2e-3:.7f}"]) for row in rows]
    (images / "poses.csv").write_text("\n".join([lines[0], *moved]) + "\n", "utf-8")
    changed = lc.verify(folder / "cell" / "result", images)
    assert "no change is seen" not in str(changed)
    assert "zero of rq2 moved" in str(changed)
    text = (images / "board.csv").read_text("utf-8")
    (images / "board.csv").write_text(text.replace("0.020,0", "0.021,0"), "utf-8")
    with refused("conflicting-keys", "the point '1' of the board 'plate'"):
        lc.verify(folder / "cell" / "result", images)

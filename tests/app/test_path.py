"""The whole path by pointing: from files that are dropped to files for the robot."""

from __future__ import annotations

import json
import re
import shlex
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from loopcal.companions.app import words
from tests.app.pointing import Hand, new_page
from tests.app.serving import Served
from tests.browser import expect, until
from tests.command_line import run_here
from tests.mechanisms.test_camera import POINTS, hands, pixels
from tests.reference import dh_arm

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "slipped_reflector"
IRB = "a;d;alpha;theta\n0;290;-90;0\n270;0;0;-90\n70;0;-90;0\n0;302;90;0\n0;0;-90;0\n0;72;0;180\n"


WIDE = 1440, 900
# Each path has one size: a path costs a minute, and what differs is where the parts stand.
UPRIGHT = pytest.mark.parametrize("hand", [(820, 1180)], indirect=True, ids=["upright"])
LYING = pytest.mark.parametrize("hand", [(1024, 768)], indirect=True, ids=["lying"])


@pytest.fixture
def hand(browser: Any, cell: tuple[Served, Path], request: pytest.FixtureRequest) -> Iterator[Hand]:
    """A page on an empty folder; its size in pixels is that of a desktop by default."""
    served, folder = cell
    page = new_page(browser, getattr(request, "param", WIDE))
    page.goto(served.address)
    yield Hand(page, folder)
    page.close()


def result_of(folder: Path) -> dict[str, Any]:
    return dict(json.loads((folder / "project-result/result.json").read_text("utf-8")))


def assert_the_command_line_gives_the_same(hand: Hand) -> None:
    """The last calibration of the log, typed, gives the same numbers to the last digit."""
    log = (hand.folder / "loopcal-log.jsonl").read_text("utf-8").splitlines()
    lines = [entry["command"] for entry in map(json.loads, log) if "command" in entry]
    typed = shlex.split([line for line in lines if line.startswith("loopcal calibrate")][-1])[1:]
    by_hand = result_of(hand.folder)
    done = run_here(*typed, "--no-report", cwd=hand.folder)
    assert done.returncode in (0, 4), done.stderr
    assert result_of(hand.folder) == by_hand


def test_the_example_is_the_arm_whose_reflector_slips(tmp_path: Path) -> None:
    dh_arm.write_slipped(tmp_path)
    for name in ("arm.urdf", "poses.csv"):
        assert (EXAMPLE / name).read_text("utf-8") == (tmp_path / name).read_text("utf-8")


def test_from_two_files_to_a_urdf_with_a_slipped_reflector_found_by_brushing(
    hand: Hand,
) -> None:
    urdf = EXAMPLE / "arm.urdf"
    hand.drop("Drop the URDF here", urdf)
    hand.sees("Go on with the step Data")
    hand.step("Data")
    hand.drop("Drop the files of readings here", EXAMPLE / "poses.csv")
    hand.run("Recognise")
    hand.sees("60 poses")
    hand.step("Check")
    hand.run("Check")
    hand.sees("Parameters, and the sds to expect")
    hand.step("Fit")
    hand.choose("Method", "least-squares")
    hand.run("Calibrate", "exit code 4")
    before = result_of(hand.folder)["accuracy"]["after"]["rms"]

    hand.step("Diagnose")
    hand.brush("error over the poses", dh_arm.SLIPPED - 0.5, 60.5)
    hand.sees("30 of 60 poses selected")
    hand.press_and_see("Reflector moved here")
    hand.sees("Provisional: error")
    hand.run("Fit again")
    expect(hand.page.locator(".provisional")).to_have_count(0)  # nothing moves any more
    after = result_of(hand.folder)["accuracy"]["after"]["rms"]
    assert after < 0.1e-3 < 1e-3 < before
    assert f"at = [{dh_arm.SLIPPED}.0]" in (hand.folder / "project.toml").read_text("utf-8")
    hand.press("Drag selects")
    hand.frame_in_space()
    hand.sees("60 of 60 poses selected")
    assert_the_command_line_gives_the_same(hand)

    hand.step("Validate")
    hand.sees("Predict one pose")
    hand.step("Deploy")
    hand.choose("Your own file", "arm.urdf")
    hand.run("Preview")
    hand.sees("Lines that change are marked")
    assert not (hand.folder / "project-result/export").exists()
    hand.run("Write")
    written = (hand.folder / "project-result/export/arm.urdf").read_text("utf-8")
    assert written != urdf.read_text("utf-8")
    assert written.count("<joint") == urdf.read_text("utf-8").count("<joint")

    hand.step("History")
    hand.press("Undo: ")
    hand.sees("(undone)")
    assert "shift" not in (hand.folder / "project.toml").read_text("utf-8")


def write_planar(folder: Path) -> None:
    """arm.csv, and poses.csv of a planar arm of two links, 0.7 mm and 0.3 deg off nominal."""
    rng = np.random.default_rng(3)
    joints = rng.uniform(-90.0, 90.0, (40, 2))
    turned = np.cumsum(np.radians(joints + np.array([0.2, -0.3])), axis=1)
    points = np.column_stack([np.cos(turned) @ (800.7, 599.2), np.sin(turned) @ (800.7, 599.2)])
    seen = np.column_stack([points, np.zeros(40)]) + rng.normal(0.0, 0.1, (40, 3))
    rows = [",".join(f"{v:.3f}" for v in row) for row in np.column_stack([joints, seen])]
    numbered = [f"{i},{row}" for i, row in enumerate(rows, 1)]
    head = "pose,J1 [deg],J2 [deg],x [mm],y [mm],z [mm]"
    (folder / "poses.csv").write_text("\n".join([head, *numbered]) + "\n", "utf-8")
    table = "joint,a [mm],d [mm],alpha [deg],theta [deg]\nJ1,800,0,0,0\nJ2,600,0,0,0\n"
    (folder / "arm.csv").write_text(table, "utf-8")


@LYING
def test_a_planar_arm_with_a_cell_that_is_no_number(hand: Hand, tmp_path: Path) -> None:
    write_planar(tmp_path)
    hand.press("Denavit-Hartenberg table")
    hand.drop("Drop the Denavit-Hartenberg table here", tmp_path / "arm.csv")
    hand.sees("Go on with the step Data")
    hand.step("Data")
    hand.drop("Drop the files of readings here", tmp_path / "poses.csv")
    hand.run("Recognise")
    hand.sees("40 poses")
    readings = hand.folder / "poses.csv"
    rows = readings.read_text("utf-8").splitlines()
    rows[7] = rows[7].rpartition(",")[0] + ",lost"
    readings.write_text("\n".join(rows) + "\n", "utf-8")
    hand.sees("'lost' is not a number")
    hand.press("Exclude 1 pose")
    hand.sees("Excluded: pose 7")
    hand.step("Plan")
    hand.run(
        "Choose poses"
    )  # a table of an arm has no limits of joints: over those of the readings
    for joint in ("J1", "J2"):
        for end, degrees in (("from", "-90"), ("to", "90")):
            hand.page.get_by_label(f"{joint} {end}", exact=True).fill(degrees)
            hand.page.keyboard.press("Tab")
    plan = {"ranges": {q: {"from": -90, "to": 90, "unit": "deg"} for q in ("J1", "J2")}}
    project = hand.folder / "project.toml"
    until(hand.page, lambda: tomllib.loads(project.read_text("utf-8")).get("plan") == plan)
    hand.page.get_by_label("Poses to measure").fill("6")
    hand.run("Choose poses")
    hand.sees("Download plan.csv")
    hand.step("Fit")
    hand.choose("Method", "auto: ")
    hand.run("Calibrate")
    assert_the_command_line_gives_the_same(hand)
    hand.step("Deploy")
    hand.run("Preview")
    hand.run(re.compile("^Write$"))  # not the record: the export can come later than its preview
    assert any((hand.folder / "project-result/export").iterdir())
    hand.step("History")
    hand.run("Add this result")
    hand.sees("calibration")


@UPRIGHT
def test_the_workspace_set_below_half_a_millimetre_without_typing(
    hand: Hand, tmp_path: Path, shared_data: Callable[[str], Path]
) -> None:
    measured, count = shared_data("motoman_ma1400_leica/right_arm_workspace.csv"), 110
    head = measured.read_text("utf-8").splitlines()[: count + 1]  # both slips are among them
    readings = tmp_path / measured.name
    readings.write_text("\n".join(head) + "\n", "utf-8")
    hand.press("Type")
    hand.choose("Type", "motoman-ma1400")
    hand.sees("Go on with the step Data")
    hand.step("Data")
    hand.drop("Drop the files of readings here", readings)
    hand.run("Recognise")
    hand.step("Fit")
    hand.choose("Method", "least-squares")
    hand.run("Calibrate", "exit code 4")
    hand.step("Diagnose")
    hand.press("Select these poses")
    hand.sees(f"1 of {count} poses selected")
    hand.press("Exclude")
    hand.sees_stale()
    hand.sees("Provisional: error")
    for end in (85, 12):  # the last pose before each slip
        hand.brush("error over the poses", 0.0, end + 0.5)  # a pixel can be more than a pose
        hand.press("Zoom in")
        hand.end_at("To pose", end)
        hand.press("Reflector moved here")
        hand.sees(f"moved from pose 1 to {end}")
        hand.sees("Provisional: error")  # it moves the figure down
        hand.press("Show all poses")
    project = (hand.folder / "project.toml").read_text("utf-8")
    assert "at = [14.0, 86.0]" in project
    assert 'exclude = ["13"]' in project
    hand.step("Fit")
    hand.choose("Method", "auto: ")
    hand.run("Calibrate", "")
    validation = result_of(hand.folder)["validation"]
    assert validation["words"].startswith("10 folds")
    assert validation["accuracy"]["rms"] < 0.5e-3


@LYING
def test_a_draw_wire_set(hand: Hand, tmp_path: Path, shared_data: Callable[[str], Path]) -> None:
    (tmp_path / "irb.csv").write_text(IRB, "utf-8")
    hand.press("Denavit-Hartenberg table")
    hand.drop("Drop the Denavit-Hartenberg table here", tmp_path / "irb.csv")
    hand.sees("Go on with the step Data")
    hand.step("Data")
    hand.drop("Drop the files of readings here", shared_data("abb_irb120_cable/RobotCali.xlsx"))
    hand.run("Recognise")
    hand.step("Fit")
    hand.choose("Method", "least-squares")
    hand.run("Calibrate", "")
    accuracy = result_of(hand.folder)["accuracy"]
    assert accuracy["after"]["rms"] < accuracy["before"]["rms"] < 0.5e-3


def test_a_refusal_offers_the_command_that_mends_it(hand: Hand, tmp_path: Path) -> None:
    """Readings in mm under headers that say m."""
    wrong = tmp_path / "poses.csv"
    wrong.write_text((EXAMPLE / "poses.csv").read_text("utf-8").replace("[mm]", "[m]"), "utf-8")
    hand.drop("Drop the URDF here", EXAMPLE / "arm.urdf")
    hand.sees("Go on with the step Data")
    hand.step("Data")
    hand.drop("Drop the files of readings here", wrong)
    hand.sees("Files of readings")
    hand.run("Recognise", "an input was wrong")
    hand.page.get_by_role("button", name=words.RUN_NEXT).click()
    hand.sees("60 poses")
    project = tomllib.loads((hand.folder / "project.toml").read_text("utf-8"))
    assert project["data"]["columns"]["x"]["unit"] == "mm"


def test_a_camera_needs_no_robot(hand: Hand, tmp_path: Path) -> None:
    """Corners, board and poses of the flange, one of them named as the project's own file."""
    files = camera_files(tmp_path)
    hand.step("Data")
    hand.drop("Drop the files of readings here", *files)
    hand.sees("Corners of a camera need none")
    hand.run("Recognise")
    hand.sees("12 poses")
    expect(hand.page.get_by_text("but the project does not read it")).to_have_count(0)
    hand.step("Robot")
    hand.page.get_by_label(words.ROBOT_DRAWN, exact=True).wait_for()
    hand.step("Fit")
    hand.choose("Method", "implicit-loop")
    hand.run("Calibrate")
    hand.step("Validate")
    hand.sees("Residuals in the image of eye")
    hand.sees("Uncertainty of the projection of eye")
    hand.sees("Images, the largest residuals first")


def camera_files(folder: Path) -> list[Path]:
    """A board on a flange before a camera: what it saw, without an error."""
    T = hands(12, 1)
    seen = pixels(T, on="base")
    at = [f"{k},{','.join(f'{v:.9f}' for v in row)}" for k, row in enumerate(flange(T).tolist())]
    texts = {
        "poses": ["pose,x_m,y_m,z_m,qw,qx,qy,qz", *at],
        "board": ["board,point,x_m,y_m,z_m", *(f"b,{i},{x},{y},{z}" for i, (x, y, z) in CORNERS)],
        "readings": [
            "pose,camera,board,point,u_px,v_px",
            *(
                f"{k},eye,b,{i},{seen[row, 0, k]:.4f},{seen[row, 1, k]:.4f}"
                for k in range(12)
                for row, (i, _) in enumerate(CORNERS)
            ),
        ],
    }
    for name, lines in texts.items():
        (folder / f"{name}.csv").write_text("\n".join(lines) + "\n", "utf-8")
    return [folder / f"{name}.csv" for name in texts]


CORNERS = [*POINTS.items()]


def flange(T: np.ndarray) -> np.ndarray:
    """(N, 7) x, y, z, qw, qx, qy, qz."""
    turns = Rotation.from_matrix(T[:, :3, :3]).as_quat()[:, [3, 0, 1, 2]]
    return np.hstack([T[:, :3, 3], turns])

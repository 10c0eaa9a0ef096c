"""Whole programs: corrected as tables are, written beside the input, refused where unsafe."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import loopcal as lc
from analyses import corrected as loops
from analyses.gauntlet_truth import drawn
from loopcal.cli import main
from loopcal.cli.reporting import run_report
from loopcal.companions.robot.correct_files import run_correct
from loopcal.companions.robot.export_files import run_export
from loopcal.companions.robot.inverse import solve
from loopcal.companions.robot.programs.coordinates import turns_of_pose
from loopcal.companions.robot.programs.registry import MARK
from loopcal.files.outputs import command
from loopcal.mechanisms.rotations import quaternions
from tests.refusals import refused

NAMES = [f"q{i}" for i in range(1, 7)]
BOX = loops.BOXES["six-axis"]
Q = np.radians(
    [[20.0, -10.0, 15, 40, 50, -30], [35.0, 5, -20, -35, 40, 100], [60.0, 30, -40, 100, 70, 29]]
)


@pytest.fixture(scope="module")
def result() -> lc.Result:
    arm = loops.drawing(loops.ARMS["six-axis"])
    rng = np.random.default_rng(5)
    truth = {p.name: p.nominal for p in arm.parameters}
    for name in truth:
        truth[name] += 4e-4 * rng.standard_normal()
    joints = dict(zip(NAMES, drawn(BOX, 50, rng).T, strict=True))
    noise = lc.Noise(dict.fromkeys(NAMES, 2e-5) | dict.fromkeys("xyz", 2e-5))
    made = lc.simulate(arm, joints, noise=noise, seed=1, truth=truth)
    return lc.calibrate(
        arm, made.dataset, noise=noise, prior=loops.prior(arm), method="implicit-loop"
    )


@pytest.fixture(scope="module")
def plain(result: lc.Result) -> lc.Correction:
    return lc.correct(result, dict(zip(NAMES, Q.T, strict=True)))


def listed(values: np.ndarray, decimals: int = 9) -> str:
    return ",".join(f"{v:.{decimals}f}" for v in values)


def rapid(plain: lc.Correction) -> str:
    lines = ["MODULE M"]
    rest = "[9E9,9E9,9E9,9E9,9E9,9E9]"
    for i, q in enumerate(np.degrees(Q)):
        lines.append(f"  CONST jointtarget j{i}:=[[{listed(q)}],{rest}];")
        T = plain.corrected.targets.poses[i]
        quadrants = [int(np.floor(q[k] / 90.0)) for k in (0, 3, 5)]
        where = f"[{listed(1e3 * T[:3, 3])}],[{listed(quaternions(T[:3, :3]))}]"
        cf = ",".join(map(str, [*quadrants, int(q[4] < 0)]))
        lines.append(f"  CONST robtarget p{i}:=[{where},[{cf}],{rest}];")
    return "\r\n".join([*lines, "ENDMODULE", ""])


def krl(plain: lc.Correction) -> str:
    lines = ["DEFDAT M"]
    for i, q in enumerate(np.degrees(Q)):
        axes = ",".join(f"A{k} {v:.9f}" for k, v in enumerate(q, 1))
        lines.append(f"DECL E6AXIS XJ{i}={{{axes},E1 0.0}}")
        turn = sum(1 << k for k, v in enumerate(q) if v < 0)
        pose = zip("XYZABC", turns_of_pose(plain.corrected.targets.poses[i]), strict=True)
        coordinates = ",".join(f"{k} {v:.9f}" for k, v in pose)
        lines.append(f"DECL E6POS XP{i}={{{coordinates},S 2,T {turn}}}")
    return "\n".join([*lines, "ENDDAT", ""])


@pytest.mark.parametrize(("name", "write"), [("m.mod", rapid), ("m.dat", krl)])
def test_programs_are_corrected_as_tables_are(
    name: str, write: object, result: lc.Result, plain: lc.Correction, tmp_path: Path
) -> None:
    path = tmp_path / name
    path.write_text(write(plain), "ascii", newline="")  # type: ignore[operator]
    done = lc.correct(result, path)
    assert done.corrected.done.all(), str(done)
    assert not done.left
    for kind in (0, 1):
        assert done.corrected.joints[kind::2] == pytest.approx(plain.corrected.joints, abs=1e-7)
    path.write_bytes(done.content)
    with refused("unsupported", name):
        lc.correct(result, path)
    path.write_bytes(done.content.replace(MARK.encode(), b"no mark"))
    again = lc.correct(result, path).corrected.targets
    assert again.joints[::2] == pytest.approx(plain.corrected.joints, abs=1e-8)
    q = solve(plain.arms.controller, again.poses[1::2], Q).joints
    assert q == pytest.approx(plain.corrected.joints, abs=1e-7)


def test_pulses_are_rounded_and_their_rounding_is_stated(
    result: lc.Result, plain: lc.Correction, tmp_path: Path
) -> None:
    path = tmp_path / "m.jbi"
    rows = [f"C{i:05}={listed(50 * q, 0)}" for i, q in enumerate(np.degrees(Q))]
    path.write_text("\n".join(["/JOB", "///PULSE", *rows, "NOP", ""]))
    coarse = lc.correct(result, path, pulses=[50.0] * 6)
    fine = lc.correct(result, path, pulses=[50.0] * 6, bounds=lc.CorrectionBounds(turn=1.0))
    assert b"," in coarse.content
    assert (coarse.u95 > 3.0 * plain.u95).all()
    assert (fine.u95 == coarse.u95).all()


def test_poses_without_a_configuration_are_refused(
    result: lc.Result, plain: lc.Correction, tmp_path: Path
) -> None:
    head = "tcp_x [mm],tcp_y [mm],tcp_z [mm],tcp_rz [deg],tcp_ry [deg],tcp_rx [deg]"
    poses = [listed(np.array(turns_of_pose(T))) for T in plain.corrected.targets.poses]
    path = tmp_path / "poses.csv"
    path.write_text("\n".join([head, *poses, ""]))
    alone = lc.correct(result, path)
    reasons = [r.reason for r in alone.corrected.refused if r]
    assert reasons == ["configuration-missing"] * 3
    assert alone.content == path.read_bytes()
    seeds = [f"{row},{listed(q + 0.05)}" for row, q in zip(poses, Q, strict=True)]
    path.write_text("\n".join([f"{head},{','.join(NAMES)}", *seeds, ""]))
    seeded = lc.correct(result, path)
    assert seeded.corrected.joints == pytest.approx(plain.corrected.joints, abs=1e-7)
    moved = lc.correct(result, path, frame=[0, 0, 0, 1, 0, 0])
    turned = moved.corrected.targets.joints - seeded.corrected.targets.joints
    assert turned == pytest.approx(np.tile(np.radians([1.0, 0, 0, 0, 0, 0]), (3, 1)), abs=1e-7)


def test_poses_relative_to_an_unknown_frame_are_refused(
    result: lc.Result, plain: lc.Correction, tmp_path: Path
) -> None:
    path = tmp_path / "m.dat"
    path.write_text(krl(plain) + "DECL FDAT FP={TOOL_NO 1,BASE_NO 4}\n")
    done = lc.correct(result, path)
    assert [r and r.reason for r in done.corrected.refused] == [None, "not-stated"] * 3
    assert lc.correct(result, path, frame=[0, 0, 0]).corrected.done.all()


def test_a_quadrant_that_changes_is_refused(result: lc.Result, tmp_path: Path) -> None:
    found = lc.correct(result, dict(zip(NAMES, Q.T, strict=True)))
    step = (found.corrected.joints - Q)[0, 0]
    q = Q[:1].copy()
    q[0, 0] = -0.5 * step  # the correction leads over zero
    at = lc.correct(result, dict(zip(NAMES, q.T, strict=True)))
    path = tmp_path / "m.mod"
    T = at.corrected.targets.poses[0]
    cf = ",".join(str(int(np.floor(np.degrees(q[0, k]) / 90.0))) for k in (0, 3, 5))
    where = f"[{listed(1e3 * T[:3, 3])}],[{listed(quaternions(T[:3, :3]), 12)}]"
    path.write_text(f"p:=[{where},[{cf},0],[0,0,0,0,0,0]];")
    done = lc.correct(result, path)
    assert [r and r.reason for r in done.corrected.refused] == ["configuration-changed"]
    assert done.content == path.read_bytes()


def test_files_are_written_beside_the_program_and_nothing_is_replaced(
    result: lc.Result, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, path = tmp_path / "result", tmp_path / "p.csv"
    lc.write_result(result, folder)
    rows = [listed(q) for q in Q]
    path.write_text("\n".join([",".join(NAMES), *rows, ""]))
    before = path.read_bytes()
    done = run_correct(folder, path)
    assert done.written == str(tmp_path / "p-corrected.csv")
    assert (tmp_path / "p-corrected.csv").read_bytes() == done.content != before
    with refused("unwritable-file", "p-corrected.csv"):
        run_correct(folder, path)
    with refused("unwritable-file", "p.csv"):
        run_correct(folder, path, out=path)
    assert path.read_bytes() == before
    with command(force=True):
        run_correct(folder, path, out=path)
    assert (tmp_path / "p.csv.bak").read_bytes() == before
    corrected = path.read_bytes()
    for out in (path, tmp_path / "twice.csv"):
        with refused("unsupported", "p.csv"), command(force=True):
            run_correct(folder, path, out=out)
    assert path.read_bytes() == corrected
    path.write_bytes(before)
    assert main(["correct", str(folder), str(path), "--force", "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown["corrected"] == 3
    assert shown["targets"][0]["u95_point"] == pytest.approx(done.u95[0])
    assert main(["correct", str(folder), str(path), "--force", "--most-turn", "0"]) == 4
    assert "moved-too-far" in capsys.readouterr().out
    assert main(["correct", str(folder), str(path), "--force", "--tool", "1,2"]) == 2
    assert main(["correct", str(folder), str(path), "--force", "--at", "t=x"]) == 2


def test_the_report_shows_what_was_made_of_this_result_and_of_no_other(
    result: lc.Result, tmp_path: Path
) -> None:
    folder, path = tmp_path / "result", tmp_path / "p.csv"
    lc.write_result(result, folder, report=False)
    assert "Into the robot" not in run_report([folder], None).read_text()
    rows = [listed(q) for q in [*Q, 0.0 * Q[0]]]
    path.write_text("\n".join([",".join(NAMES), *rows, ""]))
    done = run_correct(folder, path)
    assert [r and r.reason for r in done.corrected.refused][3] == "singular"
    run_export(folder, "zeros")
    page = run_report([folder], None).read_text()
    told = ("Into the robot", "p.csv (table): 3 targets corrected, 1 refused", "Exported as zeros")
    for words in (*told, "near a singular pose", "targets_1", "zeros and tool"):
        assert words in page
    note = folder / "deployed" / "correction-p.csv.json"
    note.write_text(note.read_text()[:100])
    with refused("invalid-syntax", "correction-p.csv.json"):
        run_report([folder], None)
    note.unlink()
    (folder / "result.json").write_text((folder / "result.json").read_text() + "\n")
    assert "Into the robot" not in run_report([folder], None).read_text()


def test_another_model_of_the_controller_is_read_from_a_table(
    result: lc.Result, plain: lc.Correction, tmp_path: Path
) -> None:
    links = loops.ARMS["six-axis"].links
    rows = [f"{1e3 * k.a},{1e3 * k.d},{np.degrees(k.alpha)},{np.degrees(k.offset)}" for k in links]
    path = tmp_path / "dh.csv"
    path.write_text("\n".join(["a [mm],d [mm],alpha [deg],theta [deg]", *rows, ""]))
    same = lc.correct(result, dict(zip(NAMES, Q.T, strict=True)), controller=path)
    assert same.corrected.joints == pytest.approx(plain.corrected.joints, abs=1e-7)

"""Straight moves: right at their ends, and in between as targets are inserted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import loopcal as lc
from analyses import corrected as loops
from analyses.gauntlet_truth import drawn
from loopcal.companions.robot.inverse import solve
from loopcal.companions.robot.programs.coordinates import JointAxes
from loopcal.companions.robot.programs.registry import read_program
from loopcal.companions.robot.rigid import between, moved

NAMES = [f"q{i}" for i in range(1, 7)]
ROWS = ["above,20,-10,15,40,50,-30,joint", "across,55,-5,-5,30,60,-10,linear"]


@pytest.fixture(scope="module")
def result() -> lc.Result:
    arm = loops.drawing(loops.ARMS["six-axis"])
    rng = np.random.default_rng(5)
    truth = {p.name: p.nominal + 2e-3 * rng.standard_normal() for p in arm.parameters}
    joints = dict(zip(NAMES, drawn(loops.BOXES["six-axis"], 40, rng).T, strict=True))
    noise = lc.Noise(dict.fromkeys(NAMES, 2e-5) | dict.fromkeys("xyz", 2e-5))
    made = lc.simulate(arm, joints, noise=noise, seed=1, truth=truth)
    return lc.calibrate(arm, made.dataset, noise=noise, method="implicit-loop")


def program(tmp_path: Path) -> Path:
    path = tmp_path / "line.csv"
    head = ",".join(["pose", *(f"{name} [deg]" for name in NAMES), "move"])
    path.write_text("\r\n".join([head, *ROWS, ""]), newline="")
    return path


def off(done: lc.Correction, q: np.ndarray, wanted: np.ndarray) -> float:
    """The largest error [m] on the controller's line between two corrected targets."""
    arms, worst = done.arms, 0.0
    ends = arms.controller(q)
    for share in np.linspace(0.05, 0.95, 19):
        pose = moved(ends[:1], between(ends[:1], ends[1:]), float(share))
        joints = solve(arms.controller, pose, q[:1] + share * (q[1:] - q[:1])).joints
        aim = moved(wanted[:1], between(wanted[:1], wanted[1:]), float(share))
        error = between(aim, arms.machine(joints))[0, :3]
        worst = max(worst, float(np.linalg.norm(error)))
    return worst


def test_the_error_in_between_is_that_of_the_machine_on_the_controllers_line(
    result: lc.Result, tmp_path: Path
) -> None:
    done = lc.correct(result, program(tmp_path))
    (move,) = done.moves
    assert (move.begin, move.end, move.line) == (0, 1, 3)
    assert move.error > 1e-5
    found = off(done, done.corrected.joints, done.corrected.targets.poses)
    assert move.error == pytest.approx(found, rel=0.1)
    assert "1 straight move" in str(done)
    assert done.document()["straight_moves"][0]["error"] == move.error


def test_inserted_targets_bring_it_below_the_bound(result: lc.Result, tmp_path: Path) -> None:
    path = program(tmp_path)
    before = lc.correct(result, path).moves[0].error
    done = lc.correct(result, path, bounds=lc.CorrectionBounds(line=before / 10.0))
    (move,) = done.moves
    assert len(move.inserted) == 3  # the error falls with the square of the length
    assert move.error < before / 10.0
    lines = done.content.decode().split("\r\n")
    assert [line.split(",")[0] for line in lines] == [
        "pose", "above", "across-1", "across-2", "across-3", "across", "",
    ]  # fmt: skip
    q = np.radians([[float(v) for v in line.split(",")[1:7]] for line in lines[1:-1]])
    assert q[1:-1] == pytest.approx(move.inserted, abs=1e-8)
    T = done.corrected.targets.poses
    way = between(T[:1], T[1:])
    wanted = np.concatenate([moved(T[:1], way, share) for share in (0.0, 0.25, 0.5, 0.75, 1.0)])
    assert done.arms.machine(q) == pytest.approx(wanted, abs=1e-8)
    assert max(off(done, q[i : i + 2], wanted[i : i + 2]) for i in range(4)) < before / 10.0


def test_a_bound_that_cannot_be_held_inserts_nothing(result: lc.Result, tmp_path: Path) -> None:
    done = lc.correct(result, program(tmp_path), bounds=lc.CorrectionBounds(line=1e-12))
    assert not len(done.moves[0].inserted)
    assert done.content.count(b"\r\n") == 3


REST = "[9E9,9E9,9E9,9E9,9E9,9E9]"
A, B = ("20,-10,15,40,50,-30", "45,-5,-5,30,60,-10")


def keyed(values: str, letter: str) -> str:
    return ",".join(f"{letter}{k} {v}" for k, v in enumerate(values.split(","), 1))


def position(number: int, values: str) -> str:
    axes = ",".join(f"J{k}= {float(v):.3f} deg" for k, v in enumerate(values.split(","), 1))
    return f"P[{number}]{{\n   GP1:\n UF : 0, UT : 1,\n{axes}\n}};"


def radians(values: str) -> str:
    return ",".join(f"{v:.9f}" for v in np.radians([float(v) for v in values.split(",")]))


MOVES = {
    "a.mod": (
        f"MODULE M\nCONST jointtarget b:=[[{B}],{REST}]; ! end\nPROC main()\n"
        f"  MoveAbsJ [[{A}],{REST}],v100,fine,tool0;\n  SetDO do1,1; ! on\n"
        "  MoveL b,v100,z1,tool0; ! weld\n  MoveAbsJ b,v1,fine,tool0;\nENDPROC\nENDMODULE\n"
    ),
    "a.src": (
        f"DEF a()\nDECL E6AXIS XB={{{keyed(B, 'A')},E1 0}}\nPTP {{{keyed(A, 'A')}}}\n"
        "WAIT SEC 1\n  LIN XB C_DIS ; weld\nEND\n"
    ),
    "a.ls": (
        "/PROG A\n/ATTR\nLINE_COUNT\t= 4;\n/MN\n   1:J P[1] 10% FINE ;\n   2:  DO[1]=ON ;\n"
        f"   3:L P[7:end] 50mm/sec FINE ;\n   4:J P[1] 10% FINE ;\n/POS\n{position(1, A)}\n"
        f"{position(7, B).replace('P[7]', 'P[7:end]')}\n/END\n"
    ),
    "a.script": (
        f"def a():\n  b = [{radians(B)}]\n  movej([{radians(A)}])\n  sleep(1)\n"
        "  movel(b, a=1, v=0.1) # weld\nend\n"
    ),
}


@pytest.mark.parametrize("name", MOVES)
def test_programs_are_divided_by_copies_of_their_moves(
    name: str, result: lc.Result, tmp_path: Path
) -> None:
    path, before = tmp_path / name, MOVES[name]
    path.write_text(before)
    plain = lc.correct(result, path)
    bound = plain.moves[0].error / 3.0
    done = lc.correct(result, path, bounds=lc.CorrectionBounds(line=bound))
    (move,) = (m for m in done.moves if len(m.inserted))
    assert move.error < bound
    path.write_bytes(done.content)
    again = read_program(path, JointAxes(dict.fromkeys(NAMES, "rad")))
    assert not again.noted
    driven = np.array([again.targets[m.target].joints for m in again.moves if m])
    count = len(move.inserted)
    digits = 2e-5 if name == "a.ls" else 1e-8
    ends = done.corrected.joints[[move.begin, move.end]]
    assert driven[1 : 1 + count] == pytest.approx(move.inserted, abs=digits)
    assert driven[[0, 1 + count]] == pytest.approx(ends, abs=digits)
    assert [m.straight for m in again.moves[1 : 2 + count] if m] == [True] * (1 + count)
    lines = done.content.decode().splitlines()
    assert len([one for one in lines if "weld" in one or "50mm" in one]) == 1 + count
    if name == "a.ls":
        numbers = [int(one.split(":")[0]) for one in lines if one[:4].strip().isdigit()]
        assert numbers == list(range(1, 5 + count))
        assert f"LINE_COUNT\t= {4 + count};" in lines


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("a.mod", "SetDO do1,1;", "IF x THEN\n Stop;\n ENDIF"),
        ("a.mod", "  MoveAbsJ [[", "  IF x MoveAbsJ [["),
        ("a.mod", "  MoveL b", "  IF x MoveL b"),
        ("a.src", "WAIT SEC 1", "LOOP"),
        ("a.src", "WAIT SEC 1", "$TOOL=TOOL_DATA[2]"),
        ("a.ls", "DO[1]=ON", "LBL[1]"),
        ("a.script", "sleep(1)", "if x:"),
        ("a.script", "b, a=1, v=0.1)", "b, a=1,\n v=0.1)"),
    ],
)
def test_nothing_is_inserted_where_the_move_before_may_be_another(
    name: str, old: str, new: str, result: lc.Result, tmp_path: Path
) -> None:
    path = tmp_path / name
    path.write_text(MOVES[name].replace(old, new))
    bounds = lc.CorrectionBounds(line=1e-9)
    done = lc.correct(result, path, bounds=bounds)
    assert not any(len(move.inserted) for move in done.moves)
    assert done.moves[0].why
    assert "NOT INSERTED" in str(done)
    assert done.document()["straight_moves"][0]["not_inserted"] == done.moves[0].why
    assert done.content == lc.correct(result, path).content

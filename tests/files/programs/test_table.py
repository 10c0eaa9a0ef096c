"""Tables of targets: numbers change, every other byte stays."""

from __future__ import annotations

import numpy as np
import pytest

from loopcal.companions.robot.programs.coordinates import JointAxes
from loopcal.companions.robot.programs.program import Program, text_of, written
from loopcal.companions.robot.programs.table import read_table
from loopcal.files.tables.readers import Column
from tests.refusals import refused

AXES = JointAxes({"a": "rad", "z": "m"}, {"a": Column("A", "deg"), "z": Column("Z", "mm")})
POSE = "tcp_x [mm],tcp_y [mm],tcp_z [mm],"


def read(data: bytes) -> Program:
    return read_table(text_of(data, "t.csv"), "t.csv", AXES)


def same(program: Program) -> bytes:
    new = {}
    for i, target in enumerate(program.targets):
        joints = np.zeros(2) if target.joints is None else target.joints
        pose = np.eye(4) if target.pose is None else target.pose
        new[i] = program.write(target, joints, pose)
    return program.edited(new)


@pytest.mark.parametrize("end", [b"\n", b"\r\n", b"\r"])
@pytest.mark.parametrize("bom", [b"", b"\xef\xbb\xbf"])
def test_bytes_outside_the_numbers_stay(end: bytes, bom: bytes) -> None:
    rows = [b'pose;A;Z;"n\xe4me"', b'1;"10,5"; 20,25 ;\xff', b"# A;5", b"", b"2;\t-1,5;2;x", b""]
    data = bom + end.join(rows)
    program = read(data)
    assert [t.line for t in program.targets] == [2, 5]
    assert [t.name for t in program.targets] == ["1", "2"]
    assert np.degrees(program.targets[0].joints[0]) == pytest.approx(10.5)  # type: ignore[index]
    assert 1e3 * program.targets[1].joints[1] == pytest.approx(2.0)  # type: ignore[index]
    edited = same(program)
    texts = [b"10,50000000", b"20,250000", b"-1,50000000", b"2,000000"]
    for old, new in zip([b"10,5", b"20,25", b"-1,5", b"2;x"], texts, strict=True):
        data = data.replace(old, new if old != b"2;x" else new + b";x", 1)
    assert edited == data
    assert program.edited({}) == bom + end.join(rows)


def test_degrees_in_a_column_of_radians_are_refused() -> None:
    axes = JointAxes({"a": "rad", "z": "m"}, {})
    for head, a in (("a", "6.2"), ("a [deg]", "60"), ("A_deg", "60"), ("a (deg)", "60")):
        table = text_of(f"{head},z\n{a},0.5\n".encode(), "t.csv")
        assert read_table(table, "t.csv", axes).targets[0].joints is not None
    with refused("implausible-unit", "t.csv, line 2", "60 rad", "'a [deg]'"):
        read_table("a,z\n60,0.5\n", "t.csv", axes)


def test_poses_are_written_in_their_own_way() -> None:
    turns = POSE + "tcp_rz [deg],tcp_ry [deg],tcp_rx [rad],A,Z\n500,0,300,10,20,0.5,1,2\n"
    quaternion = POSE + "tcp_qw,tcp_qx,tcp_qy,tcp_qz\n500,0,300,-0.5,0.5,-0.5,0.5\n"
    for text in (turns, quaternion):
        program = read(text.encode())
        assert program.targets[0].cartesian
        again = read(same(program))
        assert again.targets[0].pose == pytest.approx(program.targets[0].pose, abs=1e-9)
    assert read(turns.encode()).targets[0].joints == pytest.approx([np.radians(1), 2e-3])
    assert read(quaternion.encode()).targets[0].joints is None


def test_straight_moves_are_marked_in_a_column() -> None:
    program = read(b"A,Z,move\n1,2,joint\n1,2,linear\n")
    assert [m is not None and m.straight for m in program.moves] == [False, True]


@pytest.mark.parametrize(
    ("data", "code", "stated"),
    [
        (b"", "no-data", "empty"),
        (b"A,Z\n", "no-data", "no target"),
        (b"A\n1\n", "missing-column", "z"),
        (b"A,Z\n1,2\n1,2\n1,2\n3\n", "invalid-syntax", "line 5"),
        (b"A,Z\n1,2\n3,x\n", "invalid-number", "line 3"),
        (b"A,Z\n1,2\n3,inf\n", "invalid-number", "line 3"),
        (b"A,Z,move\n1,2,circle\n", "unknown-name", "line 2"),
        ((POSE + "A\n1,2,3,4\n").encode(), "missing-column", "tcp_rz"),
        (POSE.replace(" [mm]", "").encode() + b"tcp_rz,tcp_ry,tcp_rx\n1,2,3,4,5,6\n",
         "unknown-unit", "tcp_x"),
        ((POSE + "tcp_qw,tcp_qx,tcp_qy,tcp_qz\n1,2,3,1,1,1,1\n").encode(),
         "invalid-number", "2.000"),
        (b"A\0,Z\n", "unreadable-file", "line 1"),
        ("A,Z\n1,2\n".encode("utf-16"), "unreadable-file", "UTF-16"),
    ],
)  # fmt: skip
def test_what_is_no_table_of_targets_is_refused_with_its_line(
    data: bytes, code: str, stated: str
) -> None:
    with refused(code, stated):  # type: ignore[arg-type]
        read(data)


def test_numbers_are_written_without_a_negative_zero() -> None:
    assert [written(v, 2) for v in (-0.001, -1.0, 0.125)] == ["0.00", "-1.00", "0.12"]

"""Programs of five vendors: which numbers are targets, what they mean, and what is left alone."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from loopcal.companions.robot.programs.coordinates import JointAxes
from loopcal.companions.robot.programs.copying import inserted
from loopcal.companions.robot.programs.program import Move, Program
from loopcal.companions.robot.programs.registry import BY_ENDING, read_program
from loopcal.errors import InputError
from tests.refusals import refused

AXES = JointAxes({f"q{i}": "rad" for i in range(1, 7)}, pulses=(1000.0, -500.0, 800, 700, 600, 400))

RAPID = b"""MODULE M ! jointtarget no:=[[1,2,3,4,5,6],[9E9,9E9,9E9,9E9,9E9,9E9]];\r
  CONST jointtarget jHome := [[0,-30.5,20,1E1,.5,-6],[9E9,9E9,9E9,9E9,9E9,9E9]];\r
  PERS robtarget p10:=[[500,0,600.25],[0.5,-0.5,0.5,-0.5],[0,-1,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];\r
  CONST robtarget pArc:=[[1,2,3],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];\r
  VAR robtarget pVar;\r
  CONST robtarget pBad:=[[1,2,3],[1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];\r
  PERS loaddata l:=[1.5,[0,0,1],[1,0,0,0],0,0,0];\r
  PROC main()\r
    MoveAbsJ jHome,v100,fine,tool0;\r
    MoveL p10,v100,fine,tool0;\r
    MoveL Offs(p10,0,0,10),v100,z1,tool0;\r
    MoveC pArc,p10,v100,z1,tool0;\r
    MoveJ [[1,2,3],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v5,z1,tool0;\r
    p10.trans.x := 5;\r
    TPWrite "MoveL [[1,2,3],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]";\r
  ENDPROC\r
ENDMODULE\r
"""
KRL = b"""&ACCESS RVP
DEF test( )
DECL E6AXIS XHOME={A1 0.0,A2 -90,A3 90,A4 0,A5 10.5,A6 0,E1 5}
DECL E6POS XP1={X 500.0,Y 0,Z 600,A 90,B 45,C 10,S 2,T 10,E1 0.0}
DECL FDAT FP1={TOOL_NO 1,BASE_NO 0,IPO_FRAME #BASE}
;E6POS XP2={X 1,Y 2,Z 3,A 4,B 5,C 6,S 2,T 10}
$BASE=$NULLFRAME
$TOOL={X 1,Y 2,Z 3,A 4,B 5,C 6}
PTP XHOME
LIN XP1
LIN {X 100,Y 200,Z 300,A 0,B 0,C 0}
LIN_REL {X 10}
CIRC XP8,XP9
PTP {A1 10}
XP1.X=XP1.X+10
END
"""
LS = b"""/PROG TEST\r
/MN\r
   1:J P[1] 100% FINE    ;\r
   2:L P[2:"weld"] 500mm/sec FINE    ;\r
   3:L P[1] 500mm/sec FINE Offset,PR[1]    ;\r
   4:L PR[3] 500mm/sec FINE    ;\r
/POS\r
P[1]{\r
   GP1:\r
\tUF : 0, UT : 1,\t\r
\tJ1=    10.000 deg,\tJ2=   -20.000 deg,\tJ3=     0.000 deg,\r
\tJ4=     0.000 deg,\tJ5=    45.000 deg,\tJ6=     0.000 deg\r
   GP2:\r
\tUF : 0, UT : 1,\r
\tJ1=     1.000 deg\r
};\r
P[2:"weld"]{\r
   GP1:\r
\tUF : 2, UT : 1,\t\tCONFIG : 'N U T, 0, 0, -1',\r
\tX =   500.000  mm,\tY =     0.000  mm,\tZ =   300.000  mm,\r
\tW =   180.000 deg,\tP =    10.000 deg,\tR =    20.000 deg\r
};\r
P[3]{\r
   GP1:\r
\tUF : 0, UT : 1,\tX =  *******  mm\r
};\r
/END\r
"""
JBI = b"""/JOB
//NAME TEST
//POS
///NPOS 3,0,0,1,0,0
///POSTYPE PULSE
///PULSE
C00000=1000,500,-800,700,0,4
C00001=1,2,3
///POSTYPE ROBOT
///RECTAN
C00002=500.000,0.000,300.000,180.00,0.00,0.00
//INST
NOP
MOVJ C00000 VJ=50.00
MOVL P001 V=100.0
END
"""
SCRIPT = b"""def test():
  # movej([1,2,3,4,5,6])
  global home=[0.0, -1.5708, 1.57, 0, 0, 0]
  global via_q=[0,0,0,0,0,1]
  global via_p=p[0.3,0.2,0.1,0,3.14,0]
  set_payload(1.5, [0, 0, 0.1])
  force_mode(p[0,0,0,0,0,0],[0,0,1,0,0,0],[0,0,9,0,0,0],2,[1,1,1,1,1,1])
  movej(home, a=1.4, v=1.05)
  movel([0.1,-1.2,1,0.2,0.3,-0.5], a=0.5, v=0.1)
  movej(get_inverse_kin(via_p, qnear=via_q), a=1, v=1)
  movel(p[0.3,0.2,0.1,0,3.14,0], a=1, v=1)
  movec(via_p, via_p, a=1, v=1)
  textmsg("movej([1,2,3,4,5,6])")
end
"""
PROGRAMS = {"a.mod": RAPID, "a.src": KRL, "a.ls": LS, "a.jbi": JBI, "a.script": SCRIPT}


def program(tmp_path: Path, name: str, data: bytes | None = None) -> Program:
    path = tmp_path / name
    path.write_bytes(PROGRAMS[name] if data is None else data)
    return read_program(path, AXES)


def degrees(found: Program, index: int) -> list[float]:
    joints = found.targets[index].joints
    assert joints is not None
    return np.degrees(joints).tolist()


def test_rapid_targets_are_found_and_the_rest_is_left(tmp_path: Path) -> None:
    found = program(tmp_path, "a.mod")
    assert [t.name for t in found.targets] == ["jHome", "line 13"]  # p10 is of a circle
    assert degrees(found, 0) == pytest.approx([0, -30.5, 20, 10, 0.5, -6])
    noted = {note.line for note in found.noted}
    assert {4, 5, 6, 11, 12, 14} <= noted
    assert not noted & {1, 2, 7, 9, 15}


def test_a_robtarget_is_a_pose_with_quadrants(tmp_path: Path) -> None:
    text = RAPID.replace(b"MoveC pArc,p10", b"MoveC pArc,pArc")
    found = program(tmp_path, "a.mod", text)
    target = found.targets[1]
    assert target.name == "p10"
    assert target.pose is not None
    assert target.pose[:3, 3] == pytest.approx([0.5, 0.0, 0.60025])
    turn = Rotation.from_quat([0.5, -0.5, 0.5, -0.5], scalar_first=True).as_matrix()
    assert target.pose[:3, :3] == pytest.approx(turn)
    joints = np.radians([10, 0, 0, -10, 20, 10])
    assert found.fits(target, joints)
    assert not found.fits(target, joints * [1, 1, 1, -1, 1, 1])
    assert not found.fits(target, joints * [1, 1, 1, 1, -1, 1])
    assert [(m.target, m.straight) if m else None for m in found.moves][:3] == [
        (0, False),
        (1, True),
        None,
    ]


def test_krl_targets_are_found_and_the_rest_is_left(tmp_path: Path) -> None:
    found = program(tmp_path, "a.src")
    assert [t.name for t in found.targets] == ["XHOME", "XP1", "line 11"]
    assert degrees(found, 0) == pytest.approx([0, -90, 90, 0, 10.5, 0])
    pose = found.targets[1].pose
    assert pose is not None
    turn = Rotation.from_euler("ZYX", [90, 45, 10], degrees=True).as_matrix()
    assert pose[:3, :3] == pytest.approx(turn)
    assert found.frame is None
    assert found.fits(found.targets[1], np.radians([1, -1, 1, -1, 1, 1]))
    assert not found.fits(found.targets[1], np.radians([1, 1, 1, -1, 1, 1]))
    assert {12, 13, 14, 15} <= {note.line for note in found.noted}
    based = KRL.replace(b"BASE_NO 0", b"BASE_NO 3")
    assert "3" in str(program(tmp_path, "a.src", based).frame)


def test_listings_of_fanuc_are_read_by_group_and_frame(tmp_path: Path) -> None:
    found = program(tmp_path, "a.ls")
    assert [t.name for t in found.targets] == ["P[1]", "P[2]"]
    assert degrees(found, 0) == pytest.approx([10, -20, 0, 0, 45, 0])
    pose = found.targets[1].pose
    assert pose is not None
    turn = Rotation.from_euler("xyz", [180, 10, 20], degrees=True).as_matrix()
    assert pose[:3, :3] == pytest.approx(turn)
    assert found.frame == "the user frame 2"
    assert found.fits(found.targets[1], np.radians([1, 2, 3, 4, 5, -300]))
    assert not found.fits(found.targets[1], np.radians([1, 2, 3, 4, 5, 100]))
    assert {5, 6, 23} <= {note.line for note in found.noted}


def test_pulses_of_yaskawa_are_scaled_and_rounded(tmp_path: Path) -> None:
    found = program(tmp_path, "a.jbi")
    assert [t.name for t in found.targets] == ["C00000"]
    assert degrees(found, 0) == pytest.approx([1, -1, -1, 1, 0, 0.01])
    assert np.degrees(found.targets[0].step) == pytest.approx(1.0 / np.abs(AXES.pulses))
    assert (
        found.write(found.targets[0], np.radians([1.0004, 0, 0, 0, 0, 0]), np.eye(4))[0] == "1000"
    )
    assert {note.line for note in found.noted} == {8, 11, 15}
    with refused("missing-key", "--pulses-per-degree"):
        read_program(tmp_path / "a.jbi", JointAxes(AXES.joints))


@pytest.mark.parametrize("name", PROGRAMS)
def test_unchanged_targets_read_back_and_bytes_outside_them_stay(name: str, tmp_path: Path) -> None:
    found = program(tmp_path, name)
    same = {}
    for i, t in enumerate(found.targets):
        joints = np.zeros(6) if t.joints is None else t.joints
        pose = np.eye(4) if t.pose is None else t.pose
        same[i] = found.write(t, joints, pose)
    edited = found.edited(same)
    assert found.edited({}) == PROGRAMS[name]
    again = program(tmp_path, name, edited)
    for one, other in zip(found.targets, again.targets, strict=True):
        if one.pose is not None:
            assert other.pose == pytest.approx(one.pose, abs=1e-9)
        else:
            assert other.joints == pytest.approx(one.joints, abs=1e-9)
    assert outside(found, found.text) == outside(again, again.text)


def read(data: bytes, name: str) -> list[Move]:
    """The moves that are understood."""
    reads = BY_ENDING[Path(name).suffix].read(data.decode("latin-1"), name, AXES)
    return [move for move in reads.moves if move is not None]


def outside(found: Program, text: str) -> list[str]:
    """The text between the numbers of targets."""
    parts, at = [], 0
    for number in sorted((n for t in found.targets for n in t.numbers), key=lambda n: n.start):
        parts.append(text[at : number.start])
        at = number.end
    return [*parts, text[at:]]


def test_an_unknown_ending_and_an_absent_file_are_refused(tmp_path: Path) -> None:
    with refused("wrong-file-type", ".xyz"):
        read_program(tmp_path / "a.xyz", AXES)
    with refused("missing-file", "a.mod"):
        read_program(tmp_path / "a.mod", AXES)
    seven = JointAxes({f"q{i}": "rad" for i in range(1, 8)})
    (tmp_path / "a.mod").write_bytes(RAPID)
    with refused("unsupported", "7"):
        read_program(tmp_path / "a.mod", seven)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.mod", "robtarget p:=[[1,2,3],[1,0,0,0],[0,1e999,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];"),
        ("a.mod", "robtarget p:=[[1,1e999,3],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];"),
        ("a.src", "LIN {X 1,Y 2,Z 3,A 1e999,B 0,C 0}"),
        ("a.src", "PTP {A1 1e999,A2 2,A3 3,A4 4,A5 5,A6 6}"),
    ],
)
def test_a_number_that_is_too_large_is_refused_with_its_line(
    name: str, text: str, tmp_path: Path
) -> None:
    with refused("invalid-number", f"{name}, line 2"):
        program(tmp_path, name, f"\n{text}\n".encode())


HOSTILE = [(name, seed) for name in PROGRAMS for seed in range(35)]


@pytest.mark.parametrize(("name", "seed"), HOSTILE)
def test_hostile_programs_keep_their_bytes_or_are_refused_with_a_line(
    name: str, seed: int, tmp_path: Path
) -> None:
    """Truncated, doubled, with odd bytes and line endings, unknown statements and lost digits."""
    rng = np.random.default_rng([seed, len(name)])
    data = bytearray(PROGRAMS[name])
    for _ in range(rng.integers(1, 6)):
        at = int(rng.integers(max(len(data), 1)))
        kind = rng.integers(9)
        if kind == 0:
            data = data[: max(at, 1)]
        elif kind == 1:
            data[at:at] = bytes(rng.integers(128, 256, 5, dtype=np.uint8))
        elif kind == 2:
            data[at : at + 3] = b""
        elif kind == 3:
            data = data.replace(b"\r\n", b"\n")
        elif kind == 7:
            data = data.replace(b"\n", b"\r")
        elif kind == 4:
            data[at:at] = [b"[[", b"{", b"}", b'"', b";", b"!", b",,"][rng.integers(7)]
        elif kind == 5:
            data[at:at] = b"\nIF x>[[1,2,3],[4]] THEN {A1 5,A2} C00009=1,2 P[99]{\n"
        elif kind == 6:
            data[at:at] = b"1e999" if rng.random() < 0.5 else b"\0"
        else:
            data += data[at:]
    refusal = ""
    try:
        found = program(tmp_path, name, bytes(data))
    except InputError as error:
        refusal = str(error)
    if refusal:
        assert f"{name}, line" in refusal
        return
    assert found.edited({}) == bytes(data)
    numbers = [number for target in found.targets for number in target.numbers]
    assert [found.text[n.start : n.end] for n in numbers] == [n.text for n in numbers]
    spans = sorted((n.start, n.end) for n in numbers)
    assert all(a[1] <= b[0] for a, b in pairwise(spans))
    for i, move in enumerate(found.moves):
        if move is not None and not move.fixed:
            row = [number.text for number in found.targets[move.target].numbers]
            more = found.edited({}, inserted(found, {i: [row, row]}))
            assert len(read(more, name)) >= len([m for m in found.moves if m]) + 2
    new = {i: ["0"] * len(t.numbers) for i, t in enumerate(found.targets)}
    edited = found.edited(new).decode("latin-1")
    assert edited == "0".join(outside(found, found.text))


def test_joints_of_urscript_are_targets_and_the_rest_is_left(tmp_path: Path) -> None:
    found = program(tmp_path, "a.script", SCRIPT)
    assert {t.name for t in found.targets} == {"home", "line 9"}
    at = {t.name: t.joints for t in found.targets}
    assert at["home"] == pytest.approx([0, -1.5708, 1.57, 0, 0, 0])
    assert at["line 9"] == pytest.approx([0.1, -1.2, 1, 0.2, 0.3, -0.5])
    assert [m.straight if m else None for m in found.moves] == [False, True, None, None, None]
    assert [note.line for note in found.noted] == [10, 11, 12]
    twice = SCRIPT.replace(b"via_q=", b"home=")
    assert [t.name for t in program(tmp_path, "a.script", twice).targets] == ["line 9"]

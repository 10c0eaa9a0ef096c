"""Every instruction that moves is reported once: as a move, or as what stays as it is, and why."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from loopcal.companions.robot.programs.coordinates import JointAxes
from loopcal.companions.robot.programs.program import Program
from loopcal.companions.robot.programs.registry import read_program

AXES = JointAxes({f"q{i}": "rad" for i in range(1, 7)}, pulses=(1000.0,) * 6)
_POSE = "[[500,0,600],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]"
_JOINTS = "[[0,-30,20,10,5,-6],[9E9,9E9,9E9,9E9,9E9,9E9]]"
_AXES = "A1 0,A2 -90,A3 90,A4 0,A5 10,A6 0"

PROGRAMS = {
    "m.mod": (
        f"MODULE M\nCONST jointtarget j0:={_JOINTS};\nCONST robtarget p1:={_POSE};\n"
        f"CONST jointtarget js{{2}}:=[{_JOINTS},{_JOINTS}];\nCONST robtarget arc:={_POSE};\n"
        "PROC main()\n%s\nENDPROC\nENDMODULE\n"
    ),
    "m.src": (
        f"DEF m( )\nDECL E6AXIS j0={{{_AXES}}}\nDECL E6POS p1={{X 500,Y 0,Z 600,A 0,B 90,C 0}}\n"
        "%s\nEND\n"
    ),
    "m.ls": (
        "/PROG M\n/MN\n%s\n/POS\n"
        + "".join(
            f"P[{n}]{{\n   GP1:\n\tUF : 0, UT : 1,\n"
            + ",".join(f"\tJ{k}= {k}.000 deg" for k in range(1, 7))
            + "\n};\n"
            for n in (1, 2, 3)
        )
        + "/END\n"
    ),
    "m.jbi": (
        "/JOB\n//NAME M\n//POS\n///NPOS 3,0,0,1,0,0\n///PULSE\nC00000=1,2,3,4,5,6\n"
        "C00001=2,3,4,5,6,7\nC00002=3,4,5,6,7,8\n//INST\nNOP\n%s\nEND\n"
    ),
    "m.script": "def m():\n  home=[0,-1.5,1.5,0,0,0]\n  via=[0,-1,1,0,0,0]\n%s\nend\n",
}

UNDERSTOOD = {
    "m.mod": [
        *(f"MoveAbsJ j0{o},v100,fine,tool0;" for o in ("\\NoEOffs", "\\ID:=3", "\\ID:=3\\NoEOffs")),
        "MoveAbsJ \\Conc, j0 \\NoEOffs, v100 \\T:=5, z50 \\Inpos:=inpos20, tool0 \\TLoad:=t1;",
        "MoveAbsJ j0, v100 \\V:=200, z50 \\Z:=45, tool0 \\WObj:=wobj0;",
        "MoveL \\Conc, p1, v100, fine, tool0;",
        "MoveL p1 \\ID:=5, v100 \\T:=2, z10 \\Z:=8 \\Inpos:=inpos50, tool0 \\WObj:=wobj0 \\Corr;",
        "MoveJ p1\\ID:=id1,v100,z10,tool0\\TLoad:=load1;",
        "MoveL p1,\n    v100, fine,\n    tool0;",
        f"MoveAbsJ \\Conc,{_JOINTS}\\NoEOffs,v100,fine,tool0;",
        f"MoveL {_POSE}\\ID:=2,v100,fine,tool0;",
        "MoveLDO p1\\ID:=4,v100,z10,tool0,do1,1;",
        'MoveJSync p1,v100,z10,tool0,"proc1";',
        "TriggL \\Conc, p1, v100, gunon \\T2:=on2, z10, tool0 \\WObj:=wobj0;",
        "MoveAbsJ js{2}\\NoEOffs,v100,fine,tool0;",
        "IF a=1 MoveAbsJ j0\\NoEOffs,v100,fine,tool0;",
    ],
    "m.src": [
        "PTP j0 C_PTP",
        "PTP j0 C_PTP C_DIS",
        "LIN p1 C_DIS",
        "LIN p1 C_VEL C_ORI",
        "SPTP j0 WITH $VEL_AXIS[1]=SVEL_JOINT(100.0), $TOOL=tool1",
        "SLIN p1 WITH $VEL={CP 0.5}, $BASE=base1:frame1 C_SPL",
        "SPL p1",
        f"PTP {{{_AXES}}} C_PTP",
        "LIN {X 1,Y 2,Z 3,A 4,B 5,C 6} C_DIS",
        "ptp J0",
    ],
    "m.ls": [
        "   1:J P[1] 100% FINE    ;",
        "   1:J P[1] 100% CNT100 ACC50 EV30%    ;",
        "   1:L P[1] 500mm/sec FINE Wjnt PTH    ;",
        "   1:L P[1] R[5]mm/sec CNT R[6] TA .50sec,DO[1]=ON    ;",
        "   1:L P[1] 500mm/sec FINE SKIP,LBL[1]    ;",
        "   1:L P[1:offset station] 500mm/sec FINE COORD    ;",
        '   1:J P[1:"incoming INC"] 100% FINE TB 1.0sec,CALL PROG    ;',
    ],
    "m.jbi": [
        "MOVJ C00000 VJ=50.00",
        "MOVJ C00000 VJ=50.00 PL=0 NWAIT UNTIL IN#(1)=ON ACC=20 DEC=20",
        "MOVJ C00000 BC00000 EC00000 VJ=10.00",
        "MOVL C00000 V=100.0 CR=5.0 //C",
        "MOVL C00000 VR=10.0 PL=4",
        "SMOVL C00000 V=100.0",
        "MOVS C00000 V=100.0",
    ],
    "m.script": [
        "  movej(home, a=1.4, v=1.05, t=0, r=0.02)",
        "  movej(home)",
        "  movej(q=home, a=1.4)",
        "  movel([0,-1.5,1.5,0,0,0], a=0.5, v=0.1, t=3, r=0)",
        "  movep(home, v=0.1, a=1, r=0.05)",
        "  movej(q=[0,-1.5,1.5,0,0,0])",
    ],
}
LEFT = {
    "m.mod": [
        "MoveL Offs(p1,0,0,10),v100,fine,tool0;",
        "MoveJ RelTool(Offs(p1,0,0,1),0,0,10)\\ID:=3,v100,fine,tool0;",
        "MoveL \\Conc, Offs(p1,0,0,10),v100,fine,tool0\\WObj:=wobj0;",
        "MoveC arc\\ID:=3,arc,v100,fine,tool0;",
        "MoveC Offs(p1,1,0,0),Offs(p1,2,0,0),v100,fine,tool0;",
        "SearchL \\Stop,di1,sp,p1,v100,tool0;",
        "MoveAbsJ js{i}\\NoEOffs,v100,fine,tool0;",
        "MoveAbsJ js{3},v100,fine,tool0;",
        "MoveAbsJ elsewhere\\NoEOffs,v100,fine,tool0;",
        "MoveExtJ j0\\UseEOffs,vrot10,fine;",
        "MoveAbsJ CalcJointT(p1,tool0)\\NoEOffs,v100,fine,tool0;",
    ],
    "m.src": [
        "PTP {A1 10}",
        "PTP {A1 10} C_PTP",
        "LIN_REL {X 10} C_DIS",
        "SLIN_REL {Z 10} WITH $VEL={CP 0.1} #BASE",
        "CIRC {X 1,Y 2,Z 3,A 4,B 5,C 6},{X 2,Y 2,Z 3,A 4,B 5,C 6},CA 90",
        "CIRC arc1,arc2 C_DIS",
        "LIN p1:shift C_DIS",
        "LIN elsewhere C_DIS",
        "PTP xp[3] C_PTP",
    ],
    "m.ls": [
        "   1:L P[1] 500mm/sec FINE Offset,PR[1]    ;",
        "   1:L P[1] 500mm/sec FINE Tool_Offset,PR[2]    ;",
        "   1:L P[1] 500mm/sec FINE VOFFSET,VR[1]    ;",
        "   1:L P[1] 500mm/sec FINE INC    ;",
        "   1:L PR[3] 500mm/sec FINE    ;",
        "   1:J P[R[1]] 100% FINE    ;",
        "   1:J P[9] 100% FINE    ;",
        "   1:C P[2]\n    :  P[3] 500mm/sec FINE    ;",
    ],
    "m.jbi": [
        "MOVL P001 V=100.0",
        "MOVC C00001 V=100.0",
        "IMOV P002 V=10.0 RF",
        "+MOVJ C00000 VJ=10.00",
        "REFP 1 C00000",
        "MOVJ C00009 VJ=10.00",
    ],
    "m.script": [
        "  movel(p[0.3,0.2,0.1,0,3.14,0], a=1, v=1, t=0, r=0)",
        "  movej(get_inverse_kin(p[0.3,0.2,0.1,0,3.14,0], qnear=home), a=1)",
        "  movec(via, [0,0,0,0,0,0], a=1, v=1)",
        "  servoj([0,-1.5,1.5,0,0,0], 0, 0, 0.002, 0.1, 300)",
        "  movej(elsewhere, a=1)",
        "  movej([0,1,2], a=1)",
    ],
}


def read(tmp_path: Path, name: str, instruction: str) -> Program:
    path = tmp_path / name
    path.write_text(PROGRAMS[name] % instruction, "latin-1")
    return read_program(path, AXES)


def reported(found: Program, instruction: str) -> tuple[int, int]:
    """How often the instruction is reported as a move, and as what stays as it is."""
    first = found.text[: found.text.index(instruction)].count("\n") + 1
    lines = range(first, first + instruction.count("\n") + 1)
    moves = sum(move is not None and move.line in lines for move in found.moves)
    return moves, sum(note.line in lines for note in found.noted)


CASES = [
    (name, instruction, understood)
    for cases, understood in ((UNDERSTOOD, True), (LEFT, False))
    for name, several in cases.items()
    for instruction in several
]


@pytest.mark.parametrize(("name", "instruction", "understood"), CASES)
def test_an_instruction_is_reported_once_with_what_happens_to_it(
    name: str, instruction: str, understood: bool, tmp_path: Path
) -> None:
    found = read(tmp_path, name, instruction)
    assert reported(found, instruction) == ((1, 0) if understood else (0, 1))
    assert len(found.moves) == 1
    assert max(Counter(note.line for note in found.noted).values(), default=1) == 1
    move = found.moves[0]
    if move is not None and move.called.end:  # where a copy gets a target of its own
        called = found.text[slice(*move.called)]
        assert called in instruction
        assert called.lower().startswith(("j0", "p1", "js{2}", "p[1", "home", "[", "{"))


@pytest.mark.parametrize(
    ("name", "instruction", "line"),
    [
        ("m.mod", "SearchL \\Stop,di1,sp,p1,v100,tool0;", 3),
        ("m.mod", "MoveL Offs(p1,0,0,10),v100,fine,tool0;", 3),
        ("m.src", "LIN p1:shift C_DIS", 3),
        ("m.ls", "   1:L P[1] 500mm/sec FINE Offset,PR[1]    ;", 5),
        ("m.jbi", "REFP 1 C00000", 6),
    ],
)
def test_a_target_that_is_corrected_elsewhere_is_said_to_be(
    name: str, instruction: str, line: int, tmp_path: Path
) -> None:
    found = read(tmp_path, name, instruction)
    assert line in [target.line for target in found.targets]
    assert f"line {line}" in found.noted[-1].words


def test_an_element_of_an_array_is_the_target_of_its_number(tmp_path: Path) -> None:
    found = read(tmp_path, "m.mod", "MoveAbsJ js{2}\\NoEOffs,v100,fine,tool0;")
    move = found.moves[0]
    assert move is not None
    elements = [i for i, target in enumerate(found.targets) if target.name == "js"]
    assert len(elements) == 2
    assert move.target == elements[1]

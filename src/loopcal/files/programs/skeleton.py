"""Programs that drive poses one after another and wait at each: to measure them.

Only what vendors publish is written: joint targets, a slow move by joints, an exact stop, a wait.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.files.programs.joint_axes import JointAxes
from loopcal.files.programs.program import refuse_redundant, written
from loopcal.files.programs.yaskawa import pulses_of

Array = NDArray[np.float64]
WAIT = 3.0
"""Seconds at each pose."""


@dataclass(frozen=True, eq=False)
class Stops:
    """Poses to drive to.

    name: of the program; ids: of the poses, with what each is for; values: (N, n) in degrees and
    millimetres, in pulses, or in SI, as the format has them; units: deg or mm of each joint; words:
    lines of a comment at its head.
    """

    name: str
    ids: Sequence[str]
    values: Array
    units: Sequence[str]
    words: Sequence[str]

    def texts(self, decimals: int) -> list[list[str]]:
        """(N, n) with so many decimals."""
        return [[written(v, decimals) for v in row] for row in self.values.tolist()]


def _rapid(stops: Stops) -> list[str]:
    rest = ",".join(["9E9"] * 6)
    lines = [f"MODULE {stops.name}", *(f"  ! {words}" for words in stops.words)]
    for i, row in enumerate(stops.texts(6), 1):
        axes = ",".join([*row, *["0"] * (6 - len(row))])
        lines.append(f"  CONST jointtarget pose{i}:=[[{axes}],[{rest}]];")
    lines.append("  PROC main()")
    for i, one in enumerate(stops.ids, 1):
        lines += [
            f"    ! pose {one}",
            f"    MoveAbsJ pose{i},v100,fine,tool0;",
            f"    WaitTime {WAIT:g};",
        ]
    return [*lines, "  ENDPROC", "ENDMODULE"]


def _krl(stops: Stops) -> list[str]:
    lines = [f"DEF {stops.name}( )", *(f"; {words}" for words in stops.words)]
    lines += ["INT I", "BAS(#INITMOV,0)", "FOR I=1 TO 6", "$VEL_AXIS[I]=10", "ENDFOR"]
    for one, row in zip(stops.ids, stops.texts(6), strict=True):
        axes = ",".join(f"A{k} {v}" for k, v in enumerate(row, 1))
        lines += [f"; pose {one}", f"PTP {{{axes}}}", f"WAIT SEC {WAIT:g}"]
    return [*lines, "END"]


def _fanuc(stops: Stops) -> list[str]:
    moves = [f"!{words[:32]}" for words in stops.words]
    moves += ["UFRAME_NUM=0", "UTOOL_NUM=1"]
    for i, one in enumerate(stops.ids, 1):
        moves += [f"!pose {one[:26]}", f"J P[{i}] 10% FINE", f"WAIT {WAIT:.2f}(sec)"]
    head = [f"/PROG  {stops.name.upper()}", "/ATTR", "OWNER\t\t= MNEDITOR;"]
    head += ['COMMENT\t\t= "poses to measure";', f"LINE_COUNT\t= {len(moves)};"]
    head += ["DEFAULT_GROUP\t= 1,*,*,*,*;", "/MN"]
    lines = [f"{i:4d}:  {move} ;" for i, move in enumerate(moves, 1)]
    lines.append("/POS")
    for i, row in enumerate(stops.texts(3), 1):
        pairs = zip(row, stops.units, strict=True)
        axes = [f"\tJ{k}= {v:>9} {unit}" for k, (v, unit) in enumerate(pairs, 1)]
        lines += [f"P[{i}]{{", "   GP1:", "\tUF : 0, UT : 1,"]
        lines += [*(f"{axis}," for axis in axes[:-1]), axes[-1], "};"]
    return [*head, *lines, "/END"]


def _yaskawa(stops: Stops) -> list[str]:
    lines = ["/JOB", f"//NAME {stops.name.upper()}", "//POS", f"///NPOS {len(stops.ids)},0,0,0,0,0"]
    lines += ["///TOOL 0", "///POSTYPE PULSE", "///PULSE"]
    lines += [f"C{i:05d}={','.join(row)}" for i, row in enumerate(stops.texts(0))]
    lines += ["//INST", "///DATE 2000/01/01 00:00", "///ATTR SC,RW", "///GROUP1 RB1", "NOP"]
    lines += [f"'{words[:32]}" for words in stops.words]
    for i, one in enumerate(stops.ids):
        lines += [f"'pose {one[:26]}", f"MOVJ C{i:05d} VJ=10.00", f"TIMER T={WAIT:.2f}"]
    return [*lines, "END"]


def _urscript(stops: Stops) -> list[str]:
    lines = [f"def {stops.name}():", *(f"  # {words}" for words in stops.words)]
    for one, row in zip(stops.ids, stops.texts(9), strict=True):
        lines += [
            f"  # pose {one}",
            f"  movej([{','.join(row)}],a=0.5,v=0.3)",
            f"  sleep({WAIT:g})",
        ]
    return [*lines, "end"]


@dataclass(frozen=True)
class _Format:
    """A format: what it is called, how long names may be, what its numbers are, how lines end."""

    kind: str
    longest: int
    write: Callable[[Stops], list[str]]
    si: bool = False
    pulses: bool = False
    ended: str = "\r\n"


FORMATS = {
    ".mod": _Format("RAPID", 32, _rapid),
    ".src": _Format("KRL", 24, _krl),
    ".ls": _Format("Fanuc LS", 36, _fanuc),
    ".jbi": _Format("Yaskawa JBI", 32, _yaskawa, pulses=True),
    ".script": _Format("URScript", 64, _urscript, si=True, ended="\n"),
}


def program_of_stops(
    path: Path, axes: JointAxes, joints: Array, ids: Sequence[str], words: Sequence[str]
) -> bytes:
    """A program that drives to joints (N, n) [SI] and waits at each, in the format that the ending
    of the path names.

    ids: of the poses, words: for its head, both ASCII in the file. Raises InputError for an unknown
    ending, a name that the format does not allow, an arm of more than six joints, and pulses that
    are not stated.
    """
    its = FORMATS.get(path.suffix.lower())
    if its is None:
        raise InputError(
            f"the ending {path.suffix!r} is that of no program that loopcal writes",
            code="wrong-file-type",
            place=str(path),
            remedy=f"give a file that ends in {', '.join(FORMATS)}",
        )
    if not re.fullmatch(rf"[A-Za-z]\w{{0,{its.longest - 1}}}", path.stem, re.ASCII):
        raise InputError(
            f"{path.stem!r} is no name of a program in {its.kind}",
            code="invalid-value",
            place=str(path),
            remedy=f"begin with a letter, use letters, digits and _, at most {its.longest}",
        )
    refuse_redundant(axes, str(path))
    values = joints if its.si else joints / axes.scale
    if its.pulses:
        values = values * pulses_of(axes, str(path))
    units = ["mm" if unit == "m" else "deg" for unit in axes.joints.values()]
    stops = Stops(path.stem, [_plain(i) for i in ids], values, units, [_plain(w) for w in words])
    return its.ended.join([*its.write(stops), ""]).encode("ascii")


def _plain(text: str) -> str:
    """As one line of ASCII."""
    return re.sub(r"[^ -~]+", "?", text)

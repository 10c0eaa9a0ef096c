"""Programs that drive poses one after another and wait at each: to measure them.

Only what vendors publish is written: joint targets, a slow move by joints, an exact stop, a wait.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.files.programs.dialect import Stops
from loopcal.files.programs.joint_axes import JointAxes
from loopcal.files.programs.program import refuse_redundant
from loopcal.files.programs.registry import WRITTEN

Array = NDArray[np.float64]


def program_of_stops(
    path: Path, axes: JointAxes, joints: Array, ids: Sequence[str], words: Sequence[str]
) -> bytes:
    """A program that drives to joints (N, n) [SI] and waits at each, in the format that the ending
    of the path names.

    ids: of the poses, words: for its head, both ASCII in the file. Raises InputError for an unknown
    ending, a name that the format does not allow, an arm of more than six joints, and pulses that
    are not stated.
    """
    dialect = WRITTEN.get(path.suffix.lower())
    if dialect is None or dialect.drive is None:
        raise InputError(
            f"the ending {path.suffix!r} is that of no program that loopcal writes",
            code="wrong-file-type",
            place=str(path),
            remedy=f"give a file that ends in {', '.join(WRITTEN)}",
        )
    drive = dialect.drive
    if not re.fullmatch(rf"[A-Za-z]\w{{0,{drive.longest - 1}}}", path.stem, re.ASCII):
        raise InputError(
            f"{path.stem!r} is no name of a program in {dialect.kind}",
            code="invalid-value",
            place=str(path),
            remedy=f"begin with a letter, use letters, digits and _, at most {drive.longest}",
        )
    refuse_redundant(axes, str(path))
    values = joints if drive.si else joints / axes.scale
    if drive.pulses:
        values = values * axes.pulses_each(str(path))
    units = ["mm" if unit == "m" else "deg" for unit in axes.joints.values()]
    stops = Stops(path.stem, [_plain(i) for i in ids], values, units, [_plain(w) for w in words])
    return drive.ended.join([*drive.write(stops), ""]).encode("ascii")


def _plain(text: str) -> str:
    """As one line of ASCII."""
    return re.sub(r"[^ -~]+", "?", text)

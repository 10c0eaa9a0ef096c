"""The poses of a plan as a program for the controller of the arm.

Programs that drive poses one after another and wait at each: to measure them.

Only what vendors publish is written: joint targets, a slow move by joints, an exact stop, a wait.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from loopcal.arrays import Array
from loopcal.companions.planning.planned import Plan
from loopcal.companions.robot.programs.coordinates import JointAxes
from loopcal.companions.robot.programs.dialect import Stops
from loopcal.companions.robot.programs.program import refuse_redundant
from loopcal.companions.robot.programs.registry import WRITTEN
from loopcal.errors import InputError
from loopcal.files.atomic import write_atomic
from loopcal.files.outputs import one_command, refuse_foreign
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.workflow.resolved import described

# At most 32 characters each, where Fanuc and Yaskawa programs cut a comment.
WORDS = (
    "Poses planned by loopcal.",
    "Zeros of joints as in the plan.",
    "Moves between poses are not",
    "checked for collisions: run",
    "slowly first.",
)


@one_command
def plan_program(
    mechanism: Any,
    plan: Plan,
    path: str | Path,
    *,
    pulses: Sequence[float] = (),
    force: bool = False,
) -> Path:
    """Write the poses of a plan as a program: a joint move to each, in order, and a wait of 3 s.

    mechanism: a Mechanism, a project or the path of one; path: its ending names the dialect, such
    as .mod for RAPID; pulses: per degree of each joint, for a dialect in pulses; force: replace a
    file that exists, keeping a backup. Joints are named from base to tip. Moves between poses are
    not checked for collisions. Raises InputError for a machine whose joints the plan does not
    state, and for what the format cannot hold.
    """
    description = described(mechanism)
    write = program_writer(getattr(description, "mechanism", description), path, pulses=pulses)
    write_atomic(path, write(plan))
    return Path(path)


def program_writer(
    mechanism: Mechanism, path: str | Path, *, pulses: Sequence[float] = ()
) -> Callable[[Plan], bytes]:
    """What makes the program of a plan, after all that can be refused without one is refused."""
    path, joints = Path(path), {s.joint: s.unit for s in mechanism.chain if s.joint}
    if not joints or not mechanism.implied.keys().isdisjoint(joints):
        raise InputError(
            f"{mechanism.name!r} is not a serial arm whose joints are driven one by one",
            code="unsupported",
            place=str(path),
            remedy="leave --program out, and drive the poses of plan.csv",
        )
    refuse_foreign(path)
    axes = JointAxes(joints, pulses=tuple(pulses))
    # A program without poses refuses name, ending and pulses before anything is planned.
    program_of_stops(path, axes, np.empty((0, len(joints))), (), ())

    def program(plan: Plan) -> bytes:
        q = np.array([plan.poses.readings[joint] for joint in joints]).T
        ids = [f"{i}, {use}" for i, use in zip(plan.poses.poses, plan.use, strict=True)]
        return program_of_stops(path, axes, q, ids, WORDS)

    return program


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

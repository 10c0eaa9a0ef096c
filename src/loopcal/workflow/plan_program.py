"""The poses of a plan as a program for the controller of the arm."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from loopcal.errors import InputError
from loopcal.files.atomic import write_atomic
from loopcal.files.outputs import one_command, refuse_foreign
from loopcal.files.programs.joint_axes import JointAxes
from loopcal.files.programs.skeleton import program_of_stops
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.planning.planned import Plan
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

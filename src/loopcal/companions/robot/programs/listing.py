"""A program while it is read: its targets, its moves, and what is not understood.

Numbers of a target are joints; where they have keys, also x, y, z in millimetres and three turns in
degrees.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from loopcal.arrays import Array
from loopcal.companions.robot.programs.joint_axes import JointAxes
from loopcal.companions.robot.programs.poses_text import pose_of_turns, turns_of_pose
from loopcal.companions.robot.programs.program import (
    NOWHERE,
    Lines,
    Move,
    Noted,
    Number,
    Program,
    ProgramTarget,
    Span,
    written,
)


class Listing:
    """The text of a program, and what was read of it until here.

    code: the text with what `aside` matches (comments, strings) as blanks, every place kept; scale:
    (n,) SI per number of a joint, by default degrees and millimetres; decimals: written at least;
    joint: letter ahead of the number of a joint; pose: keys of x, y, z and the turns about z, y, x.
    """

    def __init__(
        self,
        text: str,
        name: str,
        axes: JointAxes,
        decimals: int,
        *,
        aside: re.Pattern[str] | None = None,
        scale: Array | None = None,
        joint: str = "",
        pose: Sequence[str] = (),
    ) -> None:
        self.text, self.name, self.lines = text, name, Lines(text)
        self.code = text
        if aside is not None:
            self.code = aside.sub(lambda match: re.sub(r"[^\r\n]", " ", match[0]), text)
        self.scale, self.decimals = axes.scale if scale is None else scale, decimals
        self.keys = [f"{joint}{i}" for i in range(1, len(axes.joints) + 1)]
        self.pose = pose
        self.targets: list[ProgramTarget] = []
        self.moves: list[Move | None] = []
        self.noted: list[Noted] = []

    def add(self, target: ProgramTarget) -> int:
        """Keep a target; its index."""
        self.targets.append(target)
        return len(self.targets) - 1

    def note(self, at: int, words: str) -> None:
        """Name what stands at a place of the text and is left as it is."""
        self.noted.append(Noted(self.lines.of(at), words))

    def leave(self, at: int, words: str, why: str, called: Iterable[int] = ()) -> None:
        """Name a move that is left as it is; called: indices of the targets that it names."""
        self.moves.append(None)
        lines = ", ".join(str(self.targets[i].line) for i in [*called][:3])
        handled = f"; the target that it names is handled in line {lines}" if lines else ""
        self.note(at, f"{words}: {why}{handled}")

    def joints(
        self, label: str, at: int, numbers: Sequence[Number], literal: Span = NOWHERE
    ) -> ProgramTarget:
        """A target of joints, which stands at a place of the text."""
        q = np.array([number.value for number in numbers]) * self.scale
        step = self.steps(numbers) * np.abs(self.scale)
        line = self.lines.of(at)
        return ProgramTarget(label, line, False, tuple(numbers), q, None, step, literal=literal)

    def keyed(
        self,
        label: str,
        at: int,
        stated: Mapping[str, Number | None],
        states: Mapping[str, int],
        literal: Span,
    ) -> ProgramTarget | None:
        """The target of numbers with keys; None where one that it needs is missing.

        states: of the configuration, which a target of joints does not need; literal: all of it.
        """
        joint = self.keys[0] in stated
        keys = self.keys if joint else self.pose
        numbers = tuple(n for key in keys if (n := stated.get(key)) is not None)
        if len(numbers) < len(keys):
            return None
        if joint:
            return self.joints(label, at, numbers, literal)
        # Reversed: numbers turn about z, y, x, the steps of a pose are about x, y, z.
        step = self.steps(numbers)
        step = np.concatenate([1e-3 * step[:3], np.radians(step[:2:-1])])
        pose = pose_of_turns([number.value for number in numbers])
        line = self.lines.of(at)
        return ProgramTarget(label, line, True, numbers, None, pose, step, states, literal)

    def steps(self, numbers: Sequence[Number]) -> Array:
        """The last digits of numbers as they will be written."""
        return np.array([10.0 ** -max(number.decimals, self.decimals) for number in numbers])

    def write(self, target: ProgramTarget, joints: Array, pose: Array) -> list[str]:
        """The new texts of the numbers of a target."""
        values = turns_of_pose(pose) if target.cartesian else (joints / self.scale).tolist()
        return texts(values, target.numbers, self.decimals)

    def program(self, kind: str, *, once: bool = False, **options: Any) -> Program:
        """The program, with further fields of it; once: of notes the first of each line alone."""
        noted = sorted(self.noted, key=lambda note: note.line)
        if once:
            noted = [*{note.line: note for note in reversed(noted)}.values()][::-1]
        targets, moves = tuple(self.targets), tuple(self.moves)
        options.setdefault("write", self.write)
        return Program(kind, self.name, self.text, targets, tuple(noted), moves=moves, **options)


def texts(values: Sequence[float], numbers: Sequence[Number], decimals: int) -> list[str]:
    """Values with as many decimals as the numbers that they replace have, and as many at least."""
    return [written(v, max(n.decimals, decimals)) for v, n in zip(values, numbers, strict=True)]

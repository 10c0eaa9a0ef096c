"""A robot program as bytes with targets in it: numbers at places, and nothing else is touched.

Programs are read as Latin-1, in which every byte is one character and comes back as it was. Values
are SI inside; each number remembers how many decimals it had.
"""

from __future__ import annotations

import re
from bisect import bisect_left
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.companions.robot.programs.coordinates import JointAxes, pose_of_turns, turns_of_pose
from loopcal.errors import InputError, short

NUMBER = re.compile(r"[+-]?(?:\d++\.?\d*+|\.\d++)(?:[eE][+-]?\d++)?", re.ASCII)
LARGEST = 16_000_000
"""Bytes of a program, at most: a larger file is no program."""
# A number of 19 digits may exceed 2^63 - 1.
_STATE = 18


@dataclass(frozen=True)
class Number:
    """A number in the text: where it stands, and how many decimals it has."""

    start: int
    end: int
    text: str

    @property
    def value(self) -> float:
        """As a float; a decimal comma counts as a point."""
        return float(self.text.replace(",", "."))

    @property
    def decimals(self) -> int:
        """Digits behind the decimal mark."""
        mantissa = self.text.replace(",", ".").lower().split("e")[0]
        return len(mantissa.partition(".")[2])


Rows = Mapping[int, Sequence[Sequence[str]]]
"""Index of a move -> texts of the numbers of each target to insert ahead of it."""


class Span(NamedTuple):
    """A part of the text, from start to before end."""

    start: int
    end: int


NOWHERE = Span(0, 0)


class Place(NamedTuple):
    """A part of the text, and what replaces it."""

    span: Span
    text: str


@dataclass(frozen=True, eq=False)
class ProgramTarget:
    """One target of a program.

    name, line: where it stands; cartesian: whether it is a pose; numbers: those that are replaced,
    in the order of the format; joints (n,) [rad, m]: of a joint target, or the seed of a pose;
    pose (4, 4): of a pose, in the frame that the program names; step: last digits as they will be
    written [SI], (n,) of joints or (6,) of a pose; states: what the program says of the
    configuration, by its own names; literal: all of it, as a copy needs it; label: where its name
    stands in it.
    """

    name: str
    line: int
    cartesian: bool
    numbers: tuple[Number, ...]
    joints: Array | None
    pose: Array | None
    step: Array
    states: Mapping[str, int] = field(default_factory=dict)
    literal: Span = NOWHERE
    label: Number | None = None


@dataclass(frozen=True)
class Noted:
    """A line that was found but not understood, and is left as it is."""

    line: int
    words: str


@dataclass(frozen=True)
class Move:
    """A move in the order of the program: to which target (its index), and how.

    lines: those that hold it; called: where its target is named or written in them; fixed: why no
    target can be inserted ahead of it, empty where one can.
    """

    target: int
    line: int
    straight: bool
    lines: Span = NOWHERE
    called: Span = NOWHERE
    fixed: str = ""


@dataclass(frozen=True, eq=False)
class Program:
    """What a file asks for.

    text: Latin-1; write(target, joints, pose): new texts of its numbers; fits(target, joints):
    whether joints (..., n) have the configuration that the target states; chosen(target, several):
    those of several fitting joints that it means; noted: what is left alone; moves:
    in their order, None where a move in between is not understood; frame: what the poses are
    relative to, where it is not the base; insert: places of targets ahead of moves, where copies of
    their lines do not do.
    """

    kind: str
    name: str
    text: str
    targets: tuple[ProgramTarget, ...]
    noted: tuple[Noted, ...]
    write: Callable[[ProgramTarget, Array, Array], list[str]]
    fits: Callable[[ProgramTarget, Array], NDArray[np.bool_]] = lambda target, joints: np.ones(
        joints.shape[:-1], dtype=bool
    )
    chosen: Callable[[ProgramTarget, list[Array]], list[Array]] = lambda target, several: several
    moves: tuple[Move | None, ...] = ()
    frame: str | None = None
    insert: Callable[[Program, Rows], Sequence[Place]] | None = None

    def edited(self, new: Mapping[int, Sequence[str]], more: Sequence[Place] = ()) -> bytes:
        """The bytes with the numbers of some targets (index -> texts) replaced.

        more: further places, such as inserted lines.
        """
        places = [
            Place(Span(number.start, number.end), text)
            for index, texts in new.items()
            for number, text in zip(self.targets[index].numbers, texts, strict=True)
        ]
        whole = Span(0, len(self.text))
        return replaced(self.text, whole, [*places, *more]).encode("latin-1")


def replaced(text: str, part: Span, places: Sequence[Place]) -> str:
    """A part of the text with other texts at some places in it."""
    parts, at = [], part.start
    # Stable: what is inserted at one place keeps its order.
    for (start, stop), new in sorted(places, key=lambda place: place.span):
        parts += [text[at:start], new]
        at = stop
    return "".join([*parts, text[at : part.end]])


def line_end(text: str) -> str:
    """What ends a line in it."""
    mark = re.search(r"\r\n|\n|\r", text)
    return mark[0] if mark else "\n"


def text_of(data: bytes, name: str) -> str:
    """The text of a program. Raises InputError for what cannot be edited byte by byte."""
    if len(data) > LARGEST:
        raise InputError(
            f"the program has more than {LARGEST:,} bytes",
            code="too-large",
            place=name,
            remedy="divide it",
        )
    if data[:2] in (b"\xff\xfe", b"\xfe\xff") or b"\0" in data:
        line = data[: data.find(b"\0")].count(b"\n") + 1 if b"\0" in data else 1
        raise InputError(
            "the program is not written in single bytes (UTF-16, or it holds zero bytes)",
            code="unreadable-file",
            place=f"{name}, line {line}",
            remedy="save it as ASCII, Latin-1 or UTF-8",
        )
    return data.decode("latin-1")


def refuse_redundant(axes: JointAxes, name: str) -> None:
    """Raise InputError for an arm of more joints than the targets of this format have."""
    if len(axes.joints) > 6:
        raise InputError(
            f"targets of this format have six joints, the arm {len(axes.joints)}",
            code="unsupported",
            place=name,
            remedy="give the joints as a table",
        )


def within(starts: Sequence[int], begin: int, end: int) -> Sequence[int]:
    """Those of some ascending places that lie from begin to before end."""
    return starts[bisect_left(starts, begin) : bisect_left(starts, end)]


def numbers_of(text: str, at: int) -> tuple[Number, ...]:
    """The numbers of a list such as "1, -2.5, 9E9", which begins at this place."""
    return tuple(Number(at + m.start(), at + m.end(), m[0]) for m in NUMBER.finditer(text))


def whole(number: Number) -> int:
    """A state of the configuration. Raises InputError for one of more digits than any has."""
    if len(number.text) > _STATE:
        raise InputError(
            f"{short(number.text)} has more than {_STATE} digits, too many for a configuration",
            code="invalid-number",
            remedy="correct the number",
        )
    return int(number.text)


class Lines:
    """Numbers of lines by the position in a text; LF, CRLF and CR alone end a line."""

    def __init__(self, text: str) -> None:
        self._ends = np.array([m.end() for m in re.finditer(r"\r\n|\n|\r", text)], dtype=np.int64)

    def of(self, position: int) -> int:
        """The line, counted from 1."""
        return int(np.searchsorted(self._ends, position, side="right")) + 1

    def begin(self, position: int) -> int:
        """Where that line begins."""
        before = self.of(position) - 1
        return int(self._ends[before - 1]) if before else 0


def written(value: float, decimals: int) -> str:
    """A number with so many decimals, never "-0.000".

    >>> written(-1e-9, 3), written(12.5, 0)
    ('0.000', '12')
    """
    text = f"{value:.{decimals}f}"
    return text.lstrip("-") if float(text) == 0.0 else text


# A program while it is read: its targets, its moves, and what is not understood.
#
# Numbers of a target are joints; where they have keys, also x, y, z in millimetres and three turns
# in degrees.


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

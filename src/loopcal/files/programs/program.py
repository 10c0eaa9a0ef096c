"""A robot program as bytes with targets in it: numbers at places, and nothing else is touched.

Programs are read as Latin-1, in which every byte is one character and comes back as it was. Values
are SI inside; each number remembers how many decimals it had.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError

Array = NDArray[np.float64]
LARGEST = 64_000_000
"""Bytes of a program, at most: a larger file is no program."""


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


@dataclass(frozen=True, eq=False)
class ProgramTarget:
    """One target of a program.

    name, line: where it stands; cartesian: whether it is a pose; numbers: those that are replaced,
    in the order of the format; joints (n,) [rad, m]: of a joint target, or the seed of a pose;
    pose (4, 4): of a pose, in the frame that the program names; step: last digits as they will be
    written [SI], (n,) of joints or (6,) of a pose; states: what the program says of the
    configuration, by its own names; straight: whether the move to it is a straight line.
    """

    name: str
    line: int
    cartesian: bool
    numbers: tuple[Number, ...]
    joints: Array | None
    pose: Array | None
    step: Array
    states: Mapping[str, int] = field(default_factory=dict)
    straight: bool = False


@dataclass(frozen=True)
class Noted:
    """A line that was found but not understood, and is left as it is."""

    line: int
    words: str


@dataclass(frozen=True, eq=False)
class Program:
    """What a file asks for.

    text: Latin-1; write(target, joints, pose): new texts of its numbers; fits(target, joints):
    whether joints have the configuration that the target states; noted: what is left alone.
    """

    kind: str
    name: str
    text: str
    targets: tuple[ProgramTarget, ...]
    noted: tuple[Noted, ...]
    write: Callable[[ProgramTarget, Array, Array], list[str]]
    fits: Callable[[ProgramTarget, Array], bool] = lambda target, joints: True

    def edited(self, new: Mapping[int, Sequence[str]]) -> bytes:
        """The bytes with the numbers of some targets (index -> texts) replaced."""
        places = [
            (number.start, number.end, text)
            for index, texts in new.items()
            for number, text in zip(self.targets[index].numbers, texts, strict=True)
        ]
        parts, at = [], 0
        for start, end, text in sorted(places):
            parts += [self.text[at:start], text]
            at = end
        return "".join([*parts, self.text[at:]]).encode("latin-1")


def text_of(data: bytes, name: str) -> str:
    """The text of a program. Raises InputError for what cannot be edited byte by byte."""
    if len(data) > LARGEST:
        raise InputError(
            f"the program has {len(data):,} bytes; the limit is {LARGEST:,}",
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


class Lines:
    """Numbers of lines by the position in a text; LF, CRLF and CR alone end a line."""

    def __init__(self, text: str) -> None:
        import re

        self._ends = np.array([m.end() for m in re.finditer(r"\r\n|\n|\r", text)], dtype=np.int64)

    def of(self, position: int) -> int:
        """The line, counted from 1."""
        return int(np.searchsorted(self._ends, position, side="right")) + 1


def written(value: float, decimals: int) -> str:
    """A number with so many decimals, never "-0.000".

    >>> written(-1e-9, 3), written(12.5, 0)
    ('0.000', '12')
    """
    text = f"{value:.{decimals}f}"
    return text.lstrip("-") if float(text) == 0.0 else text

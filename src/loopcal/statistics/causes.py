"""What probably happened to a row of data that does not fit: each guess is made, and tried.

A guess puts the row right as if one thing had gone wrong: a sign, half a turn, a unit, two columns
exchanged, one digit mistyped. It counts if the row then fits parameters that it took no part in.
Digits can be changed in many ways, so such a guess counts only if it would hardly fit by chance.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from loopcal.arrays import Array
from loopcal.estimation.problem.problem import Problem
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.mechanism import PIXELS
from loopcal.mechanisms.outputs import measured_points
from loopcal.statistics.pose_tests import Fitted, try_rows
from loopcal.units import from_si, to_si

# Record 0054: p-value of a single test.
FITS = 0.001
"""A row put right fits if a good one would be worse with at least this probability."""
# Chosen, not derived: of ten digits that are named one is named by chance, and a user looks at it.
BY_CHANCE = 0.1
"""A mistyped digit is named if one would fit by chance with at most about this probability."""
# A joint that runs through a grid repeats its reading from row to row: that is no fault.
_OFTEN = 0.2
_RATIOS = {
    "rad": (
        (math.pi / 180, "degrees read as radians"),
        (180 / math.pi, "degrees of an angle twice"),
    ),
    "m": (
        (1e-3, "millimetres read as metres"),
        (1e3, "metres read as millimetres"),
        (25.4, "inches read as millimetres"),
        (1 / 25.4, "millimetres read as inches"),
        (0.0254, "inches read as metres"),
    ),
}


# Chosen, not derived: the sd of what is predicted is then three times that of a reading.
_SEEN = 0.1
"""Where the parameters leave less of an equation to test, any row fits, and none is verified."""


@dataclass(frozen=True)
class Suspect:
    """A pose that does not fit: its chi-squared t of so many degrees of freedom.

    explained: reading -> (size of its error [SI], what is left of t without that reading), for
    the readings that explain the pose alone, the best first; together: where none does, instruments
    whose readings explain it together, with how far their point is off [m], and the joints.
    """

    pose: int
    t: float
    freedom: int
    explained: Mapping[int, tuple[float, float]]
    together: Mapping[str, float | None] = field(default_factory=dict)


@dataclass(frozen=True)
class Cause:
    """What probably happened: quantity is its position, None where several are concerned."""

    words: str
    quantity: int | None
    verified: bool


@dataclass(frozen=True)
class _Guess:
    """The row as it should have been read; rivals: like guesses per unit near the error's size."""

    words: str
    quantity: int | None
    readings: Array
    rivals: float = 0.0


def find_causes(
    problem: Problem,
    dataset: Dataset,
    fit: Fitted,
    suspects: list[Suspect],
) -> list[Cause | None]:
    """The first guess of each suspect that makes its row fit; None where none does."""
    guesses = [list(_guesses(problem, dataset, suspect)) for suspect in suspects]
    rows = [(s.pose, g) for s, tries in zip(suspects, guesses, strict=True) for g in tries]
    if not rows:
        return [_repeated(problem, suspect) for suspect in suspects]
    readings = np.array([guess.readings for _, guess in rows]).T
    hidden = np.isinf(np.broadcast_to(problem.uncertainty.sd, problem.readings.shape))
    poses = [pose for pose, _ in rows]
    tried = try_rows(problem, fit, poses, readings, hidden[:, poses])
    p = tried.tests.p_pose
    causes: list[Cause | None] = []
    column = 0
    for suspect, tries in zip(suspects, guesses, strict=True):
        cause = _repeated(problem, suspect)
        for guess in tries:
            sd = 0.0 if guess.quantity is None else float(tried.tests.sd[guess.quantity, column])
            # A window of 3 sds either way is 6 sd wide, and holds so many rivals by chance.
            hardly = 6.0 * sd * guess.rivals <= BY_CHANCE
            seen = tried.tests.least[column] >= _SEEN
            if cause is None and p[column] >= FITS and hardly and seen:
                cause = Cause(guess.words, guess.quantity, True)
            column += 1
        causes.append(cause)
    return causes


def _repeated(problem: Problem, suspect: Suspect) -> Cause | None:
    """A point of zeros, or a reading of the row before again where its column rarely repeats."""
    i, x = suspect.pose, problem.readings
    names = problem.mechanism.tape.quantities
    for point in measured_points(problem.mechanism):
        if len(point) > 1 and not x[[names.index(q) for q in point], i].any():
            return Cause(f"no reflector: {', '.join(point)} read 0", None, True)
    if i == 0:
        return None
    for j in suspect.explained:
        same = x[j, 1:] == x[j, :-1]
        if same[i - 1] and same.mean() < _OFTEN:
            return Cause("value repeated from the row before", j, True)
    return None


def _guesses(problem: Problem, dataset: Dataset, suspect: Suspect) -> Iterator[_Guess]:
    """What may have happened, the most specific first."""
    x = problem.readings[:, suspect.pose]
    units = _units(problem)
    yield from _same_point(problem, suspect.pose)
    for j, (size, _) in suspect.explained.items():
        for words, value in _simple(float(x[j]), units[j]):
            # what is far from where the other readings have it need not be tried
            if abs(value - (x[j] - size)) <= 0.1 * abs(size):
                yield _Guess(words, j, _with(x, [j], [value]))
    # With one equation every reading explains the pose alone, so that nothing is ruled out.
    if not suspect.explained or suspect.freedom < 2:
        yield from _of_several(problem, dataset, x, units)
    for j, (size, _) in suspect.explained.items():
        name = problem.mechanism.tape.quantities[j]
        stated = dataset.source.stated.get(name, units[j])
        yield from _digits(x, j, size, stated)


def _simple(value: float, unit: str) -> Iterator[tuple[str, float]]:
    """One reading: sign, half a turn, a turn, units."""
    yield "sign reversed", -value
    if unit == "rad":
        for turns, words in ((0.5, "angle off by half a turn"), (1.0, "angle off by a turn")):
            yield words, value + turns * 2 * math.pi
            yield words, value - turns * 2 * math.pi
    for ratio, words in _RATIOS.get(unit, ()):
        yield words, value * ratio


def _same_point(problem: Problem, i: int) -> Iterator[_Guess]:
    """The point measured again: then it belongs to the joints of the row before."""
    outputs = _outputs(problem)
    if i == 0 or not outputs:
        return
    now, before = problem.readings[:, i], problem.readings[:, i - 1]
    if np.array_equal(now[outputs], before[outputs]):
        yield _Guess("the point of the row before again (reflector lost?)", None, before.copy())


def _of_several(problem: Problem, dataset: Dataset, x: Array, units: list[str]) -> Iterator[_Guess]:
    """Several columns of a row: two exchanged, or all of one kind in another unit."""
    names = problem.mechanism.tape.quantities
    real = [
        j
        for j, name in enumerate(names)
        if name in dataset.readings and name not in problem.mechanism.disturbances
    ]
    for family in problem.mechanism.families:
        if family.form == PIXELS:
            # A board detected from its other end numbers its points backwards.
            pairs = np.array([names.index(q) for q in family.readings]).reshape(-1, 2)
            words = f"points of {family.name!r} in another order: turned by half a turn"
            yield _Guess(words, None, _with(x, pairs.ravel().tolist(), x[pairs[::-1].ravel()]))
    for j, other in combinations(real, 2):
        if units[j] == units[other] != "px":
            words = f"{names[j]} and {names[other]} exchanged"
            yield _Guess(words, None, _with(x, [j, other], [x[other], x[j]]))
    for unit, ratios in _RATIOS.items():
        rows = [j for j in real if units[j] == unit]
        if len(rows) > 1:
            for ratio, words in ratios:
                yield _Guess(f"all of {unit}: {words}", None, _with(x, rows, x[rows] * ratio))


def _digits(x: Array, j: int, size: float, unit: str) -> Iterator[_Guess]:
    """Decimal point moved, two digits exchanged, one digit changed, in the unit of the file."""
    # Twelve digits: more would show the rounding of the conversion from SI to the unit of the file.
    read = f"{abs(float(from_si(x[j], unit))):.12g}"
    if "e" in read:
        return
    sign = math.copysign(1.0, x[j])
    edits: dict[str, str] = {}
    for move in (-3, -2, -1, 1, 2, 3):
        edits.setdefault(f"{float(read) * 10.0**move:.12g}", "decimal point moved")
    for a in range(len(read) - 1):
        b = a + 2 if read[a + 1] == "." and a + 2 < len(read) else a + 1
        if read[a] != "." and read[b] != ".":
            edits.setdefault(_replaced(read, {a: read[b], b: read[a]}), "two digits exchanged")
    for a, digit in enumerate(read):
        if digit != ".":
            for other in "0123456789".replace(digit, ""):
                edits.setdefault(_replaced(read, {a: other}), "one digit mistyped")
    changes = {
        text: x[j] - sign * float(to_si(float(text), unit)) for text in edits if text != read
    }
    near = [c for c in changes.values() if 0.5 <= c / size <= 2.0]
    # From 0.5 to 2 times the error is an interval of 1.5 times its size: rivals is a density.
    rivals = len(near) / (1.5 * abs(size))
    for text, words in edits.items():
        change = changes.get(text)
        if change is not None and abs(change - size) <= 0.1 * abs(size):
            minus = "-" if sign < 0 else ""
            said = f"{words}: {minus}{read} {unit} read, {minus}{text} {unit} meant"
            yield _Guess(said, j, _with(x, [j], [x[j] - change]), rivals)


def _replaced(text: str, changes: Mapping[int, str]) -> str:
    return "".join(changes.get(i, letter) for i, letter in enumerate(text))


def _with(x: Array, rows: list[int], values: Array | list[float]) -> Array:
    changed = x.copy()
    changed[rows] = values
    return changed


def _units(problem: Problem) -> list[str]:
    quantities = problem.mechanism.quantities
    return [quantities[name] for name in problem.mechanism.tape.quantities]


def _outputs(problem: Problem) -> list[int]:
    return [problem.mechanism.tape.quantities.index(name) for name in problem.mechanism.outputs]

"""Who is to blame for a pose that does not fit: one reading, an instrument, or the joints.

Within a pose the loops couple the readings, and a misfit shows in all of their corrections. So
each reading is left out in turn and found again from the others: those that make the pose
unremarkable may be to blame, and what they should have read says what happened. Where none does,
all readings of an instrument are left out together (its target was hit, or it saw another one), and
all of the joints.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.dependence.dependence import joint_rows
from loopcal.estimation.problem.problem import Problem
from loopcal.mechanisms.mechanism import PIXELS
from loopcal.mechanisms.outputs import points
from loopcal.statistics.causes import Suspect
from loopcal.statistics.outlier_search import Search
from loopcal.statistics.pose_tests import Fitted, PoseTests, misfit_of_rows, try_rows

# Record 0054: p-value of a single test.
UNREMARKABLE = 0.001
"""A pose whose statistic has at least this probability is explained."""
JOINTS = "the joints"
# One start every 15 degrees, because loops are linearised where they start.
_ROUND = 24


def find_suspects(
    search: Search, fit: Fitted, where: NDArray[np.intp], tests: PoseTests
) -> list[Suspect]:
    """Each pose with every reading left out in turn and found from the others.

    Where no single one explains it, all readings of an instrument are left out together.
    """
    explained: dict[int, dict[int, tuple[float, float]]] = {int(i): {} for i in where}
    possible = np.isfinite(tests.w) & search.readings[:, None]
    # Corners are tested one by one against the others of their images (`wrong_corners`).
    names = search.problem.mechanism.tape.quantities
    pixels = {q for f in search.problem.mechanism.families if f.form == PIXELS for q in f.readings}
    possible[[name in pixels for name in names]] = False
    # The circle costs 24 starts for each angle, so it is left to poses that nothing near explains.
    for anywhere in (False, True):
        left = [i for i, singles in explained.items() if not singles]
        pairs = [(i, int(j)) for i in left for j in np.flatnonzero(possible[:, i])]
        starts = [search.problem.readings[j, i] for i, j in pairs]
        if anywhere:
            pairs, starts = _round_the_circle(search.problem, fit, pairs)
        for i, j, size, t in _without_each(search, fit, pairs, starts):
            explained[i][j] = (size, t)
    together = _together(search, fit, [i for i, singles in explained.items() if not singles], tests)
    return [
        Suspect(
            i,
            float(tests.t[i]),
            int(tests.freedom[i]),
            dict(sorted(singles.items(), key=lambda item: item[1][1])),
            together.get(i, {}),
        )
        for i, singles in explained.items()
    ]


def _left_out(problem: Problem, pairs: list[tuple[int, int]]) -> NDArray[np.bool_]:
    """(k, V) what is unmeasured if of each pose one reading more is left out."""
    rows = [i for i, _ in pairs]
    without = np.isinf(np.broadcast_to(problem.uncertainty.sd, problem.readings.shape))[:, rows]
    for column, (_, j) in enumerate(pairs):
        without[j, column] = True
    return without


def _round_the_circle(
    problem: Problem, fit: Fitted, pairs: list[tuple[int, int]]
) -> tuple[list[tuple[int, int]], list[float]]:
    """The angles among these readings, and where on the circle each fits its pose best."""
    names, units = problem.mechanism.tape.quantities, problem.mechanism.quantities
    angles = [(i, j) for i, j in pairs if units[names[j]] == "rad"]
    if not angles:
        return [], []
    turned = [pair for pair in angles for _ in range(_ROUND)]
    readings = problem.readings[:, [i for i, _ in turned]]
    for column, (_, j) in enumerate(turned):
        readings[j, column] += 2 * np.pi * (column % _ROUND) / _ROUND
    t = misfit_of_rows(problem, fit, [i for i, _ in turned], readings, _left_out(problem, turned))
    best = np.where(np.isfinite(t), t, np.inf).reshape(-1, _ROUND).argmin(axis=1)
    columns = np.arange(len(angles)) * _ROUND + best
    return angles, [float(readings[j, c]) for (_, j), c in zip(angles, columns, strict=True)]


def _without_each(
    search: Search, fit: Fitted, pairs: list[tuple[int, int]], starts: list[float]
) -> Iterator[tuple[int, int, float, float]]:
    """Pose, reading, size of its error and what is left of t, where that is unremarkable."""
    if not pairs:
        return
    problem = search.problem
    rows = [i for i, _ in pairs]
    readings = problem.readings[:, rows]
    for column, (_, j) in enumerate(pairs):
        readings[j, column] = starts[column]
    without = _left_out(problem, pairs)
    tried = try_rows(problem, fit, rows, readings, without)
    p = tried.tests.p_pose
    for column, (i, j) in enumerate(pairs):
        corrected = readings[j, column] + tried.corrections[j, column]
        size = float(problem.readings[j, i] - corrected)
        if p[column] >= UNREMARKABLE and size:  # one that stays as it is explains nothing
            yield i, j, size, float(tried.tests.t[column])


def _together(
    search: Search, fit: Fitted, poses: Sequence[int], tests: PoseTests
) -> dict[int, dict[str, float | None]]:
    """Pose -> instruments that explain it if all of their readings are wrong, and the joints; how
    far a point is off [m], None for others.

    Joints that are as many as the equations can explain anything, as can an only instrument.
    """
    problem, instruments = search.problem, {i: dict[str, float | None]() for i in poses}
    names = problem.mechanism.tape.quantities
    families = [f for f in problem.mechanism.families if f.form != "closure"]
    groups = [(f.name, [names.index(q) for q in f.readings], f) for f in families]
    for name, rows, family in [g for g in groups if len(g[1]) > 1]:
        for i, corrections in _without_all(search, fit, poses, rows):
            size = None
            if family.form in ("point", "spherical", "polar"):
                read = problem.readings[rows, i][:, None]
                moved = points(family, read + corrections[rows][:, None]) - points(family, read)
                size = float(np.linalg.norm(moved))
            instruments[i][name] = size
    joints = joint_rows(problem) if families else []
    if len(joints) > 1:
        testable = [i for i in poses if len(joints) < tests.freedom[i]]
        explained = {i for i, _ in _without_all(search, fit, testable, joints)}
        for i in poses:
            if i in explained or i not in testable:
                instruments[i][JOINTS] = None
    return instruments


def _without_all(
    search: Search, fit: Fitted, poses: Sequence[int], rows: Sequence[int]
) -> Iterator[tuple[int, NDArray[np.float64]]]:
    """The poses that fit without these readings, and the corrections (k,) of all."""
    problem = search.problem
    if not poses:
        return
    index = list(poses)
    readings = problem.readings[:, index]
    without = np.isinf(np.broadcast_to(problem.uncertainty.sd, problem.readings.shape))[:, index]
    # Where all of them were unmeasured before, leaving them out explains nothing.
    seen = np.asarray(~without[list(rows)].all(axis=0))
    without[list(rows)] = True
    tried = try_rows(problem, fit, index, readings, without)
    p = tried.tests.p_pose
    for column, i in enumerate(index):
        if seen[column] and p[column] >= UNREMARKABLE:
            yield i, tried.corrections[:, column]

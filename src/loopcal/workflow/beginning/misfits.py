"""Corners and images that do not fit the others, which a project of images leaves out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError, NoTrustworthyResult
from loopcal.estimation.fit import Fit
from loopcal.estimation.problem.problem import build_problem
from loopcal.files.project.project_file import Project
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise
from loopcal.statistics.case import Case
from loopcal.statistics.pose_tests import Fitted, pose_tests, settle, tail
from loopcal.statistics.wrong_corners import LEVEL, wrong_corners
from loopcal.workflow.beginning.images_project import WRONG

MOST = 0.25
"""Where more of the images are doubtful, none is left out: robot, lens or board may be at fault."""
_WORST = 5
"""Images named."""


@dataclass(frozen=True, eq=False)
class LeftOut:
    """readings: those that do not fit the others, (N,) by name; words: on them, "" without any;
    explained: doubtful images that the calibration of the others explains."""

    readings: Mapping[str, NDArray[np.bool_]]
    words: str = ""
    explained: frozenset[str] = frozenset()


def left_out(project: Project, dataset: Dataset, doubtful: Sequence[str]) -> LeftOut:
    """The readings that do not fit the others.

    doubtful: images that are far off where all begin. They take no part in the fit that they are
    tested against, for one wrong pose of ten makes the learnt sds as large as itself.
    """
    noise = Noise(project.noise.noise().entries)
    doubtful = [pose for pose in doubtful if pose in dataset.poses]
    if len(doubtful) > MOST * len(dataset):
        doubtful = []
    rest = dataset.exclude(doubtful) if doubtful else dataset
    try:
        result = Case(project.mechanism, rest, noise, Fit(method="implicit-loop")).calibrated()
    except (InputError, NoTrustworthyResult):
        return LeftOut({})  # for the calibration to say
    wrong = wrong_corners(result)
    rest = rest.select(result.problem.poses)  # of poses that are copies the first counts
    names = result.problem.mechanism.tape.quantities
    marks = np.zeros((len(names), len(dataset)), dtype=bool)
    marks[:, np.isin(dataset.poses, rest.poses)] = wrong.single
    words = []
    if wrong.corners:
        images = [rest.poses[i] for i in np.flatnonzero(wrong.single.any(axis=0))]
        sds = ", ".join(f"{sd:.2g} px" for sd in wrong.sd.values())
        words.append(
            f"Left out {wrong.corners} of {wrong.count} corners, in {len(images)} of "
            f"{len(dataset)} images ({_first(images)}): they do not fit the others of their "
            f"images, whose sd is {sds}."
        )
    single = dict(zip(names, wrong.single, strict=True))
    gone = _misplaced(project, dataset, rest, single, doubtful)
    if gone:
        marks[:, np.isin(dataset.poses, gone)] = True
        several = len(gone) > 1
        words.append(
            f"Left out image{'s' * several} {_first(gone)}: {'they do' if several else 'it does'} "
            "not fit the others."
        )
    explained = frozenset(doubtful).difference(doubtful if gone is None else gone)
    if not words:
        return LeftOut({}, explained=explained)
    words.append(f"{WRONG} lists the corners.")
    return LeftOut(dict(zip(names, marks, strict=True)), " ".join(words), explained)


def _misplaced(
    project: Project,
    dataset: Dataset,
    rest: Dataset,
    single: Mapping[str, NDArray[np.bool_]],
    doubtful: Sequence[str],
) -> list[str] | None:
    """The doubtful images that the fit of the rest does not explain, by what their corners share.

    Where no robot says where they stood, by their corners. None without a fit of the rest. single:
    wrong corners of the rest.
    """
    if not doubtful:
        return []
    left = {q: np.where(bad, np.nan, rest[q]) for q, bad in single.items() if bad.any()}
    good, noise = replace(rest, readings={**rest.readings, **left}), project.noise.noise()
    try:
        result = Case(project.mechanism, good, noise, Fit(method="implicit-loop")).calibrated()
    except (InputError, NoTrustworthyResult):
        return None
    names, learnt = result.problem.mechanism.tape.quantities, result.problem.uncertainty.sd
    sds = {q: float(np.min(sd)) for q, sd in zip(names, learnt, strict=True)}
    problem = build_problem(
        result.problem.mechanism, dataset.select(doubtful), Noise(sds), whole=False
    )
    parameters = np.array([result.value[n] for n in problem.mechanism.parameters.names])
    closed = settle(problem, parameters, np.zeros_like(problem.readings))
    fit = Fitted(parameters, closed.corrections, result.spectrum.covariance(), 1.0)
    tests = pose_tests(problem, fit, np.zeros(len(doubtful), dtype=bool))
    robot = tests.sharing > 0
    t = np.where(robot, tests.shared, tests.t)
    freedom = np.where(robot, tests.sharing, tests.freedom)
    # the sds are those of the other images, each of which says more than one number of them
    p = tail(t, freedom, float(len(dataset) - len(doubtful)))
    far = closed.open | (p < LEVEL / len(dataset))
    return [pose for pose, out in zip(doubtful, far, strict=True) if out]


def _first(names: Sequence[str]) -> str:
    return ", ".join(names[:_WORST]) + (", ..." if len(names) > _WORST else "")

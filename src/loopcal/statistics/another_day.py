"""Poses of another day, read from a machine that is held as it was calibrated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.document.change_points import ChangePoint
from loopcal.estimation.dependence.dependence import joint_rows, pose_order
from loopcal.estimation.dependence.stated_poses import QUANTITIES
from loopcal.estimation.noise.learning import with_model
from loopcal.estimation.problem.constants import with_latest
from loopcal.estimation.problem.problem import Problem, build_problem, taken
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import MODEL, Noise
from loopcal.statistics.calibrated import Calibrated
from loopcal.statistics.day_noise import AS_STATED, DayNoise
from loopcal.statistics.innovation import Linearised, components_of
from loopcal.statistics.joint_errors import JointErrors
from loopcal.statistics.possible_changes import (
    ALONG_A_DAY,
    Possible,
    changed_share,
    possible,
    unit_of,
)
from loopcal.statistics.replacing import IN_PROPORTION, Replaced, freed, replaced
from loopcal.statistics.run_order import WAYS, delayed, told_by_joints


@dataclass(frozen=True, eq=False)
class Day:
    """The poses of another day, at a machine that is held but for what may stand elsewhere.

    problem: at the calibrated parameters, all of which count as estimated; freed: names of what
    is found anew; places: of these roughly, by images alone; moved: what changed along the run, by
    any size; drift: what may have drifted along it, by name, with its sd [SI]; joints: errors that
    their poses share; noise: of its readings, where they scatter more than stated.
    """

    calibrated: Calibrated
    problem: Problem
    freed: tuple[str, ...]
    places: Mapping[str, float] = field(default_factory=dict)
    moved: tuple[ChangePoint, ...] = ()
    drift: Mapping[str, float] = field(default_factory=dict)
    joints: JointErrors | None = None
    noise: DayNoise = AS_STATED

    @classmethod
    def of(
        cls,
        calibrated: Calibrated,
        data: Dataset,
        noise: Noise | None,
        remounted: bool | Sequence[str] = False,
    ) -> Day:
        """From the readings of that day; noise: theirs, else that of the calibration.

        An instrument without any readings stays where it was calibrated.

        remounted: as in `freed`. Raises InputError where readings or sds are missing, and for
        a name that is not there.
        """
        problem = day_problem(calibrated, data, noise)
        unread = _unread(problem)
        names = [n for n in freed(calibrated.mechanism, remounted) if n not in unread]
        places = {name: data.places[name] for name in names if name in data.places}
        return cls(calibrated, problem, tuple(names), places)

    @property
    def drifting(self) -> Day | None:
        """The day with a drift of its instruments, as `run_drift` has it, where the joints tell
        the order of the poses; None elsewhere."""
        from loopcal.statistics.run_drift import SDS, drifting  # loaded where it is used

        problem, mechanism = self.problem, self.problem.mechanism
        joints = problem.readings[joint_rows(problem)][:, pose_order(problem)].T
        if told_by_joints(joints) is None:
            return None
        units = {n: unit_of(problem, n) for n in drifting(mechanism)}
        return replace(self, drift={n: SDS[unit] for n, unit in units.items() if unit in SDS})

    def placed(self, changes: Mapping[str, float] = {}) -> Replaced:
        """With what stands elsewhere placed anew, after changes [SI] of parameters, of the zeros of
        readings and of readings in proportion, and after delays, by name."""
        problem, mechanism = self.problem, self.problem.mechanism
        names, order = mechanism.parameters.names, mechanism.tape.quantities
        start, readings = problem.start.copy(), problem.readings.copy()
        for name, change in changes.items():
            if name in WAYS:
                readings += delayed(problem, name, change).readings - problem.readings
            elif (stem := name.removesuffix(IN_PROPORTION)) != name:
                readings[order.index(stem)] *= 1.0 + change
            elif name in order:
                readings[order.index(name)] += change
            else:
                start[names.index(name)] += change
        changed = _with_values(replace(problem, readings=readings), start)
        components = components_of(self.calibrated, order)
        return replaced(
            changed,
            self.freed,
            self.places,
            residual=self.calibrated.residual,
            components=components,
        )

    def near(self, placement: Replaced) -> Day:
        """The day whose next searches may begin at this placement, where neither points nor images
        say what begins them."""
        families = self.problem.mechanism.families
        standing = {n for f in families if f.placement is None for n in f.standing}
        if self.places or standing.isdisjoint(self.freed):
            return self
        names = self.problem.mechanism.parameters.names
        values = dict(zip(names, placement.parameters.tolist(), strict=True))
        return replace(self, places={name: values[name] for name in self.freed})

    def linearised(self, changes: Mapping[str, float] = {}) -> Linearised:
        """The equations of the held machine where it is placed anew after these changes."""
        placement = self.placed(changes)
        drift = self._drift(placement) if self.drift else None
        made = Linearised.of(placement, self.calibrated, self._columns(placement), drift)
        made = made.unsurer(self.noise.freedom)
        return made if self.joints is None else self.joints.within(made)

    def noisier(self, noise: DayNoise) -> Day:
        """The day with readings that scatter so much more than stated."""
        return replace(self, problem=noise.within(self.problem), noise=noise)

    def _drift(self, placement: Replaced) -> NDArray[np.float64]:
        """(R, q) of what may have drifted, by one sd over the run."""
        columns = placement.columns([*self.drift]) * np.array([*self.drift.values()])
        return np.asarray(self.share_of_run(placement) * columns)

    def share_of_run(self, placement: Replaced) -> NDArray[np.float64]:
        """(R, 1) when each equation was measured, from -1/2 to 1/2."""
        number = np.empty(len(self.problem.poses))
        number[pose_order(self.problem)] = np.linspace(-0.5, 0.5, len(number))
        return np.asarray(number[placement.row_poses][:, None])

    def _columns(self, placement: Replaced) -> NDArray[np.float64] | None:
        """(R, q) of what changed along the run; None without any."""
        if not self.moved:
            return None
        number = np.empty(len(self.problem.poses))
        number[pose_order(self.problem)] = np.arange(1.0, len(number) + 1.0)
        row = number[placement.row_poses][:, None]
        causes = {one.titles: one for one in possible(self.problem, ALONG_A_DAY)}
        columns = []
        for point in self.moved:
            share = changed_share(row, point.number, point.until)
            # what is no cause by itself is several parts of a link at once
            cause = causes.get(point.names) or Possible("link", point.names)
            columns.append(share * cause.columns(placement.columns))
        return np.hstack(columns)

    def without(self, poses: NDArray[np.intp]) -> Day:
        """The day without the poses at these positions, before anything is seen to move."""
        kept = np.setdiff1d(np.arange(len(self.problem.poses)), poses)
        return replace(self, problem=taken(self.problem, kept))

    def as_drawn(self) -> Day:
        """The same poses at the machine as drawn."""
        return replace(self, problem=_with_values(self.problem, self.calibrated.nominal))


def _unread(problem: Problem) -> set[str]:
    """Where instruments stand that read nothing on this day."""
    loops = {problem.mechanism.tape.loops[i] for p in problem.patterns for i in p.loops}
    stands: dict[bool, set[str]] = {True: set(), False: set()}
    for family in problem.mechanism.families:
        stands[loops.isdisjoint(family.loops)] |= {*family.standing}
    return stands[True] - stands[False]


def _with_values(problem: Problem, values: NDArray[np.float64]) -> Problem:
    names = problem.mechanism.parameters.names
    mechanism = problem.mechanism.with_nominal(dict(zip(names, values.tolist(), strict=True)))
    return replace(problem, start=values, mechanism=mechanism)


def day_problem(calibrated: Calibrated, data: Dataset, noise: Noise | None) -> Problem:
    """The poses of another day at the calibrated parameters, all of which count as estimated.

    noise: of these readings, else that of the calibration.
    """
    mechanism = calibrated.mechanism
    data = with_latest(mechanism, data if noise else as_learnt(calibrated, data))
    weighed = None if calibrated.residual is not None else (noise or noise_of(calibrated, data))
    if weighed is not None:
        mechanism, data = with_model(mechanism, data, weighed)
    # Nothing is estimated by it: with informative priors any number of poses will do.
    free = mechanism.parameters.with_prior({"*": 1.0}).with_fixed(["*"], fixed=False)
    machine = mechanism.with_parameters(free)
    # a joint that moved in the fit has errors also on a day on which it stands still
    return build_problem(machine, data, weighed, whole=False)


def as_learnt(calibrated: Calibrated, data: Dataset) -> Dataset:
    """The readings without sds of their own where the calibration has learnt better ones."""
    learnt = {
        q for entry in calibrated.noise if entry.source == "estimated" for q in entry.quantities
    }
    return replace(data, sds={q: sd for q, sd in data.sds.items() if q not in learnt})


def noise_of(calibrated: Calibrated, data: Dataset | None = None) -> Noise:
    """The sds that a calibration used, for other readings; what had none was not measured.

    data: these readings. Where a robot states poses far from those of the fit, sds are larger.
    """
    entries: dict[str | tuple[str, ...], Any] = {}
    for entry in calibrated.noise:
        if entry.role == "disturbance":
            entries[MODEL] = entry.sd
            continue
        entries |= dict.fromkeys(entry.quantities, entry.sd)
    unknown = None if data is None else calibrated.unknown_share(data)
    if unknown is not None and calibrated.smooth_errors is not None:
        for q, variance in zip(QUANTITIES, calibrated.smooth_errors.variances, strict=True):
            entries[q] = np.sqrt(entries.get(q, 0.0) ** 2 + unknown * variance)
    disturbances = calibrated.mechanism.disturbances
    unmeasured = [q for q in calibrated.mechanism.quantities if q not in (*entries, *disturbances)]
    return Noise(entries | dict.fromkeys(unmeasured, np.inf))

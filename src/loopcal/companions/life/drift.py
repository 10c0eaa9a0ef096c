"""What may have changed on a machine since its calibration, as directions of its parameters.

A drift of an estimated parameter is a step of that parameter. Others are held, because estimated
ones do to every reading what they do, and some joints have no parameter for their zero. Such a
change is one of the machine all the same. It lies along the step v of the estimated parameters that
does the same to the readings,

    J v = c,   c the column of the held parameter, or of the zero of the joint's reading,

whichever of them the calibration held (`loopcal.mechanisms.redundancy.exchanged`). An sd q of the
change adds q^2 v v^T to the covariance of the machine. Of a large change v is taken in the middle
of its way, which bends.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.chi_squared import tail
from loopcal.errors import InputError, unknown_name
from loopcal.estimation.noise.search import Bounds, search
from loopcal.estimation.noise.term_scales import Sums, TermFit, evaluate, term_system
from loopcal.lazy import cached_property
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import MODEL, Noise
from loopcal.mechanisms.effects.drift import shift_sd
from loopcal.mechanisms.parameters import BEYOND, ROLES
from loopcal.mechanisms.redundancy import exchanged
from loopcal.mechanisms.structure.structured import driven_joints
from loopcal.mechanisms.terms import Term
from loopcal.statistics.another_day import Day, day_problem
from loopcal.statistics.calibrated import Calibrated
from loopcal.statistics.changed import CONDITIONAL, LEVEL, PLACED, Change
from loopcal.statistics.innovation import Linearised
from loopcal.statistics.possible_changes import EXPANSION, HEAVY, scale_of
from loopcal.statistics.predictive import unmeasured_corrections
from loopcal.statistics.replacing import IN_PROPORTION
from loopcal.statistics.verification import verified
from loopcal.statistics.verified import Verification

DRIFTING: tuple[str, ...] = tuple(
    role for role in ROLES if role not in ("placement", "model error")
)
"""Roles of parameters that may drift."""
# Chosen, not derived: three times as many equations as a large machine has parameters.
_LOOKED_AT = 300
"""Poses that show which parameters do the same, of machines that stand in no other ones."""
# Chosen, not derived: to follow a change that did not happen costs more than to average over one
# that the poses hardly show. `analyses.followed` counts both.
_SURE = 1e-3
"""p-value of a change, adjusted for the search, below which an update follows it in any case."""
# Chosen, not derived: a prior of so many times a change shrinks its estimate by 1 %.
_ALLOWED = 10.0
"""Sd that a change gets which the check found, over its size."""
_PLACES = ("placement", "mounting")
_TOOLS = "the scale of what is mounted"
"""Estimated apart: a tool may be as warm as the machine or not, and the scale of another instrument
changes both alike."""


_WARM = " It holds at the temperature of these poses, and with the scale of their instrument."


@dataclass(frozen=True)
class Since:
    """What may have changed since a calibration, as `update` takes it."""

    moved: bool = True
    remounted: bool | Sequence[str] = False
    drift: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Allowance:
    """What an update allows to have changed.

    drift: (n_all, k) steps [SI] of one sd of each independent change; check: whether the readings
    are of the calibrated machine after it; words: a remark on each change that the check found and
    the update follows; grown: (2, n_all) of a scale that is followed (`Drifting.grown`); scale: its
    change and the sd of that, where the check named it; moved: by how much these are elsewhere
    [SI], where they explain the readings.
    """

    drift: Array
    check: Verification
    words: tuple[str, ...] = ()
    grown: Array | None = None
    scale: tuple[float, float] | None = None
    moved: Mapping[str, float] = field(default_factory=dict)

    @property
    def consistent(self) -> bool:
        """Whether no test says that the readings are of another machine."""
        return self.check.verdict["consistent"].passed is not False

    @property
    def explained(self) -> bool:
        """Whether the readings as a whole are of the machine, but for changes hardly seen."""
        changes, p_value = self.check.changes, self.check.innovation.p_value
        sizes = () if changes is None else changes.found
        unsure = all(change.p_value >= _SURE for change in sizes)
        return self.consistent or (unsure and p_value is not None and p_value >= LEVEL)


def allowed(calibrated: Calibrated, data: Dataset, since: Since, noise: Noise | None) -> Allowance:
    """The stated drift, and the changes that a check finds where these explain the readings.

    A role allows every parameter of it. Where the check says which of them changed, it is these
    alone: to estimate all at once would cost the others their accuracy.
    """
    drifting = Drifting(calibrated, data, noise)

    def checked(drift: Array, moved: Mapping[str, float] = {}) -> Allowance:
        """Where these have moved: no line from where the calibration was reaches a large change."""
        machine, readings = drifting.after(moved)
        drifted = machine.drifted(drift)
        return Allowance(drift, verified(drifted, readings, noise, since.remounted))

    def followed(allowance: Allowance, within: Container[str] | None = None) -> Allowance:
        """With the changes that its check found; itself where they are none, or not all within."""
        check = allowance.check
        named = () if check.changes is None else check.changes.found
        sure = [change for change in named if change.p_value < _SURE]
        # One that the poses hardly show is followed where zeros of joints explain it.
        changes = sure or [change for change in named if change.zeros]
        every_move = {} if check.changes is None else check.changes.moved
        sds = drifting.followed(changes, every_move)
        if allowance.consistent or not sds or not all(within is None or n in within for n in sds):
            return allowance
        moved = _of_parameters(every_move) if len(changes) == len(named) else {}
        columns = drifting.halfway(moved).columns(sds)
        wider = checked(np.hstack([allowance.drift, columns]), moved)
        words = tuple(followed_words(change, sds) for change in changes)
        scale = next(((c.value, c.sd) for c in changes if c.name == EXPANSION), None)
        wider = replace(wider, words=words, grown=drifting.grown(sds), scale=scale, moved=moved)
        return wider if wider.explained else allowance

    every = checked(drifting.columns(drifting.stated(since.drift)))
    roles = {key: sd for key, sd in since.drift.items() if key in DRIFTING}
    if roles:
        by_name = {key: sd for key, sd in since.drift.items() if key not in roles}
        narrow = checked(drifting.columns(drifting.stated(by_name)))
        narrow = followed(narrow, drifting.stated(roles))
        if narrow.words and (narrow.consistent or every.consistent):
            # Whether two machines are mixed is asked of all that was allowed.
            return narrow if narrow.consistent else replace(narrow, check=every.check)
    return followed(every)


def _of_parameters(moved: Mapping[str, float]) -> dict[str, float]:
    """With scales of slides in place of what they read in proportion."""
    stems = {name: name.removesuffix(IN_PROPORTION) for name in moved}
    return {n if stems[n] == n else f"{stems[n]}_scale": by for n, by in moved.items()}


@dataclass(frozen=True, eq=False)
class Drifting:
    """The changes that the parameters of a calibration can follow.

    data, noise: readings of another day and their sds, for a machine whose earlier poses are not
    there.
    """

    calibrated: Calibrated
    data: Dataset
    noise: Noise | None

    def after(self, moved: Mapping[str, float]) -> tuple[Calibrated, Dataset]:
        """The machine and the readings after changes [SI] of parameters and zeros of readings."""
        mechanism, data = self.calibrated.mechanism, self.data
        values = {
            p.name: p.nominal + moved[p.name] for p in mechanism.parameters if p.name in moved
        }
        read = {q: data.readings[q] + by for q, by in moved.items() if q in data.readings}
        made = replace(self.calibrated, mechanism=mechanism.with_nominal(values))
        return made, data.with_readings(read)

    def halfway(self, moved: Mapping[str, float]) -> Drifting:
        """The same where half of these changes [SI] has happened: the way to all of them has the
        direction that it has in its middle, but for third powers."""
        mechanism, way = self.calibrated.mechanism, np.zeros(len(self.calibrated.nominal))
        for name, by in moved.items():
            way += 0.5 * by * self._steps.get(self._zeros.get(name, name), 0.0 * way)
        values = {p.name: p.nominal + at for p, at in zip(mechanism.parameters, way, strict=True)}
        made = replace(self.calibrated, mechanism=mechanism.with_nominal(values))
        return replace(self, calibrated=made)

    def stated(self, drift: Mapping[str, float]) -> dict[str, float]:
        """Sds [SI] by parameter, and by joint without an estimated zero.

        drift: sds [SI] by role, parameter or joint. Raises InputError for a key that is none of
        these, a negative sd, and a drift that no estimated parameter follows.
        """
        sds: dict[str, float] = {}
        for key, sd in drift.items():
            if not sd >= 0.0:
                raise InputError(
                    f"the drift of {key!r} is {sd!r}",
                    code="invalid-value",
                    remedy="give an sd above zero, or leave it out",
                )
            named = [name for name in self._named(key) if name in self._steps]
            if sd > 0.0 and not named:
                raise _held(key)
            sds |= dict.fromkeys(named, sd)
        return sds

    def followed(self, changes: Sequence[Change], moved: Mapping[str, float]) -> dict[str, float]:
        """The same of changes that a check found; empty where one of them cannot be followed.

        moved: what all of them move [SI].
        """
        mechanism, sds = self.calibrated.mechanism, dict[str, float]()
        for change in changes:
            if change.kind in PLACED:
                sds |= self._placed(moved)
                if sds and not change.parts:
                    continue
            if change.kind == "expansion" and _TOOLS in self._steps:
                sds[_TOOLS] = abs(change.value)
            if "load" in change.kinds:
                sds |= self._loaded
            for cause in causes_of(change, self._steps):
                other = cause != change.name and cause not in change.parts
                unit = mechanism.quantities.get(cause, "1")
                size = shift_sd(unit) if other else abs(change.value)
                sds[self._zeros.get(cause, cause)] = _ALLOWED * size
        return sds if sds.keys() <= self._steps.keys() else {}

    @property
    def _loaded(self) -> dict[str, float]:
        """The same of what another load changes."""
        mechanism, prior_sd = self.calibrated.mechanism, self.calibrated.prior_sd
        sds = dict[str, float]()
        for name in () if mechanism.structure is None else mechanism.structure.loaded:
            learnt = HEAVY * float(prior_sd[mechanism.parameters.names.index(name)])
            usual = _ALLOWED * shift_sd(mechanism.parameters[name].unit)
            sds[name] = learnt if math.isfinite(learnt) else usual
        return sds

    def _placed(self, moved: Mapping[str, float]) -> dict[str, float]:
        """Sds [SI] of all places that moved: what was shifted was turned as well, and several
        things may move as one."""
        parameters, sds = self.calibrated.mechanism.parameters, dict[str, float]()
        for unit in ("m", "rad"):
            places = {p.name for p in parameters if p.role in _PLACES and p.unit == unit}
            sizes = {name: by for name, by in moved.items() if name in places}
            sds |= dict.fromkeys(sizes, _ALLOWED * float(np.linalg.norm([*sizes.values()])))
        return sds

    def columns(self, sds: Mapping[str, float]) -> Array:
        """(n_all, k) steps [SI] of one sd of each of these changes."""
        size = len(self.calibrated.mechanism.parameters)
        columns = [sd * self._steps[name] for name, sd in sds.items() if sd > 0.0]
        return np.array(columns).reshape(-1, size).T

    def grown(self, followed: Container[str]) -> Array | None:
        """(2, n_all) what a scale changes, per unit, where it is followed: that of the machine, and
        of the machine and what is mounted, as another scale of the instrument does."""
        if EXPANSION not in followed:
            return None
        machine = self._steps[EXPANSION]
        return np.array([machine, machine + self._steps.get(_TOOLS, 0.0)])

    @property
    def zeros(self) -> dict[str, Array]:
        """(n_all,) what the zero of each joint without an estimated one changes, per unit."""
        steps = self._steps
        return {q: steps[q] for q, name in self._zeros.items() if name == q and q in steps}

    def _named(self, key: str) -> list[str]:
        """The parameters, and the joints without an estimated zero, that a key stands for."""
        parameters, zeros = self.calibrated.mechanism.parameters, self._zeros
        if key in parameters.names or key in zeros:
            return [zeros.get(key, key)]
        if key not in DRIFTING:
            raise unknown_name(
                f"there is no parameter and no role of parameters {key!r}",
                key,
                (*DRIFTING, *parameters.names, *zeros),
            )
        alike = [p for p in parameters if key in (p.role, p.dimension)]
        if key != "zero":
            return [p.name for p in alike]
        # The zero of a joint is one change, however many parameters say it.
        return [*zeros.values(), *(p.name for p in alike if p.owner not in zeros)]

    @cached_property
    def _zeros(self) -> Mapping[str, str]:
        """Of each driven joint its estimated zero; the joint itself where it has none, or where
        others follow it, whose zeros move as well."""
        mechanism = self.calibrated.mechanism
        zeros = {p.owner: p.name for p in mechanism.parameters if p.role == "zero" and not p.fixed}
        moved = Counter(step.joint for step in mechanism.tree.steps) if mechanism.tree else {}
        zeros = {joint: name for joint, name in zeros.items() if moved.get(joint, 1) == 1}
        return {joint: zeros.get(joint, joint) for joint in driven_joints(mechanism)}

    @cached_property
    def _steps(self) -> Mapping[str, Array]:
        """(n_all,) of unit changes of parameters, of zeros of joints, and of the scale of the
        machine, by name; without those that the estimated parameters cannot follow."""
        mechanism = self.calibrated.mechanism
        parameters, unit = mechanism.parameters, np.eye(len(mechanism.parameters))
        every = dict(zip(parameters.names, unit, strict=True))
        steps = {name: every[name] for name in parameters.free}
        # A learnt model error says how the machine gives way, not where its zeros are.
        among = [name for name in parameters.free if parameters[name].role not in BEYOND]
        held = [name for name in (*parameters.names, *self._zeros.values()) if name not in steps]
        if among and held:
            of_others = exchanged(
                mechanism, held, among, readings=self._readings, unmeasured=self._unmeasured
            )
            basis = np.array([every[name] for name in among])
            steps |= {name: step @ basis for name, step in of_others.items()}
        lengths = [p for p in parameters if p.dimension == "length" and p.name in steps]
        tools = [p for p in parameters if (p.role, p.unit) == ("mounting", "m")]
        # Slides whose scale grows with the machine are read, not estimated.
        slides = [joint for joint in self._zeros if mechanism.quantities[joint] == "m"]
        learnt = {scale_of(joint): f"{joint}_scale" for joint in slides}
        steps |= {one: steps[name] for one, name in learnt.items() if name in steps}
        for name, grown in {EXPANSION: [] if slides else lengths, _TOOLS: tools}.items():
            if grown and steps.keys() >= {p.name for p in grown}:
                steps[name] = np.sum([p.nominal * steps[p.name] for p in grown], axis=0)
        return steps

    @cached_property
    def _unmeasured(self) -> list[str]:
        problem = day_problem(self.calibrated, self.data, self.noise)
        unread = np.flatnonzero(np.isinf(problem.uncertainty.sd).all(axis=1))
        return [problem.mechanism.tape.quantities[i] for i in unread.tolist()]

    @property
    def _readings(self) -> dict[str, Array] | None:
        """Of poses in which the loops close; None for an arm, whose joints move freely."""
        mechanism = self.calibrated.mechanism
        if mechanism.joints:
            return None
        poses = self.calibrated.poses or self.data
        some = np.unique(np.linspace(0, len(poses) - 1, _LOOKED_AT).astype(int))
        # Any sds do: they only say which quantities the loops have to find.
        sds = {"*": 1.0} | ({MODEL: 1.0} if mechanism.disturbances else {})
        noise = Noise(sds | dict.fromkeys(self._unmeasured, np.inf))
        problem = day_problem(self.calibrated, poses.take(some), noise)
        tape, x = problem.mechanism.tape, problem.readings
        x = x + unmeasured_corrections(problem, problem.start)
        names = (*tape.quantities, *tape.pose_constants)
        return dict(zip(names, (*x, *problem.pose_constants), strict=True))


def causes_of(change: Change, able: Container[str]) -> tuple[str, ...]:
    """What an update estimates of a change, but for a load: joints whose zero explains it, else
    what was named, and growth where that explains it as well.

    A joint's zero moves more easily than its other parameters change. able: what the parameters can
    follow; growth beside zeros is left out where they cannot.
    """
    grows = "expansion" in change.kinds and (EXPANSION in able or not change.zeros)
    grown = (EXPANSION,) if grows else ()
    named = () if change.kind in CONDITIONAL else (*change.parts, *change.hidden) or (change.name,)
    return (*(change.zeros or named), *grown)


def followed_words(change: Change, followed: Container[str]) -> str:
    """That an update follows this change, in two sentences; followed: what it estimates anew."""
    causes = causes_of(change, followed)
    joints = " and ".join(name for name in causes if name in change.zeros)
    every = [] if change.kind in CONDITIONAL else [change.name]
    every = [f"the zero of {joints}"] if joints else every
    every += ["the load"] if "load" in change.kinds else []
    every += [EXPANSION] if EXPANSION in causes else []
    what = " and ".join(every)
    others = [one for one in every if one not in (change.name, change.where)]
    other = f", or {' or '.join(others)} did" if others else ""
    warm = _WARM if EXPANSION in causes else ""
    return f"Since the calibration, {change.words}{other}. The update estimates {what} anew.{warm}"


def _held(key: str) -> InputError:
    """Of a drift that no estimated parameter can follow."""
    what = f"the parameter {key!r} is"
    if key in DRIFTING:
        what = f"all parameters of the role {key!r} are"
    return InputError(
        f"{what} fixed in the calibration, so the update cannot follow its drift",
        code="no-free-parameter",
        remedy="free it in the mechanism file (fixed = false) and calibrate anew",
    )


# What changed on a whole machine since its calibration, as random steps of learnt sizes.
#
# Warmth, another load or wear change many parameters by a little. No parameter alone says so, and
# what an update then keeps of the calibration is less certain than its covariance says. With what
# the placement takes up removed from the whitened misclosures e of the new poses,
#
#     e ~ N(0, phi + A A^T + sum_g s_g^2 B_g B_g^T),
#
# A the machine's covariance as these poses see it, B_g the columns of the parameters of group g,
# each times a unit step. The groups are the lengths, the angles and what lies beyond geometry,
# whose steps are their prior sds. The scales s_g are learnt as those of the terms of a calibration
# are (`estimation.noise.term_scales`), without a prior; phi >= 1 is by how much more the readings
# of that day scatter than stated.


CONDITIONS = (
    "These poses differ from the calibration as if the conditions had changed, such as warmth or a "
    "load. The update lets the whole machine drift by as much as they show."
)
_STEPS = {"length": 1e-3, "angle": 1e-3}
"""Unit steps [SI] by dimension: the usual errors of machining, so that scales are near 1."""
_ANY = 1e6
"""Sd of the logarithm of a scale of which nothing is known."""
_NONE = 1e-4
"""A scale in unit steps: so little is no change."""
_BEGINS = (1e-2, 1e-1)
"""Scales at which a search begins, for there may be more than one end."""
# Chosen, not derived, and uncritical: with a drift in every case the true errors of updates after
# no change, a zero, a bend and warmth (six machines drawn anew) change by 1 % at most on average.
_UNLIKELY = 0.05
"""p-value of an unchanged machine below which it drifts."""
# A factor of e in the sd: chosen, not derived.
_FARTHEST = 2.0
"""No logarithm of a variance changes by more in one step."""


def drift_of_conditions(day: Day) -> Array:
    """(n_all, k) steps [SI] of one sd of each parameter; none where the readings show no drift.

    day: at a calibration whose covariance has the drift that is stated.
    """
    linear = day.linearised()
    J = linear.placement.J / np.sqrt(linear.factor)
    groups = [np.diag(steps)[:, steps > 0.0] for steps in _steps(day, linear.placement.anew)]
    none = np.zeros((J.shape[1], 0))
    freedom = len(linear.e) - linear.rank
    if not groups or freedom <= len(groups) + 1:
        return none
    scales = _scales(linear, [J @ steps for steps in groups])
    scaled = zip(scales.tolist(), groups, strict=True)
    return np.hstack([none, *(scale * steps for scale, steps in scaled if scale > 0.0)])


def _scales(linear: Linearised, groups: Sequence[Array]) -> Array:
    """(g,) of the groups of columns; zeros where the readings show none of them."""
    g, parts = len(groups), [linear.F, linear.A, *groups]
    rows = np.hstack([*parts, linear.e[:, None]])
    sums = Sums(np.asarray(np.linalg.qr(rows, mode="r")), True, len(rows))
    sizes = [part.shape[1] for part in parts]
    prior_sd = np.repeat([np.inf, *np.ones(g + 1)], sizes)
    owner = np.repeat(np.arange(-2, g).clip(-1), sizes)
    terms = [Term(f"group {i}", (f"group {i}",), 1.0, _ANY) for i in range(g)]
    system = term_system(sums, prior_sd, np.zeros(len(owner)), owner, terms)

    def least(begin: float, *, changed: bool) -> TermFit:
        x = np.append(0.0, np.full(g, 2.0 * np.log(begin)))
        lowest = np.append(0.0, np.full(g, 2.0 * np.log(_NONE)))
        free = np.append(True, np.full(g, changed))
        likelihood = partial(evaluate, system)
        return search(likelihood, evaluate(system, x), Bounds(lowest, free, _FARTHEST)).at

    still = least(_NONE, changed=False)
    best = min((least(begin, changed=True) for begin in _BEGINS), key=lambda at: at.criterion)
    # Unchanged, a scale ends at zero in half of the draws (Self and Liang 1987).
    gain = max(float(still.criterion - best.criterion), 0.0)
    by_chance = [math.comb(g, k) * (tail(gain, k) if k else gain <= 0.0) for k in range(g + 1)]
    if sum(by_chance) > _UNLIKELY * 2.0**g:
        return np.zeros(g)
    return np.where(best.scales > 10.0 * _NONE, best.scales, 0.0)


def _steps(day: Day, anew: NDArray[np.bool_]) -> list[Array]:
    """(n_all,) unit steps of each group, 0 of all other parameters."""
    calibrated = day.calibrated
    held = calibrated.estimated & ~anew
    parameters, groups = list(calibrated.mechanism.parameters), []
    for dimension, step in _STEPS.items():
        groups.append(held * [step * (p.dimension == dimension) for p in parameters])
    beyond = held & np.array([p.role in BEYOND for p in parameters])
    # Without a prior sd nothing says how large its changes may be.
    groups.append(np.where(beyond & np.isfinite(calibrated.prior_sd), calibrated.prior_sd, 0.0))
    return [group for group in groups if group.any()]

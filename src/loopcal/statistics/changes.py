"""What happened during a run, modelled before methods compete: slips, and poses that do not fit.

A reflector that slipped bends every machine that is fitted to all poses alike. Change points that
are certain become effects, and gross outliers are discarded, whether anything slipped or not. Only
a fit with a structured model error is trusted to tell: under a plain fit the error of the machine
model itself changes from region to region, and looks the same. Images have no such fit; theirs with
all sensors uncertain has to do, and a change in an order that the joints show is none
(`ChangePoint.imitated`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from loopcal.document.change_points import ChangePoint, ChangePoints, Shifts, when
from loopcal.document.findings import Outlier
from loopcal.errors import InputError, NoTrustworthyResult
from loopcal.estimation.fit import Fit, modelled
from loopcal.estimation.problem.problem import Weighting
from loopcal.estimation.result import FitResult
from loopcal.execution.executor import InProcess, in_order
from loopcal.execution.forked import process_cores
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.effects.effect import with_effects
from loopcal.mechanisms.mechanism import PIXELS, Mechanism
from loopcal.mechanisms.station import standing
from loopcal.statistics.case import Begin, Case
from loopcal.statistics.change_points import apart, find_shifts
from loopcal.statistics.outlier_search import MOST
from loopcal.statistics.outliers import find_poses, misfits

if TYPE_CHECKING:
    from loopcal.mechanisms.effects.drift import Drift, Shift


# CERTAIN and MOST_OUTLIERS: record 0051.
CERTAIN = 1e-6
"""Changes of so small a p-value, corrected for the search, are modelled; such poses discarded."""
# Chosen, not derived: each further search costs a fit.
ROUNDS = 2
"""Searches: the second on the fit with what the first found."""
MOST_OUTLIERS = 0.1
"""Where more of the poses, and more than one, do not fit, the model may be at fault, or the sds:
they are discarded only where they are gross (`_without_gross`)."""
# Chosen, not derived: a distance is certain (CERTAIN, three coordinates) from 4 times its mean on,
# and the search costs as much as a fit where poses are many.
GROSS, FEW = 4.0, 60
"""Of fewer poses outliers are always sought, of more where one is as many times the mean off. More
outliers than `MOST_OUTLIERS` are gross where the others are so many times nearer without them."""
NUMBER = "pose_of_calibration"
"""The known constant that dates the changes: no file has it, so predictions hold after the last."""


@dataclass(frozen=True, eq=False)
class Changes:
    """A case with what happened during its run.

    case: with effects for the changes, without the outliers; kept: positions of its poses in the
    case as asked for; plain: that case without the effects; points: what was modelled; outliers:
    what was discarded; searched: the last search; toml: the lines that state the changes; whole:
    the fit of the case, of the candidate `by`; made: its machine with the model error, None where
    nothing happened.
    """

    case: Case
    plain: Case
    kept: NDArray[np.intp]
    points: tuple[ChangePoint, ...] = ()
    outliers: Mapping[str, Outlier] = field(default_factory=dict)
    searched: Shifts | None = None
    toml: str = ""
    whole: FitResult | None = None
    by: str = ""
    made: Mechanism | None = None

    @property
    def moved(self) -> tuple[str, ...]:
        """The parameters of the effects."""
        before = self.plain.mechanism.parameters.names
        return tuple(n for n in self.case.mechanism.parameters.names if n not in before)

    @property
    def happened(self) -> bool:
        """Whether the case is another one than was asked for."""
        return bool(self.points or self.outliers)

    def words(self) -> str:
        """For the sentence on the choice."""
        words = ""
        if self.points:
            words += f"; changes modelled {when(self.points)}"
        if self.outliers:
            words += f"; without the outlier{'s' if len(self.outliers) > 1 else ''} "
            words += ", ".join(self.outliers)
        return words

    def entry(self, mechanism: Mechanism) -> ChangePoints | None:
        """The changes that were modelled, as a document holds them; None without any.

        mechanism: of the result; one without model error does not model another load.
        """
        if self.searched is None or not self.points:
            return None
        points = tuple(
            replace(p, modelled=not (mechanism.awaiting and p.moved == "load")) for p in self.points
        )
        return ChangePoints(points, self.searched.level, self.searched.tested, self.toml)

    @property
    def discarded(self) -> tuple[Outlier, ...]:
        """The outliers that were left out."""
        return tuple(self.outliers.values())


def unchanged(case: Case) -> Changes:
    """A case in which nothing happened."""
    return Changes(case, case, np.arange(len(case.data)))


def changes(
    case: Case,
    way: Fit,
    whole: FitResult,
    level: float = CERTAIN,
    happened: Callable[[], None] = lambda: None,
) -> Changes:
    """What happened during the run of a case, beyond doubt or with p-values below a level.

    way: how a structured candidate is fitted; whole: that fit of all poses; happened: called as
    soon as it is certain that something did. Where the machine cannot have such effects, or is not
    fitted better by them, nothing.
    """
    run_changes, way = replace(unchanged(case), whole=whole), way.changed(prior=case.fit.prior)
    rounds = ROUNDS
    while rounds:
        rounds -= 1
        before = run_changes.happened
        if (less := _without_gross(case, way, run_changes)) is not None:
            run_changes, whole = less
        searched = find_shifts(whole)
        run_changes = replace(run_changes, searched=searched)
        new = [p for p in searched.told_apart if p.p_value < level and apart(p, run_changes.points)]
        if not new and (before or not _may_hold_outliers(whole)):
            break
        # Before what slipped is modelled, a slip looks like a drift of the same things.
        slipped = {p.names for p in new if p.until is None}
        kept = tuple(p for p in run_changes.points if p.until is None or p.names not in slipped)
        if len(kept) < len(run_changes.points):
            rounds, run_changes = rounds + 1, replace(run_changes, points=kept)
        try:
            full = case
            if new:
                full, run_changes = _modelled(case, way, run_changes, new)
            if run_changes.happened:
                happened()
            run_changes = _without_outliers(case, full, way, run_changes)
        except (InputError, NoTrustworthyResult):
            break
        if not run_changes.happened:
            break
        assert run_changes.whole is not None
        whole = run_changes.whole
    return run_changes


def _modelled(
    case: Case, way: Fit, run_changes: Changes, new: Sequence[ChangePoint]
) -> tuple[Case, Changes]:
    """All poses with further changes; those that were kept, and their fit."""
    number = {pose: i + 1 for i, pose in enumerate(case.data.poses)}
    points = (
        replace(
            p,
            modelled=True,
            number=number[p.pose],
            until=None if p.until is None else number[p.after],
        )
        for p in new
    )
    modelled_points = tuple(sorted((*run_changes.points, *points), key=lambda point: point.number))
    made = with_shifts(case.mechanism, case.data, modelled_points, column=NUMBER)
    full = replace(case, mechanism=made.mechanism, data=made.data)
    fitted = replace(
        _kept(case, full, run_changes.kept),
        points=modelled_points,
        outliers=run_changes.outliers,
        searched=run_changes.searched,
        toml=shift_lines(case.data, modelled_points),
    )
    return full, _fitted(way, fitted)


def _without_outliers(case: Case, full: Case, way: Fit, run_changes: Changes) -> Changes:
    """Without the poses that certainly do not fit, and fitted anew, where these are few.

    full: all poses of the case, with the changes. Where a fit takes the joints as exact, the noise
    of a coarse one makes outliers: a fit with all sensors uncertain must name them as well.
    """
    outliers, whole = dict(run_changes.outliers), run_changes.whole
    assert whole is not None
    gross = len(outliers) > MOST_OUTLIERS * len(case.data)
    most = max((MOST if gross else MOST_OUTLIERS) * len(case.data), 1)

    def sought(_: None, carefully: bool) -> Any:
        return _named_carefully(case, way, run_changes) if carefully else _certain(whole)

    # before anything is certain the other cores fit other candidates
    cores = process_cores() if run_changes.happened else InProcess()
    with closing(cores.run(sought, None, [False, True][: 1 + way.method.exact])) as outcomes:
        both = in_order(outcomes)
        bad = next(both)
        if not bad or len(bad) + len(outliers) > most:
            return run_changes
        named = next(both, None)
    bad = {pose: one for pose, one in bad.items() if named is None or pose in named}
    if not bad:
        return run_changes
    kept = [i for i in run_changes.kept if case.data.poses[i] not in bad]
    part = _kept(case, full, np.array(kept, dtype=np.intp))
    less = replace(run_changes, case=part.case, plain=part.plain, kept=part.kept)
    return _fitted(way, replace(less, outliers=outliers | bad), whole)


def _without_gross(case: Case, way: Fit, run_changes: Changes) -> tuple[Changes, FitResult] | None:
    """Without gross errors that are more than a tenth of the poses, before the run is searched: a
    fit that they bend shows nothing of it. None where there are none.

    Errors of the model or sds that are too small do not leave a fit that is so much better, and
    what moved along the run errs in poses that follow each other.
    """
    whole, count = run_changes.whole, len(case.data)
    if whole is None or run_changes.happened:
        return None
    # Of 12 to 25 % of gross errors 6 to 13 % show so in the fit that they bend (record 0163).
    off = _far_off(whole)
    if off.sum() < 0.5 * MOST_OUTLIERS * count or _follow_each_other(off):
        return None
    bad = _certain(whole)
    gone = np.array([pose in bad for pose in case.data.poses])
    if not MOST_OUTLIERS * count < gone.sum() <= MOST * count or _follow_each_other(gone):
        return None
    part = _kept(case, case, np.flatnonzero(~gone))
    try:
        less = _fitted(way, replace(part, outliers=bad))
    except (InputError, NoTrustworthyResult):
        return None
    assert less.whole is not None
    before, after = whole.accuracy_after, less.whole.accuracy_after
    gross = before is not None and after is not None and before.rms > GROSS * after.rms
    return (less, less.whole) if gross else None


def _far_off(whole: FitResult) -> NDArray[np.bool_]:
    """(N,) the poses that are many times the median off; none of images."""
    off = np.zeros(len(whole.problem.poses), dtype=bool)
    if any(family.form == PIXELS for family in whole.mechanism.families):
        return off
    for one in whole.deviations(whole.differences_after):
        for d in (one.position, one.angle):
            if d is not None and np.isfinite(d).any():
                off |= np.nan_to_num(d) > GROSS * np.nanmedian(d)
    return off


def _follow_each_other(bad: NDArray[np.bool_]) -> bool:
    """Whether bad poses stand in less than half of the runs that chance would put them in.

    m of n poses in random order make m (n - m + 1) / n runs (Wald and Wolfowitz 1940).
    """
    n, m = len(bad), int(bad.sum())
    runs = int(bad[0]) + int((bad[1:] > bad[:-1]).sum())
    return runs < 0.5 * m * (n - m + 1) / n


def _certain(whole: FitResult) -> dict[str, Outlier]:
    """The poses that certainly do not fit, by id."""
    tests = find_poses(whole)
    return {one.pose: one for one in tests.found if one.p_value * tests.tested < CERTAIN}


def _named_carefully(case: Case, way: Fit, run_changes: Changes) -> set[str] | None:
    """The poses that do not fit where all sensors are uncertain; None without such a fit."""
    methods = case.fit.among(case.data, case.noise)
    able = (m for m in methods if not m.exact and m.weighting is not Weighting.READ)
    if (method := next(able, None)) is None:
        return None
    try:
        judged = _fitted(way.changed(method=method), run_changes, run_changes.whole).whole
    except (InputError, NoTrustworthyResult):
        return None
    assert judged is not None
    return misfits(judged)


def _fitted(way: Fit, run_changes: Changes, before: FitResult | None = None) -> Changes:
    """With the fit of the case by a structured candidate, begun where one before it ended."""
    case = run_changes.case
    machine = run_changes.made or modelled(way, way.with_prior(case.mechanism), case.data)
    begin = None if before is None else Begin.of(before, machine)
    # The machine has the prior already.
    fit = way.changed(prior=None)
    whole = replace(case, mechanism=machine, fit=fit, begin=begin).calibrated()
    if not whole.status.converged:
        raise NoTrustworthyResult("the fit with the changes did not converge", code="not-converged")
    return replace(run_changes, whole=whole, made=machine)


def _may_hold_outliers(whole: FitResult) -> bool:
    """Whether some pose is so far off that the search for outliers is worth its cost.

    Corners of images have a search of their own, before the fit.
    """
    if any(family.form == PIXELS for family in whole.mechanism.families):
        return False
    after = whole.accuracy_after
    if after is None:
        return False
    kinds = [after, *filter(None, [after.orientation])]
    return after.poses < FEW or any(one.max > GROSS * one.mean for one in kinds)


def _kept(case: Case, full: Case, kept: NDArray[np.intp]) -> Changes:
    """The poses at these positions, with the effects and without."""
    gone = np.setdiff1d(np.arange(len(case.data)), kept)
    return Changes(full.discarding(gone), case.discarding(gone), kept)


# A calibration with what moved as effects: mechanism, readings, and the lines of a project.

COLUMN = "pose"


@dataclass(frozen=True)
class Shifted:
    """mechanism: with an effect for each thing that moved; data: with the known constant that they
    need; toml: the lines that say so in a project or mechanism file."""

    mechanism: Mechanism
    data: Dataset
    toml: str


def with_shifts(
    mechanism: Mechanism, data: Dataset, found: Sequence[ChangePoint], *, column: str = COLUMN
) -> Shifted:
    """The mechanism and data with these change points as effects `shift` and `drift`.

    An arm of transitions gets a station where a change moves its instrument.
    Their known constant `column` is the number of the pose: its id where ids are rising numbers,
    else its position from 1. The lines call it `pose`. Raises InputError where the mechanism cannot
    have such an effect.
    """
    effects = _effects(data, found, column)
    if not effects:
        return Shifted(mechanism, data, "")
    if column not in mechanism.pose_constants:
        data = data.with_readings({column: pose_numbers(data)}, units={column: "1"})
    mechanism = standing(mechanism, [name for effect in effects for name in effect.changing])
    return Shifted(with_effects(mechanism, effects), data, shift_lines(data, found))


def shift_lines(data: Dataset, points: Sequence[ChangePoint]) -> str:
    """The lines of a project or mechanism file that model these changes."""
    tables = ["\n".join(_table(effect)) for effect in _effects(data, points, COLUMN)]
    return "\n\n".join(tables) + "\n" if tables else ""


def _effects(data: Dataset, points: Sequence[ChangePoint], column: str) -> list[Shift | Drift]:
    if not points:
        return []
    from loopcal.mechanisms.effects.drift import Drift, Shift

    numbers = pose_numbers(data)
    first = {pose: float(number) for pose, number in zip(data.poses, numbers, strict=True)}
    effects: list[Shift | Drift] = []
    steps = [p for p in points if p.shape == "step"]
    for names, title in dict.fromkeys((p.changing, p.effect) for p in steps):
        at = tuple(sorted({first[p.pose] for p in steps if p.changing == names}))
        effects.append(Shift(names, at, column, name=title))
    for p in {p.names: p for p in points if p.shape == "ramp"}.values():
        since, until = first[p.pose], first[p.after]
        # Ending with the run, so that predictions hold for its end (docs/explanation/drift.md).
        span = until - since
        effects.append(Drift(p.changing, column, "1", since, span, p.effect, until, p.bends))
    return effects


def pose_numbers(data: Dataset) -> NDArray[np.float64]:
    """(N,) rising numbers of the poses: their ids where these are, else positions from 1."""
    if ids_are_numbers(data.poses):
        return np.array([float(pose) for pose in data.poses])
    return np.arange(1.0, len(data) + 1.0)


def ids_are_numbers(poses: Sequence[str]) -> bool:
    """Whether ids of poses are rising numbers."""
    try:
        ids = np.array([float(pose) for pose in poses])
    except ValueError:
        return False
    return bool(len(ids) and np.isfinite(ids).all() and (np.diff(ids) > 0.0).all())


def _table(effect: Shift | Drift) -> list[str]:
    from loopcal.mechanisms.effects.drift import Shift

    numbers = (
        {"at": f"[{', '.join(f'{a:.12g}' for a in effect.at)}]"}
        if isinstance(effect, Shift)
        else {
            key: f"{value:.12g}"
            for key in ("since", "over", "until", "bends")
            if (value := getattr(effect, key)) is not None and (key != "bends" or value)
        }
    )
    return [
        "[[mechanism.effect]]",
        f'type = "{"shift" if "at" in numbers else "drift"}"',
        f'name = "{effect.name}"',
        f"changing = [{', '.join(f'{chr(34)}{n}{chr(34)}' for n in effect.changing)}]",
        f'column = "{effect.column}"',
        *(f"{key} = {value}" for key, value in numbers.items()),
    ]

"""Which method was chosen for a calibration, over which others, and by how much."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from loopcal.document.accuracy import Distances
from loopcal.document.change_points import Likeness
from loopcal.document.fit import ChiSquared
from loopcal.document.plain import Count, Size
from loopcal.presentation.shown import by_sd, shortened, size, unit_shown

# Two-sided 3.29 of the normal distribution (record 0047).
BEATEN = 3.3
"""Standard errors at p = 0.001: several rivals are tried."""


def beats(difference: float, sd: float, regions: float | None, other: float | None) -> bool:
    """Whether a rival predicts poses not used better than what is judged: the rule of the choice
    and of the verdict.

    difference, sd: of its rms at random poses over that of the other; regions, other: rms of both
    in regions not used, where it must be no worse: poses of a narrow set show nothing of elsewhere.
    """
    worse_elsewhere = regions is not None and other is not None and regions > other
    return difference < -BEATEN * sd and not worse_elsewhere


@dataclass(frozen=True)
class Candidate:
    """A way to calibrate that was validated on the same poses as the chosen one."""

    name: str
    out_of_sample: Distances | None
    """On poses not used, random folds, in the unit of `accuracy`; null: it failed."""
    blocked: Distances | None
    """On regions not used; null: it failed, or there are too few poses for regions."""
    difference: float | None
    """Its rms on poses not used minus that of the chosen one; null: it failed."""
    sd: Size | None
    """Standard error of the difference, paired by pose."""
    failed: str | None = None
    """Why it was discarded before the end; null: it was not."""
    terms: tuple[TermEntry, ...] = ()
    """What it learnt of the model error, where the chosen candidate learnt nothing."""
    chi_squared: ChiSquared | None = None
    """Of its fit of all poses at the stated sds; null: it used none, or did not converge."""
    excess: Size | None = None
    """Its errors at the outputs over those that the stated sds alone cause, where it learnt a
    further error; null: it learnt none, or there are no outputs."""
    serial: Likeness | None = None
    """Of residuals of consecutive poses, of a plain candidate whose residuals depend on the pose
    order, where the chosen one has a model error; null: they do not, or were not tested."""

    @property
    def rms_elsewhere(self) -> float | None:
        """In regions not used."""
        return None if self.blocked is None else self.blocked.rms


@dataclass(frozen=True)
class Chosen:
    """What the method "auto" chose."""

    method: str
    """The method of the chosen candidate."""
    terms: tuple[str, ...]
    """Names of the terms of its model error; empty: none."""
    words: str
    """What was chosen, over what, by how much, in a sentence."""
    over: tuple[Candidate, ...]
    """All candidates, the chosen one first."""
    contradicted: str | None = None
    """Readings stated as exact that contradict each other, so that no candidate could use the
    stated sds; null: none."""


# What was learnt of the model error: terms, groups of parameters that share one prior sd.

# p = 0.0008: half of chi-squared(1), as a variance of 0 is at the boundary (Self and Liang 1987).
DECISIVE = 10.0
"""Gain in -2 log restricted likelihood from which a model without the term is wrong."""
_CLEAR, _MOST = 3.0, 3
"""Sds from which a part is named, and how many of a term."""


@dataclass(frozen=True)
class TermPart:
    """What a term does at one joint; of a smooth discrepancy: at all of them."""

    joints: tuple[str, ...]
    """The joints concerned, or "base"; of a drift the place or reading that drifts."""
    unit: str
    """SI unit of size and sd."""
    size: Size
    """The largest over the measured poses; of a smooth discrepancy the rms over them."""
    sd: Size | None
    """Of the size; null: unknown."""
    pose: str | None
    """The pose where it is so large; null: an rms."""
    words: str
    """In a sentence."""

    @property
    def clear(self) -> bool:
        """Whether it is more than its uncertainty."""
        return self.sd is not None and self.size > _CLEAR * self.sd


@dataclass(frozen=True)
class TermEntry:
    """One term and its learnt scale."""

    name: str
    unit: str
    """SI unit of scale and interval."""
    scale: Size
    """The learnt prior sd that its parameters share."""
    interval: tuple[Size, Size | None] | None
    """95 % interval of the scale; null: unknown; an upper end of null: unbounded."""
    expected: Size | None
    """The sd stated for it, median of its prior."""
    columns: Count
    """Its estimated parameters."""
    effective: Size
    """Degrees of freedom that the data use of them: from 0, no effect, to their number."""
    gain: float | None
    """By how much the term lowers -2 log of the restricted likelihood; null: unknown."""
    words: str
    """What it means for the machine, in a sentence."""
    effects: tuple[str, ...] = ()
    """Those of its parameters that are no dimension of the drawing: single ones say little."""
    parts: tuple[TermPart, ...] = ()
    """What it does joint by joint, the largest first."""

    @property
    def spared(self) -> float:
        """Degrees of freedom that it uses although the data need nothing of it; else its scale."""
        needed = self.gain is None or self.gain >= DECISIVE
        return 1.0 if needed else self.effective

    @property
    def sentences(self) -> tuple[str, ...]:
        """What the term does to the machine, a sentence per joint, where the data need it."""
        if self.gain is None or self.gain < DECISIVE:
            return ()
        return tuple(part.words for part in self.parts if part.clear)[:_MOST]


def comparison(over: Sequence[Candidate], unit: str, better: Sequence[str]) -> str:
    """What was chosen, over what, by how much with paired standard errors.

    better: the names of those of less risk, but not significantly.
    """
    taken, *others = over
    if taken.out_of_sample is None:
        return f"{taken.name}, which predicts poses not used best or as well as any"
    shown = unit_shown(unit)
    words = f"{taken.name}: {size(taken.out_of_sample.rms, unit)} {shown} rms on poses not used"
    if taken.blocked is not None:
        words += f", {size(taken.blocked.rms, unit)} {shown} in regions not used"
    least = 0.02 * taken.out_of_sample.rms  # finer digits are noise
    beaten = [
        f"{one.name} {by_sd(one.difference, max(one.sd, least), unit, sign=True)} ± "
        f"{by_sd(one.sd, max(one.sd, least), unit)}"
        for one in others
        if one.difference is not None and one.sd is not None
    ]
    if beaten:
        words += f"; rms of the others minus this: {', '.join(beaten)} {shown}"
    out: dict[str, list[str]] = {}
    for one in others:
        if one.out_of_sample is None:
            out.setdefault(one.failed or "", []).append(one.name)
    for why, names in out.items():
        words += f"; discarded: {', '.join(names)}" + (f" ({shortened(why, 80)})" if why else "")
    if better:
        words += f"; {' and '.join(better)} not significantly better"
    return words

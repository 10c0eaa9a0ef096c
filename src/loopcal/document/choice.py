"""Which method was chosen for a calibration, over which others, and by how much."""

from __future__ import annotations

from dataclasses import dataclass

from loopcal.document.accuracy import Distances
from loopcal.document.bounds import Size
from loopcal.document.dependence import Likeness
from loopcal.document.goodness_of_fit import ChiSquared
from loopcal.document.terms import TermEntry

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

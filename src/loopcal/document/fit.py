"""What a fit says: how it ended, its parameters, its sds of sensors, and how well it closes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from loopcal.chi_squared import tail
from loopcal.document.plain import Count, Probability, Rows, Size
from loopcal.errors import listed
from loopcal.mechanisms.parameters import Role, dimension_of


@dataclass(frozen=True)
class StatusEntry:
    """How the fit ended."""

    converged: bool
    """Whether the point found is the optimum."""
    reason: str
    """Why the fit stopped, in one word."""
    message: str
    """Cause and remedy."""
    iterations: Count
    """Parameter steps tried."""


@dataclass(frozen=True)
class IntervalEntry:
    """Confidence interval of a parameter: from its covariance, and by profile likelihood."""

    level: Probability
    covariance: tuple[float | None, float | None]
    """Lower and upper end; null: nothing bounds the parameter."""
    profile: tuple[float | None, float | None]
    """The same; null: chi-squared never rises to its limit."""
    differs: bool
    """Whether the two differ by more than a tenth of the half width at an end."""


@dataclass(frozen=True)
class ParameterEntry:
    """One parameter of the mechanism."""

    name: str
    unit: str
    """SI unit of all numbers of this parameter."""
    nominal: float
    """Value before the fit, after the machine was moved to where the instrument sees it."""
    value: float
    """Calibrated value; the nominal one where fixed, that of `same` where it is the same."""
    sd: Size | None
    """Null where fixed or not identifiable."""
    prior_sd: Size | None
    """How well the nominal was known; null: flat."""
    fixed: bool
    """Whether it was held at its nominal value."""
    identifiable: bool | None
    """By data and prior; null where fixed."""
    error: float | None
    """True minus estimate, where the truth of a simulation was given."""
    interval: IntervalEntry | None = None
    """Null where it was not asked for."""
    degrees_of_freedom: Size | None = None
    """Of Student's t, where sds were learnt; null: normal, because all sds are known."""
    role: Role | Literal[""] = ""
    """What it says: placement, mounting, length, twist, zero, angle, scale, effect or model error;
    empty: written by an early version."""
    owner: str = ""
    """The joint, link, instrument, target or effect that it belongs to."""
    meaning: str = ""
    """One line on it, in words."""
    same: str = ""
    """The parameter that it equals, empty: none; it counts as fixed, and has the value and sd of
    that one."""

    @property
    def dimension(self) -> Literal["length", "angle", ""]:
        """What the machine's own drawing says in m or rad: "length" or "angle"; else ""."""
        return dimension_of(self.role, self.unit)

    @property
    def held(self) -> str:
        """Why it was not estimated, in a word or two; empty where it was."""
        return f"as {self.same}" if self.same else "fixed" if self.fixed else ""

    @property
    def stderr(self) -> float | None:
        """The sd, by the name of lmfit."""
        return self.sd


@dataclass(frozen=True)
class CovarianceEntry:
    """Covariance of the estimated parameters."""

    names: tuple[str, ...]
    """Parameters in the order of rows and columns."""
    unit: Literal["SI"]
    matrix: tuple[tuple[float | None, ...], ...]
    """Products of the parameters' SI units; null where one is not identifiable."""
    plain: Rows | None = None
    """The same as if the learnt sds were known, rows of the lower triangle; null: none were
    learnt."""
    slopes: tuple[Rows, ...] = ()
    """Its changes per sd of each independent error of the learnt sds, rows of lower triangles."""
    scatter: Rows | None = None
    """The covariance that the scatter of the poses shows, valid where noise or model are wrong,
    rows of its lower triangle; null: learnt terms carry the error of the model, a stream, or a
    robust loss."""
    scatter_freedom: Size | None = None
    """From so many independent poses."""
    unwidened: Rows | None = None
    """The covariance by which the fit weighed its prior: at the sds that it used, were no residuals
    dependent. Rows of its lower triangle; null: it is `plain`, or `matrix` without that."""
    pose_part: Rows | None = None
    """What errors that stated poses share with their neighbours add to `matrix`, as sure as the
    last of `slopes` says. Rows of its lower triangle; null: nothing."""


# Chosen, not derived: the usual level.
_AS_LIKELY = 0.05
"""p-value of a learnt sd above which the readings may as well have no such noise."""
_FEW = 12
"""Quantities of a sensor that its row names: images have hundreds."""


@dataclass(frozen=True)
class NoiseEntry:
    """The sd [SI unit] used for one or several quantities."""

    quantities: tuple[str, ...]
    unit: str
    sd: Size
    """The median where it differs from reading to reading."""
    sd_of_sd: Size | None
    """How sure the sd itself is, where that is known."""
    source: str
    """Where the sd comes from: given, estimated, reading, repeats or datasheet."""
    upper: Size | None = None
    """95 % upper bound of an estimated sd that is zero or unsure."""
    likelihood_ratio: float | None = None
    """By how much -2 log of the restricted likelihood rises without this noise; null where it was
    not estimated, or the loops could not close without it."""
    p_value: float | None = None
    """Of so large a rise if there were no such noise."""
    share: Probability | None = None
    """Of chi-squared: what the corrections of these quantities contribute to it, which depends on
    their weight."""
    role: Literal["reading", "disturbance"] = "reading"
    """reading: of sensors; disturbance: an error of the machine model, which no sensor reads."""
    slopes: tuple[float, ...] = ()
    """Relative changes of the variance, sd squared, along each of the slopes of `covariance`."""
    redundancy: Size | None = None
    """Sum of the redundancy numbers of these readings: degrees of freedom that test their sd; null:
    a stream, a robust loss, or written by an earlier version."""
    variance_factor: Size | None = None
    """Chi-squared of their corrections over their redundancy: 1 where the sd is right (Foerstner
    1979). The sensor with the largest is the first to suspect."""

    @property
    def label(self) -> str:
        """For the reader: what a camera sees, turns of a pose, or else the names."""
        names = self.quantities
        if all(name.count(":") > 2 for name in names):
            eyes = listed(list(dict.fromkeys(name.split(":")[0] for name in names)), _FEW)
            return f"corners of {eyes}"
        shown = ", ".join(names) if len(names) <= _FEW else f"{names[0]} ... {names[-1]}"
        turns = {name.rpartition("_")[2] for name in names} <= {"wx", "wy", "wz"}
        return f"small turns {shown}" if turns else shown


def undetected(noise: Sequence[NoiseEntry]) -> list[NoiseEntry]:
    """The learnt sds of readings that are 0; without any, those whose readings would be as likely
    without them."""
    learnt = [e for e in noise if (e.source, e.role) == ("estimated", "reading")]
    zero = [e for e in learnt if not e.sd]
    unsure = [e for e in learnt if e.upper is not None and (e.p_value or 0.0) > _AS_LIKELY]
    return zero or unsure


@dataclass(frozen=True)
class NoiseCovarianceEntry:
    """Quantities whose errors are not independent."""

    quantities: tuple[str, ...]
    matrix: tuple[tuple[float, ...], ...]
    """Their covariance [SI]; the mean over poses, where it differs from pose to pose."""


@dataclass(frozen=True)
class ClosureSize:
    """Size of the loop equations' values over all poses [SI]."""

    rms: Size | None
    max: Size | None


@dataclass(frozen=True)
class ClosureEntry:
    """The loop equations before and after. That a loop closes is no accuracy."""

    before: ClosureSize
    """At the readings and the nominal parameters."""
    after: ClosureSize
    """At the corrected readings and the calibrated parameters."""


# What the value of a parameter rests on.

Validity = Literal["determined", "prior", "undetermined", "fixed"]
# 1 / sd^2 = 4 / prior_sd^2: beyond it the prior is more than a quarter of what is known.
MOSTLY_PRIOR = 0.5
"""Sd over prior sd above which a parameter rests on what was known before."""


def validity(entry: ParameterEntry) -> Validity:
    """What the value of a parameter rests on: the data, mostly the prior, nothing, or a choice."""
    if entry.fixed:
        return "fixed"
    if entry.sd is None or not entry.identifiable:
        return "undetermined"
    if entry.prior_sd and entry.sd > MOSTLY_PRIOR * entry.prior_sd:
        return "prior"
    return "determined"


# Chi-squared of a fit: whether the corrections are as large as the stated sds allow.


@dataclass(frozen=True)
class ChiSquared:
    """The weighted square of all corrections and of the parameters' distance from their nominal.

    With the right sds it follows a chi-squared distribution with that many degrees of freedom
    (loop equations + finite priors - determined parameters).
    """

    value: float
    degrees_of_freedom: int
    p_value: Probability | None
    """Probability of a value at least this large if model and sds are right."""
    variance_factor: Size | None
    """Value per degree of freedom."""
    absorbed: Size = 0.0
    """Degrees of freedom of priors that may be wider than the machine is off, and of learnt terms
    that the data do not need: by so much the value may be smaller with the right sds."""

    @classmethod
    def of(cls, value: float, freedom: int, absorbed: float = 0.0) -> ChiSquared:
        """With what follows from value and degrees of freedom, None where these are none."""
        if freedom <= 0:
            return cls(value, freedom, None, None, absorbed)
        return cls(value, freedom, tail(value, freedom), value / freedom, absorbed)

    @property
    def too_large(self) -> bool:
        """Whether the corrections are larger than the stated sds allow."""
        if self.p_value is None or self.variance_factor is None:
            return False
        # A single test among several rejects at 0.001 (record 0054).
        return self.p_value < 1e-3 and self.variance_factor > 1.0

    @property
    def too_small(self) -> bool:
        """Whether the corrections are smaller than the stated sds let expect."""
        # 0.8 is sds 12 % too large: with many poses still less is significant, and harmless.
        left = self.degrees_of_freedom - self.absorbed
        if self.p_value is None or left <= 0.0 or self.value >= 0.8 * left:
            return False
        return tail(self.value, left) > 0.999

    def warnings(self, discrepancy: float | None, unit: str) -> tuple[str, ...]:
        """What the reader must know of the stated sds.

        discrepancy: sd [unit] of a model error at the end point that would explain a value too
        large, None if unknown.
        """
        if self.too_large:
            return (self._too_large(discrepancy, unit),)
        if self.too_small:
            return (
                f"Chi-squared per degree of freedom is {self.variance_factor:.2g}: the readings "
                "scatter less than their stated sds, which are too large.",
            )
        return ()

    def _too_large(self, discrepancy: float | None, unit: str) -> str:
        assert self.variance_factor is not None
        factor = self.variance_factor
        text = f"{factor:.0f}" if factor >= 10 else f"{factor:.2g}"
        explained = ""
        if discrepancy:
            explained = (
                f" Besides the sensors as stated, an error of about {discrepancy:.2g} {unit} in "
                "each coordinate of the end point would explain it."
            )
        return (
            f"Chi-squared per degree of freedom is {text}: the corrections are about "
            f"{math.sqrt(factor):.2g} times as large as the stated sds allow, so these sds are "
            f"too small. Either the sensors are worse than stated, or the machine model is "
            f"incomplete (a model error).{explained} The parameter sds below are then too small "
            f"too. Closed loops do not show accuracy; compare the accuracy lines."
        )

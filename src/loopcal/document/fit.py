"""What a fit says: how it ended, its parameters, its sds of sensors, and how well it closes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from loopcal.document.bounds import Count, Probability, Size
from loopcal.document.triangle import Rows
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
    """Calibrated value; the nominal one where fixed."""
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

    @property
    def dimension(self) -> Literal["length", "angle", ""]:
        """What the machine's own drawing says in m or rad: "length" or "angle"; else ""."""
        return dimension_of(self.role, self.unit)

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

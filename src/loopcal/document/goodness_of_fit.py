"""Chi-squared of a fit: whether the corrections are as large as the stated sds allow."""

from __future__ import annotations

import math
from dataclasses import dataclass

from loopcal.chi_squared import tail
from loopcal.document.bounds import Probability, Size


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

"""Whether the residuals of an instrument depend on each other, in pose order and in joint space."""

from __future__ import annotations

from dataclasses import dataclass

from loopcal.document.bounds import Probability, Size
from loopcal.presentation.rounding import significant


@dataclass(frozen=True)
class Likeness:
    """How alike the residuals of neighbouring poses are."""

    correlation: float
    """Of neighbours; 0 in independent errors."""
    p_value: Probability
    """Of a correlation at least so large in independent errors."""


@dataclass(frozen=True)
class InstrumentDependence:
    """One instrument."""

    instrument: str
    serial: Likeness | None
    """Poses that follow each other (von Neumann's ratio); null: too few, or no noise at all."""
    spatial: Likeness | None
    """Poses that are near in joint space (Moran's I); null: too few, or no noise at all."""


@dataclass(frozen=True)
class Dependence:
    """The tests of all instruments, and what was learnt of a drift.

    Serial dependence makes the covariance of the result the sandwich of a learnt drift.
    """

    instruments: tuple[InstrumentDependence, ...]
    level: Probability
    """Of rejecting any instrument in independent errors, serial and spatial each."""
    drift_share: Size | None = None
    """Share of the drift in the variance of a reading; null: no serial dependence."""
    drift_poses: Size | None = None
    """Poses over which the drift forgets to 1/e."""
    shared: Likeness | None = None
    """The largest canonical correlation of two instruments' residuals in one pose; null: there is
    one instrument, or the sds of the joints explain what instruments share."""

    @property
    def serial(self) -> tuple[InstrumentDependence, ...]:
        """The instruments that depend on the pose order."""
        # The level is family-wise: the instruments share it (Bonferroni; record 0050).
        limit = self.level / max(len(self.instruments), 1)
        return tuple(i for i in self.instruments if i.serial and i.serial.p_value < limit)

    @property
    def spatial(self) -> tuple[InstrumentDependence, ...]:
        """The instruments that depend on the place in joint space."""
        limit = self.level / max(len(self.instruments), 1)
        return tuple(i for i in self.instruments if i.spatial and i.spatial.p_value < limit)

    @property
    def errors_shared(self) -> bool:
        """Whether instruments share errors that the fit takes as independent."""
        return self.shared is not None and self.shared.p_value < self.level

    def warnings(self) -> tuple[str, ...]:
        """What it means, and what to do."""
        lines = []
        for one in self.serial:
            assert one.serial is not None
            lines.append(
                f"Residuals of {one.instrument!r} depend on the pose order (correlation of "
                f"consecutive poses {significant(one.serial.correlation, 2)}, p = "
                f"{one.serial.p_value:.2g}): it drifts, was moved, or lacks a term of the model "
                f"along the path. Standard deviations and intervals by covariance allow for a "
                f"drift over about {significant(self.drift_poses or 0.0, 2)} poses. Look for "
                f"shifts, or measure the poses in random order."
            )
        for one in self.spatial:
            assert one.spatial is not None
            lines.append(
                f"Residuals of {one.instrument!r} depend on the place in joint space (correlation "
                f"of neighbours {significant(one.spatial.correlation, 2)}, p = "
                f"{one.spatial.p_value:.2g}): the machine model lacks a term, such as sag or a "
                f"gear error. Standard deviations do not allow for it. Add effects, or fit "
                f"with model error."
            )
        return tuple(lines)

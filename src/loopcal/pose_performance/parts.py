"""The figures of pose performance as typed values [SI]."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from loopcal.pose_performance.intervals import Estimate


@dataclass(frozen=True)
class AxisPerformance:
    """Orientation about one axis of the base: accuracy (signed) and repeatability (+-) [rad]."""

    axis: str
    accuracy: Estimate
    accuracy_fitted: Estimate | None
    repeatability: Estimate


@dataclass(frozen=True)
class PosePerformance:
    """One commanded pose, approached from one direction.

    accuracy: AP [m]; accuracy_fitted: AP after the base frame was fitted to the measured poses;
    offset: mean measured minus commanded (x, y, z) [m]; repeatability: RP [m]; instrument: RP that
    the instrument alone would show [m], and instrument_share: its part of the variance, None where
    its sd is not stated.
    """

    pose: str
    direction: str | None
    cycles: int
    accuracy: Estimate
    accuracy_fitted: Estimate | None
    offset: tuple[float, ...]
    repeatability: Estimate | None
    instrument: float | None = None
    instrument_share: float | None = None
    orientation: tuple[AxisPerformance, ...] = ()

    @property
    def name(self) -> str:
        """The pose, and its direction where there are several."""
        return self.pose if self.direction is None else f"{self.pose}, {self.direction}"


@dataclass(frozen=True)
class DirectionVariation:
    """vAP: largest distance between the mean positions of directions of approach [m]."""

    pose: str
    directions: tuple[str, ...]
    variation: Estimate


@dataclass(frozen=True)
class DistancePerformance:
    """Distance of two poses: commanded [m], accuracy AD [m], repeatability RD (+-) [m]."""

    poses: tuple[str, str]
    cycles: int
    commanded: float
    accuracy: Estimate
    repeatability: Estimate


@dataclass(frozen=True)
class Block:
    """Cycles of one pose taken together, at a mean time [s] where time is known."""

    name: str
    time: float | None
    cycles: int
    accuracy: Estimate
    repeatability: Estimate


@dataclass(frozen=True)
class Drift:
    """Last block of cycles against the first [m]: shift of the mean position, dAP, dRP."""

    pose: str
    blocks: tuple[Block, ...]
    shift: Estimate
    accuracy: Estimate
    repeatability: Estimate


@dataclass(frozen=True)
class Largest:
    """The poses whose AP, AP after fitting the base, and RP are the largest of a condition."""

    accuracy: PosePerformance
    fitted: PosePerformance | None
    repeatability: PosePerformance | None

    @property
    def figures(self) -> tuple[Estimate | None, Estimate | None, Estimate | None]:
        """AP, AP fitted and RP of these poses."""
        return (
            self.accuracy.accuracy,
            None if self.fitted is None else self.fitted.accuracy_fitted,
            None if self.repeatability is None else self.repeatability.repeatability,
        )


@dataclass(frozen=True)
class ConditionPerformance:
    """All figures at one payload and speed.

    condition: column -> value; missing: what could not be computed, and why; notes: what a reader
    of the figures must know.
    """

    condition: Mapping[str, str]
    poses: tuple[PosePerformance, ...]
    variations: tuple[DirectionVariation, ...]
    distances: tuple[DistancePerformance, ...]
    drifts: tuple[Drift, ...]
    missing: tuple[str, ...]
    notes: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """The condition in words; empty where the table has no such columns."""
        return ", ".join(f"{key} = {value}" for key, value in self.condition.items())

    @property
    def largest(self) -> Largest:
        """Poses with the largest AP, AP after fitting the base, and RP."""

        def most(figure: Callable[[PosePerformance], Estimate | None]) -> PosePerformance | None:
            valued = [(e.value, pose) for pose in self.poses if (e := figure(pose)) is not None]
            return max(valued, key=lambda pair: pair[0])[1] if valued else None

        worst = most(lambda pose: pose.accuracy)
        assert worst is not None  # a condition has poses
        return Largest(
            worst,
            most(lambda pose: pose.accuracy_fitted),
            most(lambda pose: pose.repeatability),
        )

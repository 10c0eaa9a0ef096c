"""What of a calibrated machine goes into its controller or its simulation, as typed values.

Everything is SI. Formats write it in their own units; the tables of `zeros` and `frames` are for a
controller that keeps its nominal geometry, everything else holds the whole calibrated geometry.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from loopcal.arrays import Array
from loopcal.document.accuracy import Distances
from loopcal.document.fit import ParameterEntry
from loopcal.mechanisms.origins import CalibratedOrigin
from loopcal.mechanisms.rest import RestChain
from loopcal.presentation.shown import size

_NOTHING = 1e-9
"""[m] what is left of two models that are the same."""


@dataclass(frozen=True)
class ZeroOffset:
    """A joint's zero, where only zeros, tool and base are entered.

    offset: to be added to the reading [SI of unit]; u95: half width of its 95 % interval, None
    where unknown; determined: whether the readings separate it from base and tool; where they do
    not, the offset is 0 and base and tool hold it.
    """

    joint: str
    unit: str
    offset: float
    u95: float | None
    determined: bool


@dataclass(frozen=True, eq=False)
class Placed:
    """A frame: T (4, 4) in the frame `seen_in`; turned: whether its orientation was measured;
    model: that it belongs to, "geometry" or "zeros and tool"."""

    name: str
    seen_in: str
    T: Array
    turned: bool
    model: str


@dataclass(frozen=True)
class ModelAccuracy:
    """A model of the machine beside the measured poses and beside the full model.

    model: "nominal", "zeros and tool", "geometry" or "full"; measured: computed minus measured at
    the poses of the calibration, None where unknown; from_full: distance [m] from what the full
    model predicts in the working region, None for the full model. Each has its own place and tool.
    """

    model: str
    measured: Distances | None
    from_full: Distances | None

    @property
    def figures(self) -> tuple[float | None, ...]:
        """rms, 95 % and max at the measured poses, and rms from the full model [m]."""
        measured, away = self.measured, self.from_full
        at_poses = (
            (None, None, None) if measured is None else (measured.rms, measured.p95, measured.max)
        )
        if away is None:
            return (*at_poses, None)
        return (*at_poses, away.rms if away.rms > _NOTHING else 0.0)


@dataclass(frozen=True, eq=False)
class Exported:
    """A calibrated machine for export.

    chain: joints and tip of a serial arm, None of other machines; origins: those of an arm that is
    described by joint origins; parameters: all of the result; values: by name [SI], as exported:
    those of the geometry refitted where the machine has effects beyond geometry; zeros, frames:
    for a controller that keeps its nominal geometry; accuracy: what each model reaches; omitted:
    effects beyond geometry that the exported geometry cannot hold; warnings; limits: of readings
    [SI]; links: joint -> the frame (4, 4) behind it in the base's frame, all joints at zero; eyes:
    of a body whose pose is read, what sees poses beside pixels: whether the body carries it, and
    its place (4, 4) there or in the base; images: width and height of cameras' images, by camera.
    """

    name: str
    chain: RestChain | None
    origins: tuple[CalibratedOrigin, ...]
    parameters: tuple[ParameterEntry, ...]
    values: Mapping[str, float]
    zeros: tuple[ZeroOffset, ...] = ()
    frames: tuple[Placed, ...] = ()
    accuracy: tuple[ModelAccuracy, ...] = ()
    omitted: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    links: Mapping[str, Array] = field(default_factory=dict)
    eyes: Mapping[str, tuple[bool, Array]] = field(default_factory=dict)
    images: Mapping[str, tuple[int, int]] = field(default_factory=dict)

    def of(self, model: str) -> ModelAccuracy | None:
        """The accuracy of a model; None where it is not known."""
        return next((one for one in self.accuracy if one.model == model), None)


def accuracy_lines(exported: Exported) -> list[str]:
    """What each model reaches, as lines of a table; none where nothing is known."""
    if not exported.accuracy:
        return []
    lines = ["model           rms [mm]      95 %       max  from the full model [mm], rms"]
    for one in exported.accuracy:
        cells = [size(v, "m") for v in one.figures[:3]]
        apart = "" if one.model == "full" else _apart(one.figures[3])
        row = f"{one.model:<15} {cells[0]:>8}  {cells[1]:>8}  {cells[2]:>8}  {apart}"
        lines.append(row.rstrip())
    return lines


def _apart(rms: float | None) -> str:
    return "0" if rms == 0.0 else size(rms, "m")

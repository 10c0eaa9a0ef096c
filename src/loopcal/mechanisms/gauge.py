"""Which parameters of a machine only say where a frame lies, and when they are held.

The joints of a parallel machine are points of two bodies, base and platform, whose frames cannot be
seen. A frame is tied by an instrument that reads in it; where none does, the
machine's `Gauge` holds as many parameters at their nominal values as the frame has freedoms, and
what is left is determined. Nothing that can be seen depends on which are held.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

from loopcal.mechanisms.parameters import Parameter


@dataclass(frozen=True)
class Gauge:
    """Parameters that place a frame or set the scale, by what they place.

    base: where the base frame lies, tied by an instrument that reads coordinates in it; body:
    where the body's frame lies, tied by an instrument that reads the pose of that very frame;
    scale: the size of a machine that itself reads angles alone, tied by any measured length.
    translating: the body never turns; the place of a target on it is indistinguishable from that of
    the station, and the first instrument's target is held.
    """

    base: tuple[str, ...] = ()
    body: tuple[str, ...] = ()
    scale: tuple[str, ...] = ()
    translating: bool = False


class Reader(Protocol):
    """What an instrument says of the frames that it ties."""

    @property
    def readings(self) -> Mapping[str, str]:
        """Its readings and their SI units."""

    @property
    def parameters(self) -> Mapping[str, Parameter]:
        """Of what it looks at on the body."""

    @property
    def placement(self) -> Mapping[str, Parameter]:
        """Of where it stands."""

    @property
    def implied(self) -> Mapping[str, float]:
        """Readings that are the same in every pose by construction, and so measure nothing."""

    @property
    def form(self) -> str:
        """What its readings are together."""


_COORDINATES = ("point", "spherical", "pose")
"""Forms of readings that say where in a frame something is, rather than how far from a thing."""


def held(gauge: Gauge, instruments: Sequence[Reader]) -> set[str]:
    """Names of the parameters that nothing but the drawing can say."""
    names: set[str] = set()
    if not any(i.form in _COORDINATES and not i.placement for i in instruments):
        names |= set(gauge.base)
    # The pose of a target leaves the target's place in the body's frame open, so it ties nothing.
    if not any(i.form == "pose" and not i.parameters for i in instruments):
        names |= set(gauge.body)
    if gauge.translating and instruments:
        names |= {n for n, p in instruments[0].parameters.items() if p.unit == "m"}
    units = [u for i in instruments for q, u in i.readings.items() if q not in i.implied]
    # Angles are the same for a machine of any size.
    if "m" not in units:
        names |= set(gauge.scale)
    return names


def fixed(parameters: Mapping[str, Parameter], names: set[str]) -> dict[str, Parameter]:
    """The parameters, those named held at their nominal values."""
    return {n: replace(p, fixed=True) if n in names else p for n, p in parameters.items()}

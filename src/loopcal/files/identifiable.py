"""Parameters fixed because others do the same: chosen around everything that files say of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parameters import Parameters
from loopcal.mechanisms.redundancy import redundant, without_redundant
from loopcal.mechanisms.station import Station

Told = Callable[[Parameters], Parameters]
"""Parameters with the values, prior sds and fixed flags that a mechanism file or project states."""


def identifiable(mechanism: Mechanism, told: Told) -> Mechanism:
    """The mechanism with those of a chain's parameters fixed that readings cannot tell from others.

    told: all that will be said of its parameters; those that it sets free stay free, and come
    first. Then come the instruments' parameters, which are not taken at their nominal values
    unless these are stated, then the chain's.
    """
    plain = mechanism.parameters
    other = Parameters(tuple(replace(p, nominal=p.nominal + 1.0, fixed=True) for p in plain))
    said, said_of_other = told(plain), told(other)
    free = said_of_other.free  # fixed before, and set free
    both = zip(said, said_of_other, strict=True)
    stated = {p.name for p, q in both if p.nominal == q.nominal}
    chain = {step.parameter for step in mechanism.chain}
    beyond = {n for names in mechanism.effects.values() for n in names}
    own = [n for n in plain.names if n not in chain and n not in beyond]
    stations = {
        n for f in mechanism.families if isinstance(f.placement, Station)
        for n in f.placement.parameters
    }  # fmt: skip
    joints = (mechanism.description or {}).get("joints", [])
    limits = {j.name: getattr(j, "limits", None) for j in joints}
    found = redundant(
        mechanism.with_parameters(said),
        ranges={name: span for name, span in limits.items() if span is not None},
        first=[*free, *own],
        unsure=[n for n in own if n not in stated and n not in stations],
    )
    return without_redundant(mechanism, found, but=free)

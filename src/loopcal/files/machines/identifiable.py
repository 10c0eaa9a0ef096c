"""Parameters fixed because others do the same: chosen around everything that files say of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parameters import Parameters
from loopcal.mechanisms.redundancy import fix_redundant

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
    both = zip(said, said_of_other, strict=True)
    return fix_redundant(
        mechanism.with_parameters(said),
        keep=said_of_other.free,  # fixed before, and set free
        stated=[p.name for p, q in both if p.nominal == q.nominal],
    )

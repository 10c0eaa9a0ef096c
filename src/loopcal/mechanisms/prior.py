"""How well the nominal parameters are known before any pose is measured."""

from __future__ import annotations

import math
from collections.abc import Mapping

from loopcal.errors import InputError
from loopcal.mechanisms.parameters import Parameters
from loopcal.units import unit


class Prior:
    """Prior sds by parameter name or glob, SI or (value, unit); later entries win.

    inf is flat (the nominal is no information), 0 means known exactly.

    >>> Prior({"*": float("inf"), "l?": (1.0, "mm")}).sds
    {'*': inf, 'l?': 0.001}

    Raises InputError for an sd that is negative or not a number.
    """

    def __init__(self, sds: Mapping[str, float | tuple[float, str]]) -> None:
        self.sds: dict[str, float] = {}
        for key, given in sds.items():
            value, factor = (
                (given[0], unit(given[1]).factor) if isinstance(given, tuple) else (given, 1.0)
            )
            try:
                sd = float(value) * factor
            except (TypeError, ValueError):
                sd = math.nan
            if not sd >= 0.0:
                raise InputError(
                    f"the prior sd of {key!r} is {value!r}",
                    code="invalid-value",
                    remedy="give a positive number, inf for a flat prior, 0 for a fixed value",
                )
            self.sds[key] = sd

    @classmethod
    def of(cls, given: PriorLike | None) -> Prior | None:
        """The prior itself, or one made of a mapping of sds.

        Raises InputError for anything else.
        """
        if given is None or isinstance(given, Prior):
            return given
        if not isinstance(given, Mapping):
            raise InputError(
                f"the prior is {type(given).__name__} {given!r:.40}",
                code="invalid-value",
                remedy='give Prior({"l?": 0.001}), or a dict of sds by parameter',
            )
        return cls(given)

    def __repr__(self) -> str:
        return f"Prior({self.sds!r})"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Prior) and list(self.sds.items()) == list(other.sds.items())

    __hash__ = None  # type: ignore[assignment]

    def apply(self, parameters: Parameters) -> Parameters:
        """The parameters with these prior sds."""
        return parameters.with_prior(self.sds)


PriorLike = Prior | Mapping[str, float | tuple[float, str]]
"""A prior, or the mapping that makes one."""

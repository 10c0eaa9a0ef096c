"""How well the nominal parameters are known before any pose is measured."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from loopcal.errors import InputError, unknown_name
from loopcal.mechanisms.effects.effect import OF_INSTRUMENTS
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.terms import stated_terms
from loopcal.units import unit

ESTIMATES = ("group",)


class Prior:
    """Prior sds by parameter name or glob, SI or (value, unit); later entries win.

    inf is flat (the nominal is no information), 0 means known exactly.

    >>> Prior({"*": float("inf"), "l?": (1.0, "mm")}).sds
    {'*': inf, 'l?': 0.001}

    estimate: for a key of the sds, "group": the parameters share one sd, which is learnt from the
    calibration (`loopcal.Term`). The sd stated is the median of what is expected, known to a
    factor of e.

    >>> Prior({"c_*": (1.0, "mm")}, estimate={"c_*": "group"}).estimate
    {'c_*': 'group'}

    Raises InputError for an sd that is negative or not a number, and for one to be learnt that is
    0 or inf.
    """

    def __init__(
        self,
        sds: Mapping[str, float | tuple[float, str]],
        *,
        estimate: Mapping[str, str] | None = None,
    ) -> None:
        if not isinstance(sds, Mapping):
            raise InputError(
                f"the prior is {type(sds).__name__} {sds!s:.40}",
                code="invalid-value",
                remedy='give Prior({"*": 0.001}), or a dict of sds by parameter',
            )
        self.sds: dict[str, float] = {}
        for key, stated in sds.items():
            value, factor = (
                (stated[0], unit(stated[1]).factor) if isinstance(stated, tuple) else (stated, 1.0)
            )
            try:
                sd = float(value) * factor
            except (TypeError, ValueError):
                sd = math.nan
            # Written so that NaN is refused, too.
            if not sd >= 0.0:
                raise InputError(
                    f"the prior sd of {key!r} is {value!r}",
                    code="invalid-value",
                    remedy="give a positive number, inf for a flat prior, 0 for a fixed value",
                )
            self.sds[key] = sd
        self.estimate = dict(estimate or {})
        for key, how in self.estimate.items():
            check_estimate(key, how, self.sds.get(key))

    @classmethod
    def of(cls, prior: PriorLike | None) -> Prior | None:
        """The prior itself, or one made of a mapping of sds.

        Raises InputError for anything else.
        """
        if prior is None or isinstance(prior, Prior):
            return prior
        return cls(prior)

    def __repr__(self) -> str:
        learnt = f", estimate={self.estimate!r}" if self.estimate else ""
        return f"Prior({self.sds!r}{learnt})"

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, Prior)
            and self.estimate == other.estimate
            and list(self.sds.items()) == list(other.sds.items())
        )

    __hash__ = None  # type: ignore[assignment]

    def apply(self, mechanism: Mechanism) -> Mechanism:
        """The mechanism with these prior sds, and a term for each group whose sd is learnt.

        Globs do not mean what instruments may do (`OF_INSTRUMENTS`): whoever wrote them did not
        know that a choice of methods adds this.
        """
        added = {n for t in mechanism.terms if t.name in OF_INSTRUMENTS for n in t.parameters}
        learnt = {p.name: p.prior_sd for p in mechanism.parameters if p.name in added}
        parameters = mechanism.parameters.with_prior({**self.sds, **learnt})
        keys = {key: key in self.estimate for key in self.sds}
        terms = stated_terms(mechanism.terms, parameters, keys, added)
        return replace(mechanism, parameters=parameters, terms=terms)


def check_estimate(key: str, how: str, sd: float | None) -> None:
    """Raise InputError where the sd of a prior is to be learnt in a way or from a size that none
    is."""
    if how not in ESTIMATES:
        raise unknown_name(f"estimate of the prior {key!r} is {how!r}", how, ESTIMATES)
    if sd is None or not 0.0 < sd < math.inf:
        raise InputError(
            f"the prior sd of {key!r} is to be learnt, but "
            + ("none is stated" if sd is None else f"it is stated as {sd:g}"),
            code="missing-sd",
            remedy="state a rough size of these parameters, positive and finite",
        )


PriorLike = Prior | Mapping[str, float | tuple[float, str]]
"""A prior, or the mapping that makes one."""

"""Terms: parameters that share one prior sd, which is learnt from the calibration.

A prior sd need not be known. Parameters of one kind (all link lengths, all compliances, the
features of a smooth discrepancy) share a scale s: p_i ~ N(nominal_i, s^2). The data determine s:
near zero where they do not need the term, large where they do. The log of s has a prior,
log s ~ N(log sd, spread^2), which keeps it off zero and infinity where the data are silent.

The prior sd of each such parameter is the present value of s, where a search for it begins.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

from loopcal.errors import InputError, refuse_repeated, unknown_name
from loopcal.mechanisms.parameters import Parameter, Parameters


@dataclass(frozen=True)
class Term:
    """Parameters that share one prior sd, which is learnt.

    name: of the term; parameters: their names, all in one unit; sd: median of the prior of their
    sd [SI]; spread: sd of its natural logarithm; words: what the term stands for, with {scale}
    where the learnt sd belongs ("under gravity joint 2 gives way by {scale}"), or empty.

    >>> Term("lengths", ("l1", "l2"), 1e-3)
    Term(name='lengths', parameters=('l1', 'l2'), sd=0.001, spread=1.0, words='')

    Raises InputError for an empty term, a parameter named twice, or an sd that is not a positive
    number.
    """

    name: str
    parameters: tuple[str, ...]
    sd: float
    spread: float = 1.0
    words: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "parameters", tuple(self.parameters))
        if not self.parameters:
            raise InputError(
                f"the term {self.name!r} has no parameters",
                code="no-free-parameter",
                remedy="name the parameters that share its sd",
            )
        if len(set(self.parameters)) != len(self.parameters):
            raise InputError(
                f"the term {self.name!r} names a parameter twice",
                code="duplicate-name",
                remedy="name each once",
            )
        for what, value in (("sd", self.sd), ("spread", self.spread)):
            if not 0.0 < value < math.inf:
                raise InputError(
                    f"the {what} of the term {self.name!r} is {value!r}",
                    code="invalid-value",
                    remedy="give a positive finite number: a rough size of these parameters"
                    if what == "sd"
                    else "give a positive finite number; 1 is a factor of 2.7 either way",
                )


def check_terms(terms: Sequence[Term], parameters: Parameters) -> None:
    """Raise InputError for terms that share a name or a parameter, or name one that is not there.

    The same for terms that mix units, or whose members' prior sds are not one finite number.
    """
    owner: dict[str, str] = {}
    place = {p.name: i for i, p in enumerate(parameters)}
    units = {p.name: p.unit for p in parameters}
    called = "two terms are called {!r}"
    refuse_repeated((term.name for term in terms), called, "give each term another name")
    for term in terms:
        for name in term.parameters:
            if name not in units:
                raise unknown_name(
                    f"the term {term.name!r} names {name!r}, which is not a parameter", name, units
                )
            if name in owner:
                raise InputError(
                    f"the parameter {name!r} is in two terms, {owner[name]!r} and {term.name!r}",
                    code="duplicate-name",
                    remedy="keep it in one: a parameter has one prior sd",
                )
            owner[name] = term.name
        mixed = sorted({units[name] for name in term.parameters})
        if len(mixed) > 1:
            raise InputError(
                f"the parameters of the term {term.name!r} are in {' and '.join(mixed)}",
                code="wrong-unit",
                remedy="make one term for each unit: these share one sd",
            )
        members = [parameters.items[i] for i in sorted([place[n] for n in term.parameters])]
        _check_sds([member for member in members if not member.fixed], term)


def _check_sds(members: Sequence[Parameter], term: Term) -> None:
    """Raise InputError for estimated members whose prior sds are flat or differ."""
    for member in members:
        sd, first = member.prior_sd, members[0].prior_sd
        # Sds that went through a file agree to the digits that it holds.
        if math.isinf(sd) or not math.isclose(sd, first, rel_tol=1e-9):
            state = "a flat prior" if math.isinf(sd) else f"the prior sd {sd:.6g}"
            raise InputError(
                f"{member.name!r} has {state}, but it is in the term {term.name!r}, whose "
                f"parameters share one prior sd ({first:.6g} of {members[0].name!r})",
                code="conflicting-keys",
                remedy="give all of them the same prior sd, or state this one as a prior "
                "(fit.prior, Prior): it then leaves the term",
            )


def stated_terms(
    terms: Sequence[Term],
    parameters: Parameters,
    keys: Mapping[str, bool],
    aside: Collection[str] = (),
) -> tuple[Term, ...]:
    """The terms after priors have been stated by name or glob, each learnt as a group or not.

    parameters: with these priors; keys: name or glob -> whether its sd is learnt; later ones win.
    A parameter whose prior is stated leaves the term that it was in; aside: names that no glob
    means.
    """
    owner = {name: key for key in keys for name in parameters.matching(key) if name not in aside}
    kept = []
    for term in terms:
        names = tuple(name for name in term.parameters if name not in owner)
        if names:
            kept.append(replace(term, parameters=names))
    for key in (key for key, learnt in keys.items() if learnt):
        names = tuple(name for name, by in owner.items() if by == key)
        if names:
            kept.append(Term(key, names, parameters[names[0]].prior_sd))
    return tuple(kept)

"""Which parameters no reading could tell from others, found from the Jacobian at random poses.

A machine described joint by joint has more parameters than its motion shows: a shift along the
last axis does what the tool's length does. One of each such set has to be left at its nominal
value. Parameters are gone through in an order of preference, and one is redundant where the
change that it makes in all readings is a combination of the changes that those kept before it
make:

    |c - K (K^+ c)| <= ALIKE |c|,   c its column of the Jacobian, K the columns kept so far.

Khalil and Gautier (1991) choose base parameters thus, by a QR decomposition; for serial arms
4 R + 2 P + 6 remain where a pose is measured (Mooring, Roth and Driels 1991).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.expressions.engine import engine_for
from loopcal.mechanisms.mechanism import Family, Mechanism
from loopcal.mechanisms.sampling import Sample, samples
from loopcal.mechanisms.station import Station

Array = NDArray[np.float64]
ALIKE = 5e-5
"""Between what must be none and what is some: of robots' URDFs, with parameters of their axes, the
largest remainder of the one kind is 5e-6 (right angles written as 1.5708), the smallest of the
other 4e-4 (axes 0.4 mm apart); without them 4e-12 and 6e-3."""
_NAMED, _SHARE = 3, 1e-3


@dataclass(frozen=True)
class Redundant:
    """A parameter that others make superfluous: `instead` do together what it does.

    instead: empty where the parameter changes no reading at all.
    """

    parameter: str
    instead: tuple[str, ...]

    @property
    def words(self) -> str:
        """One sentence."""
        if not self.instead:
            return f"{self.parameter!r} is fixed: it changes no reading."
        named = [repr(name) for name in self.instead[:_NAMED]]
        if more := len(self.instead) - len(named):
            named.append(f"{more} more")
        if len(named) == 1:
            return f"{self.parameter!r} is fixed: indistinguishable from {named[0]}."
        together = f"{', '.join(named[:-1])} and {named[-1]}"
        return f"{self.parameter!r} is fixed: indistinguishable from a combination of {together}."


def fix_redundant(
    mechanism: Mechanism,
    *,
    keep: Sequence[str] = (),
    stated: Iterable[str] | None = None,
    readings: Mapping[str, Array] | None = None,
    unmeasured: Sequence[str] = (),
) -> Mechanism:
    """The mechanism with those parameters fixed that no readings could distinguish from others.

    What stays free is determined by readings in enough poses; `remarks` say why each of the
    others is fixed. Gone through are first those in `keep` (names or globs), which stay free in any
    case, then of an arm its instruments' parameters, then the joints' from base to tip; one is
    fixed where it does to the readings what those before it do together. Parameters with a prior
    sd are left free. It is decided at the nominal values, at random poses within the joints'
    limits. A value of 0 of an arm's instruments is taken as unknown, as that of
    a target, and moved off; stated: names of those that are meant (default: all but what is free
    and 0; where a station stands never matters).

    Where readings must fit each other, as those of parallel machines, give them, quantity -> (N,)
    [SI], say those of a `Simulation`; unmeasured: names or globs of quantities without a sensor.

    Raises InputError for such a machine without readings, and for names that are not there.
    Source: Khalil and Gautier (1991).
    """
    if mechanism.home and readings is None:
        raise InputError(
            f"the quantities of {mechanism.name!r} cannot vary freely, because the loops "
            f"constrain them",
            code="undetermined-quantities",
            remedy="give consistent readings, such as readings=simulate(...).quantities",
        )
    kept = [name for key in keep for name in mechanism.parameters.matching(key)]
    chain = {step.parameter for step in mechanism.chain}
    beyond = {n for names in mechanism.effects.values() for n in names}
    names = mechanism.parameters.names if chain else ()
    own = [n for n in names if n not in chain and n not in beyond]
    if stated is None:
        stated = [p.name for p in mechanism.parameters if p.fixed or p.nominal != 0.0]
    believed = {*stated, *(n for f in mechanism.families for n in _station(f))}
    joints = (mechanism.description or {}).get("joints", [])
    limits = {j.name: getattr(j, "limits", None) for j in joints}
    found = redundant(
        mechanism,
        ranges={name: span for name, span in limits.items() if span is not None},
        first=[*kept, *own],
        unsure=[n for n in own if n not in believed],
        readings=readings,
        unmeasured=[q for key in unmeasured for q in mechanism.quantity_group(key)],
    )
    return without_redundant(mechanism, found, but=kept)


def _station(family: Family) -> tuple[str, ...]:
    return family.placement.parameters if isinstance(family.placement, Station) else ()


def redundant(
    mechanism: Mechanism,
    *,
    ranges: Mapping[str, tuple[float, float]] | None = None,
    first: Sequence[str] = (),
    unsure: Sequence[str] = (),
    unmeasured: Sequence[str] = (),
    readings: Mapping[str, Array] | None = None,
    seed: int = 0,
) -> tuple[Redundant, ...]:
    """The free parameters without prior that need not be estimated.

    ranges: quantity -> limits [SI] of the random poses (half a turn or 0.5 m to either side);
    readings: quantity -> (N,) values [SI] in place of random ones, for machines whose quantities
    must fit each other; first: names to be kept before all others, which come in the mechanism's
    order; unsure: parameters whose nominal values say little, and are moved off them by chance or
    to where they can be touched, such as coordinates that stand at 0; unmeasured: quantities that
    nobody reads.
    """
    free = [p.name for p in mechanism.parameters if not p.fixed and math.isinf(p.prior_sd)]
    order = [n for n in first if n in free] + [n for n in free if n not in set(first)]
    looked_at = samples(
        mechanism, ranges=ranges or {}, unsure=unsure, readings=readings or {}, seed=seed
    )
    parts = [_columns(mechanism, sample, order, unmeasured) for sample in looked_at]
    return _chosen(order, np.concatenate(parts))


def without_redundant(
    mechanism: Mechanism, found: Sequence[Redundant], *, but: Sequence[str] = ()
) -> Mechanism:
    """The mechanism with these parameters fixed and the reasons among its remarks.

    but: parameters that stay free all the same.
    """
    fixed = [r for r in found if r.parameter not in set(but)]
    parameters = mechanism.parameters.with_fixed([r.parameter for r in fixed])
    remarks = (*mechanism.remarks, *(r.words for r in fixed))
    return replace(mechanism, parameters=parameters, remarks=remarks)


def _columns(
    mechanism: Mechanism, sample: Sample, names: Sequence[str], unmeasured: Sequence[str]
) -> Array:
    """The loops' derivatives by these parameters (loops * poses, n), unmeasured eliminated."""
    engine = engine_for(mechanism.tape, tuple(names), sample.readings.shape[1], tuple(unmeasured))
    engine.at(sample.parameters)
    values = engine.evaluate(sample.readings, sample.known)
    J = np.moveaxis(values.by_parameter[:, sample.loops], 2, 0).transpose(0, 2, 1)
    if unmeasured:
        U = np.moveaxis(values.by_quantity[:, sample.loops], 2, 0).transpose(0, 2, 1)
        J = J - U @ (np.linalg.pinv(U) @ J)
    columns: Array = J.reshape(-1, len(names)).copy()
    return columns


def _chosen(names: Sequence[str], columns: Array) -> tuple[Redundant, ...]:
    """Gram and Schmidt, in the order of the columns: kept columns are Q R, Q orthonormal."""
    norms = np.linalg.norm(columns, axis=0)
    least = 1e-9 * norms.max(initial=0.0)
    kept: list[int] = []
    Q, R = np.empty((len(columns), 0)), np.empty((0, 0))
    found = []
    for i, name in enumerate(names):
        if norms[i] <= least:
            found.append(Redundant(name, ()))
            continue
        own = columns[:, i] / norms[i]
        within = Q.T @ own
        rest = own - Q @ within
        again = Q.T @ rest  # twice is enough (Kahan and Parlett)
        within, rest = within + again, rest - Q @ again
        size = float(np.linalg.norm(rest))
        if size > ALIKE:
            kept.append(i)
            Q = np.column_stack([Q, rest / size])
            R = np.block([[R, within[:, None]], [np.zeros((1, len(R))), np.array([[size]])]])
            continue
        shares = np.linalg.solve(R, within)
        greatest = np.argsort(-np.abs(shares), kind="stable").tolist()
        leading = [k for k in greatest if abs(shares[k]) > _SHARE]
        leading[:_NAMED] = sorted(leading[:_NAMED])
        found.append(Redundant(name, tuple(names[kept[k]] for k in leading)))
    return tuple(found)

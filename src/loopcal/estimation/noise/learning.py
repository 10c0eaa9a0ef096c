"""What `calibrate` is asked to learn about the noise, and how the result tells it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from loopcal.arrays import Array
from loopcal.document.fit import NoiseCovarianceEntry, NoiseEntry
from loopcal.errors import InputError
from loopcal.estimation.problem.constants import standing
from loopcal.estimation.problem.problem import Problem
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import MODEL, Noise
from loopcal.mechanisms.mechanism import PIXELS, Mechanism
from loopcal.mechanisms.model_error import disturbances, with_model_error
from loopcal.presentation.shown import with_unit

if TYPE_CHECKING:
    from loopcal.estimation.noise.estimation import EstimatedSd, NoiseEstimate
    from loopcal.estimation.noise.variance_components import Component

# Two sds are a factor of 9 either way: what separates figures of data sheets from sensors in use.
# Chosen, not derived.
SPREAD = math.log(3.0)
"""Beside an error of the machine, the sd of the logarithm of a learnt over its stated sd."""


def with_model(mechanism: Mechanism, data: Dataset, noise: Noise) -> tuple[Mechanism, Dataset]:
    """Mechanism and readings with the model's own error, where the noise speaks of one."""
    if MODEL not in noise.entries and MODEL not in noise.estimate:
        return mechanism, data
    names = disturbances(mechanism)
    data = data.with_readings({name: np.zeros(len(data)) for name in names})
    return with_model_error(mechanism), data


def components(problem: Problem, noise: Noise) -> tuple[Component, ...]:
    """The variance components that are to be estimated; later entries win.

    Raises InputError for a quantity that has no sd to begin from, and for a part of quantities
    that share a covariance.
    """
    from loopcal.estimation.noise.variance_components import Component

    quantities = problem.mechanism.tape.quantities
    still = standing(problem.mechanism, problem.readings)
    owner: dict[int, str] = {}
    for key, how in noise.estimate.items():
        names = key if isinstance(key, tuple) else problem.mechanism.quantity_group(key)
        label = ", ".join(key) if isinstance(key, tuple) else key
        for name in names:
            alone = how == "each" and key != MODEL  # the model's error is isotropic
            owner[quantities.index(name)] = name if alone else label
    for position in still:  # exact there: no reading shows what its sd is
        if not problem.uncertainty.sd[position].any():
            owner.pop(position, None)
    for label in dict.fromkeys(owner.values()):
        _check_start(problem, [i for i in owner if owner[i] == label])
    # Only their sum shows where both are white at one target: what is stated of a sensor tells how
    # much of it is the machine's.
    spread = SPREAD if MODEL in noise.entries else math.inf
    learnt_components = [
        Component(
            label,
            tuple(i for i in owner if owner[i] == label),
            math.inf if label == MODEL else spread,
        )
        for label in dict.fromkeys(owner.values())
    ]
    for block in problem.uncertainty.blocks:
        touched = [c.name for c in learnt_components if set(c.quantities) & set(block.indices)]
        if touched and not any(set(block.indices) <= set(c.quantities) for c in learnt_components):
            shared = ", ".join(quantities[i] for i in block.indices)
            raise InputError(
                f"{shared} share a covariance, so their sds can only be scaled together",
                code="invalid-covariance",
                remedy=f'estimate them together: estimate = "group" for {shared}',
            )
    return tuple(learnt_components)


def _check_start(problem: Problem, positions: Sequence[int]) -> None:
    """Refuse learning without a start; what no pose of a part reads needs none beside others."""
    sds = {i: problem.uncertainty.sd[i] for i in positions}
    read = [i for i, sd in sds.items() if np.isfinite(sd).any()] or positions[:1]
    without = [i for i in read if not np.any(np.isfinite(sds[i]) & (sds[i] > 0.0))]
    if not without:
        return
    name = problem.mechanism.tape.quantities[without[0]]
    raise InputError(
        f"the sd of {name!r} cannot be estimated without a start value",
        code="missing-sd",
        remedy=f"state a rough sd of {name!r} above zero, or do not estimate it",
    )


def entries(
    problem: Problem,
    estimate: NoiseEstimate | None,
    stated: Problem,
    relative: Array | None = None,
) -> tuple[NoiseEntry, ...]:
    """The sds that were used, one entry for each quantity or learnt group of alike sds.

    relative: (c, a) changes of the learnt variances along their independent errors, as shares.
    """
    learnt = estimate.components if estimate else ()
    owner = {i: j for j, component in enumerate(learnt) for i in component.quantities}
    alike = [f.readings for f in problem.mechanism.families if f.form == PIXELS]
    alike.append(problem.mechanism.disturbances)
    together = {q: -1 - number for number, names in enumerate(alike) for q in names}
    quantities = problem.mechanism.tape.quantities
    groups: dict[tuple[int, float], list[str]] = {}
    named_entries: list[tuple[NoiseEntry, list[str]]] = []
    for i, quantity in enumerate(quantities):
        sd = typical_sd(problem, i)
        if sd is None:
            continue
        entry = NoiseEntry(
            (quantity,),
            problem.mechanism.quantities[quantity],
            sd,
            None,
            problem.uncertainty.sources[i],
            role="disturbance" if quantity in problem.mechanism.disturbances else "reading",
        )
        names = [quantity]
        if i not in owner and quantity in together:
            group = groups.setdefault((together[quantity], sd), names)
            if group is not names:
                group.append(quantity)
                continue
        if i in owner:
            begun = typical_sd(stated, i) or 0.0
            group = groups.setdefault((owner[i], begun), names)
            if group is not names:  # shown with the first of its sd
                group.append(quantity)
                continue
            entry = learnt_entry(entry, learnt[owner[i]], begun)
            if relative is not None and entry.sd > 0.0:
                entry = replace(entry, slopes=tuple(relative[owner[i]].tolist()))
        named_entries.append((entry, names))
    return tuple(replace(entry, quantities=tuple(names)) for entry, names in named_entries)


def typical_sd(problem: Problem, position: int) -> float | None:
    """The median sd of a quantity, None where it is not measured."""
    row = problem.uncertainty.sd[position]
    measured = row[np.isfinite(row)]
    return float(np.median(measured)) if measured.size else None


def learnt_entry(entry: NoiseEntry, component: EstimatedSd, begun: float) -> NoiseEntry:
    """The entry with an sd that was learnt; begun: the stated one."""

    def sd(ratio: float | None) -> float | None:
        return None if ratio is None else ratio * begun

    return replace(
        entry,
        sd=component.ratio * begun,
        sd_of_sd=sd(component.sd_of_ratio),
        source="estimated",
        upper=sd(component.upper_ratio),
        likelihood_ratio=component.likelihood_ratio,
        p_value=component.p_value,
    )


def joint_covariances(problem: Problem) -> tuple[NoiseCovarianceEntry, ...]:
    """The covariances of quantities whose errors are not independent."""
    quantities = problem.mechanism.tape.quantities
    covariances = []
    for block in problem.uncertainty.blocks:
        matrix = block.factor @ np.swapaxes(block.factor, -1, -2)
        mean = matrix.reshape(-1, *matrix.shape[-2:]).mean(axis=0)
        names = tuple(quantities[i] for i in block.indices)
        covariances.append(NoiseCovarianceEntry(names, tuple(map(tuple, mean.tolist()))))
    return tuple(covariances)


def words(
    estimate: NoiseEstimate, noise: Sequence[NoiseEntry], shares: Mapping[str, float]
) -> tuple[str, ...]:
    """What the reader must know of the estimated sds.

    shares: of each quantity in chi-squared.
    """
    said = []
    for entry in noise:
        if entry.role == "disturbance" and sum(shares[q] for q in entry.quantities) > 0.5:
            said.append(
                "An error of "
                f"{with_unit(entry.sd, entry.unit, 2, fine=True)} in each coordinate limits the "
                "accuracy. Either the machine model lacks an effect or the instrument is worse "
                "than stated: these readings cannot distinguish them. Repeat readings of one pose. "
                "If these scatter less, check for missing effects (compliance, gear or encoder "
                "eccentricity, drift, bad poses)."
            )
    for one, other in estimate.alike:
        said.append(
            f"These data cannot distinguish the noise of {one!r} from that of {other!r}: only the "
            "sum is known. Repeat readings of one pose to separate them, or state one of them."
        )
    for entry in noise:
        if entry.source == "estimated" and entry.sd == 0.0 and entry.upper is not None:
            bound = with_unit(entry.upper, entry.unit, 2, fine=True)
            names = ", ".join(entry.quantities)
            if entry.role == "disturbance":
                names = "The readings show no error of the machine model in single coordinates"
            else:
                names = f"{names}: noise not detectable"
            said.append(f"{names} (sd below {bound} with 95 % confidence).")
    if not estimate.settled:
        said.append(
            "The estimated sds did not converge and are rough. State more of the sds; if the "
            "fit did not converge, first calibrate with stated sds."
        )
    return tuple(said)

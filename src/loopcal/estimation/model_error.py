"""Model error as part of a fit: the terms that a mechanism gets, and what its noise is then.

Sensors whose sds are stated keep them; a learnt white error of the model joins them. Least squares
states no sds: then the readings of instruments carry one learnt sd in each unit, and all other
readings stay exact, e ~ N(0, sigma^2 I).
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from loopcal.errors import InputError
from loopcal.measurements.noise import MODEL, Noise
from loopcal.mechanisms.structure.smooth import vectors_for
from loopcal.mechanisms.structure.structured import EFFECT, structured

if TYPE_CHECKING:
    from loopcal.estimation.fit import Fit
    from loopcal.measurements.dataset import Dataset
    from loopcal.mechanisms.mechanism import Mechanism

# Chosen, not derived: the usual size; a start, from which sds are learnt.
BEGIN = 1e-4
"""Learnt sds begin here [SI]: 0.1 mm, 0.1 mrad."""


def used_noise(fit: Fit, mechanism: Mechanism, data: Dataset, noise: Noise | None) -> Noise | None:
    """The noise that a fit uses; None where every reading is exact and no sd is learnt.

    Raises InputError where least squares with model error meets a loop without instrument.
    """
    if fit.solver.exact:
        return None
    if fit.model_error == "none":
        return noise
    if fit.method.exact:
        sensor_noise = instrument_noise(mechanism, data)
        return (
            sensor_noise
            if noise is None or noise.begin is None
            else sensor_noise.begun_at(noise.begin)
        )
    if noise is not None and _isotropic(mechanism) and MODEL not in noise.entries:
        return noise.with_learnt(MODEL, BEGIN)
    return noise


def weighed(fit: Fit, data: Dataset) -> Dataset:
    """The data without the sds that came with them, where a fit learns its own weights."""
    return replace(data, sds={}) if fit.method.exact else data


def modelled(fit: Fit, mechanism: Mechanism, poses: int) -> Mechanism:
    """The mechanism with the terms for its model error that a fit of so many poses asks for.

    A mechanism that is structured already stays as it is.
    """
    if fit.model_error == "none" or EFFECT in mechanism.effects:
        return mechanism
    return structured(mechanism, discrepancy=vectors_for(poses))


def _isotropic(mechanism: Mechanism) -> bool:
    """Whether one sd can serve all outputs, or all loops without outputs."""
    return len({mechanism.quantities[q] for q in mechanism.outputs}) <= 1


def instrument_noise(mechanism: Mechanism, data: Dataset) -> Noise:
    """All readings exact but those of instruments, which have one learnt sd in each unit.

    Raises InputError for a loop without any of these.
    """
    entries: dict[str, float] = {}
    groups: dict[tuple[str, str], list[str]] = {}
    forms = {q: f.form for f in mechanism.families if f.form != "closure" for q in f.readings}
    for name, unit in mechanism.quantities.items():
        read = name in mechanism.implied or np.isfinite(data.readings.get(name, np.nan)).any()
        if not read:
            entries[name] = math.inf
        elif name in forms or name in mechanism.outputs:
            entries[name] = BEGIN
            groups.setdefault((forms.get(name, ""), unit), []).append(name)
        else:
            entries[name] = 0.0
    learnt = {tuple(names): "group" for names in groups.values()}
    if not groups:
        return Noise({**entries, MODEL: BEGIN}, estimate={MODEL: "group"})
    noisy = {name for names in groups.values() for name in names}
    noisy |= {name for name, sd in entries.items() if math.isinf(sd)}
    for loop, names in zip(mechanism.tape.loops, mechanism.tape.depends_on(), strict=True):
        if noisy.isdisjoint(names):
            raise InputError(
                f"the loop {loop!r} has no reading of an instrument, so least squares cannot weigh "
                "its model error",
                code="unsupported",
                remedy="state the sds of the readings ([noise]) and use method = "
                '"implicit-loop", or set model_error = "none"',
            )
    return Noise(entries, estimate=learnt)

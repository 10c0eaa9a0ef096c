"""Whether anything says how large the machine is.

A ball in its socket, a probe on a plane and joints that turn fit a machine of any size: multiply
all its lengths by one factor, and every gap that is 0 stays 0. Worse, the smaller the machine,
the less its joints' noise moves the ball, so a fit would shrink it without end.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from loopcal.arrays import Array
from loopcal.errors import InputError
from loopcal.expressions.engine import engine_for
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parameters import GEOMETRY, Parameter

# Two of 1e9 normal readings are farther off.
_NOISE = 6.0
"""So many sds away from 0 a reading is no noise."""
# Poses that suffice for a rank, and the share of a column up to which others make it up. Chosen,
# not derived: far above rounding, far below an effect that counts.
_SAMPLE, _MADE_UP = 200, 1e-6


def refuse_without_length(
    mechanism: Mechanism, readings: Array, pose_constants: Array, sd: Array
) -> None:
    """InputError where the only lengths read are gaps of 0, and none that tells size is held.

    readings: (k, N); pose_constants: (c, N); sd: (k, N) or (k, 1), all [SI] in the orders of the
    tape. A gap within its noise of 0 says no more than one of 0.
    """
    if not mechanism.implied:  # no gap is read
        return
    names, units = mechanism.tape.quantities, mechanism.quantities
    read = np.flatnonzero(np.any(np.isfinite(sd), axis=1)).tolist()
    lengths = [i for i in read if units[names[i]] == "m"]
    gaps = {names[i] for i in lengths}
    if not gaps or not gaps <= set(mechanism.implied):
        return
    if (np.abs(readings[lengths]) > _NOISE * sd[lengths]).any():
        return
    stated_lengths = [p for p in mechanism.parameters if p.unit == "m" and p.nominal]
    held = [p for p in stated_lengths if p.fixed or math.isfinite(p.prior_sd)]
    whole = len(read) == len(names) and np.isfinite(readings).all()
    if not stated_lengths or (
        held and (not whole or _tell_size(mechanism, held, readings, pose_constants))
    ):
        return
    links = [p for p in stated_lengths if p.role in GEOMETRY] or stated_lengths
    longest = max(links, key=lambda p: abs(p.nominal)).name
    listed = ", ".join(names[i] for i in lengths)
    raise _unknown_size(f"{listed} read 0 by construction", longest)


def refuse_collapse(
    mechanism: Mechanism, readings: Array, pose_constants: Array, sd: Array, *, priors: bool
) -> None:
    """InputError where only angles are read, so that loop values vanish with all lengths.

    For methods that minimise loop values at the readings; others leave the size where it was. The
    arrays are those of `refuse_without_length`; priors: whether the method uses them.
    """
    names, units = mechanism.tape.quantities, mechanism.quantities
    read = np.flatnonzero(np.any(np.isfinite(sd), axis=1)).tolist()
    stated_lengths = [p for p in mechanism.parameters if p.unit == "m" and p.nominal]
    held = any(p.fixed or (priors and math.isfinite(p.prior_sd)) for p in stated_lengths)
    if not stated_lengths or held or any(units[names[i]] == "m" for i in read):
        return
    some = slice(None, None, max(1, readings.shape[1] // _SAMPLE))
    x = readings[:, some] + np.random.default_rng(0).uniform(-0.5, 0.5, readings[:, some].shape)
    engine = engine_for(mechanism.tape, tuple(p.name for p in stated_lengths), x.shape[1])
    at = engine.evaluate(_nominal(mechanism), x, pose_constants[:, some])
    lengths = np.array([p.nominal for p in stated_lengths])
    # Euler: loops of first degree in the lengths p have J p = f, and vanish with them.
    scaled = np.einsum("nmb,n->mb", at.by_parameter, lengths)
    by_length = np.abs(at.by_parameter).max(axis=(0, 2)) > 0.0
    left = np.abs(scaled - at.f)[by_length]
    if left.size and left.max() <= _MADE_UP * max(float(np.abs(at.f).max()), 1e-300):
        raise _unknown_size(
            "all readings are angles", max(stated_lengths, key=lambda p: abs(p.nominal)).name
        )


def _nominal(mechanism: Mechanism) -> Array:
    return np.array([p.nominal for p in mechanism.parameters])


def _unknown_size(why: str, longest: str) -> InputError:
    return InputError(
        f"no reading determines the size of the machine: {why}",
        code="unknown-size",
        remedy=f"fix a known length, say {longest} = {{ fixed = true }} under "
        "[parameters], or give it a prior sd; or measure a length, such as a ball-bar or the "
        "distance between two poses",
    )


def _tell_size(
    mechanism: Mechanism, held: Sequence[Parameter], readings: Array, pose_constants: Array
) -> bool:
    """Whether scaling the lengths that are held cannot be made up for by parameters that are free.

    Loops are of first degree in lengths. So where J_h p_h is in the range of J_free, wherever the
    joints stand, the rest of the machine scales without them.
    """
    some = slice(None, None, max(1, readings.shape[1] // _SAMPLE))
    x, constants = readings[:, some].copy(), pose_constants[:, some]
    # beside the poses: where loops close, whatever is held is trivially made up for by the rest
    turned = [
        i for i, q in enumerate(mechanism.tape.quantities) if mechanism.quantities[q] == "rad"
    ]
    x[turned] += np.random.default_rng(0).uniform(-0.5, 0.5, (len(turned), x.shape[1]))
    names = [p.name for p in held]
    free = [n for n in mechanism.parameters.free if n not in names]
    engine = engine_for(mechanism.tape, (*names, *free), x.shape[1])
    J = engine.evaluate(_nominal(mechanism), x, constants).by_parameter
    J = J.reshape(len(J), -1).T
    if not np.isfinite(J).all():
        return True
    # Loops by their own sizes: a point beside a camera's lens moves its pixel by any number.
    J = J / np.maximum(np.abs(J).max(axis=1, keepdims=True), 1e-300)
    column = J[:, : len(names)] @ np.array([p.nominal for p in held])
    rest = J[:, len(names) :]
    rest = rest / np.maximum(np.linalg.norm(rest, axis=0), 1e-300)
    left = column - rest @ np.linalg.lstsq(rest, column, rcond=1e-10)[0]
    return bool(np.linalg.norm(left) > _MADE_UP * np.linalg.norm(column))

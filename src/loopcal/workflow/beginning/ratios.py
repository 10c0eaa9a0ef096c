"""Drives whose ratios are not as stated: of a joint, or between one joint and another.

Joint i then stands at q_i + k q_j: j = i where its own gear counts otherwise, another j where its
motor sits before that joint, as in a wrist, or where a screw turns its own slide. Once the
machine's constants may move (see `weighing`), the residuals v and their derivatives A by all that
is estimated, and d = q_j dv/dq_i, show what such a ratio would explain (a score test, Rao 1948):

    M = I - A A^+,    k = -d' M v / (d' M d),    the sum of squares falls by (d' M v)^2 / (d' M d).

A soft arm that sinks a little more as it reaches out does nearly the same. The moment of a weight
along c at the point p about joint i is in proportion to dp_c/dq_i, so the columns dv/dq_i dp_c/dq_i
of all joints and the three axes c show what giving way would explain.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np

from loopcal.arrays import span
from loopcal.errors import InputError
from loopcal.presentation.shown import with_unit
from loopcal.units import from_si, unit
from loopcal.workflow.beginning.searching import CLEARLY, Machine, Understood
from loopcal.workflow.beginning.weighing import Refined, refined

LEAST = 5e-3
"""Ratios that move a joint by a smaller share of its travel are learnt as errors of gears."""
_MOST, _TRIED = 4, 4
_HELPS = 0.7
"""A further ratio has to leave so little of the misfit."""
# Far above the 1e-16 of the derivatives, and far below what a pose shows: chosen, not derived.
_ROUNDING = 1e-12
"""Of the largest direction or square, so much is rounding."""


def misstated(machine: Machine, way: Understood) -> InputError | None:
    """The refusal where ratios leave less than a third of what the best constants leave, also where
    the joints give way."""
    if machine.frame is not None or not way.seen:
        return None
    pairs: list[tuple[str, str]] = []
    before = best = refined(machine, way, way.seen[0])
    while best is not None and len(pairs) < _MOST:
        # Two axes of a wrist nearly exchange what they explain, which only a fit decides.
        tried = [
            (fit, [*pairs, pair])
            for pair in _further(way, pairs, best)
            if (fit := refined(machine, way, way.seen[0], [*pairs, pair])) is not None
        ]
        fit, more = min(tried, key=lambda one: one[0].rms, default=(best, pairs))
        if fit.rms > _HELPS * best.rms:
            break
        pairs, best = more, fit
    if before is None or best is None:
        return None
    if _giving_way(before) * before.rms < CLEARLY * best.rms:
        return None
    ratios = dict(zip(pairs, best.multiples.tolist(), strict=True))
    if any(_share(way, pair, k) < LEAST for pair, k in ratios.items()):
        return None
    return _refusal(machine, way, ratios, before.rms, best.rms)


def _share(way: Understood, pair: tuple[str, str], k: float) -> float:
    """The sd of what the ratio adds to a joint, as a share of the sd of that joint."""
    moved, by = (float(np.nanstd(way.joints[name])) for name in pair)
    return abs(k) * by / moved if moved else 0.0


def _further(
    way: Understood, pairs: Sequence[tuple[str, str]], fit: Refined
) -> list[tuple[str, str]]:
    """The pairs that explain most of the rest, by the score test."""
    every = product(way.joints, way.joints)
    others = [(name, other) for name, other in every if (name, other) not in pairs]
    names = list(way.joints)
    moved = fit.by_joints[:, [names.index(name) for name, _ in others]]
    by = np.array([way.joints[other][fit.rows] for _, other in others]).T
    d = np.zeros((len(fit.left), len(others)))
    d[: len(moved)] = moved * np.repeat(by, 3, axis=0)
    U = span(fit.derivatives, _ROUNDING)
    d -= U @ (U.T @ d)
    squares, along = np.square(d).sum(axis=0), d.T @ fit.left
    k = np.divide(
        along, squares, out=np.zeros_like(along), where=squares > _ROUNDING * squares.max()
    )
    sizes = np.array([_share(way, pair, 1.0) for pair in others])
    gains = np.where(np.abs(k) * sizes >= LEAST, k * along, 0.0)
    return [others[i] for i in np.argsort(-gains)[:_TRIED] if gains[i] > 0.0]


def _giving_way(fit: Refined) -> float:
    """The share of the misfit that is left where every joint gives way under a weight."""
    J = fit.by_joints.reshape(-1, 3, fit.by_joints.shape[1])
    moments = np.einsum("nai,nci->naic", J, J).reshape(len(fit.by_joints), -1)
    columns = np.zeros((len(fit.left), moments.shape[1]))
    columns[: len(moments)] = moments
    U = span(np.column_stack([fit.derivatives, columns]), _ROUNDING)
    return float(np.linalg.norm(fit.left - U @ (U.T @ fit.left)) / np.linalg.norm(fit.left))


def _refusal(
    machine: Machine,
    way: Understood,
    ratios: Mapping[tuple[str, str], float],
    before: float,
    after: float,
) -> InputError:
    columns = {
        name: (f.label, of)
        for name, f, of in zip(machine.joints, way.layout.joints, way.units, strict=True)
    }
    texts = {name: label for name, (label, _) in columns.items()}
    words = []
    for (name, other), k in sorted(ratios.items(), key=lambda one: one[0][0] != one[0][1]):
        (label, of), (by, of_other) = columns[name], columns[other]
        if name == other:
            texts[name] += f"*{1.0 + k:.6g}"
            words.append(f"{name} moves {1.0 + k:.4g} times as far as {label} reads")
            continue
        k = from_si(k, of) * unit(of_other).factor
        texts[name] += f"{'+' if k > 0.0 else '-'}{by}*{abs(k):.6g}"
        per = "" if of == of_other else f" {of} per {of_other}"
        words.append(f"{name} moves with {other} too, by {k:.4g}{per}")
    return InputError(
        f"{', and '.join(words)}: so the machine, its constants adjusted, misses the readings by "
        f"{with_unit(after, 'm', 2)} rms instead of {with_unit(before, 'm', 2)}",
        code="implausible-readings",
        remedy="check the ratios and couplings of these drives in the controller, and state "
        "--joints with the exact numbers; columns that you state are taken as they are",
    ).offering("--joints", ",".join(texts[name] for name in machine.joints))

"""The calibration linearised at its solution: a mixed linear model in the parameters' steps.

For each pose, after elimination of what is unmeasured,

    e = J_p dp + v,   v ~ N(0, V),   V = V_0 + sum_j s_j V_j,

e = J_x correction - f, V_j = J_j Sigma_j J_j^T the part of component j at its present sds, s_j its
variance ratio (1 at present), V_0 the sensors whose sds are taken as given. Searle, Casella and
McCulloch, Variance Components (1992), chapter 6.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.solve.kernel import eliminate, loadings
from loopcal.estimation.solve.sweep import Sweeper

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ModelBlock:
    """b poses: e (b, r), J (b, r, n), fixed (b, r, r) = V_0, parts (c, b, r, r) = V_j."""

    e: Array
    J: Array
    fixed: Array
    parts: Array


@dataclass(frozen=True)
class LinearModel:
    """All poses, the prior as precision (n,) and its offset nominal - present value (n,)."""

    blocks: tuple[ModelBlock, ...]
    precision: Array
    offset: Array

    @property
    def components(self) -> int:
        """Number of variance components."""
        return len(self.blocks[0].parts)


@dataclass(frozen=True)
class MixedFit:
    """The linear model at some variance ratios.

    criterion: -2 log of the restricted likelihood, up to a constant; score: (c,) derivatives of
    the log likelihood by the ratios; information: (c, c) its expected negative second
    derivatives; contribution: (c,) trace of P V_j, what each component takes of the freedom.
    """

    criterion: float
    score: Array
    information: Array
    contribution: Array


def linear_model(
    problem: Problem,
    parameters: Array,
    corrections: Array,
    components: Sequence[Sequence[int]],
    *,
    at_readings: bool = False,
) -> LinearModel:
    """The linearised model with one variance component for each list of quantity positions.

    at_readings: take J_p where the readings stand instead of where they were corrected to, as
    the reweighted fit does.
    """
    sweeper = Sweeper(problem)
    sweeper.at(parameters)
    blocks = []
    for pattern, block in sweeper.blocks(corrections):
        noise, engine = block.noise, sweeper.engine(pattern)
        values = engine.evaluate(block.corrected, block.known)
        unmeasured, measured = list(noise.unmeasured), list(noise.measured)
        f, J, D = values.f.copy(), values.by_quantity[measured], values.by_parameter.copy()
        columns = values.by_quantity[unmeasured]
        if at_readings:
            D = engine.evaluate(block.read, block.known).by_parameter.copy()
        skip = len(unmeasured)
        if skip:
            reflections = eliminate(columns)
            f, J, D = (reflections.apply(part) for part in (f, J, D))
        e = np.einsum("kmb,kb->mb", J[:, skip:], block.corrections[measured]) - f[skip:]
        G = loadings(J[:, skip:], noise)
        rows = [[measured.index(i) for i in c if i in noise.measured] for c in components]
        assigned = {i for own in rows for i in own}
        rest = [i for i in range(len(measured)) if i not in assigned]
        parts = [np.einsum("rkb,skb->brs", G[:, own], G[:, own]) for own in [*rows, rest]]
        blocks.append(
            ModelBlock(
                np.ascontiguousarray(e.T),
                np.ascontiguousarray(D[:, skip:].transpose(2, 1, 0)),
                parts[-1],
                np.array(parts[:-1]).reshape(len(components), *parts[-1].shape),
            )
        )
    present = parameters[problem.free]
    precision = 1.0 / np.square(problem.prior_sd)
    return LinearModel(tuple(blocks), precision, problem.nominal - present)


def fit(model: LinearModel, ratios: Array) -> MixedFit | None:
    """The restricted likelihood at these variance ratios; None where some V is singular.

    -2 log L = sum log|V| + log|H| + residual, H = sum J^T V^-1 J + prior (Patterson and
    Thompson 1971); score_j = (r^T P V_j P r - tr P V_j) / 2, information_jk = tr(P V_j P V_k)/2.
    """
    n, count = len(model.precision), model.components
    prior = np.sqrt(model.precision)
    R = np.column_stack([np.diag(prior), prior * model.offset])
    log_V, whitened = 0.0, []
    for block in model.blocks:
        V = block.fixed + np.tensordot(ratios, block.parts, axes=1)
        try:
            L = np.linalg.cholesky(V)
        except np.linalg.LinAlgError:
            return None
        log_V += 2.0 * float(np.log(np.einsum("brr->br", L)).sum())
        rows = np.linalg.solve(L, np.concatenate([block.J, block.e[:, :, None]], axis=2))
        parts = np.linalg.solve(L, block.parts)  # L^-1 V_j L^-T, from both sides
        parts = np.linalg.solve(L, np.swapaxes(parts, -1, -2))
        whitened.append((rows[:, :, :n], rows[:, :, n], parts))
        stacked = np.concatenate([R, rows.reshape(-1, n + 1)])
        R = np.asarray(np.linalg.qr(stacked, mode="r"))
    # R, not R^T R = H: squaring the condition would leave the criterion some seven digits
    scale = 1.0 / np.maximum(np.linalg.norm(R[:, :n], axis=0), 1e-150)
    U, values, Vt = np.linalg.svd(R[:, :n] * scale, full_matrices=False)
    kept = values > 1e-7 * values[0]
    root = scale[:, None] * Vt[kept].T / values[kept]  # H^-1 = root root^T
    along = U[:, kept].T @ R[:, n]
    dp = root @ along
    log_H = 2.0 * float(np.log(values[kept]).sum() - np.log(scale).sum())
    residual = np.linalg.norm(R[:, n] - U[:, kept] @ along)
    criterion = log_V + log_H + float(residual) ** 2
    quadratic, trace = np.zeros(count), np.zeros(count)
    inner = np.zeros((count, root.shape[1], root.shape[1]))
    pairs = np.zeros((count, count))
    for D3, E2, parts in whitened:
        B = D3 @ root
        r = E2 - D3 @ dp
        quadratic += np.einsum("br,cbrs,bs->c", r, parts, r)
        KB = parts @ B
        inner += np.einsum("bri,cbrj->cij", B, KB)
        trace += np.einsum("cbrr->c", parts)
        pairs += np.einsum("cbrs,dbrs->cd", parts, parts)
        pairs -= 2.0 * np.einsum("cbri,dbri->cd", KB, KB)
    trace -= np.einsum("cii->c", inner)
    pairs += np.einsum("cij,dij->cd", inner, inner)
    return MixedFit(criterion, 0.5 * (quadratic - trace), 0.5 * pairs, trace)

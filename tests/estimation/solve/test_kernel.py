"""The block kernel does for all poses at once what dense linear algebra does for each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import null_space

from loopcal.estimation.solve.block import Block, BlockNoise
from loopcal.estimation.solve.kernel import (
    REORTHOGONAL,
    eliminate,
    orthonormalise,
    unweighted,
    whiten,
)
from loopcal.expressions.engine import LoopValues
from loopcal.measurements.noise import CovarianceBlock, ReadingUncertainty

Array = NDArray[np.float64]
K, M, N, B = 6, 3, 4, 11
"""Quantities, loops, parameters, poses."""


@dataclass(frozen=True)
class Case:
    """A block of random poses: what the kernel is given, and the covariance of every pose."""

    values: LoopValues
    held: Block
    Sigma: Array

    def pose(self, b: int) -> tuple[Array, Array, Array, Array]:
        """f (m,), J_x (m, k), J_p (m, n) and the corrections (k,) of one pose."""
        v = self.values
        return (
            v.f[:, b],
            v.by_quantity[:, :, b].T,
            v.by_parameter[:, :, b].T,
            self.held.corrections[:, b],
        )


def random_block(kind: str, unmeasured: tuple[int, ...] = (), seed: int = 1) -> Case:
    """kind: how the noise is told: "sd", "sds by pose", "covariance", "covariances by pose"."""
    rng = np.random.default_rng(seed)
    values = LoopValues(
        rng.normal(size=(M, B)), rng.normal(size=(K, M, B)), rng.normal(size=(N, M, B))
    )
    correction = rng.normal(size=(K, B))
    by_pose = kind.endswith("by pose")
    sd = 10 ** rng.uniform(-3, 1, (K, B if by_pose else 1))
    sd[4] = 0.0  # an exact quantity
    Sigma = np.einsum("ib,ij->bij", np.broadcast_to(sd**2, (K, B)), np.eye(K))
    blocks: tuple[CovarianceBlock, ...] = ()
    if kind.startswith("covariance"):
        among = (0, 2, 3) if not unmeasured else tuple(i for i in (0, 2, 3) if i not in unmeasured)
        factor = rng.normal(size=((B,) if by_pose else ()) + (len(among), len(among)))
        blocks = (CovarianceBlock(among, factor),)
        part = factor @ np.swapaxes(factor, -1, -2)
        Sigma[:, np.array(among)[:, None], np.array(among)] = part
        sd[list(among)] = np.sqrt(np.einsum("...ii->...i", part)).T.reshape(len(among), -1)
    sd[list(unmeasured)] = np.inf
    measured = tuple(i for i in range(K) if i not in unmeasured)
    noise = BlockNoise(ReadingUncertainty(sd, blocks), unmeasured, measured)
    none, zeros = np.zeros((0, B)), np.zeros_like(correction)
    held = Block(slice(0, B), np.zeros(0), zeros, correction, none, noise)
    return Case(values, held, Sigma)


KINDS = ["sd", "sds by pose", "covariance", "covariances by pose"]


@pytest.mark.parametrize("kind", KINDS)
def test_whitening_is_the_inverse_cholesky_factor_of_each_pose(kind: str) -> None:
    block = random_block(kind)
    white = whiten(block.values, block.held)
    assert not white.singular.any()
    for b in range(B):
        f, J, J_p, c = block.pose(b)
        L = np.linalg.cholesky(J @ block.Sigma[b] @ J.T)
        assert pytest.approx(np.linalg.solve(L, J_p), rel=1e-9, abs=1e-9) == white.D[:, :, b].T
        assert white.E[:, b] == pytest.approx(np.linalg.solve(L, J @ c - f), rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("unmeasured", [(), (1,), (0, 5), (0, 1)])
@pytest.mark.parametrize("kind", KINDS)
def test_eliminating_is_projecting_onto_the_left_null_space(
    kind: str, unmeasured: tuple[int, ...]
) -> None:
    block = random_block(kind, unmeasured)
    white = whiten(block.values, block.held)
    assert white.D.shape == (N, M - len(unmeasured), B)
    measured = list(block.held.noise.measured)
    for b in range(B):
        f, J, J_p, c = block.pose(b)
        free = null_space(J[:, list(unmeasured)].T) if unmeasured else np.eye(M)
        loads = free.T @ J[:, measured]
        weight = np.linalg.inv(loads @ block.Sigma[b][np.ix_(measured, measured)] @ loads.T)
        A, e = free.T @ J_p, loads @ c[measured] - free.T @ f
        D, E = white.D[:, :, b].T, white.E[:, b]
        # a basis of the null space is arbitrary, what it leads to is not
        assert pytest.approx(A.T @ weight @ A, rel=1e-8, abs=1e-8) == D.T @ D
        assert pytest.approx(A.T @ weight @ e, rel=1e-8, abs=1e-8) == D.T @ E
        assert pytest.approx(e @ weight @ e, rel=1e-8) == E @ E


@pytest.mark.parametrize("unmeasured", [(), (1,), (0, 5)])
@pytest.mark.parametrize("kind", KINDS)
def test_corrections_are_the_least_that_close_the_linearised_loops(
    kind: str, unmeasured: tuple[int, ...]
) -> None:
    block = random_block(kind, unmeasured)
    white = whiten(block.values, block.held)
    for b in range(B):
        f, J, _, c = block.pose(b)
        new = white.correction[:, b]
        assert f + J @ (new - c) == pytest.approx(np.zeros(M), abs=1e-9)
        assert new[4] == 0.0  # exact quantities are not corrected
        # least: Sigma^-1 new = J^T multipliers, so new = Sigma J^T multipliers, with
        # J_unmeasured^T multipliers = 0
        measured, loose = list(block.held.noise.measured), list(unmeasured)
        part = block.Sigma[b][np.ix_(measured, measured)] @ J[:, measured].T
        stacked = np.vstack([part, J[:, loose].T])
        wanted = np.concatenate([new[measured], np.zeros(len(loose))])
        scale = 1 / np.maximum(abs(stacked).max(axis=1), 1e-300)
        multipliers = np.linalg.lstsq(stacked * scale[:, None], wanted * scale)[0]
        assert (stacked @ multipliers - wanted) * scale == pytest.approx(
            np.zeros(len(wanted)), abs=1e-8
        )
        if not unmeasured:
            square = _square(new, block.Sigma[b])
            assert white.E[:, b] @ white.E[:, b] == pytest.approx(square, rel=1e-8)


def _square(correction: Array, Sigma: Array) -> float:
    """c^T Sigma^-1 c over what is uncertain."""
    uncertain = np.flatnonzero(np.diag(Sigma))
    part = Sigma[np.ix_(uncertain, uncertain)]
    return float(correction[uncertain] @ np.linalg.solve(part, correction[uncertain]))


def test_a_loop_without_anything_uncertain_is_marked_singular() -> None:
    block = random_block("sd")
    by_quantity = block.values.by_quantity.copy()
    by_quantity[:4, 1, 3] = by_quantity[5, 1, 3] = 0.0  # only the exact quantity is left
    values = LoopValues(block.values.f, by_quantity, block.values.by_parameter)
    white = whiten(values, block.held)
    assert np.flatnonzero(white.singular).tolist() == [3]


def test_two_loops_that_say_the_same_are_marked_singular() -> None:
    block = random_block("sds by pose")
    by_quantity = block.values.by_quantity.copy()
    by_quantity[:, 2, 5] = 3.0 * by_quantity[:, 0, 5]
    values = LoopValues(block.values.f, by_quantity, block.values.by_parameter)
    white = whiten(values, block.held)
    assert np.flatnonzero(white.singular).tolist() == [5]


def test_exact_sensors_leave_the_loops_unweighted() -> None:
    block = random_block("sd")
    plain = unweighted(block.values, block.held)
    assert plain.D.tolist() == block.values.by_parameter.tolist()
    assert plain.E.tolist() == (-block.values.f).tolist()
    assert plain.correction.tolist() == block.held.corrections.tolist()


def test_exact_sensors_with_an_unmeasured_quantity_find_it_by_least_squares() -> None:
    block = random_block("sd", unmeasured=(1, 3))
    plain = unweighted(block.values, block.held)
    for b in range(B):
        f, J, J_p, c = block.pose(b)
        loose = J[:, [1, 3]]
        step, *_ = np.linalg.lstsq(loose, -f)
        assert plain.correction[[1, 3], b] - c[[1, 3]] == pytest.approx(step, rel=1e-9)
        projector = np.eye(M) - loose @ np.linalg.pinv(loose)
        D, E = plain.D[:, :, b].T, plain.E[:, b]
        assert pytest.approx(J_p.T @ projector @ J_p, rel=1e-9, abs=1e-12) == D.T @ D
        assert pytest.approx(-J_p.T @ projector @ f, rel=1e-9, abs=1e-12) == D.T @ E


@pytest.mark.parametrize("spread", [0, 5, 10])
def test_rows_become_orthonormal_though_their_lengths_differ_by_ten_decades(spread: int) -> None:
    rng = np.random.default_rng(2)
    original = rng.normal(size=(4, 9, 50)) * 10.0 ** np.linspace(0, -spread, 4)[:, None, None]
    # and columns, as where one sensor is that much better
    original *= 10.0 ** np.linspace(0, spread, 9)[None, :, None]
    orthonormal_after(original, 1e-12)


@pytest.mark.parametrize("angle", [1e-2, 1e-4, 1e-6, 1e-9])
def test_rows_become_orthonormal_though_they_are_nearly_parallel(angle: float) -> None:
    rng = np.random.default_rng(3)
    original = rng.normal(size=(3, 7, 50))
    original[1] = original[0] + angle * original[1]
    orthonormal_after(original, 1e-12)


def test_rows_become_orthonormal_though_three_nearly_span_a_line() -> None:
    """The worst that one sweep leaves: each row just above what would be swept again."""
    rng = np.random.default_rng(3)
    original = rng.normal(size=(3, 7, 500))
    small = 2 * REORTHOGONAL
    original[1] = original[0] + small * original[1]
    original[2] = original[0] - original[1] + small**2 * original[2]
    orthonormal_after(original, float(np.finfo(float).eps) / REORTHOGONAL**2)


def orthonormal_after(original: Array, tolerance: float) -> None:
    Q = original.copy()
    L, singular = orthonormalise(Q)
    L = np.tril(L.transpose(2, 0, 1))
    assert not singular.any()
    Q = Q.transpose(2, 0, 1)
    assert abs(Q @ Q.transpose(0, 2, 1) - np.eye(Q.shape[1])).max() <= tolerance
    rows = original.transpose(2, 0, 1)
    assert np.all(abs(L @ Q - rows).max(axis=2) <= 1e-14 * abs(rows).max(axis=2))


def test_reflections_triangularise_and_keep_lengths() -> None:
    rng = np.random.default_rng(4)
    columns, part = rng.normal(size=(2, 5, 20)), rng.normal(size=(3, 5, 20))
    reflections = eliminate(columns)
    turned = reflections.apply(columns)
    assert turned[0, 1:] == pytest.approx(np.zeros((4, 20)), abs=1e-14)
    assert turned[1, 2:] == pytest.approx(np.zeros((3, 20)), abs=1e-14)
    lengths = np.square(reflections.apply(part)).sum(axis=1)
    assert lengths == pytest.approx(np.square(part).sum(axis=1), rel=1e-14)
    right = rng.normal(size=(2, 20))
    solved = reflections.solve(right)
    for b in range(20):
        assert turned[:, :2, b].T @ solved[:, b] == pytest.approx(right[:, b], abs=1e-12)


def test_a_quantity_that_the_loops_of_a_pose_do_not_contain_stays_where_it_is() -> None:
    columns = np.random.default_rng(5).normal(size=(2, 3, 4))
    columns[1, :, 2] = 0.0
    solved = eliminate(columns).solve(np.ones((2, 4)))
    assert solved[1, 2] == 0.0
    assert np.all(np.isfinite(solved))
    assert np.all(solved[:, [0, 1, 3]] != 0.0)

"""Images are whitened without the cube of their rows, to what the dense covariance gives."""

from __future__ import annotations

import numpy as np
import pytest

from loopcal.estimation.noise.linear_model import LinearModel, ModelBlock, whitened


def block(spread: float, fixed: float = 0.0) -> ModelBlock:
    """Five images of 40 rows, which six loadings share, of two components of corners."""
    random = np.random.default_rng(3)
    b, r, k, n = 5, 40, 6, 4
    shared = spread * random.standard_normal((b, r, k))
    alone = np.broadcast_to(np.eye(r)[random.permutation(r)].T, (b, r, r))
    owner = np.array([0] * 3 + [1] * 3 + [2] * 15 + [3] * 25)
    V_0 = np.broadcast_to(fixed * np.eye(r), (b, r, r))
    G = np.concatenate([shared, alone], axis=2)
    return ModelBlock(random.standard_normal((b, r, n + 1)), V_0, G, owner)


@pytest.mark.parametrize("spread", [1e-3, 1.0, 1e3])
def test_products_and_volume_are_those_of_the_dense_covariance(spread: float) -> None:
    ratios = np.array([0.7, 2.0, 0.3, 1.4])
    one = block(spread)
    assert one.alone is not None
    joined = whitened(LinearModel((one,), np.zeros(4), np.zeros(4), np.full(4, np.inf)), ratios)
    assert joined is not None
    V = (one.G * ratios[one.owner]) @ one.G.transpose(0, 2, 1)
    X = np.concatenate([one.rows, one.G], axis=2)
    expected = X.transpose(0, 2, 1) @ np.linalg.solve(V, X)
    (rows,), (W,) = joined.rows, joined.W
    both = np.concatenate([rows, W], axis=2)
    np.testing.assert_allclose(
        both.transpose(0, 2, 1) @ both, expected, rtol=1e-7, atol=1e-9 * np.abs(expected).max()
    )
    assert joined.volume == pytest.approx(float(np.linalg.slogdet(V)[1].sum()), rel=1e-9)


def test_other_covariances_are_dense() -> None:
    assert block(1.0, fixed=0.1).alone is None
    assert (
        ModelBlock(np.ones((2, 3, 2)), np.zeros((2, 3, 3)), np.ones((2, 3, 3)), np.arange(3)).alone
        is None
    )

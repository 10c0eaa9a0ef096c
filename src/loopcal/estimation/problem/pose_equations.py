"""The equations of every pose at a solution, whitened, with what each reading does to them.

    E = D dp + v,   v ~ N(0, 1),   and a reading that is wrong by d moves E by -X d,

after elimination of unmeasured quantities: D = T J_p, X = T J_x, T the whitening of the kernel.

An image has far more equations than anything but its own pixels acts on. By their triangle
(Golub 1965) it keeps one for each parameter, shared reading and mode of its pixels, and one for E.
In all others a pixel counts by its square alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.estimation.problem.error_modes import image_modes
from loopcal.estimation.problem.problem import Problem, Weighting
from loopcal.estimation.solve.block import Block
from loopcal.estimation.solve.kernel import TurnedImages
from loopcal.estimation.solve.sweep import Sweeper

_ROUNDING = 4.0 * np.finfo(np.float64).eps
"""Of each reading, as a share: so much of what an equation leaves is arithmetic."""


@dataclass(frozen=True)
class Beside:
    """The equations of images that are left out, where no more than their own pixels act.

    rows: equations of an image, those kept with them; count: (b,) those of pixels that were read;
    squares: (b, k) of what each reading does to the ones left out [1/SI^2].
    """

    rows: int
    count: NDArray[np.intp]
    squares: Array


@dataclass(frozen=True)
class PoseEquations:
    """b poses with r equations each, n parameters and k quantities.

    poses: (b,) positions; E: (b, r); D: (b, r, n) [1/SI]; X: (b, r, k) [1/SI]; beside: of images.
    """

    poses: NDArray[np.intp]
    E: Array
    D: Array
    X: Array
    beside: Beside | None = None

    @property
    def count(self) -> NDArray[np.intp]:
        """(b,) equations that say anything: corners that were not detected leave zeros."""
        if self.beside is not None:
            return self.beside.count
        counts: NDArray[np.intp] = self.X.any(axis=2).sum(axis=1)
        return counts

    @property
    def rows(self) -> int:
        """Equations of a pose, those left out with them."""
        return self.E.shape[1] if self.beside is None else self.beside.rows

    @property
    def squares(self) -> Array:
        """(b, k) of what each reading does to all equations [1/SI^2]."""
        squares: Array = np.square(self.X).sum(axis=1)
        return squares if self.beside is None else squares + self.beside.squares


def pose_equations(
    problem: Problem, parameters: Array, corrections: Array, modes: Array | None = None
) -> tuple[PoseEquations, ...]:
    """The equations at parameters (n_all,) and corrections (k, N) that close the loops there.

    Whitened as the problem weighs them: loop values as they are where all count alike, D where the
    readings stand for the reweighted fit. modes: (k, q) of pixels that the equations of images
    keep, by default those of this problem.
    """
    sweeper, as_read = Sweeper(problem), problem.weighting is Weighting.READ
    everything = np.arange(len(problem.poses))
    modes = image_modes(problem) if modes is None else modes
    equations = []
    for pattern, block in sweeper.blocks(parameters, corrections):
        J_p = sweeper.loop_values(pattern, block.read).by_parameter.copy() if as_read else None
        values = sweeper.loop_values(pattern, block)
        J_p = values.by_parameter if J_p is None else J_p
        poses = everything[block.poses]
        if pattern.predicted:
            turned = TurnedImages.of(values, block, exact=sweeper.alike)
            equations.append(_of_images(poses, turned, values.by_quantity, J_p, block, modes))
            continue
        # The kernel whitens what stands as derivatives: of the identity it makes T itself.
        identity = np.repeat(np.eye(len(pattern.loops))[:, :, None], block.count, axis=2)
        whitened = sweeper.reduce(replace(values, by_parameter=identity), block)
        T = whitened.D
        equations.append(
            PoseEquations(
                poses,
                whitened.E.T.copy(),
                T.transpose(2, 1, 0) @ J_p.transpose(2, 1, 0),
                np.asarray(np.einsum("crb,kcb->brk", T, values.by_quantity)),
            )
        )
    return tuple(equations)


def _of_images(
    poses: NDArray[np.intp],
    turned: TurnedImages,
    J: Array,
    J_p: Array,
    block: Block,
    modes: Array,
) -> PoseEquations:
    """Of images, with modes (k, q) of their pixels."""
    predicted, unmeasured = list(block.noise.predicted), set(block.noise.unmeasured)
    others = [i for i in range(len(J)) if i not in unmeasured and i not in set(predicted)]
    moved = modes[predicted].T[:, :, None] * turned.slope
    columns = np.concatenate([J_p, J[others], turned.misclosure[None], moved])
    rows = turned.left(columns).transpose(2, 1, 0)
    if rows.shape[1] > rows.shape[2]:
        Q, rows = np.linalg.qr(rows)
    else:
        Q = np.broadcast_to(np.eye(rows.shape[1]), (len(rows), *2 * rows.shape[1:2]))
    n, more = len(J_p), len(J_p) + len(others)
    X = np.zeros((*rows.shape[:2], len(J)))
    X[:, :, predicted], X[:, :, others] = turned.effects(Q), rows[:, :, n:more]
    squares = np.zeros((len(rows), len(J)))
    kept = np.square(X[:, :, predicted]).sum(axis=1)
    squares[:, predicted] = np.maximum(turned.squares - kept, 0.0)
    count = (turned.weight > 0.0).sum(axis=0) - turned.unmeasured
    beside = Beside(len(turned.slope) - turned.unmeasured, count, squares)
    return PoseEquations(poses, rows[:, :, more].copy(), rows[:, :, :n].copy(), X, beside)


def rounding_left(problem: Problem, equations: Sequence[PoseEquations]) -> float:
    """Mean square that rounding of the readings leaves in an equation: what is smaller says nothing
    of sensors or poses."""
    total, count = 0.0, 0
    readings = np.nan_to_num(np.abs(problem.readings))
    for block in equations:
        left = _ROUNDING * np.einsum("brk,kb->br", np.abs(block.X), readings[:, block.poses])
        total, count = total + float(np.square(left).sum()), count + left.size
        if block.beside is not None:
            left_out = block.beside.squares * np.square(_ROUNDING * readings[:, block.poses].T)
            total, count = total + float(left_out.sum()), count + int(block.count.sum()) - left.size
    return total / max(count, 1)

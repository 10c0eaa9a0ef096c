"""Ceres on images: lens, hand and board one block, the flange's pose of each image another."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import images
import numpy as np
import pyceres
from numpy.typing import NDArray
from pyceres_costs import Enough
from scipy.spatial.transform import Rotation

if TYPE_CHECKING:
    from images import Shots

Array = NDArray[np.float64]
_CROSS = np.zeros((3, 3, 3))
for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
    _CROSS[i, j, k], _CROSS[i, k, j] = 1.0, -1.0


def _crossed(v: Array) -> Array:
    """[v] (..., 3, 3) with [v] w = v x w."""
    return np.asarray(np.einsum("ijk,...j->...ik", _CROSS, v))


def _turned(w: Array) -> tuple[Array, Array]:
    """exp [w], and Jr with exp [w + d] = exp [w] exp [Jr d] to first order (Chirikjian 2012)."""
    size = float(np.linalg.norm(w))
    K = _crossed(w)
    if size < 1e-6:
        return Rotation.from_rotvec(w).as_matrix(), np.eye(3) - 0.5 * K + K @ K / 6.0
    Jr = np.eye(3) - (1.0 - np.cos(size)) / size**2 * K
    Jr = Jr + (size - np.sin(size)) / size**3 * (K @ K)
    return Rotation.from_rotvec(w).as_matrix(), Jr


class Image(pyceres.CostFunction):  # type: ignore[misc] # has no types
    """All corners of one image beside those that were measured, in sds.

    The blocks: lens (9), and shift and turn of camera and board (12) beside their start; shift and
    turn (6) of the flange beside its reading.
    """

    def __init__(self, shot: Shots, number: int, start: tuple[Array, Array], sd: float) -> None:
        super().__init__()
        self.set_num_residuals(shot.pixels[number].size)
        self.set_parameter_block_sizes([21, 6])
        self.points, self.measured, self.sd = shot.points, shot.pixels[number], sd
        self.read, (self.hand, self.board) = shot.flange[number], start
        self.seconds = 0.0

    def Evaluate(self, parameters: list[Array], residuals: Array, jacobians: Any) -> bool:
        """Write residuals and, where asked for, derivatives row by row."""
        begun = time.process_time()
        self._evaluate(parameters[0], parameters[1], residuals, jacobians)
        self.seconds += time.process_time() - begun
        return True

    def _evaluate(self, common: Array, own: Array, residuals: Array, jacobians: Any) -> None:
        turns = [_turned(w) for w in (common[12:15], common[18:21], own[3:])]
        starts = (self.hand, self.board, self.read)
        Rc, Ro, Ri = (T[:3, :3] @ R for T, (R, _) in zip(starts, turns, strict=True))
        shifts = common[9:12], common[15:18], own[:3]
        tc, to, ti = (T[:3, 3] + d for T, d in zip(starts, shifts, strict=True))
        base = self.points @ Ro.T + to
        flange = (base - ti) @ Ri
        P = (flange - tc) @ Rc
        pixels, by_point, by_lens = images.projected(P, common[:9])
        residuals[:] = ((pixels - self.measured) / self.sd).ravel()
        if jacobians is None:
            return
        by_flange = by_point @ Rc.T
        by_base = by_flange @ Ri.T
        # Of x = R^T v, R = R_0 exp [w]: dx = [x] Jr dw; of x = R v: dx = -R [v] Jr dw.
        hand = by_point @ _crossed(P) @ turns[0][1]
        board = -by_base @ (Ro @ _crossed(self.points)) @ turns[1][1]
        turned = by_flange @ _crossed(flange) @ turns[2][1]
        of_common = np.concatenate([by_lens, -by_flange, hand, by_base, board], axis=2)
        of_own = np.concatenate([-by_base, turned], axis=2)
        for wanted, columns in zip(jacobians, (of_common, of_own), strict=True):
            if wanted is not None:
                wanted[:] = (columns / self.sd).ravel()


def calibrated(shot: Shots, lens: Array, flange: float, pixel: float) -> tuple[Array, float]:
    """(21,) lens, and shift and turn (z, y, x) of T_flange_camera and T_board_base; and seconds of
    callbacks.

    Begins at this lens and a little off the true places; raises RuntimeError where Ceres does not
    converge.
    """
    off = images.rigid(Rotation.from_rotvec([0.02, -0.01, 0.01]), [0.01, -0.01, 0.01])
    start = shot.hand @ off, shot.board @ off
    common, whole, costs = np.concatenate([lens, np.zeros(12)]), pyceres.Problem(), []
    seen: list[Image] = []
    each = [np.zeros(6) for _ in shot.flange]
    prior = flange**2 * np.eye(6)
    for i, own in enumerate(each):
        image, known = Image(shot, i, start, pixel), pyceres.factors.NormalPrior(np.zeros(6), prior)
        whole.add_residual_block(known, None, [own])
        whole.add_residual_block(image, None, [common, own])
        seen.append(image)
        costs.append(known)  # Ceres does not keep them alive
    options, enough = pyceres.SolverOptions(), Enough()
    options.linear_solver_type = pyceres.LinearSolverType.SPARSE_SCHUR
    options.function_tolerance = options.parameter_tolerance = options.gradient_tolerance = 0.0
    options.callbacks, options.num_threads = [enough], 1
    summary = pyceres.SolverSummary()
    pyceres.solve(options, whole, summary)
    ends = pyceres.TerminationType
    if summary.termination_type not in (ends.USER_SUCCESS, ends.CONVERGENCE):
        raise RuntimeError(f"Ceres did not converge: {summary.message}")
    hand, board = (
        images.rigid(
            Rotation.from_matrix(T[:3, :3]) * Rotation.from_rotvec(common[at + 3 : at + 6]),
            T[:3, 3] + common[at : at + 3],
        )
        for T, at in zip(start, (9, 15), strict=True)
    )
    places = [hand, np.linalg.inv(board)]
    turns = [Rotation.from_matrix(T[:3, :3]).as_euler("ZYX") for T in places]
    each_place = [np.concatenate([T[:3, 3], w]) for T, w in zip(places, turns, strict=True)]
    return np.concatenate([common[:9], *each_place]), sum(image.seconds for image in seen)

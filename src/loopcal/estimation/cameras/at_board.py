"""What images say of the place of a board: how large a pixel is there, and where they put it.

The body moves by a shift d (3,) [m] in the machine's base frame. It moves the pixels of an image by
G d, G (2n, 3), which is f / Z across the line of sight and nearly nothing along it. Of pixels
computed minus measured, r (2n,) with the weights W of corners, the images put the body at

    d = -(G^T W G)^-1 G^T W r

from where the machine puts it, turned as the machine turns it. With W the inverse variances,
(G^T W G)^-1 is the covariance that the noise of corners alone gives d. Its largest direction is the
line of sight of a camera; a shift along it only changes the size of the board in the image.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from loopcal.arrays import Array
from loopcal.document.accuracy import BoardPlace, PixelSize
from loopcal.estimation.accuracy import Accuracy
from loopcal.estimation.problem.problem import Problem, Weighting
from loopcal.expressions.engine import Stage, engine_for
from loopcal.mechanisms.mechanism import PIXELS, Family, Mechanism

_MOST = 512
"""Poses in a block: images have many loops."""
# Chosen, not derived: far above rounding, far below (board's size / distance)^2 / 12.
_FLAT = 1e-9
"""Share of the information across the line of sight below which there is none along it."""


@dataclass(frozen=True, eq=False)
class Sight:
    """Where the images of one camera put the body, or those of all cameras (instrument None).

    slopes: (N, 3, c) shift [m] across the line of sight, twice, and along it, by each of what the
    mechanism compares; noise: (N, 3) its sd from the noise of corners alone, None where that is not
    known. NaN where an image does not say it.
    """

    instrument: str | None
    slopes: Array
    noise: Array | None

    def place(self, differences: Array) -> BoardPlace | None:
        """From computed minus measured (c, N) [SI]; None where no image has any."""
        seen = np.isfinite(differences)
        shift = np.einsum("nic,cn->ni", self.slopes, np.where(seen, differences, 0.0))
        used = np.nan_to_num(self.slopes[:, 0]).astype(bool) & seen.T
        shift[~used.any(axis=1)] = np.nan
        across = _rms(shift[:, :2], axis=1)
        if across is None:
            return None
        position = Accuracy.of(np.linalg.norm(shift, axis=1), "m")
        by_noise = shift * np.nan if self.noise is None else self.noise + 0.0 * shift
        return BoardPlace(
            self.instrument,
            None if position is None else position.distances,
            across,
            _rms(shift[:, 2:], axis=1),
            _rms(by_noise[:, :2], axis=1),
            _rms(by_noise[:, 2:], axis=1),
        )

    def sds(self, covariance: Array) -> Array:
        """(N,) sd in space [m] of the body by the covariance (N, c, c) of what is compared."""
        shared = ((self.slopes @ covariance) * self.slopes).sum(axis=(1, 2))
        return np.asarray(np.sqrt(np.maximum(shared, 0.0)))


def _rms(values: Array, axis: int) -> float | None:
    """Of the lengths along an axis; None where all are NaN."""
    squares = np.square(values).sum(axis=axis)
    squares = squares[np.isfinite(squares)]
    return float(np.sqrt(squares.mean())) if squares.size else None


def sights(problem: Problem, parameters: Array, corrections: Array) -> tuple[Sight, ...]:
    """By camera, and of all together where several see one body, at the corrected readings.

    parameters: (n_all,); corrections: (k, N). None where only the images say where the body is.
    """
    mechanism, names = problem.mechanism, problem.mechanism.tape.quantities
    cameras = _cameras(mechanism)
    sd = np.broadcast_to(problem.uncertainty.sd, problem.readings.shape)
    pixels = {q for camera in cameras for q in camera.readings}
    others = {*names} - pixels - {*mechanism.disturbances} - mechanism.unused
    driven = any(np.isfinite(sd[names.index(q)]).any() for q in others)
    if not cameras or not driven:
        return ()
    weighed = problem.weighting is not Weighting.ALIKE and all(
        (sd[names.index(q)] > 0.0).all() for q in pixels
    )
    x = problem.readings + corrections
    G = _slopes(mechanism, parameters, x, problem.pose_constants)
    made = []
    groups: list[tuple[str | None, tuple[str, ...]]] = [(c.name, c.readings) for c in cameras]
    if len(cameras) > 1 and len({_moving(mechanism, camera) for camera in cameras}) == 1:
        groups.append((None, tuple(pixels)))
    for instrument, readings in groups:
        weights = np.zeros((problem.count, G.shape[1]))
        for q in readings:
            row = sd[names.index(q)]
            weight = 1.0 / np.square(row) if weighed else np.isfinite(row).astype(float)
            weights[:, mechanism.compared.index(q)] = weight
        slopes, noise = _placed(G, weights)
        made.append(Sight(instrument, slopes, noise if weighed else None))
    return tuple(made)


def sight_of(
    mechanism: Mechanism, instrument: str, parameters: Array, x: Array, constants: Array
) -> Sight:
    """Of one camera that sees every point of its board, at readings x (k, N)."""
    readings = next(f.readings for f in _cameras(mechanism) if f.name == instrument)
    weights = np.isin(mechanism.compared, readings).astype(float)
    G = _slopes(mechanism, parameters, x, constants)
    slopes, _ = _placed(G, np.broadcast_to(weights, G.shape[:2]))
    return Sight(instrument, slopes, None)


def _placed(G: Array, weights: Array) -> tuple[Array, Array]:
    """Slopes (N, 3, c) and noise (N, 3) from G (N, c, 3) and weights (N, c), along the principal
    directions of the information, the least known last."""
    weighted = G * weights[:, :, None]
    information = np.nan_to_num(np.swapaxes(weighted, 1, 2) @ G)
    size, axes = np.linalg.eigh(information)
    size, axes = size[:, ::-1], axes[:, :, ::-1]
    size = np.where(size > _FLAT * size[:, :1], size, np.nan)
    slopes = -np.swapaxes(weighted @ axes, 1, 2) / size[:, :, None]
    return slopes, np.sqrt(1.0 / size)


def _cameras(mechanism: Mechanism) -> list[Family]:
    """What reads images of a body that can be displaced."""
    return [f for f in mechanism.families if f.form == PIXELS and mechanism.body is not None]


def _moving(mechanism: Mechanism, camera: Family) -> str:
    """The body whose shift a camera sees: what is fixed to the ground is seen from a moving body,
    whose own shift does as much."""
    assert mechanism.body is not None
    return camera.on if camera.on in mechanism.body.displacements else camera.against


def _slopes(mechanism: Mechanism, parameters: Array, x: Array, constants: Array) -> Array:
    """G (N, c, 3) [px/m] of what is compared, zero for what is no pixel."""
    body = mechanism.body
    assert body is not None
    cameras, loops = _cameras(mechanism), body.tape.loops
    shifts = {c.name: body.displacements[_moving(mechanism, c)][0][:3] for c in cameras}
    asked = tuple(dict.fromkeys(name for names in shifts.values() for name in names))
    stated = dict(zip(mechanism.parameters.names, parameters.tolist(), strict=True))
    values = np.array([stated.get(name, 0.0) for name in body.tape.parameters])
    engine = engine_for(body.tape, asked, min(_MOST, x.shape[1]), ())
    G = np.zeros((x.shape[1], len(mechanism.compared), 3))
    for begin in range(0, x.shape[1], _MOST):
        part = slice(begin, begin + _MOST)
        by_shift = engine.evaluate(values, x[:, part], constants[:, part], Stage.BY_PARAMETER)
        for camera in cameras:
            rows = [loops.index(q) for q in camera.readings]
            columns = [mechanism.compared.index(q) for q in camera.readings]
            along = [asked.index(name) for name in shifts[camera.name]]
            G[part, np.array(columns)] = by_shift.by_parameter[along][:, rows].T
    return G


def pixel_sizes(problem: Problem, parameters: Array, corrections: Array) -> tuple[PixelSize, ...]:
    """By camera, root mean square [m] over all corners of what a pixel is at the board.

    |G|^2 of a corner, (2, 3), is 2 (f / Z)^2 nearly, so a pixel is sqrt(2) / |G| there.
    """
    mechanism, names = problem.mechanism, problem.mechanism.tape.quantities
    cameras = _cameras(mechanism)
    if not cameras:
        return ()
    x = problem.readings + corrections
    G = _slopes(mechanism, parameters, x, problem.pose_constants)
    seen = np.isfinite(np.broadcast_to(problem.uncertainty.sd, x.shape))
    sizes = []
    for camera in cameras:
        u, v = camera.readings[0::2], camera.readings[1::2]
        square = sum(
            np.square(G[:, [mechanism.compared.index(q) for q in one]]).sum(axis=2)
            for one in (u, v)
        )
        detected = seen[[names.index(q) for q in u]].T & (square > 0.0)
        if detected.any():
            size = float(np.sqrt((2.0 / square[detected]).mean()))
            sizes.append(PixelSize(camera.name, size))
    return tuple(sizes)

"""How large a pixel is at the board that a camera sees."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from loopcal.document.accuracy import PixelSize
from loopcal.estimation.problem.problem import Problem
from loopcal.expressions.engine import Stage, engine_for
from loopcal.mechanisms.mechanism import PIXELS

Array = NDArray[np.float64]
_MOST = 512
"""Poses in a block: images have many loops."""


def pixel_sizes(problem: Problem, parameters: Array, corrections: Array) -> tuple[PixelSize, ...]:
    """By camera, root mean square [m] over all corners of what a pixel is at the board.

    A shift of the board by d moves a pixel by G d, G (2, 3): f / Z across the line of sight and
    nothing along it. |G|^2 = 2 (f / Z)^2 nearly, so a pixel is sqrt(2) / |G| there.
    """
    mechanism, body = problem.mechanism, problem.mechanism.body
    cameras = [f for f in mechanism.families if f.form == PIXELS]
    if body is None or not cameras:
        return ()
    # What is fixed to the ground is seen from a moving body, whose own shift does as much.
    moving = {f.name: f.on if f.on in body.displacements else f.against for f in cameras}
    shifts = {name: body.displacements[of][0][:3] for name, of in moving.items()}
    asked = tuple(dict.fromkeys(name for names in shifts.values() for name in names))
    values = np.concatenate([parameters, np.zeros(len(body.tape.parameters) - len(parameters))])
    x = problem.readings + corrections
    seen = np.isfinite(np.broadcast_to(problem.uncertainty.sd, problem.readings.shape))
    names, loops = mechanism.tape.quantities, body.tape.loops
    squares: dict[str, list[Array]] = {camera.name: [] for camera in cameras}
    engine = engine_for(body.tape, asked, min(_MOST, problem.count))
    for begin in range(0, problem.count, _MOST):
        part = slice(begin, begin + _MOST)
        G = engine.evaluate(
            values, x[:, part], problem.pose_constants[:, part], Stage.BY_PARAMETER
        ).by_parameter
        for camera in cameras:
            rows = [loops.index(q) for q in camera.readings]
            along = [asked.index(name) for name in shifts[camera.name]]
            square = np.square(G[along][:, rows]).sum(axis=0)
            both = square[0::2] + square[1::2]
            detected = seen[[names.index(q) for q in camera.readings[0::2]], part]
            squares[camera.name].append((2.0 / both)[detected & (both > 0.0)])
    return tuple(
        PixelSize(name, float(np.sqrt(np.concatenate(some).mean())))
        for name, some in squares.items()
        if sum(map(len, some))
    )

"""Which images a camera can take: the board in front of it, in the image, and not too tilted."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.chain import frames, product
from loopcal.mechanisms.mechanism import PIXELS, Family, Mechanism
from loopcal.mechanisms.placement import inverse
from loopcal.mechanisms.station import Station

Array = NDArray[np.float64]
TILT = math.radians(60.0)
"""Most that a board is turned away from the camera: detectors lose corners beyond."""


def faces(mechanism: Mechanism, joints: Dataset) -> NDArray[np.bool_]:
    """(N,) whether some camera has a board before it, towards its image and tilted by at most
    `TILT`; the print is on the side of the board that most of these poses show."""
    seen = np.zeros(len(joints), dtype=bool)
    for family in _cameras(mechanism):
        seen |= _faces(mechanism, family, joints)
    return seen if _cameras(mechanism) else ~seen


def in_image(mechanism: Mechanism, data: Dataset) -> NDArray[np.bool_]:
    """(N,) whether some camera has all of a board in its image, twice as large as its principal
    point is from its corner."""
    values = {p.name: p.nominal for p in mechanism.parameters}
    inside = np.zeros(len(data), dtype=bool)
    for family in _cameras(mechanism):
        eye = family.readings[0].split(":")[0]
        size = 2.0 * np.array([values[f"{eye}_cx"], values[f"{eye}_cy"]])[:, None]
        pixels = np.array([data.readings[q] for q in family.readings]).reshape(-1, 2, len(data))
        inside |= ((pixels > 0.0) & (pixels < size)).all(axis=(0, 1))
    return inside if _cameras(mechanism) else ~inside


def _cameras(mechanism: Mechanism) -> list[Family]:
    return [f for f in mechanism.families if f.form == PIXELS] if mechanism.chain else []


def _faces(mechanism: Mechanism, family: Family, joints: Dataset) -> NDArray[np.bool_]:
    eye, board = family.readings[0].split(":")[:2]
    values = {p.name: p.nominal for p in mechanism.parameters}
    *_, (R, origin) = frames(mechanism.chain, joints.readings, values)
    T = np.tile(np.eye(4), (len(joints), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = R, origin
    eyes, boards = (product(Station(name).steps, {}, values) for name in (eye, board))
    on_base = isinstance(family.placement, Station) and family.placement.name == eye
    M = eyes @ T @ boards if on_base else inverse(boards @ T @ eyes)
    half = np.array([values[f"{eye}_cx"], values[f"{eye}_cy"]]) / values[f"{eye}_f"]
    ahead = M[:, 2, 3] > 0.0
    ahead &= (np.abs(M[:, :2, 3]) < half * M[:, 2, 3, None]).all(axis=1)
    side = 1.0 if (M[ahead, 2, 2] > 0.0).mean() > 0.5 else -1.0
    return np.asarray(ahead & (side * M[:, 2, 2] > math.cos(TILT)))

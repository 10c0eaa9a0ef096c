"""Which images a camera can take: the board in front of it, in the image, and not too tilted."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.instruments.camera import all_cameras, boards_in_camera
from loopcal.mechanisms.mechanism import PIXELS, Family, Mechanism

Mask = NDArray[np.bool_]
TILT = math.radians(60.0)
"""Most that a board is turned away from the camera: detectors lose corners beyond."""


def shown(mechanism: Mechanism, serves: Mask, seen: Mapping[str, Mask]) -> tuple[Mask, Mask]:
    """(F, N) the families that poses serve where cameras see so much; and (N,) the poses with a
    camera that sees its board, and those without any camera."""
    serves = serves.copy()
    rows = [i for i, family in enumerate(mechanism.families) if family.name in seen]
    due = serves[rows].any(axis=0)
    for i in rows:
        serves[i] &= seen[mechanism.families[i].name]
    return serves, np.asarray(~due | serves[rows].any(axis=0))


def faces(mechanism: Mechanism, joints: Dataset) -> dict[str, Mask]:
    """By camera (N,) whether it has its board before it, towards its image and tilted by at most
    `TILT`; the print is on the side of the board that most of these poses show."""
    return {f.name: _faces(mechanism, f, joints) for f in _cameras(mechanism)}


def in_image(mechanism: Mechanism, data: Dataset) -> dict[str, Mask]:
    """By camera (N,) whether all of its board is in its image.

    Without a stated size the image is twice as large as its principal point is from its corner.
    """
    values = mechanism.parameters.nominal
    stated = {one.name: one.intrinsics.image for one in all_cameras(mechanism)}
    inside = {}
    for family in _cameras(mechanism):
        eye = family.readings[0].split(":")[0]
        twice = (2.0 * values[f"{eye}_cx"], 2.0 * values[f"{eye}_cy"])
        size = np.array(stated.get(eye) or twice)[:, None]
        pixels = np.array([data.readings[q] for q in family.readings]).reshape(-1, 2, len(data))
        inside[family.name] = np.asarray(((pixels > 0.0) & (pixels < size)).all(axis=(0, 1)))
    return inside


def _cameras(mechanism: Mechanism) -> list[Family]:
    return [f for f in mechanism.families if f.form == PIXELS] if mechanism.tree else []


def _faces(mechanism: Mechanism, family: Family, joints: Dataset) -> Mask:
    eye = family.readings[0].split(":")[0]
    values = mechanism.parameters.nominal
    M = boards_in_camera(mechanism, family, joints.readings, len(joints))
    half = np.array([values[f"{eye}_cx"], values[f"{eye}_cy"]]) / values[f"{eye}_f"]
    ahead = M[:, 2, 3] > 0.0
    ahead &= (np.abs(M[:, :2, 3]) < half * M[:, 2, 3, None]).all(axis=1)
    side = 1.0 if (M[ahead, 2, 2] > 0.0).mean() > 0.5 else -1.0
    return np.asarray(ahead & (side * M[:, 2, 2] > math.cos(TILT)))

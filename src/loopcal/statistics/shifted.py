"""A calibration with what moved as effects: mechanism, readings, and the lines of a project."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.document.change_points import ChangePoint
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.effects.drift import Drift, Shift
from loopcal.mechanisms.effects.effect import with_effects
from loopcal.mechanisms.mechanism import Mechanism

COLUMN = "pose"


@dataclass(frozen=True)
class Shifted:
    """mechanism: with an effect for each thing that moved; data: with the known constant that they
    need; toml: the lines that say so in a project or mechanism file."""

    mechanism: Mechanism
    data: Dataset
    toml: str


def with_shifts(mechanism: Mechanism, data: Dataset, found: Sequence[ChangePoint]) -> Shifted:
    """The mechanism and data with these change points as effects `shift` and `drift`.

    Their known constant `pose` is the number of the pose: its id where ids are rising numbers, else
    its position from 1. Raises InputError where the mechanism cannot have such an effect.
    """
    numbers = _numbers(data)
    first = {pose: float(number) for pose, number in zip(data.poses, numbers, strict=True)}
    effects: list[Shift | Drift] = []
    lines: list[str] = []
    for names in dict.fromkeys(p.names for p in found if p.shape == "step"):
        at = tuple(sorted(first[p.pose] for p in found if p.shape == "step" and p.names == names))
        effects.append(Shift(names, at, COLUMN, name=f"shift of {', '.join(names)}"))
        lines += _table("shift", effects[-1].name, names, f"at = {_listed(at)}")
    for names in dict.fromkeys(p.names for p in found if p.shape == "ramp"):
        since, over = float(numbers.min()), float(np.ptp(numbers))
        effects.append(Drift(names, COLUMN, "1", since, over, f"drift of {', '.join(names)}"))
        lines += _table("drift", effects[-1].name, names, f"since = {since:g}\nover = {over:g}")
    if not effects:
        return Shifted(mechanism, data, "")
    if COLUMN not in mechanism.known:
        data = data.with_readings({COLUMN: numbers}, units={COLUMN: "1"})
    return Shifted(with_effects(mechanism, effects), data, "\n".join(lines).strip() + "\n")


def _numbers(data: Dataset) -> NDArray[np.float64]:
    """(N,) rising numbers of the poses: their ids where these are, else positions from 1."""
    try:
        ids = np.array([float(pose) for pose in data.poses])
    except ValueError:
        ids = np.zeros(0)
    if len(ids) and np.isfinite(ids).all() and (np.diff(ids) > 0.0).all():
        return ids
    return np.arange(1.0, len(data) + 1.0)


def _table(kind: str, name: str, names: Sequence[str], rest: str) -> list[str]:
    return [
        "[[mechanism.effect]]",
        f'type = "{kind}"',
        f'name = "{name}"',
        f"changing = [{', '.join(f'{chr(34)}{n}{chr(34)}' for n in names)}]",
        f'column = "{COLUMN}"',
        rest,
        "",
    ]


def _listed(at: Sequence[float]) -> str:
    return "[" + ", ".join(f"{a:.12g}" for a in at) + "]"

"""A calibration with what moved as effects: mechanism, readings, and the lines of a project."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from loopcal.document.change_points import ChangePoint
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.effects.effect import with_effects
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.stationed import standing

if TYPE_CHECKING:
    from loopcal.mechanisms.effects.drift import Drift, Shift

COLUMN = "pose"


@dataclass(frozen=True)
class Shifted:
    """mechanism: with an effect for each thing that moved; data: with the known constant that they
    need; toml: the lines that say so in a project or mechanism file."""

    mechanism: Mechanism
    data: Dataset
    toml: str


def with_shifts(
    mechanism: Mechanism, data: Dataset, found: Sequence[ChangePoint], *, column: str = COLUMN
) -> Shifted:
    """The mechanism and data with these change points as effects `shift` and `drift`.

    An arm of transitions gets a station where a change moves its instrument.
    Their known constant `column` is the number of the pose: its id where ids are rising numbers,
    else its position from 1. The lines call it `pose`. Raises InputError where the mechanism cannot
    have such an effect.
    """
    effects = _effects(data, found, column)
    if not effects:
        return Shifted(mechanism, data, "")
    if column not in mechanism.pose_constants:
        data = data.with_readings({column: pose_numbers(data)}, units={column: "1"})
    mechanism = standing(mechanism, [name for effect in effects for name in effect.changing])
    return Shifted(with_effects(mechanism, effects), data, shift_lines(data, found))


def shift_lines(data: Dataset, points: Sequence[ChangePoint]) -> str:
    """The lines of a project or mechanism file that model these changes."""
    tables = ["\n".join(_table(effect)) for effect in _effects(data, points, COLUMN)]
    return "\n\n".join(tables) + "\n" if tables else ""


def _effects(data: Dataset, points: Sequence[ChangePoint], column: str) -> list[Shift | Drift]:
    if not points:
        return []
    from loopcal.mechanisms.effects.drift import Drift, Shift

    numbers = pose_numbers(data)
    first = {pose: float(number) for pose, number in zip(data.poses, numbers, strict=True)}
    effects: list[Shift | Drift] = []
    for names in dict.fromkeys(p.names for p in points if p.shape == "step"):
        at = tuple(sorted(first[p.pose] for p in points if p.shape == "step" and p.names == names))
        effects.append(Shift(names, at, column, name=f"shift of {', '.join(names)}"))
    for names in dict.fromkeys(p.names for p in points if p.shape == "ramp"):
        since, over = float(numbers.min()), float(np.ptp(numbers))
        title = f"drift of {', '.join(names)}"
        # Ending with the run, so that predictions hold for its end (docs/explanation/drift.md).
        effects.append(Drift(names, column, "1", since, over, title, since + over))
    return effects


def pose_numbers(data: Dataset) -> NDArray[np.float64]:
    """(N,) rising numbers of the poses: their ids where these are, else positions from 1."""
    if ids_are_numbers(data.poses):
        return np.array([float(pose) for pose in data.poses])
    return np.arange(1.0, len(data) + 1.0)


def ids_are_numbers(poses: Sequence[str]) -> bool:
    """Whether ids of poses are rising numbers."""
    try:
        ids = np.array([float(pose) for pose in poses])
    except ValueError:
        return False
    return bool(len(ids) and np.isfinite(ids).all() and (np.diff(ids) > 0.0).all())


def _table(effect: Shift | Drift) -> list[str]:
    from loopcal.mechanisms.effects.drift import Shift

    numbers = (
        {"at": f"[{', '.join(f'{a:.12g}' for a in effect.at)}]"}
        if isinstance(effect, Shift)
        else {
            key: f"{value:.12g}"
            for key in ("since", "over", "until")
            if (value := getattr(effect, key)) is not None
        }
    )
    return [
        "[[mechanism.effect]]",
        f'type = "{"shift" if "at" in numbers else "drift"}"',
        f'name = "{effect.name}"',
        f"changing = [{', '.join(f'{chr(34)}{n}{chr(34)}' for n in effect.changing)}]",
        f'column = "{effect.column}"',
        *(f"{key} = {value}" for key, value in numbers.items()),
    ]

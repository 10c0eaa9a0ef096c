"""Several cameras on one bracket: each part of its change moves all of them as one body."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from loopcal.statistics.possible_changes import BETWEEN_DAYS, Possible, possible

ENDS = ("x", "y", "z", "rz", "ry", "rx")
PLACES = {
    "left": (0.3, -0.4, 1.2, 0.5, -0.3, 2.8),
    "right": (0.5, -0.3, 1.1, 0.7, -0.2, 2.6),
    "third": (-0.2, 0.1, 0.9, -2.5, 0.9, 0.4),
}
SMALL = 1e-5


def changes(role: str) -> list[Possible]:
    """Of cameras that are placed so, and of nothing else."""

    def entry(name: str, value: float, role: str, unit: str) -> Any:
        return SimpleNamespace(
            name=name,
            nominal=value,
            role=role,
            unit=unit,
            owner=name.split("_")[0],
            same=None,
            dimension=None,
        )

    entries = [
        entry(f"{eye}_{end}", value, role, "rad" if "r" in end else "m")
        for eye, place in PLACES.items()
        for end, value in zip(ENDS, place, strict=True)
    ]
    entries += [entry(f"{eye}_f", 1000.0, "lens", "px") for eye in PLACES]
    problem = SimpleNamespace(
        mechanism=SimpleNamespace(parameters=entries), names=tuple(one.name for one in entries)
    )
    cameras = next(cause for cause in BETWEEN_DAYS if cause.__name__ == "_cameras")
    return possible(problem, [cameras])  # type: ignore[arg-type]


def motion(place: tuple[float, ...]) -> np.ndarray:
    T = np.eye(4)
    T[:3, 3] = place[:3]
    T[:3, :3] = Rotation.from_euler("ZYX", place[3:]).as_matrix()
    return T


@pytest.mark.parametrize("role", ["placement", "mounting"])
def test_each_part_moves_all_cameras_as_one_body(role: str) -> None:
    (bracket,) = [one for one in changes(role) if one.label == "cameras"]
    beside = role == "placement"
    assert bracket.kind == ("camera" if beside else "mounting")
    assert bracket.units == ("m",) * 3 + ("rad",) * 3
    for number, part in enumerate(bracket.directions):
        moves = []
        for eye, place in PLACES.items():
            before = motion(place)
            steps = [part[f"{eye}_{end}"] for end in ENDS]
            after = motion(tuple(v + SMALL * by for v, by in zip(place, steps, strict=True)))
            inverse = np.linalg.inv(after) @ before if beside else after @ np.linalg.inv(before)
            moves.append((inverse - np.eye(4)) / SMALL)
        for one in moves[1:]:
            np.testing.assert_allclose(one, moves[0], atol=1e-4)
        W = moves[0][:3, :3]
        turn = np.array([W[2, 1], W[0, 2], W[1, 0]])
        expected = np.eye(6)[number]
        np.testing.assert_allclose(turn, expected[3:], atol=1e-4)
        # A turn about the middle of the cameras leaves it where it is.
        places = [motion(place) for place in PLACES.values()]
        middle = np.mean([(np.linalg.inv(T) if beside else T)[:3, 3] for T in places], axis=0)
        np.testing.assert_allclose((moves[0] @ [*middle, 1.0])[:3], expected[:3], atol=1e-4)


def test_a_single_camera_has_no_bracket(monkeypatch: pytest.MonkeyPatch) -> None:
    for eye in ("right", "third"):
        monkeypatch.delitem(PLACES, eye)
    assert [one.label for one in changes("placement") if one.kind == "camera"] == ["left"]

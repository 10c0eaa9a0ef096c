"""Scale and principal point against what was stated: pitch and aspect of the board, half pixels."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from loopcal.estimation.cameras.facts import Fact
from loopcal.estimation.cameras.placing import Reading
from loopcal.estimation.cameras.scene import REDESCENDING, Adjusted, adjusted

CLEAR = 4.0
"""Standard deviations, from the scatter of the images, beyond which a difference is reported."""
SMALLEST = {"pitch": 2e-3, "aspect": 3e-4}
"""Relative differences that are not reported: lengths of arms as made, and 0.1 mm over 0.3 m."""
HALF_PIXEL = 0.6
"""Distance [px] from the middle of an image that leaves the convention of its pixels open."""


def scale_facts(reading: Reading, result: Adjusted, lens: Sequence[str]) -> list[Fact]:
    """The facts of one adjusted reading."""
    return [*_board(reading, result, lens), *_centres(reading, result)]


def _board(reading: Reading, result: Adjusted, lens: Sequence[str]) -> Iterator[Fact]:
    """Pitch needs the robot as the yardstick, aspect needs a plane and square pixels."""
    names = [] if reading.T_base_flange is None else ["pitch"]
    if all(board.planar for board in reading.corners.boards):
        names.append("aspect")
    if not names or len(np.unique(reading.corners.image)) < 6:
        return
    few = reading.thinned(200, 24)
    scene = result.scene
    if scene.F is not None:
        few = reading
    free = [name for name in lens if all(name in one.values for one in scene.intrinsics)]
    freed = adjusted(few.corners, scene, free, names, iterations=15, loss=REDESCENDING)
    for name in names:
        value = freed.scene.board[("pitch", "aspect").index(name)]
        sd = freed.sds[(-1, name)]
        if abs(value) < max(CLEAR * sd, SMALLEST[name]):
            continue
        number = f"{1.0 + value:.4f} ± {sd:.1g}"
        sentence = (
            f"Board and robot disagree about lengths: the board's pitch is {number} of the stated "
            f"one if the robot is right. If the board is right, the robot is stated "
            f"{abs(100.0 * value):.2g} % too {'long' if value > 0.0 else 'short'}. Images show no "
            "lengths, and the calibration takes those of the robot. Measure the print."
            if name == "pitch"
            else f"Height and width of the board fit as {number} of the stated ratio, if pixels "
            "are square. Measure both on the print."
        )
        values: dict[str, float | str] = {name: 1.0 + value, "sd": sd, "px": freed.rms}
        for camera, one in zip(reading.corners.cameras, freed.scene.intrinsics, strict=True):
            values[f"f_{camera}"] = one.fx
        yield Fact(f"board-{name}", sentence, values)


def _centres(reading: Reading, result: Adjusted) -> Iterator[Fact]:
    """Half a pixel between the stated and the adjusted principal point, or a doubt about it."""
    for c, camera in enumerate(reading.corners.cameras):
        lens, now = reading.lenses[c], result.scene.intrinsics[c]
        if not reading.stated:
            continue
        sds = [result.sds.get((c, name), np.inf) for name in ("cx", "cy")]
        off = np.array([now.cx - lens.cx, now.cy - lens.cy])
        half = np.sign(off) * 0.5
        if (np.abs(off - half) < 3.0 * np.array(sds)).all() and max(sds) < 0.5 / CLEAR:
            shift = f"({off[0]:+.2f}, {off[1]:+.2f}) px"
            yield Fact(
                "pixel-centre",
                f"The principal point of camera {camera!r} is {shift} off the stated one. "
                "Half a pixel is the difference between the two conventions for the centre of the "
                "first pixel, 0 and 0.5. Check both files.",
                {"u_px": float(off[0]), "v_px": float(off[1]), "sd": max(sds), "camera": camera},
            )
        elif lens.image is not None:
            middle = (np.array(lens.image) - 1.0) / 2.0
            if (np.abs(np.array([lens.cx, lens.cy]) - middle) < HALF_PIXEL).all():
                yield Fact(
                    "pixel-centre-unstated",
                    f"The principal point of camera {camera!r} is the middle of its images. State "
                    "whether the centre of the first pixel is 0 or 0.5.",
                    {"cx": lens.cx, "cy": lens.cy, "camera": camera},
                )

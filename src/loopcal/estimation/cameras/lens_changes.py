"""Stated lenses read in another way: of another camera, of turned, resized or cut images."""

from __future__ import annotations

from dataclasses import replace

from loopcal.estimation.cameras.placing import Reading, placed, view_poses
from loopcal.mechanisms.cameras.lens import Intrinsics


def exchanged(reading: Reading, a: int, b: int) -> Reading | None:
    """The lenses of two cameras exchanged; None where they state images of other sizes."""
    lenses = list(reading.lenses)
    sizes = {lens.image for lens in (lenses[a], lenses[b]) if lens.image is not None}
    if len(sizes) > 1:
        return None
    lenses[a], lenses[b] = lenses[b], lenses[a]
    return replace(reading, lenses=tuple(lenses))


def turned(reading: Reading, turn: str) -> Reading | None:
    """Lenses of images on their side; a real turn needs the images' size."""
    if turn != "exchanged" and any(lens.image is None for lens in reading.lenses):
        return None
    lenses = []
    for lens in reading.lenses:
        width, height = lens.image or (0, 0)
        cx, cy = {
            "exchanged": (lens.cy, lens.cx),
            "clockwise": (lens.cy, height - 1.0 - lens.cx),
            "counterclockwise": (width - 1.0 - lens.cy, lens.cx),
            "half": (width - 1.0 - lens.cx, height - 1.0 - lens.cy),
        }[turn]
        fx, fy = (lens.fx, lens.fy) if turn == "half" else (lens.fy, lens.fx)
        lenses.append(replace(lens, fx=fx, fy=fy, cx=cx, cy=cy))
    return replace(reading, lenses=tuple(lenses))


def cut(reading: Reading) -> Reading | None:
    """Lenses with the principal points that fit the images, whose size is left open."""
    few = reading.thinned(60, 12)
    best = placed(few, view_poses(few), ("cx", "cy"), iterations=40)
    if best is None:
        return None
    lenses = tuple(replace(lens, image=None) for lens in best.scene.intrinsics)
    return replace(reading, lenses=lenses)


def resized(reading: Reading, factor: float) -> Reading:
    """Lenses of images so many times as wide and as high."""
    lenses = tuple(
        replace(
            lens,
            fx=lens.fx * factor,
            fy=lens.fy * factor,
            cx=(lens.cx + 0.5) * factor - 0.5,
            cy=(lens.cy + 0.5) * factor - 0.5,
        )
        for lens in reading.lenses
    )
    return replace(reading, lenses=lenses)


def rectified(reading: Reading, *, by_P: bool) -> Reading:
    """With lenses that do not bend; by_P: of the focal lengths and principal points stated so."""
    lenses = []
    for lens in reading.lenses:
        fx, fy, cx, cy = (by_P and lens.rectified) or (lens.fx, lens.fy, lens.cx, lens.cy)
        straight = Intrinsics("brown5", fx, fy, cx, cy, (), lens.image)
        lenses.append(straight if any(lens.distortion) else lens)
    return replace(reading, lenses=tuple(lenses))

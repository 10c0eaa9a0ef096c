"""Time against the number of poses as a drawing: one line per program, labelled where it ends."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from math import ceil, floor, log10

from side_by_side import Comparison

from loopcal.figures.figure import COLOURS

WIDE, HIGH = 860, 560
LEFT, RIGHT, TOP, BOTTOM = 88, 176, 24, 56
INK, GRID, FONT, LETTER = "#24292f", "#e3e5e8", 13, 6.7
"""LETTER: how wide one is, about [px]."""
HALO = ' stroke="#ffffff" stroke-width="4" stroke-linejoin="round" paint-order="stroke"'


@dataclass(frozen=True)
class Line:
    """A program: poses and median times [s], and how its line looks."""

    program: str
    points: list[tuple[float, float]]
    colour: str
    dashed: bool

    @property
    def ours(self) -> bool:
        """Whether it is loopcal, which stands out."""
        return self.program.startswith("loopcal")


@dataclass(frozen=True)
class Scales:
    """From poses and seconds to the paper [px], both by their logarithms."""

    poses: tuple[int, int]
    decades: tuple[int, int]

    def x(self, poses: float) -> float:
        """From the left."""
        low, high = (log10(n) for n in self.poses)
        return LEFT + (WIDE - LEFT - RIGHT) * (log10(poses) - low) / max(high - low, 1e-9)

    def y(self, seconds: float) -> float:
        """From the top."""
        low, high = self.decades
        return TOP + (HIGH - TOP - BOTTOM) * (high - log10(seconds)) / (high - low)


def drawn(found: Sequence[Comparison], words: str) -> str:
    """The comparisons of one problem as SVG; words: what it shows, for who cannot see it."""
    lines = _lines(found)
    every = [point for line in lines for point in line.points]
    poses, times = [n for n, _ in every], [t for _, t in every]
    decades = floor(log10(min(times))), ceil(log10(max(times)))
    scales = Scales((min(poses), max(poses)), (decades[0], max(decades[1], decades[0] + 1)))
    title = f"Time of a calibration against poses: {found[0].problem}"
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDE} {HIGH}" width="{WIDE}" '
        f'height="{HIGH}" role="img" font-family="Helvetica, Arial, sans-serif" '
        f'font-size="{FONT}">',
        f"<title>{escape(title)}</title>",
        f"<desc>{escape(words)}</desc>",
        f'<rect width="{WIDE}" height="{HIGH}" fill="#ffffff"/>',
        *_axes(scales),
        *(part for line in lines for part in _line(line, scales)),
        *_labels(lines, scales),
        "</svg>",
    ]
    return "\n".join(parts) + "\n"


def _lines(found: Sequence[Comparison]) -> list[Line]:
    """By program, in the order of the tables; dashed where colours have been used up."""
    names = list(dict.fromkeys(name for one in found for name in one.times))
    return [
        Line(
            name,
            [(one.poses, one.times[name].median) for one in found if name in one.times],
            COLOURS[i % len(COLOURS)],
            dashed=i >= len(COLOURS),
        )
        for i, name in enumerate(names)
    ]


def _axes(scales: Scales) -> list[str]:
    """A line of the grid for every decade, and what the axes are."""
    right, foot = WIDE - RIGHT, HIGH - BOTTOM
    low, high = scales.poses
    parts = []
    for power in range(ceil(log10(low)), floor(log10(high)) + 1):
        x = scales.x(10**power)
        parts.append(f'<path d="M{x:.1f},{TOP}V{foot}" stroke="{GRID}"/>')
        parts.append(_text(x, foot + 20, f"{10**power:,}", "middle"))
    for power in range(scales.decades[0], scales.decades[1] + 1):
        y = scales.y(10.0**power)
        parts.append(f'<path d="M{LEFT},{y:.1f}H{right}" stroke="{GRID}"/>')
        parts.append(_text(LEFT - 8, y + 4.5, _seconds(power), "end"))
    parts.append(_text((LEFT + right) / 2, HIGH - 12, "poses", "middle"))
    middle = (TOP + foot) / 2
    turned = f' transform="rotate(-90 16 {middle})"'
    parts.append(_text(16, middle, "time of one calibration (median)", "middle", INK, turned))
    return parts


def _seconds(power: int) -> str:
    """A power of ten seconds with a unit that keeps it short."""
    unit, shift = ("s", 0) if power >= 0 else ("ms", 3) if power >= -3 else ("µs", 6)
    return f"{10 ** (power + shift):,} {unit}"


def _line(line: Line, scales: Scales) -> list[str]:
    places = [(scales.x(n), scales.y(t)) for n, t in line.points]
    path = " ".join(f"{x:.1f},{y:.1f}" for x, y in places)
    dashes = ' stroke-dasharray="5 3"' if line.dashed else ""
    return [
        f'<polyline fill="none" stroke="{line.colour}" stroke-width="{2.6 if line.ours else 1.6}" '
        f'stroke-linejoin="round"{dashes} points="{path}"/>',
        *(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="2.8" fill="{line.colour}"/>' for x, y in places),
    ]


def _labels(lines: Sequence[Line], scales: Scales) -> list[str]:
    """A name to the right of each line's end, moved as far as it must to keep off the others."""
    placed: list[tuple[float, float, float]] = []
    parts = []
    for line in sorted(lines, key=lambda line: -line.points[-1][1]):
        n, t = line.points[-1]
        left, y = scales.x(n) + 9, scales.y(t) + 4.5
        right = left + LETTER * len(line.program)
        for a, b, taken in placed:
            if left < b and a < right and y < taken + FONT + 2:
                y = taken + FONT + 2
        placed.append((left, right, y))
        weight = ' font-weight="bold"' if line.ours else ""
        parts.append(_text(left, y, line.program, "start", line.colour, HALO + weight))
    return parts


def _text(x: float, y: float, text: str, anchor: str, colour: str = INK, more: str = "") -> str:
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" fill="{colour}" text-anchor="{anchor}"{more}>'
        f"{escape(text)}</text>"
    )

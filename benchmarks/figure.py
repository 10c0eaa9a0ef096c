"""Time against the number of poses as a drawing: one line per program, labelled where it ends."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from math import ceil, floor, log10
from statistics import fmean

from side_by_side import Comparison

from loopcal.figures.figure import BEFORE, COLOURS

WIDE, HIGH = 860, 560
LEFT, RIGHT, TOP, BOTTOM = 88, 196, 16, 56
INK, GRID, FONT = "#24292f", "#e3e5e8", 13
INKS = (*COLOURS, INK, BEFORE)
APART, BEYOND = 16.0, 0.1
"""Of labels [px]; how far the paper goes on beyond the longest and the shortest time [decades]."""


@dataclass(frozen=True, eq=False)
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

    poses: tuple[float, float]
    decades: tuple[float, float]

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
    decades = log10(min(times)) - BEYOND, log10(max(times)) + BEYOND
    scales = Scales((min(poses), max(poses)), decades)
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
            INKS[i % len(INKS)],
            dashed=i >= len(INKS),
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
    for power in range(ceil(scales.decades[0]), floor(scales.decades[1]) + 1):
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
    """A column of names beside the paper, each led to from the end of its line."""
    ends = {line: (scales.x(line.points[-1][0]), scales.y(line.points[-1][1])) for line in lines}
    ordered = sorted(lines, key=lambda line: ends[line][1])
    parts, edge = [], WIDE - RIGHT
    for line, y in zip(ordered, _spread([ends[line][1] for line in ordered]), strict=True):
        x, end = ends[line]
        parts.append(
            f'<path d="M{x:.1f},{end:.1f}H{edge + 6}L{edge + 18},{y:.1f}" fill="none" '
            f'stroke="{line.colour}" stroke-dasharray="1.5 3"/>'
        )
        weight = ' font-weight="bold"' if line.ours else ""
        parts.append(_text(edge + 22, y + 4.5, line.program, "start", line.colour, weight))
    return parts


def _spread(heights: Sequence[float]) -> list[float]:
    """Heights from the top in order, moved as little as keeps each off its neighbours."""
    groups: list[list[float]] = []  # of heights that a label at the group's top would have
    for i, y in enumerate(heights):
        groups.append([y - APART * i])
        while len(groups) > 1 and fmean(groups[-2]) > fmean(groups[-1]):
            last = groups.pop()
            groups[-1] += last
    tops = [fmean(group) for group in groups for _ in group]
    return [top + APART * i for i, top in enumerate(tops)]


def _text(x: float, y: float, text: str, anchor: str, colour: str = INK, more: str = "") -> str:
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" fill="{colour}" text-anchor="{anchor}"{more}>'
        f"{escape(text)}</text>"
    )

"""What cameras saw: residuals and sds over an image, and boards and cameras in space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from loopcal.arrays import Array
from loopcal.figures.figure import (
    AFTER,
    BEFORE,
    MARK,
    Figure,
    axis,
    interval,
    layout,
    names,
    numbers,
    shown_text,
    spots,
    thinned,
    trace,
    upright,
)
from loopcal.figures.space import (
    MACHINE,
    SHADES,
    Machine,
    arrow_traces,
    enlargement,
    machine_trace,
    one_of,
    shaded,
    space_layout,
)
from loopcal.presentation.shown import significant

BINS = 12
"""Rings about the principal point, with as many corners each."""
LEAST = 560
"""Pixels that an image needs to show its arrows."""
STEEP = 4.0
"""Sds beyond so many medians have one colour: corners of an image would take all others."""
LENGTH = 0.4
"""A camera is drawn as long as this share of its distance to the boards."""
_HEAT = [[0, "rgba(0,114,178,0.12)"], [0.4, "rgba(230,159,0,0.35)"], [1, "rgba(213,94,0,0.85)"]]


@dataclass(frozen=True, eq=False)
class ImagePlane:
    """One camera's image: width and height, principal point (2,), and the radius about it at which
    the lens turns back, inf where it does not, all [px]."""

    camera: str
    size: tuple[float, float]
    centre: Array
    turns: float = np.inf

    @property
    def corner(self) -> float:
        """The largest distance from the principal point [px]."""
        far = np.maximum(self.centre, np.array(self.size) - self.centre)
        return float(np.linalg.norm(far))

    @property
    def words(self) -> str:
        """Where the lens turns back."""
        if self.turns > self.corner:
            return " The lens does not turn back within the image."
        return f" Dashed: the lens turns back {self.turns:.0f} px from the principal point."

    def layout(self, height: int = 620, **more: Any) -> dict[str, Any]:
        """u to the right and v down, to scale, with the frame of the image."""
        (width, high), (cx, cy) = self.size, self.centre.tolist()
        shapes: list[dict[str, Any]] = [
            {"type": "rect", "x0": 0, "y0": 0, "x1": width, "y1": high, "line": {"color": BEFORE}}
        ]
        if self.turns <= self.corner:
            r, line = self.turns, {"color": MARK, "width": 1.5, "dash": "dash"}
            ends = {"x0": cx - r, "x1": cx + r, "y0": cy - r, "y1": cy + r}
            shapes.append({"type": "circle", **ends, "line": line})
        room = 0.02 * max(self.size)
        plane = {"constrain": "domain", "zeroline": False}
        return layout(
            height,
            shapes=shapes,
            xaxis=axis("u [px]", range=[-room, width + room], **plane),
            yaxis=axis(
                "v [px]", range=[high + room, -room], scaleanchor="x", scaleratio=1, **plane
            ),
            **more,
        )

    @property
    def middle(self) -> dict[str, Any]:
        """The principal point."""
        look = {"symbol": "cross-thin", "size": 14, "line": {"width": 2, "color": BEFORE}}
        x, y = self.centre[:, None]
        return trace("markers", "principal point", x, y, marker=look)


def image_residuals(
    plane: ImagePlane, uv: Array, residuals: Array, labels: Sequence[str]
) -> Figure | None:
    """Arrows from measured to computed pixels (2, n); None without corners."""
    sizes = np.hypot(*residuals)
    chosen = thinned(sizes, what="corners")
    if not chosen.index.size:
        return None
    at, along, size = uv[:, chosen.index], residuals[:, chosen.index], sizes[chosen.index]
    scale = enlargement(at, size)
    said = [
        f"{labels[i]}<br>{significant(s, 3)} px" for i, s in zip(chosen.index, size, strict=True)
    ]
    drawn = arrow_traces(at, scale * along, size, said, "px")
    rms, largest = float(np.sqrt(np.mean(sizes**2))), float(sizes.max())
    # Marks first: what is selected in the app belongs to the first trace.
    return Figure(
        f"image-{plane.camera}",
        f"Residuals in the image of {shown_text(plane.camera)}",
        f"Arrows from the measured corner to the computed one, enlarged {scale:,.0f} times. "
        "Neighbours that point alike: the lens, the board or the robot has an error left. Where "
        f"no corner is, nothing was tested.{plane.words}{chosen.words}",
        f"{sizes.size} corners of {shown_text(plane.camera)}: rms {rms:.3g} px, at most "
        f"{largest:.3g} px.",
        (drawn[-1], *drawn[:-1], plane.middle),
        plane.layout(),
        least_width=LEAST,
    )


def over_radius(plane: ImagePlane, uv: Array, residuals: Array) -> Figure | None:
    """Residuals (2, n) along the radius and across it, against the distance from the centre.

    None where there are fewer corners than two a ring.
    """
    away = uv - plane.centre[:, None]
    radius = np.hypot(*away)
    if radius.size < 2 * BINS:
        return None
    out = away / np.where(radius > 0.0, radius, 1.0)
    parts = {
        "radial": (out * residuals).sum(axis=0),
        "tangential": out[0] * residuals[1] - out[1] * residuals[0],
    }
    chosen = thinned(radius, what="corners")
    rings = np.array_split(np.argsort(radius), BINS)
    middle = np.array([radius[ring].mean() for ring in rings])
    data, worst = [], []
    for (name, values), end in zip(parts.items(), ("", "2"), strict=True):
        mean = np.array([values[ring].mean() for ring in rings])
        se = np.array([values[ring].std(ddof=1) / np.sqrt(ring.size) for ring in rings])
        first = end == ""
        common = {"yaxis": f"y{end}", "showlegend": first}
        dots = {"marker": {"color": BEFORE, "size": 3, "opacity": 0.6}, "hoverinfo": "skip"}
        x, y = radius[chosen.index], values[chosen.index]
        data.append(trace("markers", "corners", x, y, **dots, **common))
        look = {"marker": {"color": AFTER, "size": 7}, "line": {"color": AFTER}}
        look["error_y"] = interval(2.0 * se)
        data.append(trace("lines+markers", "mean of a ring ± 2 se", middle, mean, **look, **common))
        worst.append(f"{name} mean at most {np.abs(mean).max():.2g} px")
    reach = 1.03 * float(radius.max())
    shapes = [upright(plane.turns, MARK, 1.5)] if plane.turns <= plane.corner else []
    return Figure(
        f"radius-{plane.camera}",
        f"Residuals against the distance from the principal point of {shown_text(plane.camera)}",
        "Computed minus measured; rings have as many corners each. Means off zero along the "
        "radius: the distortion lacks a coefficient. Off zero across it: the image is turned about "
        f"its middle, as by an error of the camera's place.{plane.words}{chosen.words}",
        f"Residuals of {shown_text(plane.camera)} in {BINS} rings: {', '.join(worst)}.",
        tuple(data),
        layout(
            420,
            shapes=shapes,
            xaxis=axis("distance [px]", anchor="y2", range=[0.0, reach]),
            yaxis=axis("radial [px]", domain=[0.54, 1.0], zeroline=True),
            yaxis2=axis("tangential [px]", domain=[0.0, 0.46], zeroline=True, anchor="x"),
        ),
    )


@dataclass(frozen=True, eq=False)
class SdMap:
    """Sds (rows, columns) [px] over an image at a distance [m], and the length of a pixel there."""

    distance: float
    sds: Array
    pixel: float


def projection_sds(
    plane: ImagePlane, u: Array, v: Array, maps: Sequence[SdMap], shown: int, uv: Array, holder: str
) -> Figure | None:
    """Where a point of the holder is seen, as its sd over the image; `shown`: the map drawn first.

    u (columns,), v (rows,): the grid [px]; uv: (2, n) corners. None without a finite sd.
    """
    if not maps or not all(np.isfinite(one.sds).any() for one in maps):
        return None
    data: list[dict[str, Any]] = []
    for i, one in enumerate(maps):
        data.append(
            {
                "type": "contour",
                "name": _distance(one),
                "visible": i == shown,
                "showlegend": False,
                "x": numbers(u),
                "y": numbers(v),
                # three digits: no eye sees more of a colour
                "z": [
                    [None if x is None else float(f"{x:.3g}") for x in map(_finite, row)]
                    for row in one.sds
                ],
                "colorscale": _HEAT,
                "ncontours": 12,
                "zmin": 0.0,
                "zmax": STEEP * float(np.nanmedian(one.sds)),
                "contours": {"coloring": "heatmap", "showlabels": True},
                "line": {"color": BEFORE, "width": 1},
                "colorbar": {
                    "title": {"text": f"sd [px]<br>at {_distance(one)}"},
                    "thickness": 12,
                },
                "hovertemplate": "(%{x:.0f}, %{y:.0f}) px: sd %{z:.3g} px<extra></extra>",
            }
        )
    chosen = thinned(uv[0], what="corners").index
    dots = {"marker": {"color": BEFORE, "size": 3, "opacity": 0.8}, "hoverinfo": "skip"}
    data.append(trace("markers", "corners", uv[0, chosen], uv[1, chosen], **dots))
    data.append(plane.middle)
    buttons = [
        {
            "label": _distance(one),
            "method": "restyle",
            "args": ["visible", [k == i for k in range(len(maps))] + [True, True]],
        }
        for i, one in enumerate(maps)
    ]
    sizes = ", ".join(
        f"{significant(float(np.nanmin(m.sds)) * m.pixel * 1e3, 2)} to "
        f"{significant(float(np.nanmax(m.sds)) * m.pixel * 1e3, 2)} mm at {_distance(m)}"
        for m in maps
    )
    below = {"orientation": "h", "x": 0, "y": -0.14, "yanchor": "top"}
    return Figure(
        f"projection-{plane.camera}",
        f"Uncertainty of the projection of {shown_text(plane.camera)}",
        f"Sd of the pixel at which a point fixed to the {holder} is seen, from the covariance of "
        f"the lens and the place of the camera: {sizes}. A level map: the place is uncertain, not "
        "the lens. Where no corner is, the lens is extrapolated.",
        f"Sds over the image of {shown_text(plane.camera)}: {sizes}.",
        tuple(data),
        plane.layout(**one_of(buttons, shown))
        | {"legend": below, "margin": {"l": 8, "r": 8, "t": 48, "b": 8}},
        least_width=LEAST,
    )


def _distance(one: SdMap) -> str:
    return f"{significant(one.distance, 2)} m"


def _finite(value: float) -> float | None:
    return value if value - value == 0.0 else None


# The cameras as pyramids and the boards as outlines, in the frame of the machine's base.


@dataclass(frozen=True, eq=False)
class Sight:
    """A camera in one place, T_base_camera (4, 4); rays: (4, 3) to the corners of its image at the
    distance 1."""

    camera: str
    T: Array
    rays: Array


@dataclass(frozen=True, eq=False)
class Outline:
    """A board in the base: a closed line (k, 3) [m]; label, and its rms residual [px]."""

    points: Array
    label: str
    rms: float


def scene(
    sights: Sequence[Sight],
    outlines: Sequence[Outline],
    machine: Machine | None,
) -> Figure | None:
    """Cameras and boards in space; None where either is missing."""
    outlines = [one for one in outlines if np.isfinite(one.points).all()]
    if not sights or not outlines:
        return None
    chosen = thinned(np.array([one.rms for one in outlines]), 300, "images")
    shown = [outlines[i] for i in chosen.index]
    data = scene_traces(sights, shown)
    if machine is not None:
        data.insert(0, machine_trace(machine))
    rms = [one.rms for one in shown]
    return Figure(
        "scene",
        "Where the boards were before the cameras",
        "Boards of all images, coloured by their rms residual. Far images in one colour: an error "
        "grows with the distance. Boards that are all alike in distance or tilt determine the lens "
        f"weakly.{chosen.words}",
        f"{len(sights)} places of cameras and {len(shown)} of boards; rms residuals of "
        f"{min(rms):.2g} to {max(rms):.2g} px.",
        tuple(data),
        space_layout(data),
    )


def scene_traces(sights: Sequence[Sight], outlines: Sequence[Outline]) -> list[dict[str, Any]]:
    """The traces of a picture in space: boards by shade, cameras by name."""
    data: list[dict[str, Any]] = []
    shade, ends = shaded(np.array([one.rms for one in outlines]))
    for i, colour in enumerate(SHADES):
        some = [one for one, at in zip(outlines, shade, strict=True) if at == i]
        if some:
            lines, texts = _broken([one.points for one in some], [one.label for one in some])
            name = f"boards up to {significant(ends[i], 2)} px"
            look = {"line": {"color": colour, "width": 3}, "text": names(texts)}
            data.append(spots("lines", lines, name=name, hoverinfo="text", **look))
    middle = np.mean([one.points.mean(axis=0) for one in outlines], axis=0)
    for camera in dict.fromkeys(one.camera for one in sights):
        places = [one for one in sights if one.camera == camera]
        chosen = thinned(np.zeros(len(places)), 60).index
        pyramids = [_pyramid(places[i], middle) for i in chosen]
        lines, _ = _broken(pyramids, [camera] * len(pyramids))
        # Its name stands at the tip of the first pyramid.
        texts = [camera, *[""] * (lines.shape[1] - 1)]
        look = {"line": {"color": MACHINE, "width": 3}, "text": names(texts)}
        data.append(spots("lines+text", lines, name=shown_text(camera), hoverinfo="name", **look))
    return data


def _pyramid(one: Sight, middle: Array) -> Array:
    """A line along the edges of a camera's pyramid of sight."""
    length = LENGTH * float(np.linalg.norm(middle - one.T[:3, 3]))
    tip = one.T[:3, 3]
    a, b, c, d = tip + length * one.rays @ one.T[:3, :3].T
    return np.array([tip, a, b, tip, c, b, c, d, tip, d, a])


def _broken(lines: Sequence[Array], labels: Sequence[str]) -> tuple[Array, list[str]]:
    """Lines as one, NaN lifts the pen, with a label at each point."""
    lifted = np.full((1, 3), np.nan)
    joined = np.vstack([part for line in lines for part in (line, lifted)])
    texts = [label for line, label in zip(lines, labels, strict=True) for _ in range(len(line) + 1)]
    return joined.T, texts

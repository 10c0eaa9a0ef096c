"""Figures of the app itself: the machine in a pose, and errors whose poses can be selected."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.figures.figure import axis, layout, names, numbers
from loopcal.figures.thinning import thinned
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.skeleton import skeleton, skeleton_labels
from loopcal.presentation.shown import factor, unit_shown
from loopcal.report.drawn import distances
from loopcal.report.source import Source

Array = NDArray[np.float64]
MOST = 5_000
"""Points of one figure; of more the largest and a sample of the rest."""
CHOSEN, REST = "#d55e00", "#0072b2"
TRANSPARENT = "rgba(0,0,0,0)"


def look(height: int, **more: Any) -> dict[str, Any]:
    """Layout of a figure on either ground."""
    plain = {
        "paper_bgcolor": TRANSPARENT,
        "plot_bgcolor": TRANSPARENT,
        "font": {"color": "#6b7280"},
    }
    return layout(height, **more) | plain


def machine_figure(mechanism: Mechanism, joints: Mapping[str, float]) -> dict[str, Any] | None:
    """The machine in one pose; None where it has no known shape."""
    points = skeleton(mechanism, joints)
    if points is None or not np.isfinite(points).any():
        return None
    flat = points.shape[1] == 2
    keys = "xy" if flat else "xyz"
    trace = {
        "type": "scatter" if flat else "scatter3d",
        "mode": "lines+markers+text",
        "line": {"color": REST, "width": 6},
        "marker": {"size": 5, "color": REST},
        "text": names(skeleton_labels(mechanism)),
        "hoverinfo": "text",
        **{k: numbers(points[:, i]) for i, k in enumerate(keys)},
    }
    if flat:
        more: dict[str, Any] = {"xaxis": axis("x [m]"), "yaxis": axis("y [m]", scaleanchor="x")}
    else:
        more = {
            "scene": {
                "aspectmode": "data",
                "camera": {"eye": {"x": 1.5, "y": 1.5, "z": 0.9}},
                **{f"{k}axis": {"title": {"text": f"{k} [m]"}} for k in keys},
            }
        }
    return {"data": [trace], "layout": look(460, showlegend=False, uirevision="machine", **more)}


@dataclass(frozen=True, eq=False)
class Errors:
    """What the linked figures show: size of the error of each pose, after the calibration.

    size: (N,) in `unit`; drawn: positions of the poses that are drawn.
    """

    source: Source
    size: Array
    unit: str
    drawn: NDArray[np.int64]

    @classmethod
    def of(cls, source: Source) -> Errors | None:
        """None for a result without outputs."""
        table, accuracy = source.table, source.document.accuracy
        if accuracy is None or not table.differences_after:
            return None
        size = distances(source, table.differences_after) / factor(accuracy.unit)
        kept = thinned(np.nan_to_num(size), MOST).index
        return cls(source, size, unit_shown(accuracy.unit), kept)

    @property
    def joints(self) -> list[str]:
        """Quantities that are no outputs and vary."""
        readings = self.source.table.readings
        outputs = set(self.source.table.differences_after)
        return [
            name
            for name, values in readings.items()
            if name not in outputs and np.nanmax(values) > np.nanmin(values)
        ]

    def over_poses(self) -> dict[str, Any]:
        """Size of the error over the poses in their order."""
        head = {
            "xaxis": axis("pose, in order"),
            "yaxis": axis(f"error [{self.unit}]", rangemode="tozero"),
        }
        trace = self._points("scattergl", x=self.drawn + 1.0, y=self.size[self.drawn])
        return {"data": [trace], "layout": look(280, dragmode="select", **head), "config": _PLAIN}

    def over_joint(self, name: str) -> dict[str, Any]:
        """Size of the error over one joint."""
        unit = self.source.document.mechanism
        assert unit is not None
        own = unit.quantities.get(name, "rad")
        x = self.source.table.readings[name][self.drawn] / factor(own)
        head = {
            "xaxis": axis(f"{name} [{unit_shown(own)}]"),
            "yaxis": axis(f"error [{self.unit}]", rangemode="tozero"),
        }
        trace = self._points("scattergl", x=x, y=self.size[self.drawn])
        return {"data": [trace], "layout": look(240, dragmode="select", **head), "config": _PLAIN}

    def in_space(self) -> dict[str, Any] | None:
        """Measured points coloured by the size of the error."""
        table = self.source.table
        outputs = [n for n in table.differences_after if n in table.readings][:3]
        if len(outputs) < 2:
            return None
        at = [table.readings[n][self.drawn] for n in outputs]
        keys = dict(zip("xyz", at, strict=False))
        solid = len(outputs) == 3
        trace = self._points("scatter3d" if solid else "scattergl", **keys)
        trace["marker"] |= {
            "color": numbers(self.size[self.drawn]),
            "colorscale": "Viridis",
            "size": 4 if solid else 7,
        }
        trace["marker"]["colorbar"] = {"title": {"text": self.unit}, "thickness": 12}
        titles = {
            f"{k}axis": {"title": {"text": f"{n} [m]"}}
            for k, n in zip("xyz", outputs, strict=False)
        }
        more = {"scene": {"aspectmode": "data", **titles}} if solid else titles
        return {
            "data": [trace, _empty(solid)],
            "layout": look(460, showlegend=False, **more),
            "config": _PLAIN,
        }

    def space_of(self, positions: Sequence[int]) -> dict[str, list[Any]]:
        """Coordinates of the selected poses, for the ring around them in space."""
        table = self.source.table
        outputs = [n for n in table.differences_after if n in table.readings][:3]
        return {
            k: [numbers(table.readings[n][list(positions)])]
            for k, n in zip("xyz", outputs, strict=False)
        }

    def _points(self, kind: str, **at: NDArray[Any]) -> dict[str, Any]:
        ids = [self.source.table.poses[i] for i in self.drawn]
        said = [
            f"pose {p}: {v:.3g} {self.unit}"
            for p, v in zip(ids, self.size[self.drawn], strict=True)
        ]
        return {
            "type": kind,
            "mode": "markers",
            "marker": {"color": REST, "size": 6},
            "customdata": self.drawn.tolist(),
            "text": names(said),
            "hoverinfo": "text",
            "selected": {"marker": {"color": CHOSEN, "size": 8}},
            "unselected": {"marker": {"opacity": 0.35}},
            **{key: numbers(values) for key, values in at.items()},
        } | ({} if kind != "scatter3d" else {"selected": None, "unselected": None})


_PLAIN = {"displaylogo": False, "displayModeBar": True, "scrollZoom": False}


def _empty(solid: bool) -> dict[str, Any]:
    """The trace that rings the selected poses."""
    ring = {"color": "rgba(0,0,0,0)", "size": 10, "line": {"color": CHOSEN, "width": 3}}
    none: dict[str, Any] = {"x": [], "y": []} | ({"z": []} if solid else {})
    kind = "scatter3d" if solid else "scatter"
    return {"type": kind, "mode": "markers", "marker": ring, "hoverinfo": "skip", **none}

"""Figures of the app itself: the machine in a pose, and errors whose poses can be selected."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.companions.app import words
from loopcal.companions.app.beside import SIZE, LeftOut, errors_by_name
from loopcal.companions.app.scene import Scene, restyled
from loopcal.figures.figure import axis, layout, names, numbers, spots, thinned, upright
from loopcal.figures.space import arrow_lines, enlargement
from loopcal.files.machines.meshes import DrawnLinks
from loopcal.files.result.pose_table import PoseTable
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.outputs import measured_points, seen_outputs
from loopcal.mechanisms.skeleton import skeleton, skeleton_labels
from loopcal.presentation.shown import factor, unit_shown
from loopcal.report.sighted import Sighting, seen, sightings
from loopcal.report.source import Source
from loopcal.statistics.changes import ids_are_numbers

MOST = 2_000
"""Points of one figure; of more the largest and a sample of the rest."""
CHOSEN, REST, DIM = "#d55e00", "#2b7bd6", "rgba(43,123,214,0.35)"
"""Colours on either ground."""
GREY = "#8a919c"
"""Of poses that the fit does not use, on either ground."""
ABOVE = 1.25
"""A figure reaches so many times as high as the largest error used. Beyond it poses left out are
drawn at its edge: one slip of an encoder would flatten all others."""
TRANSPARENT = "rgba(0,0,0,0)"
Framed = tuple[Array, Array]
"""What the axes of a flat figure show: (N,) each."""
COURSE, WINDOW = 80, 0.05
"""Points of the curve through errors that change slowly, and the sd of its window over the run."""
FEWEST = 2.5
"""Poses within that sd at least: fewer would be followed one by one."""
SAMPLED = 30
"""Poses whose machine makes the extent of the figure in space."""
ROOM = 0.15
"""Share of the width of a figure that the name of a change needs."""
NEAR = 0.08
"""Share of the length of a skeleton within which joints share one label, as high as its text is."""
GRID = "rgba(128,128,128,0.3)"
_BRUSHED = {"dragmode": "select", "selectdirection": "d"}
"""A frame is as it is drawn; by default plotly takes a narrow one for a band across all."""
_PLAIN = {"displaylogo": False, "displayModeBar": False, "scrollZoom": False, "responsive": True}


def look(height: int, **more: Any) -> dict[str, Any]:
    """Layout of a figure on either ground."""
    plain = {
        "paper_bgcolor": TRANSPARENT,
        "plot_bgcolor": TRANSPARENT,
        "font": {"color": "#7b828c", "size": 12},
    }
    return layout(height, **more) | plain


def joints_of(mechanism: Mechanism) -> list[str]:
    """The readings that pose a machine: joints of its chain, else what is no measured point."""
    joints = list(mechanism.joints)
    measured = {name for point in measured_points(mechanism) for name in point}
    measured |= {name for one in seen_outputs(mechanism) for name in one.position}
    return joints or [name for name in mechanism.quantities if name not in measured]


def machine_figure(
    scene: Scene, joints: Mapping[str, float], cloud: Array | None = None
) -> dict[str, Any] | None:
    """The machine in one pose; None where nothing of it has a place; cloud: (N, d) further
    points."""
    mechanism = scene.mechanism
    points = scene.skeleton(joints)
    if points is not None and points.shape[1] == 2:
        data = [_joints_named(mechanism, points)]
    else:
        data = scene.traces(joints)
        if points is not None:
            data.insert(0, _joints_named(mechanism, points))
    if not any(np.isfinite(np.array(trace["x"], dtype=float)).any() for trace in data):
        return None
    flat = "z" not in data[0]
    if cloud is not None and len(cloud):
        marker = {"size": 5 if flat else 3, "color": CHOSEN, "opacity": 0.7}
        count = [f"pose {i}" for i in range(1, len(cloud) + 1)]
        data.append(spots("markers", cloud.T, marker=marker, text=count, hoverinfo="text"))
    if flat:
        more: dict[str, Any] = {"xaxis": axis("x [m]"), "yaxis": axis("y [m]", scaleanchor="x")}
    else:
        more = {"scene": {}}
    return {
        "data": data,
        "layout": look(420, showlegend=False, uirevision="machine", **more),
        "config": _PLAIN,
    }


def _joints_named(mechanism: Mechanism, points: Array) -> dict[str, Any]:
    """The joints of a machine with their names; of one in a plane also its limbs."""
    flat = points.shape[1] == 2
    return spots(
        "lines+markers+text" if flat else "markers+text",
        points.T,
        line={"color": REST, "width": 6},
        marker={"size": 8 if flat else 4, "color": REST},
        text=names(_joined(skeleton_labels(mechanism), points)),
        textposition="top center",
        hoverinfo="text",
    )


def _joined(labels: Sequence[str], points: Array) -> list[str]:
    """The labels, those of neighbours on the spot in one, as of a wrist: none covers another."""
    near = NEAR * float(np.nansum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    joined, first = [*labels], 0
    for i in range(1, len(joined)):
        if joined[i] and joined[first] and np.linalg.norm(points[i] - points[first]) < near:
            joined[first], joined[i] = f"{joined[first]}, {joined[i]}", ""
        else:
            first = i
    return joined


def moved(scene: Scene, joints: Mapping[str, float]) -> list[Any]:
    """What `restyle` makes of the machine's traces to move it to another pose, and which these
    are."""
    points = scene.skeleton(joints)
    if points is not None and points.shape[1] == 2:
        return [{k: [numbers(v)] for k, v in zip("xy", points.T, strict=True)}, [0]]
    named = [] if points is None else [points]
    return restyled([*named, *scene.moved(joints)], 0)


def end_points(mechanism: Mechanism, poses: Sequence[Mapping[str, float]]) -> Array | None:
    """(N, d) where the machine's end is in these poses [m]; None where it has no known shape."""
    skeletons = [skeleton(mechanism, pose) for pose in poses]
    if not skeletons or any(points is None for points in skeletons):
        return None
    return np.array([points[-1] for points in skeletons if points is not None])


@dataclass(frozen=True, eq=False)
class Errors:
    """What the linked figures show: the error of each pose, after the calibration.

    shown: name -> (N,) in the unit of `units`, the size first; numbers: (N,) of the poses, their
    ids where these rise; drawn: positions of the poses that are drawn; steps: numbers from which on
    something is modelled as moved; selected: positions of the poses that are marked; changed:
    numbers from which on a finding says that something changed, and how it is named; left_out:
    the poses that the fit does not use; links: the shapes of the machine;
    slow: whether a finding says that errors depend on the order of the poses.
    """

    source: Source
    shown: Mapping[str, Array]
    units: Mapping[str, str]
    numbers: Array
    drawn: NDArray[np.int64]
    steps: tuple[float, ...] = ()
    selected: Sequence[int] = ()
    changed: Mapping[float, str] = field(default_factory=dict)
    left_out: LeftOut | None = None
    links: DrawnLinks | None = None
    slow: bool = False

    @classmethod
    def of(
        cls,
        source: Source,
        steps: Sequence[float] = (),
        selected: Sequence[int] = (),
        *,
        differences: Mapping[str, Array] | None = None,
        changed: Mapping[float, str] = MappingProxyType({}),
        left_out: LeftOut | None = None,
        links: DrawnLinks | None = None,
        slow: bool = False,
    ) -> Errors | None:
        """None for a result without outputs. differences: shown instead of the result's."""
        table, accuracy = source.table, source.document.accuracy
        if accuracy is None or not table.differences_after:
            return None
        if differences is None:
            differences = table.differences_after
        shown, units = errors_by_name(source, differences, accuracy.unit)
        kept = thinned(np.nan_to_num(shown[SIZE]), MOST).index
        order = np.arange(1.0, len(table.poses) + 1.0)
        if ids_are_numbers(table.poses):
            order = np.array([float(pose) for pose in table.poses])
        at = tuple(steps)
        return cls(source, shown, units, order, kept, at, selected, changed, left_out, links, slow)

    @property
    def size(self) -> Array:
        """(N,) one number for each pose."""
        return self.shown[SIZE]

    @property
    def unit(self) -> str:
        """Of the size."""
        return self.units[SIZE]

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

    def between(self, low: float, high: float) -> Errors | None:
        """The same of the poses with these numbers alone; None where there are none."""
        indices = np.flatnonzero((low <= self.numbers) & (self.numbers <= high))
        kept = indices[thinned(np.nan_to_num(self.size[indices]), MOST).index]
        steps = tuple(at for at in self.steps if low <= at <= high)
        return replace(self, drawn=kept, steps=steps) if len(indices) else None

    def over_poses(self, what: str = SIZE) -> dict[str, Any]:
        """The error over the poses in their order, with its level between changes."""
        values = self.shown[what]
        data = [self._points(self.numbers, values)]
        low, high = self.numbers[self.drawn[[0, -1]]] if len(self.drawn) else (0.0, 0.0)
        changed = {at: name for at, name in self.changed.items() if low < at <= high}
        if changed:
            data.append(self._level(sorted({*changed, *self.steps}), values))
        if self.slow:
            data.append(self._course(values))
        data += self._aside(None, what, low, high)
        # Between the last pose ahead of a change and the first one behind it.
        lines = [upright(at - 0.5, CHOSEN, 1) for at in sorted({*self.steps, *changed})]
        said = [
            {
                "x": at - 0.5,
                "y": 1.0,
                "yref": "paper",
                "text": text,
                "showarrow": False,
                "xanchor": "left" if at < 0.5 * (low + high) else "right",
                "yanchor": "bottom",
                "font": {"color": CHOSEN, "size": 12},
            }
            for at, text in names_apart(changed, ROOM * (high - low))
        ]
        title = "pose, in the order of measurement"
        return self._flat(data, title, what, 300, shapes=lines, annotations=said)

    def _level(self, steps: Sequence[float], values: Array) -> dict[str, Any]:
        """A line at the median between one change and the next: the step as an eye takes it."""
        ends = [-np.inf, *steps, np.inf]
        x: list[float | None] = []
        y: list[float | None] = []
        for begin, end in pairwise(ends):
            inside = (begin <= self.numbers) & (self.numbers < end) & np.isfinite(values)
            if inside.any():
                level = float(np.median(values[inside]))
                span = self.numbers[inside]
                x += [float(span[0]) - 0.5, float(span[-1]) + 0.5, None]
                y += [level, level, None]
        line = {"color": CHOSEN, "width": 2}
        return {
            **{"type": "scatter", "mode": "lines", "line": line, "hoverinfo": "skip"},
            **{"x": x, "y": y},
        }

    def _course(self, values: Array) -> dict[str, Any]:
        """A smooth curve through the errors of the poses drawn: a warm-up as an eye takes it.

        Lines fitted about each place, neighbours by weight (Cleveland 1979).
        """
        kept = self.drawn[np.isfinite(values[self.drawn])]
        at, value = self.numbers[kept], values[kept]
        span = float(np.ptp(at)) if len(at) else 0.0
        x = np.linspace(at.min(), at.max(), COURSE) if span > 0.0 else np.zeros(0)
        sd = max(WINDOW, FEWEST / len(self.drawn)) * span
        y = np.empty_like(x)
        for i, place in enumerate(x):
            w = np.exp(-0.5 * np.square((at - place) / sd))
            middle = w @ at / w.sum()
            slope = w @ ((at - middle) * value) / max(w @ np.square(at - middle), 1e-300)
            y[i] = w @ value / w.sum() + slope * (place - middle)
        line = {"color": CHOSEN, "width": 2}
        return spots("lines", np.array([x, y]), line=line, hoverinfo="skip", name="course")

    def _aside(
        self, joint: str | None, what: str, low: float = -np.inf, high: float = np.inf
    ) -> list[dict[str, Any]]:
        """The poses that the fit does not use, in grey; over a joint or over the numbers."""
        aside = self.left_out
        if aside is None or (joint is not None and joint not in aside.readings):
            return []
        accuracy = self.source.document.accuracy
        unit = "m" if accuracy is None else accuracy.unit
        sizes = aside.sizes / factor(unit)
        table = PoseTable(aside.poses, readings=aside.readings)
        of_these, _ = errors_by_name(replace(self.source, table=table), aside.differences, unit)
        values = sizes if what == SIZE else of_these[what]
        at = aside.numbers if joint is None else aside.readings[joint] / factor(self._unit(joint))
        # One left out at an end of the run lies outside of the numbers of the poses used.
        span = max(high - low, 1.0)
        kept = np.isfinite(values) & (at >= low - 0.05 * span) & (at <= high + 0.05 * span)
        most = ABOVE * float(np.nanmax(np.abs(self.shown[what]), initial=0.0))
        beyond = np.abs(values) > most
        shapes = np.where(beyond, np.where(values > 0.0, "triangle-up", "triangle-down"), "x")
        said = [
            f"pose {p}, not used: {v:.3g} {self.unit}"
            for p, v in zip(aside.poses, sizes, strict=True)
        ]
        drawn = np.array([at, np.clip(values, -most, most)])[:, kept]
        marker = {"color": GREY, "size": 8, "symbol": shapes[kept].tolist()}
        text = [one for one, keep in zip(said, kept, strict=True) if keep]
        return [spots("markers", drawn, marker=marker, text=names(text), hoverinfo="text")]

    def over_joint(self, name: str, what: str = SIZE) -> dict[str, Any]:
        """The error over one joint."""
        data = [self._points(self.joint(name), self.shown[what]), *self._aside(name, what)]
        return self._flat(data, f"{name} [{unit_shown(self._unit(name))}]", what, 220)

    def joint(self, name: str) -> Array:
        """(N,) readings of a joint, in the unit shown."""
        return self.source.table.readings[name] / factor(self._unit(name))

    @property
    def solid(self) -> bool:
        """Whether the figure in space has three dimensions."""
        return self._at is not None and len(self._at) == 3

    def seen(self, frame: Mapping[str, Sequence[float]]) -> Framed:
        """(N,) each: where the figure in space shows the poses. Of three dimensions, the frame's
        matrix (16 numbers, column by column) takes points to its axes."""
        at = self._at
        assert at is not None
        if not self.solid:
            return at[0], at[1]
        matrix = np.array(frame["matrix"], dtype=float).reshape(4, 4).T
        # Homogeneous coordinates: the perspective of the scene divides by w.
        x, y, _, w = matrix @ np.array([*at, np.ones(len(self.size))])
        return x / w, y / w

    def framed(self, of: Framed, frame: Mapping[str, Sequence[float]]) -> list[int] | None:
        """Positions of all poses in a frame of a flat figure, also of those that are not drawn;
        None where all are drawn."""
        if len(self.drawn) == len(self.size):
            return None
        inside = np.ones(len(self.size), dtype=bool)
        for values, key in zip(of, "xy", strict=True):
            low, high = sorted(float(v) for v in frame[key])
            inside &= (low <= values) & (values <= high)
        return np.flatnonzero(inside).tolist()

    def _unit(self, name: str) -> str:
        mechanism = self.source.document.mechanism
        assert mechanism is not None
        return {**mechanism.quantities, **mechanism.known}.get(name, "1")

    def in_space(self, what: str = SIZE) -> dict[str, Any] | None:
        """Measured points coloured by the size of the error, and arrows to the computed ones."""
        at, solid = self._at, self.solid
        if at is None:
            return None
        trace = self._points(*at)
        size = self.shown[what]
        sizes = np.abs(size[self.drawn])
        # One lost pose would give all others one colour.
        usual = ABOVE * float(np.nanpercentile(sizes, 95)) if np.isfinite(sizes).any() else 0.0
        trace["marker"] |= {
            "color": numbers(sizes),
            "colorscale": "Viridis",
            "cmin": 0.0,
            "cmax": min(float(np.nanmax(sizes, initial=0.0)), usual) or 1.0,
            "size": 3 if solid else 7,
            "colorbar": {"title": {"text": f"[{self.units[what]}]"}, "thickness": 12},
        }
        if not solid:
            trace["unselected"] = {"marker": {"opacity": 0.35}}
            trace.pop("selected")
        data = [trace]
        said = []
        if solid:
            arrows, times = self._arrows(what)
            data += [arrows, *self._scene_traces()]
            said = [{"text": words.ARROWS.format(times=times)}] if times else []
            more: dict[str, Any] = {"scene": self._extent(at)}
        else:
            more = {f"{k}axis": axis(f"{k} [m]") for k in "xy"} | _BRUSHED
        return {
            "data": data,
            "layout": look(420, showlegend=False, uirevision="space", annotations=said, **more),
            "config": _PLAIN,
        }

    def _arrows(self, what: str) -> tuple[dict[str, Any], str]:
        """The trace of the arrows from measured to computed points, of the instrument shown or of
        all; and how many times they are enlarged, empty without any."""
        some = [s for s in self._sightings if what == s.instrument] or self._sightings
        nothing = np.zeros((3, 0))
        at = np.hstack([nothing, *(s.at[:, self.drawn] for s in some)])
        along = np.hstack([nothing, *(s.along[:, self.drawn] for s in some)])
        whole = np.isfinite((at + along).sum(axis=0))
        look = {"line": {"color": CHOSEN, "width": 2}, "hoverinfo": "skip", "opacity": 0.8}
        if not whole.any():
            return spots("lines", np.full((3, 1), np.nan), **look), ""
        at, along = at[:, whole], along[:, whole]
        times = enlargement(at, np.linalg.norm(along, axis=0))
        lines = arrow_lines(at, times * along)
        return spots("lines", lines, **look), f"{times:,.0f}" if times >= 1 else f"{times:.3g}"

    def _scene_traces(self) -> list[dict[str, Any]]:
        """The machine in the first pose selected, or of all."""
        posed = self._readings(min(self.selected, default=0))
        return [] if self._scene is None else self._scene.traces(posed)

    @cached_property
    def _scene(self) -> Scene | None:
        mechanism = self.source.mechanism
        return None if mechanism is None else Scene(mechanism, self.links)

    def _readings(self, position: int) -> dict[str, float]:
        """What is read in one pose."""
        table = self.source.table
        every = {**table.readings, **table.pose_constants}
        return {q: float(v[position]) for q, v in every.items() if np.isfinite(v[position])}

    def posing(self, position: int) -> list[Any] | None:
        """What `restyle` makes of the figure in space to draw the machine in a pose; None where
        none is drawn."""
        if self._scene is None or not self.solid:
            return None
        moved_traces = self._scene.moved(self._readings(position))
        return restyled(moved_traces, 2) if moved_traces else None

    def _extent(self, at: Array) -> dict[str, list[float]]:
        """Ends of the axes by all that is drawn, so that they stay where the machine moves."""
        some = np.linspace(0, len(self.size) - 1, SAMPLED).astype(int)
        bodies = []
        if self._scene is not None:
            for i in dict.fromkeys(some.tolist()):
                bodies += self._scene.moved(self._readings(i))
        everything = np.vstack([at.T, *bodies])
        ends = np.nanmin(everything, axis=0), np.nanmax(everything, axis=0)
        return dict(zip(("low", "high"), map(numbers, ends), strict=True))

    def _marked(self) -> list[int]:
        """Which of the drawn poses are selected."""
        return np.flatnonzero(np.isin(self.drawn, list(self.selected))).tolist()

    def rms(self, positions: Sequence[int]) -> float:
        """Of the size at some poses."""
        return float(np.sqrt(np.nanmean(np.square(self.size[list(positions)]))))

    @cached_property
    def _sightings(self) -> tuple[Sighting, ...]:
        """Where each instrument read what, of a machine in space."""
        source, table = self.source, self.source.table
        if source.mechanism is None:
            return ()
        every = {**table.pose_constants, **table.readings}
        return sightings(source.mechanism, every, table.differences_after)

    @cached_property
    def _at(self) -> Array | None:
        """(d, N) where the poses were measured [m]; None where nothing says so."""
        one = seen(self.source, self.source.table.differences_after)
        return None if one is None else one.at

    def _flat(
        self, data: list[dict[str, Any]], x: str, what: str, height: int, **more: Any
    ) -> dict[str, Any]:
        said = "error" if what == SIZE else f"error of {what}"
        head = {
            "xaxis": axis(x, gridcolor=GRID, zeroline=False),
            "yaxis": axis(
                f"{said} [{self.units[what]}]",
                gridcolor=GRID,
                rangemode="normal" if what in self.source.table.differences_after else "tozero",
            ),
        }
        drawn = look(height, showlegend=False, **_BRUSHED, **head, **more)
        return {"data": data, "layout": drawn, "config": _PLAIN}

    def _points(self, *at: NDArray[Any]) -> dict[str, Any]:
        """The drawn poses at (N,) coordinates of all."""
        ids = [self.source.table.poses[i] for i in self.drawn]
        said = [
            f"pose {p}: {v:.3g} {self.unit}"
            for p, v in zip(ids, self.size[self.drawn], strict=True)
        ]
        # plotly dims all points where selectedpoints is an empty list, so it is left out.
        marks: dict[str, Any] = {
            "selected": {"marker": {"color": CHOSEN}},
            "unselected": {"marker": {"color": DIM, "opacity": 1.0}},
            **({"selectedpoints": self._marked()} if self.selected else {}),
        }
        return spots(
            "markers",
            np.array(at)[:, self.drawn],
            marker={"color": REST, "size": 6},
            customdata=self.drawn.tolist(),
            text=names(said),
            hoverinfo="text",
            **marks,
        )


def names_apart(changed: Mapping[float, str], room: float) -> list[tuple[float, str]]:
    """The names of changes in the order of the run, where they leave each other room."""
    kept: list[tuple[float, str]] = []
    for at, name in sorted(changed.items()):
        if not kept or at - kept[-1][0] > room:
            kept.append((at, name))
    return kept

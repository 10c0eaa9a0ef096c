"""How good the calibration is on poses not used, over the working region, and on another day."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from nicegui import run, ui
from numpy.typing import NDArray

from loopcal.app import words
from loopcal.app.controls import choice, offer, printed, uploader
from loopcal.app.pictures import look, machine_figure, moved
from loopcal.app.view import View, figure, heading
from loopcal.errors import InputError
from loopcal.figures.figure import axis, names, numbers, spots
from loopcal.files.tables.registry import BY_ENDING
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.outputs import levers, point_family, point_outputs, points
from loopcal.presentation.shown import by_sd, factor, in_unit, unit_shown, with_unit
from loopcal.report import top
from loopcal.report.drawn import figures
from loopcal.report.source import Source
from loopcal.statistics.prediction import Prediction, predict
from loopcal.statistics.predictor import Predictor, predictor_of

ENDS = tuple(BY_ENDING)


def show(view: View) -> None:
    """The step."""
    source = view.session.source()
    if source is None:
        ui.label(view.session.unreadable() or words.NO_RESULT)
        return
    if view.session.state().stale:
        ui.label(words.STALE).classes("care")
    with ui.grid(columns="auto 1fr auto").classes("w-full items-center"):
        for bar in top.accuracy_bars(source.document):
            ui.label(bar.label)
            level = ui.linear_progress(value=bar.share / 100.0, show_value=False, size="16px")
            level.props(f'aria-label="{bar.label}"')
            ui.label(bar.words)
    validation = source.document.validation
    if validation is not None:
        ui.label(words.VALIDATED.format(words=validation.words)).classes("text-body2")
    heading(words.PREDICTED_SD)
    place = ui.column().classes("w-full")
    with place:
        waiting = ui.spinner(size="lg")

    async def fill() -> None:
        prediction = await run.io_bound(_predicted, source)
        waiting.delete()
        with place:
            if prediction is None:
                ui.label(words.NO_REGION)
            else:
                _region(view, source, *prediction)

    # The page is shown ahead of what takes long.
    ui.timer(0.01, fill, once=True)
    _another_day(view)
    drawn = figures(source)
    for key in ("histogram", "arrows"):
        if key in drawn:
            figure(drawn[key])


def _predicted(source: Source) -> tuple[Probe, Map] | None:
    probe = Probe.of(source)
    return None if probe is None else (probe, probe.map())


class _Pose:
    """One pose of the region: its sliders, its prediction, and the machine in it."""

    def __init__(self, view: View, source: Source, probe: Probe) -> None:
        assert source.mechanism is not None
        self.mechanism, self.probe = source.mechanism, probe
        self.asked: dict[str, float] = view.kept.setdefault("validate.joints", {})
        asked = [(n, self.asked[n], span) for n, span in probe.spans.items() if n in self.asked]
        within = {n: min(max(v, low), high) for n, v, (low, high) in asked}
        self.joints = {**probe.predictor.typical, **probe.middle(), **within}
        self.sliders: dict[str, Any] = {}
        self.words: dict[str, Any] = {}
        self.quiet = False
        heading(words.PREDICT_ONE_POSE)
        with ui.element("div").classes("beside"):
            with ui.column().classes("figures"):
                drawn = machine_figure(self.mechanism, self.joints)
                self.plot = None if drawn is None else ui.plotly(drawn).classes("w-full")
            with ui.column().classes("acts"):
                self.outputs = ui.column()
                with ui.grid(columns="auto 1fr 5.5rem").classes("w-full items-center"):
                    for name, (low, high) in probe.spans.items():
                        self._slider(name, low, high)
        self.show()

    def _slider(self, name: str, low: float, high: float) -> None:
        ui.label(name)
        step = (high - low) / 400.0 or 1.0
        slider = ui.slider(min=low, max=high, step=step, value=self.joints[name])
        slider.on_value_change(partial(self._moved, name)).props(f'aria-label="{name}"')
        self.sliders[name], self.words[name] = slider, ui.label()

    def _moved(self, name: str, event: Any) -> None:
        self.joints[name] = self.asked[name] = float(event.value)
        if not self.quiet:
            self.show()

    def go(self, joints: dict[str, float]) -> None:
        """Move all sliders at once."""
        # One prediction for all sliders together.
        self.quiet = True
        for name, value in joints.items():
            self.sliders[name].set_value(value)
        self.quiet = False
        self.show()

    def show(self) -> None:
        """Predict the pose as it stands."""
        for name, label in self.words.items():
            unit = self.probe.units[name]
            label.set_text(f"{in_unit(self.joints[name], unit):z.2f} {unit_shown(unit)}")
        joints = {name: self.joints[name] for name in self.probe.spans}
        self.outputs.clear()
        with self.outputs:
            for line in self.probe.words(joints):
                ui.label(line).classes("text-subtitle1")
        if self.plot is not None:
            moving = moved(self.mechanism, self.joints)
            self.plot.run_plot_method("restyle", moving, [0])


def _region(view: View, source: Source, probe: Probe, region_map: Map) -> None:
    """The sd over the working region, and one pose of it."""
    drawn = map_figure(region_map)
    plot = None
    if drawn is not None:
        ui.label(words.MAP).classes("text-body2")
        plot = ui.plotly(drawn).classes("w-full")
        plot.props('aria-label="predicted sd over the working region"')
    pose = _Pose(view, source, probe)
    if plot is not None:
        picked = "(event) => emit((event?.points ?? []).map((point) => point.customdata))"

        def clicked(event: Any) -> None:
            if event.args:
                pose.go(region_map.pose(int(event.args[0])))

        plot.on("plotly_click", clicked, js_handler=picked)


def _another_day(view: View) -> None:
    """Readings of another day, beside what the result predicts for them."""
    heading(words.ANOTHER_DAY)
    ui.label(words.VERIFY).classes("text-body2")
    uploader(view, words.DROP_ANOTHER_DAY)
    tables = view.files(ENDS)
    if not tables:
        return
    result = view.session.folder.result.name
    choice(view, "verify.file", words.READINGS, tables)
    offer(view, words.VERIFY_IT, lambda: ("verify", result, str(view.kept["verify.file"])))
    printed(view, "verify")


# What a result predicts where nothing was measured: at one pose, and over the working region.

Array = NDArray[np.float64]
PLAIN = {"displaylogo": False, "displayModeBar": False, "scrollZoom": True}
POSES = 400
"""Random poses of the map."""


@dataclass(frozen=True, eq=False)
class Map:
    """at: (d, N) points [m]; sd: (N,) predicted there [m]; joints: joint -> (N,) its readings."""

    at: Array
    sd: Array
    joints: Mapping[str, Array]

    def pose(self, index: int) -> dict[str, float]:
        """The joints of one point."""
        return {q: float(values[index]) for q, values in self.joints.items()}


@dataclass(frozen=True, eq=False)
class Probe:
    """Predicts with the result on the disk. spans: joint -> least and largest reading [SI] of the
    working region; units: of the joints."""

    predictor: Predictor
    spans: Mapping[str, tuple[float, float]]
    units: Mapping[str, str]

    @classmethod
    def of(cls, source: Source) -> Probe | None:
        """None where the result states no working region, or cannot predict."""
        prediction = source.document.prediction
        region = None if prediction is None else prediction.region
        if region is None or source.mechanism is None:
            return None
        try:
            predictor = predictor_of(source.document, source.mechanism)
        except InputError:
            return None
        spans = {span.quantity: (span.low, span.high) for span in region.ranges}
        return cls(predictor, spans, {q: source.mechanism.quantities[q] for q in spans})

    def middle(self) -> dict[str, float]:
        """The pose in the middle of the region."""
        return {q: 0.5 * (low + high) for q, (low, high) in self.spans.items()}

    def at(self, joints: Mapping[str, float]) -> Prediction:
        """The outputs of one pose."""
        return self._predicted({q: np.array([value]) for q, value in joints.items()})

    def words(self, joints: Mapping[str, float]) -> list[str]:
        """The outputs of one pose with half widths of their 95 % intervals, a line each."""
        prediction = self.at(joints)
        half = prediction.half_width()
        return [
            _interval(name, float(prediction.outputs[name][0]), float(half[name][0]), unit)
            for name, unit in prediction.units.items()
        ]

    def map(self) -> Map:
        """Random poses of the region, and the sd predicted there."""
        # A fixed seed: the map stays the same while the result does.
        rng = np.random.default_rng(0)
        poses = {q: rng.uniform(low, high, POSES) for q, (low, high) in self.spans.items()}
        prediction = self._predicted(poses)
        family = point_family(self.predictor.mechanism)
        lengths = [n for n, unit in prediction.units.items() if unit == "m"][:3]
        shown = lengths if family is None else point_outputs(self.predictor.mechanism, family)
        at = np.array([prediction.outputs[n] for n in shown])
        sds = np.array([prediction.sd[n] for n in shown])
        if family is not None:
            # An sd of an angle counts by its lever, as a length.
            at, sds = points(family, at), levers(family, at) * sds
        # The root of the trace of the covariance, which is the same along any axes.
        sd = np.sqrt(np.square(sds).sum(axis=0))
        good = np.isfinite(sd) & np.isfinite(at).all(axis=0) if len(at) else np.zeros(0, bool)
        kept = {q: values[good] for q, values in poses.items()} if len(at) else {}
        return Map(at[:, good] if len(at) else np.zeros((0, 0)), sd[good] if len(at) else sd, kept)

    def _predicted(self, joints: Mapping[str, Array]) -> Prediction:
        count = len(next(iter(joints.values())))
        others = {
            q: np.full(count, value)
            for q, value in self.predictor.typical.items()
            if q not in joints
        }
        units = {**self.predictor.mechanism.quantities, **self.predictor.mechanism.pose_constants}
        readings = {q: v for q, v in {**others, **joints}.items() if q in units}
        return predict(
            self.predictor, Dataset.from_arrays(readings, units={q: units[q] for q in readings})
        )


def map_figure(region_map: Map) -> dict[str, Any] | None:
    """The sd predicted over the working region; None where no point is predicted."""
    if len(region_map.at) < 2 or not len(region_map.sd):
        return None
    scale = factor("m")
    solid = len(region_map.at) == 3
    keys = "xyz"[: len(region_map.at)]
    colour = {"color": numbers(region_map.sd / scale), "colorscale": "Viridis", "size": 5}
    bar = {"title": {"text": f"sd [{unit_shown('m')}]"}, "thickness": 12}
    trace = spots(
        "markers",
        region_map.at,
        marker={**colour, "colorbar": bar},
        customdata=list(range(len(region_map.sd))),
        text=names([with_unit(float(s), "m") for s in region_map.sd]),
        hoverinfo="text",
    )
    titles = {f"{k}axis": axis(f"{k} [m]") for k in keys}
    more = {"scene": {"aspectmode": "data", **titles}} if solid else titles
    return {"data": [trace], "layout": look(440, uirevision="map", **more), "config": PLAIN}


def _interval(name: str, value: float, half: float, unit: str) -> str:
    if not np.isfinite(value):
        return f"{name}: cannot be reached"
    if not np.isfinite(half):
        return f"{name} = {with_unit(value, unit)}, uncertainty unknown"
    return f"{name} = {by_sd(value, half, unit)} ± {with_unit(half, unit, 2)}"

"""How good the calibration is on poses not used, over the working region, and on another day."""

from __future__ import annotations

from functools import partial
from typing import Any

from nicegui import run, ui

from loopcal.companions.app import words
from loopcal.companions.app.controls import choice, offer, printed, uploader
from loopcal.companions.app.pictures import machine_figure, moved
from loopcal.companions.app.predicting import Map, Probe, map_figure
from loopcal.companions.app.scene import Scene
from loopcal.companions.app.view import View, figure, heading, plot, table
from loopcal.files.tables.registry import BY_ENDING
from loopcal.presentation.shown import in_unit, unit_shown
from loopcal.report import top
from loopcal.report.drawn import figures
from loopcal.report.images import OF_IMAGES, image_table
from loopcal.report.source import Source

ENDS = tuple(BY_ENDING)


def show(view: View) -> None:
    """The step."""
    source = view.session.source()
    if source is None:
        ui.label(view.session.unreadable() or words.NO_RESULT).classes("printed-lines")
        return
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
    for key in drawn:
        if key in ("histogram", "arrows") or key.startswith(OF_IMAGES):
            figure(drawn[key])
    images = image_table(source)
    if images is not None:
        heading(images.caption)
        table(images.head, images.rows)


def _predicted(source: Source) -> tuple[Probe, Map] | None:
    probe = Probe.of(source)
    return None if probe is None else (probe, probe.map())


class _Pose:
    """One pose of the region: its sliders, its prediction, and the machine in it."""

    def __init__(self, view: View, source: Source, probe: Probe) -> None:
        assert source.mechanism is not None
        self.scene = Scene(source.mechanism, view.session.links())
        self.probe = probe
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
                drawn = machine_figure(self.scene, self.joints)
                self.plot = None if drawn is None else plot(drawn, words.ROBOT_DRAWN)
            with ui.column().classes("acts"):
                self.outputs = ui.column()
                with ui.grid(columns="auto 1fr 5.5rem").classes("w-full items-center"):
                    for name, (low, high) in probe.spans.items():
                        self._slider(name, low, high)
        self.predict()

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
        """Predict the pose as it stands, and move the machine there."""
        self.predict()
        if self.plot is not None:
            moving = moved(self.scene, self.joints)
            self.plot.run_plot_method("restyle", *moving)

    def predict(self) -> None:
        """State what is predicted at this pose."""
        for name, label in self.words.items():
            unit = self.probe.units[name]
            label.set_text(f"{in_unit(self.joints[name], unit):z.2f} {unit_shown(unit)}")
        joints = {name: self.joints[name] for name in self.probe.spans}
        self.outputs.clear()
        with self.outputs:
            for line in self.probe.words(joints):
                ui.label(line).classes("text-subtitle1")


def _region(view: View, source: Source, probe: Probe, region_map: Map) -> None:
    """The sd over the working region, and one pose of it."""
    drawn = map_figure(region_map)
    region_plot = None
    if drawn is not None:
        ui.label(words.MAP).classes("text-body2")
        region_plot = plot(drawn, words.PREDICTED_SD)
    pose = _Pose(view, source, probe)
    if region_plot is not None:
        picked = "(event) => emit((event?.points ?? []).map((point) => point.customdata))"

        def clicked(event: Any) -> None:
            if event.args:
                pose.go(region_map.pose(int(event.args[0])))

        region_plot.on("plotly_click", clicked, js_handler=picked)


def _another_day(view: View) -> None:
    """Readings of another day, beside what the result predicts for them."""
    heading(words.ANOTHER_DAY)
    ui.label(words.VERIFY).classes("text-body2")
    uploader(view, words.DROP_ANOTHER_DAY)
    tables = view.files(ENDS, "validate")
    if not tables:
        return
    choice(view, "verify.file", words.READINGS, tables)
    offer(
        view, words.VERIFY_IT, lambda: ("verify", view.result_name(), str(view.kept["verify.file"]))
    )
    if view.session.outdated("verify"):
        ui.label(words.OUTDATED).classes("care")
    else:
        printed(view, "verify")

"""The tables of the printed summary, from the parts of a document."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from loopcal.document.accuracy import (
    AccuracyEntry,
    BoardPlace,
    Deviation,
    Distances,
    InstrumentDistances,
    ModelEntry,
    ValidationEntry,
)
from loopcal.document.choice import DECISIVE, Candidate, TermEntry
from loopcal.document.findings import RegionEntry
from loopcal.document.fit import NoiseEntry, ParameterEntry
from loopcal.presentation.shown import (
    Table,
    by_sd,
    columns,
    percent,
    significant,
    size,
    unit_shown,
    with_unit,
)


@dataclass(frozen=True)
class Stage:
    """Distances at a stage, such as "nominal" and "on poses not used"; instrument "": of all."""

    name: str
    instrument: str
    distances: Distances


@dataclass(frozen=True)
class Stages:
    """The lines of the tables of accuracy and of orientation; noise_floor: rms of the first."""

    position: tuple[Stage, ...]
    orientation: tuple[Stage, ...]
    noise_floor: float | None = None


def accuracy_stages(
    accuracy: AccuracyEntry, validation: ValidationEntry | None, updated: bool
) -> Stages:
    """What the tables of accuracy show; several instruments each have lines of their own.

    updated: the fit began with an earlier calibration instead of the drawing.
    """
    held = validation or ValidationEntry({}, "", 0, None, None)
    unseen = {e.instrument: e for e in held.by}
    positions = [_Row("", accuracy, held.accuracy)]
    turns = [_Row("", accuracy.orientation, held.orientation)]
    for e in accuracy.by if len(accuracy.by) > 1 else ():
        held_out = unseen.get(e.instrument, InstrumentDistances(e.instrument, None, None, None))
        if accuracy.orientation is None and e.position is None:
            positions.append(_Row(e.instrument, e.orientation, held_out.orientation))
        else:
            positions.append(_Row(e.instrument, e.position, held_out.position))
            turns.append(_Row(e.instrument, e.orientation, held_out.orientation))
    first = "before the update" if updated else "nominal"
    position = list(_stages(positions, accuracy.unit, first))
    if accuracy.nominal is not None and not updated:
        # After the last "nominal", for several instruments have one each.
        last = max(i for i, stage in enumerate(position) if stage.name == first)
        position.insert(last + 1, Stage("nominal, best placed", "", accuracy.nominal))
    blocked = validation and validation.blocked and validation.blocked.accuracy
    if blocked:
        position.append(Stage("in regions not used", "", blocked))
    images = validation and validation.images and validation.images.accuracy
    if images:
        position.append(Stage("in image regions not used", "", images))
    return Stages(tuple(position), _stages(turns, "rad", first), accuracy.noise_floor)


@dataclass(frozen=True)
class _Row:
    instrument: str
    deviation: AccuracyEntry | Deviation | None
    unseen: Distances | None


def _stages(rows: Sequence[_Row], unit: str, first: str) -> tuple[Stage, ...]:
    shown = [(r, r.deviation) for r in rows if r.deviation is not None and r.deviation.unit == unit]
    stages = [Stage(first, r.instrument, deviation.before) for r, deviation in shown]
    stages += [Stage("calibrated", r.instrument, deviation.after) for r, deviation in shown]
    for row, _ in shown:
        if row.unseen is not None:
            stages.append(Stage("on poses not used", row.instrument, row.unseen))
    return tuple(stages)


def accuracy_table(
    accuracy: AccuracyEntry, validation: ValidationEntry | None, updated: bool
) -> list[str]:
    """Distances by stage, then orientations."""
    stages = accuracy_stages(accuracy, validation, updated)
    lines = _distance_table("accuracy", stages.position, accuracy.unit, stages.noise_floor)
    if accuracy.orientation is not None:
        lines += [
            "",
            *_distance_table("orientation", stages.orientation, accuracy.orientation.unit),
        ]
    return lines


def place_table(
    accuracy: AccuracyEntry, validation: ValidationEntry | None, region: RegionEntry | None
) -> Table | None:
    """Where images put boards, less where the machine puts them; None without cameras.

    region: with the sd that is predicted at the measured poses.
    """
    several = len(accuracy.places) > 1
    blocked, images = validation and validation.blocked, validation and validation.images
    stages = (
        ("calibrated", accuracy.places),
        ("on poses not used", validation.places if validation else ()),
        ("in regions not used", blocked.places if blocked else ()),
        ("in image regions not used", images.places if images else ()),
    )

    def row(name: str, place: BoardPlace, *sizes: float | None) -> tuple[str, ...]:
        name += f", {place.instrument or 'all cameras'}" if several else ""
        return (name, *("" if one is None else size(one, "m") for one in sizes))

    rows = []
    for name, places in stages:
        for one in places:
            space = one.position
            far = (None,) * 3 if space is None else (space.rms, space.p95, space.max)
            rows.append(row(name, one, one.across, one.along, *far))
    for one in accuracy.places:
        if one.noise_across is not None:
            sizes = one.noise_across, one.noise_along, None, None, None
            rows.append(row("noise of corners alone", one, *sizes))
    if rows and region is not None and (predicted := region.of("m")) is not None:
        rows.append(("predicted sd", "", "", size(predicted.sd_at_poses, "m"), "", ""))
    caption = "Place of the board by the images less that by the machine: rms across the line of "
    head = ("board's place", "across view [mm]", "along view", "in space", "95 %", "max")
    return Table(caption + "sight, along it, and in space", head, tuple(rows)) if rows else None


_FAULT = {
    "robot": "The geometry of the robot differs from its drawing.",
    "lens": "The stated lens does not fit these images.",
    "board": "The board is not as stated: measure the print.",
}
"""What follows where the images are predicted better with one of these freed."""
# Paired standard errors that "better" needs (docs/explanation/verdict.md).
_CERTAIN = 2.0


def culprit_table(culprits: Sequence[Candidate], unit: str) -> Table | None:
    """Robot, lens and board freed one by one, and by how much that predicts images better."""
    if not culprits:
        return None
    stated, *freed = culprits
    names = ["all as stated", *(one.name for one in freed[:-1]), "all of them, as calibrated"]
    rows = []
    for name, one in zip(names, culprits, strict=True):
        if one.out_of_sample is None:
            rows.append((name, one.failed or "", "", ""))
            continue
        gain = "" if one is stated or one.difference is None else size(-one.difference, unit)
        sd = size(one.sd, unit, 2) if gain else ""
        rows.append((name, size(one.out_of_sample.rms, unit), gain, sd))
    caption = "What is at fault: each freed alone, all else held as stated; images not used"
    return Table(caption, ("freed", f"rms [{unit_shown(unit)}]", "gain", "sd"), tuple(rows))


def culprit_words(culprits: Sequence[Candidate], unit: str) -> str:
    """What is at fault, in a sentence or two."""
    if not culprits:
        return ""
    stated, *freed = culprits[:-1]
    judged = [one for one in freed if one.out_of_sample and one.difference is not None]
    better = [one for one in judged if -(one.difference or 0.0) > _CERTAIN * (one.sd or 0.0)]
    before = stated.out_of_sample
    if not better or before is None:
        names = " and ".join(one.name for one in judged) or "nothing"
        verb = "predicts" if len(judged) == 1 else "predict"
        return f"Freed alone, {names} {verb} images not used no better than as stated."
    best = min(better, key=lambda one: one.difference or 0.0)
    assert best.out_of_sample is not None
    words = (
        f"Freeing the {best.name} gains most: {size(before.rms, unit, 3)} to "
        f"{with_unit(best.out_of_sample.rms, unit, 3)} on images not used. {_FAULT[best.name]}"
    )
    others = [one.name for one in better if one is not best]
    return words + (f" Freeing the {' or the '.join(others)} gains less." if others else "")


def _distance_table(
    what: str, stages: Sequence[Stage], unit: str, floor: float | None = None
) -> list[str]:
    rows = [[what, f"mean [{unit_shown(unit)}]", "rms", "95 %", "max"]]
    for stage in stages:
        name = f"  {stage.instrument}" if stage.instrument else stage.name
        rows.append([name, *distances_shown(stage.distances, unit)])
    if floor is not None:
        rows.append(["noise floor", "", size(floor, unit), "", ""])
    return columns(rows)


def distances_shown(distances: Distances, unit: str) -> list[str]:
    """Mean, rms, 95 % and largest, in the unit shown."""
    values = (distances.mean, distances.rms, distances.p95, distances.max)
    return [size(value, unit) for value in values]


def machine_table(caption: str, unit: str, machines: Mapping[str, Distances | None]) -> Table:
    """Distances [unit] of each machine that was compared."""
    rows = ((name, *distances_shown(d, unit)) for name, d in machines.items() if d is not None)
    head = ("machine", f"mean [{unit_shown(unit)}]", "rms", "95 %", "max")
    return Table(caption, head, tuple(rows))


def validation_table(validations: Mapping[str, ValidationEntry], unit: str) -> list[str]:
    """One line per method that was validated on the same poses: accuracy [unit], likelihood."""
    shown = unit_shown(unit)
    rows = [["on poses not used", f"mean [{shown}]", "rms", "95 %", "max", "log-likelihood"]]
    for name, entry in validations.items():
        cells = [""] * 4 if entry.accuracy is None else distances_shown(entry.accuracy, unit)
        likely = entry.log_likelihood
        rows.append([name, *cells, "" if likely is None else f"{likely:.1f}"])
    return columns(rows)


def model_table(models: Sequence[ModelEntry], unit: str, scheme: str) -> list[str]:
    """One line per model: its size, rms [unit] and log-likelihood on poses not used; which to take.

    behind: by how much less than the best, with the sd of that difference; scheme: which poses.
    """
    rows = [["model", "parameters", f"rms [{unit_shown(unit)}]", "log-likelihood", "behind", "sd"]]
    for m in models:
        row = [m.name, str(m.parameters), *[""] * 4]
        if m.behind is not None:
            row[2] = "" if m.accuracy is None else size(m.accuracy.rms, unit)
            row[3] = "" if m.log_likelihood is None else f"{m.log_likelihood:.1f}"
            row[4] = "best" if not m.behind else f"{m.behind:.1f}"
            sd = "inf" if m.sd_of_behind is None else f"{m.sd_of_behind:.1f}"
            row[5] = sd if m.behind else ""
        rows.append(row)
    failed = [f"{m.name}: {m.failed}" for m in models if m.failed]
    return [*columns(rows), f"(on poses not used, {scheme})", *failed, recommendation(models)]


def recommendation(models: Sequence[ModelEntry]) -> str:
    """Which model to take, and why."""
    compared = [m for m in models if m.behind is not None]
    best = next(m for m in compared if m.behind == 0.0)
    taken = next(m for m in compared if m.recommended)
    if best is not taken:
        return (
            f"Recommended: {taken.name}, the simplest that is not significantly worse than "
            f"{best.name}."
        )
    if all(m is best or m.parameters >= best.parameters for m in compared):
        return f"Recommended: {best.name}, which predicts best and is the simplest."
    return (
        f"Recommended: {best.name}, which predicts best; every simpler model is significantly "
        f"worse."
    )


def sensor_table(noise: Sequence[NoiseEntry]) -> list[str]:
    """One line per sensor: its sd, how sure and from where, and its variance factor."""
    rows = [["sensor", "sd", "sd of sd", "at most", "factor", "from", "unit"]]
    for entry in noise:
        sd_of_sd, upper = entry.sd_of_sd, entry.upper
        rows.append(
            [
                entry.label,
                size(entry.sd, entry.unit, 3, fine=True),
                "" if sd_of_sd is None else size(sd_of_sd, entry.unit, 2, fine=True),
                "" if upper is None else size(upper, entry.unit, 2, fine=True),
                "" if entry.variance_factor is None else significant(entry.variance_factor, 2),
                entry.source,
                unit_shown(entry.unit, fine=True),
            ]
        )
    note = "(factor: chi-squared of the sensor over its redundancy; 1 where its sd is right)"
    return [*columns(rows), note]


TERM_HEAD = ("model error", "sd", "from", "to", "unit", "used", "of", "gain", "meaning")
"""used: degrees of freedom that the data use, of so many columns; gain: in -2 log likelihood."""


def term_rows(terms: Sequence[TermEntry]) -> list[tuple[str, ...]]:
    """One row per term: the learnt sd, its 95 % interval, what the data use of it, its meaning."""
    return [
        (
            term.name,
            size(term.scale, term.unit, 2, fine=True),
            *(size(end, term.unit, 2, fine=True) for end in term.interval or (None, None)),
            unit_shown(term.unit, fine=True),
            f"{term.effective:.1f}",
            str(term.columns),
            "" if term.gain is None else f"{term.gain:z.0f}",
            term.words,
        )
        for term in terms
    ]


def term_table(terms: Sequence[TermEntry]) -> list[str]:
    """One line per term of the model error."""
    rows = [TERM_HEAD, *term_rows(terms)]
    numbers = columns([list(row[:-1]) for row in rows])
    lines = [f"{line}  {row[-1]}" for line, row in zip(numbers, rows, strict=True)]
    lines.append(f"(gain above {DECISIVE:g}: the machine model is wrong without this term)")
    return lines + [f"  {words}" for term in terms for words in term.sentences]


def shown_parameters(
    parameters: Sequence[ParameterEntry], terms: Sequence[TermEntry]
) -> list[ParameterEntry]:
    """The parameters without the many columns of the model error."""
    hidden = {name for term in terms for name in term.effects}
    return [p for p in parameters if p.name not in hidden and p.role != "corner"]


def parameter_table(parameters: Sequence[ParameterEntry]) -> list[str]:
    """One line per parameter: value, change from nominal and sd, rounded by the sd."""
    head = ["parameter", "value", "change", "sd", "unit"]
    with_error = any(p.error is not None for p in parameters)
    if with_error:
        head.insert(4, "error")
    rows = [head]
    for p in parameters:
        unit, sd = p.unit, p.sd
        row = [p.name, by_sd(p.value, sd, unit), "", p.held, unit_shown(unit)]
        if not p.fixed:
            change = by_sd(p.value - p.nominal, sd, unit, sign=True)
            row[2:4] = [change, "unknown" if sd is None else size(sd, unit, 2)]
        if with_error:
            row.insert(4, "" if p.error is None else by_sd(p.error, sd, unit, sign=True))
        rows.append(row)
    return columns(rows)


def interval_table(parameters: Sequence[ParameterEntry]) -> list[str]:
    """Confidence intervals, by covariance and by profile; those that differ are marked."""
    intervals = [(p, p.interval) for p in parameters if p.interval is not None]
    level = f"{percent(intervals[0][1].level)} " if intervals else ""
    rows = [[f"{level}interval", "from", "to", "profile from", "to", "", "unit"]]
    for p, interval in intervals:
        unit = unit_shown(p.unit)
        if interval.covariance[0] is None:
            rows.append([p.name, *[""] * 4, p.held or "unbounded", unit])
            continue
        ends = (*interval.covariance, *interval.profile)
        cells = ["none" if end is None else by_sd(end, p.sd, p.unit) for end in ends]
        rows.append([p.name, *cells, "differs" if interval.differs else "", unit])
    lines = columns(rows)
    if any(interval.differs for _, interval in intervals):
        lines.append("(differs: use the profile; the covariance ignores the model's curvature)")
    return lines

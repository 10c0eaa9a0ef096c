"""What repeated readings say of the sensors, in words, as lines for [noise] and as plain data."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from loopcal.presentation.shown import p_words
from loopcal.statistics.repeats import CLEAR, Repeats, SensorScatter
from loopcal.statistics.separation import SeparatedSd, Separation
from loopcal.units import from_si, unit

_SMALL = {"m": "um", "rad": "urad"}
_HEAD = ("sensor", "unit", "sd", "+-", "95 % interval", "no drift", "drift/row", "p", "step")


def summary(repeats: Repeats) -> str:
    """The table, a sentence for each sensor, and the lines to paste."""
    named = ", ".join(f"{name} ({number})" for name, number in repeats.series)
    lines = [f"Repeated readings of one pose: {named}", "", *_table(repeats), ""]
    lines += [sentence(sensor) for sensor in repeats.sensors]
    if repeats.correlated:
        lines += ["", *_correlated(repeats)]
    if repeats.separation is not None:
        lines += ["", *separated(repeats.separation)]
    return "\n".join([*lines, "", "To paste into the project:", "", noise_table(repeats)])


def sentence(sensor: SensorScatter) -> str:
    """What to put into [noise] for one sensor, and why."""
    head = f"{sensor.name}: sd = {_shown(sensor.sd, sensor)}"
    reasons = []
    if sensor.about_mean.sd == 0.0:
        if sensor.rounding_sd is None:
            return (
                f"{sensor.name}: it never changed, so its sd cannot be estimated from these "
                "readings."
            )
        return (
            f"{head}, what rounding to {_shown(sensor.resolution, sensor)} leaves; it never "
            "changed, so its scatter is below what it can show."
        )
    if sensor.drifts:
        p = min(p for p in (sensor.drift_p_value, sensor.slow_p_value) if p is not None)
        reasons.append(
            f"from successive differences, for it drifts ({p_words(p)}): about the mean it would "
            f"be {_shown(sensor.about_mean.sd, sensor)}, drift included"
        )
    if sensor.rounding_sd is not None and sensor.rounding_sd > sensor.scatter.sd:
        reasons.append(
            f"what rounding to {_shown(sensor.resolution, sensor)} leaves; the readings scatter "
            "less"
        )
    # 0.3 of the sd is 9 % of the variance: less changes the sd by less than 5 %.
    elif sensor.rounding_sd is not None and sensor.rounding_sd > 0.3 * sensor.scatter.sd:
        reasons.append(
            f"of which rounding to steps of {_shown(sensor.resolution, sensor)} makes "
            f"{_shown(sensor.rounding_sd, sensor)}"
        )
    if sensor.alternating_p_value is not None and sensor.alternating_p_value < CLEAR:
        reasons.append("readings alternate, as if the pose were approached from two sides")
    if sensor.homogeneity_p_value is not None and sensor.homogeneity_p_value < CLEAR:
        series_sds = ", ".join(_number(sd, sensor) for sd in sensor.by_series)
        reasons.append(
            f"but the series differ ({p_words(sensor.homogeneity_p_value)}: {series_sds}): it "
            "depends on the pose, or something moved"
        )
    if sensor.parked:
        series = "one series" if sensor.parked == 1 else f"{sensor.parked} series"
        reasons.append(f"without {series} in which it never changed (parked?)")
    return "; ".join([head, *reasons]) + "."


def separated(separation: Separation) -> list[str]:
    """What the loops say of joints and instrument, as lines."""
    lines = [
        f"Separated by the loops ({separation.readings} rows; without real motion, which all "
        f"sensors share):"
    ]
    for group in separation.groups:
        lines.append(f"  {group.name} ({', '.join(group.quantities)}): {_separated(group)}")
    if not separation.separable:
        lines.append(
            "  These readings cannot distinguish them. Repeats of a "
            "fixed target with the machine still give the instrument's sd alone; poses with other "
            "lever arms help as well."
        )
    unsure = [group.name for group in separation.groups if group.upper is not None]
    if separation.separable and unsure:
        lines.append(
            f"  The noise of {' and '.join(unsure)} is too small to detect here; only its bound "
            f"is known. To measure it, read a fixed target with the machine at rest."
        )
    lines.append(
        "  What a joint does behind its encoder (gears, bending) counts as noise of the joints; "
        "what all readings of a pose share, such as an offset, is in none of these."
    )
    return lines


def noise_table(repeats: Repeats) -> str:
    """[noise] as TOML; groups that the loops told apart have their own sd."""
    lines = ["[noise]"]
    group_of: dict[str, SeparatedSd] = {}
    if repeats.separation is not None:
        group_of = {q: g for g in repeats.separation.groups for q in g.quantities}
    for sensor in repeats.sensors:
        group = group_of.get(sensor.name)
        sd, why = sensor.sd, ""
        if group is not None:
            sd = group.upper if group.upper is not None else group.sd
            why = "  # 95 % bound" if group.upper is not None else "  # separated by the loops"
            if sensor.rounding_sd is not None and sensor.rounding_sd > sd:
                sd, why = sensor.rounding_sd, "  # what its steps leave"
        if sd == 0.0:
            lines.append(f"# {_key(sensor.name)}: it never changed, so its sd is unknown")
            continue
        if not sensor.unit:
            why += "  # no unit was stated: SI?"
        number, unit_name = _number(sd, sensor), _shown_unit(sensor)
        stated = f', unit = "{unit_name}"' if unit_name else ""
        lines.append(f"{_key(sensor.name)} = {{ sd = {number}{stated} }}{why}")
    return "\n".join(lines)


def document(repeats: Repeats) -> dict[str, Any]:
    """All of it as plain data, SI."""
    sensors = []
    for sensor in repeats.sensors:
        entry = asdict(sensor)
        entry["unit"] = unit(sensor.unit).si if sensor.unit else None
        sensors.append(
            entry | {"drifts": sensor.drifts, "sd": sensor.sd, "words": sentence(sensor)}
        )
    separation = None
    if repeats.separation is not None:
        apart = {"told_apart": repeats.separation.separable}
        separation = asdict(repeats.separation) | apart
    return {
        "series": [{"file": name, "readings": number} for name, number in repeats.series],
        "sensors": sensors,
        "correlations": [asdict(c) for c in repeats.correlations],
        "separation": separation,
        "toml": noise_table(repeats),
    }


def _table(repeats: Repeats) -> list[str]:
    rows = [_HEAD, *(_row(sensor) for sensor in repeats.sensors)]
    widths = [max(len(row[i]) for row in rows) for i in range(len(_HEAD))]
    return [
        "  ".join(
            c.ljust(w) if i < 2 else c.rjust(w)
            for i, (c, w) in enumerate(zip(r, widths, strict=True))
        )
        for r in rows
    ]


def _row(sensor: SensorScatter) -> tuple[str, ...]:
    mean = sensor.about_mean
    drift = max(sensor.drift, key=abs)
    p_values = [p for p in (sensor.drift_p_value, sensor.slow_p_value) if p is not None]
    return (
        sensor.name,
        _shown_unit(sensor) or "?",
        _number(mean.sd, sensor),
        _number(mean.sd_of_sd, sensor),
        f"{_number(mean.low, sensor)} to {_number(mean.high, sensor)}",
        _number(sensor.without_drift.sd, sensor),
        _number(drift, sensor),
        f"{min(p_values):.2g}" if p_values else "",
        "" if sensor.resolution is None else _number(sensor.resolution, sensor),
    )


def _correlated(repeats: Repeats) -> list[str]:
    pairs = sorted(repeats.correlated, key=lambda c: -abs(c.value))
    named = ", ".join(f"{' and '.join(c.sensors)} {c.value:+.2f}" for c in pairs[:6])
    more = f" and {len(pairs) - 6} more pairs" if len(pairs) > 6 else ""
    lines = [f"Correlated beyond chance (1 % over all pairs): {named}{more}."]
    if repeats.separation is None:
        lines.append(
            "Sensors that move together saw something move: these sds hold real motion as well and "
            "are upper bounds. Use --project to separate them by the loops."
        )
    return lines


def _separated(group: SeparatedSd) -> str:
    def text(value: float) -> str:
        small = _SMALL.get(group.unit, group.unit)
        return f"{from_si(value, small):.3g} {small}"

    raw = f"of {text(group.raw)} raw scatter"
    if group.sd == 0.0:
        words = f"no separate noise detected {raw}"
    elif group.sd_of_sd is None:
        words = f"sd = {text(group.sd)} {raw}, not distinguished from the rest"
    else:
        words = f"sd = {text(group.sd)} +- {text(group.sd_of_sd)} {raw}"
    return words if group.upper is None else f"{words}; below {text(group.upper)} (95 %)"


def _shown_unit(sensor: SensorScatter) -> str:
    return _SMALL.get(unit(sensor.unit).si, unit(sensor.unit).name) if sensor.unit else ""


def _number(value: float, sensor: SensorScatter) -> str:
    return f"{from_si(value, _shown_unit(sensor) or '1'):.3g}"


def _shown(value: float | None, sensor: SensorScatter) -> str:
    return f"{_number(value or 0.0, sensor)} {_shown_unit(sensor)}".rstrip()


def _key(name: str) -> str:
    bare = name.replace("_", "").replace("-", "")
    return name if bare.isascii() and bare.isalnum() else '"' + name.replace('"', '\\"') + '"'

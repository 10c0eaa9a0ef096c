"""What a plan promises: sds against the number of poses, and the chosen poses in space."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from loopcal.arrays import Array
from loopcal.figures.figure import (
    AFTER,
    BEFORE,
    COLOURS,
    Figure,
    axis,
    colours,
    layout,
    names,
    shown_text,
    spots,
    suffix,
    trace,
)
from loopcal.figures.space import Machine, machine_trace, space_layout


@dataclass(frozen=True, eq=False)
class Line:
    """A value (n,) by number of poses (n,), NaN where it is not known."""

    name: str
    poses: Sequence[int]
    values: Array


def by_number(lines: Sequence[Line], unit: str, number: int) -> Figure | None:
    """Expected sd of the end point by the number of poses; number: of the plan."""
    if not any(np.isfinite(line.values).any() for line in lines):
        return None
    # The plan as "after", random poses as "before".
    shades = (AFTER, COLOURS[1], BEFORE)
    data = [
        trace(
            "lines+markers",
            line.name,
            line.poses,
            line.values,
            line={"color": shade, "width": 2},
            marker={"size": 4},
        )
        for line, shade in zip(lines, shades, strict=False)
    ]
    sds_text = ", ".join(
        f"{line.name} {float(line.values[list(line.poses).index(number)]):.3g} {unit}"
        for line in lines
        if number in line.poses
    )
    return Figure(
        "by_number",
        "Expected sd of the end point by the number of poses",
        "Stop where the curve is flat: further poses would improve little. Grey: random poses "
        "from the same candidates.",
        f"Expected sd against the number of poses; after {number} poses {sds_text}.",
        tuple(data),
        layout(
            360,
            xaxis=axis("poses", rangemode="tozero"),
            yaxis=axis(f"expected sd [{shown_text(unit)}]", type="log"),
        ),
    )


def parameters_by_number(groups: Mapping[str, Sequence[Line]]) -> Figure | None:
    """Expected sd of every parameter by the number of poses; a panel for each unit."""
    groups = {unit: lines for unit, lines in groups.items() if lines}
    if not groups:
        return None
    data: list[dict[str, Any]] = []
    more: dict[str, Any] = {}
    height = 1.0 / len(groups)
    for i, (unit, lines) in enumerate(groups.items()):
        end = suffix(i)
        top = 1.0 - i * height
        more[f"yaxis{end}"] = axis(
            f"expected sd [{shown_text(unit)}]",
            type="log",
            domain=[top - height + 0.06, top],
        )
        shades = colours(line.name for line in lines)
        data += [
            trace(
                "lines",
                line.name,
                line.poses,
                line.values,
                line={"color": shades[line.name], "width": 1.5},
                yaxis=f"y{end}",
            )
            for line in lines
        ]
    count = sum(len(lines) for lines in groups.values())
    return Figure(
        "parameters_by_number",
        "Expected sd of the parameters by the number of poses",
        "A line begins where the poses determine its parameter.",
        f"Expected sds of {count} parameters against the number of poses.",
        tuple(data),
        layout(
            300 * len(groups) + 80,
            xaxis=axis("poses", rangemode="tozero", anchor=f"y{end}"),
            **more,
        ),
    )


def chosen_points(
    points: Array, use: Sequence[str], ids: Sequence[str], machine: Machine | None
) -> Figure:
    """The end points (d, n) [m] of the chosen poses, in the order to measure them."""
    line = {"color": BEFORE, "width": 1.5}
    way = spots("lines", points, name="order", hoverinfo="skip", line=line)
    data = [way] if machine is None else [machine_trace(machine), way]
    for name, shade in zip(dict.fromkeys(sorted(use)), (AFTER, COLOURS[1]), strict=False):
        some = [i for i, u in enumerate(use) if u == name]
        marker = {"color": shade, "size": 5}
        texts = names([f"{i + 1}: pose {ids[i]}" for i in some])
        hover = {"text": texts, "hoverinfo": "text"}
        data.append(spots("markers", points[:, some], name=name, marker=marker, **hover))
    return Figure(
        "chosen",
        "The chosen poses",
        "End points in the order to measure them, which has short joint travel.",
        f"{len(use)} end points in space, joined in the order to measure them.",
        tuple(data),
        space_layout(data),
    )

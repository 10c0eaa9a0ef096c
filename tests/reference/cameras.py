"""A pinhole camera as an instrument of one's own: steep readings without a unit of length."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import loopcal as lc


def camera(
    name: str = "camera", *, pixels: Sequence[float] = (1.0, 1.0), focal: float = 2000.0
) -> lc.Instrument:
    """A camera that stands still and sees a mark on the body.

    u, v = pixels (focal (x, y) / z + centre), (x, y, z) the mark in the camera; pixels: units of u
    and v, in pixels.
    """
    station, target = lc.instruments.Station(name), lc.instruments.Target.named("mark")
    own = {
        f"{name}_focal": focal,
        f"{name}_aspect": 1.0,
        f"{name}_u": 0.0,
        f"{name}_v": 0.0,
    }

    def equations(frames: Any, x: Any, p: Any) -> list[Any]:
        seen = station.seen(frames[0].point(target.point(p)), p)
        f = p[f"{name}_focal"]
        u = f * seen[0] / seen[2] + p[f"{name}_u"]
        v = f * p[f"{name}_aspect"] * seen[1] / seen[2] + p[f"{name}_v"]
        return [pixels[0] * u - x["u"], pixels[1] * v - x["v"]]

    parameters = {n: lc.Parameter(n, value, "1") for n, value in own.items()}
    return lc.Instrument(
        name,
        {"u": "1", "v": "1"},
        {**parameters, **target.declared},
        equations,
        "image",
        placement=station.declared,
        mounted=tuple(target.declared),
    )

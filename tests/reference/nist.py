"""NIST's certified nonlinear regressions (StRD), each posed as one loop: y - model(x) = 0."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise
from loopcal.mechanisms.mechanism import Mechanism

Model = Callable[[Any, Any], Any]
PI = np.pi


def _season(x: Any, period: Any, cosine: Any, sine: Any) -> Any:
    return cosine * np.cos(2 * PI * x / period) + sine * np.sin(2 * PI * x / period)


def _peak(x: Any, height: Any, centre: Any, width: Any) -> Any:
    return height * np.exp(-((x - centre) ** 2) / width**2)


def _gauss(q: Any, b: Any) -> Any:
    return b.b1 * np.exp(-b.b2 * q.x) + _peak(q.x, b.b3, b.b4, b.b5) + _peak(q.x, b.b6, b.b7, b.b8)


def _lanczos(q: Any, b: Any) -> Any:
    terms = (b.b1, b.b2), (b.b3, b.b4), (b.b5, b.b6)
    return sum(height * np.exp(-rate * q.x) for height, rate in terms)


def _cubics(q: Any, b: Any) -> Any:
    above = b.b1 + b.b2 * q.x + b.b3 * q.x**2 + b.b4 * q.x**3
    return above / (1 + b.b5 * q.x + b.b6 * q.x**2 + b.b7 * q.x**3)


def _chwirut(q: Any, b: Any) -> Any:
    return np.exp(-b.b1 * q.x) / (b.b2 + b.b3 * q.x)


def _enso(q: Any, b: Any) -> Any:
    year = b.b1 + _season(q.x, 12.0, b.b2, b.b3)
    return year + _season(q.x, b.b4, b.b5, b.b6) + _season(q.x, b.b7, b.b8, b.b9)


def _kirby(q: Any, b: Any) -> Any:
    return (b.b1 + b.b2 * q.x + b.b3 * q.x**2) / (1 + b.b4 * q.x + b.b5 * q.x**2)


MODELS: dict[str, Model] = {
    "Bennett5": lambda q, b: b.b1 * (b.b2 + q.x) ** (-1 / b.b3),
    "BoxBOD": lambda q, b: b.b1 * (1 - np.exp(-b.b2 * q.x)),
    "Chwirut1": _chwirut,
    "Chwirut2": _chwirut,
    "DanWood": lambda q, b: b.b1 * q.x**b.b2,
    "ENSO": _enso,
    "Eckerle4": lambda q, b: b.b1 / b.b2 * np.exp(-(((q.x - b.b3) / b.b2) ** 2) / 2),
    "Gauss1": _gauss,
    "Gauss2": _gauss,
    "Gauss3": _gauss,
    "Hahn1": _cubics,
    "Kirby2": _kirby,
    "Lanczos1": _lanczos,
    "Lanczos2": _lanczos,
    "Lanczos3": _lanczos,
    "MGH09": lambda q, b: b.b1 * (q.x**2 + q.x * b.b2) / (q.x**2 + q.x * b.b3 + b.b4),
    "MGH10": lambda q, b: b.b1 * np.exp(b.b2 / (q.x + b.b3)),
    "MGH17": lambda q, b: b.b1 + b.b2 * np.exp(-q.x * b.b4) + b.b3 * np.exp(-q.x * b.b5),
    "Misra1a": lambda q, b: b.b1 * (1 - np.exp(-b.b2 * q.x)),
    "Misra1b": lambda q, b: b.b1 * (1 - (1 + b.b2 * q.x / 2) ** -2),
    "Misra1c": lambda q, b: b.b1 * (1 - (1 + 2 * b.b2 * q.x) ** -0.5),
    "Misra1d": lambda q, b: b.b1 * b.b2 * q.x / (1 + b.b2 * q.x),
    "Nelson": lambda q, b: b.b1 - b.b2 * q.x1 * np.exp(-b.b3 * q.x2),
    "Rat42": lambda q, b: b.b1 / (1 + np.exp(b.b2 - b.b3 * q.x)),
    "Rat43": lambda q, b: b.b1 / (1 + np.exp(b.b2 - b.b3 * q.x)) ** (1 / b.b4),
    "Roszman1": lambda q, b: b.b1 - b.b2 * q.x - np.arctan(b.b3 / (q.x - b.b4)) / PI,
    "Thurber": _cubics,
}


@dataclass(frozen=True)
class Certified:
    """A problem with NIST's answer: parameters and their standard deviations, to 11 digits."""

    mechanism: Mechanism
    data: Dataset
    noise: Noise
    starts: tuple[dict[str, float], dict[str, float]]
    values: dict[str, float]
    sds: dict[str, float]
    residual_sd: float


def certified() -> dict[str, Certified]:
    """All problems by name; predictors are exact, the response has the certified residual sd."""
    stored = tomllib.loads((Path(__file__).parent / "nist_strd.toml").read_text())
    return {name: _problem(name, entry) for name, entry in stored.items()}


def _problem(name: str, entry: dict[str, Any]) -> Certified:
    model = MODELS[name]
    arrays = {key: np.array(entry[key]) for key in ("x", "x1", "x2", "y") if key in entry}
    if name == "Nelson":  # the model is that of log(y)
        arrays["y"] = np.log(arrays["y"])
    names = [f"b{i}" for i in range(1, len(entry["values"]) + 1)]

    def parameters(numbers: list[float]) -> dict[str, float]:
        return dict(zip(names, numbers, strict=True))

    first, second = (parameters(start) for start in entry["starts"])
    return Certified(
        Mechanism.from_function(
            lambda q, b: (q.y - model(q, b),),
            dict.fromkeys(arrays, "1"),
            {b: (value, "1") for b, value in first.items()},
            outputs=("y",),
        ),
        Dataset.from_arrays(arrays),
        Noise({**dict.fromkeys(arrays, 0.0), "y": entry["residual_sd"]}),
        (first, second),
        parameters(entry["values"]),
        parameters(entry["sds"]),
        entry["residual_sd"],
    )

"""How a lens projects a point in front of a camera into its image.

The camera's frame has x to the right, y down and z forward, as in OpenCV and in ROS's optical
frames. With x = X/Z, y = Y/Z, r2 = x^2 + y^2 the pinhole has x' = x, y' = y, and further

    brown (Brown 1971; Conrady 1919), in OpenCV's order k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4:
    x' = x (1 + k1 r2 + k2 r2^2 + k3 r2^3) / (1 + k4 r2 + k5 r2^2 + k6 r2^3)
         + 2 p1 x y + p2 (r2 + 2 x^2) + s1 r2 + s2 r2^2
    y' = y (the same) + p1 (r2 + 2 y^2) + 2 p2 x y + s3 r2 + s4 r2^2

    fisheye (Kannala and Brandt 2006): t = atan2(sqrt(X^2 + Y^2), Z),
    (x', y') = t (1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8) (X, Y) / sqrt(X^2 + Y^2)

    u = f x' + cx,    v = f (1 + aspect) y' + cy    [px].

The centre of the first pixel of an image is (0, 0).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from loopcal.errors import InputError, unknown_name

_BROWN = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4")
LENSES: dict[str, tuple[str, ...]] = {
    "pinhole": (),
    "brown5": _BROWN[:5],
    "brown8": _BROWN[:8],
    "brown12": _BROWN,
    "fisheye": ("k1", "k2", "k3", "k4"),
}
"""By the name of a lens, its coefficients of distortion in OpenCV's order."""
FRAME = ("f", "aspect", "cx", "cy")
"""The other numbers of a camera: focal length, aspect of its pixels less 1, principal point."""
_NEVER_ZERO = 1e-24
"""Added to a square: on the axis of a fisheye the quotient stays finite, within 1e-12 of it."""


@dataclass(frozen=True)
class Intrinsics:
    """A camera without a place: focal lengths and principal point [px], distortion, image size.

    distortion: in the order of `LENSES[lens]`, as OpenCV writes them; image: width and height [px];
    rectified: fx, fy, cx, cy [px] of the rectified images. Both are None where they are not stated.
    Raises InputError for another lens or number of coefficients.
    """

    lens: str
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()
    image: tuple[int, int] | None = None
    rectified: tuple[float, float, float, float] | None = None

    def __post_init__(self) -> None:
        if self.lens not in LENSES:
            raise unknown_name(f"there is no lens {self.lens!r}", self.lens, LENSES)
        wanted = len(LENSES[self.lens])
        if not self.distortion:
            object.__setattr__(self, "distortion", (0.0,) * wanted)
        if len(self.distortion) != wanted:
            raise InputError(
                f"the lens {self.lens!r} has {wanted} coefficients of distortion, and "
                f"{len(self.distortion)} are stated",
                code="wrong-shape",
                remedy="state them in OpenCV's order: " + ", ".join(LENSES[self.lens]),
            )

    @property
    def values(self) -> dict[str, float]:
        """By the names of `FRAME` and of the lens's coefficients."""
        frame = (self.fx, self.fy / self.fx - 1.0, self.cx, self.cy)
        return dict(zip((*FRAME, *LENSES[self.lens]), (*frame, *self.distortion), strict=True))

    @classmethod
    def of(
        cls, lens: str, values: Mapping[str, float], image: tuple[int, int] | None = None
    ) -> Intrinsics:
        """From values by the names of `FRAME` and of the lens's coefficients."""
        f, aspect, cx, cy = (float(values[name]) for name in FRAME)
        distortion = tuple(float(values[name]) for name in LENSES[lens])
        return cls(lens, f, f * (1.0 + aspect), cx, cy, distortion, image)


def project(lens: str, point: Any, values: Mapping[str, Any]) -> tuple[Any, Any]:
    """Pixel (u, v) of a point (X, Y, Z) [m] in the camera's frame.

    point: three numbers, arrays of points or traced values; values: by the names of `FRAME` and
    of the lens's coefficients.
    """
    X, Y, Z = point
    if lens == "fisheye":
        x, y = _fisheye(X, Y, Z, values)
    else:
        x, y = _brown(X / Z, Y / Z, [values[name] for name in LENSES[lens]])
    u = values["f"] * x + values["cx"]
    v = values["f"] * (1.0 + values["aspect"]) * y + values["cy"]
    return u, v


def _brown(x: Any, y: Any, coefficients: list[Any]) -> tuple[Any, Any]:
    if not coefficients:
        return x, y
    k1, k2, p1, p2, k3 = coefficients[:5]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    if len(coefficients) > 5:
        k4, k5, k6 = coefficients[5:8]
        radial = radial / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    xy = 2.0 * x * y
    u = x * radial + p1 * xy + p2 * (r2 + 2.0 * x * x)
    v = y * radial + p1 * (r2 + 2.0 * y * y) + p2 * xy
    if len(coefficients) > 8:
        s1, s2, s3, s4 = coefficients[8:]
        u, v = u + r2 * (s1 + r2 * s2), v + r2 * (s3 + r2 * s4)
    return u, v


def _fisheye(X: Any, Y: Any, Z: Any, values: Mapping[str, Any]) -> tuple[Any, Any]:
    rho = np.sqrt(X * X + Y * Y + _NEVER_ZERO)
    t = np.arctan2(rho, Z)
    t2 = t * t
    k1, k2, k3, k4 = (values[name] for name in LENSES["fisheye"])
    bent = t * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4)))) / rho
    return bent * X, bent * Y


def turning_radius(lens: str, values: Mapping[str, float]) -> float:
    """The radius r at which r (1 + k1 r^2 + k2 r^4 + k3 r^6), and a rational one, turns back.

    inf where it grows without end. In a fisheye it is the angle t [rad].
    """
    names = LENSES[lens]
    if not names:
        return float("inf")
    if lens == "fisheye":
        over = np.array([1.0, *(values[name] for name in names)])
        under = np.array([1.0])
    else:
        over = np.array([1.0, values["k1"], values["k2"], values["k3"]])
        rational = len(names) > 5
        under = np.array([1.0, values["k4"], values["k5"], values["k6"]] if rational else [1.0])
    # d/dr of r N(r^2) / M(r^2): M N + 2 s (N' M - N M') with s = r^2, ascending powers of s.
    N, M = np.polynomial.Polynomial(over), np.polynomial.Polynomial(under)
    s = np.polynomial.Polynomial([0.0, 1.0])
    roots = (M * N + 2.0 * s * (N.deriv() * M - N * M.deriv())).roots()
    real = roots[(np.abs(roots.imag) < 1e-9 * (1.0 + np.abs(roots.real))) & (roots.real > 0.0)].real
    return float(np.sqrt(real.min())) if real.size else float("inf")

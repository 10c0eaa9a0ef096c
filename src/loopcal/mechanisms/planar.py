"""The planar two-link arm of the seed (equations 4.1 and 4.2), measured by its end point.

The Yaskawa Motoman MA1400 as the seed models it (chapter 5): 27 parameters, point measured.

T01 = Tx(x0) Ty(y0) Rx(phix0) Ry(phiy0) Rz(theta_1); T12 and T23 about y, T34 about x, T45 about y,
T56 about z; tool point (x6B, y6B, z6B): complete and minimal for positions, and
free of singularities at parallel axes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from loopcal.expressions.trace import Inputs
from loopcal.keys import Key
from loopcal.mechanisms.chain import BASE, Step, zero_of
from loopcal.mechanisms.machine import Machine
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parameters import Gauge, Parameter, stated
from loopcal.mechanisms.serial import Joint, Motions, chain_machine, serial_arm

NAME = "planar two-link arm"
"""What the arm is called that has no other name."""
PLANAR_TWO_LINK = {
    p.name: p
    for p in (
        Parameter("xA", 0.0, "m").of("placement", BASE, "position along x"),
        Parameter("yA", 0.0, "m").of("placement", BASE, "position along y"),
        Parameter("l2", 0.8, "m").of("length", "phi2", "length of the link after phi2"),
        Parameter("l3", 0.6, "m").of("length", "phi3", "length of the link after phi3"),
        Parameter("phi20", 0.0, "rad").of("placement", BASE, zero_of("phi2")),
        Parameter("phi30", 0.0, "rad").of("zero", "phi3", zero_of("phi3")),
    )
}
"""The six parameters with the dimensions assumed where the seed states none (table 5)."""


@dataclass(frozen=True)
class PlanarPlacement:
    """Moving the arm in its plane shifts A and adds to the first joint's offset."""

    parameters: tuple[str, ...] = ("xA", "yA", "phi20")

    def moved(
        self, values: Mapping[str, float], rotation: NDArray[np.float64], shift: NDArray[np.float64]
    ) -> dict[str, float]:
        """The parameters of the arm moved by p -> rotation @ p + shift (2x2, (2,))."""
        corner = rotation @ np.array([values["xA"], values["yA"]]) + shift
        turn = math.atan2(rotation[1, 0], rotation[0, 0])
        turned = {"xA": float(corner[0]), "yA": float(corner[1]), "phi20": values["phi20"] + turn}
        return dict(values) | turned

    def advice(self, values: Mapping[str, float]) -> tuple[str, ...]:
        """Nothing: the arm's parameters serve at every placement."""
        return ()


def _loops(x: Inputs, p: Inputs) -> tuple[Any, Any]:
    a = x.phi2 + p.phi20
    b = a + x.phi3 + p.phi30
    return (
        p.xA + p.l2 * np.cos(a) + p.l3 * np.cos(b) - x.xP,
        p.yA + p.l2 * np.sin(a) + p.l3 * np.sin(b) - x.yP,
    )


def planar_two_link(
    nominal: Mapping[str, float | Parameter] | None = None, *, name: str = NAME
) -> Mechanism:
    """The planar two-link arm: A, two links, two joint offsets, end point P measured.

    xA + l2 cos(phi2 + phi20) + l3 cos(phi2 + phi20 + phi3 + phi30) - xP = 0, and the same with
    sin for y. Quantities xP, yP [m], phi2, phi3 [rad]; nominal: values [SI] by name.

    Raises InputError for a parameter this arm does not have. Source: seed, (4.1) and (4.2).
    """
    nominal = nominal or {}
    made = Mechanism.from_function(
        _loops,
        quantities={"xP": "m", "yP": "m", "phi2": "rad", "phi3": "rad"},
        parameters=PLANAR_TWO_LINK | stated(PLANAR_TWO_LINK, nominal),
        outputs=("xP", "yP"),
        loops=("xP", "yP"),
        name=name,
    )
    return Mechanism(
        name,
        made.tape,
        made.variables,
        made.parameters,
        made.outputs,
        description={"type": "planar-two-link"},
        placement=PlanarPlacement(),
    )


def planar_machine(*, name: str = NAME) -> Machine:
    """The same arm without its end point measured, to be looked at by any instrument.

    A is the origin of the base, so the links alone are left: l2, l3, phi30, and phi20, which says
    how the base lies and is held unless an instrument reads coordinates in it. The body is the
    second link, its origin P: T_base_body = Rz(phi2 + phi20) Tx(l2) Rz(phi3 + phi30) Tx(l3).
    """
    steps = (
        Step("rz", "phi20", "phi2"),
        Step("tx", "l2"),
        Step("rz", "phi30", "phi3"),
        Step("tx", "l3"),
    )
    made = chain_machine(steps, name=name, description={"type": "planar-two-link"})
    drawn = {n: replace(p, nominal=PLANAR_TWO_LINK[n].nominal) for n, p in made.parameters.items()}
    return replace(made, parameters=drawn, dimension=2, gauge=Gauge(base=("phi20",)))


AXES = "zyyxyz"
DIRECTIONS = (1, 1, -1, -1, -1, -1)
"""Sign of each joint's reading about its axis: S, L, U, R, B, T of the controller."""

NOMINAL = {
    "x1": 0.150,
    "z2": 0.614,
    "z3": 0.200,
    "x4": 0.640,
    "x5": 0.030,
    "x6B": 0.020,
    "y6B": -0.070,
    "z6B": -0.350,
}
"""The drawing's lengths [m]; the tool point is that of the seed's reflector, rounded."""


def motoman_ma1400(
    nominal: Mapping[str, float | Parameter] | None = None,
    *,
    before: Motions = MappingProxyType({}),
    name: Annotated[str, Key("Name of the machine.")] = "Motoman MA1400",
) -> Mechanism:
    """The MA1400 arm with the seed's 27 parameters; joints theta_1 to theta_6, point x, y, z.

    nominal: values [SI] by name that replace the drawing's; before: fixed motions ahead of the
    first joint, as a `Joint` takes them, say {"rz": pi / 2} for an instrument that sees the arm
    turned so far that x1 and y3 would run away. Source: seed, chapter 5.
    """
    joints = list(motoman_joints())
    joints[0] = replace(joints[0], before=dict(before))
    made = serial_arm(joints, {**NOMINAL, **(nominal or {})}, name=name)
    described = {"type": "motoman-ma1400", "before": joints[0].before}
    return replace(made, description=described)


def motoman_joints() -> tuple[Joint, ...]:
    """The six joints, theta_1 to theta_6."""
    return tuple(
        Joint(f"theta_{i}", f"transition-{axis}", direction=direction)
        for i, (axis, direction) in enumerate(zip(AXES, DIRECTIONS, strict=True), 1)
    )

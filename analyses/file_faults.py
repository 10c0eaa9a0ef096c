"""Are faults of whole files named, and are good files left alone?

Simulated readings of the machines and instruments of `analyses.instruments`, from nominal machines
1 mm and 1 mrad off, as they are and with each fault that their instruments allow. `named`: share
of the draws in which the fault is found before any fit and has its code; `blamed`: share of good
draws, and of draws with a length of the machine 50 mm off, in which any fault is found.

    python -m analyses.file_faults [--draws 20] [--only WORD ...] [--write FILE.md]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import loopcal as lc
from analyses.instruments import Setup, setup
from analyses.written import write_block
from loopcal.errors import InputError
from loopcal.estimation.faults.search import column_faults
from loopcal.estimation.steps import started

Array = NDArray[np.float64]
Readings = dict[str, Array]
SETUPS = (
    "six-axis point",
    "six-axis spherical",
    "six-axis pose",
    "six-axis two trackers, two reflectors",
    "six-axis draw-wire",
    "six-axis relative distance",
    "six-axis ball-bar",
    "two-link point",
    "two-link draw-wire",
    "origins point",
    "origins pose",
    "exponentials pose",
)
GOOD, ROUGH = "none", "a length of the drawing 50 mm off"


@dataclass(frozen=True)
class Case:
    """A fault: its codes, any of which names it, and what it does to the readings."""

    codes: tuple[str, ...]
    change: Callable[[Readings, list[str], np.random.Generator], None]


def _lengths(readings: Readings, joints: list[str]) -> list[str]:
    angular = ("_wx", "_wy", "_wz", "azimuth", "elevation", "qw", "qx", "qy", "qz")
    return [q for q in readings if q not in joints and not q.endswith(angular)]


def _scaled(factor: float) -> Callable[[Readings, list[str], np.random.Generator], None]:
    def change(readings: Readings, joints: list[str], rng: np.random.Generator) -> None:
        for q in _lengths(readings, joints):
            readings[q] = factor * readings[q]

    return change


def _turned(factor: float, some: int) -> Callable[[Readings, list[str], np.random.Generator], None]:
    def change(readings: Readings, joints: list[str], rng: np.random.Generator) -> None:
        for q in rng.permutation(joints)[: some or len(joints)]:
            readings[str(q)] = factor * readings[str(q)]

    return change


def _last_reversed(readings: Readings, joints: list[str], rng: np.random.Generator) -> None:
    readings[joints[-1]] = -readings[joints[-1]]


def _exchanged(readings: Readings, joints: list[str], rng: np.random.Generator) -> None:
    one, other = (str(q) for q in rng.permutation(joints)[:2])
    readings[one], readings[other] = readings[other], readings[one]


def _mirrored(readings: Readings, joints: list[str], rng: np.random.Generator) -> None:
    readings["y"] = -readings["y"]


def _quaternion(readings: Readings, joints: list[str], rng: np.random.Generator) -> None:
    w, x, y, z = (readings[f"q{a}"] for a in "wxyz")
    readings |= {"qw": x, "qx": y, "qy": z, "qz": w}


def _inverted(readings: Readings, joints: list[str], rng: np.random.Generator) -> None:
    from scipy.spatial.transform import Rotation

    turned = Rotation.from_quat(np.array([readings[f"q{a}"] for a in "xyzw"]).T).inv()
    point = -turned.apply(np.array([readings[a] for a in "xyz"]).T)
    readings |= dict(zip("xyz", point.T, strict=True))
    readings |= dict(zip(("qx", "qy", "qz", "qw"), turned.as_quat().T, strict=True))


def _rolled(shift: int) -> Callable[[Readings, list[str], np.random.Generator], None]:
    def change(readings: Readings, joints: list[str], rng: np.random.Generator) -> None:
        for q in readings:
            if q not in joints:
                readings[q] = np.roll(readings[q], shift)

    return change


def _shuffled(readings: Readings, joints: list[str], rng: np.random.Generator) -> None:
    order = rng.permutation(len(readings[joints[0]]))
    for q in readings:
        if q not in joints:
            readings[q] = readings[q][order]


def _constant(readings: Readings, joints: list[str], rng: np.random.Generator) -> None:
    readings["z"] = np.full_like(readings["z"], readings["z"][0])


def _other(readings: Readings, joints: list[str], rng: np.random.Generator) -> None:
    for q in joints:
        readings[q] = rng.uniform(-1.0, 1.0, len(readings[q]))


FAULTS: Mapping[str, Case] = {
    "lengths in metres, declared mm": Case(("unit",), _scaled(1e-3)),
    "lengths in inches, declared mm": Case(("unit",), _scaled(1 / 25.4)),
    "lengths in centimetres, declared mm": Case(("unit",), _scaled(0.1)),
    "lengths in millimetres, declared m": Case(("unit",), _scaled(1e3)),
    "joints in gon, declared deg": Case(("unit",), _turned(1 / 0.9, 0)),
    "joints in degrees, declared rad": Case(("unit",), _turned(180 / np.pi, 0)),
    "one joint in degrees, declared rad": Case(("unit",), _turned(180 / np.pi, 1)),
    "last joint reversed": Case(("reversed",), _last_reversed),
    "three joints reversed": Case(("reversed",), _turned(-1.0, 3)),
    "two joints exchanged": Case(("exchanged",), _exchanged),
    "left-handed frame": Case(("left-handed", "reversed"), _mirrored),
    "quaternion x, y, z, w": Case(("orientation",), _quaternion),
    "inverse pose": Case(("pose-inverted",), _inverted),
    "readings one row late": Case(("rows-shifted",), _rolled(1)),
    "readings two rows early": Case(("rows-shifted",), _rolled(-2)),
    "rows shuffled": Case(("rows-shuffled",), _shuffled),
    "z constant": Case(("constant",), _constant),
    "joints of another file": Case(("wrong-machine", "rows-shuffled"), _other),
}


def applies(name: str, given: Setup) -> bool:
    """Whether the instruments of a machine allow a fault."""
    quantities = given.truth.quantities
    contact = "wire" not in quantities and not {"x", "y"} <= {*quantities}
    contact = contact and not any(q.endswith("range") for q in quantities)
    if name in ("left-handed frame", "z constant"):
        return {"x", "y", "z"} <= {*quantities}
    if name in ("quaternion x, y, z, w", "inverse pose"):
        return bool(given.truth.orientations)
    if name.startswith("lengths"):
        return not contact
    if name.startswith(("readings", "rows")):
        return bool(given.truth.outputs) and not contact
    return True


@dataclass(frozen=True)
class Found:
    """What was said of a draw: the codes of the faults found before a fit, or a refusal."""

    codes: tuple[str, ...]
    words: str


def draw(given: Setup, name: str, seed: int) -> Found:
    """One file with a fault, or none."""
    rng = np.random.default_rng([52, seed])
    made = lc.simulate(given.truth, given.driven, noise=given.noise, seed=seed, start=given.start)
    readings = {q: v.copy() for q, v in made.dataset.readings.items()}
    joints = list(given.driven)
    nominal = given.nominal(seed)
    if name in FAULTS:
        FAULTS[name].change(readings, joints, rng)
    elif name == ROUGH:
        own = {step.parameter for step in nominal.chain}
        lengths = [p for p in nominal.parameters if p.unit == "m" and p.name in own]
        longest = max(lengths, key=lambda p: abs(p.nominal))
        nominal = nominal.with_nominal({longest.name: longest.nominal + 0.05})
    held = nominal.with_parameters(nominal.parameters.with_fixed(given.held))
    try:
        problem = started(held, lc.Dataset.from_arrays(readings), given.noise, "auto")
        faults = column_faults(problem, suspected=False)
    except InputError as error:
        return Found((error.code,), str(error))
    return Found(tuple(f.code for f in faults), "; ".join(map(str, faults)))


def lines(draws: int, only: list[str], *, talk: bool = False) -> Iterator[str]:
    """The table."""
    yield f"{'fault':38s} {'files':>5s} {'named':>6s} {'blamed':>6s}"
    chosen = [name for name in SETUPS if all(word in name for word in only)]
    for fault in (GOOD, ROUGH, *FAULTS):
        found = []
        for name in chosen:
            given = setup(name)
            if not applies(fault, given):
                continue
            for seed in range(draws):
                one = draw(given, fault, seed)
                found.append(one)
                right = not one.codes if fault not in FAULTS else _right(fault, one)
                if talk and not right:
                    print(f"  {fault} | {name} | {seed}: {one.codes} {one.words[:230]}", flush=True)
        if not found:
            continue
        share = f"{100 * np.mean([bool(one.codes) for one in found]):5.0f} %"
        named = (
            ""
            if fault not in FAULTS
            else (f"{100 * np.mean([_right(fault, one) for one in found]):4.0f} %")
        )
        yield f"{fault:38s} {len(found):5d} {named:>6s} {'' if named else share:>6s}"


def _right(fault: str, found: Found) -> bool:
    return bool({*FAULTS[fault].codes} & {*found.codes})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--only", nargs="*", default=[])
    parser.add_argument("--talk", action="store_true", help="print draws that went wrong")
    parser.add_argument("--write", type=Path)
    given = parser.parse_args()
    table = []
    for line in lines(given.draws, given.only, talk=given.talk):
        print(line, flush=True)
        table.append(line)
    if given.write:
        write_block(given.write, "file_faults", "\n".join(table))


if __name__ == "__main__":
    main()

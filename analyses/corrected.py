"""Does a corrected target bring a machine where it says, as surely as it says?

A simulated controller computes with the drawing of an arm; the true machine (`gauntlet_truth`: code
of its own) differs from it in its geometry and, "worn", gives way under its weight and has gears
that are out of round; each reading of a joint is a little wrong. A tracker measures some poses, the
arm is calibrated, and targets at fresh joints are corrected. Then the true machine goes to them.
The wanted point is placed by the calibrated placement of the tracker, as a workpiece is.

Printed per arm: rms error of the tool's point before and after; the floor, the rms that the stated
covariance expects; the share of targets inside the stated 95 % region of the point; the largest
difference between f(q) and the wanted pose, q by the controller's inverse from the corrected pose.

    python -m analyses.corrected [--draws 20] [--only WORD ...] [--write FILE.md]

With --write the table goes into the file, and bars of the worn arms into docs/pictures.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import loopcal as lc
from analyses import gauntlet_truth as truth
from analyses.gauntlet_truth import Arm, Link, drawn, random_placement
from analyses.written import write_block
from loopcal.companions.robot.inverse import solve
from loopcal.companions.robot.rigid import between
from loopcal.mechanisms.instruments.point import point
from loopcal.mechanisms.serial import Joint, parameter_name, serial_machine

Array = NDArray[np.float64]
TOOL = np.array([0.05, 0.03, 0.12])
LENGTH, ANGLE, MOUNTED = 3e-4, 5e-4, 2e-3
"""sds by which machines are off their drawing [m, rad], and the target on them [m]."""
ENCODER, SLIDE, TRACKER = 3e-5, 1e-5, 1.5e-5
UR = Arm(
    (
        Link(d=0.1625, alpha=np.pi / 2, mass=4.0),
        Link(a=-0.425, beta=0.0, mass=8.0),
        Link(a=-0.3922, beta=0.0, mass=2.5),
        Link(d=0.1333, alpha=np.pi / 2, mass=1.2),
        Link(d=0.0997, alpha=-np.pi / 2, mass=1.2),
        Link(d=0.0996, mass=0.2),
    ),
    tool_mass=3.0,
)
ARMS = {"six-axis": truth.SIX, "SCARA": truth.SCARA, "UR-like": UR, "seven-axis": truth.SEVEN}
BOXES = {
    "six-axis": np.array([[-2, 2], [-0.8, 1], [-1, 0.8], [-2, 2], [0.4, 1.6], [-2, 2]]),
    "SCARA": np.array([[-2.0, 2.0], [0.5, 2.0], [0.02, 0.18], [-2.5, 2.5]]),
    "UR-like": np.array([[-2, 2], [-2.2, -0.6], [0.6, 2.0], [-2, 0], [-2.0, -0.8], [-2, 2]]),
    "seven-axis": np.array(
        [[-2, 2], [0.3, 1.2], [-1, 1], [-1.6, -0.6], [-2, 2], [0.4, 1.3], [-2, 2]]
    ),
}


INKS = {"before": "#9e9e9e", "after": "#0072b2", "stated: expected rms": "#56b4e9"}
SVG = Path(__file__).parents[1] / "docs" / "pictures" / "corrected.svg"


@dataclass(frozen=True, eq=False)
class Loop:
    """One closed loop: distances (N,) [m] before and after, stated variances (N,) [m^2], whether
    each target lies in its region, the largest difference of f from the wanted pose."""

    before: Array
    after: Array
    variance: Array
    held: Array
    inverse: float


def drawing(arm: Arm) -> lc.Mechanism:
    """The mechanism of an arm as it was drawn, a target seen by a tracker."""
    joints, nominal = [], dict(zip(("tool_x", "tool_y", "tool_z"), TOOL.tolist(), strict=True))
    for i, link in enumerate(arm.links, 1):
        form = "dh" if link.beta is None else "hayati"
        joints.append(Joint(f"q{i}", form, "prismatic" if link.slides else "revolute"))
        own = {"a": link.a, "d": link.d, "alpha": link.alpha, "offset": link.offset}
        if form == "hayati":
            own["beta"] = own.pop("d")
        nominal |= {parameter_name(form, key, i): v for key, v in own.items()}
    made = lc.assemble(serial_machine(joints), [point()])
    return made.with_nominal({n: v for n, v in nominal.items() if n in made.parameters.names})


def worn(arm: Arm, rng: np.random.Generator) -> Arm:
    """The arm with sag of some tenths of a millimetre and gears out of round by some 0.1 mrad."""
    n = len(arm.links)
    reach = sum(abs(link.a) + abs(link.d) for link in arm.links)
    weight = arm.tool_mass + 0.5 * sum(link.mass for link in arm.links)
    sizes, phases = 1e-4 * rng.standard_normal((2, n)), rng.uniform(-3.1, 3.1, (2, n))
    slides = np.array([link.slides for link in arm.links])
    gears = np.column_stack([sizes[0], phases[0], sizes[1], phases[1]]) * ~slides[:, None]
    return replace(arm, yielding=4e-4 / (reach**2 * weight * truth.GRAVITY), gears=gears)


def prior(mechanism: lc.Mechanism) -> lc.Prior:
    """What is known of a machine that is off its drawing as these are; nothing of its placement."""
    sds = {}
    for p in mechanism.parameters:
        size = LENGTH if p.unit == "m" else ANGLE
        sds[p.name] = {"mounting": MOUNTED, "placement": np.inf}.get(p.role, size)
    return lc.Prior(sds)


def closed_loop(name: str, seed: int, *, wear: bool, poses: int = 100, targets: int = 100) -> Loop:
    """One arm, measured, calibrated, corrected, and sent to its targets.

    wear: calibrated with the structured model error; without it by the machine's own priors.
    """
    rng = np.random.default_rng([len(name), seed])
    box, drawn_arm = BOXES[name], drawing(ARMS[name])
    true = ARMS[name].perturbed(rng, LENGTH, ANGLE)
    true = worn(true, rng) if wear else true
    mounted = TOOL + MOUNTED * rng.standard_normal(3)
    turn, shift = random_placement(rng, 2.0)

    def seen(q: Array) -> Array:
        R, o = true.flange(q)
        return (o + R @ mounted) @ turn.T + shift

    slides = np.array([link.slides for link in ARMS[name].links])
    sds = np.where(slides, SLIDE, ENCODER)
    q = drawn(box, poses, rng)
    measured = seen(q) + TRACKER * rng.standard_normal((poses, 3))
    names = [f"q{i}" for i in range(1, q.shape[1] + 1)]
    read = dict(zip(names, (q + sds * rng.standard_normal(q.shape)).T, strict=True))
    readings = read | dict(zip("xyz", measured.T, strict=True))
    noise = lc.Noise(dict(zip(names, sds.tolist(), strict=True)) | dict.fromkeys("xyz", TRACKER))
    if wear:
        model = lc.structured(drawn_arm)
        result = lc.calibrate(model, readings, noise=noise, method="implicit-loop")
    else:
        known = prior(drawn_arm)
        result = lc.calibrate(drawn_arm, readings, noise=noise, prior=known, method="implicit-loop")
    wanted = drawn(box, targets, rng)
    done = lc.correct(result, dict(zip(names, wanted.T, strict=True)))
    found, kept = done.corrected, done.corrected.done
    base = done.arms.machine.base
    aim = found.targets.poses[:, :3, 3] @ base[:3, :3].T + base[:3, 3]

    def off(joints: Array) -> Array:
        error = seen(joints + sds * rng.standard_normal(joints.shape)) - aim
        return error @ base[:3, :3]

    before, after = off(wanted)[kept], off(found.joints)[kept]
    C = found.reached.covariance.matrix[kept, :3, :3]
    square = np.einsum("ni,ni->n", after, np.linalg.solve(C, after[:, :, None])[:, :, 0])
    return Loop(
        np.linalg.norm(before, axis=1),
        np.linalg.norm(after, axis=1),
        np.einsum("nii->n", C),
        square <= found.reached.region()[kept],
        _inverse(done),
    )


def _inverse(done: lc.Correction) -> float:
    """How far f(q) is from the wanted pose, q of the controller's inverse; of a redundant arm at
    the corrected joints themselves, of an arm of few joints by its point alone."""
    found, kept = done.corrected, done.corrected.done
    q = found.joints[kept]
    if q.shape[1] <= 6:
        q = solve(done.arms.controller, found.poses[kept], found.targets.joints[kept]).joints
    left = between(done.arms.machine(q), found.targets.poses[kept])
    return float(np.abs(left[:, : 6 if q.shape[1] >= 6 else 3]).max())


def line(name: str, loops: list[Loop]) -> str:
    """A row of the table."""
    before, after, variance = (
        np.concatenate([getattr(loop, key) for loop in loops])
        for key in ("before", "after", "variance")
    )
    rms = [1e3 * float(np.sqrt(np.mean(v))) for v in (before**2, after**2, variance)]
    shares = np.array([loop.held.mean() for loop in loops])
    held, sd = 100.0 * shares.mean(), 100.0 * shares.std(ddof=1) / np.sqrt(len(shares))
    worst = max(loop.inverse for loop in loops)
    return (
        f"{name:<22}{len(after):>8}{rms[0]:>9.3f}{rms[1]:>8.3f}{rms[2]:>8.3f}"
        f"{rms[1] / rms[2]:>8.2f}{held:>8.1f} +- {sd:.1f} %{worst:>11.0e}"
    )


HEAD = (
    f"{'arm':<22}{'targets':>8}{'before':>9}{'after':>8}{'floor':>8}{'ratio':>8}"
    f"{'inside region':>16}{'inverse':>11}"
)


def bars(rows: list[str]) -> str:
    """Bars of the rms errors of worn arms before and after, and what is stated, as SVG."""
    wide, high, left, top, bottom = 720, 340, 64, 54, 36
    low, most = 0.01, 2.0

    def up(value: float) -> float:
        share = np.log(min(max(value, low), most) / low) / np.log(most / low)
        return float(high - bottom - share * (high - bottom - top))

    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {wide} {high}" '
        'font-family="sans-serif" font-size="13">',
        "<title>Errors at the targets of a program before and after its correction</title>",
        f'<rect width="{wide}" height="{high}" fill="white"/>',
    ]
    for tick in (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0):
        y = up(tick)
        lines.append(f'<path d="M{left},{y:.1f}H{wide - 16}" stroke="#ddd"/>')
        lines.append(f'<text x="{left - 8}" y="{y + 4:.1f}" text-anchor="end">{tick:g}</text>')
    shown = [row for row in rows if ", worn" in row]
    group = (wide - 16 - left) / len(shown)
    bar = 0.75 * group / len(INKS)
    for j, row in enumerate(shown):
        name, values = row[:22].strip().removesuffix(", worn"), map(float, row[30:55].split())
        begin = left + j * group + 0.125 * group
        for i, (value, ink) in enumerate(zip(values, INKS.values(), strict=True)):
            x, y = begin + i * bar, up(value)
            lines.append(
                f'<rect x="{x:.1f}" y="{y:.1f}" width="{bar - 4:.1f}" '
                f'height="{high - bottom - y:.1f}" fill="{ink}"/>'
            )
            lines.append(
                f'<text x="{x + 0.5 * (bar - 4):.1f}" y="{y - 4:.1f}" text-anchor="middle" '
                f'font-size="11">{value:.3f}</text>'
            )
        middle = begin + 0.375 * group
        lines.append(f'<text x="{middle:.1f}" y="{high - 14}" text-anchor="middle">{name}</text>')
    for i, (label, ink) in enumerate(INKS.items()):
        lines.append(f'<rect x="{left + i * 170}" y="14" width="12" height="12" fill="{ink}"/>')
        lines.append(f'<text x="{left + i * 170 + 17}" y="25">{label}</text>')
    y = 0.5 * (high - bottom + top)
    lines.append(
        f'<text x="14" y="{y}" transform="rotate(-90 14 {y})" text-anchor="middle">'
        "rms error of the tool's point [mm]</text>"
    )
    return "\n".join([*lines, "</svg>", ""])


def main() -> None:
    """Run what is asked for, and print the table."""
    parser = argparse.ArgumentParser(description="Closed loops of corrected targets.")
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--only", nargs="*", default=[])
    parser.add_argument("--write", type=Path)
    given = parser.parse_args()
    rows = [HEAD]
    for wear in (False, True):
        for name in ARMS:
            label = f"{name}{', worn' if wear else ''}"
            if given.only and not any(word in label for word in given.only):
                continue
            loops = [closed_loop(name, seed, wear=wear) for seed in range(given.draws)]
            rows.append(line(label, loops))
            print(rows[-1], flush=True)
    if given.write:
        write_block(given.write, "corrected", "\n".join(rows))
        SVG.write_text(bars(rows), "utf-8")


if __name__ == "__main__":
    main()

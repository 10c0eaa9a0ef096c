"""Do calibrations by cameras hold? Coverage of 95 % regions, and of learnt sds.

Robots with a camera on the hand or in front of it are simulated by code of their own
(`analyses.cameras_truth`): three makes of arms, off their drawings as `loopcal init` states, K and
print unknown, 40 images of 48 corners. Of each draw the folder of a user goes through

    loopcal init FOLDER --dh dh.csv

and its calibration by the implicit loop, or through `loopcal init FOLDER` where the poses of the
flange are kept instead of the joints: as the joints state them, or each 0.3 mm and 0.3 mrad off. A
region of l parameters holds where

    (estimate - truth)^T C^-1 (estimate - truth) / l

is at most the 95 % quantile of F; C their covariance, whose learnt sds state the denominator.

    python -m analyses.cameras [--draws 40] [--kinds KIND ...] [--encoder 50] [--processes 1]
        [--keep FILE]

Draws are kept in FILE as they end, and a run goes on where an earlier one stopped.
"""

from __future__ import annotations

import argparse
import re
import tempfile
from functools import partial
from pathlib import Path

import numpy as np
from scipy.stats import beta

import loopcal as lc
from analyses.cameras_truth import Rig, inverse, shots
from analyses.gauntlet_truth import Array, turned_by
from analyses.kept import Draw, complete
from loopcal.small_samples import LearntCovariance, f_tail

KINDS = {
    "eye to hand": (True, "joints"),
    "eye in hand": (False, "joints"),
    "eye to hand, poses": (True, "poses"),
    "eye in hand, poses": (False, "poses"),
    "eye to hand, own errors": (True, "own errors"),
    "eye in hand, own errors": (False, "own errors"),
}
"""Whether the board is held, and what is kept: joints, poses of the flange by joints as read, or
poses of which each has errors of its own."""
OWN = (3e-4, 3e-4)
"""sds of these [m, rad]."""
SIX = "(x|y|z|rz|ry|rx)"
REGIONS = {
    "camera": f"cam_{SIX}",
    "board": f"board_{SIX}",
    "lens": "cam_(f|aspect|c|k|p).*",
    "print": "board_(scale|aspect|warp).*",
    "joints": "(a|d|alpha|offset|beta)_[0-9]",
    "all": ".*",
}
SIGMAS = 1.959963984540054


def truth(rig: Rig) -> dict[str, float]:
    """Under the names that parameters have in a project."""
    true: dict[str, float] = {}
    for j, link in enumerate(rig.arm.links, 1):
        true |= {f"a_{j}": link.a, f"d_{j}": link.d}
        true |= {f"alpha_{j}": link.alpha, f"offset_{j}": link.offset}
        if link.beta is not None:
            true[f"beta_{j}"] = link.beta
    places = (inverse(rig.fixed), rig.carried) if rig.held else (rig.carried, inverse(rig.fixed))
    for owner, T in zip(("cam", "board"), places, strict=True):
        true |= {f"{owner}_{axis}": float(v) for axis, v in zip("xyz", T[:3, 3], strict=True)}
        R = T[:3, :3]
        turns = np.arctan2(R[1, 0], R[0, 0]), -np.arcsin(R[2, 0]), np.arctan2(R[2, 1], R[2, 2])
        true |= {f"{owner}_r{axis}": float(v) for axis, v in zip("zyx", turns, strict=True)}
    lens = ("f", "aspect", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
    true |= {f"cam_{name}": float(v) for name, v in zip(lens, rig.lens, strict=True)}
    printed = ("scale", "aspect", "warp_x", "warp_y")
    true |= {f"board_{name}": float(v) for name, v in zip(printed, rig.printed, strict=True)}
    return true


def judged(name: str, draw: int, encoder: float) -> Draw:
    """Where the truth lies in the regions of one calibration."""
    held, kept = KINDS[name]
    posed = kept != "joints"
    shot = shots(draw, held, encoder=encoder)
    T = shot.rig.flange(shot.read)
    if kept == "own errors":
        rng = np.random.default_rng([48, draw, held])
        off = turned_by(OWN[1] * rng.normal(size=(len(shot.q), 3)))
        T = shot.rig.flange(shot.q)
        T[:, :3, :3] = T[:, :3, :3] @ off
        T[:, :3, 3] += OWN[0] * rng.normal(size=(len(shot.q), 3))
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        shot.write(folder, T=T if posed else None)
        project = lc.init(folder, dh=None if posed else folder / "dh.csv")
    found = lc.calibrate(
        project.mechanism, project.dataset, noise=project.noise, method="implicit-loop"
    )
    true, names = truth(shot.rig), list(found.estimated)
    wrapped = {n: found.value[n] - true[n] for n in names}
    turns = [n for n in names if found.mechanism.parameters[n].unit == "rad"]
    wrapped |= {n: float((wrapped[n] + np.pi) % (2.0 * np.pi) - np.pi) for n in turns}
    error = np.array([wrapped[n] for n in names])
    answer: Draw = {"kind": name, "draw": draw, "converged": found.status.converged}
    answer |= {"family": shot.rig.family, "single": {}, "sds": {}}
    for region, pattern in REGIONS.items():
        some = [i for i, n in enumerate(names) if re.fullmatch(pattern, n)]
        if some:
            answer[region] = p_value(error[some], found.learnt_covariance.of(np.array(some)))
    for n, e in zip(names, error, strict=True):
        sd, freedom = found.sd[n] or np.nan, found.degrees_of_freedom[n] or np.inf
        answer["single"][n] = f_tail((e / sd) ** 2, 1, freedom)
    sds = {"cam": shot.rig.corner, "theta": encoder}
    assert found.estimate is not None
    for one in found.estimate.components:
        key = "cam" if one.name.startswith("cam") else "theta"
        begun = found.estimate.began.uncertainty.sd[one.quantities[0], 0]
        if one.sd_of_ratio and (key == "cam" or not posed):
            answer["sds"][key] = (one.ratio - sds[key] / begun) / one.sd_of_ratio
    return answer


def p_value(error: Array, covariance: LearntCovariance) -> float:
    """Of an error this far out, where the covariance is right."""
    scale = 1.0 / np.sqrt(np.diag(covariance.matrix))
    scaled = covariance.matrix * scale * scale[:, None]
    t = float((error * scale) @ np.linalg.solve(scaled, error * scale))
    return f_tail(t, len(error), float(covariance.denominator))


def share(held: int, of: int) -> str:
    """In percent, with the Clopper-Pearson interval of 95 %."""
    low = beta.ppf(0.025, held, of - held + 1) if held else 0.0
    high = beta.ppf(0.975, held + 1, of - held) if held < of else 1.0
    return f"{100 * held / of:5.1f} ({100 * low:.1f} to {100 * high:.1f})"


def main() -> None:
    """Run what is missing and print the table."""
    options = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    options.add_argument("--draws", type=int, default=40)
    options.add_argument("--first", type=int, default=0)
    options.add_argument("--kinds", nargs="+", choices=[*KINDS], default=[*KINDS])
    options.add_argument("--encoder", type=float, default=50.0, help="sd of a joint [urad]")
    options.add_argument("--processes", type=int, default=1)
    options.add_argument("--keep", type=Path, default=Path(".cache/cameras.jsonl"))
    chosen = options.parse_args()
    draws = range(chosen.first, chosen.first + chosen.draws)
    run = partial(judged, encoder=1e-6 * chosen.encoder)
    wanted = [(name, i) for i in draws for name in chosen.kinds]
    done = complete(chosen.keep, wanted, run, chosen.processes, f"{chosen.encoder:g}")
    print("95 % regions hold the truth [%], with the interval of the draws")
    for name in KINDS:
        some = [one for one in done if one["kind"] == name]
        if not some:
            continue
        print(f"{name}: {len(some)} draws, {sum(one['converged'] for one in some)} converged")
        for region in REGIONS:
            p = [one[region] for one in some if region in one]
            if p:
                print(f"  {region:8} {share(sum(v > 0.05 for v in p), len(p))}")
        singles = [p > 0.05 for one in some for p in one["single"].values()]
        print(f"  single   {100 * np.mean(singles):5.1f} of {len(singles)}")
        for key in ("cam", "theta"):
            z = [one["sds"][key] for one in some if key in one["sds"]]
            if z:
                held = sum(abs(v) <= SIGMAS for v in z)
                print(f"  sd {key:5} {share(held, len(z))}, mean {np.mean(z):+.2f} sds")


if __name__ == "__main__":
    main()

"""Every number of result.json for many projects, and how two versions of loopcal differ in them.

    python -m analyses.snapshot write SNAPSHOT.json [--command .venv/bin/loopcal]
    python -m analyses.snapshot compare BEFORE.json AFTER.json [--tolerance 1e-12]

`write` calibrates the examples, the measured sets (where `LOOPCAL_DATA` or ../shared/data has
them) and 50 random projects through the command line, so that any two versions can be compared:
install each in an environment of its own and name its command.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import random
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import tomli_w

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = ROOT / "examples"
RANDOM_PROJECTS = 50
TYPES = (
    *("planar-two-link", "serial", "serial-trackers", "serial-draw-wire", "serial-socket", "urdf"),
    *("exponentials", "motoman-ma1400", "four-bar", "five-bar", "three-rrr", "linear-delta"),
    *("rotary-delta", "stewart-gough"),
)
METHODS = ("implicit-loop", "implicit-loop", "least-squares", "reweighted")
ROUNDING = ("closure.after", "status.message", "status.iterations", "loopcal", "versions")
"""Entries that hold nothing but rounding, or words."""
Where = tuple[str | int, ...]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    commands = parser.add_subparsers(dest="action", required=True)
    write = commands.add_parser("write")
    write.add_argument("snapshot", type=Path)
    write.add_argument("--command", default=str(Path(sys.executable).parent / "loopcal"))
    compare = commands.add_parser("compare")
    compare.add_argument("before", type=Path)
    compare.add_argument("after", type=Path)
    compare.add_argument("--tolerance", type=float, default=1e-12)
    given = parser.parse_args()
    if given.action == "write":
        given.snapshot.write_text(json.dumps(snapshot(given.command), indent=0), "utf-8")
        return 0
    before, after = (json.loads(p.read_text("utf-8")) for p in (given.before, given.after))
    lines = differences(before, after, given.tolerance)
    print("\n".join(lines) if lines else "equal")
    return int(bool(lines))


def snapshot(command: str) -> dict[str, Any]:
    """Project -> content of its result.json; or what the command said where there is none."""
    found = {}
    with tempfile.TemporaryDirectory() as name:
        for title, project, options in projects(command, Path(name)):
            out = Path(name) / "results" / title
            done = run(command, "calibrate", project, "--no-report", "--out", out, *options)
            written = out / "result.json"
            content = json.loads(written.read_text("utf-8")) if written.is_file() else {}
            found[title] = {"exit": done.returncode, "result": content}
            print(f"{title}: exit {done.returncode}", file=sys.stderr, flush=True)
    return found


def projects(command: str, folder: Path) -> Iterator[tuple[str, Path, tuple[str, ...]]]:
    """Title, project file and options of every calibration."""
    for path in sorted(EXAMPLES.rglob("*.toml")):
        content = tomllib.loads(path.read_text("utf-8"))
        if "data" in content and "mechanism" in content:
            yield path.relative_to(EXAMPLES).with_suffix("").as_posix(), path, ()
    for number in range(RANDOM_PROJECTS):
        rng = random.Random(number)
        kind = TYPES[number % len(TYPES)]
        made = folder / f"random-{number}"
        run(command, "new", made, "--mechanism", kind)
        project = made / "project.toml"
        content = tomllib.loads(project.read_text("utf-8"))
        data = made / content["data"]["file"]
        run(command, "simulate", project, "--out", data, "--seed", str(number))
        fit = content.setdefault("fit", {})
        fit["method"] = rng.choice(METHODS)
        fit.pop("loss", None)
        factor = math.exp(rng.uniform(-0.5, 0.5))
        for entry in content["noise"].values():
            if isinstance(entry.get("sd"), float | int) and math.isfinite(entry["sd"]):
                entry["sd"] *= factor
                if fit["method"] != "least-squares" and rng.random() < 0.15:
                    entry["estimate"] = "group"
        estimated = any("estimate" in entry for entry in content["noise"].values())
        if fit["method"] == "implicit-loop" and not estimated and rng.random() < 0.25:
            fit["loss"] = rng.choice(("huber", "student-t"))
        content.pop("simulation", None)
        project.write_text(tomli_w.dumps(content), "utf-8")
        folds = ("--folds", "3") if "loss" not in fit and rng.random() < 0.3 else ()
        yield f"random-{number}-{kind}", project, folds


def run(command: str, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
    shared = ROOT.parent / "shared" / "data"
    env = {"LOOPCAL_DATA": str(shared)} | dict(os.environ)
    return subprocess.run(
        [command, *map(str, arguments)], capture_output=True, text=True, env=env, check=False
    )


def differences(before: dict[str, Any], after: dict[str, Any], tolerance: float) -> list[str]:
    """A line for everything of `before` that `after` lacks or has otherwise."""
    lines = []
    for title, old in before.items():
        new = after.get(title)
        if new is None:
            lines.append(f"{title}: missing")
            continue
        if old["exit"] != new["exit"]:
            lines.append(f"{title}: exit {old['exit']} before, {new['exit']} after")
        values = dict(leaves(new["result"]))
        for path, value in leaves(old["result"]):
            name = ".".join(map(str, path))
            if name.startswith(ROUNDING) or name.startswith(("inputs.", "data.")):
                continue
            other = values.get(path, "missing")
            if not alike(value, other, scale(old["result"], path), tolerance):
                lines.append(f"{title}: {name}: {value!r} before, {other!r} after")
    return lines


def leaves(value: Any, path: Where = ()) -> Iterator[tuple[Where, Any]]:
    """All values that hold no others, with where they stand."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from leaves(inner, (*path, key))
    elif isinstance(value, list):
        for number, inner in enumerate(value):
            yield from leaves(inner, (*path, number))
    else:
        yield path, value


def scale(result: dict[str, Any], path: Where) -> float:
    """The size an entry is compared with beside its own: the sds of a covariance or parameter."""
    if path[:2] == ("covariance", "matrix"):
        matrix, (i, j) = result["covariance"]["matrix"], path[2:4]
        diagonal = [matrix[int(k)][int(k)] or 0.0 for k in (i, j)]
        return math.sqrt(abs(diagonal[0] * diagonal[1]))
    if path[:1] == ("parameters",):
        return float(abs(result["parameters"][path[1]]["sd"] or 0.0))
    return 0.0


def alike(old: Any, new: Any, size: float, tolerance: float) -> bool:
    if isinstance(old, bool) or not isinstance(old, float | int):
        return bool(old == new) or isinstance(old, str)
    if isinstance(new, bool) or not isinstance(new, float | int):
        return False
    return abs(old - new) <= tolerance * max(abs(old), abs(new), size)


if __name__ == "__main__":
    raise SystemExit(main())

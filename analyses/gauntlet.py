"""The gauntlet: how often what loopcal answers on the command line is right.

Machines are drawn (`analyses.lives_truth`, no code of loopcal's) whose zeros are off the drawing by
0.1 to 0.6 degrees, twists by 0.5 to 2 mrad and lengths by 0.1 to 1 mm; most of them sag, some have
gears or backlash; poses are random, sorted by the first joint or a raster. A user has CSV files and
a table of Denavit-Hartenberg parameters or a URDF (of a delta: a project). On a first day

    loopcal init day-1.csv --dh dh.csv --out calibration --run

and on a later day, of 20 to 40 poses with the tracker elsewhere,

    loopcal verify calibration/project-result day-2.csv --json

is asked. Nothing is wrong with clean kinds of day (`analyses.gauntlet_kinds`); each other kind has
one fault of the file, the instrument or the machine. The truth is at 200 fresh poses: the rms
error of what `loopcal predict` says, beside the stated sd, the nominal machine and least squares.
On a later day, and where only the instrument was at fault, predictions are placed rigidly first.

- alarm: not sound; on a later day: not as calibrated. An alarm on a clean kind is false.
- wrong: sound, or better, or as calibrated, where the true error is above 1.5 times the stated: of
  `predict` in the region that is called valid; on a later day the one that `verify` expects.
- worse: called better than the nominal machine, and truly worse than it.
- named: the answer speaks of the fault, with its pose or parameter where it has one.
- absurd: on a later day, a change of more than five times the planted size of its unit, or, where
  nothing of its unit was planted, of more than 20 mm or 2 degrees.

    python -m analyses.gauntlet [--draws 40] [--first 0] [--kinds WORD ...] [--processes 2]
        [--keep FILE] [--write]

Draws are kept in FILE as they end, with the stamp of the code that they judged; a run goes on where
an earlier one stopped, and draws of other code do not count; with 0 processes it only counts what
is kept. --kinds takes those whose names have one of the words; --write puts the tables into the
documentation.
"""

from __future__ import annotations

import argparse
import hashlib
import os
from functools import partial
from pathlib import Path

import loopcal
from analyses.gauntlet_asked import RIVAL_POINTS, THE_FLEET, answered, place
from analyses.gauntlet_kinds import KINDS
from analyses.kept import complete
from analyses.rates import tables
from analyses.written import write_block

KEPT = Path(".cache/gauntlet.jsonl")
PAGE = Path("docs/explanation/gauntlet.md")
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "LOOPCAL_THREADS": "1"}


def stamp() -> str:
    """A hash of all that a draw judges: the package, and the gauntlet's own files."""
    here, package = Path(__file__).parent, Path(loopcal.__file__).parent
    own = [
        *here.glob("gauntlet*.py"),
        *here.glob("lives_[pt]*.py"),
        *here.glob("cameras_truth.py"),
    ]
    files = [*sorted(package.rglob("*.py")), *sorted(own)]
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()[:12]


def main() -> None:
    """Run what is missing and print the tables."""
    options = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    options.add_argument("--draws", type=int, default=40)
    options.add_argument("--first", type=int, default=0, help="the first draw")
    options.add_argument("--kinds", nargs="*", default=[""], metavar="WORD")
    options.add_argument("--processes", type=int, default=2)
    options.add_argument("--keep", type=Path, default=KEPT)
    options.add_argument("--write", action="store_true", help=f"write the tables into {PAGE}")
    chosen = options.parse_args()
    os.environ.update(ONE_THREAD)
    code, draws = stamp(), range(chosen.first, chosen.first + chosen.draws)
    names = [name for name in KINDS if any(word in name for word in chosen.kinds)]
    root = chosen.keep.resolve().with_suffix("") / code
    run = partial(answered, root=root)
    if any(KINDS[name].later for name in names):
        fleet = [(THE_FLEET, i) for i in draws if not (place(root, i) / RIVAL_POINTS).exists()]
        complete(chosen.keep, fleet, run, chosen.processes, code, again=True)
    wanted = [
        (name, i) for i in draws for name in names if KINDS[name].happens(KINDS[name].machine(i))
    ]
    done = complete(chosen.keep, wanted, run, chosen.processes, code)
    counted = f"{len(done)} of {len(wanted)} draws, from {draws[0]} to {draws[-1]}"
    text = f"{tables(done)}\n\n{counted}; stamp of the code: {code}"
    print(text)
    if chosen.write:
        write_block(PAGE, "gauntlet", text)


if __name__ == "__main__":
    main()

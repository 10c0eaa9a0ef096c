"""The gauntlet: what the verdict says of clean data sets and of each fault of the field.

Every kind of data set (`analyses.gauntlet_kinds`) is drawn many times and given to the default
call, `loopcal.calibrate` with the drawing, the readings and what sds a user would state. The truth
is `analyses.gauntlet_truth`, which is not loopcal's code. Of each draw is kept what the verdict
said, and how large the true error at fresh poses is beside the stated 95 % region. Counted are

- false alarms: clean sets that are not called sound, be it "no" or "open";
- missed: sets called sound whose true error at fresh poses, in the region called valid, exceeds
  the stated region by half: the 95th percentile over poses of sqrt(e^T C^-1 e / q) is above 1.5,
  with q the limit of the region that `predict` states;
- named: whether a finding speaks of the cause.

    python -m analyses.gauntlet [--draws 100] [--first 0] [--processes 2] [--only WORD ...]
        [--write FILE]

Draws are kept in .cache/gauntlet.jsonl as they end, and a run goes on where an earlier one stopped.
Each has the stamp of the code that it judged; draws of other code do not count.
"""

from __future__ import annotations

import argparse
import hashlib
import math
import re
import time
import warnings
import zlib
from pathlib import Path
from typing import Any

import numpy as np

import loopcal as lc
from analyses.gauntlet_kinds import KINDS, Kind
from analyses.gauntlet_truth import Array
from analyses.gauntlet_worlds import Fresh
from analyses.kept import complete
from analyses.rates import table
from analyses.written import write_block
from loopcal.small_samples import f_limit

KEPT = Path(".cache/gauntlet.jsonl")
PAGE = Path("docs/explanation/gauntlet.md")


def _stamp() -> str:
    """A hash of all that a draw judges: the code that calibrates, and the gauntlet's own."""
    judged = ("mechanisms", "measurements", "estimation", "statistics", "expressions", "document")
    package = Path(lc.__file__).parent
    files = [p for folder in judged for p in sorted((package / folder).rglob("*.py"))]
    files += sorted(Path(__file__).parent.glob("gauntlet*.py"))
    found = hashlib.sha256()
    for path in files:
        found.update(path.read_bytes())
    return found.hexdigest()[:12]


STAMP = _stamp()


def run(name: str, draw: int) -> dict[str, Any]:
    """What became of one data set; an error of loopcal's own counts, and does not end the run."""
    try:
        return _run(name, draw)
    except Exception as error:
        named = False if KINDS[name].cause else None
        failed = {"failed": repr(error)[:300], "named": named}
        return {"kind": name, "draw": draw, "stamp": STAMP} | failed


def _run(name: str, draw: int) -> dict[str, Any]:
    kind = KINDS[name]
    rng = np.random.default_rng([zlib.crc32(name.encode()), draw])
    trial = kind.world.made(rng)
    begun = time.process_time()
    found: dict[str, Any] = {"kind": name, "draw": draw, "stamp": STAMP}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            result = lc.calibrate(trial.mechanism, trial.readings, noise=trial.noise, method="auto")
            verdict = lc.verdict(result)
        except lc.LoopcalError as refused:
            words = f"{refused.code}: {refused}"
            named = bool(re.search(kind.cause, words, re.IGNORECASE)) if kind.cause else None
            return found | {"refused": words[:300], "named": named, "cpu": _since(begun)}
        answers = verdict.answers
        told = " ".join([*(f"{a.code} {a.words} {a.next}" for a in answers.values())])
        effects = (words for term in result.document.terms for words in term.sentences)
        told = " ".join([told, *result.warnings, *effects])
        found |= {name: answer.passed for name, answer in answers.items()}
        found |= {"codes": [answer.code for answer in answers.values()], "cpu": _since(begun)}
        found |= {"method": result.fit.method.label, "told": told[:600]}
        if kind.cause:
            found["named"] = bool(re.search(kind.cause, told, re.IGNORECASE))
        found["inside"] = beyond(result, trial.inside, kind)
        found["outside"] = None if trial.outside is None else beyond(result, trial.outside, kind)
    return found


def _since(begun: float) -> float:
    return round(time.process_time() - begun, 3)


def beyond(result: lc.Result, fresh: Fresh, kind: Kind) -> dict[str, float] | None:
    """True error over the stated region at fresh poses; error and sd [SI], root mean squares."""
    predicted = lc.predict(result, fresh.readings)
    computed = np.column_stack([predicted.outputs[q] for q in fresh.outputs])
    if kind.placed:
        computed = _placed(computed, fresh.true)
    index = [list(predicted.outputs).index(q) for q in fresh.outputs]
    C = predicted.covariance[:, index][:, :, index]
    off = computed - fresh.true
    usable = np.isfinite(off).all(axis=1) & np.isfinite(C).all(axis=(1, 2))
    if not usable.any():
        return None
    off, C = off[usable], C[usable]
    tiny = 1e-24 * np.eye(len(index))
    squares = np.einsum("ni,ni->n", off, np.linalg.solve(C + tiny, off[:, :, None])[:, :, 0])
    limit = f_limit(0.95, len(index), predicted.denominator[usable])
    ratio = np.sqrt(squares / limit)
    return {
        "ratio": float(np.quantile(ratio, 0.95)),
        "held": float((ratio <= 1.0).mean()),
        "error": math.sqrt(float(np.square(off).sum(axis=1).mean())),
        "sd": math.sqrt(float(np.einsum("nii->n", C).mean())),
    }


def _placed(points: Array, onto: Array) -> Array:
    """Points (N, 3) moved rigidly onto others."""
    a, b = points - points.mean(axis=0), onto - onto.mean(axis=0)
    U, _, Vt = np.linalg.svd(b.T @ a)
    U[:, -1] *= np.sign(np.linalg.det(U @ Vt))
    moved: Array = a @ (U @ Vt).T + onto.mean(axis=0)
    return moved


def main() -> None:
    """Run what is missing and print the table."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--draws", type=int, default=100)
    options.add_argument("--first", type=int, default=0, help="the first draw, a new seed each")
    options.add_argument("--processes", type=int, default=2)
    options.add_argument("--only", nargs="*", default=[])
    options.add_argument("--keep", type=Path, default=KEPT)
    options.add_argument("--write", type=Path, help=f"the page to write into, {PAGE}")
    chosen = options.parse_args()
    names = [name for name in KINDS if all(word in name for word in chosen.only)]
    wanted = range(chosen.first, chosen.first + chosen.draws)
    asked = [(name, i) for i in wanted for name in names]
    draws = complete(chosen.keep, asked, run, chosen.processes, STAMP)
    text = (
        f"{table(draws)}\n\ndraws {wanted[0]} to {wanted[-1]} of each kind; stamp of the code that "
        f"was judged: {STAMP}"
    )
    print(text)
    if chosen.write:
        write_block(chosen.write, "gauntlet", text)


if __name__ == "__main__":
    main()

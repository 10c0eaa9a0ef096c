"""The gauntlet's error rates: what its draws amount to, kind by kind and over all."""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from analyses.gauntlet_kinds import CLEAN, FIRST, IMAGES, KINDS, LATER, Kind
from analyses.kept import Draw
from analyses.lives_truth import DEGREE

BEYOND = 1.5
"""True error over the stated one, from which what is stated is wrong."""
LARGEST = {"m": 0.02, "rad": 2.0 * DEGREE}
"""Changes that no machine has by itself."""
NEAR = 2
"""By how many poses a change within a run may be dated wrongly."""


def alarmed(draw: Draw) -> bool:
    """Whether a first day is not called sound, or a later one not as calibrated.

    A faulty file that a later day refuses for another reason than its fault answers nothing.
    """
    kind = KINDS[draw["kind"]]
    if kind.later and draw.get("refused") and not kind.clean:
        return speaks(draw)
    return draw.get("passed" if kind.later else "sound") is not True


def called_better(draw: Draw) -> bool:
    return draw.get("better") is True


def wrong(draw: Draw) -> bool:
    """Whether an answer is confident where the true error is far beyond the stated one."""
    if KINDS[draw["kind"]].later:
        expected, true = (draw.get("accuracy") or {}).get("expected"), draw.get("true")
        confident = not alarmed(draw) and not draw.get("refused")
        return bool(confident and expected and true and true > BEYOND * expected)
    if alarmed(draw) and not called_better(draw):
        return False
    return any(_ratio(draw, where) > BEYOND for where in _valid(draw))


def worse(draw: Draw) -> bool:
    """Whether a calibration is called better than the nominal machine and is worse."""
    return called_better(draw) and any(
        draw[where]["error"] > draw[f"nominal {where}"] for where in _valid(draw)
    )


def _valid(draw: Draw) -> list[str]:
    """Where a calibration claims to hold."""
    places = ["inside", "outside"] if draw.get("valid") else ["inside"]
    return [where for where in places if draw.get(where)]


def _ratio(draw: Draw, where: str) -> float:
    return float(draw[where]["error"] / draw[where]["sd"])


def named(draw: Draw) -> bool:
    """Whether an alarm, or a calibration that models it, speaks of what was planted."""
    return (alarmed(draw) if KINDS[draw["kind"]].later else True) and speaks(draw)


def speaks(draw: Draw) -> bool:
    """Whether an answer speaks of what was planted."""
    kind, planted = KINDS[draw["kind"]], draw["planted"]
    findings, changes = draw.get("findings", []), draw.get("changes", [])
    told = [f"{one['code']} {one['words']}" for one in findings if "code" in one]
    words = " ".join([draw.get("words", ""), draw["told"], *told])
    if not kind.names and kind.later:
        return any(_is_it(one, planted) for one in changes[:1])
    if not kind.names:
        pattern = "|".join(rf"\b{name}\b" for name in planted["parameters"])
        return bool(re.search(pattern, words)) and _dated(planted, words, findings)
    spoken = [words, *(f"{one['name']} {one.get('kind', '')}" for one in changes)]
    if not all(re.search(kind.names, text, re.IGNORECASE) for text in spoken):
        return False
    if kind.column and not any(name in words for name in planted["parameters"]):
        return False
    return _dated(planted, words, findings)


def _is_it(change: dict[str, Any], planted: dict[str, Any]) -> bool:
    """Whether a change has the planted one's name, or is not distinguishable from it, and size."""
    names = {change["name"], *change.get("alike", ())}
    share = (change.get("value") or 0.0) / planted["size"]
    if planted["kind"] == "bend":  # a URDF turns the axes of a link by the offset of its joint
        share = abs(share)
    same = change["name"] in planted["parameters"]
    return bool(names & {*planted["parameters"]}) and (not same or 0.5 <= share <= 2.0)


def _dated(planted: dict[str, Any], words: str, findings: Sequence[dict[str, Any]]) -> bool:
    """Whether the pose of a change is spoken of, where it has one."""
    if planted["pose"] is None:
        return True
    spoken = re.findall(r"(?:pose|image)s? \(?(\d+(?:(?:, | and )\d+)*)", words, re.IGNORECASE)
    spoken = [number for one in spoken for number in re.findall(r"\d+", one)]
    placed = [p for one in findings for p in (one["place"] or {}).get("poses", ())]
    poses = {int(p) for p in [*spoken, *placed] if str(p).isdigit()}
    return any(abs(pose - planted["pose"]) <= NEAR for pose in poses)


def absurd(draw: Draw) -> bool:
    """Whether a change is named that is far larger than anything that happened."""
    planted = draw["planted"]
    for change in draw.get("changes", []):
        unit = change.get("unit")
        limit = LARGEST.get(unit, math.inf)
        if planted["unit"] == unit:
            limit = 5.0 * abs(planted["size"])
        parts = change.get("parts", {}).values()
        if max(map(abs, [change.get("value") or 0.0, *parts])) > limit:
            return True
    return False


HEAD = (
    f"{'':34}{'draws':>5} {'alarm %':>15} {'named %':>15} {'wrong %':>14} {'better %':>8}"
    f" {'worse':>5} {'error/sd':>8} {'held %':>6} {'nominal':>8} {'squares':>8}"
)


def tables(draws: Sequence[Draw]) -> str:
    """Rates of each kind, over all, and what `update` made of a later day."""
    by: dict[str, list[Draw]] = defaultdict(list)
    for draw in _usable(draws):
        by[draw["kind"]].append(draw)
    clean = [draw for kind in CLEAN for draw in by[kind.name]]
    lines = []
    groups = {"first day, clean": CLEAN, "first day, faulty": FIRST, "later day": LATER}
    groups["images"] = IMAGES
    for title, kinds in groups.items():
        rows = [row(kind, by[kind.name]) for kind in kinds if by[kind.name]]
        if rows:
            lines += [title + HEAD[len(title) :], *rows, ""]
    later = [draw for kind in LATER for draw in by[kind.name]]
    lines += [
        *_rates("first day", clean, [d for kind in FIRST for d in by[kind.name]]),
        *_rates("later day", [d for d in later if KINDS[d["kind"]].clean], later),
        *_coverage(clean),
        *_updated(later),
        *_by_chance(clean, FIRST),
        *_by_chance([d for d in later if KINDS[d["kind"]].clean], LATER),
    ]
    for flaw in ("failed", "unmade"):
        if its := sorted({f"{d['kind']} {d['draw']}" for d in draws if flaw in d}):
            lines.append(f"{flaw}: {', '.join(its)}")
    return "\n".join(lines)


def _usable(draws: Sequence[Draw]) -> list[Draw]:
    """Those that were made and answered."""
    return [d for d in draws if "failed" not in d and "unmade" not in d]


def row(kind: Kind, draws: Sequence[Draw]) -> str:
    """One line of a table."""
    names = [named(d) for d in draws] if kind.names is not None else []
    if kind.later:
        ratios = [d["true"] / d["accuracy"]["expected"] for d in draws if _expects(d)]
        over = {rival: _over(draws, "true", rival) for rival in ("nominal", "least squares")}
        better = ""
    else:
        ratios = [_ratio(d, "inside") for d in draws if d.get("inside")]
        over = {rival: _over(draws, "inside", rival) for rival in ("nominal", "least squares")}
        better = f"{100 * sum(map(called_better, draws)) / max(len(draws), 1):.0f}"
    held = [d["inside"]["held"] for d in draws if not kind.later and d.get("inside")]
    return (
        f"{kind.name:34}{len(draws):5d} {rate(map(alarmed, draws)):>15} {rate(names):>15}"
        f" {rate(map(wrong, draws)):>14} {better:>8} {sum(map(worse, draws)) or '':>5}"
        f" {_mean(ratios):>8} {_mean(held, 100.0, 1):>6} {over['nominal']:>8}"
        f" {over['least squares']:>8}"
    )


def _expects(draw: Draw) -> bool:
    return bool((draw.get("accuracy") or {}).get("expected") and draw.get("true"))


def _over(draws: Iterable[Draw], key: str, rival: str) -> str:
    """The geometric mean of the true error over a rival's."""
    errors = [(d[key] if key == "true" else d[key]["error"], d) for d in draws if d.get(key)]
    ratios = [error / d[f"{rival} inside"] for error, d in errors]
    return f"{math.exp(float(np.log(ratios).mean())):.3f}" if ratios else ""


def _mean(values: Sequence[float], factor: float = 1.0, places: int = 2) -> str:
    return f"{factor * float(np.mean(values)):.{places}f}" if values else ""


def rate(of: Iterable[bool]) -> str:
    """In per cent, with its 95 % interval."""
    every = list(of)
    if not every:
        return ""
    low, high = (100 * v for v in interval(sum(every), len(every)))
    return f"{100 * sum(every) / len(every):.0f} ({low:.0f} to {high:.0f})"


def _line(what: str, of: Iterable[bool]) -> str:
    every = list(of)
    low, high = interval(sum(every), len(every))
    return (
        f"{what:44}{100 * sum(every) / max(len(every), 1):6.1f} % of {len(every):4d}"
        f"   (95 % interval {100 * low:.1f} to {100 * high:.1f} %)"
    )


def _rates(day: str, clean: Sequence[Draw], other: Sequence[Draw]) -> list[str]:
    every = [*{id(d): d for d in [*clean, *other]}.values()]
    if not every:
        return []
    faulty = [d for d in every if not KINDS[d["kind"]].clean]
    nameable = [d for d in faulty if KINDS[d["kind"]].names is not None]
    lines = [
        _line(f"{day}: false alarms on clean kinds", map(alarmed, clean)),
        _line(f"{day}: faults with an alarm", map(alarmed, faulty)),
        _line(f"{day}: causes named", map(named, nameable)),
        _line(f"{day}: confident and wrong", map(wrong, every)),
    ]
    if day == "later day":
        return [*lines, _line(f"{day}: absurd sizes", map(absurd, every)), ""]
    order = ["drift-or-machine" in d.get("codes", ()) for d in clean]
    lines.insert(1, _line(f"{day}: of them by the pose order", order))
    better = [called_better(d) for d in clean]
    return [*lines, _line(f"{day}: clean kinds called better", better), ""]


def _coverage(clean: Sequence[Draw]) -> list[str]:
    judged = [d for d in clean if d.get("inside")]
    if not judged:
        return []
    held = 100.0 * float(np.mean([d["inside"]["held"] for d in judged]))
    ratio = float(np.mean([_ratio(d, "inside") for d in judged]))
    words = f"intervals hold {held:.1f} % of true coordinates, true error over stated {ratio:.2f}"
    return [f"clean first days: {words}", ""]


def _updated(later: Sequence[Draw]) -> list[str]:
    lines = []
    for kind in sorted({d["kind"] for d in later if "updated" in d}):
        its = [d for d in later if d["kind"] == kind and d["updated"].get("true")]
        if its:
            before = np.array([d["true"] for d in its])
            after = np.array([d["updated"]["true"] for d in its])
            ratios = after / [d["updated"]["sd"] for d in its]
            sound = np.array([bool(d["updated"]["sound"]) for d in its])
            lines.append(
                f"update after {kind}: true error, median {1e3 * np.median(before):.3f} mm before, "
                f"{1e3 * np.median(after):.3f} after; better in {(after < before).sum()} of "
                f"{len(its)}, sound in {sound.sum()}, of them wrong "
                f"{(sound & (ratios > BEYOND)).sum()}; true over stated {np.mean(ratios):.2f}"
            )
    return [*lines, ""] if lines else []


def _by_chance(clean: Sequence[Draw], kinds: Sequence[Kind]) -> list[str]:
    """Which faults clean answers speak of: their names then prove little."""
    lines = []
    patterns: dict[str, Callable[[str], Any]] = {
        kind.names: re.compile(kind.names, re.IGNORECASE).search for kind in kinds if kind.names
    }
    for pattern, search in patterns.items():
        told = [" ".join([d.get("words", ""), d.get("told", "")]) for d in clean]
        if share := sum(bool(search(text)) for text in told):
            lines.append(f"clean answers that match {pattern}: {share} of {len(told)}")
    return lines


def interval(found: int, draws: int) -> tuple[float, float]:
    """95 % interval of a rate (Clopper and Pearson 1934)."""
    from scipy.stats import beta

    low = 0.0 if found == 0 else float(beta.ppf(0.025, found, draws - found + 1))
    high = 1.0 if found == draws else float(beta.ppf(0.975, found + 1, draws - found))
    return low, high

"""The gauntlet's error rates: what its draws amount to, kind by kind and over all."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import Any

from analyses.gauntlet_kinds import KINDS

BEYOND = 1.5
"""True error over the stated 95 % region, from which a stated region is wrong."""


def wrong(draw: dict[str, Any]) -> bool:
    """Whether the true error at fresh poses, where the result is called valid, is far beyond."""
    regions = [draw.get("inside")]
    if draw.get("valid"):
        regions.append(draw.get("outside"))
    return any(region is not None and region["ratio"] > BEYOND for region in regions)


def table(draws: Sequence[dict[str, Any]]) -> str:
    """Rates of each kind, and over all."""
    by: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for draw in draws:
        by[draw["kind"]].append(draw)
    lines = [
        f"{'kind':34} {'draws':>5} {'sound':>6} {'refused':>7} {'wrong':>6} {'missed':>6}"
        f" {'named':>6}"
    ]
    alarms, missed, named = [], [], []
    for name, kind in KINDS.items():
        its = by.get(name, [])
        if not its:
            continue
        sound = [bool(d.get("sound")) for d in its]
        off = [wrong(d) for d in its]
        both = [s and w for s, w in zip(sound, off, strict=True)]
        calls = [d["named"] for d in its if d.get("named") is not None]
        missed += both
        if kind.clean:
            alarms += [not s for s in sound]
        named += calls
        refused = sum("refused" in d for d in its)
        lines.append(
            f"{name:34} {len(its):5d} {_share(sound)} {refused:7d} {_share(off)} {_share(both)}"
            f" {_share(calls) if calls else '     -'}"
        )
    lines += [
        "",
        _rate("false alarms on clean sets", alarms),
        _rate("called sound, yet wrong", missed),
        _rate("cause named", named),
    ]
    if failed := sorted({draw["kind"] for draw in draws if "failed" in draw}):
        lines.append(f"ended by an error of loopcal's own: {', '.join(failed)}")
    return "\n".join(lines)


def _share(of: Sequence[bool]) -> str:
    return f"{100.0 * sum(of) / max(len(of), 1):6.1f}"


def _rate(what: str, of: Sequence[bool]) -> str:
    low, high = interval(sum(of), len(of))
    return (
        f"{what:30}{_share(of)} %  of {len(of):4d}   (95 % interval {100 * low:.1f} to "
        f"{100 * high:.1f} %)"
    )


def interval(found: int, draws: int) -> tuple[float, float]:
    """95 % interval of a rate (Clopper and Pearson 1934)."""
    from scipy.stats import beta

    low = 0.0 if found == 0 else float(beta.ppf(0.025, found, draws - found + 1))
    high = 1.0 if found == draws else float(beta.ppf(0.975, found + 1, draws - found))
    return low, high

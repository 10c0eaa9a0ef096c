"""The arithmetic of the floor in words and a table."""

from __future__ import annotations

from floor import SOLVED, Floor, Share
from tables import table


def floor(found: Floor) -> str:
    """Operations, what they take at least, what was measured, and what the rest is."""
    parts = [_head(found), _table(found)]
    if found.hertz:
        parts += [_sum(found), _rest(found), _memory(found)]
    return "### The floor\n\n" + "\n\n".join(parts)


def _head(found: Floor) -> str:
    told = "the system does not tell its clock, so times stand alone"
    if found.hertz:
        told = (
            f"2 × {found.lanes} × {found.hertz / 1e9:.2f} GHz = "
            f"{2 * found.lanes * found.hertz / 1e9:.1f} operations in a nanosecond"
        )
    return (
        f"One thread can do, with a vector of {found.lanes} products and one of {found.lanes} sums "
        f"in every cycle, no more than the floor: {told}. Six-axis arm, one thread, for a pose:"
    )


def _table(found: Floor) -> str:
    rows = [_row(found, share) for share in [*found.shares, found.solve]]
    head = ["for one pose", "in a solve", "operations", "floor [ns]", "time [ns]", "times floor"]
    return table(head, rows)


def _row(found: Floor, share: Share) -> list[str]:
    times = "" if share.times is None else f"{share.times:.3g}"
    least = ["", ""]
    if found.hertz:
        least = [f"{1e9 * found.least(share):.0f}", f"{share.seconds / found.least(share):.1f}"]
    time = f"{1e9 * share.seconds:,.0f}"
    return [share.name, times, f"{share.operations:,}", least[0], time, least[1]]


def _sum(found: Floor) -> str:
    """The operations of a solve, added up."""
    of = [share for share in found.shares if share.times]
    terms = " + ".join(f"{share.times:.3g} × {share.operations:,}" for share in of)
    sweeps = of[0].times or 1.0
    return (
        f"A solve of {SOLVED:,} poses makes {terms} = {found.solve.operations:,} operations per "
        f"pose: {1e9 * found.least(found.solve):.0f} ns at least, "
        f"{1e9 * found.solve.seconds:,.0f} ns measured; divided by its {sweeps:.3g} sweeps, "
        f"{1e6 * found.least(found.solve) / sweeps:.3f} and "
        f"{1e6 * found.solve.seconds / sweeps:.3f} µs per pose and iteration on one thread."
    )


def _rest(found: Floor) -> str:
    """What of a solve is above the floor, and where."""
    sweep, _, _, closing = found.shares
    sweeps, closings = sweep.times or 0.0, closing.times or 0.0
    above = {
        "in sweeps": sweeps * (sweep.seconds - found.least(sweep)),
        "in closings": closings * (closing.seconds - found.least(closing)),
    }
    engine = sweeps * sweep.seconds + closings * closing.seconds
    above["around them"] = found.solve.seconds - engine
    terms = ", ".join(f"{1e9 * seconds:.0f} ns {where}" for where, seconds in above.items())
    rest = found.solve.seconds - found.least(found.solve)
    return f"The {1e9 * rest:.0f} ns above the floor: {terms}."


def _memory(found: Floor) -> str:
    """What memory alone would take."""
    passes = sum(share.times or 0.0 for share in found.shares)
    seconds = passes * found.moved / found.copied
    return (
        f"Memory: each of the {passes:.3g} passes reads readings and corrections and writes "
        f"corrections, {found.moved} bytes together; at the {found.copied / 1e9:.1f} GB/s of a "
        f"copy by one thread that is {1e9 * seconds:.0f} ns of a solve."
    )

"""What a run measured, as tables of Markdown: printed, and kept in docs/explanation."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import command
import platform_poses
import scale
from both_engines import Engines
from floor import LANES, Share
from measuring import Times
from whole_solve import DEMANDED, SOLVE, Comparison

ALL = "measured"
"""The block of the document that holds every part but the platform's, which has its own."""


def whole_solve(comparison: Comparison) -> str:
    """The programs side by side at one number of poses."""
    rows = [
        [
            name,
            _milliseconds(times.median),
            _milliseconds(times.best),
            f"{comparison.evaluations[name]:.0f}",
            f"{comparison.ratio(name):.3g}",
            _demand(comparison.ratio(name), DEMANDED[name]) if name in DEMANDED else "",
        ]
        for name, times in comparison.times.items()
    ]
    head = ["program", "median [ms]", "best [ms]", "evaluations", f"/ {SOLVE}", "demanded"]
    title = (
        f"Six-axis arm, 27 parameters, {comparison.poses:,} poses; parameters agree to "
        f"{comparison.disagreement:.1g} sds. Evaluations are of the model or its derivatives, "
        "per pose:"
    )
    return f"{title}\n\n{_table(head, rows)}"


def sizes(found: Sequence[scale.Size]) -> str:
    """Time per pose and memory over the number of poses."""
    rows = [
        [
            f"{size.poses:,}",
            f"{size.solve / size.poses * 1e6:.2f}",
            f"{size.numpy / size.poses * 1e6:.2f}",
            f"{size.numpy / size.solve:.2f}",
            f"{size.calibrate / size.poses * 1e6:.2f}",
            f"{size.peak / 1e6:,.0f}",
            f"{size.peak_calibrate / 1e6:,.0f}",
        ]
        for size in found
    ]
    per_pose = [size.solve / size.poses for size in found]
    flat, last = max(per_pose) / min(per_pose), found[-1]
    head = [
        "poses",
        "solve [µs/pose]",
        "on NumPy [µs/pose]",
        "ratio",
        "calibrate() [µs/pose]",
        "peak memory [MB]",
        "with calibrate() [MB]",
    ]
    words = (
        f"Time per pose of the solve is flat within {flat:.2f} "
        f"({'meets' if flat <= scale.DEMANDED_FLAT else 'misses'} {scale.DEMANDED_FLAT:g}); "
        f"{last.poses:,} poses take {last.numpy / last.solve:.2f} times as long on NumPy "
        f"({'meets' if last.numpy >= scale.DEMANDED_RATIO * last.solve else 'misses'} "
        f"{scale.DEMANDED_RATIO:g}); peak memory of the whole process that solves, readings "
        f"included, is {last.peak / 1e6:,.0f} MB "
        f"({'meets' if last.peak <= scale.DEMANDED_PEAK else 'misses'} "
        f"{scale.DEMANDED_PEAK / 1e6:,.0f} MB)."
    )
    return f"One process each, medians:\n\n{_table(head, rows)}\n\n{words}"


def engines(found: Sequence[Engines]) -> str:
    """Both engines side by side, other problems."""
    rows = [
        [
            one.problem,
            _milliseconds(one.times["compiled"].median),
            _milliseconds(one.times["numpy"].median),
            f"{one.ratio:.2f}",
            _demand(one.ratio, one.demanded),
        ]
        for one in found
    ]
    head = ["solve", "compiled [ms]", "NumPy [ms]", "ratio", "demanded"]
    return f"Both engines, parameters checked to agree:\n\n{_table(head, rows)}"


def shares(found: Sequence[Share], hertz: float) -> str:
    """The time of a pose beside its arithmetic."""
    rows = [
        [
            share.name,
            f"{share.seconds * 1e9:.0f}",
            f"{share.operations:,}",
            f"{share.floor(hertz) * 1e9:.0f}" if hertz else "",
            f"{share.seconds / share.floor(hertz):.1f}" if hertz else "",
        ]
        for share in found
    ]
    head = ["one pose, one thread", "time [ns]", "operations", "floor [ns]", "times the floor"]
    words = (
        f"The floor is two vectors of {LANES} operations in every cycle at {hertz / 1e9:.2f} GHz"
    )
    return f"{words}:\n\n{_table(head, rows)}"


def cold_start(times: dict[str, Times]) -> str:
    """The command beside a bare import of NumPy."""
    bare = times[command.BARE].median
    ratio = times[command.COMMAND].median / bare
    rows = [
        [f"`{name}`", _milliseconds(t.median), _milliseconds(t.best), f"{t.median / bare:.3g}"]
        for name, t in times.items()
    ]
    words = f"Demanded: at most {command.DEMANDED:g} times; "
    words += "met." if ratio <= command.DEMANDED else "missed."
    head = ["from a cold start", "median [ms]", "best [ms]", "ratio"]
    return f"{_table(head, rows)}\n\n{words}"


def platform(found: Sequence[platform_poses.Platform]) -> str:
    """Whole calibrations of a platform that nobody reads."""
    rows = [
        [
            entry.seen,
            str(entry.parameters),
            f"{entry.wall:.1f}",
            f"{entry.processor:.1f}",
            "met" if entry.wall <= platform_poses.DEMANDED else "missed",
        ]
        for entry in found
    ]
    head = ["the platform is seen by", "parameters", "wall [s]", "processor [s]"]
    head.append(f"{platform_poses.DEMANDED:g} s")
    title = (
        f"Stewart-Gough platform, its pose read by nobody, {platform_poses.POSES:,} poses, "
        "calibrate() as a whole, the best of three:"
    )
    return f"{title}\n\n{_table(head, rows)}"


def write_into(document: Path, block: str, text: str) -> None:
    """Replace what a former run measured, between two markers, by what this one did."""
    begin, end = (f"<!-- {block}: {edge} -->" for edge in ("begin", "end"))
    content = document.read_text(encoding="utf-8")
    ahead, rest = content.split(begin)
    _, behind = rest.split(end)
    document.write_text(f"{ahead}{begin}\n{text}\n{end}{behind}", encoding="utf-8")


def _demand(ratio: float, demanded: float) -> str:
    return f"{demanded:g}: {'met' if ratio >= demanded else 'missed'}"


def _milliseconds(seconds: float) -> str:
    return f"{seconds * 1e3:,.2f}" if seconds < 1.0 else f"{seconds * 1e3:,.0f}"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    widths = [max(len(row[i]) for row in [head, *rows]) for i in range(len(head))]

    def line(cells: Sequence[str]) -> str:
        first = cells[0].ljust(widths[0])
        rest = (cell.rjust(width) for cell, width in zip(cells[1:], widths[1:], strict=True))
        return "| " + " | ".join([first, *rest]) + " |"

    rule = "| " + " | ".join(
        "-" * w if i == 0 else "-" * (w - 1) + ":" for i, w in enumerate(widths)
    )
    return "\n".join([line(head), rule + " |", *map(line, rows)])

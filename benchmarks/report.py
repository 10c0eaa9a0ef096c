"""What a run measured, in words and tables: printed, and kept in docs/explanation."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import command
import default_call
import images as images_fit
import learning
import memory
import platform_poses
import small_fits
import whole_robots
from both_engines import Engines
from flatness import DEMANDED as DEMANDED_FLAT
from flatness import FROM as FLAT_FROM
from flatness import Flatness
from images import Images
from measuring import Times
from programs import NUMPY, PROGRAMS
from side_by_side import Comparison
from tables import met, milliseconds, table, times_as_long

DEMANDED_AT, MANY = 1_000, 1_000_000
"""Poses: where others have to be slower, and how many are many."""
DEMANDED_OF_NUMPY = 4.0


def side_by_side(found: Sequence[Comparison], drawing: str | None = None) -> str:
    """The programs on one problem over the number of poses; drawing: where its figure will be."""
    names = list(dict.fromkeys(name for one in found for name in one.times))
    head = [f"{one.poses:,} poses" for one in found]

    def rows(cell: Callable[[Comparison, str], str]) -> list[list[str]]:
        """A row for every program, a cell for every number of poses that it went up to."""
        return [
            [name, *(cell(one, name) if name in one.times else "" for one in found)]
            for name in names
        ]

    apart = max(one.disagreement for one in found)
    times = rows(lambda one, name: milliseconds(one.times[name].median))
    ratios = rows(lambda one, name: times_as_long(one.ratio(name)))
    evaluations = rows(lambda one, name: f"{one.evaluations[name]:,.0f}")
    shown = [f"![Time of a calibration against poses]({drawing})"] if drawing else []
    return "\n\n".join(
        [
            f"### {found[0].problem.capitalize()}",
            *shown,
            f"Parameters agree to {apart:.1g} sds. Medians in milliseconds:",
            table(["program", *head], times),
            f"How many times as long as {names[0]}:",
            table(["program", *head], ratios),
            "Evaluations of the model or its derivatives, per pose:",
            table(["program", *head], evaluations),
        ]
    )


def demands(found: Sequence[Comparison]) -> str:
    """Whether loopcal is as fast as it has to be on the six-axis arm, as far as that was run."""
    by_poses = {one.poses: one for one in found}
    words = []
    few, many = by_poses.get(DEMANDED_AT), by_poses.get(MANY)
    for program in PROGRAMS:
        if few and program.demanded and program.name in few.times:
            ratio = few.ratio(program.name)
            words.append(
                f"{program.name} takes {times_as_long(ratio)} times as long at {DEMANDED_AT:,} "
                f"poses (at least {program.demanded:g} demanded: {met(ratio >= program.demanded)})"
            )
    if many:
        ratio = many.ratio(NUMPY.name)
        words.append(
            f"{NUMPY.name} {times_as_long(ratio)} times as long at {MANY:,} "
            f"(at least {DEMANDED_OF_NUMPY:g}: {met(ratio >= DEMANDED_OF_NUMPY)})"
        )
    return "; ".join(words) + "." if words else ""


def flat(found: Flatness) -> str:
    """loopcal's time per pose over the number of poses."""
    each = ", ".join(f"{1e6 * time:.3f} at {poses:,}" for poses, time in found.per_pose.items())
    return (
        f"{PROGRAMS[0].name}, these sizes in turns, microseconds per pose: {each}; flat within "
        f"{found.ratio:.2f} (at most {DEMANDED_FLAT:g} from {FLAT_FROM:,} poses on: "
        f"{met(found.ratio <= DEMANDED_FLAT)})."
    )


def absent() -> str:
    """The programs that are not installed here."""
    names = [f"{program.name} ({program.needs})" for program in PROGRAMS if not program.installed]
    return f"Not installed, and so not run: {', '.join(names)}." if names else ""


def engines(found: Sequence[Engines]) -> str:
    """Both engines side by side, other problems."""
    rows = [
        [
            one.problem,
            milliseconds(one.times["compiled"].median),
            milliseconds(one.times["numpy"].median),
            f"{one.ratio:.2f}",
            f"{one.demanded:g}: {met(one.ratio >= one.demanded)}",
        ]
        for one in found
    ]
    head = ["solve", "compiled [ms]", "NumPy [ms]", "ratio", "demanded"]
    return f"### Both engines\n\nParameters agree:\n\n{table(head, rows)}"


def small(found: Sequence[small_fits.Small]) -> str:
    """Small fits beside odrpack."""
    rows = [
        [
            one.fits,
            milliseconds(one.ours.median),
            milliseconds(one.odrpack.median),
            f"{one.ratio:.2f}",
            f"{small_fits.DEMANDED:g}: {met(one.ratio <= small_fits.DEMANDED)}",
        ]
        for one in found
    ]
    head = ["planar arm", "loopcal [ms]", "odrpack, loopcal's tape [ms]", "ratio", "at most"]
    return f"### Small fits\n\nOne thread each:\n\n{table(head, rows)}"


def sizes(found: Sequence[memory.Size]) -> str:
    """Memory over the number of poses."""
    rows = [
        [f"{size.poses:,}", f"{size.solve / 1e6:,.0f}", f"{size.calibrate / 1e6:,.0f}"]
        for size in found
    ]
    head = ["poses, six-axis", "solve [MB]", "calibrate() [MB]"]
    words = "Peak of the whole process, readings included, one process each:"
    demanded = ""
    if found[-1].poses == MANY:
        demanded = (
            f"\n\nAt most {memory.DEMANDED / 1e6:,.0f} MB demanded of a solve of {MANY:,} poses: "
            f"{met(found[-1].solve <= memory.DEMANDED)}."
        )
    return f"### Memory\n\n{words}\n\n{table(head, rows)}{demanded}"


def cold_start(times: dict[str, Times], study: float) -> str:
    """The command beside a bare import of NumPy; study: how long the seed's takes [s]."""
    bare = times[command.BARE].median
    ratio = times[command.COMMAND].median / bare
    rows = [
        [f"`{name}`", milliseconds(t.median), milliseconds(t.best), f"{t.median / bare:.3g}"]
        for name, t in times.items()
    ]
    head = ["from a cold start", "median [ms]", "best [ms]", "ratio"]
    return (
        f"### The command\n\n{table(head, rows)}\n\n"
        f"At most {command.DEMANDED:g} times demanded: {met(ratio <= command.DEMANDED)}. "
        f"`{command.STUDY}`, all scenarios of the seed 1,000 times by both methods, takes "
        f"{study:.1f} s (at most {command.DEMANDED_STUDY:g} s: "
        f"{met(study <= command.DEMANDED_STUDY)})."
    )


def learnt(found: Sequence[learning.Learning]) -> str:
    """Learnt sds, and readings that no sds explain, beside a plain fit."""
    rows = [
        [
            case.case,
            f"{case.seconds:.2f}",
            f"{case.ratio:.0f}",
            ""
            if case.demanded is None
            else f"{case.demanded:g} s: {met(case.seconds <= case.demanded)}",
        ]
        for case in found
    ]
    head = ["case", "processor [s]", "of a plain fit", "at most"]
    title = f"A six-axis arm with {learning.REFLECTORS} reflectors, {learning.POSES:,} poses:"
    return f"### Learnt sds\n\n{title}\n\n{table(head, rows)}"


def defaults(found: Sequence[default_call.Default]) -> str:
    """Default calls and a stream with a model error, beside plain least squares."""
    rows = [
        [
            case.case,
            f"{case.seconds:.1f}",
            f"{case.ratio:,.0f}" if case.ratio >= 10.0 else f"{case.ratio:.1f}",
            ""
            if case.demanded is None
            else f"{case.demanded:g}: {met(case.ratio <= case.demanded)}",
        ]
        for case in found
    ]
    head = ["case", "processor [s]", "of plain least squares", "at most"]
    return f"### The default call\n\n{table(head, rows)}"


def trees(measured: whole_robots.Trees) -> str:
    """What a tree of bodies costs."""
    ratios = [(f"an arm as a tree, {poses:,} poses", r) for poses, r in measured.ratios.items()]
    most, seconds = whole_robots.DEMANDED, whole_robots.DEMANDED_HUMANOID
    rows = [[case, f"{r:.3f} of a chain", f"{most:g}: {met(r <= most)}"] for case, r in ratios]
    case = f"a humanoid: {measured.parameters} parameters, {whole_robots.POSES} poses, 5 observed"
    in_time = met(measured.seconds <= seconds)
    rows.append([case, f"{measured.seconds:.1f} s", f"{seconds:g} s: {in_time}"])
    return f"### Whole robots\n\n{table(['case', 'processor', 'at most'], rows)}"


def images(measured: Images) -> str:
    """A camera on a hand, beside Ceres."""
    rows = []
    for case, seconds, most in (
        ("sds stated", measured.stated, images_fit.DEMANDED),
        ("all sds learnt", measured.learnt, images_fit.DEMANDED_LEARNT),
    ):
        rows.append([case, f"{seconds:.1f}", f"{most:g} s: {met(seconds <= most)}"])
    if measured.ceres is not None and measured.callbacks is not None:
        own = measured.ceres - measured.callbacks
        rows.append(["sds stated, Ceres", f"{measured.ceres:.1f}", ""])
        rows.append(["the same without its callbacks in Python", f"{own:.1f}", ""])
    title = f"### {measured.images:,} images of {measured.corners} corners"
    words = (
        "A camera on a hand whose poses are uncertain; both programs end at the same parameters."
    )
    return f"{title}\n\n{words}\n\n{table(['case', 'processor [s]', 'at most'], rows)}"


def platform(found: Sequence[platform_poses.Platform]) -> str:
    """Whole calibrations of a platform that nobody reads."""
    rows = [
        [
            entry.seen,
            str(entry.parameters),
            f"{entry.wall:.1f}",
            f"{entry.processor:.1f}",
            met(entry.wall <= platform_poses.DEMANDED),
        ]
        for entry in found
    ]
    head = ["the platform is seen by", "parameters", "wall [s]", "processor [s]"]
    head.append(f"{platform_poses.DEMANDED:g} s")
    title = (
        f"Its pose read by nobody, {platform_poses.POSES:,} poses, calibrate() as a whole, the "
        "best of three:"
    )
    return f"### Stewart-Gough platform\n\n{title}\n\n{table(head, rows)}"

"""What a correction did, for people and for programs: changed, refused, not understood.

Straight moves between corrected targets: how far the machine is off the line in between.

The controller moves the tool on a straight line between two poses by its own model. So the machine
meets the wanted line at its ends alone. In between, at a share s of the way,

    error(s) = f(q(s)) less line(s),    f_c(q(s)) on the controller's line.

Wanted poses in between, corrected and inserted, shorten the lines: the error falls with the square
of their length.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from loopcal.arrays import Array
from loopcal.companions.robot.arms import Arms
from loopcal.companions.robot.corrected import Corrected, shown
from loopcal.companions.robot.inverse import solve
from loopcal.companions.robot.programs.program import Noted
from loopcal.companions.robot.rigid import between, moved
from loopcal.document.plain import plain
from loopcal.presentation.shown import brief, with_unit

_SHOWN = 10
_REPEATED = "Inserted targets repeat the speed and zone of their move: an exact stop stops at each."


@dataclass(frozen=True, eq=False)
class Correction:
    """Corrected targets of one file.

    file, kind: of the program; lines: (N,) of the targets; left: lines that are left alone;
    remarks: what the correction assumes; content: the corrected file; written: where it was
    written, if anywhere; moves: the straight ones between corrected targets.
    """

    __repr__ = brief

    arms: Arms
    corrected: Corrected
    file: str
    kind: str
    lines: tuple[int, ...]
    left: tuple[Noted, ...] = ()
    remarks: tuple[str, ...] = ()
    content: bytes = field(default=b"", repr=False)
    written: str | None = None
    moves: tuple[StraightMove, ...] = ()

    @property
    def joints(self) -> dict[str, Array]:
        """Joint -> (N,) corrected readings [SI]; NaN where a target is refused."""
        q = np.where(self.corrected.done[:, None], self.corrected.joints, np.nan)
        return dict(zip(self.arms.joints, q.T, strict=True))

    @property
    def poses(self) -> Array:
        """(N, 4, 4) the corrected Cartesian targets in the base; NaN where a target is refused."""
        return np.where(self.corrected.done[:, None, None], self.corrected.poses, np.nan)

    @property
    def u95(self) -> Array:
        """(N,) U95 of the distance between the reached and the wanted tool point [m]."""
        return np.where(self.corrected.done, self.corrected.reached.radial(0), np.nan)

    def __str__(self) -> str:
        """The summary."""
        return self.words()

    def words(self) -> str:
        """What was changed, refused and not understood."""
        corrected, done = self.corrected, self.corrected.done
        lines = [f"{int(done.sum())} of {len(done)} targets corrected ({self.kind})"]
        if done.any():
            lines += self._numbers()
        refused = [
            (target, line, refusal)
            for target, line, refusal in zip(
                corrected.targets.names, self.lines, corrected.refused, strict=True
            )
            if refusal is not None
        ]
        if self.moves:
            lines += self._straight()
        if refused:
            counts = Counter(refusal.reason for _, _, refusal in refused)
            several = ", ".join(f"{n} {reason}" for reason, n in counts.most_common())
            lines.append(f"REFUSED  {_stay(len(refused), 'target')}: {several}")
            lines += _first([f"line {n}, {t}: {r.words}" for t, n, r in refused])
        if self.left:
            lines.append(f"NOT UNDERSTOOD  {_stay(len(self.left), 'line')}")
            lines += _first([f"line {one.line}: {one.words}" for one in self.left])
        return "\n".join([*lines, *self.remarks])

    def _numbers(self) -> list[str]:
        corrected, done = self.corrected, self.corrected.done
        before, after = (
            np.linalg.norm(part[done, :3], axis=1) for part in (corrected.before, corrected.after)
        )
        turned = np.linalg.norm(corrected.before[done, 3:], axis=1)
        step = np.abs(corrected.joints - corrected.targets.joints)[done]
        lines = [
            f"error before: median {_m(np.median(before))}, largest {_m(before.max())}; "
            f"turned by up to {_deg(turned.max())}",
            f"error left: {_left(after, corrected.after[done, 3:])}",
            f"U95 of the reached point: {_spread(self.u95[done], _m, 'moves')}",
            f"U95 of the reached turn: {_spread(corrected.reached.radial(3)[done], _deg, 'turns')}",
            f"largest change of a joint: {_joint(step, self.arms.joints)}",
        ]
        beyond = corrected.extrapolated & done
        if beyond.any():
            lines.append(
                f"EXTRAPOLATION  {int(beyond.sum())} targets are unlike the calibration poses: the "
                "stated accuracy of the calibration does not apply there"
            )
        if not corrected.reached.readings:
            lines.append("U95 without the joints' readings, whose sds are unknown")
        return lines

    def _straight(self) -> list[str]:
        """The straight moves, and where no targets were inserted although the bound asks for it."""
        worst = max(self.moves, key=lambda move: move.error)
        new = sum(len(move.inserted) for move in self.moves)
        count = f"{len(self.moves)} straight move{'s' if len(self.moves) > 1 else ''}"
        error = _m(worst.error) if math.isfinite(worst.error) else "not followed by the controller"
        words = f"{count}: error in between up to {error} (line {worst.line})"
        lines = [f"{words}; {new} targets inserted" if new else words]
        kept = [move for move in self.moves if move.why]
        if kept:
            lines.append(f"NOT INSERTED  {_stay(len(kept), 'move')} above the bound")
            lines += _first([f"line {move.line}: {move.why}" for move in kept])
        if new and self.kind != "table":
            lines.append(_REPEATED)
        return lines

    def document(self) -> dict[str, Any]:
        """As one JSON document: SI, null for what is not known."""
        corrected, half = self.corrected, self.corrected.reached.half_widths
        shift, turn = corrected.reached.radial(0), corrected.reached.radial(3)
        targets = []
        for i, name in enumerate(corrected.targets.names):
            refusal = corrected.refused[i]
            accepted = refusal is None
            targets.append(
                {
                    "target": name,
                    "line": self.lines[i],
                    "corrected": accepted,
                    "refused": plain(refusal),
                    "joints_before": self._named(corrected.targets.joints[i]),
                    "joints": self._named(corrected.joints[i]) if accepted else None,
                    "pose": corrected.poses[i] if accepted else None,
                    "error_before": corrected.before[i],
                    "error_left": corrected.after[i] if accepted else None,
                    "u95": half[i] if accepted else None,
                    "u95_point": float(shift[i]) if accepted else None,
                    "u95_turn": float(turn[i]) if accepted else None,
                    "ratio": float(corrected.ratio[i]),
                    "extrapolated": bool(corrected.extrapolated[i]),
                }
            )
        document: dict[str, Any] = {
            "file": self.file,
            "format": self.kind,
            "written": self.written,
            "units": {"joints": dict(self.arms.joints), "shift": "m", "turn": "rad"},
            "corrected": int(corrected.done.sum()),
            "refused": int((~corrected.done).sum()),
            "readings_included": corrected.reached.readings,
            "not_understood": self.left,
            "remarks": self.remarks,
            "straight_moves": [
                {
                    "line": move.line,
                    "from": corrected.targets.names[move.begin],
                    "to": corrected.targets.names[move.end],
                    "error": move.error,
                    "inserted": [self._named(q) for q in move.inserted],
                    "not_inserted": move.why or None,
                }
                for move in self.moves
            ],
            "targets": targets,
        }
        written: dict[str, Any] = plain(document)
        return written

    def _named(self, q: Array) -> dict[str, float]:
        return dict(zip(self.arms.joints, q.tolist(), strict=True))


def _stay(count: int, what: str) -> str:
    return f"1 {what} stays as it is" if count == 1 else f"{count} {what}s stay as they are"


def _first(rows: list[str]) -> list[str]:
    more = [f"and {len(rows) - _SHOWN} more; --json lists all"] if len(rows) > _SHOWN else []
    return [f"  {row}" for row in [*rows[:_SHOWN], *more]]


def _m(value: float) -> str:
    return with_unit(float(value), "m") if math.isfinite(value) else "unknown"


def _deg(value: float) -> str:
    return shown(value, "rad")


def _left(shifts: Array, turns: Array) -> str:
    turned = float(np.linalg.norm(turns, axis=1).max())
    if shifts.max() < 1e-9 and turned < 1e-9:
        return "below 1 nm"
    return f"up to {_m(shifts.max())}, turned by up to {_deg(turned)} (the arm has too few joints)"


def _spread(values: Array, text: Callable[[float], str], moved: str) -> str:
    if not np.isfinite(values).all():
        return f"unknown: a combination of parameters that {moved} it is not determined"
    return f"median {text(float(np.median(values)))}, largest {text(float(values.max()))}"


def _joint(step: Array, joints: Mapping[str, str]) -> str:
    turning = np.array([unit == "rad" for unit in joints.values()])
    parts = [_deg(float(step[:, turning].max()))] if turning.any() else []
    parts += [_m(float(step[:, ~turning].max()))] if not turning.all() else []
    return ", ".join(parts)


_AT = np.linspace(0.0, 1.0, 9)[1:]
MOST = 63
"""Targets that are inserted into one move, at most."""
_MANY = f"more than {MOST} targets would be needed"


@dataclass(frozen=True, eq=False)
class StraightMove:
    """A straight move from one target to another (their indices), in a line of the program.

    error: the largest distance [m] of the tool's point from the wanted one in between, inf where
    the controller does not follow the line; inserted: (k, n) joints of targets in between; why:
    none were inserted although the error is above the bound, empty elsewhere.
    """

    begin: int
    end: int
    line: int
    error: float
    inserted: Array
    why: str = ""


def divided(
    arms: Arms, move: StraightMove, joints: Array, wanted: Array, bound: float
) -> StraightMove:
    """A move between two targets, whose corrected joints are (2, n), wanted poses (2, 4, 4).

    bound: targets are inserted, at equal shares, until the error is below it [m]. Where 63 do not
    suffice, the move stays as it is.
    """
    if move.error <= bound:
        return move
    if not math.isfinite(move.error):
        return replace(move, why="the controller does not follow the line")
    if math.sqrt(move.error / max(bound, 1e-300)) > 2 * MOST:
        return replace(move, why=_MANY)  # far more would be needed
    pieces = 2
    while pieces - 1 <= MOST:
        q, T = _shares(arms, joints, wanted, pieces)
        if not np.isfinite(q).all():
            break
        parts = line_errors(arms, *(np.stack([v[:-1], v[1:]], axis=1) for v in (q, T)))
        if parts.max() <= bound:
            return replace(move, error=float(parts.max()), inserted=q[1:-1])
        pieces *= 2
    return replace(move, why=_MANY)


def _shares(arms: Arms, joints: Array, wanted: Array, pieces: int) -> tuple[Array, Array]:
    """Corrected joints (pieces + 1, n), NaN where there are none, and wanted poses of them."""
    way = between(wanted[:1], wanted[1:])
    shares = np.linspace(0.0, 1.0, pieces + 1)
    T = np.concatenate([moved(wanted[:1], way, float(s)) for s in shares])
    q = [joints[0]]
    for pose in T[1:-1]:
        solved = solve(arms.machine, pose[None], q[-1][None])
        q.append(solved.joints[0] if solved.settled[0] else np.full(joints.shape[1], np.nan))
    return np.array([*q, joints[1]]), T


def line_errors(arms: Arms, joints: Array, wanted: Array) -> Array:
    """(M,) the largest distance [m] between the ends of each of M moves.

    joints: (M, 2, n) corrected, at the ends; wanted: (M, 2, 4, 4) their poses.
    """
    M, _, n = joints.shape
    ends = arms.controller(joints.reshape(-1, n)).reshape(-1, 2, 4, 4)
    line, path = (between(T[:, 0], T[:, 1]) for T in (wanted, ends))
    q, errors, on = joints[:, 0].copy(), np.zeros(M), np.arange(M)
    for share in _AT.tolist():
        solved = solve(arms.controller, moved(ends[on, 0], path[on], share), q[on])
        q[on] = solved.joints
        errors[on[~solved.settled]] = math.inf
        on = on[solved.settled]
        off = between(moved(wanted[on, 0], line[on], share), arms.machine(q[on]))
        errors[on] = np.maximum(errors[on], np.linalg.norm(off[:, :3], axis=1))
    elsewhere = np.abs(q - joints[:, 1]).max(axis=1) > 1e-3
    errors[elsewhere] = math.inf  # the line ends in another configuration
    return errors

"""The address of what a page shows: its step, the poses selected there, a run of the log."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from urllib.parse import quote, unquote

LONGEST = 1_500
"""Characters of a selection that an address holds: browsers and proxies cut longer ones."""


@dataclass(frozen=True)
class Address:
    """step: its key, empty: of none; poses: ids of the ends of the selected runs; run: number of
    an entry of the log."""

    step: str = ""
    poses: tuple[tuple[str, str], ...] = ()
    run: int | None = None

    @classmethod
    def of(cls, path: str, query: str, steps: Collection[str]) -> Address:
        """What an address says; what it says wrongly counts as unsaid.

        >>> Address.of("/diagnose", "poses=31:33,a%2Cb:a%2Cb", ["diagnose"]).poses
        (('31', '33'), ('a,b', 'a,b'))
        """
        said = dict(part.partition("=")[::2] for part in query.split("&"))
        step, run = path.strip("/"), said.get("run", "")
        runs = [one.split(":") for one in said.get("poses", "").split(",")]
        poses = tuple((unquote(ends[0]), unquote(ends[1])) for ends in runs if len(ends) == 2)
        number = int(run) if run.isascii() and run.isdigit() and len(run) < 10 else None
        return cls(step if step in steps else "", poses, number)

    @classmethod
    def selecting(cls, step: str, selected: Sequence[int], poses: Sequence[str]) -> Address:
        """Of a step with poses selected by their positions, which rise."""
        runs: list[list[int]] = []
        for position in selected:
            if runs and position == runs[-1][1] + 1:
                runs[-1][1] = position
            else:
                runs.append([position, position])
        return cls(step, tuple((poses[first], poses[last]) for first, last in runs))

    @property
    def text(self) -> str:
        """Path and query. A selection of too many runs is left out."""
        poses = ",".join(f"{quote(a, safe='')}:{quote(b, safe='')}" for a, b in self.poses)
        said = [f"poses={poses}"] if 0 < len(poses) <= LONGEST else []
        said += [] if self.run is None else [f"run={self.run}"]
        return f"/{self.step}{'?' if said else ''}{'&'.join(said)}"

    def selected(self, poses: Sequence[str]) -> list[int]:
        """Positions of its poses among these ids; a run whose ends are not there is left out."""
        place = {pose: i for i, pose in enumerate(poses)}
        runs = [(place[a], place[b]) for a, b in self.poses if a in place and b in place]
        return sorted({i for first, last in runs for i in range(first, last + 1)})

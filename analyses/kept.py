"""Draws that are kept as they end: a run goes on where an earlier one stopped."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Any

Draw = dict[str, Any]


def kept(path: Path, stamp: str | None = None) -> list[Draw]:
    """The draws that earlier runs have kept, the last of each kind and number; a broken line is
    left out, and so is a draw of another stamp."""
    found = {}
    for line in path.read_text("utf-8").splitlines() if path.exists() else []:
        try:
            draw = json.loads(line)
        except json.JSONDecodeError:
            continue
        if draw.get("stamp") == stamp:
            found[draw["kind"], draw["draw"]] = draw
    return list(found.values())


def _pool(processes: int) -> ProcessPoolExecutor:
    return ProcessPoolExecutor(processes, mp_context=get_context("spawn"))


def complete(
    path: Path,
    wanted: Iterable[tuple[str, int]],
    run: Callable[[str, int], Draw],
    processes: int,
    stamp: str | None = None,
    *,
    again: bool = False,
) -> list[Draw]:
    """All wanted draws (kind, number): those that are kept, and what `run` makes of the others.

    Each runs in a process that imports everything anew; without any process nothing runs. again:
    those that are kept as well.
    """
    wanted = list(wanted)
    done = set() if again else {(one["kind"], one["draw"]) for one in kept(path, stamp)}
    marked = {} if stamp is None else {"stamp": stamp}
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a", encoding="utf-8") as file, _pool(max(processes, 1)) as pool:
        for future in as_completed(
            [pool.submit(run, *one) for one in (wanted if processes else ()) if one not in done]
        ):
            file.write(json.dumps(future.result() | marked) + "\n")
            file.flush()
    asked = set(wanted)
    return [one for one in kept(path, stamp) if (one["kind"], one["draw"]) in asked]

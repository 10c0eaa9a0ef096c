"""How many frames a second the page shows while the figure in space is turned or pointed at.

    python -m benchmarks.app_turn FOLDER

FOLDER holds a project with a result. A hand turns the figure in space of the step Diagnose, points
at its poses, and at those of the figure over the poses, whose machine follows. It needs Chromium,
playwright and NiceGUI (`make partners`).
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tests.app.diagnosing import diagnosing

MOVES, APART = 150, 12
"""Moves of the hand, and the milliseconds between two of them."""
COUNT = """
() => {
  window.frames_seen = [];
  let last = performance.now();
  const look = now => {
    window.frames_seen.push(now - last);
    last = now;
    window.counting = requestAnimationFrame(look);
  };
  window.counting = requestAnimationFrame(look);
}
"""
ENDED = "() => { cancelAnimationFrame(window.counting); return window.frames_seen.slice(2); }"


def moved(page: Any, way: Sequence[tuple[float, float]]) -> list[float]:
    """Milliseconds of each frame while the hand moves so."""
    page.evaluate(COUNT)
    for x, y in way:
        page.mouse.move(x, y)
        page.wait_for_timeout(APART)
    return list(page.evaluate(ENDED))


def main() -> None:
    """Print frames a second, and how long the slow ones take."""
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    with diagnosing(parser.parse_args().folder) as hand:
        page = hand.page
        for label in ("error in space", "error over the poses"):
            plot = page.get_by_label(label, exact=True)
            plot.evaluate("e => e.scrollIntoView({block: 'center'})")
            page.wait_for_timeout(1000)
            box = plot.bounding_box()
            way = [
                (box["x"] + box["width"] * (0.1 + 0.7 * i / MOVES), box["y"] + box["height"] * 0.5)
                for i in range(MOVES)
            ]
            if label == "error in space":
                page.mouse.move(*way[0])
                page.mouse.down()
                _printed("turning", moved(page, way))
                page.mouse.up()
            _printed(f"pointing at {label}", moved(page, way))


def _printed(what: str, times: Sequence[float]) -> None:
    ordered = sorted(times)
    count = len(ordered)
    rate, slow = 1e3 * count / sum(ordered), ordered[int(0.95 * count)]
    print(f"{what}: {rate:.0f} frames a second, 95 of 100 within {slow:.0f} ms")


if __name__ == "__main__":
    main()

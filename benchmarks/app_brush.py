"""How long the app takes from a brush in one figure to the selection in all of them.

    python -m benchmarks.app_brush FOLDER [--brushes 10]

FOLDER holds a project with a result. A hand drags over the figure of errors in Chromium, each time
over other poses. A brush begins with the event of plotly that ends it. For the figures, the ring in
space and the number of poses it is over in the frame after the one that draws the selection there.
It needs Chromium, playwright and NiceGUI (`make partners`).
"""

from __future__ import annotations

import argparse
from pathlib import Path

from tests.app.diagnosing import diagnosing, printed

WATCH = """
() => {
  const flat = [...document.querySelectorAll('.linked.js-plotly-plot')];
  const solid = [...document.querySelectorAll('.linked.space')];
  const bright = p => [...p.querySelectorAll('.trace:first-child path.point')]
    .filter(e => e.style.fill === 'rgb(213, 94, 0)').length;
  const said = () => [...document.querySelectorAll('.q-page .text-subtitle1')]
    .map(e => e.innerText).find(t => t.includes('poses selected')) ?? '';
  window.took = null;
  let heard = false;
  flat[0].on('plotly_selected', event => {
    // plotly sends one without points where it draws a figure again
    if (heard || !event?.points.length) return;
    heard = true;
    const begun = performance.now(), count = event.points.length;
    const marks = {
      figures: () => flat.every(p => bright(p) === count),
      space: () => solid.every(p => p.space.chosen.size === count && !p.space.asked),
      panel: () => said().startsWith(`${count} of`),
    };
    const took = {}, set = new Set();
    const look = () => {
      for (const [name, shown] of Object.entries(marks))
        if (set.has(name)) took[name] ??= performance.now() - begun;
        else if (shown()) set.add(name);
      if (Object.keys(took).length === 3) window.took = took;
      else requestAnimationFrame(look);
    };
    requestAnimationFrame(look);
  });
}
"""


def brushes(folder: Path, count: int) -> list[dict[str, float]]:
    """Milliseconds of each brush until figures, space and panel show it."""
    with diagnosing(folder) as hand:
        page = hand.page
        low, high = page.evaluate(
            "document.querySelector('.js-plotly-plot')._fullLayout.xaxis.range"
        )
        times = []
        for i in range(count):
            page.evaluate(WATCH)
            begin = low + (high - low) * (0.1 + 0.5 * i / count)
            hand.brush("error over the poses", begin, begin + (0.2 + 0.01 * i) * (high - low))
            page.wait_for_function("window.took !== null")
            times.append(page.evaluate("window.took"))
        return times


def main() -> None:
    """Print the median, the least and the largest."""
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("--brushes", type=int, default=10)
    asked = parser.parse_args()
    took = brushes(asked.folder, asked.brushes)
    for name in ("figures", "space", "panel"):
        printed(name, [one[name] for one in took])


if __name__ == "__main__":
    main()

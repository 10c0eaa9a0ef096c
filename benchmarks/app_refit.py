"""How long the app takes from an act of diagnosis to the errors of the fit that follows it.

    python -m benchmarks.app_refit FOLDER [--acts 6]

FOLDER holds a project with a result; the work is done on a copy. A hand leaves poses out in
Chromium, one run of them after the other, and at last calibrates by each of some methods. A time
begins with the click. The first one ends in the frame in which the figure of errors holds other
points, the second one in that in which the page says too how large the error of the new fit is,
and the figure holds the points of that fit. It needs Chromium, playwright and
NiceGUI (`make partners`).
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
import time
from pathlib import Path

from tests.app.diagnosing import diagnosing, printed

METHODS = ("auto", "least-squares", "implicit-loop")
WATCH = """
() => {
  const told = () => document.querySelector('.provisional')?.innerText.split('\\n')[0] ?? '';
  const points = () => {
    const y = document.querySelector('.linked.js-plotly-plot')?.data?.[0].y;
    return y ? String(Array.from(y).slice(0, 50)) : '';
  };
  const before = [told(), points()];
  window.took = null;
  window.drew = null;
  addEventListener('click', () => {
    const begun = performance.now();
    const look = () => {
      const now = [told(), points()];
      if (now[1] && now[1] !== before[1]) window.drew ??= performance.now() - begun;
      if (window.drew && now[0] && now[0] !== before[0])
        window.took = performance.now() - begun;
      else requestAnimationFrame(look);
    };
    requestAnimationFrame(look);
  }, {capture: true, once: true});
}
"""


def acts(
    folder: Path, count: int
) -> tuple[list[float], list[float], dict[str, tuple[float, float]]]:
    """Milliseconds after each act until picture and fit, and after each calibration until first
    and last numbers."""
    drawn, found, calibrated = [], [], {}
    with diagnosing(folder) as hand:
        page = hand.page
        for i in range(count):
            hand.brush("error over the poses", 100.0 + 40 * i, 130.0 + 40 * i)
            page.wait_for_timeout(1500)
            page.evaluate(WATCH)
            hand.press("Exclude")
            page.wait_for_function("window.took !== null", timeout=15_000)
            drawn.append(page.evaluate("window.drew"))
            found.append(page.evaluate("window.took"))
        for method in METHODS:
            hand.choose("Method", f"{method}: ")
            page.wait_for_timeout(1500)
            page.evaluate(WATCH)
            begun = time.perf_counter()
            hand.run("Calibrate", "")
            last = 1e3 * (time.perf_counter() - begun)
            calibrated[method] = (page.evaluate("window.took") or float("nan"), last)
    return drawn, found, calibrated


def main() -> None:
    """Print the median, the least and the largest."""
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("--acts", type=int, default=6)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as copy:
        work = Path(copy) / "work"
        shutil.copytree(asked.folder, work)
        drawn, found, calibrated = acts(work, asked.acts)
    printed("picture after an act", drawn)
    printed("fit after an act", found)
    for method, (first, last) in calibrated.items():
        print(f"{method}: first numbers after {first:.0f} ms, the whole after {last:.0f} ms")


if __name__ == "__main__":
    main()

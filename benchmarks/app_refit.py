"""How long the app takes from an act of diagnosis to the errors of the fit that follows it.

    python -m benchmarks.app_refit FOLDER [--acts 6]

FOLDER holds a project with a result; the work is done on a copy. A hand leaves poses out in
Chromium, one run of them after the other, and at last calibrates by each of some methods at the
step Fit. A time begins with the click. Of an act the first one ends in the frame in which the
figure of errors holds other points, the second one in that in which the page says too how large the
error of the new fit is. That of a calibration ends when its command has ended. It needs Chromium,
playwright and NiceGUI (`make partners`).
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
import time
from pathlib import Path

from tests.app.diagnosing import diagnosing, printed

METHODS = ("least-squares", "implicit-loop")
WATCH = """
() => {
  const said = () => document.querySelector('.provisional')?.innerText.split('\\n')[0] ?? '';
  const points = () => {
    const y = document.querySelector('.linked.js-plotly-plot')?.data?.[0].y;
    return y ? String(Array.from(y).slice(0, 50)) : '';
  };
  const before = [said(), points()];
  window.took = null;
  window.drew = null;
  addEventListener('click', () => {
    const begun = performance.now();
    const look = () => {
      const now = [said(), points()];
      if (now[1] && now[1] !== before[1]) window.drew ??= performance.now() - begun;
      if (window.drew && now[0] && now[0] !== before[0])
        window.took = performance.now() - begun;
      else requestAnimationFrame(look);
    };
    requestAnimationFrame(look);
  }, {capture: true, once: true});
}
"""


def acts(folder: Path, count: int) -> tuple[list[float], list[float], dict[str, float]]:
    """Milliseconds after each act until picture and fit, and of each calibration."""
    drawn, fitted, calibrated = [], [], {}
    with diagnosing(folder) as hand:
        page = hand.page
        for i in range(count):
            hand.brush("error over the poses", 100.0 + 40 * i, 130.0 + 40 * i)
            page.wait_for_timeout(1500)
            page.evaluate(WATCH)
            hand.press("Exclude")
            page.wait_for_function("window.took !== null", timeout=15_000)
            drawn.append(page.evaluate("window.drew"))
            fitted.append(page.evaluate("window.took"))
        hand.step("Fit")
        for method in METHODS:
            hand.choose("Method", f"{method}: ")
            begun = time.perf_counter()
            hand.run("Calibrate", "")
            calibrated[method] = 1e3 * (time.perf_counter() - begun)
    return drawn, fitted, calibrated


def main() -> None:
    """Print the median, the least and the largest."""
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("--acts", type=int, default=6)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as copy:
        work = Path(copy) / "work"
        shutil.copytree(asked.folder, work)
        drawn, fitted, calibrated = acts(work, asked.acts)
    printed("picture after an act", drawn)
    printed("fit after an act", fitted)
    for method, took in calibrated.items():
        print(f"{method}: calibrated after {took:.0f} ms")


if __name__ == "__main__":
    main()

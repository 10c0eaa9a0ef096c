"""Make the pictures of the README from a report of the demo: the arm in space, the first screen.

    python -m analyses.pictures

It needs Chromium and playwright (`make partners`).
"""

from __future__ import annotations

import base64
import sys
from pathlib import Path

import pytest

from tests.browser import chromium, opened

ROOT = Path(__file__).resolve().parents[1]
PICTURES = ROOT / "docs" / "pictures"
REPORT = ROOT / "build" / "demo" / "slipped_reflector" / "report.html"


def main() -> None:
    """Write arm.png and report.png."""
    if not REPORT.exists():
        raise SystemExit(f"{REPORT.relative_to(ROOT)} is missing; run `make demo` first")
    with chromium() as browser, opened(browser, REPORT, width=1280) as seen:
        seen.page.set_viewport_size({"width": 1280, "height": 760})
        (PICTURES / "report.png").write_bytes(seen.page.screenshot())
        still = seen.page.get_attribute("#r1-arrows-still", "src")
        (PICTURES / "arm.png").write_bytes(base64.b64decode(still.split(",")[1]))
    print(f"written to {PICTURES.relative_to(ROOT)}: arm.png, report.png")


if __name__ == "__main__":
    try:
        main()
    except pytest.skip.Exception as absent:
        sys.exit(str(absent))

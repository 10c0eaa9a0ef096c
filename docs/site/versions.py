"""Let every published version of the site link to the others.

    python docs/site/versions.py FOLDER

FOLDER holds one site per version, in a folder named after it. Each gets the list of all, the newest
first, and FOLDER/index.html leads to the newest.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

SCRIPT = Path("_static", "versions.js")


def main(folder: Path) -> int:
    """Write the lists; returns the exit code."""
    found = [site.name for site in folder.iterdir() if (site / SCRIPT).is_file()]
    versions = sorted(found, key=_key, reverse=True)
    if not versions:
        print(f"{folder}: no site here; build one: python docs/site/build.py", file=sys.stderr)
        return 1
    for version in versions:
        listed = f"window.LOOPCAL_VERSIONS = {json.dumps(versions)};\n"
        (folder / version / SCRIPT).write_text(listed, "utf-8")
    newest = f'<meta http-equiv="refresh" content="0; url={versions[0]}/index.html">\n'
    (folder / "index.html").write_text(f"<!doctype html>\n{newest}", "utf-8")
    return 0


def _key(version: str) -> tuple[tuple[int, int | str], ...]:
    """Numbers count as such: 0.10 comes after 0.9."""
    parts = version.replace("-", ".").split(".")
    return tuple((1, int(part)) if part.isdigit() else (0, part) for part in parts)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))

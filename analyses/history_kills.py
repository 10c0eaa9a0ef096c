"""Kill a process at random moments while it writes a history: is every entry there, and whole?

The writer prints the number of each entry once it is written; whatever was printed must be read
back whole, and nothing may be skipped.

    python -m analyses.history_kills [--kills 100]
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from loopcal.companions.life.history_folder import read_entries

WRITER = """
import sys
from loopcal.companions.life.history_folder import append_entries
while True:
    entry = append_entries(sys.argv[1], [("event", {"words": "x" * 20000})]).whole[-1]
    print(entry.sequence, flush=True)
"""


def killed(folder: Path, *, kills: int, seed: int) -> int:
    """How many entries were lost or half written, after so many kills."""
    rng, lost = np.random.default_rng(seed), 0
    acknowledged: set[int] = set()
    for _ in range(kills):
        writer = subprocess.Popen(
            [sys.executable, "-c", WRITER, str(folder)], stdout=subprocess.PIPE, text=True
        )
        assert writer.stdout is not None
        told = [writer.stdout.readline()]  # it has begun
        time.sleep(float(rng.uniform(0.0, 0.03)))
        writer.kill()
        rest, _ = writer.communicate()
        told += rest.splitlines()
        acknowledged |= {int(line) for line in told if line.strip()}
        found = read_entries(folder)
        there = {entry.sequence for entry in found.whole}
        lost += len(acknowledged - there) + len(found.skipped)
    return lost


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--kills", type=int, default=100)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        lost = killed(Path(folder), kills=given.kills, seed=0)
        entries = len(read_entries(folder).whole)
    print(f"{given.kills} kills, {entries} entries written, {lost} lost or half written")


if __name__ == "__main__":
    main()

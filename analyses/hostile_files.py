"""Valid files altered at random, given to every command that reads them: none may end in a fault.

    python -m analyses.hostile_files [--draws 400] [--out hostile.jsonl]

Each draw alters one file of a project folder and runs one command on it, in a process of its own
with limits of memory and time. Met as it should be is an exit code of 0, 2, 3 or 4, without a
traceback, without a control character, with a message that does not grow with the file. A draw
follows from its number alone, and those in the file of an earlier run are not run again.
"""

from __future__ import annotations

import argparse
import json
import random
import re
import resource
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

SECONDS, MEMORY, LONGEST = 120, 4 * 1024**3, 20_000
"""A command may take so long, so many bytes, and say so many characters on stderr."""
PROJECT, DATA, RESULT = "project.toml", "poses.csv", "project-result/result.json"
COMMANDS: tuple[tuple[str, ...], ...] = (
    ("calibrate", PROJECT, "--no-report", "--method", "implicit-loop"),
    ("calibrate", PROJECT, "--no-report", "--method", "least-squares", "--folds", "3"),
    ("check", PROJECT),
    ("simulate", PROJECT, "--out", "new.csv", "--seed", "1"),
    ("init", DATA),
    ("noise", DATA),
    ("report", "project-result"),
    ("compare", "project-result", "project-result"),
    ("predict", "project-result", DATA),
    ("verify", "project-result", DATA),
    ("update", "project-result", DATA),
    ("plan", PROJECT),
    ("export", "project-result"),
    ("record", "project-result"),
)
FILES = (PROJECT, DATA, RESULT, "project-result/mechanism.toml", "project-result/residuals.csv")
STRANGE = (
    *(
        "nan",
        "inf",
        "-1e999",
        "1e308",
        "0",
        "-1",
        "[]",
        "{}",
        "null",
        "true",
        '"',
        "'''",
        "\\u0000",
    ),
    *("\u202e", "\ufeff", "\x1b[2J", "../../..", "9" * 400, "a" * 20_000, "$(id)", "\r", "\t;,|"),
)
CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")


@dataclass(frozen=True)
class Drawn:
    """One draw: what was altered and how, which command ran, and how that ended.

    fault: what was not met as it should be; empty where all was.
    """

    number: int
    file: str
    alteration: str
    command: str
    code: int
    fault: str


def struck(content: bytes, rng: random.Random) -> bytes:
    """A stretch left out."""
    begin = rng.randrange(len(content) + 1)
    return content[:begin] + content[begin + rng.randrange(1, 200) :]


def cut(content: bytes, rng: random.Random) -> bytes:
    """The end left out."""
    return content[: rng.randrange(len(content) + 1)]


def flipped(content: bytes, rng: random.Random) -> bytes:
    """Some bits turned over."""
    found = bytearray(content)
    for _ in range(rng.randrange(1, 9)):
        found[rng.randrange(len(found))] ^= 1 << rng.randrange(8)
    return bytes(found)


def repeated(content: bytes, rng: random.Random) -> bytes:
    """A line written many times."""
    lines = content.splitlines(keepends=True)
    at = rng.randrange(len(lines))
    return b"".join([*lines[:at], *[lines[at]] * rng.choice((2, 3, 1000)), *lines[at:]])


def exchanged(content: bytes, rng: random.Random) -> bytes:
    """Two words in each other's place."""
    words = re.split(rb"(\W+)", content)
    i, j = rng.randrange(len(words)), rng.randrange(len(words))
    words[i], words[j] = words[j], words[i]
    return b"".join(words)


def strange(content: bytes, rng: random.Random) -> bytes:
    """A word replaced by what nobody means."""
    words = list(re.finditer(rb"[\w.+-]+", content))
    at, new = rng.choice(words), rng.choice(STRANGE)
    return content[: at.start()] + new.encode("utf-8", "surrogatepass") + content[at.end() :]


ALTERATIONS: tuple[Callable[[bytes, random.Random], bytes], ...] = (
    *(struck, cut, flipped, repeated, exchanged, strange, strange, strange),
)


def made(folder: Path) -> Path:
    """A planar arm with readings and a result: every file is valid."""
    run(("new", str(folder), "--mechanism", "planar-two-link"), folder.parent)
    project = folder / PROJECT
    text = project.read_text("utf-8").replace('"auto" ', '"implicit-loop" ')
    project.write_text(text, "utf-8")
    run(("simulate", PROJECT, "--out", DATA, "--seed", "1"), folder)
    done = run(("calibrate", PROJECT, "--no-report"), folder)
    if not (folder / RESULT).exists():
        raise RuntimeError(f"the valid project does not calibrate:\n{done.stderr}")
    return folder


def altered(folder: Path, number: int) -> tuple[str, str, tuple[str, ...]]:
    """Alter a file of a folder as a draw does: the file, the alteration, and the command to run."""
    rng = random.Random(number)
    file, alter = rng.choice(FILES), rng.choice(ALTERATIONS)
    path = folder / file
    path.write_bytes(alter(path.read_bytes(), rng))
    return file, alter.__name__, rng.choice(COMMANDS)


def fault_of(code: int, out: str, error: str) -> str:
    """What is wrong with how a command ended; empty where nothing is."""
    if code not in (0, 2, 3, 4):
        last = error.strip().splitlines()
        return f"exit {code}: {last[-1][:160] if last else ''}"
    if "Traceback" in error:
        return "a traceback"
    if CONTROL.search(error) or CONTROL.search(out):
        return "a control character"
    return f"{len(error)} characters on stderr" if len(error) > LONGEST else ""


def run(arguments: tuple[str, ...], folder: Path) -> subprocess.CompletedProcess[str]:
    """A command in a process of its own, within its limits."""

    def limited() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))

    return subprocess.run(
        [sys.executable, "-m", "loopcal", *arguments],
        cwd=folder,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        encoding="utf-8",
        errors="surrogateescape",
        preexec_fn=limited,
        check=False,
    )


def drawn(valid: Path, number: int) -> Drawn:
    """One draw on a copy of the valid folder."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(shutil.copytree(valid, Path(place) / "arm"))
        file, alteration, command = altered(folder, number)
        done = run(command, folder)
        fault = fault_of(done.returncode, done.stdout, done.stderr)
        return Drawn(number, file, alteration, " ".join(command), done.returncode, fault)


def told(draws: list[Drawn]) -> str:
    """The table by command, and what was not met."""
    count, bad = Counter(d.command for d in draws), Counter(d.command for d in draws if d.fault)
    refused = Counter(d.command for d in draws if d.code in (2, 3))
    lines = ["| command | files | refused | not met |", "| --- | ---: | ---: | ---: |"]
    for name in sorted(count):
        lines.append(f"| `{name}` | {count[name]} | {refused[name]} | {bad[name]} |")
    lines.append(f"| all | {len(draws)} | {sum(refused.values())} | {sum(bad.values())} |")
    return "\n".join([*lines, *(f"draw {d.number}: {d.fault}" for d in draws if d.fault)])


def main() -> None:
    """Run what is missing, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--draws", type=int, default=400)
    parser.add_argument("--out", type=Path, default=Path("hostile.jsonl"))
    asked = parser.parse_args()
    lines = asked.out.read_text("utf-8").splitlines() if asked.out.exists() else []
    draws = [Drawn(**json.loads(line)) for line in lines if line.endswith("}")]
    known = {d.number for d in draws}
    with tempfile.TemporaryDirectory() as place, asked.out.open("a", encoding="utf-8") as kept:
        valid = made(Path(place) / "arm")
        for number in sorted(set(range(1, asked.draws + 1)) - known):
            draws.append(drawn(valid, number))
            kept.write(json.dumps(asdict(draws[-1])) + "\n")
            kept.flush()
    print(told(sorted(draws, key=lambda d: d.number)))


if __name__ == "__main__":
    main()

"""Hostile inputs of every kind given to every command: each is answered, and none ends in a fault.

    python -m analyses.hostile_inputs [--count 500] [--seed 1] [--first 0] [--kind GLOB]

Each draw makes one hostile input in a copy of a valid folder and runs one command on it, in a
forked process. Met as it should be is an exit code of 0, 2, 3 or 4 (5 where a stream is full or
closed, and files are written), no traceback, no raw control character, a message of bounded length,
at most 20 s of computing and 1.5 GB, and every file that was there before as it was. A draw
follows from the seed and its number alone.
"""

from __future__ import annotations

import argparse
import fnmatch
import json
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
import zipfile
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

from analyses.hostile_files import altered, fault_of

SECONDS, MEMORY, WALL = 20.0, 1_500_000_000, 600
"""What a command may take: seconds of computing, bytes, and seconds until it is said to hang."""
PROJECT, DATA, RESULT, ARM = "project.toml", "poses.csv", "project-result", "arm"
Command = tuple[str, ...]
Rng = random.Random
# fmt: off
EVIL = (
    "=1+1", "+1-1", "-x", "@SUM(A1)", "=cmd|' /C calc'!A0", "\x1b[2J\x1b]0;x\x07", "\u202eabc",
    "a\x00b", "a\rb", "\t=1", "'", '"', '"a', "\\" * 60, "'" + "\\" * 60, "a" * 30_000,
    "9" * 20_000, "", " ", "\ufeff", "nan", "inf", "-inf", "1e308", "-1e308", "1e999", "5e-324",
    "0", "-0.0", "../../../etc/passwd", "/dev/zero", "${HOME}", "$(id)", "%s%n", "{0}", "{{7*7}}",
    "<script>", "1,5", "1.2.3", "0x1F", "1_000", "٣", "१", "¹", "−1", "1e", "e5", "--1", "NaN()",
    "None", "true", "(" * 3_000, "[" * 3_000, "((" * 400 + "))", "a " * 5_000, "/" * 2_000,
    "a\n" * 100, "𝕏" * 300,
)
# fmt: on
# fmt: off
VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 10**30, -(2**63), 1e308, -1e308, 5e-324, "", "x" * 20_000,
    "\x1b[2J", [], {}, [[]], [1, 2], {"a": 1}, "nan", "m", "=1+1", [None] * 1000, "\u202e", 0.5,
)
# fmt: on
# fmt: off
PYTHON = (
    "import sys\ndef loops(x, p):\n    sys.exit(0)\n", "import sys\nsys.exit(0)\n",
    "raise KeyError('\\x1b[2J')\n",
    "class E(Exception):\n    def __str__(self):\n        raise self\ndef loops(x, p):\n"
    "    raise E()\n",
    "class E(BaseException): pass\ndef loops(x, p):\n    raise E('\\x1b]0;x\\x07' * 9)\n",
    "class E(BaseException):\n    def __str__(self):\n        raise SystemExit(0)\nraise E\n",
    "def loops(x, p):\n    yield 1\n    raise SystemExit(0)\n",
    "def loops(x, p):\n    return loops(x, p)\n", "def loops(x, p):\n    return None\n",
    "def loops(x, p):\n    return [x] * 3\n",
    "def loops(x, p):\n    return float('nan'), float('inf')\n",
    "def loops(x, p):\n    return (1,) * 100000\n", "def loops(x, p):\n    return 'abc'\n",
    "loops = 5\n", "class loops:\n    def __init__(self, x, p): raise SystemExit(3)\n",
    "def loops(: \n", "\x00", "(" * 5000, "def loops(x, p):\n    return x.phi2 / 0,\n",
    "def loops(x, p):\n    return x['phi2'],\n",
    "def loops(x, p):\n    return getattr(x, '\\x1b[2J'),\n",
    "def loops():\n    raise SystemExit(0)\n",
    "class C:\n    def __call__(self, x, p): raise SystemExit(0)\n    __signature__ = 5\n"
    "loops = C()\n",
    "globals()[5] = print\n", "import os\ndef loops(x, p):\n    return os.nothing\n",
    "def loops(x, p):\n    raise MemoryError('\\x1b')\n",
)
# fmt: on
# fmt: off
FRAGMENTS = {
    ".mod": (
        "MODULE m\n", "robtarget a", "robtarget a{", "jointtarget a:=", "[[",
        "[[0,0,0,0,0,0],[0,0,0,", "[[1,2,3,4,5,6],[9E9,9E9,9E9,9E9,9E9,9E9]]", "MoveL ",
        "MoveC a,", "IF ", "IF x THEN", ";", '"', '""', "Offs(", "a.trans.x:=", "\\WObj:=",
        "WaitTime 1;", "MoveJ a,v100,fine,tool0;",
    ),
    ".src": (
        "DECL E6POS", "DECL E6POS a=", "E6AXIS b={A1 0,A2 0,A3 0,A4 0,A5 0,A6 0}", "{", "}",
        "{A1 ", "PTP {A1 1,A2 2,A3 3,A4 4,A5 5,A6 6}",
        "LIN {X 1,Y 2,Z 3,A 4,B 5,C 6,S 'B110',T 2}", "=", "PTP ", "CIRC ", "a.X=", "$BASE=",
        "BASE_NO 9", ";", '"', "[", "a[", "LIN_REL {X 1}", "T 999",
    ),
    ".ls": (
        "/PROG x\n/MN\n", "   1:J P[1] 10% FINE ;\n", "/POS\n", "P[1]{", "P[", "P[1:", "};\n",
        "GP1:", "X = 1 mm,", "J1= 1 deg,", "CONFIG:'N U T, 0, 0, 0',", "CONFIG:'", "UF:1",
        "999:L P[2]", "GP2:",
    ),
    ".jbi": (
        "/JOB\n//POS\n///PULSE\n", "C00000=1,2,3,4,5,6\n", "C1=", "C1 = 1", "///POSTYPE PULSE\n",
        ",", "//INST\n", "MOVJ C00000 VJ=1\n", "MOVC C00000\n", "P001=1,2", " ", "EC1=5",
    ),
    ".script": (
        "def f():\n", "movej(", "movej([1,2,3,4,5,6])\n", "movel(p[1,2,3,4,5,6])\n", "a=[1,2,3,",
        "(", "servoj(a)", "movec(a,b)", "a=[0,0,0,0,0,0]\n", "movej(a)\n", "#", '"',
        "global a = [", "sleep(1)\n",
    ),
    ".csv": (
        "joint_1,joint_2,joint_3,joint_4,joint_5,joint_6\n", "1,2,3,4,5,6\n", '"', '""', ",", ";",
        "tcp_x [mm],", "[", "]", "move\n", "linear", "nan", "1e308,", "\t", " ", "9" * 50, "#",
        "\r",
    ),
}
# fmt: on


@dataclass(frozen=True)
class Drawn:
    """One draw: what kind of input, which command, how it ended, and what was not met."""

    number: int
    kind: str
    command: str
    code: int
    seconds: float
    memory: int
    fault: str


# ---- texts and bytes ---------------------------------------------------------------------------


def mangled(content: bytes, rng: Rng) -> bytes:
    """Valid bytes cut, flipped, repeated, put into another encoding, or replaced."""
    how = rng.randrange(9)
    at = rng.randrange(len(content) + 1)
    match how:
        case 0:
            return content[:at]
        case 1:
            return content[:at] + rng.randbytes(rng.choice((1, 8, 1000))) + content[at:]
        case 2:
            return rng.randbytes(rng.choice((1, 100, 100_000)))
        case 3:
            return content[:at] + content[at : at + 50] * rng.choice((100, 20_000)) + content[at:]
        case 4:
            code = rng.choice(("utf-16", "utf-32", "utf-7", "utf-8-sig", "cp037", "utf-16-be"))
            return content.decode("latin-1").encode(code, "replace")
        case 5:
            return content.replace(b"\n", rng.choice((b"\r", b"\r\n\n", b"", b"\x0b", b"\0\n")))
        case 6:
            evil = rng.choice(EVIL).encode("utf-8", "replace")
            return content[:at] + evil + content[at:]
        case 7:
            return rng.choice((b"PK\x03\x04", b"PAR1", b"%PDF", b"\x89HDF", b"\x1f\x8b")) + content
        case _:
            return rng.choice(
                (b" ", b"\n", b",", b"[", b"<a>", b"{", b'"', b"9", b"a")
            ) * rng.choice((10_000, 1_500_000))


def replaced_by_node(path: Path, rng: Rng) -> str:
    """Put something in place of a file that is no file."""
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
    what = rng.choice(("folder", "pipe", "loop", "zero", "full", "dangling", "empty", "locked-out"))
    match what:
        case "folder":
            path.mkdir()
        case "pipe":
            os.mkfifo(path)
        case "loop":
            path.symlink_to(path.name)
        case "zero":
            path.symlink_to("/dev/zero")
        case "full":
            path.symlink_to("/dev/full")
        case "dangling":
            path.symlink_to("/nowhere/at/all")
        case "empty":
            path.write_bytes(b"")
        case _:
            path.symlink_to("/proc/self/mem")
    return what


def hostile_table(rng: Rng) -> str:
    """A table whose ids, names or numbers are hostile."""
    names = ["pose", "phi2", "phi3", "xP", "yP"]
    rows = [[str(i), *(f"{rng.uniform(-1, 1):.5f}" for _ in range(4))] for i in range(25)]
    how = rng.randrange(8)
    if how in (0, 1):
        for row in rows[:: rng.choice((1, 5))]:
            row[0] = rng.choice(EVIL)
    elif how == 2:
        names[rng.randrange(5)] = rng.choice(EVIL)
    elif how == 3:
        names[rng.randrange(5)] = names[rng.randrange(5)]
    elif how == 4:
        rows[rng.randrange(25)][rng.randrange(1, 5)] = rng.choice(EVIL)
    elif how == 5:
        for row in rows:
            row[rng.randrange(1, 5)] = rng.choice(("nan", "inf", "1e308", "-1e308", "1e-320", ""))
    elif how == 6:
        column, value = rng.randrange(1, 5), rng.choice(("1e308", "-1e200", "nan", "0", "1e-320"))
        for row in rows:
            row[column] = value
    else:
        width = rng.choice((300, 5_000))
        names += [f"c{i}" if rng.random() < 0.9 else rng.choice(EVIL)[:90] for i in range(width)]
        rows = [[*row, *["1"] * width] for row in rows]
    quote = rng.random() < 0.5

    def cell(text: str) -> str:
        return '"' + text.replace('"', '""') + '"' if quote else text

    mark = rng.choice((",", ",", ";", "\t"))
    return "\n".join(mark.join(map(cell, row)) for row in (names, *rows)) + "\n"


READS = (
    ("noise", DATA),
    ("noise", DATA, "--columns", "phi2=rad,phi3=rad"),
    ("init", DATA, "--dh", "dh.csv"),
    ("calibrate", PROJECT, "--no-report", "--out", "new", "--method", "least-squares"),
    ("check", PROJECT),
    ("predict", RESULT, "other.csv"),
    ("predict", RESULT, "other.csv", "--out", "new.csv"),
    ("verify", RESULT, "other.csv", "--out", "new.html"),
    ("update", RESULT, "other.csv", "--out", "new", "--no-report"),
    ("compare", RESULT, RESULT, "--poses", "other.csv"),
    ("performance", "other.csv"),
    ("plan", PROJECT, "--poses", "5", "--candidates", "other.csv", "--out", "new", "--no-report"),
)


def text_tables(folder: Path, rng: Rng) -> Command:
    """Hostile CSV to every reader of readings."""
    command = rng.choice(READS)
    name = next(part for part in ("other.csv", DATA) if part in command or part == DATA)
    valid = (folder / DATA).read_bytes()
    mixed = rng.random() < 0.5
    text = mangled(valid, rng) if mixed else hostile_table(rng).encode("utf-8", "replace")
    (folder / name).write_bytes(text)
    return command


def nodes(folder: Path, rng: Rng) -> Command:
    """A folder, pipe, device or loop of links in place of a file."""
    file = rng.choice(
        (
            *(DATA, PROJECT, "other.csv", "other.xlsx", "other.parquet", "other.mat", "robot.urdf"),
            *(
                f"{RESULT}/result.json",
                f"{RESULT}/mechanism.toml",
                f"{RESULT}/residuals.csv",
                "dh.csv",
            ),
            *(
                "prog.mod",
                "stream/b.parquet",
                "function.py",
                "machine.history",
                "truth.json",
                "s.xsd",
            ),
        )
    )
    (folder / "stream").mkdir()
    _parquet(folder / "stream" / "a.parquet", rng, hostile=False)
    (folder / file).parent.mkdir(exist_ok=True)
    replaced_by_node(folder / file, rng)
    data = "stream" if file.startswith("stream") else file
    choices: tuple[Command, ...] = (
        ("noise", data),
        ("init", data, "--urdf", "robot.urdf"),
        ("predict", RESULT, data),
        ("verify", RESULT, data, "--out", "new.html"),
        ("performance", data),
    )
    special: dict[str, Command] = {
        PROJECT: ("check", PROJECT),
        "robot.urdf": ("init", DATA, "--urdf", "robot.urdf"),
        "dh.csv": ("init", DATA, "--dh", "dh.csv"),
        "prog.mod": ("correct", ARM, "prog.mod"),
        "function.py": ("check", PROJECT, "--mechanism", "function.py:loops"),
        "machine.history": ("history", "machine.history"),
        "truth.json": (
            "calibrate",
            PROJECT,
            "--no-report",
            "--out",
            "new",
            "--truth",
            "truth.json",
        ),
        "s.xsd": ("record", RESULT, "--schema", "s.xsd", "--out", "new.html"),
    }
    if file.startswith(RESULT):
        return rng.choice((("report", RESULT, "--out", "new.html"), ("predict", RESULT, DATA)))
    return special.get(file) or rng.choice(choices)


def _parquet(path: Path, rng: Rng, *, hostile: bool = True) -> None:
    """Write a Parquet file, in a process of its own: the threads of Polars survive no fork."""
    child = os.fork()
    if not child:
        try:
            _write_parquet(path, rng, hostile=hostile)
        finally:
            os._exit(0)
    os.waitpid(child, 0)
    if hostile and rng.random() < 0.3:
        path.write_bytes(mangled(path.read_bytes(), rng))


def _write_parquet(path: Path, rng: Rng, *, hostile: bool) -> None:
    import polars as pl

    n = 25
    frame: dict[str, Any] = {"pose": [str(i) for i in range(n)]}
    frame |= {k: [rng.uniform(-1, 1) for _ in range(n)] for k in ("phi2", "phi3", "xP", "yP")}
    how = rng.randrange(7) if hostile else -1  # the parent draws on from where it was
    if how == 0:
        n = 300_000
        frame = {"pose": pl.repeat("x" * 30_000, n, eager=True)}
        frame |= {k: pl.zeros(n, eager=True) for k in ("phi2", "phi3", "xP", "yP")}
    elif how == 1:
        n = 20_000_000
        frame = {f"c{i}": pl.zeros(n, dtype=pl.Float64, eager=True) for i in range(3)}
    elif how == 2:
        frame["pose"] = [rng.choice(EVIL) for _ in range(n)]
    elif how == 3:
        frame["phi2"] = [[1.0, 2.0]] * n
    elif how == 4:
        frame = {rng.choice(EVIL)[:2000] + k: v for k, v in frame.items()}
    elif how == 5:
        frame["phi2"] = ["1e308"] * n
    elif how == 6:
        frame["pose"] = [b"\xff\x00" * 40] * n
    pl.DataFrame(frame).write_parquet(path)


def binary_tables(folder: Path, rng: Rng) -> Command:
    """Hostile workbooks, Parquet and MATLAB files."""
    ending = rng.choice((".xlsx", ".parquet", ".parquet", ".mat"))
    path = folder / f"other{ending}"
    if ending == ".parquet":
        _parquet(path, rng)
    elif ending == ".mat":
        from io import BytesIO

        import numpy as np
        from scipy.io import savemat

        out = BytesIO()
        big = rng.random() < 0.3
        values = np.zeros((3000, 3000) if big else (25, 5))
        savemat(
            out, {"a" * 30: values, "s": {"x": [1.0], "y": rng.choice(EVIL)}}, do_compression=big
        )
        path.write_bytes(mangled(out.getvalue(), rng) if rng.random() < 0.6 else out.getvalue())
    else:
        _workbook(path, rng)
        if rng.random() < 0.3:
            path.write_bytes(mangled(path.read_bytes(), rng))
    sheet = ("--sheet", rng.choice(("1", "x", rng.choice(EVIL)[:90].replace("\0", ""))))
    return rng.choice(
        (
            ("noise", path.name),
            ("init", path.name, "--dh", "dh.csv", *(sheet if rng.random() < 0.3 else ())),
            ("predict", RESULT, path.name),
            ("verify", RESULT, path.name, "--out", "new.html"),
            ("performance", path.name),
            ("init", DATA, "--dh", path.name),
        )
    )


def _workbook(path: Path, rng: Rng) -> None:
    rows = [line.split(",") for line in hostile_table(rng).splitlines()]
    how = rng.randrange(5)

    def cell(text: str, r: int, c: int) -> str:
        place = (
            f"{chr(65 + c % 26)}{r + 1}"
            if how != 1
            else rng.choice(("XFD1048576", "A0", "", "ZZZZ9"))
        )
        plain = "".join(x for x in text if x.isprintable()).replace("&", "").replace("<", "")
        kind = rng.choice(("inlineStr", "e", "d", "n", "b"))
        return f'<c r="{place}" t="{kind}"><is><t>{plain}</t></is><v>{plain}</v></c>'

    body = "".join(
        f'<row r="{r + 1}">{"".join(cell(t, r, c) for c, t in enumerate(row[:26]))}</row>'
        for r, row in enumerate(rows)
    )
    if how == 2:
        body = '<row r="1"><c r="A1"><v>1</v></c></row>' * 300_000
    if how == 3:
        body = "<row>" * 20_000
    space = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
    head = '<!DOCTYPE x [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;&a;">]>' if how == 4 else ""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as out:
        out.writestr("[Content_Types].xml", "<Types/>")
        out.writestr(
            "xl/workbook.xml",
            f'<workbook xmlns="{space}" xmlns:r="http://schemas.openxmlformats.org/officeDocument/2006/'
            'relationships"><sheets><sheet name="x" sheetId="1" r:id="r1"/></sheets></workbook>',
        )
        out.writestr(
            "xl/_rels/workbook.xml.rels",
            '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">'
            '<Relationship Id="r1" Type="http://schemas.openxmlformats.org/officeDocument/2006/'
            'relationships/worksheet" Target="worksheets/sheet1.xml"/></Relationships>',
        )
        sheet = f'<worksheet xmlns="{space}"><sheetData>{body}</sheetData></worksheet>'
        out.writestr("xl/worksheets/sheet1.xml", head + sheet)


# ---- projects, machines, results -----------------------------------------------------------------

# fmt: off
ENDS = (
    "schema = 0x" + "f" * 6_000, "a" + ".a" * 30_000 + " = 1", "x = " + "[" * 5_000, "title = 5",
    "x = " + "9" * 5_000, '[noise]\n"*" = { sd = 1e308, unit = "m" }',
    '[noise]\n"*" = { sd = -1 }', "[[a]]\n" * 200_000, "x = [" + "{}," * 300_000 + "]",
    "x = {" * 3_000, "title = '" + "t" * 200_000 + "'",
    '[noise]\n"x*" = { sd = nan, unit = "m" }',
    "[fit]\nvalidation = { folds = 9223372036854775807 }",
    '[parameters]\nl2 = { value = 1e308, unit = "m" }',
    '[parameters]\nl2 = { value = inf, unit = "m" }',
    '[parameters]\nl2 = { value = 0.0, unit = "' + "m/" * 900 + '" }',
    "[data]\nevery = 1" + "0" * 15, '[data]\nexclude = ["=1", "\\u001b[2J"]',
    "[data]\nexclude = [" + "1," * 90_000 + "]", '[prior]\n"' + "*" * 3_000 + '" = { sd = 1.0 }',
    '[prior]\n"' + "*?" * 90 + '" = { sd = 1e308 }', '[data]\nfile = "' + "f" * 300 + '.csv"',
    '[mechanism]\nfile = "' + "f" * 300 + '.toml"', '[data]\nfile = "/dev/zero"',
    '[data]\nfile = "project.toml"', '[mechanism]\nfile = "project.toml"',
    '[mechanism]\nfile = "\\u001b[2J"', '[mechanism]\ntype = "urdf"\nfile = "project.toml"',
    '[fit]\nmethod = "\\u001b[2J"', "[fit]\nmax_iterations = -5",
    '[fit]\nloss = "' + "x" * 9_000 + '"',
)
# fmt: on
# fmt: off
LIMITED = (
    'type = "serial"\n[[mechanism.joint]]\nname = "j1"\nlimits = [-1e308, 1e308]\n',
    'type = "serial"\n[[mechanism.joint]]\nname = "j1"\na = 1e308\nd = -1e308\nalpha = 1e308\n',
    'type = "serial"\n[[mechanism.joint]]\nname = "=1+1"\n',
    'type = "serial"\n[[mechanism.joint]]\nname = "\\u001b[2J"\n',
    'type = "serial"\n' + "".join(f'[[mechanism.joint]]\nname = "j{i}"\n' for i in range(3_000)),
    'type = "planar-two-link"\nunits = { length = "\\u202e" }\n',
)
# fmt: on


def projects(folder: Path, rng: Rng) -> Command:
    """Hostile TOML: projects, machines and studies."""
    path = folder / PROJECT
    valid, how = path.read_text("utf-8"), rng.randrange(5)
    lines = valid.splitlines()
    stated = [i for i, line in enumerate(lines) if "=" in line and line[:1] not in "#"]
    if how == 0:
        path.write_bytes(mangled(valid.encode(), rng))
    elif how == 1:
        path.write_text(f"{rng.choice(ENDS)}\n{valid}", "utf-8")
    elif how == 2:
        path.write_text(f"{valid}\n{rng.choice(ENDS)}\n", "utf-8")
    elif how == 3:
        at = rng.choice(stated)
        value = rng.choice(
            (
                *(
                    "0x" + "f" * 5_000,
                    "-1",
                    "1e308",
                    "nan",
                    "[]",
                    "{}",
                    "true",
                    '""',
                    "1979-05-27",
                    "inf",
                ),
                *(
                    '"\\u001b[2J"',
                    '"' + "a" * 5_000 + '"',
                    "[[[[]]]]",
                    '"../../etc/passwd"',
                    '"=1"',
                ),
            )
        )
        lines[at] = f"{lines[at].partition('=')[0]}= {value}"
        path.write_text("\n".join(lines), "utf-8")
    else:
        head = valid.partition("[mechanism]")[0]
        path.write_text(f"{head}[mechanism]\n{rng.choice(LIMITED)}", "utf-8")
    (folder / "study.toml").write_bytes(path.read_bytes())
    return rng.choice(
        (
            ("check", PROJECT),
            ("calibrate", PROJECT, "--no-report", "--out", "new", "--method", "least-squares"),
            ("simulate", PROJECT, "--out", "new.csv"),
            ("plan", PROJECT, "--poses", "5", "--out", "new", "--no-report"),
            ("study", "study.toml", "--draws", "1", "--workers", "1", "--out", "new"),
            ("noise", DATA, "--project", PROJECT),
            ("correct", ARM, "targets.csv", "--controller", PROJECT),
        )
    )


def robots(folder: Path, rng: Rng) -> Command:
    """Hostile URDF."""
    valid, how = (folder / "robot.urdf").read_text("utf-8"), rng.randrange(13)
    limits = '<limit lower="-1e308" upper="1e308" velocity="1" effort="1"/>'

    roots = "".join(f'<link name="r{i}"/>' for i in range(40_000))
    odd = rng.choice(("nan", "1e308", "9" * 9_000))

    def chain(n: int) -> str:
        joints = "".join(
            f'<joint name="j{i}" type="revolute"><parent link="l{i}"/><child link="l{i + 1}"/>'
            f"{limits}</joint>"
            for i in range(n)
        )
        return "".join(f'<link name="l{i}"/>' for i in range(n + 1)) + joints

    bodies = (
        lambda: mangled(valid.encode(), rng),
        lambda: b'<robot name="r">' + b'<link name="a"/>' * 1_200_000 + b"</robot>",
        lambda: b"<robot>" + b"<a>" * 100_000,
        lambda: b'<!DOCTYPE r [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "' + b"&a;" * 99 + b'">]><r/>',
        lambda: valid.encode("utf-16"),
        lambda: valid.replace("3.14", "1e308").replace('lower="-', 'lower="-1e30').encode(),
        lambda: f'<robot name="r">{chain(rng.choice((60, 3_000)))}</robot>'.encode(),
        lambda: valid.replace('link="', 'link="\u202e').encode(),
        lambda: ("<robot " + " ".join(f'a{i}="1"' for i in range(200_000)) + "/>").encode(),
        lambda: b"<robot>" + b"<!-- a -->" * 500_000 + b"</robot>",
        lambda: f"<robot>{roots}</robot>".encode(),
        lambda: valid.replace('xyz="', f'xyz="{odd} ').encode(),
        lambda: valid.replace('type="revolute"', 'type="' + rng.choice(EVIL[:6]).replace("\x1b", "")
                              .replace("\x07", "") + '"').encode("utf-8", "replace"),
    )  # fmt: skip
    (folder / "robot.urdf").write_bytes(bodies[how]())
    return rng.choice(
        (
            ("init", "arm.csv", "--urdf", "robot.urdf"),
            ("init", "arm.csv", "--urdf", "robot.urdf", "--base", "l0", "--tip", "l3"),
            ("export", ARM, "--to", "urdf", "--source", "robot.urdf", "--out", "new"),
        )
    )


def programs(folder: Path, rng: Rng) -> Command:
    """Hostile robot programs of every dialect."""
    ending = rng.choice(tuple(FRAGMENTS))
    parts = FRAGMENTS[ending]
    how = rng.randrange(3)
    if how == 0:
        one, two = rng.choice(parts), rng.choice(parts)
        text = (one + rng.choice(("", " ", "\n")) + rng.choice(("", "", two))) * rng.choice(
            (50, 20_000)
        )
        text = rng.choice(parts) + text + rng.choice(("", "\n", "!", two))
    elif how == 1:
        text = "".join(
            rng.choice(parts) + rng.choice(("", "\n")) for _ in range(rng.choice((30, 5_000)))
        )
    else:
        text = "".join(parts) + "\n" + rng.choice(EVIL) * 3
    content = text.encode("latin-1", "replace")
    if rng.random() < 0.2:
        content = mangled(content, rng)
    (folder / f"prog{ending}").write_bytes(content)
    more = ("--pulses-per-degree", "1000,1000,1000,1000,1000,1000") if ending == ".jbi" else ()
    return ("correct", ARM, f"prog{ending}", *more, *rng.choice(((), ("--line", "1"), ("--json",))))


def _placed(document: Any, rng: Rng) -> Any:
    """Put a hostile value somewhere into a document."""
    at = document
    while True:
        keys = list(at) if isinstance(at, dict) else list(range(len(at)))
        if not keys:
            return document
        key = rng.choice(keys)
        if isinstance(at[key], dict | list) and at[key] and rng.random() < 0.75:
            at = at[key]
            continue
        value = rng.choice(VALUES)
        if isinstance(at, dict) and rng.random() < 0.2:
            del at[key]
            at[rng.choice(EVIL)] = value
        else:
            at[key] = value
        return document


def results(folder: Path, rng: Rng) -> Command:
    """Hostile result.json, residuals and machines of a result."""
    own = rng.choice((RESULT, ARM))
    path = folder / own / "result.json"
    if rng.random() < 0.75:
        document = json.loads(path.read_text("utf-8"))
        for _ in range(rng.choice((1, 1, 3))):
            _placed(document, rng)
        path.write_text(json.dumps(document), "utf-8")
    else:
        file = rng.choice([p for p in (folder / own).iterdir() if p.is_file()])
        file.write_bytes(mangled(file.read_bytes(), rng))
    data = DATA if own == RESULT else "arm.csv"
    return rng.choice(
        (
            ("report", own, "--out", "new.html"),
            ("compare", own, own),
            ("predict", own, data),
            ("verify", own, data, "--out", "new.html"),
            ("update", own, data, "--out", "new", "--no-report"),
            ("record", own, "--out", "new.html"),
            ("record", own, "--dcc", "--out", "new.html"),
            ("fleet", own, own, own, "--no-report", "--out", "new.toml"),
            ("history", "new.history", "--add", own),
            ("correct", ARM, "targets.csv"),
            *(
                ("export", own, "--to", kind, "--out", "new")
                for kind in (
                    "urdf",
                    "xacro",
                    "ur",
                    "dh",
                    "mdh",
                    "mjcf",
                    "sdf",
                    "zeros",
                    "frames",
                    "json",
                )
            ),
        )
    )


def histories(folder: Path, rng: Rng) -> Command:
    """History entries with a right hash and hostile content."""
    place = folder / "machine.history"
    for path in sorted(place.glob("*.json"))[: rng.choice((1, 3))]:
        body = json.loads(path.read_text("utf-8"))
        body.pop("sha256")
        _placed(body, rng)
        text = json.dumps(body, sort_keys=True, separators=(",", ":"))
        path.write_text(json.dumps({**body, "sha256": sha256(text.encode()).hexdigest()}), "utf-8")
    if rng.random() < 0.2:
        (place / ("20260101T000000Z-" + "9" * rng.choice((4, 30, 200)) + ".json")).mkdir()
    return rng.choice(
        (
            ("history", "machine.history"),
            ("history", "machine.history", "--json", "--out", "new.html"),
            ("history", "machine.history", "--event", rng.choice(EVIL).replace("\0", "")[:100_000]),
            ("update", RESULT, DATA, "--history", "machine.history", "--out", "new", "--no-report"),
        )
    )


def functions(folder: Path, rng: Rng) -> Command:
    """Functions of the user's that fail in every way."""
    (folder / "function.py").write_text(rng.choice(PYTHON), "utf-8")
    head = 'schema = 1\n[mechanism]\ntype = "function"\noutputs = ["xP", "yP"]\n'
    units = 'quantities = { phi2 = "rad", phi3 = "rad", xP = "m", yP = "m" }\n'
    data = (folder / PROJECT).read_text("utf-8").partition("[data]")[2].partition("\n[noise]")[0]
    (folder / PROJECT).write_text(f"{head}{units}[data]{data}\n", "utf-8")
    named = (
        "--mechanism",
        rng.choice(("function.py:loops", "function.py:nothing", "function.py:")),
    )
    return rng.choice(
        (
            ("check", PROJECT, *named),
            ("calibrate", PROJECT, "--no-report", "--out", "new", *named),
            ("simulate", PROJECT, "--out", "new.csv", *named),
            ("noise", DATA, *named, "--project", PROJECT),
        )
    )


def doubling_schema(element: str) -> str:
    """A short schema whose element holds a group of two of another group, and so on, 40 deep."""
    head = f'<xs:schema xmlns:xs="{SCHEMA}" version="3.3.0"><xs:element name="{element}">'
    groups = "".join(
        f'<xs:group name="g{i}"><xs:sequence>'
        + f'<xs:group ref="g{i + 1}"/>' * 2
        + "</xs:sequence></xs:group>"
        for i in range(40)
    )
    last = '<xs:group name="g40"><xs:sequence><xs:element name="x"/></xs:sequence></xs:group>'
    own = '<xs:complexType><xs:group ref="g0"/></xs:complexType></xs:element>'
    return f"{head}{own}{groups}{last}</xs:schema>"


def others(folder: Path, rng: Rng) -> Command:
    """Everything else that is read: schemas, tables of robots, truths, records, performance."""
    bombs = (
        doubling_schema("digitalCalibrationCertificate").encode(),
        f'<xs:schema xmlns:xs="{SCHEMA}"><xs:import schemaLocation="s.xsd"/></xs:schema>'.encode(),
        f'<xs:schema xmlns:xs="{SCHEMA}"><xs:include schemaLocation="/dev/zero"/>'.encode(),
        b"<a>" * 300_000,
    )
    (folder / "s.xsd").write_bytes(rng.choice(bombs))
    dh = "name,a [mm],d [mm],alpha [deg],theta [deg]\n" + "j,1,2,3,4\n" * rng.choice((3, 70, 5_000))
    for old in ("1", "2", "mm", "theta", "j"):
        if rng.random() < 0.3:
            dh = dh.replace(old, rng.choice(EVIL).replace("\n", " "), rng.choice((1, 3)))
    (folder / "dh2.csv").write_bytes(dh.encode("utf-8", "replace"))
    (folder / "truth.json").write_bytes(
        mangled(rng.choice((b'{"schema": 1, "parameters": {"l2": 1e308}}', b"[" * 100)), rng)
    )
    record = b'<record xmlns="urn:loopcal:record" sha256="' + b"0" * 64 + b'">'
    record = rng.choice(
        (record * 20_000, record + b"[" * 9_000 + b"</record>", record + b"5</record>")
    )
    (folder / "record.html").write_bytes(record)
    (folder / "scheduler.json").write_bytes(mangled(b'{"address": "tcp://127.0.0.1:1"}', rng))
    conf = b"kinematics:\n  hash: calib_1\n" + b"\n" * rng.choice((1, 100_000))
    (folder / "calibration.conf").write_bytes(mangled(conf, rng))
    new = ("new", "table", "--performance")
    return rng.choice(
        (
            ("record", RESULT, "--schema", "s.xsd", "--out", "new.html"),
            ("init", "arm.csv", "--dh", "dh2.csv"),
            ("correct", ARM, "targets.csv", "--controller", "dh2.csv"),
            ("calibrate", PROJECT, "--no-report", "--out", "new", "--truth", "truth.json"),
            ("record", "record.html", "--verify"),
            ("study", PROJECT, "--cluster", "scheduler.json"),
            ("export", ARM, "--to", "ur", "--source", "calibration.conf", "--out", "new"),
            ("noise", RESULT + "/result.json"),
            ("performance", "dh2.csv"),
            new,
        )
    )


def arguments(folder: Path, rng: Rng) -> Command:
    """Names and options that are hostile themselves."""
    names = (
        *(
            os.fsdecode(b"a\xff.csv"),
            "n" * 300 + ".csv",
            "\x1b[2J.csv",
            "=x.csv",
            "a/" * 900,
            "\u202e.toml",
        ),
        *(
            "",
            " ",
            ".",
            "/",
            "~",
            "-",
            "--",
            "\n",
            "poses.csv/x",
            "missing.csv",
            "/dev/null",
            "CON",
            "x" * 5_000,
        ),
    )
    name = rng.choice(names)
    number = rng.choice(("nan", "inf", "1e308", "-1", "0", "", "9" * 400, "١", "1e-320", "\x1b[2J"))
    if name.endswith("xff.csv") or "\udcff" in name or name in ("\x1b[2J.csv", "=x.csv"):
        shutil.copy(folder / DATA, folder / name)
    return rng.choice(
        (
            ("init", name),
            ("init", DATA, "--dh", name),
            ("init", DATA, "--machine", name),
            ("init", "arm.csv", "--machine", "motoman-ma1400", "--out", name),
            ("noise", name),
            ("noise", DATA, "--columns", name),
            ("check", name),
            ("calibrate", name),
            ("calibrate", PROJECT, "--no-report", "--out", name or "new"),
            ("calibrate", PROJECT, "--no-report", "--out", "new", "--folds", number),
            ("calibrate", PROJECT, "--no-report", "--out", "new", "--profile", name),
            ("report", name),
            ("predict", RESULT, name),
            ("predict", RESULT, DATA, "--out", name),
            ("verify", RESULT, name),
            ("verify", RESULT, DATA, "--tolerance", number, "--out", "new.html"),
            (
                "update",
                RESULT,
                DATA,
                "--drift",
                f"length={number}mm",
                "--out",
                "new",
                "--no-report",
            ),
            ("export", RESULT, "--to", name),
            ("export", ARM, "--to", "json", "--out", name or "new"),
            ("correct", ARM, "targets.csv", "--tool", f"{number},0,0"),
            ("correct", ARM, "targets.csv", "--line", number),
            ("correct", ARM, "targets.csv", "--at", f"{name}={number}"),
            ("plan", PROJECT, "--poses", number, "--out", "new", "--no-report"),
            ("performance", DATA, "--units", name),
            ("performance", DATA, "--tracker", number),
            ("history", name),
            ("new", name or "x", "--mechanism", "planar-two-link"),
            ("new", "x", "--mechanism", name),
            ("schema", name),
            ("simulate", PROJECT, "--out", name),
            ("simulate", PROJECT, "--out", "new.csv", "--seed", number),
            (name,),
            ("app", name, "--no-browser", "--port", number),
        )
    )


def alterations(folder: Path, rng: Rng) -> Command:
    """Valid files altered as `analyses.hostile_files` does."""
    return altered(folder, rng.randrange(1 << 30))[2]


KINDS: dict[str, Callable[[Path, Rng], Command]] = {
    one.__name__: one
    for one in (
        *(text_tables, binary_tables, nodes, projects, robots, programs, results, histories),
        *(functions, others, arguments, alterations),
    )
}
SCHEMA = "http://www.w3.org/2001/XMLSchema"
STREAMS = ("plain",) * 8 + ("out closed", "err closed", "out full", "err full", "all closed")

# ---- running --------------------------------------------------------------------------


def made(folder: Path) -> Path:
    """A planar arm and one of six joints, with readings and results, and what else is valid."""
    root = Path(__file__).resolve().parents[1]
    shutil.copytree(root / "examples" / "planar", folder)
    fit = ("--no-report", "--method", "least-squares", "--folds", "3")
    _must(("calibrate", PROJECT, *fit, "--history", "machine.history"), folder)
    for words in ("collision", "new belt"):
        _must(("history", "machine.history", "--event", words), folder)
    six = folder / "six"
    shutil.copytree(root / "examples" / "six_axis", six)
    _must(("calibrate", PROJECT, *fit, "--out", str(folder / ARM)), six)
    shutil.copy(six / DATA, folder / "arm.csv")
    lines = (six / DATA).read_text("utf-8").splitlines()[:5]
    (folder / "targets.csv").write_text("\n".join(lines) + "\n", "utf-8")
    (folder / "other.csv").write_bytes((folder / DATA).read_bytes())
    (folder / "dh.csv").write_text("a [mm],d [mm],alpha [deg],theta [deg]\n800,0,0,0\n600,0,0,0\n")
    links = "".join(f'<link name="l{i}"/>' for i in range(7))
    joints = "".join(
        f'<joint name="joint_{i + 1}" type="revolute"><parent link="l{i}"/><child link="l{i + 1}"/>'
        f'<origin xyz="0 0 0.3" rpy="{1.57 * (i % 2)} 0 0"/><axis xyz="0 0 1"/>'
        '<limit lower="-3.14" upper="3.14" effort="1" velocity="1"/></joint>\n'
        for i in range(6)
    )
    (folder / "robot.urdf").write_text(f'<robot name="r">\n{links}\n{joints}</robot>\n')
    return folder


def _must(command: Command, folder: Path) -> None:
    code, *_ = run(command, folder, "plain")
    if code not in (0, 4):
        raise RuntimeError(f"the valid folder is none: {' '.join(command)} ends with {code}")


def run(command: Command, folder: Path, streams: str) -> tuple[int, str, str, float, int]:
    """Code, stdout, stderr, seconds of computing and bytes of a command in a forked process."""
    with tempfile.TemporaryDirectory() as place:
        out, err = Path(place) / "out", Path(place) / "err"
        child = os.fork()
        if not child:
            _child(command, folder, streams, out, err)
        begun = time.monotonic()
        while (ended := os.wait4(child, os.WNOHANG))[0] == 0:
            if time.monotonic() - begun > WALL:
                os.killpg(child, signal.SIGKILL)
            time.sleep(0.02)
        _, status, used = ended
        code = os.waitstatus_to_exitcode(status)
        said, told = (
            p.read_bytes()[:2_000_000].decode("utf-8", "surrogateescape") if p.exists() else ""
            for p in (out, err)
        )
        return code, said, told, used.ru_utime + used.ru_stime, used.ru_maxrss * 1024


def _child(command: Command, folder: Path, streams: str, out: Path, err: Path) -> None:
    code = 70
    try:
        os.setpgid(0, 0)
        resource.setrlimit(resource.RLIMIT_CPU, (60, 60))
        resource.setrlimit(resource.RLIMIT_DATA, (4 * MEMORY, 4 * MEMORY))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        os.chdir(folder)
        files = {0: "/dev/null", 1: str(out), 2: str(err)}
        for number, file in files.items():
            os.dup2(os.open(file, os.O_RDWR | os.O_CREAT, 0o600), number)
        for number, name in ((1, "out"), (2, "err")):
            if streams == f"{name} full":
                os.dup2(os.open("/dev/full", os.O_WRONLY), number)
            if streams in (f"{name} closed", "all closed"):
                os.close(number)
        if streams == "all closed":
            os.close(0)
        sys.stdin, sys.stdout, sys.stderr = (
            _stream(n, m) for n, m in ((0, "r"), (1, "w"), (2, "w"))
        )
        from loopcal.cli import main

        code = main(list(command))
        for stream in (sys.stdout, sys.stderr):
            try:
                stream and stream.flush()
            except OSError:
                code = 120  # what Python makes of it
    except BaseException:
        import traceback

        err.write_text("Traceback outside:\n" + traceback.format_exc())
        code = 71
    finally:
        import loopcal.files.guarded as guarded

        guarded._CHILDREN.end()
        os._exit(code & 255)


def _stream(number: int, mode: str) -> Any:
    try:
        os.fstat(number)
    except OSError:
        return None
    return open(
        number,
        mode,
        encoding="utf-8",
        errors="surrogateescape" if mode == "r" else "backslashreplace",
    )


def state(folder: Path) -> dict[str, str]:
    """Every regular file below a folder, and what it holds."""
    found = {}
    for path, _, names in os.walk(folder):
        for name in names:
            file = Path(path) / name
            if file.is_file() and not file.is_symlink():
                found[str(file.relative_to(folder))] = sha256(file.read_bytes()).hexdigest()
    return found


def drawn(valid: Path, seed: int, number: int, wanted: str = "*") -> Drawn | None:
    """One draw on a copy of the valid folder; None where it is of no wanted kind."""
    kind = [*KINDS][number % len(KINDS)]
    if not fnmatch.fnmatch(kind, wanted):
        return None
    rng = random.Random(f"{seed}-{number}")
    with tempfile.TemporaryDirectory() as place:
        folder = Path(shutil.copytree(valid, Path(place) / "f", symlinks=True))
        command = KINDS[kind](folder, rng)
        streams = rng.choice(STREAMS)
        before = state(folder)
        code, out, err, seconds, memory = run(command, folder, streams)
        after = state(folder)
        rest = code == 5 and streams != "plain"
        fault = fault_of(0 if rest else code, "" if "--json" in command else out, err)
        fault += next((f": {line[:200]}" for line in err.splitlines() if "fault of" in line), "")
        lost = [
            name for name, its in before.items() if after.get(name) != its and kept(name, command)
        ]
        if not fault and lost:
            fault = f"changed: {', '.join(lost[:3])}"
        if not fault and seconds > SECONDS:
            fault = f"{seconds:.0f} s of computing"
        if not fault and memory > MEMORY:
            fault = f"{memory / 1e9:.1f} GB"
        if not fault and code in (2, 3) and not err.strip() and streams in ("plain", "out closed"):
            fault = "no message"
    words = " ".join(part if len(part) < 60 else f"{part[:20]}..." for part in command)
    return Drawn(number, kind, f"{words!r} [{streams}]", code, seconds, memory, fault)


def kept(name: str, command: Command) -> bool:
    """Whether a command has no right to change a file that was there."""
    if command[0] == "calibrate" and "--out" not in command:
        return not name.startswith(RESULT)
    defaults = {"report": f"{RESULT}/report.html", "record": f"{RESULT}/record.html"}
    return name not in (defaults.get(command[0]), "machine.history.html") and name != _out(command)


def _out(command: Command) -> str:
    return command[command.index("--out") + 1] if "--out" in command else ""


def main() -> None:
    """Run the draws and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--kind", default="*")
    asked = parser.parse_args()
    import polars  # noqa: F401  loaded once, before the forks

    import loopcal.cli.run  # noqa: F401

    rows: list[Drawn] = []
    with tempfile.TemporaryDirectory() as place:
        valid = made(Path(place) / "valid")
        for number in range(asked.first, asked.first + asked.count):
            one = drawn(valid, asked.seed, number, asked.kind)
            if one is not None:
                rows.append(one)
                if one.fault:
                    print(f"{one.number} {one.kind}: {one.command}: {one.fault}", flush=True)
    count, unmet = Counter(r.kind for r in rows), Counter(r.kind for r in rows if r.fault)
    print(
        "| kind | inputs | refused | unmet | most s | most MB |",
        "| --- | ---: | ---: | ---: | ---: | ---: |",
        sep="\n",
    )
    for kind in count:
        its = [r for r in rows if r.kind == kind]
        refused = sum(r.code in (2, 3) for r in its)
        most = max(r.seconds for r in its), max(r.memory for r in its) / 1e6
        print(
            f"| {kind} | {count[kind]} | {refused} | {unmet[kind]} "
            f"| {most[0]:.1f} | {most[1]:.0f} |"
        )
    print(f"| all | {len(rows)} | | {sum(unmet.values())} | | |")


if __name__ == "__main__":
    main()

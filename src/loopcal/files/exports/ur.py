"""Universal Robots: kinematics for ur_description, with the hash of the controller's own table.

The driver compares the hash in the file with that of the controller's table, nominal + delta of
calibration.conf, and warns where they differ. The hash stays that of the controller: the file
changes what the computer believes, not what the robot does.

    hash = "calib_" + std::hash(text),   text: theta, d, a and alpha of each joint, six digits each

std::hash of the GNU C++ library is MurmurHash64A (Appleby 2008) with the seed 0xc70f6907. The
hashes of published default_kinematics.yaml are tested.
"""

from __future__ import annotations

import configparser
import re
from contextlib import suppress
from pathlib import Path

from loopcal.document.exported import Exported
from loopcal.errors import Code, InputError
from loopcal.files.exports.format import ExportFiles, ExportOptions, Format
from loopcal.files.exports.tables import frames_csv
from loopcal.files.exports.urdf import decimal
from loopcal.files.tables.raw import bytes_of
from loopcal.files.toml.reader import shown
from loopcal.mechanisms.rest import roll_pitch_yaw
from loopcal.mechanisms.universal_robots import (
    UrTable,
    drawing,
    nominal_origins,
    ur_origins,
)

MOST_BYTES = 100_000
_SEED = 0xC70F6907  # of libstdc++
# Possessive: a file of blanks cannot make the search back out (docs/decisions/0137).
_HASH = re.compile(r"^[ \t]*+hash[ \t]*+:\s*+['\"]?(calib_\d+)", re.MULTILINE)
_REMEDY = (
    "copy calibration.conf from the controller and name it, or name the kinematics file of the "
    "robot; both state the hash"
)


def ur(exported: Exported, options: ExportOptions) -> ExportFiles:
    """kinematics.yaml, and kinematics_frames.csv with base and tool."""
    assert exported.chain is not None
    arm = ur_origins(exported.chain)
    digest = None if options.source is None else controller_hash(options.source, arm.model)
    lines = [
        f"# Calibrated kinematics of a {arm.model}, for kinematics_params_file of ur_description.",
        "# It changes the model on the computer only: the controller moves (movel) by its own.",
        "# Base and tool are not part of it: see kinematics_frames.csv.",
        "kinematics:",
    ]
    for (link, L), N in zip(arm.origins.items(), nominal_origins(arm.model), strict=True):
        # Of equivalent triples the one nearest to the drawing's shows what the calibration changed.
        near = roll_pitch_yaw(N[:3, :3])
        values = (*L[:3, 3].tolist(), *roll_pitch_yaw(L[:3, :3], near))
        lines.append(f"  {link}:")
        keys = ("x", "y", "z", "roll", "pitch", "yaw")
        lines += [f"    {k}: {decimal(v)}" for k, v in zip(keys, values, strict=True)]
    lines += [f"  hash: {digest}"] if digest else []
    words = (
        ()
        if digest
        else (
            "The file has no hash, so the driver will report another calibration. Name "
            "calibration.conf of the controller with --source.",
        )
    )
    frames = frames_csv((("base", arm.base), ("tool", arm.tool)))
    return ExportFiles(
        {"kinematics.yaml": "\n".join([*lines, ""]), "kinematics_frames.csv": frames}, words
    )


def controller_hash(path: Path, model: str) -> str:
    """The hash of a controller: as a kinematics file states it, or of a calibration.conf.

    Raises InputError for a file that is neither.
    """
    text = _text(path)
    stated = _HASH.search(text)
    return stated[1] if stated else table_hash(read_calibration(path, model))


def read_calibration(path: Path, model: str) -> UrTable:
    """The table of a controller: the model's drawing plus the deltas of its calibration.conf.

    Raises InputError for what is no such file.
    """
    parser = configparser.ConfigParser(interpolation=None, strict=False)
    place = shown(path)
    try:
        parser.read_string(_text(path))
    except configparser.Error as error:
        words = f"this is not a calibration.conf: {str(error).splitlines()[0]}"
        raise _refusal(words, "wrong-file-type", place) from None
    deltas = {}
    for key in ("theta", "d", "a", "alpha"):
        written = parser.get("mounting", f"delta_{key}", fallback=None)
        if written is None:
            words = f"calibration.conf has no delta_{key} in [mounting]"
            raise _refusal(words, "missing-key", place)
        deltas[key] = _six(written, f"delta_{key}", place)
    return drawing(model).changed(deltas)


def _six(text: str, key: str, place: str) -> list[float]:
    words = text.strip().removeprefix("[").removesuffix("]").replace(",", " ").split()
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        numbers = []
    if len(numbers) != 6 or not all(abs(v) < 1e6 for v in numbers):
        raise _refusal(f"{key} is not six numbers in brackets", "invalid-number", place)
    return numbers


def _text(path: Path) -> str:
    content = bytes_of(path, MOST_BYTES)
    with suppress(UnicodeDecodeError):
        if len(content) <= MOST_BYTES:
            return content.decode("utf-8-sig")
    raise _refusal("this is not a calibration.conf", "wrong-file-type", shown(path))


def _refusal(words: str, code: Code, place: str) -> InputError:
    return InputError(words, code=code, place=place, remedy=_REMEDY)


def table_hash(table: UrTable) -> str:
    """The hash by which the driver tells controllers apart.

    >>> table_hash(drawing("ur5e"))
    'calib_12788084448423163542'
    """
    # A stream of C++ prints six significant digits, as %g does; other digits give another hash.
    numbers = zip(table.theta, table.d, table.a, table.alpha, strict=True)
    return f"calib_{_murmur(''.join(f'{v:g}' for row in numbers for v in row).encode())}"


def _murmur(data: bytes) -> int:
    """MurmurHash64A."""
    # Unsigned 64-bit products of C++ wrap, those of Python do not.
    factor, mask = 0xC6A4A7935BD1E995, (1 << 64) - 1
    whole = len(data) // 8 * 8
    h = (_SEED ^ (len(data) * factor)) & mask
    for i in range(0, whole, 8):
        k = int.from_bytes(data[i : i + 8], "little") * factor & mask
        h = (h ^ ((k ^ (k >> 47)) * factor & mask)) * factor & mask
    if data[whole:]:
        h = (h ^ int.from_bytes(data[whole:], "little")) * factor & mask
    h = (h ^ (h >> 47)) * factor & mask
    return h ^ (h >> 47)


FORMATS = (
    Format(
        "ur",
        "kinematics of Universal Robots for ur_description (YAML)",
        "a robot of Universal Robots under ROS",
        "name `kinematics.yaml` as `kinematics_params_file`",
        ur,
        source="calibration.conf of the controller, or a kinematics file with its hash",
        optional=True,
    ),
)

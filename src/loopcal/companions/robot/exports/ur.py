"""Universal Robots: kinematics for ur_description, with the hash of the controller's own table.

The driver compares the hash in the file with that of the controller's table, nominal + delta of
calibration.conf, and warns where they differ. The hash stays that of the controller: the file
changes what the computer believes, not what the robot does.

    hash = "calib_" + std::hash(text),   text: theta, d, a and alpha of each joint, six digits each

std::hash of the GNU C++ library is MurmurHash64A (Appleby 2008) with the seed 0xc70f6907. The
hashes of published default_kinematics.yaml are tested.

Arms of Universal Robots: their drawings, and any calibrated one as the six origins of its URDF.

    T_base_tip(q) = B  L_1 Rz(q_1)  L_2 Rz(q_2) ... L_6 Rz(q_6)  T

Of a Denavit-Hartenberg table L_i = Rx(alpha_i-1) Tx(a_i-1) Rz(theta_i) Tz(d_i). Where the axes of
shoulder, elbow and wrist are nearly parallel, d_2 and d_3 of a controller's table are hundreds of
metres. Where along its axis the frame of a joint lies, and how it is turned about it, changes
nothing: here each lies as near as it can to where the drawing puts it behind the one before.

The base B takes up what belongs to the place of the robot: axis 1, and the height and zero of
joint 1, as axis 2 shows them. The tool T takes up the zero of joint 6.
Sources of the drawings: the makers' published tables, `default_kinematics.yaml` of
Universal_Robots_ROS2_Description.
"""

from __future__ import annotations

import configparser
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from loopcal.arrays import Array
from loopcal.companions.robot.exports.format import ExportFiles, ExportOptions, Format
from loopcal.companions.robot.exports.tables import frames_csv
from loopcal.companions.robot.exports.urdf import decimal
from loopcal.document.exported import Exported
from loopcal.errors import Code, InputError
from loopcal.files.tables.raw import bytes_of
from loopcal.files.toml.reader import shown
from loopcal.mechanisms.chain import Step, product
from loopcal.mechanisms.placement import inverse, rigid
from loopcal.mechanisms.rest import RestChain, roll_pitch_yaw

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


QUARTER = 1.570796327
"""The right angle of the controller's tables."""
LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
MODELS = {
    "ur3": (0.1519, -0.24365, -0.21325, 0.11235, 0.08535, 0.0819),
    "ur5": (0.089159, -0.425, -0.39225, 0.10915, 0.09465, 0.0823),
    "ur10": (0.1273, -0.612, -0.5723, 0.163941, 0.1157, 0.0922),
    "ur3e": (0.15185, -0.24355, -0.2132, 0.13105, 0.08535, 0.0921),
    "ur5e": (0.1625, -0.425, -0.3922, 0.1333, 0.0997, 0.0996),
    "ur10e": (0.1807, -0.6127, -0.57155, 0.17415, 0.11985, 0.11655),
    "ur15": (0.2186, -0.6475, -0.5164, 0.1824, 0.1361, 0.1434),
    "ur16e": (0.1807, -0.4784, -0.36, 0.17415, 0.11985, 0.11655),
    "ur20": (0.2363, -0.862, -0.7287, 0.201, 0.1593, 0.1543),
    "ur30": (0.2363, -0.637, -0.5037, 0.201, 0.1593, 0.1543),
}
"""d_1, a_2, a_3, d_4, d_5 and d_6 [m]."""
# Calibrated arms lie within millimetres of their drawing; farther away is another machine.
_NEAR = 0.05
"""[m, 1] by which the entries of an origin may differ from the drawing's."""


@dataclass(frozen=True)
class UrTable:
    """theta, d, a and alpha of the six joints [rad, m], as the controller holds them."""

    theta: tuple[float, ...]
    d: tuple[float, ...]
    a: tuple[float, ...]
    alpha: tuple[float, ...]

    def changed(self, deltas: Mapping[str, Sequence[float]]) -> UrTable:
        """With theta, d, a and alpha changed by these."""
        return UrTable(
            *(
                tuple(float(v + d) for v, d in zip(getattr(self, key), deltas[key], strict=True))
                for key in ("theta", "d", "a", "alpha")
            )
        )


def drawing(model: str) -> UrTable:
    """The table of a model as drawn."""
    d1, a2, a3, d4, d5, d6 = MODELS[model]
    return UrTable(
        (0.0,) * 6,
        (d1, 0.0, 0.0, d4, d5, d6),
        (0.0, a2, a3, 0.0, 0.0, 0.0),
        (QUARTER, 0.0, 0.0, QUARTER, -QUARTER, 0.0),
    )


@dataclass(frozen=True, eq=False)
class UrOrigins:
    """model: whose drawing the arm is near; origins: L (4, 4) by link; base, tool: B and T."""

    model: str
    origins: Mapping[str, Array]
    base: Array
    tool: Array


def ur_origins(chain: RestChain) -> UrOrigins:
    """A calibrated arm as the origins of the model that it is nearest to.

    Raises InputError for an arm that is none of these.
    """
    joints = chain.joints
    turning = [j for j in joints if j.kind == "revolute" and abs(j.factor) == 1.0]
    if len(joints) != 6 or len(turning) != 6 or len({j.reads for j in joints}) != 6:
        raise _no_ur("it does not have six turning joints")
    fits = [_placed(chain.along_z, model) for model in MODELS]
    errors = [_away(one) for one in fits]
    best = int(np.argmin(errors))
    if errors[best] > _NEAR:
        raise _no_ur(
            f"it is nearest to the {fits[best].model}, from which an entry of an origin differs "
            f"by {errors[best]:.3g} (m or rad)"
        )
    return fits[best]


def _no_ur(words: str) -> InputError:
    return InputError(
        f"this arm is not one of Universal Robots: {words}",
        code="unsupported",
        remedy="check the signs and zeros of the joints, or use the format of another maker",
    )


def nominal_origins(model: str) -> list[Array]:
    """L_1 ... L_6 (4, 4) of a drawing."""
    table = drawing(model)
    ahead, origins = np.eye(4), []
    for theta, d, a, alpha in zip(table.theta, table.d, table.a, table.alpha, strict=True):
        origins.append(
            ahead @ product([Step("rz", constant=theta), Step("tz", constant=d)], {}, {})
        )
        ahead = product([Step("tx", constant=a), Step("rx", constant=alpha)], {}, {})
    return origins


def _away(arm: UrOrigins) -> float:
    nominal = nominal_origins(arm.model)
    pairs = zip(arm.origins.values(), nominal, strict=True)
    return max(float(np.abs(L - N).max()) for L, N in pairs)


def _placed(chain: RestChain, model: str) -> UrOrigins:
    """The frames of a chain, whose axes are along z, near those of a drawing."""
    axes, T = [], np.eye(4)
    for joint in chain.joints:
        T = T @ joint.before
        axes.append(T)
    tip = T @ chain.tip
    nominal = nominal_origins(model)
    base = _base(axes[0], axes[1], MODELS[model][0])
    origins, before = {}, base
    for link, axis, N in zip(LINKS, axes, nominal, strict=True):
        frame = _onto(axis, before @ N)
        origins[link] = inverse(before) @ frame
        before = frame
    return UrOrigins(model, origins, base, inverse(before) @ tip)


def _base(first: Array, second: Array, height: float) -> Array:
    """B: its z along axis 1, its -y towards axis 2, below where axis 2 comes nearest."""
    z, along = first[:3, 2], second[:3, 2]
    across = along - z * (z @ along)
    y = -across / (float(np.linalg.norm(across)) or 1.0)
    x = np.cross(y, z)
    between = second[:3, 3] - first[:3, 3]
    # the point of axis 1 that is nearest to axis 2
    # Shortest distance of two lines: the foot on axis 1 has its connection normal to both axes.
    square = float(across @ across) or 1.0
    s = float(between @ z) - float(between @ across) * float(along @ z) / square
    foot = first[:3, 3] + s * z
    return rigid(np.stack([x, y, z], axis=1), foot - height * z)


def _onto(axis: Array, near: Array) -> Array:
    """The frame with this axis as z that comes nearest to another."""
    z, o = axis[:3, 2], axis[:3, 3]
    x = near[:3, 0] - z * (z @ near[:3, 0])
    x = x / (float(np.linalg.norm(x)) or 1.0)
    origin = o + z * float(z @ (near[:3, 3] - o))
    return rigid(np.stack([x, np.cross(z, x), z], axis=1), origin)

"""A camera: pixels of the points of a board, on the machine's body or beside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from inspect import signature
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from loopcal.expressions.vectors import cross, dot, vector
from loopcal.keys import Key
from loopcal.mechanisms.cameras.board import Board
from loopcal.mechanisms.cameras.lens import FRAME, LENSES, Intrinsics, project, turning_radius
from loopcal.mechanisms.chain import Step, frames, product
from loopcal.mechanisms.frame import ChainFrame, Frame, Values, Vector
from loopcal.mechanisms.machine import Instrument, recorded
from loopcal.mechanisms.mechanism import PIXELS, Family, Mechanism
from loopcal.mechanisms.parallel.free_body import COLUMNS, pose_read
from loopcal.mechanisms.parameters import Parameter
from loopcal.mechanisms.placement import inverse
from loopcal.mechanisms.station import MOTIONS, Name, Station, placed_by

PIXEL = ("u", "v")
Points = Annotated[
    Mapping[str, tuple[float, float, float]],
    Key(
        "Points of the board by their ids, each x, y, z in the board's frame, z out of the print.",
        unit="m",
        least=1,
        example={"0": [0.0, 0.0, 0.0], "1": [0.03, 0.0, 0.0]},
    ),
]
On = Annotated[
    str,
    Key(
        "What carries the camera: the base (eye to hand; the machine's body carries the board), "
        "the body (eye in hand; the board is fixed to the base), or a body of a tree by its name.",
    ),
]
Sees = Annotated[
    str | None,
    Key(
        "The body of a tree that carries the board. Default: its only leaf for a camera on the "
        "base, else its root, the ground."
    ),
]
Lens = Annotated[
    str,
    Key("What the lens does beyond a pinhole.", choices=tuple(LENSES)),
]
Image = Annotated[
    tuple[int, int] | None,
    Key(
        "Width and height of its images. Default: twice the principal point.",
        unit="px",
        example=[1600, 1200],
    ),
]
_INTRINSIC = {
    "f": ("focal length along u", "px"),
    "aspect": ("focal length along v over that along u, less 1", "1"),
    "cx": ("principal point along u", "px"),
    "cy": ("principal point along v", "px"),
}
_SHAPE = {
    "scale": "size of the print over the stated one, less 1",
    "aspect": "size along y over that along x, less 1",
    "warp_x": "height of the middle over the two edges across x",
    "warp_y": "height of the middle over the two edges across y",
}
ASPECT_SD = 1e-3
"""How square the pixels of a sensor are. Chosen: sensors are made by lithography."""
PRINT_SD, WARP_SD = 0.01, 1e-3
"""How far prints are off: 1 % in size, 1 mm in flatness. Chosen: prints are off by 0.5 to 3 %."""


@partial(recorded, also={"image": Image})
def camera(
    name: Name = "camera",
    *,
    points: Points,
    board: Annotated[
        str, Key("Name of the board: six parameters BOARD_x, _y, _z, _rz, _ry, _rx.")
    ] = "board",
    eye: Annotated[
        str | None,
        Key(
            "Name of the camera, which begins the names of its parameters; entries for several "
            "boards name the same one. Default: the name of the instrument."
        ),
    ] = None,
    on: On = "base",
    sees: Sees = None,
    lens: Lens = "brown5",
    offsets: Annotated[
        bool,
        Key(
            "Whether each point has offsets BOARD_POINT_x, _y, _z, with a prior in [prior]. "
            "Without, those of a flat board are learnt."
        ),
    ] = False,
) -> Instrument:
    """Pixels (u, v) at which a camera sees the points of a board; one image is one pose.

    With P the point in the camera's frame (x right, y down, z forward) and pi the lens:

        pi(P) - (u, v) = 0 [px],
        on the base:  P = T_camera_base T_base_body T_body_board X,
        on the body:  P = T_body_camera^-1 T_base_body^-1 T_board_base^-1 X.

    On the base EYE_x ... EYE_rx are T_camera_base and BOARD_x ... BOARD_rx T_body_board. On the
    body EYE_x ... EYE_rx are T_body_camera and BOARD_x ... BOARD_rx T_board_base, where the base is
    that which carries the board: of a tree any body that it `sees`, such as a hand. EYE_f, _aspect,
    _cx, _cy and the coefficients of the lens (`loopcal.mechanisms.cameras.lens`) need nominal
    values. X is the point of the board as printed:

        ((1 + scale) x, (1 + scale) (1 + aspect) y, z + warp_x (1 - (x/a)^2) + warp_y (1 - (y/b)^2))

    with x and y of the warp from the middle of the board, which is 2a wide and 2b high. Readings
    are named EYE:BOARD:POINT:u and :v; a point that was not detected is blank. (0, 0) is the centre
    of the first pixel.

    Raises InputError for another lens, and a board without points.
    """
    eye = name if eye is None else eye
    seen = Board(
        board, {point: (float(x), float(y), float(z)) for point, (x, y, z) in points.items()}
    )
    coefficients = LENSES[lens]
    intrinsic = {
        **{
            f"{eye}_{key}": Parameter(
                f"{eye}_{key}",
                1000.0 if key == "f" else 0.0,
                unit,
                prior_sd=ASPECT_SD if key == "aspect" else np.inf,
                role="lens",
                owner=eye,
                meaning=meaning,
            )
            for key, (meaning, unit) in _INTRINSIC.items()
        },
        **{
            f"{eye}_{key}": Parameter(
                f"{eye}_{key}", 0.0, "1", role="lens", owner=eye, meaning=f"distortion {key}"
            )
            for key in coefficients
        },
    }
    printed = _printed(seen, offsets=offsets)
    camera_on_body = on != "base"
    stands = Station(board if camera_on_body else eye)
    mount = tuple(
        Step(m, f"{eye if camera_on_body else board}_{m[1] if m[0] == 't' else m}")
        for m in MOTIONS[3]
    )
    mounted = placed_by(mount, eye if camera_on_body else board)
    names = {p: [f"{eye}:{board}:{p}:{axis}" for axis in PIXEL] for p in seen.points}

    def equations(frames: Sequence[Frame], x: Values, p: Values) -> list[Any]:
        axes = _eye_in_hand if camera_on_body else _eye_to_hand
        origin, ex, ey, ez = axes(frames[0], stands, mount, p)
        values = {key: p[f"{eye}_{key}"] for key in (*FRAME, *coefficients)}
        loops = []
        for point, pixel in names.items():
            X, Y, Z = _as_printed(seen, point, printed, p)
            P = origin + X * ex + Y * ey
            if not _nothing(Z):
                P = P + Z * ez
            predicted = project(lens, P, values)
            loops += [value - x[reading] for value, reading in zip(predicted, pixel, strict=True)]
        return loops

    return Instrument(
        name,
        {reading: "px" for pixel in names.values() for reading in pixel},
        mounted | intrinsic | printed,
        equations,
        PIXELS,
        placement=stands.declared,
        mounted=tuple(mounted),
        place=stands,
        remedy=f"the board {board!r} is beside or behind the camera {eye!r}: begin nearer to where "
        "it is, with `loopcal init`",
        on=(None if on == "body" else on) if camera_on_body else sees,
        against=sees if camera_on_body else None,
    )


def _printed(board: Board, *, offsets: bool) -> dict[str, Parameter]:
    """What a print may be off by, each with a prior sd."""
    declared: dict[str, Parameter] = {}
    if board.planar and len(board.points) > 3:
        for key, meaning in _SHAPE.items():
            unit, sd = ("m", WARP_SD) if key.startswith("warp") else ("1", PRINT_SD)
            declared[key] = Parameter(
                f"{board.name}_{key}",
                0.0,
                unit,
                prior_sd=sd,
                role="print",
                owner=board.name,
                meaning=meaning,
            )
    # Those of a planar print are learnt beside the fit (`loopcal.estimation.noise.prints`).
    learnt = bool(declared) and not offsets
    for point in board.points if offsets or learnt else ():
        for axis in "xyz":
            key = f"{point}:{axis}"
            declared[key] = Parameter(
                f"{board.name}_{point}_{axis}",
                0.0,
                "m",
                prior_sd=WARP_SD,
                fixed=learnt,
                role="corner" if learnt else "print",
                owner=board.name,
                meaning=f"offset of the point {point} along {axis}",
            )
    return {p.name: p for p in declared.values()}


def _as_printed(board: Board, point: str, printed: Mapping[str, Any], p: Values) -> list[Any]:
    """X, Y, Z of a point of the board."""
    nominal = board.points[point]
    X: list[Any] = list(nominal)
    if f"{board.name}_scale" in printed:
        (mx, my, _), (a, b) = board.middle, board.half
        dx, dy = nominal[0] - mx, nominal[1] - my
        size = 1.0 + p[f"{board.name}_scale"]
        # About the origin: cameras that see other points of the board share these parameters.
        X[0] = size * nominal[0]
        X[1] = size * ((1.0 + p[f"{board.name}_aspect"]) * nominal[1])
        for warp, across in (("warp_x", dx / a if a else 0.0), ("warp_y", dy / b if b else 0.0)):
            X[2] = X[2] + (1.0 - across**2) * p[f"{board.name}_{warp}"]
    for i, axis in enumerate("xyz"):
        if f"{board.name}_{point}_{axis}" in printed:
            X[i] = X[i] + p[f"{board.name}_{point}_{axis}"]
    return X


def _nothing(value: Any) -> bool:
    return isinstance(value, float) and value == 0.0


Axes = tuple[Vector, Vector, Vector, Vector]


def _eye_to_hand(body: Frame, station: Station, mount: Sequence[Step], p: Values) -> Axes:
    """Origin and axes of the board in the camera: T_camera_base T_base_body T_body_board."""
    mounted, stands = ChainFrame(mount, {}, p), ChainFrame(station.steps, {}, p)
    origin = stands.point(body.point(mounted.point(vector(0.0, 0.0, 0.0))))
    ex, ey = (
        stands.direction(body.direction(mounted.direction(vector(*unit))))
        for unit in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    )
    return origin, ex, ey, cross(ex, ey)


def _eye_in_hand(body: Frame, station: Station, mount: Sequence[Step], p: Values) -> Axes:
    """The same by T_body_camera^-1 T_base_body^-1 T_board_base^-1."""
    back = ChainFrame([s.inverse() for s in reversed(station.steps)], {}, p)
    into = ChainFrame([s.inverse() for s in reversed(mount)], {}, p)
    bx, by = (body.direction(vector(*u)) for u in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)))
    bz, at = cross(bx, by), body.point(vector(0.0, 0.0, 0.0))

    def turned(v: Vector) -> Vector:
        return vector(dot(bx, v), dot(by, v), dot(bz, v))

    origin = into.point(turned(back.point(vector(0.0, 0.0, 0.0)) - at))
    ex, ey = (
        into.direction(turned(back.direction(vector(*u))))
        for u in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    )
    return origin, ex, ey, cross(ex, ey)


# What a machine's description says of its cameras.


@dataclass(frozen=True)
class CameraEntry:
    """A camera and the board it sees, with their calibrated or nominal values [SI].

    T_eye, T_board: (4, 4) of their places as `camera` defines them; instrument: what reads them;
    on: the base, the body, or a body of a tree.
    """

    name: str
    board: Board
    on: str
    intrinsics: Intrinsics
    T_eye: NDArray[np.float64]
    T_board: NDArray[np.float64]
    instrument: str = ""

    @property
    def on_body(self) -> bool:
        """Whether it moves with the machine, or with a body of a tree."""
        return self.on != "base"


def cameras_of(mechanism: Mechanism) -> tuple[CameraEntry, ...]:
    """The cameras on the base or the body of a mechanism that can be described, by instrument."""
    # Places of the others are those of bodies of a tree.
    return tuple(one for one in all_cameras(mechanism) if one.on in ("base", "body"))


def all_cameras(mechanism: Mechanism) -> tuple[CameraEntry, ...]:
    """The same, with those on bodies of a tree."""
    values = {p.name: p.nominal for p in mechanism.parameters}
    usual = {name: one.default for name, one in signature(camera).parameters.items()}
    entries = []
    for described in (mechanism.description or {}).get("instrument", ()):
        if described["type"] != "camera":
            continue
        stated = {**usual, **described}
        eye, lens = stated["eye"] or stated["name"], stated["lens"]
        intrinsic = {key: values[f"{eye}_{key}"] for key in (*FRAME, *LENSES[lens])}
        points = {
            str(k): (float(x), float(y), float(z)) for k, (x, y, z) in stated["points"].items()
        }
        T_eye, T_board = (
            product(Station(name).steps, {}, values) for name in (eye, stated["board"])
        )
        entries.append(
            CameraEntry(
                eye,
                Board(stated["board"], points),
                stated["on"],
                Intrinsics.of(lens, intrinsic, stated["image"] and tuple(stated["image"])),
                T_eye,
                T_board,
                stated["name"],
            )
        )
    return tuple(entries)


def boards_in_camera(
    mechanism: Mechanism, family: Family, readings: Mapping[str, NDArray[np.float64]], count: int
) -> NDArray[np.float64]:
    """(N, 4, 4) of the board that a camera sees, in the camera; of a tree of bodies or of one body
    whose pose is read; readings: with the known constants."""
    eye, board = family.readings[0].split(":")[:2]
    values = {p.name: p.nominal for p in mechanism.parameters}
    if mechanism.tree is None:
        R, origin = pose_read(readings)
    else:
        *_, (R, origin) = frames(mechanism.tree.path(family.on, family.against), readings, values)
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3], T[:, :3, 3] = R, origin
    eyes, boards = (product(Station(name).steps, {}, values) for name in (eye, board))
    on_base = isinstance(family.placement, Station) and family.placement.name == eye
    return np.asarray(eyes @ T @ boards if on_base else inverse(boards @ T @ eyes))


def off_axis(
    mechanism: Mechanism, family: Family, readings: Mapping[str, NDArray[np.float64]], count: int
) -> NDArray[np.float64] | None:
    """(N, points) angle [rad] from the axis of a camera to each point of its board; None where
    nothing says where the board is; readings: as of `boards_in_camera`."""
    entry = next((one for one in all_cameras(mechanism) if one.instrument == family.name), None)
    if entry is None or not (mechanism.tree or {*COLUMNS} <= readings.keys()):
        return None
    M = boards_in_camera(mechanism, family, readings, count)
    x, y, z = np.moveaxis(M[:, :3, :3] @ entry.board.xyz.T + M[:, :3, 3:], 1, 0)
    return np.asarray(np.arctan2(np.hypot(x, y), z))


def before_lens(
    mechanism: Mechanism, family: Family, readings: Mapping[str, NDArray[np.float64]], count: int
) -> NDArray[np.bool_]:
    """(N,) whether all of the board is in front of the camera, and where its lens does not turn
    back: of what is elsewhere a pixel is computed too, but no image shows it; readings: as of
    `boards_in_camera`."""
    angle = off_axis(mechanism, family, readings, count)
    if angle is None:
        return np.ones(count, dtype=bool)
    lens = next(one for one in all_cameras(mechanism) if one.instrument == family.name).intrinsics
    most = turning_radius(lens.lens, lens.values)
    most = most if lens.lens == "fisheye" else np.arctan(most)
    return np.asarray((angle < most).all(axis=1))

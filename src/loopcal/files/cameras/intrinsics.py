"""Cameras as other programs describe them: ROS, Kalibr, OpenCV, industrial_calibration and others.

What a file is shows in its keys, not in its name:

    ROS camera_info           camera_matrix or K, distortion_model, as a file or as a message
    Kalibr camchain           camera_model, intrinsics, distortion_model; T_cn_cnm1 [m]
    OpenCV FileStorage        camera_matrix, cameraMatrix, M1, ... and distortion_coefficients,
                              D1, ...; R, T of the second camera of a pair
    fx, fy, cx, cy by name    industrial_calibration and others; k1, ... and width, height beside

Several cameras stand under their names. In all of these formats the centre of the first pixel is
(0, 0), as here.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from loopcal.arrays import Array
from loopcal.errors import InputError
from loopcal.files.cameras.document import Part, read_document, transform
from loopcal.mechanisms.cameras.lens import LENSES, Intrinsics

_DEPTH = 4
"""Mappings within mappings in which cameras are looked for."""
_BROWN = {0: "pinhole", 4: "brown5", 5: "brown5", 8: "brown8", 12: "brown12", 14: "brown12"}
"""Coefficients of OpenCV -> lens; of 4 the k3 is 0, the last two of 14 tilt the sensor."""
_P = 12
"""Numbers of P of a `camera_info`, 3 x 4."""
_ENDS = {1: 4, 2: 4, 6: 8, 7: 8}
"""Lengths of lists that end with k1, k2, k4 or k5, and of those that go on with zeros."""
_OF = r"[_-]?(?P<of>\d+|l|r|left|right)?"
_MATRIX = re.compile(rf"(?:camera_?matrix|intrinsics?(?:_?matrix)?|mtx|k|m){_OF}", re.IGNORECASE)
_DISTORTION = re.compile(
    rf"(?:dist|distortion|d)(?:_?coe?f+s?|_?coefficients?)?{_OF}", re.IGNORECASE
)
_PLACED = re.compile(r"T_(?P<of>.+?)_(?P<first>.+?)(?P<mm>_mm)?")
_SIZE = (("image_width", "width"), ("image_height", "height"))


@dataclass(frozen=True)
class Rig:
    """cameras: by name; T_camera_first: the place (4, 4) [m] of the first camera in each, of those
    whose place the file states."""

    cameras: Mapping[str, Intrinsics]
    T_camera_first: Mapping[str, Array]


def read_intrinsics(path: str | Path) -> dict[str, Intrinsics]:
    """The cameras of a file by name, "camera" where it names none.

    Raises InputError for a file without cameras, for a lens that is not one of `LENSES`, and for
    numbers that are none.
    """
    cameras = dict(read_rig(path).cameras)
    if not cameras:
        raise InputError(
            "no camera is recognised in this file",
            code="missing-key",
            place=Path(path).name,
            remedy="state fx, fy, cx, cy, or name a camera_info, camchain or OpenCV file",
        )
    return cameras


def read_rig(path: str | Path) -> Rig:
    """As `read_intrinsics`, with the places of the cameras; the cameras may be missing."""
    document = read_document(path)
    cameras = dict(_cameras(document, "camera", _DEPTH))
    return Rig(cameras, dict(_places(document)))


def _cameras(part: Part, name: str, depth: int) -> Iterator[tuple[str, Intrinsics]]:
    one = _camera(part)
    if one is not None:
        named = part.get("camera_name")
        yield (named.text if named and named.text else name), one
        return
    several = list(_matrices(part, name))
    yield from several
    for key, inner in part.items() if depth and not several else ():
        if isinstance(inner.data, dict):
            yield from _cameras(inner, key, depth - 1)


def _camera(part: Part) -> Intrinsics | None:
    """The camera that a mapping describes; None where it describes none or several."""
    matrix = part.get("camera_matrix", "K", "k")
    model = part.get("distortion_model")
    if matrix and model:
        D = part.get("distortion_coefficients", "D", "d")
        fisheye = model.text in ("equidistant", "fisheye")
        if not (fisheye or model.text in ("plumb_bob", "rational_polynomial", "none", "")):
            raise _unsupported(model, "plumb_bob, rational_polynomial and equidistant")
        lens = _of_matrix(matrix, D, _image(part), fisheye)
        P = part.get("projection_matrix", "P", "p")
        stated = P.numbers() if P else ()
        # A rectified image is one possibility among others: what is no matrix says nothing of it.
        fx, _, cx, _, _, fy, cy, *_ = stated if len(stated) == _P else [0.0] * _P
        return replace(lens, rectified=(fx, fy, cx, cy)) if fx > 0.0 and fy > 0.0 else lens
    if "camera_model" in part and "intrinsics" in part:
        return _of_kalibr(part)
    if {"fx", "fy", "cx", "cy"} <= {key for key, _ in part.items()}:
        return _by_name(part)
    return None


_EQUI = ("equidistant", "equi")
"""Kalibr writes the first, and is asked for the second."""


def _of_kalibr(part: Part) -> Intrinsics:
    if part.part("camera_model").text != "pinhole":
        raise _unsupported(part.part("camera_model"), "pinhole")
    model = part.get("distortion_model")
    if model and model.text not in ("radtan", "none", *_EQUI):
        raise _unsupported(model, "radtan, equidistant and none")
    fx, fy, cx, cy = part.part("intrinsics").numbers(4)
    stated = part.get("distortion_coeffs")
    image = part.get("resolution")
    fisheye = bool(model and model.text in _EQUI)
    none = model is None or model.text == "none"
    coefficients = () if none or stated is None else stated.numbers(4)
    return _made(part, (fx, fy, cx, cy), coefficients, _pair(image), fisheye)


_FISHEYES = re.compile(r"fish|equi|kannala|brandt|^kb\d?$")
_BROWNS = re.compile(r"pinhole|brown|conrady|plumb|radtan|rational|opencv|perspective|^none$")
"""Words by which programs name a lens."""


def _by_name(part: Part) -> Intrinsics:
    frame = [part.part(name).number for name in ("fx", "fy", "cx", "cy")]
    stated = part.get("lens", "model", "camera_model", "distortion_model", "projection")
    word = "" if stated is None else stated.text.lower()
    named = {key for key, _ in part.items()} & {*LENSES["brown12"]}
    # The smallest lens that has all the coefficients stated; k1 alone does not tell a fisheye, but
    # k4 does where nothing else is beside it that a lens with k4 has.
    lens = next(one for one, coefficients in LENSES.items() if named <= {*coefficients})
    if _FISHEYES.search(word) or (not word and named == {*LENSES["fisheye"]}):
        lens = "fisheye"
    elif word in LENSES:
        lens = word
    elif stated is not None and word and not _BROWNS.search(word):
        raise _unsupported(stated, ", ".join(LENSES))
    coefficients = [c.number if (c := part.get(name)) else 0.0 for name in LENSES[lens]]
    return _made(part, frame, coefficients, _image(part), lens == "fisheye")


def _matrices(part: Part, name: str) -> Iterator[tuple[str, Intrinsics]]:
    """Matrices of cameras as OpenCV's programs store them, each with its distortion."""
    distortions = {
        (match["of"] or "").lower(): value
        for key, value in part.items()
        if (match := _DISTORTION.fullmatch(key))
    }
    fisheye = part.get("fisheye_model", "fisheye")
    for key, value in part.items():
        match = _MATRIX.fullmatch(key)
        of = ((match["of"] or "") if match else key).lower()
        if not isinstance(value.data, dict | list) or not (match or of in distortions):
            continue
        if match and not ("data" in value or isinstance(value.data, list)):
            continue
        stated = part.get("camera_name")
        D = distortions.get(of)
        image = _image(part)
        camera = _of_matrix(value, D, image, bool(fisheye and fisheye.flag))
        yield of or (stated.text if stated else name), camera


def _of_matrix(K: Part, D: Part | None, image: tuple[int, int] | None, fisheye: bool) -> Intrinsics:
    fx, skew, cx, zero, fy, cy, *last = K.numbers(9)
    if not any(K.numbers()):
        raise InputError(
            "the camera matrix is zero, as of a camera that was never calibrated",
            code="invalid-value",
            place=K.place,
            remedy="calibrate the camera, or leave the file out",
        )
    if zero or last != [0.0, 0.0, 1.0]:
        raise K.wrong("a camera matrix fx 0 cx, 0 fy cy, 0 0 1")
    if abs(skew) > 1e-9 * abs(fx):
        raise InputError(
            f"the camera matrix has a skew of {skew:g}, which no lens here has",
            code="unsupported",
            place=K.place,
            remedy="calibrate the camera without skew; sensors of today have none",
        )
    return _made(K, (fx, fy, cx, cy), () if D is None else D.numbers(), image, fisheye)


def _made(
    part: Part,
    frame: Sequence[float],
    D: Sequence[float],
    image: tuple[int, int] | None,
    fisheye: bool,
) -> Intrinsics:
    fx, fy, cx, cy = frame
    if not (fx > 0.0 and fy > 0.0):
        raise InputError(
            f"the focal lengths are {fx:g} and {fy:g} px, and must be positive",
            code="invalid-value",
            place=part.place,
            remedy="an uncalibrated camera has none: calibrate it, or leave the file out",
        )
    D = tuple(D)
    most = 4 if fisheye else max(_BROWN)
    while len(D) > most and D[-1] == 0.0:
        D = D[:-1]
    D = (*D, *[0.0] * (_ENDS.get(len(D), 0) - len(D)))
    if fisheye:
        lens, wanted = "fisheye", "4"
        counts: Sequence[int] = (0, 4)
    else:
        lens, wanted, counts = _BROWN.get(len(D), ""), "4, 5, 8, 12 or 14", [*_BROWN]
    if len(D) not in counts:
        raise InputError(
            f"the camera has {len(D)} coefficients of distortion",
            code="wrong-shape",
            place=part.place,
            remedy=f"state {wanted} of them, in OpenCV's order",
        )
    if len(D) == 14 and any(D[12:]):
        raise InputError(
            "the sensor is tilted against the lens, which no lens here has",
            code="unsupported",
            place=part.place,
            remedy="calibrate the camera without tilt",
        )
    D = (*D, 0.0) if lens == "brown5" and len(D) == 4 else D[:12]
    return Intrinsics(lens, fx, fy, cx, cy, D, image)


def _image(part: Part) -> tuple[int, int] | None:
    size = part.get("image_size", "resolution", "image")
    if size is not None and isinstance(size.data, dict | list):
        return _pair(size)
    width, height = (part.get(*names) for names in _SIZE)
    return (width.count, height.count) if width and height and width.number else None


def _pair(size: Part | None) -> tuple[int, int] | None:
    if size is None:
        return None
    size.numbers(2)
    width, height = (
        Part(size.data, size.place).parts()
        if isinstance(size.data, list)
        else (size.part("data").parts())
    )
    return width.count, height.count


def _places(part: Part) -> Iterator[tuple[str, Array]]:
    """T_camera_first (4, 4) of the cameras whose places are stated, the first with its own."""
    chain = [(name, inner) for name, inner in part.items() if "camera_model" in inner]
    if any("T_cn_cnm1" in inner for _, inner in chain):
        T = np.eye(4)
        for name, inner in chain:
            T = transform(inner.part("T_cn_cnm1")) @ T if "T_cn_cnm1" in inner else T
            yield name, T
    if "R" in part and "T" in part and "camera_model" not in part:
        rows = np.c_[np.reshape(part.part("R").numbers(9), (3, 3)), part.part("T").numbers(3)]
        yield "1", np.eye(4)
        yield "2", transform(Part(rows.tolist(), part.part("R").place))
    for key, inner in (part.get("cameras") or part).items():
        match = _PLACED.fullmatch(key)
        if match and isinstance(inner.data, list):
            values = np.reshape(inner.numbers(16), (4, 4))
            values[:3, 3] *= 1e-3 if match["mm"] else 1.0
            yield match["first"], np.eye(4)
            yield match["of"], transform(Part(values.tolist(), inner.place))


def _unsupported(part: Part, models: str) -> InputError:
    return InputError(
        f"the model {part.text!r} is not read",
        code="unsupported",
        place=part.place,
        remedy=f"calibrate the camera as one of {models}",
    )

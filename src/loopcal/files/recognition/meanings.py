"""What the numbers of an instrument may mean: units, forms of orientation, direction of a pose.

Every meaning is tried on the nominal machine, placed as well as can be; `Mounted.share` says how
well it fits. Units that a header states are not varied.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.errors import InputError
from loopcal.estimation.mounted import (
    Bodies,
    Mounted,
    see_lengths,
    see_planar,
    see_points,
    see_poses,
)
from loopcal.files.recognition.fields import Field, names_of
from loopcal.files.recognition.layouts import Seen
from loopcal.units import to_si, unit

LENGTHS, ANGLES = ("m", "mm", "cm", "in"), ("rad", "deg", "gon")
JOINT_ANGLES = (*ANGLES, "turn", "arcmin")
_MOST_TURNS = 4.0 * np.pi
"""No joint is read beyond this [rad]: readings that are larger are in another unit."""
_FORMS: tuple[tuple[str, str, tuple[int, int, int]], ...] = (
    ("a rotation vector", "rotation-vector", (0, 1, 2)),
    ("turns about x, y and z, Rz Ry Rx", "rz ry rx", (2, 1, 0)),
    ("turns about x, y and z, Rx Ry Rz", "rx ry rz", (0, 1, 2)),
)
"""In words; the form of an instrument; which of the columns x, y, z are its numbers."""
_QUATERNIONS = (
    ((0, 1, 2, 3), "w, x, y, z"),
    ((3, 0, 1, 2), "x, y, z, w"),
    ((1, 2, 3, 0), "z, w, x, y"),  # w, x, y, z under headers x, y, z, w
)
"""Which of the columns are w, x, y and z; what the columns are, in words."""
_POLAR_FORMS = (
    ("", ""),
    ("zenith", ", the last counted from the zenith"),
    ("clockwise", ", the first counted clockwise"),
    ("zenith clockwise", ", the first counted clockwise, the last from the zenith"),
)
_FORMS_BY_NAME: dict[tuple[str, ...], tuple[tuple[str, str, tuple[int, int, int]], ...]] = {
    ("a", "b", "c"): (
        ("turns A, B, C, Rz Ry Rx", "rz ry rx", (0, 1, 2)),
        ("turns A, B, C about x, y and z, Rz Ry Rx", "rz ry rx", (2, 1, 0)),
    ),
    ("w", "p", "r"): (("turns W, P, R, Rz Ry Rx", "rz ry rx", (2, 1, 0)),),
    ("roll", "pitch", "yaw"): (
        ("roll, pitch, yaw, Rz Ry Rx", "rz ry rx", (2, 1, 0)),
        ("yaw, pitch, roll, Rz Ry Rz", "rz ry rz", (2, 1, 0)),
    ),
    ("o", "a", "t"): (("turns O, A, T, Rz Ry Rz", "rz ry rz", (0, 1, 2)),),
    ("u", "v", "w"): (("turns U, V, W, Rz Ry Rx", "rz ry rx", (0, 1, 2)),),
    ("a", "e", "r"): (("turns A, E, R, Rz Ry Rz", "rz ry rz", (0, 1, 2)),),
}
"""By the letters under which makers of robots write three turns, what these may mean."""


@dataclass(frozen=True, eq=False)
class Meaning:
    """One meaning of the columns of an instrument.

    length, angle: units of its columns; form: of the orientation, as an instrument states it;
    order: which columns are its numbers; inverted: the station is seen from the target; position:
    (N, 3), (N, 2) of what reads x and y, or (N,) [m]; turns: (N, 3, 3) of a pose; fit: on the
    nominal machine; words: what was not stated.
    """

    seen: Seen
    length: str
    angle: str
    form: str
    order: tuple[int, ...]
    inverted: bool
    position: Array
    turns: Array | None
    words: tuple[str, ...]
    fit: Mounted | None = None

    @property
    def share(self) -> float:
        """The misfit of the nominal machine, as a share of the spread of the readings."""
        return self.fit.share if self.fit else float("inf")

    @property
    def in_space(self) -> bool:
        """Whether it reads where a point is, in three coordinates."""
        return self.position.ndim == 2 and self.position.shape[1] == 3

    @property
    def read_in(self) -> tuple[str, str, str]:
        """Length, angle and form, as `positions` takes them."""
        return self.length, self.angle, self.form

    def fitted(
        self, bodies: Bodies, index: NDArray[np.intp] | slice = slice(None), rounds: int = 4
    ) -> Meaning:
        """With its fit on some poses of the nominal machine; infinite where there is none.

        rounds: how often the better poses are found anew.
        """
        some = bodies.take(index)
        position = self.position[index]
        try:
            if self.seen.kind == "length":
                fit = see_lengths(some, position)
            elif self.seen.kind == "planar":
                fit = see_planar(some, position, rounds)
            elif self.turns is not None:
                fit = see_poses(some, position, self.turns[index], rounds)
            else:
                fit = see_points(some, position[None], rounds)
        except (InputError, np.linalg.LinAlgError):
            return replace(self, fit=None)
        return replace(self, fit=fit)


def meanings(seen: Seen, *, as_stated: bool = True) -> Iterator[Meaning]:
    """Every meaning of the columns of an instrument; as_stated: in the units of their headers."""
    for length in _units(_lengths_of(seen), LENGTHS, as_stated):
        for angle, form, order, R, words in _orientations(seen, as_stated):
            reading_words = (f"{names_of(_lengths_of(seen))} in {length}", *words)
            made = Meaning(
                seen,
                length,
                angle,
                form,
                order,
                False,
                positions(seen, length, angle, form),
                R,
                reading_words,
            )
            yield made
            if R is not None:
                words = (*reading_words, "the pose is that of the station seen from the target")
                yield replace(inverse(made), words=words)


def positions(seen: Seen, length: str, angle: str, form: str) -> Array:
    """Points (N, 3) or (N, 2), or (N,) lengths [m], of columns in these units."""
    if seen.kind == "spherical":
        return _cartesian(_polar(seen, length, angle, form))
    factor = unit(length).factor
    if seen.kind == "length":
        return factor * seen.position[0].values
    return factor * np.array([f.values for f in seen.position]).T


def inverse(meaning: Meaning) -> Meaning:
    """The columns as the pose of the station, seen from the target."""
    assert meaning.turns is not None
    # the inverse of the motion x -> R x + p is x -> R^T x - R^T p
    back = np.swapaxes(meaning.turns, 1, 2)
    moved = -np.einsum("nij,nj->ni", back, meaning.position)
    return replace(meaning, inverted=True, position=moved, turns=back)


def _lengths_of(seen: Seen) -> Sequence[Field]:
    return seen.position[:1] if seen.kind in ("spherical", "length") else seen.position


def _units(fields: Sequence[Field], usual: Sequence[str], as_stated: bool) -> Sequence[str]:
    """The units that columns may be in."""
    stated = next((f.unit for f in fields if f.unit), None)
    if stated is not None and as_stated:
        return (stated,)
    return usual


def _orientations(
    seen: Seen, as_stated: bool
) -> Iterator[tuple[str, str, tuple[int, ...], Array | None, tuple[str, ...]]]:
    """Unit of angles, form, order of the columns, rotations (N, 3, 3), and words."""
    if seen.kind == "spherical":
        for angle in _units(seen.position[1:], ANGLES, as_stated):
            polar_words = f"{names_of(seen.position[1:])} in {angle}"
            for form, words in _POLAR_FORMS:
                yield angle, form, (), None, (f"{polar_words}{words}",)
        return
    if not seen.turned:
        yield "rad", "", (), None, ()
        return
    if seen.form == "matrix":
        by_rows = np.arange(9).reshape(3, 3)
        for numbers, words in ((by_rows, "row by row"), (by_rows.T, "column by column")):
            order = tuple(map(int, numbers.ravel()))
            yield (
                "rad",
                "matrix",
                order,
                turned_by(seen, "rad", "matrix", order),
                (f"the matrix {words}",),
            )
    elif seen.form == "quaternion":
        for order, words in _QUATERNIONS:
            R = turned_by(seen, "rad", "quaternion", order)
            form_words = (f"the quaternion {names_of(seen.turned)} in the order {words}",)
            yield "rad", "quaternion", order, R, form_words
    else:
        names = tuple(f.stem for f in seen.turned)
        forms = _FORMS_BY_NAME.get(names, _FORMS)
        for angle in _units(seen.turned, ANGLES, as_stated):
            for words, form, order in forms:
                R = turned_by(seen, angle, form, order)
                form_words = (f"{names_of(seen.turned)} in {angle}, {words}",)
                yield angle, form, order, R, form_words


def turned_by(seen: Seen, angle: str, form: str, order: Sequence[int]) -> Array:
    """(N, 3, 3) of an orientation; order: of its columns, as the form has them."""
    values = np.array([seen.turned[i].values for i in order]).T
    if form == "matrix":
        return values.reshape(-1, 3, 3)
    if form not in ("quaternion", "rotation-vector"):
        # Capital letters: SciPy then turns about the moving axes, as Rz Ry Rx does.
        form = "".join(t[1] for t in form.split()).upper()
    return rotations(values if form == "quaternion" else to_si(values, angle), form)


def rotations(values: Array, form: str) -> Array:
    """Rotation matrices (N, 3, 3) of numbers (N, k), NaN where one is missing.

    form: "quaternion", w first; "rotation-vector" [rad]; or the axes of three turns [rad] as SciPy
    names them: "xyz" about fixed ones, "ZYX" about those that move.
    """
    from scipy.spatial.transform import Rotation

    complete = np.isfinite(values).all(axis=1)
    if form == "quaternion":
        # SciPy refuses a quaternion of length 0.
        complete &= np.linalg.norm(values, axis=1) > 0.0
    matrices = np.full((len(values), 3, 3), np.nan)
    if complete.any():
        whole = values[complete]
        if form == "quaternion":
            made = Rotation.from_quat(whole[:, [1, 2, 3, 0]])  # SciPy has w last
        elif form == "rotation-vector":
            made = Rotation.from_rotvec(whole)
        else:
            made = Rotation.from_euler(form, whole)
        matrices[complete] = made.as_matrix()
    return matrices


def polar(meaning: Meaning) -> Array:
    """Range [m], azimuth and elevation [rad] (3, N) of a spherical instrument."""
    return _polar(meaning.seen, meaning.length, meaning.angle, meaning.form)


def _polar(seen: Seen, length: str, angle: str, form: str) -> Array:
    r, azimuth, height = (f.values for f in seen.position)
    azimuth, height = unit(angle).factor * azimuth, unit(angle).factor * height
    if "clockwise" in form:
        azimuth = -azimuth
    if "zenith" in form:
        height = 0.5 * np.pi - height
    return np.array([unit(length).factor * r, azimuth, height])


def _cartesian(values: Array) -> Array:
    r, azimuth, elevation = values
    flat = r * np.cos(elevation)
    return np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), r * np.sin(elevation)]).T


def joint_units(
    fields: Sequence[Field], kinds: Sequence[str], *, as_stated: bool = True, mixed: bool = False
) -> Iterator[tuple[str, ...]]:
    """Every way to read the joints: a unit for each column; kinds: their SI units.

    Columns whose headers state none share one unit; mixed: each turning one may be in its own.
    """
    turning = [f for f, si in zip(fields, kinds, strict=True) if si == "rad"]
    sliding = [f for f, si in zip(fields, kinds, strict=True) if si == "m"]
    angles = _units(turning, JOINT_ANGLES, as_stated) if turning else ("rad",)
    lengths = _units(sliding, LENGTHS, as_stated) if sliding else ("m",)
    for angle, length in product(angles if not mixed else ("",), lengths):
        choices = list[tuple[str, ...]]()
        for f, si in zip(fields, kinds, strict=True):
            if f.unit and as_stated:
                choices.append((f.unit,))
            elif si == "m":
                choices.append((length,))
            else:
                some = ANGLES[:2] if mixed else (angle,)
                largest = float(np.nanmax(np.abs(f.values), initial=0.0))
                choices.append(tuple(a for a in some if _as_usual(a, largest)))
        for units in product(*choices):
            if not mixed or len({u for u, si in zip(units, kinds, strict=True) if si == "rad"}) > 1:
                yield units


def _as_usual(angle: str, largest: float) -> bool:
    """Whether a column whose largest number this is may be in a unit: degrees and gon always, the
    others where no unit between theirs and a degree would be as likely."""
    if angle in ("rad", "turn"):
        return unit(angle).factor * largest <= _MOST_TURNS
    return angle != "arcmin" or unit("deg").factor * largest > _MOST_TURNS

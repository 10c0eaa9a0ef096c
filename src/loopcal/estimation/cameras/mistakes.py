"""Mistakes in files of cameras: each tried as another reading of the same files.

A reading is preferred where it divides the reprojection by more than `CLEAR`, and only then: the
corrected reading goes on, and a fact says what was changed. What explains the corners equally well
is never changed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from loopcal.estimation.cameras.board_pose import BoardPoses
from loopcal.estimation.cameras.corners import Corners
from loopcal.estimation.cameras.facts import Fact
from loopcal.estimation.cameras.hand_changes import (
    CHANGES,
    INVERTED,
    QUATERNIONS,
    TRANSPOSED,
    UNITS,
    positions_in,
    quaternions_in,
)
from loopcal.estimation.cameras.homography import homographies, spread, transfer_errors
from loopcal.estimation.cameras.lens_changes import cut, exchanged, rectified, resized, turned
from loopcal.estimation.cameras.orders import (
    consistent_orders,
    mirrored,
    on_other_squares,
    renumbered,
)
from loopcal.estimation.cameras.placing import Reading, closed_forms, placed, view_poses
from loopcal.mechanisms.cameras.board import Board
from loopcal.mechanisms.placement import inverse
from loopcal.presentation.shown import significant

RESIZED, TURNED = "intrinsics-of-another-size", "intrinsics-turned"
"""Facts of images that are not in the format that the intrinsics are of."""
MIRRORS = ("uv-exchanged", "u-reversed", "v-reversed")
"""Facts of pixels in a mirror."""
MIRRORED = "pixels-mirrored"
"""Fact of pixels that several mistakes explain alike, with different places of the camera."""
CLEAR = 0.6
"""Twenty images of two residuals each: log likelihood ratio 40 ln(1 / 0.6) = 20."""
THINNED = (60, 12)
"""Images and corners per view of a trial: far more than a mistake needs to show."""
FITS = 1.3
"""If the robot adds less than this to what single images leave, nothing is suspected."""
PLANES = 20
"""Images of a trial of numberings, which shows in each of them."""
DRAWS = 2
"""Random starts of a trial: a wrong reading fails with all of them."""
HOPELESS = 40.0
"""Closed forms leave two to six times what the adjustment does; of few markers up to sixty."""
WITHOUT_DOUBT = 0.2
"""The same that ends a search: the images by themselves do not fit better."""
CLEAR_PLANE = 0.85
"""The same for homographies, which no error of the robot enters: 20 views of 12 corners have a log
likelihood ratio of 240 ln(1 / 0.85) = 39."""
NEAR_UNIT = 1.4
"""A ratio of lengths that near a unit's: a guessed focal length may be wrong by a third."""
LARGEST_BOARD = 5.0
"""Half a diagonal [m] above which a board was not stated in metres."""
SMALLEST_BOARD = 1e-3
"""Half a diagonal [m] below which a board was not stated in mm: no camera shows its corners."""
FAR, FARTHER = 0.5, 3.0
"""What sits on a flange is not that far [m] from it, and so many times as far as what stands beside
the robot is from its base."""
SIZES = (1 / 3, 0.5, 2 / 3, 0.75, 4 / 3, 1.5, 2.0, 3.0)
"""Widths of images over those that the intrinsics are of, as 1280 / 1920."""
FARTHEST_HAND = 20.0
"""Spread of positions [m] above which a hand was not stated in metres."""


@dataclass(frozen=True)
class Suspicion:
    """Another reading of the files, or None where it makes no sense for them.

    share: it leaves less than that of what the best one before it leaves; poses: how it changes
    those of the flange (`hand_changes`); values: numbers of its fact.
    """

    code: str
    sentence: str
    change: Callable[[Reading], Reading | None]
    share: float = 1.0
    poses: str = ""
    values: Mapping[str, float] = field(default_factory=dict)


def corrected(reading: Reading, held: bool | None) -> tuple[Reading, list[Fact]]:
    """The reading of the files that fits, and what had to be changed for it.

    held: whether the board is on the flange, None where that is to be found out. Of all suspicions
    the best one is taken, at most two in a row.
    """
    reading, facts = _better(reading, list(_planar_suspicions(reading)), plane_misfit)
    reading, more = _straight(reading)
    facts += more
    if reading.T_base_flange is None:
        reading, more = _believable(reading)
        facts += more
        sizes = [misfit(reading)]
    else:
        reading, more, sizes = _mounted(reading, held)
        facts += more
    before = min(sizes)
    for _ in range(2):
        enough = FITS * image_misfit(reading)
        if before < enough:
            break
        either = held is None and reading.T_base_flange is not None
        reading, more = _better(
            reading,
            list(_suspicions(reading, held)),
            before=before,
            enough=enough,
            mounts=(True, False) if either else (reading.held,),
        )
        if not more:
            break
        facts, sizes, before = [*facts, *more], [], float(more[0].values["px_after"])
    if reading.T_base_flange is not None and held is None:
        reading, fact = _mount(reading, sizes)
        facts.append(fact)
    return reading, facts


def misfit(reading: Reading, poses: BoardPoses | None = None, limit: float = np.inf) -> float:
    """Core rms [px] of a reading, thinned and adjusted shortly; inf where nothing fits.

    poses: of a reading that is thinned; limit: what is clearly above it need not be exact.
    """
    few = reading if poses is not None else reading.thinned(*THINNED)
    free = () if reading.stated else ("f", "k1")
    poses = view_poses(few) if poses is None else poses
    best = placed(few, poses, free, iterations=8, hopeless=HOPELESS * limit, draws=DRAWS)
    return np.inf if best is None else best.core


def patient_misfit(reading: Reading, poses: BoardPoses) -> float:
    """The same with as many iterations as it takes: what a suspicion has to beat."""
    free = () if reading.stated else ("f", "k1")
    best = placed(reading, poses, free, iterations=40)
    return np.inf if best is None else best.core


def image_misfit(reading: Reading) -> float:
    """Median over the views of the rms [px] that a free pose leaves, by its degrees of freedom."""
    few = reading.thinned(*THINNED)
    poses, views = view_poses(few), few.corners.views
    # Four corners of a plane fit always.
    full = poses.usable & (views.sizes >= min(6, int(views.sizes.max())))
    if not full.any():
        return np.inf
    f = np.array([lens.fx for lens in reading.lenses])[views.camera]
    freedom = 1.0 / np.sqrt(np.maximum(1.0 - 3.0 / views.sizes, 0.1))
    return float(np.median((poses.error[:, 0] * f * freedom)[full]))


def plane_misfit(reading: Reading, poses: BoardPoses | None = None, limit: float = 0.0) -> float:
    """Median over the views of planes of what homographies leave [px], by degrees of freedom.

    Of each view exp(mean log sqrt(r^2 + m^2)), m the median of the distances r but the four least,
    which fit always: a seventh of the corners far off doubles it, for numbers displaced by one are
    wrong at the ends of rows only.
    """
    corners = reading.corners
    flat = np.array([board.planar for board in corners.boards])[corners.board]
    corners = corners.where(flat)
    if not len(corners):
        return np.inf
    views, xy = corners.views, corners.xyz[:, :2]
    H, _ = homographies(views, xy, corners.uv)
    r = transfer_errors(views, H, xy, corners.uv)
    floor = views.medians(r, beyond=4)[views.of_corner] + 1e-9
    middle = np.exp(views.sums(0.5 * np.log(r**2 + floor**2)) / views.sizes)
    freedom = np.sqrt(np.maximum(1.0 - 4.0 / views.sizes, 0.0))
    rest = (middle / np.maximum(freedom, 1e-9))[(freedom > 0.0) & spread(views, xy)]
    return float(np.median(rest)) if rest.size else np.inf


def _better(
    reading: Reading,
    suspicions: list[Suspicion],
    size: Callable[[Reading, BoardPoses, float], float] = misfit,
    before: float = 0.0,
    enough: float = 0.0,
    mounts: tuple[bool, ...] = (),
) -> tuple[Reading, list[Fact]]:
    """The reading after the suspicion that is clearly better than all is, if one is.

    before: what is left now [px]; 0 to measure it. enough: what leaves no other suspicion to try.
    mounts: what the flange may hold, for each suspicion anew.
    """
    # Numbers that are displaced by one are wrong at the ends of rows, of which a few corners of a
    # view may have none.
    few = reading.thinned(*(THINNED if size is misfit else (PLANES, len(reading.corners))))
    mounts = mounts or (reading.held,)
    poses = view_poses(few)
    before = before or size(few, poses, np.inf)
    after, reason, held = (CLEAR if size is misfit else CLEAR_PLANE) * before, None, few.held
    for suspicion in suspicions:
        other = suspicion.change(few)
        if other is None:
            continue
        same = other.corners is few.corners and other.lenses is few.lenses
        needed = poses if same or size is not misfit else view_poses(other)
        for mount in mounts:
            value = size(replace(other, held=mount), needed, suspicion.share * after)
            if value < suspicion.share * after:
                after, reason, held = value, suspicion, mount
        if reason is not None and after < min(enough, WITHOUT_DOUBT * before):
            break
    if reason is not None and size is misfit and after > CLEAR * patient_misfit(few, poses):
        return reading, []
    best = None if reason is None else reason.change(reading)
    if best is None or reason is None:
        return reading, []
    values: dict[str, float | str] = {"px_before": before, "px_after": after, **reason.values}
    fact = Fact(reason.code, reason.sentence, values, applied=True, poses=reason.poses)
    return replace(best, held=held), [fact]


def _straight(reading: Reading) -> tuple[Reading, list[Fact]]:
    """The reading without the stated distortion, where single images fit clearly better so."""
    if not reading.stated or not any(any(lens.distortion) for lens in reading.lenses):
        return reading, []
    others = {
        "without the stated distortion": rectified(reading, by_P=False),
        "by the stated P, without distortion": rectified(reading, by_P=True),
    }
    left = {words: image_misfit(other) for words, other in others.items()}
    words = min(left, key=lambda one: left[one])
    before, px = image_misfit(reading), left[words]
    if not px < CLEAR * before:
        return reading, []
    sentence = (
        f"The images fit {words}, as rectified images do. State the lens of the images as they are."
    )
    values: dict[str, float | str] = {"px_before": before, "px_after": px}
    return others[words], [Fact("images-rectified", sentence, values, applied=True)]


def _planar_suspicions(reading: Reading) -> Iterator[Suspicion]:
    """Numberings that a single image of a plane shows."""
    for b, board in enumerate(reading.corners.boards):
        if board.planar:
            yield from _numberings(b, board)


def _suspicions(reading: Reading, held: bool | None) -> Iterator[Suspicion]:
    """All that shows in the images together."""
    if reading.T_base_flange is not None:
        yield from _hand_suspicions(held)
    yield from _exchanged_cameras(reading.corners.cameras)
    if reading.stated:
        yield from _lens_suspicions(reading.corners.cameras)
    for b, board in enumerate(reading.corners.boards):
        if not board.planar:
            yield from _numberings(b, board)
    if not all(board.planar for board in reading.corners.boards):
        yield Suspicion(
            "board-mirrored",
            "The points fit the board only as in a mirror. Check the signs of its points, "
            "and whether u and v are exchanged.",
            lambda one: replace(one, corners=mirrored(one.corners)),
        )


def _numberings(b: int, board: Board) -> Iterator[Suspicion]:
    for order in consistent_orders(board):
        yield Suspicion(
            "board-numbering",
            f"The points of the board {board.name!r} are numbered in another way: "
            f"{order.name}. Correct the board or its kind.",
            lambda one, order=order: replace(  # type: ignore[misc]
                one, corners=renumbered(one.corners, {b: order})
            ),
        )
    if (legacy := on_other_squares(board)) is not None:
        yield Suspicion(
            "board-legacy",
            f"The markers of the board {board.name!r} are on the other squares, as OpenCV before "
            "4.6 printed them. Correct the points of the board, or state legacy = true.",
            lambda one, legacy=legacy: replace(  # type: ignore[misc]
                one, corners=_with_board(one.corners, b, legacy)
            ),
        )


def _with_board(corners: Corners, b: int, board: Board) -> Corners:
    boards = [board if i == b else one for i, one in enumerate(corners.boards)]
    return replace(corners, boards=tuple(boards))


def _mounted(reading: Reading, held: bool | None) -> tuple[Reading, list[Fact], list[float]]:
    """The mount that fits, with the units of lengths, and what each mount leaves [px]."""
    mounts = [replace(reading, held=h) for h in ((True, False) if held is None else (held,))]
    tried = [_scale(one) for one in mounts]
    sizes = [misfit(one) for one, _ in tried]
    # Without a turn of the hand a mirror on one mount is the other mount without any.
    weighed = [
        size / (CLEAR if facts else 1.0) for size, (_, facts) in zip(sizes, tried, strict=True)
    ]
    best, facts = tried[weighed.index(min(weighed))]
    return best, facts, sizes


def mounted_misfit(reading: Reading) -> float:
    """What the better mount leaves [px]; what needs another unit or a mirror has to be clearly
    better."""
    _, facts, sizes = _mounted(reading, None)
    return min(sizes) / (CLEAR if facts else 1.0)


def _mount(reading: Reading, misfits: list[float]) -> tuple[Reading, Fact]:
    """The reading with what is likelier on the flange, where two are the same equations."""
    things = ("board", "camera") if reading.held else ("camera", "board")
    clear = len(misfits) < 2 or min(misfits) < CLEAR * max(misfits)
    away, poses = _away(reading) if clear else (0.0, 0.0), ""
    if away[0] > max(FAR, FARTHER * away[1]):
        assert reading.T_base_flange is not None
        far, near = (f"{significant(one, 2)} m" for one in away)
        words = (
            f"The images fit if the {things[1]} is on the flange and the poses are inverted (base "
            f"in the flange), which is taken to be so. As they stand, the {things[0]} would sit "
            f"{far} from the flange, and the {things[1]} {near} from the base."
        )
        T, poses = inverse(reading.T_base_flange), INVERTED
        reading = replace(reading, T_base_flange=T, held=not reading.held)
    else:
        doubt = (
            f"If the {things[1]} is on the flange, the poses are inverted (base in the flange)."
            if clear
            else f"The {things[1]} on the flange fits as well. Take images in which the hand is "
            "turned by 30 deg about two axes: they decide it."
        )
        words = f"The images fit if the {things[0]} is on the flange. {doubt}"
    values: dict[str, float | str] = {"held": "board" if reading.held else "camera"}
    if misfits:
        values |= {"px": min(misfits), "px_other": max(misfits)}
    return reading, Fact("mount", words, values, applied=True, poses=poses)


def _away(reading: Reading) -> tuple[float, float]:
    """Distances [m]: of what is taken to be on the flange from it, of the other from the base."""
    few = reading.thinned(*THINNED)
    free = () if reading.stated else ("f", "k1")
    best = placed(few, view_poses(few), free, iterations=8, draws=DRAWS)
    if best is None:
        return 0.0, 0.0
    X, Y = (float(np.linalg.norm(T[0, :3, 3])) for T in (best.scene.X, best.scene.Y))
    return (Y, X) if reading.held else (X, Y)


def _scale(reading: Reading) -> tuple[Reading, list[Fact]]:
    """Units and mirrors, by the ratio of the robot's lengths to the board's."""
    few = reading.thinned(60, 24)
    poses = view_poses(few)
    if not poses.usable.any():
        return reading, []
    scales = [candidate.scale for _, _, candidate in closed_forms(few, poses, DRAWS, scaled=True)]
    best, facts, value = reading, list[Fact](), 0.0
    for unit, factor, mirror in sorted(set(filter(None, map(_readable, scales)))):
        other, more = (reading, []) if factor == 1.0 else _in_unit(reading, factor, unit)
        if mirror:
            other, more = _unmirrored(other, more)
        value = value or CLEAR * misfit(reading)
        if (px := misfit(other, limit=value)) < value:
            best, facts, value = other, more, px
    return best, facts


def _readable(scale: float) -> tuple[str, float, bool] | None:
    """The unit, its factor and whether there is a mirror, of a scale that one of both explains."""
    for factor, unit in [(1.0, "m"), *UNITS.items(), *((1.0 / k, u) for k, u in UNITS.items())]:
        if 1.0 / NEAR_UNIT < abs(scale) * factor < NEAR_UNIT and (factor != 1.0 or scale < 0.0):
            return unit, factor, scale < 0.0
    return None


def _in_unit(reading: Reading, factor: float, unit: str) -> tuple[Reading, list[Fact]]:
    """Lengths of the hand divided by the factor, or those of the board multiplied."""
    assert reading.T_base_flange is not None
    T, corners = reading.T_base_flange.copy(), reading.corners
    reach = float(np.linalg.norm(np.ptp(T[:, :3, 3], axis=0)))
    size = max(float(np.linalg.norm(board.half)) for board in corners.boards)
    values: dict[str, float | str] = {"factor": factor, "unit": unit}
    large = factor > 1.0
    if reach > FARTHEST_HAND if large else size < LARGEST_BOARD:
        T[:, :3, 3] /= factor
        way = f"are in {unit}" if large else f"are in metres, and were converted from {unit}"
        fact = Fact(
            "unit-of-poses",
            f"The positions of the flange {way}. State their unit.",
            values,
            applied=True,
            poses=positions_in(unit, converted=not large),
        )
        return replace(reading, T_base_flange=T), [fact]
    way = f"are in metres, and were converted from {unit}" if large else f"are in {unit}"
    fact = Fact(
        "unit-of-board", f"The points of the board {way}. State their unit.", values, applied=True
    )
    return _resized_boards(reading, factor), [fact]


def _believable(reading: Reading) -> tuple[Reading, list[Fact]]:
    """Boards of a size that boards have; without a robot nothing else says how large they are."""
    size = max(float(np.linalg.norm(board.half)) for board in reading.corners.boards)
    if SMALLEST_BOARD < size < LARGEST_BOARD:
        return reading, []
    factor = 1e-3 if size > SMALLEST_BOARD else 1e3
    way = "in mm" if factor < 1.0 else "in metres, not in mm"
    sentence = f"A board would be {2.0 * size:.3g} m large: its points are taken {way}. "
    values: dict[str, float | str] = {"factor": factor}
    fact = Fact("unit-of-board", f"{sentence}State their unit.", values, applied=True)
    return _resized_boards(reading, factor), [fact]


def _resized_boards(reading: Reading, factor: float) -> Reading:
    boards = tuple(
        replace(
            b, points={k: (x * factor, y * factor, z * factor) for k, (x, y, z) in b.points.items()}
        )
        for b in reading.corners.boards
    )
    return replace(reading, corners=replace(reading.corners, boards=boards))


def _unmirrored(reading: Reading, facts: list[Fact]) -> tuple[Reading, list[Fact]]:
    """u and v exchanged, or one reversed, whichever the lens and the image's size allow."""
    choices = [
        ("uv-exchanged", "Columns u and v are exchanged. Correct them.", _exchanged(reading))
    ]
    sized = all(lens.image is not None for lens in reading.lenses)
    if sized:
        upwards = "v counts upwards, from the bottom of the image, as if it were mirrored."
        sideways = "Images are mirrored: u runs from right to left."
        choices += [
            ("v-reversed", f"{upwards} Correct the column.", _reversed(reading, 1)),
            ("u-reversed", f"{sideways} Correct the column.", _reversed(reading, 0)),
        ]
    choices += [
        (one.code, one.sentence, other)
        for one in _exchanged_cameras(reading.corners.cameras)
        if (other := one.change(reading)) is not None
    ]
    measured = [(misfit(other), i) for i, (_, _, other) in enumerate(choices)]
    px, i = min(measured)
    reverses = choices[i][0] in MIRRORS[1:]
    if reverses and px > CLEAR * measured[0][0] and _inside(choices[0][2]):
        i = 0
    code, sentence, other = choices[i]
    if i == 0 and not reading.stated and not sized and _wide(reading):
        code = MIRRORED
    fact = Fact(code, sentence, {"px_after": px}, applied=True)
    return other, [*facts, fact]


def _wide(reading: Reading) -> bool:
    """Whether corners as they stand reach farther in u than in v, as in images that lie: with u and
    v exchanged these would stand."""
    return bool(np.greater(*reading.corners.uv.max(axis=0)))


def _exchanged(reading: Reading, camera: int | None = None) -> Reading:
    """u and v exchanged of one camera, or of all."""
    corners, mine = reading.corners, (camera is None) | (reading.corners.camera == camera)
    lenses = tuple(
        # A principal point guessed from the corners is exchanged with them.
        replace(one, cx=one.cy, cy=one.cx)
        if not reading.stated and one.image is None and camera in (None, c)
        else one
        for c, one in enumerate(reading.lenses)
    )
    uv = np.where(np.reshape(mine, (-1, 1)), corners.uv[:, ::-1], corners.uv)
    return replace(reading, corners=corners.at(uv), lenses=lenses)


def _reversed(reading: Reading, axis: int) -> Reading:
    uv = reading.corners.uv.copy()
    size = np.array([(lens.image or (0, 0))[axis] for lens in reading.lenses], dtype=float)
    uv[:, axis] = size[reading.corners.camera] - 1.0 - uv[:, axis]
    return replace(reading, corners=reading.corners.at(uv))


def _inside(reading: Reading) -> bool:
    """Whether all corners are in their images, as far as the sizes are stated."""
    for c, lens in enumerate(reading.lenses):
        uv = reading.corners.uv[reading.corners.camera == c]
        if lens.image is not None and (uv.max(axis=0) > np.array(lens.image)).any():
            return False
    return True


def _hand_suspicions(held: bool | None) -> Iterator[Suspicion]:
    if held is not None:
        where = "board" if held else "camera"
        yield _read_as(
            "poses-inverted",
            "The poses fit as the base in the flange, the inverse of the flange in the base. "
            f"Invert them, or check whether the {where} really is on the flange.",
            INVERTED,
        )
    yield _read_as(
        "rotations-transposed",
        "The rotations of the poses fit only when transposed. Check the order of their elements.",
        TRANSPOSED,
    )
    for name in QUATERNIONS:
        yield _read_as(
            "quaternion-order",
            f"The quaternions fit in the order {name}, not in the order that was read.",
            quaternions_in(name),
        )
    for shift in (1, -1, 2, -2):
        where = "later" if shift > 0 else "earlier"
        rows = "one row" if abs(shift) == 1 else f"{abs(shift)} rows"
        yield Suspicion(
            "poses-shifted",
            f"Each image fits the pose that stands {rows} {where}, which is used. Check which pose "
            "belongs to which image.",
            lambda one, shift=shift: _shifted(one, shift),  # type: ignore[misc]
        )


def _read_as(code: str, sentence: str, word: str) -> Suspicion:
    """Poses of the flange changed as this word says."""

    def change(reading: Reading) -> Reading:
        assert reading.T_base_flange is not None
        return replace(reading, T_base_flange=CHANGES[word](reading.T_base_flange))

    return Suspicion(code, sentence, change, poses=word)


def _shifted(reading: Reading, shift: int) -> Reading | None:
    assert reading.T_base_flange is not None
    T, n = reading.T_base_flange, len(reading.T_base_flange)
    if n < 4 + abs(shift):
        return None
    row = np.arange(n) + shift
    inside = (row >= 0) & (row < n)
    corners = reading.corners.where(inside[reading.corners.image])
    return replace(reading, corners=corners, T_base_flange=T[np.clip(row, 0, n - 1)])


def _exchanged_cameras(cameras: tuple[str, ...]) -> Iterator[Suspicion]:
    """Of several cameras the columns of one."""
    for c, camera in enumerate(cameras) if len(cameras) > 1 else ():
        yield Suspicion(
            "uv-exchanged",
            f"Columns u and v of the camera {camera!r} are exchanged. Correct them.",
            lambda one, c=c: _exchanged(one, c),  # type: ignore[misc]
        )


def _lens_suspicions(cameras: tuple[str, ...]) -> Iterator[Suspicion]:
    for a, b in combinations(range(len(cameras)), 2):
        yield Suspicion(
            "cameras-exchanged",
            f"The stated intrinsics of the cameras {cameras[a]!r} and {cameras[b]!r} are "
            "exchanged. Exchange them.",
            lambda one, a=a, b=b: exchanged(one, a, b),  # type: ignore[misc]
        )
    for turn in ("exchanged", "clockwise", "counterclockwise", "half"):
        angle = 180.0 if turn == "half" else 90.0
        yield Suspicion(
            TURNED,
            f"The stated intrinsics fit images turned by {angle:g} degrees. State them for the "
            "images as they are: the principal point moves.",
            lambda one, turn=turn: turned(one, turn),  # type: ignore[misc]
            values={"degrees": angle},
        )
    for factor in SIZES:
        yield Suspicion(
            RESIZED,
            f"The stated intrinsics fit images of {1.0 / factor:.4g} times this size: multiply "
            f"f and c by {factor:.4g}.",
            lambda one, factor=factor: resized(one, factor),  # type: ignore[misc]
            values={"factor": factor},
        )
    yield Suspicion(
        "principal-point",
        "The images fit with another principal point than the stated one, as images do that were "
        "cut. State the intrinsics and the size of the images as they are.",
        cut,
        CLEAR,  # a free point fits as well as each of those before
    )

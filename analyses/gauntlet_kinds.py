"""The kinds of day of the gauntlet: clean ones and one for each fault of the field, on a first day
that is calibrated and on a later one that is verified.

names: what an answer must speak of to have named the fault, a regular expression over codes and
words; where it is empty, a parameter of what was planted. `analyses.gauntlet` prints how often
clean answers match it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from analyses import gauntlet_days as days
from analyses.gauntlet_cameras import KINDS as PHOTOGRAPHED
from analyses.gauntlet_cameras import Photographed
from analyses.gauntlet_days import Event
from analyses.gauntlet_truth import Arm
from analyses.lives_parallel import relinked
from analyses.lives_truth import DEGREE, DRAWINGS, FLEET, Machine, machine

ARMS = 12
"""Of the fleet: arms measured from one place with one load."""
ALONG = r"drift|warm|temperature|over the (whole )?run|pose order|serial"
LOAD_ONLY = r"payload|\bload|weight|heavier"
LOAD = LOAD_ONLY + "|gravity"
ROWS, COPIES = r"\brows?\b", r"cop(y|ies|ied)|duplicat|same row|repeated row|twice"
UNIT, SIGN = r"\bunits?\b(?! and orders)|\binch|25\.4|\bin in\b", r"\bsign|revers|other way"
EXCHANGED, HANDED = "exchang|swap", "exchang|swap|handed|mirror|revers"
SCALE, OFF = r"scale|expan|temperature", "outlier|not fit"
TOOL, SLIP = r"\btool|target|reflector|mount(ed|ing)", r"slip|from pose|since pose"
NEAR = r"near-poses-only|near the measured poses|outside"
DRAWING = r"off the drawing|(off|from) (its|the) (nominal|drawing)|does not describe"


@dataclass(frozen=True)
class Kind:
    """A kind of day.

    later: whether it is verified, by the calibration of a clean first day, or calibrated itself;
    clean: nothing is wrong; names: see above, None where the fault has no name; event: before the
    measurement; tamper: afterwards, in the file; fixed: of the machine (`lives_truth.machine`);
    misled: what the user takes for the machine; happens: to which machines; column: whether the
    name of the column belongs to it; placed: what happened concerns the instrument alone, so
    predictions are placed on the truth first; cell: what separates cells.
    """

    name: str
    later: bool = False
    clean: bool = False
    names: str | None = None
    event: Event | None = None
    tamper: Event | None = None
    fixed: Mapping[str, Any] = field(default_factory=dict)
    misled: Callable[[Machine], Machine] = lambda user: user
    happens: Callable[[Machine], bool] = lambda user: True
    column: bool = False
    placed: bool = False
    photographed: Photographed | None = None
    cell: str = ","

    def machine(self, draw: int) -> Machine:
        """Whose day it is."""
        fleet = FLEET if self.later else ARMS
        return self.misled(machine(draw, **{"fleet": fleet, **self.fixed}))


def _clean(name: str, **fixed: Any) -> Kind:
    return Kind(name, clean=True, fixed=fixed)


def _fault(name: str, names: str | None, event: Event | None = None, **rest: Any) -> Kind:
    """Of the first day."""
    fixed = rest.pop("fixed", {})
    return Kind(name, names=names, event=event, fixed=fixed, **rest)


def _file(name: str, names: str, tamper: Event, **fixed: Any) -> Kind:
    return Kind(name, names=names, tamper=tamper, fixed=fixed)


def _later(name: str, names: str | None, event: Event | None = None, **rest: Any) -> Kind:
    return Kind(name, later=True, names=names, event=event, **rest)


def _long_link(user: Machine) -> Machine:
    assert isinstance(user.drawing, Arm)
    return replace(user, drawing=relinked(user.drawing, 2, a=0.05))


def _another_robot(user: Machine) -> Machine:
    return replace(user, drawing=DRAWINGS["irb"])


_SIX: dict[str, Any] = {"family": "six", "wear": "rigid"}
_DRIFT = days.drifting(2e-4, 3e-4)
CLEAN = (
    Kind("the fleet", clean=True, fixed={"fleet": FLEET}),
    _clean("six axes, random order", **_SIX, order="random"),
    _clean("six axes, sorted", **_SIX, order="sorted"),
    _clean("six axes, raster", **_SIX, order="raster"),
    _clean("six axes, 20 poses", **_SIX, poses=20),
    _clean("six axes, 30 poses", **_SIX, poses=30),
    _clean("six axes, 150 poses", **_SIX, poses=150),
    _clean("small arm, sagging", family="irb", wear="sagging"),
    _clean("UR, sagging, sorted", family="ur", wear="sagging", order="sorted"),
    _clean("gears", family="six", wear="sagging with gears"),
    _clean("backlash", family="ur", wear="sagging with backlash"),
    _clean("seven axes", family="seven", wear="rigid"),
    _clean("SCARA", family="scara", wear="rigid", order="random"),
    _clean("palletiser", family="palletiser", described="urdf", wear="sagging"),
    _clean("rotary delta", family="delta", described="project", wear="rigid"),
    _clean("three reflectors", family="six", instrument="three reflectors", poses=40),
    _clean("camera", family="six", wear="rigid", instrument="camera", tracker=2e-4, poses=60),
    _clean("two stations", family="six", stations=2),
    _clean("column of loads", family="ur", wear="sagging", loaded=True),
    _clean("headers without units", family="irb", wear="rigid", plain=True),
    _clean("small region", **_SIX, described="urdf", share=0.3),
    _clean("small region, sagging", family="irb", wear="sagging", described="urdf", share=0.3),
)
FIRST = (
    _file("points in inches", UNIT, days.in_inches(0.0)),
    _file("half of the rows in inches", UNIT, days.in_inches(0.5)),
    _file("a column in inches", UNIT, days.a_column_in_inches),
    _file("radians called degrees", UNIT, days.other_angles(DEGREE)),
    _file("gon called degrees", r"\bgon\b", days.other_angles(200 / 180)),
    _file("a joint reversed", SIGN, days.reversed_joints(1)),
    _file("three joints reversed", SIGN, days.reversed_joints(3)),
    _file("two joints exchanged", EXCHANGED, days.joints_exchanged),
    _file("x and y exchanged", HANDED, days.axes_exchanged),
    _file("left-handed frame", HANDED, days.left_handed),
    _file("quaternion, w first", "quaternion", days.quaternion_rolled, instrument="camera"),
    _file("points one row late", ROWS, days.rows_shifted),
    _file("points shuffled", ROWS + "|belong", days.shuffled),
    _file("joints read late", r"\bmoment\b", days.read_late(5e-3), order="random"),
    _file("rows copied", COPIES, days.copied),
    _file("a constant column", "constant|same value|never changes", days.constant_column),
    _file("a pose off by 20 mm", OFF, days.poses_off(0.0, 0.02)),
    _file("a quarter of the poses bad", OFF, days.poses_off(0.25, 1e-3)),
    _fault(
        "a length 50 mm off",
        r"\ba_2\b[^.]*\boff\b|" + DRAWING,
        misled=_long_link,
        fixed={"described": "dh"},
    ),
    _fault("another robot", DRAWING, misled=_another_robot, fixed=_SIX | {"described": "dh"}),
    _fault("joints in steps of 0.1 degree", "coarse|in steps of", fixed={"rounded": 0.1 * DEGREE}),
    _fault("12 poses", f"few|more poses|{NEAR}", fixed={"poses": 12}),
    _fault("sds 3 times too small", "stated sd|chi-squared|sds", fixed={"stated": 1 / 3}),
    _fault("sds 3 times too large", "stated sd|chi-squared|sds", fixed={"stated": 3.0}),
    _fault("sds 1,000 times too large", "stated sd|chi-squared|sds", fixed={"stated": 1e3}),
    _fault("reflector slips", SLIP, days.slipped),
    _fault("tracker moves", SLIP, days.moved_station, placed=True),
    _fault("zero moves", "", days.within_the_run(days.moved_zero)),
    _fault("link bends", "", days.within_the_run(days.bent_link)),
    _fault(
        "payload added", LOAD_ONLY, days.within_the_run(days.heavier), fixed={"wear": "sagging"}
    ),
    _fault("loads unrecorded", LOAD_ONLY, days.unrecorded_loads, fixed={"wear": "sagging"}),
    _fault("loose flange", None, days.loose_flange),
    _fault("drift, random order", ALONG, _DRIFT, placed=True, fixed={"order": "random"}),
    _fault("drift, sorted", ALONG, _DRIFT, placed=True, fixed={"order": "sorted"}),
    _fault("drift, raster", ALONG, _DRIFT, placed=True, fixed={"order": "raster"}),
    _fault(
        "drift, sorted, 5 repeats",
        ALONG,
        _DRIFT,
        placed=True,
        fixed={"order": "sorted", "repeats": 5},
    ),
    _fault("warming machine", f"{ALONG}|{SCALE}", days.warm_machine, fixed={"order": "random"}),
    _fault(
        "warming, column of temperatures",
        f"{ALONG}|{SCALE}",
        days.warm_machine,
        fixed={"order": "random", "thermometer": True},
    ),
    _fault("two stations of unlike scale", "scale|ppm", days.another_scale, fixed={"stations": 2}),
)
LATER = (
    Kind("another day", later=True, clean=True),
    Kind("another day, semicolons", later=True, clean=True, cell=";"),
    _later("day 2: zero", "", days.moved_zero),
    _later("day 2: tool", TOOL, days.another_tool, happens=lambda m: m.turns),
    _later("day 2: slip", SLIP, days.slipped),
    _later("day 2: drift", ALONG, days.drifting(1e-4, 2e-4)),
    _later("day 2: payload", LOAD, days.heavier, happens=lambda m: m.sags),
    _later("day 2: bend", "", days.bent_link),
    _later("day 2: warm machine", rf"{ALONG}|{SCALE}", days.warm_machine),
    _later("day 2: another scale", rf"{SCALE}|ppm", days.another_scale),
    _later("day 2: loose flange", None, days.loose_flange),
    _later("day 2: rows shifted", ROWS, tamper=days.rows_shifted),
    _later("day 2: one pose off", "pose", tamper=days.poses_off(0.0, 0.02)),
    _later("day 2: copied rows", COPIES, tamper=days.copied),
    _later("day 2: unit", UNIT, tamper=days.a_column_in_inches, column=True),
    _later(
        "day 2: sign",
        SIGN,
        tamper=days.reversed_joints(1),
        column=True,
    ),
)
IMAGES = tuple(
    Kind(name, clean=names is None, names=names, photographed=photographed)
    for name, (photographed, names) in PHOTOGRAPHED.items()
)
KINDS = {kind.name: kind for kind in (*CLEAN, *FIRST, *LATER, *IMAGES)}

"""A calibrated robot in its user's own URDF: attribute values replaced, all other bytes kept.

Of the joints calibrated the `xyz` and `rpy` of their origins are replaced where they changed, the
numbers within them where these changed (and `xyz` of an axis that was calibrated). An origin or an
attribute that is not there is inserted where it belongs. Values are the shortest decimals that read
back to the same double; of equivalent rpy the triple nearest to the old one is written.

XML as its author wrote it: where start tags and attribute values stand in the text.

A parser says what a file means, and forgets how it was written. Here attribute values are found in
the text itself, so that single ones can be replaced and everything else stays byte for byte. The
text is known to be well-formed, without a document type (`safe_xml`).
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from loopcal.companions.robot.exports.cameras import camera_origins
from loopcal.companions.robot.exports.format import ExportFiles, ExportOptions, Format
from loopcal.companions.robot.programs.program import Place, Span, replaced
from loopcal.document.exported import Exported
from loopcal.errors import InputError, nearest
from loopcal.files.machines.safe_xml import children, content_of, read_xml
from loopcal.files.machines.urdf import NO_URDF, UrdfRobot
from loopcal.files.toml.reader import shown
from loopcal.mechanisms.origins import CalibratedOrigin, LinkJoint
from loopcal.mechanisms.rest import roll_pitch_yaw, rotation

# 1 nm and 1 nrad: below what a calibration changes, above what writing decimals rounds.
_SAME = 1e-9
"""[m, rad] by which the file's robot may differ from the one calibrated."""
# A few units in the last place of entries up to 1 (2.2e-16).
_ROUNDED = 1e-15
"""By which rotations differ that are one: what the decimals of rpy leave."""


@dataclass(frozen=True)
class Patched:
    """content: the new file; changed: joints whose elements were changed; warnings."""

    content: bytes
    changed: tuple[str, ...]
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class UrdfSource:
    """A URDF that was read once: its text, where its tags stand, and the robot in it."""

    text: XmlText
    tags: Mapping[Any, StartTag]
    robot: UrdfRobot

    @classmethod
    def of(cls, path: str | Path) -> UrdfSource:
        """Raises InputError with file and line if the file is no URDF."""
        root, place = read_xml(path, "robot", NO_URDF), shown(path)
        text = XmlText.of(content_of(path), root.getroottree().docinfo.encoding, place)
        elements = (element for element in root.iter() if isinstance(element.tag, str))
        tags = dict(zip(elements, text.tags(), strict=True))
        return cls(text, tags, UrdfRobot.of(root, place))

    def patched(self, origins: Sequence[CalibratedOrigin]) -> Patched:
        """With calibrated origins.

        Raises InputError for those of another robot: a joint is absent, or its origin is neither
        the drawing's nor the new one.
        """
        place, joints = self.robot.file, self.robot.joints
        edits: list[Place] = []
        changed: list[str] = []
        rising: list[str] = []
        for one in origins:
            name = one.joint.name
            if name not in joints:
                raise InputError(
                    f"the robot has no joint {name!r}, which was calibrated",
                    code="unknown-name",
                    place=place,
                    remedy=f"name the URDF that was calibrated; {nearest(name, joints)}",
                )
            # Joints off the chain may be of a kind that cannot be calibrated.
            element = joints[name]
            joint = self.robot.joint(element)
            _check_same(one, joint, place)
            joint_edits = _edits(one, joint, element, self.tags)
            edits += joint_edits
            changed += [name] * bool(joint_edits)
            rising += [name] * bool(children(element, "calibration"))
        return Patched(self.text.edited(edits), tuple(changed), _warnings(rising))


def _warnings(rising: list[str]) -> tuple[str, ...]:
    if not rising:
        return ()
    joints = ", ".join(map(repr, rising))
    return (
        f"The URDF has <calibration> at {joints}. It was left as it is: it names a reference "
        "position of the encoder, and forward kinematics ignore it.",
    )


def _check_same(one: CalibratedOrigin, joint: LinkJoint, place: str) -> None:
    """Raise InputError for a joint that is neither as drawn nor as exported."""
    # Limits are no part of the geometry; the origin is compared below, with a tolerance.
    drawn = replace(joint, xyz=one.joint.xyz, rpy=one.joint.rpy, limits=one.joint.limits)
    new_axis = replace(drawn, axis=one.joint.axis)
    if new_axis != one.joint:
        words = "its kind, axis or mimic is not the one calibrated"
    elif np.abs(np.subtract(joint.axis, one.joint.axis)).max() > _SAME and (
        np.abs(np.subtract(joint.axis, one.axis)).max() > _SAME
    ):
        words = "its axis is not the one calibrated"
    else:
        T = CalibratedOrigin(joint, one.T, one.axis).drawn
        # The calibrated origin is accepted too, so that a file can be exported again.
        if min(np.abs(T - one.drawn).max(), np.abs(T - one.T).max()) <= _SAME:
            return
        words = "its origin is neither the nominal nor the calibrated one"
    raise InputError(
        f"the joint {joint.name!r} is of another robot: {words}",
        code="conflicting-keys",
        place=place,
        remedy="name the URDF that the calibration began with, or calibrate with this one",
    )


def _edits(
    one: CalibratedOrigin, joint: LinkJoint, element: Any, tags: Mapping[Any, StartTag]
) -> list[Place]:
    """What changes in a joint."""
    attributes: dict[str, str] = {}
    origin = next(iter(children(element, "origin")), None)
    old = "" if origin is None else origin.get("xyz", "")
    if (xyz := tuple(map(float, one.T[:3, 3]))) != joint.xyz:
        attributes["xyz"] = numbers(xyz, joint.xyz, old)
    R_file = _rotation(joint.rpy)
    if np.abs(R_file - one.T[:3, :3]).max() > _ROUNDED:
        old = "" if origin is None else origin.get("rpy", "")
        attributes["rpy"] = numbers(roll_pitch_yaw(one.T[:3, :3], joint.rpy), joint.rpy, old)
    edits = _written(attributes, "origin", origin, tags[element], tags)
    if one.axis != one.joint.axis and one.axis != joint.axis:
        axis = next(iter(children(element, "axis")), None)
        edits += _written({"xyz": numbers(one.axis)}, "axis", axis, tags[element], tags)
    return edits


def _rotation(rpy: Sequence[float]) -> Any:
    """Rz(yaw) Ry(pitch) Rx(roll)."""
    roll, pitch, yaw = (rotation(a, v) for a, v in zip(np.eye(3).tolist(), rpy, strict=True))
    return yaw @ pitch @ roll


def _written(
    attributes: dict[str, str],
    tag: str,
    element: Any,
    parent: StartTag,
    tags: Mapping[Any, StartTag],
) -> list[Place]:
    """The edits that give an element, which may not be there, these attributes."""
    if not attributes:
        return []
    if element is None:
        prefix = parent.tag.rpartition(":")[0]
        name = f"{prefix}:{tag}" if prefix else tag
        words = "".join(f' {key}="{value}"' for key, value in attributes.items())
        return [Place(Span(parent.after, parent.after), f"<{name}{words}/>")]
    start_tag = tags[element]
    edits = []
    for key, value in attributes.items():
        if key in start_tag.values:
            edits.append(Place(start_tag.values[key], value))
        else:
            edits.append(Place(Span(start_tag.end, start_tag.end), f' {key}="{value}"'))
    return edits


def numbers(values: Iterable[float], old: Sequence[float] | None = None, written: str = "") -> str:
    """The shortest decimals that read back to the same doubles.

    old, written: values that stood there and their text, which is kept of those that are the same.
    """
    words = written.split()
    if old is None or len(words) != len(old):
        return " ".join(map(decimal, values))
    kept = zip(values, old, words, strict=True)
    return " ".join(word if value == before else decimal(value) for value, before, word in kept)


def decimal(value: float) -> str:
    """The shortest decimal of a double: 0.1, 0, 1e-05.

    >>> decimal(0.1), decimal(-0.0), decimal(2.0)
    ('0.1', '0', '2')
    """
    # repr gives the shortest digits that read back exactly; adding 0.0 makes 0.0 of -0.0.
    text = repr(float(value) + 0.0)
    return text.removesuffix(".0")


def urdf(exported: Exported, options: ExportOptions) -> ExportFiles:
    """The user's URDF patched, and offsets.csv where zero offsets stand apart; of several robots
    that are described by this file one file each."""
    path = options.source
    assert path is not None
    source = UrdfSource.of(path)
    robots = by_prefix(exported.origins, source.robot.joints)
    files: dict[str, str | bytes] = {}
    warnings: list[str] = []
    for prefix, origins in robots.items():
        hung = camera_origins(source.robot, replace(exported, origins=origins))
        done = source.patched((*origins, *hung.origins))
        files[f"{prefix if len(robots) > 1 else ''}{path.name}"] = done.content
        warnings += [*done.warnings, *hung.warnings]
    left = len(exported.origins) - sum(map(len, robots.values()))
    if left:
        which = " and ".join(map(repr, robots))
        warnings.append(
            f"Written is the robot whose joints begin with {which}. Other origins ({left}) are not "
            "in this file: export other robots by their --source; mechanism.toml says where robots "
            "stand."
        )
    return ExportFiles(files | offsets(exported), tuple(warnings))


def by_prefix(
    origins: Sequence[CalibratedOrigin], joints: Collection[str]
) -> dict[str, tuple[CalibratedOrigin, ...]]:
    """The origins that are in a file with these joints, named as there, by the prefix that tells
    its robot from others; all of them without a prefix where none is in it by that."""
    names = [one.joint.name for one in origins]
    prefixes = dict.fromkeys(
        name.removesuffix(joint) for name in names for joint in joints if name.endswith(joint)
    )
    robots = {
        p: tuple(one for one in origins if _bare(one.joint.name, p) in joints) for p in prefixes
    }
    most = max(map(len, robots.values()), default=0)
    if not most or "" in robots:
        return {"": tuple(origins)}
    return {
        prefix: tuple(replace(one, joint=_without(one.joint, prefix)) for one in mine)
        for prefix, mine in robots.items()
        if len(mine) == most
    }


def _bare(name: str, prefix: str) -> str:
    """The name behind a prefix; empty where it has another one."""
    return name.removeprefix(prefix) if name.startswith(prefix) else ""


def _without(joint: LinkJoint, prefix: str) -> LinkJoint:
    mimic = joint.mimic and replace(joint.mimic, joint=joint.mimic.joint.removeprefix(prefix))
    return replace(joint, name=joint.name.removeprefix(prefix), mimic=mimic)


def offsets(exported: Exported) -> dict[str, bytes]:
    """offsets.csv: what the controller adds to each joint's reading; none where origins hold it."""
    rows = [
        f"{one.joint.name},{'m' if one.joint.kind == 'prismatic' else 'rad'},{decimal(one.offset)}"
        for one in exported.origins
        if one.offset != 0.0
    ]
    if not rows:
        return {}
    return {"offsets.csv": "\n".join(["joint,unit,offset", *rows, ""]).encode()}


FORMATS = (
    Format(
        "urdf",
        "your own URDF, patched in place",
        "ROS, Drake, Isaac, any program that loads your URDF",
        "load the new file",
        urdf,
        "origins",
        "the URDF calibrated",
        described=True,
        options=("offsets",),
    ),
)


# Comments and CDATA come first: what looks like a tag inside them is none.
_TOKEN = re.compile(
    r"<!--.*?-->|<!\[CDATA\[.*?\]\]>|<\?.*?\?>|</[^>]*>"
    r"|<(?P<tag>[^\s/>!?]+)(?P<inside>(?:[^\"'>]|\"[^\"]*\"|'[^']*')*)>",
    re.DOTALL,
)
_ATTRIBUTE = re.compile(r"([^\s=/]+)\s*=\s*(?:\"([^\"]*)\"|'([^']*)')", re.DOTALL)
# UTF-32 first: its little-endian mark begins with that of UTF-16.
_MARKS = (
    (codecs.BOM_UTF32_LE, "utf-32-le"),
    (codecs.BOM_UTF32_BE, "utf-32-be"),
    (codecs.BOM_UTF16_LE, "utf-16-le"),
    (codecs.BOM_UTF16_BE, "utf-16-be"),
)


@dataclass(frozen=True)
class StartTag:
    """A start tag in a text: its tag as written, and where its parts stand.

    end: behind the tag and its blanks and attributes, ahead of "/>" or ">"; after: behind ">";
    values: attribute as written -> its value, without the quotes.
    """

    tag: str
    end: int
    after: int
    values: Mapping[str, Span]


@dataclass(frozen=True)
class XmlText:
    """The text of a file and the codec that makes its bytes again."""

    text: str
    codec: str

    @classmethod
    def of(cls, content: bytes, encoding: str | None, place: str) -> XmlText:
        """The text of a file; encoding: as its parser found it.

        Raises InputError where the bytes do not come back the same.
        """
        mark = next((codec for bytes_, codec in _MARKS if content.startswith(bytes_)), None)
        codec = mark or encoding or "utf-8"
        try:
            text = content.decode(codec)
            same = text.encode(codec) == content
        except (LookupError, UnicodeError):
            same = False
        if not same:
            raise InputError(
                f"the bytes of this file are not its text in {codec}, so that it cannot be patched "
                "in place",
                code="invalid-syntax",
                place=place,
                remedy="save it as UTF-8 and export again",
            )
        return cls(text, codec)

    def tags(self) -> Iterator[StartTag]:
        """Its start tags, in the order of the elements."""
        for match in _TOKEN.finditer(self.text):
            if match["tag"] is None:
                continue
            inside, begin = match["inside"], match.start("inside")
            end = begin + len(inside.removesuffix("/").rstrip())
            values = {
                a[1]: Span(*(begin + place for place in a.span(2 if a[2] is not None else 3)))
                for a in _ATTRIBUTE.finditer(inside)
            }
            yield StartTag(match["tag"], end, match.end(), values)

    def edited(self, edits: Sequence[Place]) -> bytes:
        """The bytes with the edits made."""
        return replaced(self.text, Span(0, len(self.text)), edits).encode(self.codec)

"""Do robots of others get the known number of parameters? 4 R + 2 P + 6, for a point 3 less.

Every chain of three or more joints, none of them mimicking, from the root of a robot to one of its
last links, in all URDFs of the test partners rtb-data and example-robot-data (`make partners`),
seen as a point and as a pose. Printed are those whose identifiable set has another size.

    python -m analyses.robots
"""

from __future__ import annotations

import importlib.metadata
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from pathlib import Path

from loopcal import InputError
from loopcal.files.machines.urdf import read_urdf
from loopcal.mechanisms.instruments.point import point
from loopcal.mechanisms.instruments.pose import pose
from loopcal.mechanisms.machine import Instrument, assemble
from loopcal.mechanisms.origins import LinkJoint, joint_chain
from loopcal.mechanisms.redundancy import redundant


def files() -> list[Path]:
    """All URDFs of the partners that are installed."""
    found = []
    for package in ("example-robot-data", "rtb-data"):
        try:
            listed = importlib.metadata.files(package) or []
        except importlib.metadata.PackageNotFoundError:
            print(f"{package} is not installed")
            continue
        found += [Path(str(path.locate())) for path in listed if path.suffix == ".urdf"]
    return sorted(found)


def chains(path: Path) -> Iterator[tuple[LinkJoint, ...]]:
    """The chains of a robot that differ in their moving joints."""
    try:
        robot = ET.parse(path).getroot()
    except ET.ParseError:
        return
    joints = [joint for joint in robot.iterfind("joint") if joint.get("type")]
    ends = {
        tag: {link.get("link") for joint in joints for link in joint.iterfind(tag)}
        for tag in ("parent", "child")
    }
    links = [str(link.get("name")) for link in robot.iterfind("link")]
    roots = [link for link in links if link not in ends["child"]]
    met = set()
    for tip in (link for link in links if link not in ends["parent"]):
        try:
            chain = read_urdf(path, roots[0], tip)
        except InputError:
            continue
        moving = tuple(joint.name for joint in chain if joint.kind != "fixed")
        if len(moving) > 2 and moving not in met and not any(joint.mimic for joint in chain):
            met.add(moving)
            yield chain


def identifiable(chain: Sequence[LinkJoint], instrument: Instrument) -> int:
    """The size of the set that is chosen."""
    made = assemble(joint_chain(chain), [instrument])
    ranges = {joint.name: joint.limits for joint in chain if joint.limits}
    own = [*instrument.placement, *instrument.parameters]
    found = redundant(made, ranges=ranges, first=own, unsure=list(instrument.parameters))
    return len(made.parameters) - len(found)


def known(chain: Sequence[LinkJoint], instrument: Instrument) -> int:
    """Mooring, Roth and Driels (1991)."""
    kinds = [joint.kind for joint in chain if joint.kind != "fixed"]
    prismatic = kinds.count("prismatic")
    whole = 4 * (len(kinds) - prismatic) + 2 * prismatic + 6
    return whole - 3 if instrument.form == "point" else whole


def main() -> None:
    robots = count = others = 0
    for path in files():
        found = list(chains(path))
        robots, count = robots + bool(found), count + len(found)
        for chain in found:
            for instrument in (point(), pose()):
                size, expected = identifiable(chain, instrument), known(chain, instrument)
                if size != expected:
                    others += 1
                    print(f"{path.name} to {chain[-1].name}, {instrument.name}: {size}, {expected}")
    print(f"{count} chains in {robots} files, as points and as poses: {others} of another size")


if __name__ == "__main__":
    main()

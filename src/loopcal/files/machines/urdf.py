"""Read URDF files: the chain of joints between two links of a robot.

Only the joints of this chain are validated. Names must be unique in the whole file.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError, listed, nearest, unknown_name
from loopcal.files.machines.safe_xml import at, children, local, read_xml
from loopcal.files.toml.reader import shown
from loopcal.mechanisms.bodies import Hanging, tree_machine
from loopcal.mechanisms.chain import AxisFrame, Step, fixed_frame, product, refuse_long_chain
from loopcal.mechanisms.effects.gravity import Load
from loopcal.mechanisms.machine import Machine
from loopcal.mechanisms.origins import KINDS, LinkJoint, Mimic, joint_chain

NO_URDF = "name a URDF file, as written by xacro or a CAD exporter (convert SDF or MJCF first)"
MOMENTS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
_EXPAND = "expand it first (xacro robot.urdf.xacro > robot.urdf) and name the result"


def read_urdf(path: str | Path, base: str, tip: str) -> tuple[LinkJoint, ...]:
    """Read the joints from the link `base` to the link `tip` of a URDF file.

    Raises InputError with file and line if the file is not a URDF, if a link does not exist, if the
    tip is not below the base, or if a joint cannot be calibrated.
    """
    robot = UrdfRobot.read(path)
    chain = robot.chain(base, tip)
    return tuple(robot.joint(element) for element in chain)


def read_tree(
    path: str | Path, leaves: Sequence[str], root: str | None = None
) -> tuple[str, tuple[Hanging, ...], tuple[Load, ...]]:
    """The bodies of a URDF between its root and these links, what they weigh, and the root.

    root: a link, by default the one on which all others hang. Raises InputError as `read_urdf`.
    """
    robot = UrdfRobot.read(path)
    if root is None:
        tops = dict.fromkeys(robot.top(leaf) for leaf in leaves if leaf in robot.links)
        root = next(iter(tops), next(iter(robot.links)))
    elements: dict[str, Any] = {}
    for leaf in leaves:
        if leaf != root:
            elements |= {str(e.get("name")): e for e in robot.chain(root, leaf)}
    bodies = tuple(
        Hanging(robot.link(e, "child"), robot.link(e, "parent"), robot.joint(e))
        for e in elements.values()
    )
    return root, bodies, _masses(robot, root, elements.values())


def urdf_tree(
    path: str | Path, use: Sequence[str], *, root: str | None = None, name: str | None = None
) -> Machine:
    """The machine of a whole robot: all joints between the root of a URDF and the links in `use`.

    T_A_B of two links is the product of the joints between them, as of `urdf`; instruments name the
    two (`on`, `against`). use: such as both hands, or a hand and the camera's link; root: the link
    that stands for the ground, by default the one on which all others hang.

    Raises InputError with file and line as `urdf` does.
    """
    top, bodies, masses = read_tree(path, use, root)
    return tree_machine(bodies, root=top, name=name or Path(path).stem, masses=masses)


@dataclass(frozen=True)
class Branch:
    """The chain from the root of a URDF to one of its links: joints that are read, by name.

    leaf: whether no joint begins at the tip; beyond: fixed joints behind the last one that moves.
    """

    base: str
    tip: str
    joints: tuple[str, ...]
    leaf: bool
    beyond: int


def branches(path: str | Path) -> tuple[Branch, ...]:
    """The chain from the root to every link of a URDF file that moves against it.

    Raises InputError with file and line if the file is not a URDF.
    """
    robot = UrdfRobot.read(path)
    roots = [link for link in robot.links if link not in robot.above]
    parents = {robot.link(element, "parent") for element in robot.joints.values()}
    below: dict[str, list[str]] = {}
    for tip in robot.links:
        below.setdefault(robot.top(tip), []).append(tip)
    moving_branches = []
    for base in roots:
        for tip in below[base]:
            if tip == base:
                continue
            elements = robot.chain(base, tip)
            # Floating and planar joints have several coordinates; a branch may begin behind them.
            if any(element.get("type") not in KINDS for element in elements):
                continue
            reads = [joint.reads for joint in map(robot.joint, elements)]
            moving = dict.fromkeys(read[0] for read in reads if read)
            beyond = next((i for i, read in enumerate(reversed(reads)) if read), 0)
            if moving:
                moving_branches.append(Branch(base, tip, tuple(moving), tip not in parents, beyond))
    return tuple(moving_branches)


def urdf_machine(
    path: str | Path, base: str, tip: str, *, axes: bool = False, name: str | None = None
) -> Machine:
    """Build the machine of the joints between two links of a URDF file; the body is the tip.

    Each joint contributes T_parent_child = Tx(x) Ty(y) Tz(z) R_rpy Rz(rz) Ry(ry) Rx(rx) J(q). Its
    parameters are JOINT_x, _y, _z [m], nominally the origin's xyz, and the small turns JOINT_rz,
    _ry, _rx [rad] after its rpy. Quantities are the readings of the joints, by their names [rad or
    m]. base, tip: links, the tip below the base; axes: add two tilts JOINT_axis_r. for the axis of
    each joint; name: by default that of the file. Not all of these parameters are identifiable:
    see `loopcal.fix_redundant`.

    Raises InputError with file and line if the file is not a URDF, if a link does not exist, if the
    tip is not below the base, or if a joint cannot be calibrated.
    """
    joints, masses = read_urdf(path, base, tip), read_masses(path, base, tip)
    return joint_chain(joints, axes=axes, name=name or Path(path).stem, masses=masses)


@dataclass(frozen=True, eq=False)
class Inertial:
    """What a link weighs: mass [kg]; T (4, 4): its centre and axes in the link's frame; moments:
    ixx, iyy, izz, ixy, ixz, iyz [kg m^2] about the centre, along those axes.
    """

    mass: float
    T: NDArray[np.float64]
    moments: tuple[float, ...]

    @property
    def sound(self) -> bool:
        """Whether a body can have it: principal moments > 0, none above the sum of the others."""
        xx, yy, zz, xy, xz, yz = self.moments
        moments = np.linalg.eigvalsh(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
        return bool(self.mass > 0.0 and moments[0] > 0.0 and moments[2] <= moments[0] + moments[1])


def read_inertials(path: str | Path) -> dict[str, Inertial]:
    """By joint of a URDF what the link behind it weighs, where the file states what can be.

    Raises InputError with file and line if the file is not a URDF, or a number is none.
    """
    robot = UrdfRobot.read(path)
    inertials = {}
    for name, element in robot.joints.items():
        link = robot.links[robot.link(element, "child")]
        for stated in children(link, "inertial")[:1]:
            inertials[name] = robot.inertial(stated)
    return {name: one for name, one in inertials.items() if one.sound}


def read_masses(path: str | Path, base: str, tip: str) -> tuple[Load, ...]:
    """What hangs on each moving joint from `base` to `tip` of a URDF file, as one mass.

    Links that are fixed to one another, or hang on joints beside the chain, these at zero, are one
    body; its mass acts at the centre. Empty where a joint of the chain moves several axes.

    Raises InputError as `read_urdf` does.
    """
    robot = UrdfRobot.read(path)
    return _masses(robot, base, robot.chain(base, tip))


def _masses(robot: UrdfRobot, base: str, chain: Iterable[Any]) -> tuple[Load, ...]:
    moved = {element.get("name"): robot.joint(element) for element in chain}
    moving = [joint.reads[0] for joint in moved.values() if joint.reads]
    if len({*moving}) < len(moving):
        return ()
    below: dict[str, list[Any]] = {}
    for element in robot.joints.values():
        below.setdefault(robot.link(element, "parent"), []).append(element)
    carried: dict[str, tuple[str, NDArray[np.float64]]] = {base: ("", np.eye(4))}
    sums: dict[str, NDArray[np.float64]] = {}
    waiting = [base]
    for parent in waiting:  # it grows: each link adds those that hang on it
        for element in below.get(parent, ()):
            owner, T = carried[parent]
            link, joint = robot.link(element, "child"), moved.get(element.get("name"))
            if link in carried:
                continue
            T = T @ robot.origin(element)
            if joint is not None and joint.reads:
                turns = AxisFrame.of(joint.axis, joint.name).turns
                owner, T = joint.reads[0], product(turns, {}, {}).T
            carried[link] = owner, T
            waiting.append(link)
            mass = robot.mass(link) if owner else np.zeros(4)
            if mass[3] > 0.0:
                sums[owner] = sums.get(owner, np.zeros(4)) + T @ mass
    return tuple(
        Load(joint, joint, (*(total[:3] / total[3]).tolist(),), float(total[3]))
        for joint, total in sums.items()
    )


@dataclass(frozen=True)
class UrdfRobot:
    """Links and joints (XML elements) by name; above: the joints above each link."""

    file: str
    links: Mapping[str, Any]
    joints: Mapping[str, Any]
    above: Mapping[str, tuple[Any, ...]]

    @classmethod
    def of(cls, root: Any, file: str) -> UrdfRobot:
        for element in root.iter():
            if isinstance(element.tag, str) and "xacro" in element.tag.partition("}")[0]:
                _refuse(element, file, "this is xacro, a program that makes a URDF", _EXPAND)
        links = _named(children(root, "link"), file)
        joints = _named(children(root, "joint"), file)
        robot = cls(file, links, joints, {})
        above: dict[str, tuple[Any, ...]] = {}
        for element in joints.values():
            child = robot.link(element, "child")
            above[child] = (*above.get(child, ()), element)
        return cls(file, links, joints, above)

    @classmethod
    def read(cls, path: str | Path) -> UrdfRobot:
        """Those of a file. Raises InputError with file and line if it is not a URDF."""
        return cls.of(read_xml(path, "robot", NO_URDF), shown(path))

    def moving(self) -> tuple[tuple[tuple[str, str, tuple[Step, ...]], ...], dict[str, float]]:
        """Parent, child and steps of each joint, parents first, and the values of their parameters
        by the drawing. Joints that float or slide in a plane stand still."""
        below: dict[str, list[Any]] = {}
        for element in self.joints.values():
            below.setdefault(self.link(element, "parent"), []).append(element)
        waiting = [link for link in self.links if link not in self.above][:1]
        chain: list[tuple[str, str, tuple[Step, ...]]] = []
        nominal: dict[str, float] = {}
        for parent in waiting:  # it grows: each link adds those that hang on it
            for element in below.get(parent, ()):
                link = self.link(element, "child")
                if element.get("type") in KINDS:
                    joint = self.joint(element)
                    nominal |= {p.name: p.nominal for p in joint.origin}
                    steps = tuple(joint.steps())
                else:
                    steps = tuple(fixed_frame(*self._placed(element)))
                chain.append((parent, link, steps))
                waiting.append(link)
        return tuple(chain), nominal

    def _refuse_circle(self, base: str) -> None:
        """Raise InputError if the links above the base form a cycle: a URDF is a tree."""
        met, waiting = set(), [base]
        while waiting:
            for element in self.above.get(waiting.pop(), ()):
                link = self.link(element, "parent")
                if link == base:
                    _refuse(
                        element,
                        self.file,
                        f"the joints above {base!r} lead back to it",
                        "correct the parent of one of them; a URDF is a tree",
                    )
                if link not in met:
                    met.add(link)
                    waiting.append(link)

    def top(self, tip: str) -> str:
        """The link on which another one hangs in the end; one of a cycle where that has none."""
        met: set[str] = set()
        while tip not in met and self.above.get(tip):
            met.add(tip)
            tip = self.link(self.above[tip][0], "parent")
        return tip

    def chain(self, base: str, tip: str) -> list[Any]:
        """The joints from a link to another one below it."""
        for link in (base, tip):
            if link not in self.links:
                raise unknown_name(f"the robot has no link {link!r}", link, self.links, self.file)
        elements: list[Any] = []
        passed, link = {tip: None}, tip
        while link != base:
            above = self.above.get(link, ())
            if not above:
                raise InputError(
                    f"the link {tip!r} is not below {base!r}; above it are {listed(passed)}",
                    code="unknown-name",
                    place=self.file,
                    remedy=f"name one of these as the base, or a tip below {base!r}",
                )
            if len(above) > 1:
                names = " and ".join(repr(e.get("name")) for e in above)
                _refuse(
                    above[1],
                    self.file,
                    f"the link {link!r} has two parent joints, {names}; a URDF is a tree",
                    "describe closed loops as a machine of their own type, or delete one joint",
                )
            elements.append(above[0])
            link = self.link(above[0], "parent")
            if link in passed:
                _refuse(
                    above[0],
                    self.file,
                    f"the joints above {tip!r} form a cycle through {link!r}",
                    "correct the parent of one of them",
                )
            passed[link] = None
        self._refuse_circle(base)
        if not elements:
            raise InputError(
                f"base and tip are the same link {base!r}",
                code="conflicting-keys",
                place=self.file,
                remedy="name a tip with moving joints between the two",
            )
        refuse_long_chain(len(elements))
        return elements[::-1]

    def _placed(self, element: Any) -> tuple[Any, Any]:
        """xyz [m] and rpy [rad] of the origin of a joint, or of an inertial."""
        xyz = rpy = (0.0, 0.0, 0.0)
        for origin in children(element, "origin")[:1]:
            xyz = self._numbers(origin, "xyz", xyz)
            rpy = self._numbers(origin, "rpy", rpy)
        return xyz, rpy

    def origin(self, element: Any) -> NDArray[np.float64]:
        """The origin (4, 4) of a joint, or of an inertial."""
        return product(fixed_frame(*self._placed(element)), {}, {})

    def joint(self, element: Any) -> LinkJoint:
        """Read one joint."""
        name, kind = element.get("name"), self._kind(element)
        xyz, rpy = self._placed(element)
        axis = (1.0, 0.0, 0.0)  # by the definition of URDF
        for stated in children(element, "axis")[:1]:
            axis = self._numbers(stated, "xyz", axis)
        moves = kind in ("revolute", "prismatic")
        limits = self._limits(element) if moves else None
        mimic = None if kind == "fixed" else self._mimic(element, (name,))
        try:
            return LinkJoint(name, kind, xyz, rpy, axis, limits, mimic)
        except InputError as error:
            raise error.at(at(element, self.file)) from None

    def mass(self, link: str) -> NDArray[np.float64]:
        """m x, m y, m z, m of a link in its frame; zeros where the file states none."""
        for stated in children(self.links[link], "inertial")[:1]:
            try:
                one = self.inertial(stated)
            except InputError:  # only the joints of the chain are validated
                break
            return one.mass * one.T[:, 3]
        return np.zeros(4)

    def inertial(self, element: Any) -> Inertial:
        """Read what a link weighs."""
        mass, moments = 0.0, (0.0,) * len(MOMENTS)
        for stated in children(element, "mass")[:1]:
            mass = self._numbers(stated, "value", (0.0,), 1)[0]
        for stated in children(element, "inertia")[:1]:
            moments = tuple(self._numbers(stated, key, (0.0,), 1)[0] for key in MOMENTS)
        return Inertial(mass, self.origin(element), moments)

    def _kind(self, element: Any) -> str:
        kind = element.get("type")
        if kind not in KINDS:
            words = "no type" if kind is None else f"the type {kind!r}"
            _refuse(
                element,
                self.file,
                f"the joint {element.get('name')!r} has {words}",
                f"joints of a chain are {', '.join(KINDS)}; name a base behind a joint that "
                "floats or slides in a plane",
            )
        return str(kind)

    def link(self, element: Any, tag: str) -> str:
        """The "parent" or "child" of a joint. Raises InputError where there is no such link."""
        link_names = [child.get("link") for child in children(element, tag)]
        if len(link_names) != 1 or not link_names[0]:
            _refuse(
                element,
                self.file,
                f"the joint {element.get('name')!r} names no {tag} link",
                f'give it one <{tag} link="..."/>',
            )
        if link_names[0] not in self.links:
            _refuse(
                element,
                self.file,
                f"the joint {element.get('name')!r} has the {tag} link {link_names[0]!r}, which "
                f"does not exist",
                nearest(link_names[0], self.links),
            )
        return str(link_names[0])

    def _mimic(self, element: Any, met: tuple[str, ...]) -> Mimic | None:
        """The independent joint that a joint mimics, directly or through other mimic joints."""
        stated = children(element, "mimic")
        if not stated:
            return None
        followed = stated[0].get("joint")
        if followed not in self.joints:
            _refuse(
                stated[0],
                self.file,
                f"the joint {met[-1]!r} mimics {followed!r}, which does not exist",
                nearest(str(followed), self.joints),
            )
        if followed in met:
            _refuse(
                stated[0],
                self.file,
                f"the joint {met[0]!r} mimics itself, through {', '.join(map(repr, met))}",
                "remove the mimic of one of them",
            )
        target = self.joints[followed]
        kind = self._kind(target)
        if kind == "fixed":
            _refuse(
                stated[0],
                self.file,
                f"the joint {met[-1]!r} mimics {followed!r}, which is fixed",
                "name a joint that moves, or make this one fixed",
            )
        multiplier = self._numbers(stated[0], "multiplier", (1.0,), 1)[0]
        offset = self._numbers(stated[0], "offset", (0.0,), 1)[0]
        # Of a chain of mimics q = m (m' q'' + o') + o.
        inner = self._mimic(target, (*met, followed))
        if inner is None:
            return Mimic(followed, multiplier, offset, kind)
        return Mimic(
            inner.joint, multiplier * inner.multiplier, multiplier * inner.offset + offset,
            inner.kind,
        )  # fmt: skip

    def _limits(self, element: Any) -> tuple[float, float] | None:
        for stated in children(element, "limit"):
            lower = self._numbers(stated, "lower", (0.0,), 1)[0]
            upper = self._numbers(stated, "upper", (0.0,), 1)[0]
            # 0 and 0 are the defaults of URDF: then no limits are stated.
            return (lower, upper) if lower < upper else None
        return None

    def _numbers(self, element: Any, key: str, default: Any, count: int = 3) -> Any:
        text = element.get(key)
        if text is None:
            return default
        if "${" in text or "$(" in text:
            words = f"{key}={text!r} is a formula of xacro, a program that makes a URDF"
            _refuse(element, self.file, words, _EXPAND)
        numbers = _floats(text)
        if len(numbers) != count or not all(map(math.isfinite, numbers)):
            many = "a finite number" if count == 1 else f"{count} finite numbers"
            _refuse(
                element,
                self.file,
                f"{key}={text!r} is not {many}",
                f'write {key}="{" ".join(["0"] * count)}" with numbers in m and rad',
            )
        return numbers


def _floats(text: str) -> tuple[float, ...]:
    try:
        return tuple(float(word) for word in text.split())
    except ValueError:
        return ()


def _named(elements: Iterable[Any], file: str) -> dict[str, Any]:
    by_name: dict[str, Any] = {}
    for element in elements:
        name, what = element.get("name"), local(element)
        if not name:
            _refuse(element, file, f"a {what} has no name", f'give it one: <{what} name="...">')
        if name in by_name:
            _refuse(
                element,
                file,
                f"two {what}s are called {name!r}, the first in line {by_name[name].sourceline}",
                "give each a unique name",
            )
        by_name[name] = element
    return by_name


def _refuse(element: Any, file: str, words: str, remedy: str) -> None:
    raise InputError(words, code="invalid-syntax", place=at(element, file), remedy=remedy)

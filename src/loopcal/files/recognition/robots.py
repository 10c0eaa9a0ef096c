"""The robot of a new project: a URDF, a table of Denavit-Hartenberg parameters, or a type."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from math import degrees, pi, radians
from pathlib import Path
from typing import Any

from loopcal.errors import InputError, listed, unknown_name
from loopcal.files.machines.urdf import Branch, branches
from loopcal.files.recognition.dh_table import DhTable, Row, chain_rows, joint_names, read_dh
from loopcal.files.recognition.fields import Field, moving
from loopcal.files.recognition.headers import words
from loopcal.files.recognition.joint_sets import (
    affixed_joints,
    joint_sets,
    named_joints,
    usual_joints,
)
from loopcal.mechanisms.chain import Step, product
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parameters import Parameter
from loopcal.mechanisms.rest import roll_pitch_yaw
from loopcal.mechanisms.serial import tool_names
from loopcal.presentation.shown import significant

_SIX = ("tx", "ty", "tz", "rz", "ry", "rx")
"""Motions that make any frame, in this order."""
GUESSED = 0.2
"""sd of a dimension that is the example's, in the machine's largest length, and of an angle [rad].
Chosen, not derived: machines of one type differ by more than the parts of one do."""
# Chosen, not derived: what fits two lines.
_SHOWN = 8
"""Guesses that a remark names."""
CONVENTIONS = {"dh": "classical", "mdh": "modified"}
"""The conventions of Denavit and Hartenberg by the form of a joint."""
_PARALLEL = 1e-3
"""Axes that meet at a smaller angle [rad] are parallel for Denavit and Hartenberg."""


@dataclass(frozen=True)
class Robot:
    """table: the [mechanism] of a project without instruments; joints: how many are read; names:
    of them, empty where the columns name them; remarks: what was chosen, and why; point: the
    parameters of the one point that its type measures by itself; apart: the same machine for other
    instruments, where it has such a point; lengths: nominal values [m] beside the table; otherwise:
    the machine of the same numbers in the other convention of Denavit and Hartenberg; convention:
    that of the file, "" where it states none; unread: what no sensor of a parallel machine
    reads."""

    table: Mapping[str, Any]
    joints: int
    names: tuple[str, ...] = ()
    remarks: tuple[str, ...] = field(default=())
    point: tuple[str, ...] = ()
    apart: Robot | None = None
    lengths: Mapping[str, float] = field(default_factory=dict)
    otherwise: Robot | None = None
    convention: str = ""
    unread: tuple[str, ...] = ()


def urdf_robot(
    path: Path,
    relative: str,
    fields: Sequence[Field],
    base: str | None,
    tip: str | None,
    count: int = 0,
) -> Robot:
    """The chain of a URDF that has the joints of the columns; relative: its path in the project;
    count: of columns that are stated as joints.

    Raises InputError listing the chains where base and tip are not stated and several fit.
    """
    if tip is None and not fields:
        tip = robot_link(path)  # no column says which joints are read
    if base is not None and tip is not None:
        from loopcal.files.machines.urdf import read_urdf

        reads = dict.fromkeys(j.reads[0] for j in read_urdf(path, base, tip) if j.reads)
        return Robot(_urdf_table(relative, base, tip), len(reads), tuple(reads))
    chains = branches(path)
    for link, ends in ((base, {b.base: 0 for b in chains}), (tip, {b.tip: 0 for b in chains})):
        if link is not None and ends and link not in ends:
            raise unknown_name(f"no chain ends at a link {link!r}", link, ends, path.name)
    every = [b for b in chains if (base in (None, b.base)) and (tip in (None, b.tip))]
    columns = {name: f for b in every for name, f in named_joints(fields, b.joints).items()}
    if not columns:
        affixed = ((b.joints, c) for b in every for c in affixed_joints(fields, b.joints))
        names, fields_of = max(affixed, key=lambda one: len(one[0]), default=((), ()))
        columns = dict(zip(names, fields_of, strict=True))
    usual = max(count, len(usual_joints(fields))) if not columns else 0
    if columns:
        fitting = [b for b in every if {*b.joints} == {*columns}] or _of_moving(every, columns)
        why = "its moving joints are the columns' names"
    else:
        moves = len(moving(usual_joints(fields)))
        fitting = [b for b in every if len(b.joints) == usual] or [
            b for b in every if len(b.joints) == moves
        ]
        why = f"it alone has as many moving joints as there are joint columns ({usual or moves})"
        if not usual:
            most = max((len(b.joints) for b in every), default=0)
            fitting = [b for b in every if len(b.joints) == most]
            why = f"it alone has the most moving joints ({most})"
    if len({b.joints for b in fitting}) != 1:
        raise _which_chain(path, every, fitting)
    best = _best_tip(fitting)
    remark = f"base {best.base!r} and tip {best.tip!r} of {path.name}: {why}"
    others = [b.tip for b in every if b.tip != best.tip]
    if others:
        remark += f"; other tips: {listed(list(dict.fromkeys(others)))}"
    table = _urdf_table(relative, best.base, best.tip)
    return Robot(table, len(best.joints), best.joints, (remark,))


def _of_moving(every: Sequence[Branch], columns: Mapping[str, Field]) -> list[Branch]:
    """The shortest chains with all joints that move: fingers, wheels or another arm stand still."""
    still = {name for name, f in columns.items() if f not in moving([*columns.values()])}
    holding = [b for b in every if {*columns} - still <= {*b.joints} <= {*columns}]
    fewest = min((len(b.joints) for b in holding), default=0)
    return [b for b in holding if len(b.joints) == fewest]


def _urdf_table(relative: str, base: str, tip: str) -> dict[str, Any]:
    return {"type": "urdf", "file": relative, "base": base, "tip": tip}


def _best_tip(fitting: Iterable[Branch]) -> Branch:
    """Of links that move alike the one that tools are mounted on; else the only leaf, or the first.

    Which of them matters little: where the target sits on it is estimated.
    """
    links = sorted(fitting, key=lambda b: b.beyond)
    if tips := _named_tips(links):
        return tips[0]
    leaves = [link for link in links if link.leaf]
    return leaves[0] if len(leaves) == 1 else links[0]


def tips_before(urdf: str | Path, base: str, tip: str) -> list[str]:
    """A link of each part of a chain that has fewer joints than the whole, the longest first."""
    every = [b for b in branches(urdf) if b.base == base]
    whole = next((b.joints for b in every if b.tip == tip), ())
    parts = (whole[:n] for n in reversed(range(1, len(whole))))
    links = ([b for b in every if b.joints == part] for part in parts)
    return [_best_tip(some).tip for some in links if some]


def _named_tips(links: Sequence[Branch]) -> list[Branch]:
    """Links named as what tools are mounted on, in the order of these words."""
    return [
        link
        for word in words("links", "tip")
        for link in links
        if link.tip == word or link.tip.endswith(f"_{word}")
    ]


def joints_of(urdf: str | Path | None) -> set[str]:
    """Names of all joints of a URDF that move; none without one."""
    return set() if urdf is None else {name for b in branches(urdf) for name in b.joints}


def robot_link(path: Path) -> str | None:
    """The link of a URDF that tools are mounted on, by its name; None where none or several are."""
    tips = _named_tips(branches(path))
    return tips[0].tip if len({b.joints for b in tips}) == 1 else None


def _which_chain(path: Path, every: Sequence[Branch], fitting: Sequence[Branch]) -> InputError:
    ends: dict[tuple[str, ...], Branch] = {}
    for branch in fitting or every:
        ends.setdefault(branch.joints, branch)
    longest = sorted(ends.values(), key=lambda b: -len(b.joints))[:8]
    shown = "; ".join(
        f"--base {b.base!r} --tip {b.tip!r} ({len(b.joints)} joints)" for b in longest
    )
    what = "several chains fit" if fitting else "no chain fits"
    likely = longest[:1]
    if len(longest) > 1 and longest[0].joints[:-1] == longest[1].joints[:-1]:  # two fingers
        likely = [b for b in longest if b.joints == longest[0].joints[:-1]] or likely
    limbs = any(not {*longest[0].joints} & {*b.joints} for b in longest)
    both = "; of several limbs state what is observed: --observe" if limbs else ""
    return InputError(
        f"{what} the joint columns of the readings",
        code="unknown-name",
        place=path.name,
        remedy=f"state one of: {shown}{both}" if shown else "name a URDF with moving joints",
    ).offering(*(word for b in likely for word in ("--base", b.base, "--tip", b.tip)))


def dh_robot(path: Path, fields: Sequence[Field], signs: Sequence[int] = ()) -> Robot:
    """The machine of a table of Denavit-Hartenberg parameters; signs: how its joints count.

    Where two axes are nominally parallel the form of Hayati replaces the classical one, in which d
    could not be determined. Raises InputError for a table that cannot be read.
    """
    table = read_dh(path)
    if signs and len(signs) == table.moving:
        each = iter(signs)
        turned = [row if row.kind == "fixed" else row.turned(next(each)) for row in table.rows]
        table = replace(table, rows=tuple(turned))
    robot = _of_table(path, table, fields)
    other = _of_table(path, replace(table, modified=not table.modified), fields)
    convention = CONVENTIONS["mdh" if table.modified else "dh"] if table.stated else ""
    return replace(robot, otherwise=other, convention=convention)


def _of_table(path: Path, table: DhTable, fields: Sequence[Field]) -> Robot:
    before, rows = chain_rows(table)
    count = table.moving
    if not count:
        raise InputError(
            "no row of the table moves",
            code="missing-key",
            place=path.name,
            remedy="give a row per joint",
        )
    # Commanded and actual joints would give the machine the names of one of them.
    usual = usual_joints(fields) if len(joint_sets(fields, count, ())) < 2 else ()
    # Without their unit: joints are in SI, and so are the readings that a project of images writes.
    columns = [f.heading.text.removesuffix(f"_{f.unit}") if f.heading else "" for f in usual]
    names = joint_names(rows, [c for c in columns if c])
    joints: list[dict[str, Any]] = []
    ahead: dict[str, float] = {}
    _append(ahead, before)
    for row in rows:
        if row.kind == "fixed":
            motions = {"rz": row.offset, "tz": row.d, "tx": row.a, "rx": row.alpha}
            where = joints[-1].setdefault("after", {}) if joints else ahead
            _append(where, motions)
            continue
        joints.append(
            joint_table(names[len(joints)], row, last=len(joints) == count - 1, ahead=ahead)
        )
        ahead = {}
    remarks = list(table.remarks)
    if table.modified:
        remarks.append(f"{path.name} is of the modified convention, written here in the classical")
    moving_names = tuple(row.name for row in rows if row.kind != "fixed")
    turned = [joint["name"] for joint in joints if "direction" in joint]
    if turned:
        remarks.append(f"{', '.join(turned)} count the other way round (direction = -1)")
    stated = moving_names if len(named_joints(fields, moving_names)) == count else ()
    made = {"type": "serial", "units": {"length": "mm", "angle": "deg"}, "fix_redundant": True}
    return Robot({**made, "joint": joints}, count, stated, tuple(remarks))


def _append(where: dict[str, float], motions: Mapping[str, float]) -> None:
    """Let fixed motions [m, rad] follow others [mm, deg]; of one kind twice they become a frame."""
    written = {k: _written(k, v) for k, v in motions.items() if v}
    if set(where) & set(written):
        steps = [Step(k, constant=_si(k, v)) for k, v in (*where.items(), *written.items())]
        T = product(steps, {}, {})
        roll, pitch, yaw = roll_pitch_yaw(T[:3, :3])
        six = (*T[:3, 3].tolist(), yaw, pitch, roll)
        where.clear()
        written = {k: _written(k, v) for k, v in zip(_SIX, six, strict=True)}
    where |= {k: v for k, v in written.items() if v}


def joint_table(name: str, row: Row, *, last: bool, ahead: Mapping[str, float]) -> dict[str, Any]:
    """One joint in mm and degrees, of the form of Hayati where the next axis is parallel."""
    joint: dict[str, Any] = {"name": name}
    # Axes that are parallel with opposite directions count too.
    turned = row.alpha % pi
    parallel = min(turned, pi - turned) < _PARALLEL
    form = "hayati" if parallel and not last else "dh"
    if form != "dh":
        joint["form"] = form
    if row.kind != "revolute":
        joint["kind"] = row.kind
    if row.direction < 0:
        joint["direction"] = -1
    # Hayati and Mirmirani (1985): the form has no d, so that of the drawing goes ahead.
    before = dict(ahead)
    if form == "hayati" and row.d:
        _append(before, {"tz": row.d})  # motions along and about one axis may be exchanged
    if before:
        joint["before"] = before
    keys = {"a": row.a, "alpha": row.alpha, "offset": row.offset}
    if form == "dh":
        keys["d"] = row.d
    for key in ("a", "d", "alpha", "offset"):
        if keys.get(key):
            joint[key] = _written("tx" if key in "ad" else "rx", keys[key])
    return joint


def _written(motion: str, value: float) -> float:
    """A length in mm, an angle in degrees; rounded where digits are those of a conversion."""
    return round(1e3 * value if motion[0] == "t" else degrees(value), 9)


def _si(motion: str, value: float) -> float:
    """A length in m, an angle in radians."""
    return 1e-3 * value if motion[0] == "t" else radians(value)


def typed_robot(named: str) -> Robot:
    """Build the machine of a type that has nominal values, or of a mechanism file.

    Raises InputError for a type without nominal values, for one without closed loops that moves in
    a plane, and for a file that names other files.
    """
    from loopcal.files.machines.mechanism_file import mechanism_from_data

    table: dict[str, Any] = _table_of(named) if named.endswith(".toml") else {"type": named}
    kind = table.get("type", "")
    try:
        mechanism = mechanism_from_data(table, "--machine")
    except InputError as error:
        if table != {"type": named}:
            raise
        raise InputError(
            f"a machine of the type {kind!r} needs nominal values ({error.message})",
            code="missing-key",
            place="--machine",
            remedy=f"name --urdf or --dh, or begin with loopcal new NAME --mechanism {kind}",
        ) from None
    if not mechanism.chain:
        return _closed(table, mechanism)
    robot = _of_chain(table, mechanism)
    rows: list[dict[str, Any]] = table.get("joint", [])
    forms = {row.get("form", "dh") for row in rows}
    if kind != "serial" or len(forms) != 1 or not forms <= CONVENTIONS.keys():
        return robot
    (form,) = forms
    (other,) = CONVENTIONS.keys() - forms
    turned = {**table, "joint": [{**row, "form": other} for row in rows]}
    otherwise = _of_chain(turned, mechanism_from_data(turned, "--machine"))
    return replace(robot, otherwise=otherwise, convention=CONVENTIONS[form])


def _of_chain(table: Mapping[str, Any], mechanism: Mechanism) -> Robot:
    """A machine of joints one behind another."""
    from loopcal.files.machines.registry import machine_type

    driven = tuple(mechanism.joints)
    row = machine_type(table["type"])
    if row.joints is None:
        return Robot(table, len(driven), driven)
    point = tool_names(row.joints())
    apart = _apart(mechanism, {**table, "joint": row.listed()}, point)
    return Robot(table, len(driven), driven, point=point, apart=apart)


def parallel_machine(mechanism: Mechanism) -> Robot | None:
    """The machine of closed loops that instruments look at, in space; None for any other."""
    described = mechanism.description or {}
    if mechanism.chain or not mechanism.home or "instrument" not in described:
        return None
    from loopcal.files.machines.mechanism_file import mechanism_from_data

    table = {key: described[key] for key in ("type", "passive", "home") if key in described}
    bare = mechanism_from_data(table, described["type"])
    values = {p.name: p.nominal for p in mechanism.parameters if p.name in bare.parameters.names}
    return _closed({**table, "parameters": values}, bare)


def _table_of(path: str) -> dict[str, Any]:
    """A mechanism file without its instruments and what it says of them."""
    from loopcal.files.machines.mechanism_file import mechanism_from_data
    from loopcal.files.toml.reader import read_toml

    aside = ("schema", "instrument", "base", "point")
    table = {k: v for k, v in read_toml(path).items() if k not in aside}
    if "file" in table or table.get("type") == "function":
        raise InputError(
            "this file rests on another file",
            code="unsupported",
            place=path,
            remedy="name the robot's URDF with --urdf, or write [data] and [noise] yourself: "
            "loopcal new NAME shows how",
        )
    stated = table.pop("parameters", {})
    names = mechanism_from_data(table, path).parameters.names
    kept = {k: v for k, v in stated.items() if any(fnmatchcase(n, k) for n in names)}
    return {**table, "parameters": kept} if kept else table


def by_hand(kind: str, why: str, then: str) -> InputError:
    """The refusal of a machine whose project a template begins."""
    refusal = InputError(
        f"a machine of the type {kind!r} {why}",
        code="unsupported",
        place="--machine",
        remedy=f"begin with loopcal new NAME --mechanism {kind}, {then}",
    )
    refusal.command = f"loopcal new my-{kind} --mechanism {kind}"
    return refusal


def _closed(table: Mapping[str, Any], mechanism: Mechanism) -> Robot:
    """A parallel machine, of whose quantities the first are driven, as many as it has freedoms.

    Raises InputError for other machines in a plane.
    """
    names = mechanism.tape.quantities
    if not mechanism.home:
        raise by_hand(table["type"], "moves in a plane", "and name your columns in it")
    driven = names[: len(names) - len(mechanism.tape.loops)]
    unread = names[len(driven) :]
    table, remarks = _with_guesses(table, mechanism)
    return Robot(table, len(driven), driven, remarks=remarks, unread=unread)


def _with_guesses(
    table: Mapping[str, Any], mechanism: Mechanism
) -> tuple[Mapping[str, Any], tuple[str, ...]]:
    """The table of a parallel machine with what it leaves out, as guesses, and what says so.

    A value that a drawing does not state is 0 where that of the example is.
    """
    stated = table.get("parameters", {})
    missing = [
        p
        for p in mechanism.parameters
        if p.nominal and not any(fnmatchcase(p.name, key) for key in stated)
    ]
    if not missing:
        return table, ()
    if not stated:
        return table, (
            "no dimension is stated: all are guesses, those of the example of this type. State the "
            "drawing's in a mechanism file (--machine FILE.toml)",
        )
    far = {"m": GUESSED * max(abs(p.nominal) for p in mechanism.parameters if p.unit == "m")}
    guesses = {p.name: _guess(p, far.get(p.unit, GUESSED)) for p in missing}
    words = [f"{n} = {one['value']:g} {one['unit']}" for n, one in guesses.items()]
    more = [f"{len(words) - _SHOWN} more"] if len(words) > _SHOWN else []
    sds = " and ".join(dict.fromkeys(f"{one['sd']:g} {one['unit']}" for one in guesses.values()))
    remark = (
        f"guesses, because the file states no other values: {', '.join(words[:_SHOWN] + more)}. "
        f"They are those of the example of this type, taken to be known to {sds} (sd). Write the "
        "drawing's values, without sd"
    )
    return {**table, "parameters": {**stated, **guesses}}, (remark,)


def _guess(parameter: Parameter, sd: float) -> dict[str, Any]:
    """An entry of a file, in mm or degrees."""
    motion, unit = ("t", "mm") if parameter.unit == "m" else ("r", "deg")
    near = float(significant(_written(motion, sd), 2))
    return {"value": _written(motion, parameter.nominal), "unit": unit, "sd": near}


def _apart(mechanism: Mechanism, stated: Mapping[str, Any], point: Sequence[str]) -> Robot:
    """The joints of an arm as a machine of the type "serial", which any instrument may see."""
    parameters = {n: v for n, v in stated.get("parameters", {}).items() if n not in point}
    table = {
        "name": mechanism.name,
        "fix_redundant": True,
        **stated,
        "type": "serial",
        "parameters": parameters,
    }
    lengths = {
        p.name: p.nominal
        for p in mechanism.parameters
        if p.nominal and p.name not in {*point, *parameters}
    }
    joints = tuple(joint["name"] for joint in table["joint"])
    return Robot(table, len(joints), joints, lengths=lengths)

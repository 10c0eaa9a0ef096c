"""Names of images and points in a table of corners, matched to those of poses and boards."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

from loopcal.files.cameras.corner_table import CornerTable
from loopcal.mechanisms.cameras.board import Board


def matched(
    table: CornerTable, boards: Sequence[Board], poses: Sequence[str], *, counted: bool = False
) -> tuple[CornerTable, tuple[str, ...]]:
    """The corners under the names of poses and points, and what was changed, in words.

    boards: in the order of `table.boards`; counted: whether poses have no names, and are counted
    from 1. Names stay where nothing or not everything matches.
    """
    remarks = []
    by = _by_row(table.images, poses) if counted else {}
    how = "poses in the order of their rows"
    if not by and poses and {*poses}.isdisjoint(table.image):
        by, how = _by_number(table.images, poses), "poses of the same number"
    if by:
        first = next(iter(by.items()))
        remarks.append(f"images belong to the {how}: {first[0]!r} to {first[1]!r}")
        table = replace(table, image=tuple(by.get(name, name) for name in table.image))
    points = list(table.point)
    for name, board in zip(table.boards, boards, strict=True):
        mine = [i for i, of in enumerate(table.board) if of == name]
        step = _step({points[i] for i in mine}, board.points)
        if step:
            begins = "1, those of the board at 0" if step > 0 else "0, those of the board at 1"
            remarks.append(f"numbers of corners of {name!r} begin at {begins}: matched so")
        for i in mine if step else ():
            points[i] = str(int(points[i]) - step)
        if begin := _first_of_tags({points[i] for i in mine}, board.points):
            names = ["", *board.points][1 - int(begin) :]
            remarks.append(f"corners of {name!r} are numbered tag by tag from {begin}: matched so")
            for i in mine:
                points[i] = names[int(points[i])]
    return replace(table, point=tuple(points)), tuple(remarks)


def _by_number(images: Sequence[str], poses: Sequence[str]) -> Mapping[str, str]:
    """Image -> pose with the same last number; empty where numbers are missing or repeated."""
    by = [{_last_number(name): name for name in names} for names in (images, poses)]
    if any(None in one for one in by) or [len(one) for one in by] != [len(images), len(poses)]:
        return {}
    return {by[0][n]: by[1][n] for n in by[0] if n in by[1]}


def _by_row(images: Sequence[str], poses: Sequence[str]) -> Mapping[str, str]:
    """Image -> pose, whose rows have no names: images that count from 0, or as many of any other
    numbers; empty where numbers count from 1, as rows do, or say nothing."""
    numbers = {name: n for name in images if (n := _last_number(name)) is not None}
    every = sorted(numbers.values())
    if len({*every}) < len(images) or not every:
        return {}
    if every[0] == 0 and every[-1] < len(poses):
        return {name: poses[n] for name, n in numbers.items()}
    if len(images) == len(poses) and every[-1] > len(poses):
        return {name: poses[every.index(n)] for name, n in numbers.items()}
    return {}


def _last_number(name: str) -> int | None:
    digits = re.findall(r"\d+", name.rpartition("/")[2])
    return int(digits[-1]) if digits else None


def _step(used: Collection[str], points: Collection[str]) -> int:
    """By how much the numbers of corners exceed those of the points; 0 where names match."""
    if {*used} <= {*points} or not all(name.isdecimal() for name in (*used, *points)):
        return 0
    fitting = (step for step in (1, -1) if {str(int(n) - step) for n in used} <= {*points})
    return next(fitting, 0)


def _first_of_tags(used: Collection[str], points: Collection[str]) -> str:
    """The number of the first of corners that are counted through, on a board that names them by
    tag and corner; empty where names match."""
    tags = all(re.fullmatch(r"\d+\.\d+", name) for name in points)
    if not tags or not used or not all(name.isdecimal() for name in used):
        return ""
    most = max(map(int, used))
    if most < len(points):
        return "0"
    return "1" if most == len(points) and "0" not in used else ""

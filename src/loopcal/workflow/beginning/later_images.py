"""Readings of another day from the files that `init` takes, for cameras that are calibrated."""

from __future__ import annotations

import warnings
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from loopcal.errors import InputError, listed
from loopcal.estimation.cameras.facts import Fact
from loopcal.estimation.cameras.mistakes import MIRRORS, RESIZED, TURNED
from loopcal.files.cameras.folder import files_of, read_files
from loopcal.files.machines.mechanism_file import mechanism_from_data
from loopcal.files.machines.mechanism_writer import mechanism_table
from loopcal.files.recognition.robots import Robot
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.cameras.board import Board
from loopcal.mechanisms.instruments.camera import cameras_of
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parallel.free_body import BEGIN
from loopcal.workflow.beginning.from_images import named, refuse_unexplained, understood
from loopcal.workflow.beginning.images_hand import Hand, hand_of
from loopcal.workflow.beginning.images_project import doubts, word
from loopcal.workflow.beginning.still_cameras import without_still

SAME = 1e-4
"""Points of one board differ by less than this share of it: files round."""


def later_images(
    entries: Sequence[Any], mechanism: Mechanism, flange: Sequence[str] = ()
) -> Dataset:
    """Readings of another day from the files that `init` takes, for calibrated cameras.

    The board and the lenses are those of the calibration. flange: how its poses were read on the
    first day, and are read now. Warns of what had to be corrected, of images that do not fit and of
    wrong corners. Raises InputError for another board.
    """
    cameras = cameras_of(mechanism)
    usual = {one.board.name: one.board for one in cameras}
    files, _ = without_still(read_files(entries, usual))
    for name in files.corners.boards:
        board = named(files.boards, name)
        refuse_another(replace(board, name=word(name, "board")), usual, whole=True)
    lenses = {one.name: one.intrinsics for one in cameras}
    eyes = {camera: word(camera, "camera") for camera in files.corners.cameras}
    for eye in eyes.values():
        refuse_unknown_eye(eye, lenses)
    files = replace(files, lenses={camera: lenses[eye] for camera, eye in eyes.items()})
    hand = _hand(files.poses, mechanism).read_as(flange)
    on_body = {one.name: one.on_body for one in cameras}
    project, _ = understood(files, hand, {camera: not on_body[eye] for camera, eye in eyes.items()})
    _refuse_another_format(project.begun.facts)
    refuse_unexplained(project)
    for words in doubts(project):
        warnings.warn(words, stacklevel=2)
    data = project.dataset
    pixels = {q for family in mechanism.families for q in family.readings}
    unseen = {q: np.full(len(data), np.nan) for q in pixels - data.readings.keys()}
    return replace(data.with_readings(unseen), places=project.places)


def _refuse_another_format(facts: Sequence[Fact]) -> None:
    """Raise InputError for images that were resized or turned since the calibration: no camera
    changes so, and its learnt lens would be taken for a machine that did. A mirror on its side is
    one of u or v alone."""
    mirrored = any(fact.code in MIRRORS for fact in facts)
    for fact in facts:
        if fact.code == RESIZED:
            factor = float(fact.values["factor"])
            raise InputError(
                f"the images are {factor:.4g} times as wide and high as those of the calibration",
                code="conflicting-keys",
                remedy="use images of the size of the calibration's, or corners in its pixels: "
                f"u = (u + 0.5) / {factor:.4g} - 0.5, and v likewise",
            )
        if mirrored and fact.code == TURNED:
            raise InputError(
                "corners fit the lens of the calibration as in a mirror only: v counts upwards "
                "from the bottom of the image, or u from right to left",
                code="conflicting-keys",
                remedy="write pixels as on the day of the calibration, v downwards from the top: "
                "v = height - 1 - v",
            )
        if fact.code == TURNED:
            raise InputError(
                f"the images are turned by {fact.values['degrees']:g} degrees beside those of the "
                "calibration",
                code="conflicting-keys",
                remedy="use images with the same side up as those of the calibration",
            )


def later_poses(
    entries: Sequence[Any], mechanism: Mechanism, flange: Sequence[str] = ()
) -> Dataset | None:
    """Poses or joints without images, to predict from, in the tables that `init` takes.

    flange: as in `later_images`. None where no table has them. Raises InputError for turns that
    only images could decide.
    """
    stated = _hand(files_of(entries), mechanism)
    hand = stated.read_as(flange)
    if not hand.poses:
        return None
    for words in hand.remarks[len(stated.remarks) :]:
        warnings.warn(words, stacklevel=2)
    if len(hand.ways) > 1:
        raise InputError(
            "the turns of the flange can be read in several ways, and there is no image that "
            "shows which one it is",
            code="conflicting-keys",
            remedy="add the images, or state the turns as quaternions qw, qx, qy, qz",
        )
    return Dataset.from_arrays(hand.readings, poses=hand.poses)


def _hand(poses: Sequence[Path], mechanism: Mechanism) -> Hand:
    describe = (lambda _: _bare(mechanism)) if mechanism.joints else None
    # Cameras that were calibrated alone have no hand whose positions were read.
    read = {*BEGIN}.isdisjoint(mechanism.pose_constants)
    return hand_of(poses, describe, None, Path(), unturned=read)


def _bare(mechanism: Mechanism) -> Robot:
    """The robot as calibrated, without its instruments and its model error."""
    table = mechanism_table(mechanism)
    values = table.pop("parameters")
    for beyond in ("instrument", "effect", "structure", "same"):
        table.pop(beyond, None)
    names = mechanism_from_data(table, mechanism.name).parameters.names
    table["parameters"] = {name: values[name] for name in names if name in values}
    joints = tuple(mechanism.joints)
    return Robot(table, len(joints), joints)


def refuse_unknown_eye(eye: str, eyes: Collection[str]) -> None:
    """Raise InputError for a camera that is not in the calibration."""
    if eye not in eyes:
        raise InputError(
            f"the camera {eye!r} is not in the calibration",
            code="unknown-name",
            remedy=f"its cameras are {listed(list(eyes), 5)}",
        )


def refuse_another(stated: Board, usual: Mapping[str, Board], *, whole: bool = False) -> None:
    """Raise InputError for a board whose points are not those of the calibration.

    whole: where points that were not stated are absent.
    """
    board = usual.get(stated.name)
    if board is None:
        raise InputError(
            f"the calibration has no board {stated.name!r}",
            code="unknown-name",
            remedy=f"its boards are {listed(list(usual), 5)}",
        )
    for point, at in board.points.items():
        other = stated.points.get(point)
        if other is None and not whole:
            continue
        if other is None or np.linalg.norm(np.subtract(other, at)) > SAME * max(board.half):
            where = "absent" if other is None else f"at ({_mm(other)}) mm"
            raise InputError(
                f"the point {point!r} of the board {stated.name!r} is {where}; the calibration has "
                f"it at ({_mm(at)}) mm",
                code="conflicting-keys",
                remedy="use the board of the calibration and its description, or calibrate anew "
                "with this one",
            )


def _mm(point: Sequence[float]) -> str:
    return ", ".join(f"{1e3 * value:.6g}" for value in point)

"""Other ways to number the points of a board: what detectors and users confuse."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.cameras.corners import Corners
from loopcal.mechanisms.cameras.board import Board

Indices = NDArray[np.intp]


@dataclass(frozen=True)
class Order:
    """A way to number: its name and, for each label, the point that it really is; -1 for none."""

    name: str
    point: Indices


def consistent_orders(board: Board) -> list[Order]:
    """Orders that change the shape: visible in every single image."""
    n = len(board.points)
    k = np.arange(n)
    orders = [
        Order("numbers begin at 1, not at 0", np.where(k > 0, k - 1, -1)),
        Order("numbers begin at 0, not at 1", np.where(k < n - 1, k + 1, -1)),
    ]
    grid = _Grid.of(board)
    if grid is None:
        return orders
    nx, ny = grid.shape
    if nx > 1 and ny > 1 and nx != ny:
        orders.append(Order("numbers run along columns, not along rows", grid.at(k // ny, k % ny)))
    if all("." in name for name in board.points):
        along = grid.at(k % nx, k // nx)
        orders.append(Order("numbers run along whole rows, not tag by tag", along))
    shift = np.where(grid.y % 2 == 0, 1, -1)
    for sign in (1, -1):
        name = "alternate rows are displaced by a column, as of a legacy pattern"
        orders.append(Order(name, grid.at(grid.x + sign * shift, grid.y)))
    return orders


def image_orders(board: Board) -> list[Order]:
    """Orders that a single image cannot show by itself, beside those that it can."""
    grid = _Grid.of(board)
    if grid is None:
        return consistent_orders(board)
    nx, ny = grid.shape
    x, y = nx - 1 - grid.x, ny - 1 - grid.y
    orders = [
        Order("turned by 180 degrees", grid.at(x, y)),
        Order("rows reversed", grid.at(grid.x, y)),
        Order("columns reversed", grid.at(x, grid.y)),
    ]
    if nx == ny:
        orders += [
            Order("turned by 90 degrees", grid.at(y, grid.x)),
            Order("turned by 270 degrees", grid.at(grid.y, x)),
            Order("rows and columns exchanged", grid.at(grid.y, grid.x)),
        ]
    return [*orders, *consistent_orders(board)]


def on_other_squares(board: Board) -> Board | None:
    """The board with its markers on the squares that they leave free, in the same order.

    OpenCV before 4.6 printed ChArUco boards with an even number of rows so. None where points are
    not the corners of markers on every other square.
    """
    xyz = board.xyz
    if not board.planar:
        return None
    levels = [np.unique(np.round(xyz[:, i], 9)) for i in (0, 1)]
    if any(len(one) < 4 or len(one) % 2 for one in levels):
        return None
    # Both sides of a marker are two levels; the next square begins with the third.
    ranks = [np.searchsorted(one, np.round(xyz[:, i], 9)) // 2 for i, one in enumerate(levels)]
    pitch = [float(one[2] - one[0]) for one in levels]
    squares = list(dict.fromkeys(zip(ranks[1].tolist(), ranks[0].tolist(), strict=True)))
    columns, rows = (len(one) // 2 for one in levels)
    downwards = squares[0][0] > squares[-1][0]

    def order(square: tuple[int, int]) -> tuple[int, int]:
        return (-square[0] if downwards else square[0], square[1])

    parity = {(row + column) % 2 for row, column in squares}
    free = [(r, c) for r in range(rows) for c in range(columns) if {(r + c) % 2} != parity]
    if len(parity) != 1 or len(free) != len(squares) or squares != sorted(squares, key=order):
        return None
    other = dict(zip(squares, sorted(free, key=order), strict=True))
    points = {}
    for i, (name, (x, y, z)) in enumerate(board.points.items()):
        row, column = int(ranks[1][i]), int(ranks[0][i])
        to_row, to_column = other[row, column]
        points[name] = (x + (to_column - column) * pitch[0], y + (to_row - row) * pitch[1], z)
    return replace(board, points=points)


def renumbered(corners: Corners, orders: dict[int, Order]) -> Corners:
    """Corners in other orders by board; those without a point are left out."""
    point = corners.point.copy()
    for board, order in orders.items():
        mine = corners.board == board
        point[mine] = order.point[corners.point[mine]]
    return corners.numbered(np.maximum(point, 0)).where(point >= 0)


def mirrored(corners: Corners) -> Corners:
    """The same corners on boards whose z is reversed."""
    boards = tuple(
        Board(b.name, {name: (x, y, -z) for name, (x, y, z) in b.points.items()})
        for b in corners.boards
    )
    return replace(corners, boards=boards)


@dataclass(frozen=True)
class _Grid:
    """Columns x and rows y of the points of a full grid."""

    x: Indices
    y: Indices

    @classmethod
    def of(cls, board: Board) -> _Grid | None:
        xyz = board.xyz
        if not board.planar:
            return None
        x, y = (np.unique(np.round(xyz[:, i], 9), return_inverse=True)[1] for i in (0, 1))
        grid = cls(np.asarray(x, dtype=np.intp), np.asarray(y, dtype=np.intp))
        nx, ny = grid.shape
        return grid if nx * ny == len(xyz) and min(nx, ny) > 1 else None

    @property
    def shape(self) -> tuple[int, int]:
        return int(self.x.max()) + 1, int(self.y.max()) + 1

    def at(self, x: Indices, y: Indices) -> Indices:
        """The points at columns x and rows y; -1 outside."""
        nx, ny = self.shape
        index = np.full((nx, ny), -1, dtype=np.intp)
        index[self.x, self.y] = np.arange(len(self.x))
        inside = (x >= 0) & (x < nx) & (y >= 0) & (y < ny)
        return np.where(inside, index[np.clip(x, 0, nx - 1), np.clip(y, 0, ny - 1)], -1)

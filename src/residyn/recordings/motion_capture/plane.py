"""The table's plane, and a chain's angles in it.

All joints move parallel to the table, each at its own height. So the plane's normal is the
direction in which no marker moves; where they move too little to tell, it is taken that they are
equally high. Angles grow anticlockwise as seen from the lab axis that the normal is nearest to, and
are counted from the lab's x axis (from y if the table stands across x).
"""

from typing import NamedTuple

import numpy as np

from ...errors import InputError

_LEVEL = 0.02  # how far heights may differ, of the arm's size, before the motion is looked at
_FAR_OFF = 8.0  # standard deviations off the plane at which a reading is not one of the arm's
_SEAM = 0.15  # where a joint's typical angle is cut, rad beyond a half turn: at no usual value


class Plane(NamedTuple):
    """An orthonormal frame, the last axis off the table."""

    x: np.ndarray
    y: np.ndarray
    normal: np.ndarray
    tilt: float = 0.0  # standard deviation of the normal's direction, rad

    def flat(self, joints: np.ndarray) -> np.ndarray:
        """(..., 2) m, of positions (..., 3) m."""
        return joints @ np.stack([self.x, self.y], axis=1)

    def height(self, joints: np.ndarray) -> np.ndarray:
        """(...) m along the normal, of positions (..., 3) m."""
        return joints @ self.normal


def frame_of(normal: np.ndarray, tilt: float = 0.0) -> Plane:
    """The plane of this normal, whose length does not matter."""
    normal = normal / np.linalg.norm(normal)
    along = np.eye(3)[1 if np.abs(normal).argmax() == 0 else 0]
    x = along - (along @ normal) * normal
    x = x / np.linalg.norm(x)
    return Plane(x, np.cross(normal, x), normal, tilt)


def fit(joints: np.ndarray, noise: float) -> Plane:
    """The plane that joints (N, n + 1, 3) m move in, NaN where lost; `noise` of a coordinate, m."""
    size = float(np.nanmedian(np.linalg.norm(np.diff(joints, axis=1), axis=2)))
    # A few readings off the table, before they are known as such, may spoil one start.
    found = [_settle(joints, noise, size, level * size) for level in (_LEVEL, 0.01 * _LEVEL)]
    normal, _, tilt = min(found, key=lambda each: each[1])
    return frame_of(normal * np.sign(normal[np.abs(normal).argmax()]), tilt)


def _settle(
    joints: np.ndarray, noise: float, size: float, level: float
) -> tuple[np.ndarray, float, float]:
    """A normal, how badly it fits and its error, from a first guess of how far heights differ."""
    first, normal, cost, tilt = noise, np.zeros(3), 0.0, 0.0
    keep = ~np.isnan(joints[:, :, 0])
    middle = np.nanmedian(joints, axis=0)
    for _ in range(10):
        moved = (joints - middle)[keep]
        centre = middle - middle.mean(axis=0)
        # Of the squares, not of all the rows: three by three.
        within = moved.T @ moved / noise**2
        spread, axes = np.linalg.eigh(within + centre.T @ centre / level**2)
        if not spread[1] > 1e-12 * spread[2]:
            raise InputError(
                "these markers stay on one straight line, which lies in many planes: give normal, "
                "the direction off the table"
            )
        normal = axes[:, 0]
        # By the motion alone, apart from what heights may be.
        loose = np.linalg.eigvalsh(within + centre.T @ centre / (_LEVEL * size) ** 2)
        tilt = float(max(loose[1] - loose[0], 1e-300) ** -0.5)
        high = joints @ normal
        off = np.abs(high - np.nanmedian(high, axis=0))
        noise = max(1.4826 * float(np.nanmedian(off, axis=0).max()), 1e-7 * size)
        keep = off <= _FAR_OFF * noise  # NaN is not
        # About the means, or noise of the middle would tilt the plane.
        middle = np.nanmean(np.where(keep[:, :, None], joints, np.nan), axis=0)
        # Heights that the motion does not ask for shrink to none; others stay.
        heights = centre @ normal
        uneven = float(np.sqrt(np.mean(heights**2)))
        level = min(max(uneven, 3 * noise / len(joints) ** 0.5), _LEVEL * size)
        cost = float(np.nansum(np.minimum(off / first, _FAR_OFF) ** 2))
        cost += float(np.sum((heights / (_LEVEL * size)) ** 2))
    return normal, cost, tilt


def angles(flat: np.ndarray) -> np.ndarray:
    """(N, n) rad: the first link's absolute angle, and each further one's to the link before it.

    `flat` (N, n + 1, 2) m; NaN where a link's end is lost. No joint jumps by a turn.
    """
    link = np.diff(flat, axis=1)
    absolute = np.arctan2(link[:, :, 1], link[:, :, 0])
    joint = np.concatenate([absolute[:, :1], np.diff(absolute, axis=1)], axis=1)
    for column in joint.T:
        seen = ~np.isnan(column)
        if seen.any():
            column[seen] = np.unwrap(column[seen])
            turns = np.ceil((np.median(column[seen]) - np.pi - _SEAM) / (2 * np.pi))
            column[seen] -= 2 * np.pi * turns
    return joint

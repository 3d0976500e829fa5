"""Marker files of arms that are known, for tests: shares no code with the package."""

import numpy as np


def swinging(rng, joints=2, frames=800, rate=100.0, size=0.2, bend=None):
    """Joint angles of a ring-down about a pose: time, angles (frames, joints) and the pose."""
    t = np.arange(frames) / rate
    pose = rng.uniform(-2.3, 2.3, joints)
    if bend is not None:
        pose[1:] = bend
    q = np.zeros((frames, joints))
    for _ in range(joints):
        w = 2 * np.pi * np.exp(rng.uniform(np.log(0.4), np.log(2.5)))
        wave = np.exp(-rng.uniform(0.005, 0.02) * w * t) * np.cos(w * t)
        q += wave[:, None] * rng.uniform(0.4, 1, joints) * rng.choice([-1, 1], joints) * size
    return t, pose + q, pose


def table(rng, tilt):
    """Axes of a table (columns x, y, normal) that leans by about `tilt` rad, its normal near z."""
    axis = rng.normal(size=3)
    axis[2] = 0.0
    k = axis / np.linalg.norm(axis)
    cross = np.array([[0, -k[2], k[1]], [k[2], 0, -k[0]], [-k[1], k[0], 0]])
    return np.eye(3) + np.sin(tilt) * cross + (1 - np.cos(tilt)) * cross @ cross


def placed(angle, lengths, axes=None, origin=(0.3, -0.8, 0.9), heights=None):
    """(frames, joints + 1, 3) m: where the joints of an arm are."""
    axes = np.eye(3) if axes is None else axes
    absolute = np.cumsum(angle, axis=1)
    flat = np.zeros((len(angle), len(lengths) + 1, 3))
    for i, length in enumerate(lengths):
        step = np.stack([np.cos(absolute[:, i]), np.sin(absolute[:, i])], axis=1)
        flat[:, i + 1, :2] = flat[:, i, :2] + length * step
    if heights is not None:
        flat[:, :, 2] = heights
    return flat @ axes.T + np.asarray(origin)


def vicon(
    position,
    names,
    *,
    rate=100,
    unit="mm",
    between=",",
    decimal=".",
    subject="Arm:",
    newline="\n",
    before="",
    after="",
    tail="",
    first=1,
):
    """The text of a Vicon CSV file; NaN becomes empty cells."""
    scale, digits = {"mm": (1e3, 4), "cm": (1e2, 5), "m": (1.0, 7)}[unit]
    c = between
    head = [
        "Trajectories",
        f"{rate:g}",
        c * 2 + (c * 3).join(subject + name for name in names) + c * 2,
        c.join(["Frame", "Sub Frame", *["X", "Y", "Z"] * len(names)]),
        c * 2 + c.join([unit] * (3 * len(names))),
    ]
    rows = []
    for i, row in enumerate(position.reshape(len(position), -1)):
        cells = ["" if x != x else f"{x * scale:.{digits}f}".replace(".", decimal) for x in row]
        rows.append(c.join([str(first + i), "0", *cells]) + tail)
    return newline.join([*([before] if before else []), *head, *rows, ""]) + after

"""The demo: a recording that ships with the package, and where along it a model fails.

A spring-and-damper model of the shipped recording looks good on a plot and is wrong all the same.
What shows it is the residual, window by window, in units of the noise: a model that lacks nothing
leaves 1 everywhere.
"""

import contextlib
import importlib.resources
import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .errors import InputError
from .files import make_folder, write

if TYPE_CHECKING:
    from .fitting.result import RecordingFit

HIDDEN = "coulomb_friction:elbow"
"""The effect that the recording was made with, beside springs and dampers."""


EXAMPLES = {
    "release": ("demo", "experiment.toml", "residyn diagnose"),
    "driven": ("driven", "driven.toml", "residyn inertia"),
    "bearings": (
        "bearings",
        "bearings.toml",
        "residyn unload --with bearing_drag --with bearing_friction",
    ),
    "pendulum": ("pendulum", "pendulum.toml", "residyn diagnose"),
}
"""By name: the folder of the package's data, the experiment, the command for it."""


def write_example(name: str, folder: Path) -> list[Path]:
    """Write a shipped example into a folder, which is made if need be.

    **Returns:** the files, the experiment first.

    **Raises:** `InputError` for a file that is there already, or cannot be written.
    """
    home, experiment, _ = EXAMPLES[name]
    source = importlib.resources.files("residyn") / "data" / home
    files = sorted((f.name for f in source.iterdir() if f.is_file()), key=lambda f: f != experiment)
    for file in files:
        if os.path.lexists(folder / file):
            raise InputError(f"{folder / file}: is there already; choose another folder")
    make_folder(folder)
    for file in files:
        write(folder / file, (source / file).read_bytes())
    return [folder / file for file in files]


@contextlib.contextmanager
def experiment_file() -> Iterator[Path]:
    """The shipped experiment as a file, wherever and however the package is installed."""
    folder = importlib.resources.files("residyn") / "data" / "demo"
    with importlib.resources.as_file(folder) as here:
        yield here / "experiment.toml"


def by_window(beside: "RecordingFit", count: int = 8) -> tuple[np.ndarray, np.ndarray]:
    """The residual over equal windows of time, in units of the noise.

    **Returns:** the windows' edges, (count + 1,) s; the rms residual over the noise, (count, n),
    NaN in a window without readings.
    """
    time = beside.recording.time
    edges = np.linspace(time[0], time[-1], count + 1)
    window = np.clip(np.searchsorted(edges, time, side="right") - 1, 0, count - 1)
    unit = np.where(beside.used, beside.residual / beside.recording.noise, 0.0)
    square, readings = np.zeros((2, count, unit.shape[1]))
    np.add.at(square, window, unit**2)
    np.add.at(readings, window, beside.used)
    return edges, np.sqrt(square / np.where(readings > 0, readings, np.nan))

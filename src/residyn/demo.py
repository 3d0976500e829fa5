"""The demo and the other examples that ship with the package."""

import contextlib
import importlib.resources
import os
from collections.abc import Iterator
from pathlib import Path

from .errors import InputError
from .files import make_folder, write

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

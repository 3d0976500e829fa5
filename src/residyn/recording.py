"""Recordings and experiments: what was measured, on what, and whether it makes sense.

A `Recording` is one run of readings, cut to the part that counts, with the sigma of one reading. An
`Experiment` is the inertia of the thing that moved, and its recordings; `load` reads one from a
TOML file and the files it names, whatever their format. Nothing here knows a model. Everything
wrong with a file or an argument raises `InputError` with one clear line; whatever is merely
doubtful is a warning.
"""

import dataclasses
import os
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from . import motion_capture
from ._arrays import (
    check_drive,
    check_enough,
    check_noise,
    check_table,
    doubtful_clock,
)
from ._columns import Joints, Layout
from ._csv import read_csv, write_csv
from ._doubts import in_degrees, not_held_out
from ._input import InputError, decode, flag, inside, number, quote, read_text
from ._lab_files import has_markers, read_table
from ._noise import estimate_noise, noise_and_doubts
from ._release import _even, release_time, window
from ._rest import SWINGS, rest_angles, swings, thinned
from ._sanity import not_free
from ._tables import ArmTable, Bearing, InertiaTable, check_bearings
from ._toml import check_role, parse
from ._wild import wild_samples
from .integrators import integrator_of

if TYPE_CHECKING:
    from .mechanism import AbstractMechanism

__all__ = [
    "ArmTable",
    "Bearing",
    "Experiment",
    "InertiaTable",
    "InputError",
    "Recording",
    "estimate_noise",
    "load",
    "read_csv",
    "release_time",
    "wild_samples",
    "write_csv",
]


@dataclass(frozen=True, eq=False)
class Recording:
    """One run of readings. Make it with `Recording.from_arrays`, which checks and cuts it."""

    name: str
    """File name as the experiment has it, or as given."""
    time: np.ndarray
    """(N,) s, strictly increasing, on the recording's own clock."""
    angle: np.ndarray
    """(N, n) rad or m; NaN where a sample was lost."""
    drive: np.ndarray | None
    """(N, n) N m or N, or None for free motion."""
    noise: np.ndarray
    """(n,) sigma of one reading, rad or m."""
    noise_given: bool
    """False where the noise was estimated from the data."""
    theta2: float = 0.0
    """Elbow angle at rest, rad (arm only)."""
    role: str = "fit"
    """"fit", "check" or "inertia"."""
    air_bearings: bool = True
    """Whether the bearings were on."""
    extra_mass: float = 0.0
    """Load on the first coordinate, kg (constant inertia only)."""
    warnings: tuple[str, ...] = ()
    """What is doubtful, a line each that names the recording."""
    whole: "Recording | None" = None
    """What this is a stretch of, if it is one."""
    understood: str = ""
    """What was made of a file that is not written as this package writes it, in one line."""

    @classmethod
    def from_arrays(
        cls,
        time: Any,
        angle: Any,
        *,
        drive: Any = None,
        noise: Any = None,
        theta2: float = 0.0,
        role: str = "fit",
        name: str = "recording",
        start: float | str | None = None,
        stop: float | None = None,
        air_bearings: bool = True,
        extra_mass: float = 0.0,
        rest: Any = None,
    ) -> "Recording":
        """Check a recording, cut it from `start` to `stop`, estimate its noise if not given.

        **Arguments:**

        - `time`: (N,) s, strictly increasing.
        - `angle`: (N,) or (N, n) rad or m; NaN where a sample was lost.
        - `drive`: shaped as `angle`, N m or N; NaN is interpolated over.
        - `noise`: sigma of one reading, a number or one per joint.
        - `start`, `stop`: s on the recording's own clock; `start` may be "release", the instant
          from which the motion is free.
        - `rest`: where the joints rest, (n,) rad or m, which is taken off; "estimate" finds it in
          the ringing. None is zero.
        - the others: the fields of the same name.
        """
        name = str(name)
        with inside(name):
            time, angle = check_table(time, angle)
            force, warnings = check_drive(drive, time, angle)
            part = window(time, angle, start, stop)
            time, angle = time[part], angle[part]
            force = None if force is None else force[part]
            check_enough(angle, part=start is not None or stop is not None)
            warnings += doubtful_clock(time)
            understood = ""
            if rest is not None:
                off, doubts = _rest(rest, time, angle)
                angle, warnings = angle - off, warnings + doubts
                each = ", ".join(f"q{j + 1} {x:.5g}" for j, x in enumerate(off))
                understood = f"rest at {each}, taken off" if off.any() else ""
            if noise is None:
                sigma, doubts = noise_and_doubts(time, angle)
            else:
                sigma = check_noise(noise, angle.shape[1])
                still = np.nanmax(angle, axis=0) == np.nanmin(angle, axis=0)
                doubts = [
                    f"q{j + 1} never moves: all its readings are the same"
                    for j in np.flatnonzero(still)
                ]
            for array in (time, angle, force, sigma):
                if array is not None:
                    array.flags.writeable = False
            return cls(
                name=name,
                time=time,
                angle=angle,
                drive=force,
                noise=sigma,
                noise_given=noise is not None,
                theta2=number("theta2", theta2, "rad"),
                role=check_role(role),
                air_bearings=flag("air_bearings", air_bearings),
                extra_mass=number("extra_mass", extra_mass, "kg", least=0),
                warnings=tuple(f"{name}: {warning}" for warning in [*warnings, *doubts]),
                understood=understood,
            )

    def saying(self, doubts: Iterable[str]) -> "Recording":
        """The same recording with further warnings, each given its name."""
        said = tuple(f"{self.name}: {doubt}" for doubt in doubts)
        return dataclasses.replace(self, warnings=(*self.warnings, *said))

    @property
    def duration(self) -> float:
        """From the first sample to the last, s."""
        return float(self.time[-1] - self.time[0])

    @property
    def joints(self) -> int:
        """How many joints were read."""
        return self.angle.shape[1]

    @property
    def lost(self) -> int:
        """How many readings were lost, all joints together."""
        return int(np.count_nonzero(np.isnan(self.angle)))


@dataclass(frozen=True, eq=False)
class Experiment:
    """The inertia of what moved, and its recordings."""

    inertia: "ArmTable | InertiaTable | AbstractMechanism"
    """A table, or a mechanism of your own: it is then as it is in every recording."""
    recordings: tuple[Recording, ...]
    bearings: tuple[Bearing, ...] = ()
    path: str = ""
    integrator: Any = None
    """What integrates in every fit: a `residyn.Integrator` or what makes one; None: fixed steps."""

    def __post_init__(self):
        object.__setattr__(self, "integrator", integrator_of(self.integrator))
        object.__setattr__(self, "recordings", tuple(self.recordings))
        object.__setattr__(self, "bearings", tuple(self.bearings))
        check_bearings(self.inertia, self.bearings)
        for recording in self.recordings:
            if recording.joints != len(self.joints):
                raise InputError(
                    f"{recording.name}: angle has {recording.joints} joints, the experiment has "
                    f"{len(self.joints)}: {', '.join(self.joints)}"
                )

    @property
    def joints(self) -> tuple[str, ...]:
        """One name per coordinate."""
        return self.inertia.joints

    @property
    def units(self) -> tuple[str, ...] | None:
        """ "rad" or "m" per joint, or None if not known."""
        return self.inertia.units

    @property
    def fit_recordings(self) -> tuple[Recording, ...]:
        """Those with role "fit"."""
        return tuple(r for r in self.recordings if r.role == "fit")

    @property
    def check_recordings(self) -> tuple[Recording, ...]:
        """Those with role "check": held out, never fitted, always scored."""
        return tuple(r for r in self.recordings if r.role == "check")

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is doubtful in the recordings, and in their fitting together."""
        own = [line for recording in self.recordings for line in recording.warnings]
        return (*own, *in_degrees(self), *not_held_out(self))


def load(path: str | os.PathLike[str]) -> Experiment:
    """Read an experiment from a TOML file and the files of recordings it names.

    These are CSV, MATLAB or Parquet files of angles, or files of markers. They are looked for in
    the TOML file's folder; if `path` is "-", the TOML is read from standard input and they are
    looked for in the current folder.

    **Raises:** `InputError`, a single line, for whatever is wrong with the files.
    """
    if os.fspath(path) == "-":
        where, folder = "standard input", Path()
        data = getattr(sys.stdin, "buffer", sys.stdin).read()
        text = decode(data, where, "TOML file") if isinstance(data, bytes) else data
    else:
        where, folder = os.fspath(path), Path(path).parent
        text = read_text(path, "TOML file")
    return from_text(text, folder, where, os.fspath(path))


def from_text(text: str, folder: Path, where: str, path: str = "") -> Experiment:
    """An experiment from the text of its file, `where` being its name; recordings are looked for in
    `folder`.

    **Raises:** as `load`.
    """
    contents = parse(text, where)
    with inside(where):
        recordings = []
        for i, entry in enumerate(contents.recordings):
            with inside(f"[[recordings]] {i + 1}"):
                recordings.append(_read(folder, contents.inertia, **entry))
        return Experiment(
            contents.inertia,
            tuple(recordings),
            contents.bearings,
            path,
            contents.integrator,
        )


def _read(
    folder: Path, inertia: ArmTable | InertiaTable, *, file: str, **options: Any
) -> Recording:
    """One `[[recordings]]` table's recording."""
    path, drive = folder / file, None
    given = {key: options.pop(key, None) for key in ("columns", "units", "separator", "decimal")}
    marked = has_markers(path)
    if marked:
        for key, value in (given | {"rest": options.get("rest")}).items():
            if value is not None:
                raise InputError(f"{file}: {key} does not go with markers; leave it out")
        recording = _from_markers(path, inertia, name=file, **options)
    else:
        for key in ("markers", "normal"):
            if key in options:
                raise InputError(
                    f"{file}: {key} is for files of markers, C3D or what Vicon exports as CSV; "
                    "this is neither"
                )
        with inside(file):
            layout = Layout(**given)
        table = read_table(path, Joints(inertia.joints, inertia.units), layout)
        time, angle, drive = table.time, table.angle, table.drive
        recording = Recording.from_arrays(time, angle, drive=drive, name=file, **options)
        said = "; ".join(filter(None, [table.understood, recording.understood]))
        recording = dataclasses.replace(recording, understood=said)
        odd = not_free(recording, inertia.units, table.stated, options)
        if odd is not None and recording.role != "inertia":
            raise InputError(f"{file}: {odd.words}")
    if recording.role == "inertia" and drive is None:
        columns = ", ".join(f"u{j + 1}" for j in range(recording.joints))
        raise InputError(f'{file}: role = "inertia" needs the drive that moved it, as {columns}')
    if isinstance(inertia, ArmTable) and "theta2" not in options and not marked:
        doubt = "theta2, the elbow's angle at rest, is not given; 0 rad is taken"
        recording = recording.saying([doubt])
    return recording


def _rest(rest: Any, time: np.ndarray, angle: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """(n,) angles at rest, given or found, and what is doubtful of them."""
    n = angle.shape[1]
    if rest != "estimate" or not isinstance(rest, str):
        values = rest.tolist() if hasattr(rest, "tolist") else rest
        if not isinstance(values, list | tuple) or len(values) != n:
            raise InputError(
                f'rest = {quote(rest)}: must be "estimate", or {n} number{"s" * (n > 1)} (rad or '
                "m), one for each joint, in a list"
            )
        return np.array([number("rest", x, "rad or m") for x in values]), []
    check_enough(angle, part=False)
    count = swings(time, angle)
    doubt = (
        f"with {count:.2g} swings of the slowest mode its rest is known roughly: if the residual "
        "has an offset, fit sensor_offset too"
    )
    return rest_angles(*thinned(*_even(time, angle))), [doubt] if count < SWINGS else []


def _from_markers(
    path: Path,
    inertia: ArmTable | InertiaTable,
    *,
    markers: Any = None,
    normal: Any = None,
    **options: Any,
) -> Recording:
    """The recording in a file of markers; what was mended in it is among its warnings."""
    if "m" in (inertia.units or ()):
        raise InputError(f"{options['name']}: markers give angles, but a joint is in m")
    lengths = inertia.link_lengths if isinstance(inertia, ArmTable) else None
    seen = motion_capture.read(path, markers, normal=normal, link_lengths=lengths)
    return seen.recording(**options)

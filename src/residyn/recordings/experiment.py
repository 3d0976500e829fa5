"""An experiment: the inertia of what moved, and its recordings; `load` reads one from its files.

The TOML file says what free motion cannot tell, and names the recordings, whatever their format.
"""

import dataclasses
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError, inside, quote
from ..files import decode, read_stream, read_text
from ..physics.mechanism import AbstractMechanism
from ..simulation.integrator import integrator_of
from .columns import Joints, Layout
from .formats import has_markers, is_named_as_recording, read_table
from .limits import Limits
from .motion_capture.angles import read as read_markers
from .reads import READS, check_reads, reading_units
from .recording import Recording
from .sanity import in_degrees, not_free, off_rest_alike
from .segments import by_recording
from .tables import ArmTable, Bearing, InertiaTable, check_bearings
from .toml import parse


@dataclass(frozen=True, eq=False)
class Experiment:
    """The inertia of what moved, and its recordings.

    **Raises:** `TypeError` for what is no inertia or no recording, `InputError` for recordings that
    do not go with it or with each other, and for angles that seem to be in degrees.
    """

    inertia: ArmTable | InertiaTable | AbstractMechanism
    """A table, or a mechanism of your own: it is then as it is in every recording, and one that
    states another pose or load is refused."""
    recordings: tuple[Recording, ...]
    bearings: tuple[Bearing, ...] = ()
    path: str = ""
    integrator: Any = None
    """What integrates in every fit: a `residyn.Integrator` or what makes one; None: fixed steps."""
    limits: Limits | None = None
    """Within which the next tests may be planned (`residyn.plan`)."""

    def __post_init__(self):
        object.__setattr__(self, "integrator", integrator_of(self.integrator))
        object.__setattr__(self, "recordings", tuple(self.recordings))
        object.__setattr__(self, "bearings", tuple(self.bearings))
        if not isinstance(self.inertia, ArmTable | InertiaTable | AbstractMechanism):
            raise TypeError(
                f"{quote(self.inertia)} is no inertia: residyn.ArmTable, residyn.InertiaTable or a "
                "mechanism is"
            )
        for recording in self.recordings:
            if not isinstance(recording, Recording):
                raise TypeError(
                    f"{type(recording).__name__} is no recording: residyn.Recording.from_arrays "
                    "makes one of arrays"
                )
        check_bearings(self.inertia, self.bearings)
        _check_stated(self.inertia, self.recordings)
        if self.limits is not None:
            arm = isinstance(self.inertia, ArmTable)
            self.limits.check(self.joints, arm, bool(self.bearings))
        runs = self._runs
        for recording in self.recordings:
            if recording.joints != len(self.joints):
                raise InputError(
                    f"{recording.name}: angle has {recording.joints} joints, the experiment has "
                    f"{len(self.joints)}: {', '.join(self.joints)}"
                )
            own = runs.get((recording.segment_of or recording).name, ())
            if recording.role == "fit" and set(recording.own) != set(own):
                raise InputError(
                    f"{recording.name}: own is {quote(list(recording.own))} in one recording of "
                    f"this name and {quote(list(own))} in another, but a run has one set of "
                    "numbers: give both the same, or put a run of its own into a file of its own"
                )
            first = self._braked[0] if self._braked else recording
            if recording.role != "inertia" and recording.orders != first.orders:
                raise InputError(
                    f"{recording.name}: reads is not as in {first.name}: recordings that are "
                    "fitted together read the same of each joint"
                )
            # A part of a recording may lie farther from rest than nearly all of it.
            if recording.segment_of is not None:
                continue
            hint = 'if it is in rad, stated = ["{}"] of its recording says so'
            units = reading_units(self.units, recording.orders)
            large = in_degrees(recording, units, recording.stated, hint)
            if large is not None:
                raise InputError(f"{recording.name}: {large.words}")

    @property
    def joints(self) -> tuple[str, ...]:
        """One name per coordinate."""
        return self.inertia.joints

    @property
    def units(self) -> tuple[str, ...] | None:
        """ "rad" or "m" per joint, or None if not known."""
        return self.inertia.units

    @property
    def reading_units(self) -> tuple[str, ...]:
        """ "rad", "m/s", ...: of what was read of each joint, "" where it is not known."""
        n = len(self.joints)
        orders = self._braked[0].orders if self._braked else (0,) * n
        return reading_units(self.units, orders) or ("",) * n

    @property
    def fit_recordings(self) -> tuple[Recording, ...]:
        """Those with role "fit"."""
        return tuple(r for r in self.recordings if r.role == "fit")

    @property
    def _braked(self) -> tuple[Recording, ...]:
        return tuple(r for r in self.recordings if r.role != "inertia")

    @property
    def check_recordings(self) -> tuple[Recording, ...]:
        """Those with role "check": held out, never fitted, always scored."""
        return tuple(r for r in self.recordings if r.role == "check")

    @property
    def own(self) -> dict[str, tuple[tuple[int, str], ...]]:
        """Effect (`name:place`) -> the runs, (number, name), that have its numbers for themselves.

        A run's number is 1, 2, ... among the recordings that have anything of their own.
        """
        found: dict[str, list[tuple[int, str]]] = {}
        for number, name in enumerate(self._runs, 1):
            for label in self._runs[name]:
                found.setdefault(label, []).append((number, name))
        return {label: tuple(runs) for label, runs in found.items()}

    def owning(self, labels: Sequence[str]) -> "Experiment":
        """The same, but that only these effects' numbers may be a run's own."""
        if not self.own:
            return self

        def left(r: Recording) -> Recording:
            own = [x for x in labels if any(f"{x}:".startswith(f"{words}:") for words in r.own)]
            return dataclasses.replace(r, own=tuple(own))

        return dataclasses.replace(self, recordings=tuple(map(left, self.recordings)))

    def run_of(self, recording: Recording) -> int:
        """The number of a recording's run; 0 if it has nothing of its own."""
        name = (recording.segment_of or recording).name
        return 1 + list(self._runs).index(name) if name in self._runs else 0

    @property
    def _runs(self) -> dict[str, tuple[str, ...]]:
        return {(r.segment_of or r).name: r.own for r in self.recordings if r.own}

    @property
    def understood(self) -> tuple[str, ...]:
        """What was made of a lab's own files, and found in them, a line each."""
        return tuple(f"{r.name}: {r.understood}" for r in self.recordings if r.understood)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is doubtful in the recordings, and in their fitting together."""
        own = [line for recording in self.recordings for line in recording.warnings]
        return (*own, *_in_another_unit(self), *_not_held_out(self), *_twice(self), *_no_load(self))


def _check_stated(inertia: Any, recordings: Sequence[Recording]) -> None:
    """**Raises:** `InputError` for a recording in another pose, or loaded otherwise, than `inertia`
    is in all of them. Markers give an angle at rest to whatever they are on: it is a pose only of
    an arm."""
    for key, table, fixed in (
        ("theta2", "residyn.ArmTable", hasattr(inertia, "theta2")),
        ("extra_mass", "residyn.InertiaTable", not isinstance(inertia, InertiaTable)),
        ("load", "a table of inertia", isinstance(inertia, AbstractMechanism)),
    ):
        stated = [getattr(recording, key) for recording in recordings]
        # 0 is what is not stated, unless another recording states something else.
        if not fixed or not any(stated):
            continue
        own = float(getattr(inertia, key, 0.0))
        for recording, value in zip(recordings, stated, strict=True):
            if not np.isclose(value, own):  # a mechanism may be in single precision
                raise InputError(
                    f"{recording.name}: {key} = {value:g}, but {type(inertia).__name__} has "
                    f"{own:g} in every recording; {table} takes each recording's own"
                )


def must_be_experiment(given: Any) -> None:
    """**Raises:** `TypeError` for what is no experiment, such as the path of its file."""
    if not isinstance(given, Experiment):
        raise TypeError(
            f"{quote(given)} is no experiment: residyn.load reads one from its file, "
            "residyn.Experiment makes one of recordings"
        )


def load(path: str | os.PathLike[str]) -> Experiment:
    """Read an experiment from a TOML file and the files of recordings it names.

    These are CSV, MATLAB or Parquet files of angles, or files of markers. They are looked for in
    the TOML file's folder; if `path` is "-", the TOML is read from standard input and they are
    looked for in the current folder.

    **Raises:** `InputError`, a single line, for whatever is wrong with the files.
    """
    if os.fspath(path) == "-":
        where, folder = "standard input", Path()
        data = read_stream(getattr(sys.stdin, "buffer", sys.stdin), where, "TOML file")
        text = data if isinstance(data, str) else decode(data, where, "TOML file")
    else:
        where, folder = os.fspath(path), Path(path).parent
        if is_named_as_recording(path) and Path(path).is_file():
            what = f'name it in an experiment file, as file = "{Path(path).name}"'
            if Path(path).suffix.lower() == ".csv" and not has_markers(path):
                what = f"`residyn new experiment.toml {where}` writes an experiment file for it"
            raise InputError(f"{where}: is a recording and no experiment; {what}")
        text = read_text(path, "TOML file")
    return from_text(text, folder, where, os.fspath(path))


def from_text(text: str, folder: Path, where: str, path: str = "") -> Experiment:
    """An experiment from the text of its file, `where` being its name; recordings are looked for in
    `folder`.

    **Raises:** as `load`.
    """
    fields, entries = parse(text, where)
    with inside(where):
        recordings = []
        for i, entry in enumerate(entries):
            with inside(f"[[recordings]] {i + 1}"):
                recordings.append(_read(folder, fields["inertia"], **entry))
        settled = {"rest", "reads", "markers", "normal"}
        free = [  # from their release on
            r for r, entry in zip(recordings, entries, strict=True)
            if r.drive is None and r.role != "inertia" and not settled & entry.keys()
            and entry.get("start", "release") == "release"
        ]  # fmt: skip
        if len(free) > 1 and (words := off_rest_alike(free)) is not None:
            raise InputError(words)
        return Experiment(**fields, recordings=tuple(recordings), path=path)


def _read(
    folder: Path, inertia: ArmTable | InertiaTable, *, file: str, **options: Any
) -> Recording:
    """One `[[recordings]]` table's recording."""
    path, drive = folder / file, None
    given = {key: options.pop(key, None) for key in ("columns", "units", "separator", "decimal")}
    marked = has_markers(path)
    if marked:
        for key, value in (given | {key: options.get(key) for key in ("rest", "reads")}).items():
            if value is not None:
                raise InputError(f"{file}: {key} does not go with markers; leave it out")
        if "m" in (inertia.units or ()):
            raise InputError(f"{file}: markers give angles, but a joint is in m")
        normal, lengths = options.pop("normal", None), getattr(inertia, "link_lengths", None)
        markers = options.pop("markers", None)
        seen = read_markers(path, markers, normal=normal, link_lengths=lengths)
        recording = seen.recording(name=file, **options)
    else:
        for key in ("markers", "normal"):
            if key in options:
                raise InputError(
                    f"{file}: {key} is for files of markers, C3D or what Vicon exports as CSV; "
                    "this is neither"
                )
        with inside(file):
            layout = Layout(**given)
            kinds = check_reads(options.get("reads", "angle"), len(inertia.joints))
        orders = tuple(map(READS.index, kinds))
        table = read_table(path, Joints(inertia.joints, inertia.units, orders), layout)
        angle, drive = table.angle, table.drive
        recording = Recording.from_arrays(
            table.time, angle, drive=drive, name=file, stated=table.stated, **options
        )
        said = "; ".join(filter(None, [table.understood, recording.understood]))
        recording = dataclasses.replace(recording, understood=said)
        odd = not_free(recording, reading_units(inertia.units, orders), table, options)
        if odd is not None:
            raise InputError(f"{file}: {odd.words}")
        still = drive is None and not (np.nanmax(angle, 0) > np.nanmin(angle, 0)).any()
        if still and recording.role == "fit":
            raise InputError(f"{file}: no joint moves: all readings of each are the same")
    if recording.role == "inertia" and drive is None:
        columns = ", ".join(f"u{j + 1}" for j in range(recording.joints))
        raise InputError(f'{file}: role = "inertia" needs the drive that moved it, as {columns}')
    if isinstance(inertia, ArmTable) and "theta2" not in options and not marked:
        doubt = "theta2, the elbow's angle at rest, is not given; 0 rad is taken, stretched out"
        recording = recording.saying([doubt])
    return recording


def _in_another_unit(experiment: Experiment) -> list[str]:
    """Doubts about the unit of readings: no braked joint slides by five metres, and who counts an
    elbow's rest in radians seldom takes more than half a turn."""
    doubts = []
    for recording, _ in by_recording(experiment.recordings):
        sizes = zip(recording.sizes, experiment.reading_units, strict=True)
        for j, (size, unit) in enumerate(sizes, 1):
            if unit == "m" and f"q{j}" not in recording.stated and size > 5:
                seen = f"{recording.name}: q{j} reaches {size:.3g}"
                doubts.append(f"{seen}: in mm? it must be in m")
        if abs(recording.theta2) > np.pi:
            seen = f"{recording.name}: theta2 = {recording.theta2:g}"
            doubts.append(f"{seen}: in degrees? it must be in rad")
    return doubts


def _not_held_out(experiment: Experiment) -> list[str]:
    """A check on readings that were fitted is none."""
    warnings = []
    for check, _ in by_recording(experiment.check_recordings):
        for fit, _ in by_recording(experiment.fit_recordings):
            _, i, j = np.intersect1d(check.time, fit.time, return_indices=True)
            same = np.array_equal(check.angle[i], fit.angle[j], equal_nan=True)
            if check.name == fit.name and len(i) and same:
                warnings.append(
                    f'{check.name}: {len(i)} of its samples have role = "check" and are fitted too'
                )
    return warnings


def _twice(experiment: Experiment) -> list[str]:
    """Readings that are fitted twice seem to be known better than they are."""
    first: dict[tuple[bytes, bytes], int] = {}
    fitted = [r for r, _ in by_recording(experiment.fit_recordings)]
    warnings = []
    for i, r in enumerate(fitted):
        same = first.setdefault((r.time.tobytes(), r.angle.tobytes()), i)
        if same != i:
            what = f"has the readings of {fitted[same].name}, so that they"
            if fitted[same].name == r.name:
                what = "is listed twice, so that its readings"
            warnings.append(f"{r.name}: {what} are fitted twice: errors come out too small")
    return warnings


def _no_load(experiment: Experiment) -> list[str]:
    """Where some recordings state what presses their friction, and others do not."""
    seen = by_recording(experiment.recordings)
    stated = [r.name for r, _ in seen if r.load > 0]
    return [
        f"{r.name}: load is not given, as it is for {stated[0]}; 0 N is taken"
        for r, _ in seen
        if stated and not r.load > 0
    ]

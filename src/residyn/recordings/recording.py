"""A recording: one run of readings, checked, cut to the part that counts, with its noise.

Nothing here knows a model. Everything wrong with an argument raises `InputError` with one clear
line; whatever is merely doubtful is a warning.
"""

import dataclasses
import functools
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ..errors import InputError, did_you_mean, entries, flag, inside, number, quote
from .arrays import check_drive, check_enough, check_noise, check_table, clock_warnings
from .bandwidth import independent
from .noise import noise_and_warnings
from .outliers import outlier_mask
from .reads import READS, angles_from, check_reads
from .release import window
from .resampling import block_means
from .rest import estimated_rest

ROLES = ("fit", "check", "inertia")
MOST = 100_000
"""Instants of a recording: where there are more, means of some after each other are taken. That
leaves dozens for each period of anything that swings less than a thousand times."""


class Extent(NamedTuple):
    """How far and how fast each joint moves, (n,) rad or m, and per second."""

    rms: np.ndarray  # about the middle of its range of values
    largest: np.ndarray  # distance from that middle which one reading in a hundred exceeds
    rate: np.ndarray  # highest sustained rate, from differences above the noise


@dataclass(frozen=True, eq=False)
class Recording:
    """One run of readings. Make it with `Recording.from_arrays`, which checks and cuts it."""

    name: str
    """File name as the experiment has it, or as given."""
    time: np.ndarray
    """(N,) s, strictly increasing, on the recording's own clock."""
    angle: np.ndarray
    """(N, n) readings, rad or m, or a derivative of that (`reads`); NaN where one is missing."""
    drive: np.ndarray | None
    """(N, n) N m or N, or None for free motion."""
    noise: np.ndarray
    """(n,) sigma of one reading, in its unit."""
    noise_given: bool
    """False where the noise was estimated from the data."""
    theta2: float = 0.0
    """Elbow angle at rest, rad, 0 being stretched out (arm only)."""
    role: str = "fit"
    """"fit", "check" or "inertia"."""
    air_bearings: bool = True
    """Whether the bearings were on."""
    extra_mass: float = 0.0
    """Load on the first coordinate, kg m^2 (kg if it slides; constant inertia only)."""
    load: float = 0.0
    """What presses a load-dependent friction, N."""
    own: tuple[str, ...] = ()
    """Effects, `name:place`, whose numbers this recording has for itself."""
    reads: tuple[str, ...] = ()
    """(n,) what was read of each joint: "angle", "rate" or "acceleration"; () is angles."""
    warnings: tuple[str, ...] = ()
    """What is doubtful, a line each that names the recording."""
    segment_of: "Recording | None" = None
    """What this is a segment of, if it is one."""
    understood: str = ""
    """What was found in it (release, rest), and made of a file that is not written as this package
    writes it, in one line."""
    stated: frozenset[str] = frozenset()
    """Columns, "t", "q1", ..., whose unit is stated and not to be doubted."""
    rest_estimated: bool = False
    """Whether the rest that was taken off its readings is an estimate from them."""

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
        load: float = 0.0,
        own: Sequence[str] = (),
        rest: Any = None,
        reads: Any = "angle",
        stated: Collection[str] = (),
    ) -> "Recording":
        """Check a recording, cut it from `start` to `stop`, estimate its noise if not given.

        **Arguments:**

        - `time`: (N,) s, strictly increasing.
        - `angle`: (N,) or (N, n) rad or m; NaN where one is missing.
        - `reads`: "angle", "rate" (`angle` is in rad/s or m/s) or "acceleration" (rad/s^2, m/s^2),
          for all joints, or a list with one for each.
        - `drive`: shaped as `angle`, N m or N; NaN is interpolated over.
        - `noise`: sigma of one reading, a number or one per joint.
        - `start`, `stop`: s on the recording's own clock; `start` may be "release", the instant
          from which the motion is free.
        - `rest`: where the joints rest, (n,) rad or m, which is taken off; "estimate" finds it in
          the ringing. None is zero. Of a rate or an acceleration it is the sensor's own zero.
        - `stated`: columns, "t", "q1", ..., whose unit is known and not to be doubted, as of joints
          that turn by more than 5 rad.
        - the others: the fields of the same name.
        """
        name = str(name)
        with inside(name):
            time, angle = check_table(time, angle)
            kinds = check_reads(reads, angle.shape[1])
            if role == "inertia" and set(kinds) != {"angle"}:
                raise InputError('reads: role = "inertia" needs angles')
            force, warnings = check_drive(drive, time, angle)
            part = window(time, angle, start, stop)
            time, angle = time[part], angle[part]
            understood = [f"release found at {time[0]:g} s"] if isinstance(start, str) else []
            force = None if force is None else force[part]
            check_enough(angle, part=start is not None or stop is not None)
            warnings += [] if "t" in stated else clock_warnings(time)
            many = -(-len(time) // MOST)
            if many > 1:
                warnings.append(
                    f"has {len(time)} samples: means of {many} are taken, which leaves "
                    f"{len(time) // many}; if the arm swings faster than they tell, cut it with "
                    "start and stop"
                )
                # Not of outliers, which would be in their means.
                angle = np.where(outlier_mask(time, angle), np.nan, angle)
                time, angle = block_means(time, many), block_means(angle, many)
                force = None if force is None else block_means(force, many)
            every, cut_off = independent(time, angle) if force is None else (1, np.inf)
            if every > 1:
                warnings.append(
                    f"its readings were low-pass filtered, at about {cut_off:.2g} Hz: one of "
                    f"{every} is taken, for those between say nothing new"
                )
                time, angle = time[::every], angle[::every]
            if rest is not None:
                off, more = _rest(rest, time, angle)
                angle, warnings = angle - off, warnings + more
                each = ", ".join(f"q{j + 1} {x:.5g}" for j, x in enumerate(off))
                understood += [f"rest at {each}, taken off"] if off.any() else []
            if noise is None:
                sigma, more = noise_and_warnings(time, angle)
            else:
                sigma = check_noise(noise, angle.shape[1]) / many**0.5
                still = np.nanmax(angle, axis=0) == np.nanmin(angle, axis=0)
                more = [
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
                extra_mass=number("extra_mass", extra_mass, "kg m^2 or kg", least=0),
                load=number("load", load, "N", least=0),
                own=check_own(own, role),
                reads=kinds,
                warnings=tuple(f"{name}: {warning}" for warning in [*warnings, *more]),
                understood="; ".join(understood),
                stated=frozenset(stated),
                rest_estimated=isinstance(rest, str),
            )

    def saying(self, warnings: Iterable[str]) -> "Recording":
        """The same recording with further warnings, each given its name."""
        said = tuple(f"{self.name}: {warning}" for warning in warnings)
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
    def orders(self) -> tuple[int, ...]:
        """(n,) which derivative of its angle was read of each joint."""
        return tuple(map(READS.index, self.reads)) or (0,) * self.joints

    @functools.cached_property
    def as_angles(self) -> "Recording":
        """The recording with integrals of what was read as derivatives (`reads.angles_from`), for
        first guesses and typical sizes; itself where angles were read."""
        if not any(self.orders):
            return self
        if self.segment_of is not None:
            whole = self.segment_of.as_angles
            first = int(np.searchsorted(whole.time, self.time[0]))
            angle, noise = whole.angle[first : first + len(self.time)], whole.noise
        else:
            angle = angles_from(self.time, self.angle, self.orders)
            # As large beside its motion as the noise of the readings beside theirs.
            sizes = [np.nanstd(x, axis=0) for x in (angle, self.angle)]
            noise = self.noise * sizes[0] / np.maximum(sizes[1], 1e-300)
            noise = np.where(noise > 0, noise, self.noise)
        return dataclasses.replace(self, angle=angle, noise=noise, reads=())

    @functools.cached_property
    def extent(self) -> Extent:
        """How far and how fast it moves; of angles, whatever was read."""
        here = self.as_angles
        off = [x[np.isfinite(x)] for x in here.angle.T]
        off = [np.abs(x - np.median(x)) if len(x) else np.zeros(1) for x in off]
        rms = np.array([np.sqrt(np.mean(x**2)) for x in off])
        largest = np.array([np.quantile(x, 0.99) for x in off])
        lag = min(4, len(here.time) - 1)
        moved = np.abs(here.angle[lag:] - here.angle[:-lag])
        moved = np.maximum(moved - 4 * here.noise, 0.0)
        rates = moved / (here.time[lag:] - here.time[:-lag])[:, None]
        rates[~np.isfinite(rates)] = 0.0
        return Extent(rms, largest, np.quantile(rates, 0.99, axis=0))

    @functools.cached_property
    def outliers(self) -> np.ndarray:
        """(N, n) readings that sit far off their neighbours (`outlier_mask`)."""
        found = outlier_mask(self.time, self.angle, self.noise)
        found.flags.writeable = False
        return found

    @functools.cached_property
    def sizes(self) -> np.ndarray:
        """(n,) distance from 0 that one reading in a hundred exceeds, outliers apart."""
        return np.nanquantile(np.abs(np.where(self.outliers, np.nan, self.angle)), 0.99, axis=0)

    @property
    def lost(self) -> int:
        """How many readings are missing, all joints together."""
        return int(np.count_nonzero(np.isnan(self.angle)))


def _rest(rest: Any, time: np.ndarray, angle: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """(n,) angles at rest, given or found, and what is doubtful of them."""
    n = angle.shape[1]
    if not (isinstance(rest, str) and rest == "estimate"):
        many = f"{n} number{'s' * (n > 1)} (rad or m), one for each joint, in a list"
        values = entries("rest", rest, f'"estimate", or {many}', n)
        return np.array([number("rest", x, "rad or m") for x in values]), []
    check_enough(angle, part=False)
    return estimated_rest(time, angle)


def check_role(role: Any) -> str:
    """`role`, if it is one."""
    if not isinstance(role, str) or role not in ROLES:
        line = f"role = {quote(role)}: must be {' or '.join(map(quote, ROLES))}"
        raise InputError("; ".join(filter(None, [line, did_you_mean(str(role), ROLES)])))
    return role


def check_own(own: Any, role: str) -> tuple[str, ...]:
    """`own`, if it is a list of effects, and the recording is one that tells their numbers."""
    if not isinstance(own, list | tuple) or not all(isinstance(x, str) for x in own):
        raise InputError(
            f'own = {quote(own)}: must be a list of effects, as ["coulomb_friction:elbow"]'
        )
    if own and role != "fit":
        raise InputError(
            f"own = {quote(list(own))}: with role = {quote(role)} nothing tells its own numbers; "
            "leave own out"
        )
    return tuple(own)

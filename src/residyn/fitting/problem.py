"""An experiment as a least-squares problem: what is unknown, and everything that is not.

The unknowns are the model's numbers, shared by all recordings, and each recording's own initial
state, which nobody measured. The rest is chosen once, before the search begins: the bodies that
each recording saw, the integration step, the scales in which the unknowns are of order one, and
first guesses of the states. A `Fit` carries its problem.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple, TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ..effects import AbstractEffect, check_own, effects_named
from ..effects.own_numbers import with_own
from ..errors import InputError, inside, quote
from ..physics.bearings import without_bearings
from ..physics.effect import BASE
from ..physics.inertia import AbstractInertia
from ..physics.mechanism import AbstractMechanism, ConstantInertia, PlanarArm
from ..physics.modal import fastest, ringing
from ..physics.model import Model, changed, check_model
from ..physics.motion import split
from ..physics.parameter import Scales, all_floating
from ..recordings.experiment import Experiment
from ..recordings.recording import Recording
from ..recordings.segments import by_recording
from ..recordings.tables import ArmTable
from ..runtime.export_cache import kept
from ..simulation.integrator import Integrator, integrator_of
from .layout import AnyArray, Recorded, bucket, lay_out, read_of

_Bodies = TypeVar("_Bodies", bound=AbstractInertia)

# Step of a fit times fastest angular frequency: good to 1e-6 of the amplitude, far below any noise.
_STEP = 0.4
_ROUGH_STEP = 0.2
# A driven motion is as quick as its drive, whatever the modes: samples per step at most.
_SAMPLES_DRIVEN = 5
# Room for steps comes in powers of this, from this up, and room for readings: few compilations;
# what is not used costs little.
_ROOMS = 4, 2048
_INSTANTS = 8, 4096
_MANY = 32


class Unknowns(NamedTuple):
    """What a fit moves: (P,) numbers of the model and (R, s) initial states (q0, v0, z0), where z0
    are the internal states beyond what their effects begin with."""

    numbers: Float[AnyArray, " P"]
    states: Float[AnyArray, "R s"]

    def local(self) -> Float[AnyArray, "R L"]:
        """Each recording's own unknowns: the numbers, then its state."""
        here = np if isinstance(self.numbers, np.ndarray) else jnp
        numbers = here.broadcast_to(self.numbers, (len(self.states), len(self.numbers)))
        return here.concatenate([numbers, self.states], axis=1)


class Problem(eqx.Module):
    """A model, its recordings and the scales in which the unknowns are of order one.

    How many integration steps a recording takes is an input like any other, so that one compiled
    program serves slow arms and fast ones; only the `room` for them is compiled in.
    """

    model: Model
    recorded: Recorded
    scale: Unknowns
    active: Float[AnyArray, " P"]  # 1 for a number that the fit moves, 0 for one it must keep
    steps: Int[AnyArray, ""]  # M, of every recording
    tighter: Float[AnyArray, ""]  # what the tolerances of an integrator are divided by
    room: int = eqx.field(static=True)  # at least M
    # Whether M is `room`, compiled in: what reverse mode asks for.
    fixed: bool = eqx.field(static=True, default=False)
    # What integrates instead of fixed steps; M are then the nodes that it leaves behind.
    integrator: Integrator | None = eqx.field(static=True, default=None)

    def numbers(self, y: Unknowns) -> Float[AnyArray, " P"]:
        """The model's numbers, in their own units, at scaled unknowns."""
        # NumPy where nothing is traced: JAX would compile each of these operations by itself.
        here = np if isinstance(y.numbers, np.ndarray) else jnp
        kept = here.asarray(self.model.vector())
        moved = self.scale.numbers * y.numbers
        return here.where(self.active > 0, moved, kept)

    def stepped(self, y: Unknowns, step: Unknowns) -> Unknowns:
        """Scaled unknowns after a step of a descent: a retraction (Absil, Mahony and Sepulchre,
        Optimization Algorithms on Matrix Manifolds, 2008, ch. 4), to first order their sum.

        What a law does grows with its strength and with its shape at the same time, so that what
        readings tell is often a product of the two, and the valley of the cost a hyperbola, which
        straight steps follow slowly. In logarithms it is straight. So of laws with a shape numbers
        that physics makes positive step in their logarithm; by straight lines where a step is as
        long as the number, so that one of the wrong sign finds back across zero.
        """
        fitted, here = self.model.fitted, np if isinstance(y.numbers, np.ndarray) else jnp
        shaped = {n.effect for n in fitted if n.meaning.silent is None}
        own = np.array([n.effect in shaped and n.meaning.sign == "positive" for n in fitted])
        ratio = step.numbers / here.where(y.numbers == 0, 1.0, y.numbers)
        small = own & (here.abs(ratio) < 1) & (y.numbers != 0)
        factor = here.exp(here.where(small, ratio, 0.0))
        numbers = here.where(small, y.numbers * factor, y.numbers + step.numbers)
        return Unknowns(numbers, y.states + step.states)

    def states(self, y: Unknowns) -> Float[AnyArray, "R s"]:
        """The initial states, in their own units, at scaled unknowns."""
        return self.scale.states * y.states

    def scaled(self, numbers, states) -> Unknowns:
        """The inverse of `numbers` and `states`."""
        return Unknowns(numbers / self.scale.numbers, states / self.scale.states)


def posed(model: Model, mechanism: AbstractInertia) -> Model:
    """The model on another mechanism: another pose of the arm, or with its bearings off."""
    return changed(model, mechanism=mechanism)


def mechanism_of(experiment: Experiment, recording: Recording) -> AbstractMechanism:
    """The bodies of an experiment as they were in one recording (Eq. 2 and 5)."""
    table = experiment.inertia
    if isinstance(table, ArmTable):
        if table.shoulder is None or table.elbow is None or table.coupling is None:
            raise ValueError(
                "[arm] has no inertias: free motion fixes stiffness and damping only relative to "
                "them (Eq. 9), so measure them first and write them into [arm]"
            )
        arm = PlanarArm(
            table.link_lengths,
            table.shoulder,
            table.elbow,
            table.coupling,
            recording.theta2,
            [sum(b.joint == where for b in experiment.bearings) for where in ("elbow", "wrist")],
            recording.load,
            experiment.run_of(recording),
        )
        if not recording.air_bearings:
            arm = without_bearings(arm, experiment.bearings)  # pyrefly: ignore[bad-argument-type]
        return all_floating(arm)
    if isinstance(table, AbstractMechanism):
        return all_floating(table)
    matrix = np.array(table.matrix, float)
    matrix[0, 0] += recording.extra_mass
    run = experiment.run_of(recording)
    return ConstantInertia(matrix, table.joints, table.units, recording.load, run)


def model_for(mechanism: AbstractMechanism, effects: Sequence[str | AbstractEffect] = ()) -> Model:
    """The base model (a spring and a damper at every joint, Eq. 4) plus effects, all silent.

    **Raises:** `ValueError`, in one line, for an effect that does not exist or is there twice, and
    for a number that is not finite.
    """
    if isinstance(effects, str):
        raise ValueError(f'effects = "{effects}": must be a list, as ["{effects}"]')
    model = Model(mechanism)
    check_own([e for e in effects if isinstance(e, AbstractEffect)], mechanism)
    for effect in (*BASE, *effects):
        named = (
            (effect,) if isinstance(effect, AbstractEffect) else effects_named(effect, mechanism)
        )
        for each in named:
            model = model + all_floating(each)
    check_model(model)
    return model


def richest(mechanisms: Sequence[_Bodies]) -> _Bodies:
    """Of the bodies of several recordings those on which most effects make sense: effects of the
    bearings, or of a load, go with an experiment if any of its recordings had them."""

    def most(mechanism: AbstractInertia) -> tuple[float, float]:
        bearings = float(mechanism.bearings.sum()) if isinstance(mechanism, PlanarArm) else 0.0
        return bearings, float(getattr(mechanism, "load", 0.0))

    return max(mechanisms, key=most)


def identifiable(effect: AbstractEffect, recordings: Sequence[Recording]) -> bool:
    """Whether recordings have as many frequencies as it takes to tell an effect from springs and
    dampers."""
    joints, loads = recordings[0].angle.shape[1], {r.extra_mass for r in recordings}
    return not effect.of_frequency or joints > 1 or len(loads) > 1


def check_identifiable(recordings: Sequence[Recording], effects: Iterable[AbstractEffect]) -> None:
    """**Raises:** `InputError` for an effect that is not `identifiable` from recordings."""
    for effect in effects:
        if recordings and not identifiable(effect, recordings):
            raise InputError(
                f"{effect.name} needs a second joint, or recordings that differ in extra_mass: at "
                "one frequency it is a spring and a damper"
            )


def with_own_numbers(
    effects: Iterable[AbstractEffect], experiment: Experiment, mechanism: AbstractMechanism
) -> tuple[AbstractEffect, ...]:
    """The effects, with numbers of their own for the recordings that ask for it.

    **Raises:** `ValueError`, in one line, for an effect that does not exist, and where no fitted
    recording is left for the shared numbers.
    """
    if experiment.own and isinstance(experiment.inertia, AbstractMechanism):
        raise InputError("own goes with [arm] or [inertia], not with a mechanism of your own")
    sharing = len(by_recording(experiment.fit_recordings))
    runs: dict[str, tuple[tuple[int, str], ...]] = {}
    for words, each in experiment.own.items():
        with inside(": ".join(filter(None, [experiment.path, each[0][1], "own"]))):
            for effect in effects_named(words, mechanism):
                own = tuple(dict.fromkeys([*runs.get(effect.label, ()), *each]))
                if len(own) >= sharing:
                    raise InputError(
                        f"{quote(words)} is in every fitted recording: leave it out of one, which "
                        "the others are compared with"
                    )
                runs[effect.label] = own
    return tuple(with_own(e, runs.get(e.label, ())) for e in effects)


class Ready(NamedTuple):
    """Recordings, the model on each one's bodies, and the resolution that its motion needs."""

    model: Model
    recordings: tuple[Recording, ...]
    mechanisms: tuple[AbstractMechanism, ...]
    integrator: Integrator | None = None  # what integrates instead of fixed steps
    finer: int = 1  # how many times as many steps are taken as usual

    def posed(self, model: Model | None = None) -> list[Model]:
        """The model as each recording saw it."""
        return [posed(model or self.model, m) for m in self.mechanisms]

    @property
    def outliers(self) -> list[np.ndarray]:
        """(N, n) readings of each recording that are far off their neighbours."""
        return [r.outliers for r in self.recordings]

    @property
    def adapts(self) -> bool:
        """Whether what integrates chooses its steps."""
        return self.integrator is not None and self.integrator.adapts

    def problem(
        self,
        begin: Model,
        outliers: Sequence[np.ndarray],
        like: Problem | None = None,
        fixed: bool = False,
        frequency: float | None = None,
    ) -> tuple[Problem, np.ndarray]:
        """The least-squares problem near the model `begin`, and guessed initial states (R, s).

        `like` gives the problem the shapes of another one, so that its compiled program serves;
        `fixed` compiles the number of steps in; `frequency` is `begin`'s, if that is known.
        """
        frequency = self.frequency(begin) if frequency is None else frequency
        steps, scales = self.steps(begin, frequency), self.scales(frequency)
        readings = max(len(r.time) for r in self.recordings)
        room, instants = steps, readings
        if not fixed:
            room = bucket(2 * steps, *_ROOMS)  # twice the steps tell how exact they are
            # What is not there costs little but the room for it, which many recordings lack.
            many = len(self.recordings) > _MANY
            instants = bucket(readings) if many else bucket(readings, *_INSTANTS)
        if like is not None:
            room, instants = max(room, like.room), max(instants, like.recorded.row.shape[-1])
        recorded = lay_out(self.recordings, self.mechanisms, outliers, steps, room, instants)
        pairs = zip(self.recordings, outliers, strict=True)
        states = np.stack([first_state(r, bad, frequency) for r, bad in pairs])
        states = np.pad(states, ((0, 0), (0, len(begin.memory))))
        # A number's size is never zero: its value, or a part of what is typical of its dimension.
        values = np.nan_to_num(np.abs(begin.vector()), posinf=0.0)
        size = self.amplitude
        memory = [m.meaning.dimension.size(scales(m.joint)) for m in begin.memory]
        scale = Unknowns(
            np.maximum(values, 1e-2 * self.typical(scales)),
            np.tile(np.concatenate([size, size * frequency, memory]), (len(states), 1)),
        )
        counts = np.ones(len(begin.fitted)), np.asarray(steps), np.asarray(1.0)
        return Problem(begin, recorded, scale, *counts, room, fixed, self.integrator), states

    @property
    def amplitude(self) -> np.ndarray:
        """(n,) typical angle of each joint, rad or m."""
        each = [np.maximum(r.extent.rms, 3 * r.as_angles.noise) for r in self.recordings]
        return np.max(each, axis=0)

    def frequency(self, begin: Model) -> float:
        """Fastest angular frequency that the integration must follow, rad/s."""
        fast = max((ringing if self.adapts else fastest)(m) for m in self.posed(begin))
        # No mode above the sampling's own limit can have been seen, none below one cycle matters.
        most = max(math.pi / float(np.median(np.diff(r.time))) for r in self.recordings)
        # In a wide swing the angles themselves turn the forces round.
        units = begin.mechanism.units or ("rad",) * len(begin.mechanism.joints)
        rotary = np.array([u == "rad" for u in units])
        turning = max(float(r.extent.rate[rotary].max(initial=0.0)) for r in self.recordings)
        fast = math.hypot(fast, turning) if math.isfinite(fast) else most
        forced = (float(getattr(e, e.oscillates)) for e in begin.effects if e.oscillates)
        fast = max([fast, *(2 * math.pi * abs(f) for f in forced)])
        return min(max(fast, self._slowest), most)

    def steps(self, begin: Model, frequency: float | None = None) -> int:
        """How many integration steps the longest recording needs; `frequency` is `begin`'s."""
        frequency = self.frequency(begin) if frequency is None else frequency
        steps = self.duration * frequency / (_ROUGH_STEP if begin.rough else _STEP)
        for r in self.recordings:
            if r.drive is not None:
                steps = max(steps, len(r.time) * self.duration / r.duration / _SAMPLES_DRIVEN)
        return self.finer * max(16, math.ceil(steps))

    def memory(self, starts: int) -> np.ndarray:
        """(S, R, m) internal states of which nothing is known."""
        return np.zeros((starts, len(self.recordings), len(self.model.memory)))

    def typical(self, scales: Callable[[int | None], Scales] | None = None) -> np.ndarray:
        """(P,) numbers of typical size."""
        scales = scales or self.scales()
        sizes = [n.meaning.dimension.size(scales(n.joint)) for n in self.model.fitted]
        return np.array(sizes, float)

    def scales(self, frequency: float | None = None) -> Callable[[int | None], Scales]:
        """The scales of one joint's motion, or of the last one's for what belongs to none, from the
        amplitudes and rates of the readings alone, or for one angular `frequency`."""
        mechanism, size = self.model.mechanism, self.amplitude
        pace = self.pace if frequency is None else np.full(len(size), frequency)
        swing, reach = np.maximum(self.swing, size), np.array(mechanism.reach())
        each = np.asarray(_inertia(mechanism)), pace, size, reach, swing

        def of(joint: int | None) -> Scales:
            *own, swing = (float(x[-1 if joint is None else joint]) for x in each)
            return Scales(*own, duration=self.duration, swing=swing)

        return of

    @property
    def swing(self) -> np.ndarray:
        """(n,) largest angle of each joint, rad or m."""
        return np.max([r.extent.largest for r in self.recordings], axis=0)

    @property
    def duration(self) -> float:
        """s, of the longest recording."""
        return max(r.duration for r in self.recordings)

    @property
    def pace(self) -> np.ndarray:
        """(n,) typical angular frequency of each joint's motion, rad/s."""
        rate = np.max([r.extent.rate for r in self.recordings], axis=0)
        return np.maximum(rate / np.maximum(self.swing, self.amplitude), self._slowest)

    @property
    def _slowest(self) -> float:
        """Angular frequency of one cycle in the shortest recording, rad/s."""
        return max(2 * math.pi / r.duration for r in self.recordings)


def ready(
    experiment: Experiment, recordings: Sequence[Recording], effects: Sequence[str | AbstractEffect]
) -> Ready:
    """Make recordings of an experiment ready to fit.

    **Raises:** `ValueError` if there are none, and for an effect that does not exist or does not go
    with them.
    """
    if not recordings:
        raise ValueError('no recording has role = "fit": there is nothing to fit to')
    mechanisms = tuple(mechanism_of(experiment, r) for r in recordings)
    most = richest(mechanisms)
    shared = model_for(most, effects).effects
    check_identifiable(experiment.fit_recordings, shared)
    model = Model(mechanisms[0], with_own_numbers(shared, experiment, most))
    _goes_with_readings(model, recordings)
    integrator = integrator_of(experiment.integrator)
    if integrator is not None:
        integrator.check(model)
        integrator.check_forward()
    return Ready(model, tuple(recordings), mechanisms, integrator)


def _goes_with_readings(model: Model, recordings: Sequence[Recording]) -> None:
    """**Raises:** `InputError` for a sensor's offset or curvature where a derivative is read."""
    joints, first = model.mechanism.joints, recordings[0]
    for effect in model.effects:
        if effect.of_angles and first.orders[joints.index(effect.place)]:
            raise InputError(
                f"{effect.label} is of readings of angles, and {first.name} reads something else: "
                'rest = "estimate" takes off the zero of such a sensor'
            )


def reweighted(problem: Problem, outliers: Sequence[np.ndarray]) -> Problem:
    """The problem with outliers (N, n) taken out."""
    weights = np.array(problem.recorded.weights)
    for own, bad in zip(weights, outliers, strict=True):
        own[: len(bad)] *= ~bad
    return eqx.tree_at(lambda p: p.recorded.weights, problem, weights)


def tight(problem: Problem) -> Problem:
    """The problem with hardly more instants than its recordings have, for programs whose cost grows
    with what is there, read or not."""
    recorded = problem.recorded
    few = bucket(int(np.max(recorded.count)))
    if few >= recorded.row.shape[-1]:
        return problem
    return eqx.tree_at(
        lambda p: read_of(p.recorded), problem, [x[:, :few] for x in read_of(recorded)]
    )


@kept(like=0)
def _inertia(mechanism: AbstractMechanism):
    """(n,) the diagonal of the mass matrix with all angles zero."""
    n = len(mechanism.joints)
    matrix = mechanism.mass_matrix(split(jnp.zeros(n)))
    return jnp.stack([jnp.asarray(row[i], float) for i, row in enumerate(matrix)])


def first_state(recording: Recording, outliers: np.ndarray, frequency: float) -> np.ndarray:
    """(q0, v0) from a cubic through the first quarter cycle that was read of each joint."""
    recording = recording.as_angles
    state = []
    for joint in range(recording.angle.shape[1]):
        use = np.flatnonzero(np.isfinite(recording.angle[:, joint]) & ~outliers[:, joint])
        if len(use) < 4:  # of a cubic: a segment without readings
            state.append((0.0, 0.0))
            continue
        # From the first reading on: a cubic led back over lost ones ends anywhere.
        time = recording.time[use] - recording.time[use[0]]
        count = max(8, int(np.searchsorted(time, 1.5 / frequency)))
        use, time = use[:count], time[:count]
        window = time[-1]
        line = np.polynomial.polynomial.polyfit(time / window, recording.angle[use, joint], 3)
        state.append((line[0], line[1] / window))
    return np.concatenate(np.transpose(state))

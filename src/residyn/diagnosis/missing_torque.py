"""The missing torque: what each joint feels that the model does not know of.

    Z(q) q'' + f^w + sum of effect torques + tau = drive torque

Nothing is assumed of tau but a random torque's size and correlation time. The model's numbers are
estimated beside it, so that springs and dampers are not bent to stand in for it, and the motion is
the readings' own: a curve with a band. Against time, angle, rate and amplitude it draws the
signature of what is missing: a step against the rate is dry friction, a bent line against the angle
a spring that is not linear, a loop hysteresis.
"""

import dataclasses
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import jax
import numpy as np

from ..effects import AbstractEffect, SensorOffset
from ..errors import quote
from ..filtering.grid import local_amplitude
from ..filtering.law import number_slices, numbers_of
from ..filtering.trajectory import Scene, Trajectory
from ..fitting.problem import ready
from ..physics.mechanism import AbstractMechanism
from ..physics.model import Model
from ..physics.parameter import parameters_of
from ..recordings.experiment import Experiment
from ..recordings.recording import Recording
from .tried import Tried, tried_alone

CURVES = 2
"""Of rivals, drawn beside a missing torque."""


class Curve(NamedTuple):
    """What an effect would draw over the missing torque."""

    effect: str
    """`name` or `name:place`."""
    share: float
    """Of the missing torque's mean square, over all recordings and joints, the share that it
    explains, 0 to 1."""
    values: dict[str, tuple[float, str]]
    """Its numbers: value and unit."""
    torque: np.ndarray
    """(N, n) N m: its own torque, at the times of the missing torque."""
    changed: np.ndarray
    """(N, n) N m: what changes of the model's other numbers add to it."""


@dataclass(frozen=True, eq=False)
class MissingTorque:
    """What one recording's joints feel beside the model: N instants of n joints."""

    time: np.ndarray
    """(N,) s, on the recording's own clock."""
    angle: np.ndarray
    """(N, n) smoothed angle, rad or m."""
    rate: np.ndarray
    """(N, n) smoothed rate, rad/s or m/s."""
    torque: np.ndarray
    """(N, n) N m or N, positive where it resists, like an effect's."""
    std: np.ndarray
    """(N, n) its standard error: the 95 % band is 1.96 of it to either side."""
    amplitude: np.ndarray
    """(N, n) local amplitude of the angle about where it rests, rad or m."""
    rms: np.ndarray
    """(n,) rms of the torque, N m or N: the root of its mean square's expected value, which is that
    of the estimate's square and its variance."""
    share_of_spring: np.ndarray
    """(n,) `rms` over that of the restoring torque: of springs and of what acts in their place, or
    of Z q'' if the joint has neither."""


class Missing(NamedTuple):
    """What is missing in one recording."""

    recording: str
    units: tuple[str, ...]
    """Of the torque, per joint."""
    joints: tuple[str, ...]
    torque: MissingTorque
    link_angle: np.ndarray | None
    """(N, n) absolute angles of the links, rad; None where the joints do not tell them."""
    curves: tuple[Curve, ...]
    """What effects would draw, the likeliest first."""

    def significant(self, joint: int) -> bool:
        """Whether the torque at a joint is larger than what is not known of it."""
        size = np.sqrt(np.mean(self.torque.torque[:, joint] ** 2))
        return bool(size > np.sqrt(np.mean(self.torque.std[:, joint] ** 2)))

    def curves_at(self, joint: int) -> tuple[Curve, ...]:
        """The curves that act at a joint."""
        if not self.significant(joint):
            return ()
        return tuple(c for c in self.curves if np.any(c.torque[:, joint]))

    def explained(self, curve: Curve, joint: int) -> float:
        """Of the torque's mean square at a joint, the share that a curve explains, 0 to 1."""
        torque = self.torque.torque[:, joint]
        left = torque - curve.torque[:, joint] - curve.changed[:, joint]
        return float(max(0.0, 1.0 - np.mean(left**2) / np.mean(torque**2)))


def missing_torque(
    model: Model, recording: Recording, *, wild: np.ndarray | None = None
) -> MissingTorque:
    """The torque that a model lacks to move as the recording says, with its band.

    Runs in float64 whatever JAX's setting.

    **Arguments:**

    - `model`: on this recording's mechanism, whatever effects it has. Its numbers are estimated
      again, beside the missing torque.
    - `recording`: readings and their noise; samples may be lost or uneven, and the motion driven.
    - `wild`: (N, n) readings to leave out, as from `residyn.recording.wild_samples`.

    **Returns:** a `MissingTorque`.
    """
    with jax.enable_x64(True):
        bad = np.zeros(recording.angle.shape, bool) if wild is None else np.asarray(wild, bool)
        scene = Scene([recording], [model.mechanism], [bad])
        (found,) = torques_of(scene, tried_alone(scene, model.effects))
    return found


def torques_of(
    scene: Scene, model: Tried, pairs: Sequence[tuple[float, Trajectory]] = ()
) -> list[MissingTorque]:
    """The missing torque of each recording of a scene: averaged over the random torque's
    intensities, each by its posterior (`pairs`, if `model.over_torques` is known)."""
    best, pairs = model.best, pairs or model.over_torques(scene)
    weights = np.array([w for w, _ in pairs])
    torques = np.stack([t.torque for _, t in pairs])
    variances = np.stack([t.torque_variance for _, t in pairs])
    mean = -np.tensordot(weights, torques, 1)
    square = np.tensordot(weights, variances + torques**2, 1)
    std = np.sqrt(np.maximum(square - mean**2, 0.0))
    pulled_back = restoring_torque(scene, best)
    g, n, found = scene.grid, scene.n, []
    slowest = 2 * np.pi / min(s.frequency for s in scene.scales)
    for i, recording in enumerate(scene.recordings):
        own = g.of(i)
        time, angle = g.time[own], best.path[own, :n]
        rms, whole = (np.sqrt(np.mean(x[own], axis=0)) for x in (square, pulled_back**2))
        found.append(
            MissingTorque(
                time=time + recording.time[0],
                angle=angle,
                rate=best.path[own, n : 2 * n],
                torque=mean[own],
                std=std[own],
                amplitude=local_amplitude(time, angle, slowest),
                rms=rms,
                share_of_spring=rms / np.where(whole > 0, whole, np.nan),
            )
        )
    return found


def restoring_torque(scene: Scene, t: Trajectory) -> np.ndarray:
    """(K, n) torque of what pulls each joint back, N m: springs, and what acts in their place, as
    gravity does; Z q'' where a joint has neither."""
    linear = scene.linearised(t)
    each = scene.torques(t, linear)
    own = [
        each[e.label] for e in t.effects
        if e.name == "spring" or any(p.as_spring for p in parameters_of(e))
    ]  # fmt: skip
    found = np.sum(own, axis=0) if own else np.zeros((scene.K, scene.n))
    asked = np.asarray(linear.acceleration)[:, : scene.K].T.copy()
    for i, mechanism in enumerate(scene.mechanisms):
        here = scene.grid.run == i
        q = tuple(t.path[here, : scene.n].T)
        rows = Model(mechanism, t.valued()).bodies.mass_matrix(q)
        a = asked[here].T
        asked[here] = np.stack([sum(z * x for z, x in zip(r, a, strict=True)) for r in rows], 1)
    return np.where(np.any(found != 0, axis=0), found, asked)


def curve(scene: Scene, before: np.ndarray, missing: np.ndarray, model: Tried, label: str) -> Curve:
    """What one effect of a model draws over the torque (K, n) that the base model lacks, whose own
    torque is `before`, over all recordings of the scene."""
    t = model.best
    after, index = scene.torques(t), t.labels.index(label)
    own = after.pop(label)
    changed = np.sum([*after.values()], axis=0) - before
    whole, left = (np.sum(x[scene.real] ** 2) for x in (missing, missing - own - changed))
    effect, numbers = t.effects[index], t.numbers[number_slices(t.effects)[index]]
    values = {
        f"{label}.{n.name}": (float(x), scene.unit(effect, n))
        for n, x in zip(numbers_of(effect), numbers, strict=True)
    }
    return Curve(label, float(max(0.0, 1.0 - left / max(whole, 1e-300))), values, own, changed)


def missing_of(
    scene: Scene,
    base: Tried,
    models: Sequence[tuple[Tried, str]] = (),
    pairs: Sequence[tuple[float, Trajectory]] = (),
) -> tuple[Missing, ...]:
    """The missing torque of every recording of a scene, with the curves of some models' effects;
    `pairs` as in `torques_of`."""
    pairs, curves = pairs or base.over_torques(scene), []
    if models:
        missing = -np.sum([w * t.torque for w, t in pairs], axis=0)
        before = np.sum([*scene.torques(base.best).values()], axis=0)
        curves = [curve(scene, before, missing, model, label) for model, label in models]
    g, found = scene.grid, []
    for i, torque in enumerate(torques_of(scene, base, pairs)):
        own = g.of(i)
        try:
            angles = scene.mechanisms[i].link_angles(tuple(torque.angle.T))
            links = np.stack([np.asarray(a) for a in angles], axis=1)
        except ValueError:
            links = None
        cut = tuple(c._replace(torque=c.torque[own], changed=c.changed[own]) for c in curves)
        name = scene.recordings[i].name
        found.append(Missing(name, scene.torque_units, scene.joints, torque, links, cut))
    return tuple(found)


def with_rests(
    experiment: Experiment, effects: Sequence[str | AbstractEffect]
) -> tuple[Experiment, tuple[str | AbstractEffect, ...]]:
    """The experiment and the effects of a base model, to which the zeros of readings belong whose
    rest was estimated: an estimate is off by more than many effects bend a ring-down.

    They are a `sensor_offset` of each joint that reads angles, whose numbers each recording has for
    itself, but one: the numbers that all share are the first recording's, or those of recordings
    whose rest is given.

    **Raises:** `ValueError` for an effect that does not exist or does not go with the experiment.
    """
    fitted = experiment.fit_recordings
    names = dict.fromkeys((r.segment_of or r).name for r in fitted if r.rest_estimated)
    if not names:
        return experiment, tuple(effects)
    known = ready(experiment, fitted, effects).model.labels
    pairs = zip(experiment.joints, fitted[0].orders, strict=True)
    offsets = [f"{SensorOffset.name}:{joint}" for joint, order in pairs if not order]
    offsets = [label for label in offsets if label not in known]
    own = [*names][all(r.rest_estimated for r in fitted) :]
    if own and isinstance(experiment.inertia, AbstractMechanism):  # it tells no run from another
        return experiment, tuple(effects)
    there = tuple(x for x in known if x.partition(":")[0] == SensorOffset.name)

    def owning(r: Recording) -> Recording:
        given = (there if x == SensorOffset.name else (x,) for x in r.own if x not in offsets)
        more = offsets if (r.segment_of or r).name in own else ()
        own_here = (*itertools.chain(*given), *more)
        return dataclasses.replace(r, own=own_here) if r.role == "fit" else r

    recordings = tuple(map(owning, experiment.recordings))
    return dataclasses.replace(experiment, recordings=recordings), (*effects, *offsets)


def owning_base(experiment: Experiment, effects: Sequence[str | AbstractEffect]) -> Experiment:
    """The experiment, but that only numbers of the base model with some effects are a run's own:
    what a search adds has numbers that all recordings share, which a warning says."""
    if not experiment.own:
        return experiment
    labels = ready(experiment, experiment.fit_recordings, effects).model.labels
    found = experiment.owning(labels)

    def saying(given: Recording, left: Recording) -> Recording:
        kept = tuple(f"{label}:" for label in left.own)
        gone = [x for x in given.own if not any(k.startswith(f"{x}:") for k in kept)]
        own, names = ", ".join(map(quote, gone)), " ".join(f"--with {x}" for x in gone)
        words = (
            f"own = [{own}] is of no effect that the model begins with, and what a search adds has "
            f"numbers that all recordings share: {names} begins with it"
        )
        return left.saying([words]) if gone else left

    pairs = zip(experiment.recordings, found.recordings, strict=True)
    return dataclasses.replace(found, recordings=tuple(saying(*pair) for pair in pairs))


def scene_of(
    experiment: Experiment, effects: Sequence[str | AbstractEffect]
) -> tuple[Scene, tuple[AbstractEffect, ...]]:
    """The fitted recordings of an experiment as a scene, and the base model with some effects."""
    here = ready(experiment, experiment.fit_recordings, effects)
    return Scene(here.recordings, here.mechanisms, here.outliers), here.model.effects

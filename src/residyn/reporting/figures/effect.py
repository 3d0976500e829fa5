"""What an effect looks like: the torque that a model without it would miss."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

from ...effects import AbstractEffect, effects_named
from ...fitting.problem import model_for
from ...physics.mechanism import PlanarArm
from ...physics.motion import Motion, stack
from ...physics.parameter import Scales, parameters_of
from ...simulation.simulate import simulate
from ..names import title
from .style import FAINT, MEASURED, MODEL, RESIDUAL, blank, styled

_RELEASE = (0.2, -0.2)
_SECONDS, _RATE = 16.0, 400.0
_EDGE = 4  # samples at the ends where a difference is one-sided
_SCALES = Scales(inertia=0.6, frequency=5.0, amplitude=0.1, swing=0.1, duration=_SECONDS)
# Share of the typical size at which an effect can be seen beside the ringing without burying it.
_STRENGTH = 0.1
_STRONG = {
    "dead_zone": 0.6,
    "brake_slip": 0.6,
    "sensor_delay": 0.1,
    "damper": 0.05,
    "spring": 1.0,
    "coupling_damping": 0.01,  # more, and it feeds the arm faster than its dampers drain it
}


@styled
def signature(name: str, *, narrow: bool = False) -> Figure:
    """What an effect of the catalogue does to the arm of the paper, released at 0.2 rad.

    The torque that springs and dampers alone would miss (for a sensor's error: would seem to miss),
    against time, angle and rate, and the reading with and without the effect.

    **Raises:** `ValueError` for an effect that does not exist.
    """
    with jax.enable_x64(True):
        t, angle, without, rate, torque = _motions(name)
    joint = int(np.argmax(np.sqrt(np.mean(torque**2, axis=0))))
    where = ("shoulder", "elbow")[joint]
    q, v, tau = angle[:, joint], rate[:, joint], torque[:, joint]
    # The smallest range that holds all but the instants of a jump, where a difference overshoots.
    most = 1.15 * float(np.quantile(np.abs(tau), 0.995)) or 1.0
    figure = blank(narrow, 9.0 if narrow else 5.2)
    (top, *rest) = figure.subplots(*((4, 1) if narrow else (2, 2))).ravel()
    top.plot(t, without[:, joint], color=MEASURED, lw=2.2, label="without")
    top.plot(t, q, color=MODEL, lw=0.9, label="with")
    top.set(
        xlabel="time (s)", ylabel="reading (rad)", title=f"{title(name)}: reading at the {where}"
    )
    low, high = top.get_ylim()
    top.set_ylim(low, high + 0.25 * (high - low))  # the legend's own room, above the curves
    top.legend(loc="upper right", ncols=2)
    for ax, x, label in zip(
        rest, (t, q, v), ("time (s)", "angle (rad)", "rate (rad/s)"), strict=True
    ):
        order = "missing torque against " + label.split(" (")[0]
        ax.axhline(0.0, color=FAINT, lw=0.6)
        ax.plot(x, tau, color=RESIDUAL, lw=0.9)
        ax.set(xlabel=label, ylabel="torque (N m)", ylim=(-most, most), title=order)
    return figure


def _motions(name: str):
    """(t, readings with, readings without, and of the former the rate and the missing torque)."""
    arm = PlanarArm([0.4, 0.4], 1.1662, 0.579, 1.4384, 0.3, bearings=[1, 1], load=1.5)
    base = model_for(arm)
    springs = {n.name: 16.67 if n.name.startswith("spring") else 0.05 for n in base.fitted}
    base, effect = base.with_values(springs), effects_named(name, arm)[-1]
    if effect.label in base.labels:  # what is in every model: what is missing without it
        base = base.without(effect.label)
    full = base + _sized(effect)
    t = np.arange(round(_SECONDS * _RATE)) / _RATE
    with_it, without = (
        np.asarray(simulate(m, t, _RELEASE, steps=len(t)).readings) for m in (full, base)
    )
    # What the base model would have to explain; without noise, differences will do.
    v = np.gradient(with_it, 1 / _RATE, axis=0)
    a = np.gradient(v, 1 / _RATE, axis=0)

    def missing(t, q, v, a):
        motion = Motion.at(t, q, v)
        inertial = jnp.asarray(arm.mass_matrix(q)) @ a + stack(arm.inertia_torque(q, v))
        return -inertial - stack(base.torque(motion))

    tau = np.asarray(jax.vmap(missing)(*map(jnp.asarray, (t, with_it, v, a))))
    inner = slice(_EDGE, -_EDGE)
    return tuple(x[inner] for x in (t, with_it, without, v, tau))


def _sized(effect: AbstractEffect) -> AbstractEffect:
    strength = _STRONG.get(effect.name, _STRENGTH)
    values = {}
    for p in parameters_of(effect):
        size = p.dimension.size(_SCALES)
        if p.silent is not None:
            values[p.field] = jnp.asarray(p.silent + strength * size)
        elif p.grid:
            values[p.field] = jnp.asarray(p.grid[(len(p.grid) - 1) // 2] * size)
    return dataclasses.replace(effect, **values)

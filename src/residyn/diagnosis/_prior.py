"""What a missing torque may look like, before the data are asked.

Each joint's torque is a walk of its own plus slowly changing shares of all angles and rates:

    tau_i = w_i + sum over j of a_ij q_j + b_ij q'_j.

The shares are what a wrong spring, damper or coupling leaves, and follow the motion without any
delay or smoothing; the walk is everything else. How much of each there is, is for the likelihood to
say, joint by joint, through *intensities*: of a walk that goes on steadily, of one that goes as the
square of the local amplitude (a torque that dies away with the motion), of one that goes where the
joint turns round (friction jumps there); of lasting shares in the joint's own motion, of lasting
shares in the others', and of shares that wander. Whatever follows the motion may have harmonics too
small to be seen in the noise: so the shares bring a little walk along, lest the band be too sure of
itself.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from ._filter import Walk
from ._grid import Grid

KINDS = 6  # steady, swinging, turning; own, others', wandering

_TURN = 0.1  # of the rate's amplitude: below it a joint is turning round
_FLOOR = 1e-6  # of the mean square amplitude
_HARMONICS = 1.0  # growth of the walk over one radian of the motion, as a share of the shares
# Variance at the first instant of the walk, of own shares and of others', by intensity.
_BEGIN = ((1, 1, 1, 0, 0, 0), (0, 0, 0, 1, 0, 1), (0, 0, 0, 0, 1, 1))


class Prior(NamedTuple):
    """Variances of coefficients per unit intensity."""

    regressor: Float[Array, "M o"]
    growth: Float[Array, "M n p kinds"]  # of the walk, of shares of own motion, of the others'
    begin: Float[Array, "n p kinds"]
    part: Float[Array, "n o p"]  # 1 where a coefficient belongs to this part

    def walk(self, intensity: Float[Array, "n kinds"]) -> Walk:
        """The walk of these intensities."""
        growth = jnp.einsum("nop,knpc,nc->kno", self.part, self.growth, intensity)
        begin = jnp.einsum("nop,npc,nc->no", self.part, self.begin, intensity)
        return Walk(self.regressor, growth, begin)


def prior_along(
    grid: Grid, angle: Float[Array, "M n"], rate: Float[Array, "M n"], unit: Float[Array, " n"]
) -> Prior:
    """The prior for a motion; an intensity of 1 is a torque of size `unit` over the recording."""
    span, n = jnp.sum(grid.step), len(unit)

    def mean(x):
        return jnp.sum(grid.step[:, None] * x, axis=0) / span

    size, speed = jnp.sqrt(mean(angle**2)), jnp.sqrt(mean(rate**2))
    pace = speed / size
    regressor = jnp.concatenate([jnp.ones((len(angle), 1)), angle / size, rate / speed], axis=1)
    swing = jnp.maximum(grid.swing**2 / mean(grid.swing**2), _FLOOR)
    turn = 1.0 / (1.0 + (rate / (_TURN * pace * grid.swing)) ** 2)
    turn = turn / mean(turn)
    h = grid.step[:, None] * unit**2
    even, none = h / span, jnp.zeros_like(h)
    harmonics = 2 * _HARMONICS * pace * swing * h  # of the shares in one joint's angle and rate
    walk = [even, even * swing, even * turn]
    walk += [harmonics, (n - 1) * harmonics, n * harmonics]
    share = [none, none, none, none, none, even]
    growth = jnp.stack([jnp.stack(x, axis=-1) for x in (walk, share, share)], axis=2)
    begin = unit[:, None, None] ** 2 * jnp.asarray(_BEGIN, float)
    own = jnp.tile(jnp.eye(n), (1, 2))
    part = jnp.stack([jnp.zeros_like(own), own, 1.0 - own], axis=-1)
    walks = jnp.zeros((n, 1, 3)).at[:, :, 0].set(1.0)
    return Prior(regressor, growth, begin, jnp.concatenate([walks, part], axis=1))

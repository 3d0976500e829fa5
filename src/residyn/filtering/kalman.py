"""A linear system under a random torque: its Kalman filter, likelihood and smoother.

    x_{k+1} = A x_k + B u + T tau_k + c          x: angles, rates, internal states
    tau_{k+1} = decay tau_k + white noise         random torques, one a joint (Ornstein-Uhlenbeck)
    y_k = Hx x_k + Ht tau_k + Hu u + hc + noise   readings

The regressors u (numbers of the model, each with a unit normal prior) are constant. The filter's
gains do not depend on them, so readings and the response to every regressor are right-hand sides of
one recursion (Rosenberg 1973; de Jong, Annals of Statistics 19, 1991): it leaves whitened
innovations e = w + W u, and with the Gram matrix G of (w, W) the marginal likelihood of the
readings under any subset of the regressors is a small Cholesky factorisation.
"""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ..runtime.export_cache import kept


class System(NamedTuple):
    """K steps of a linear system: X states, n joints, P regressors."""

    A: Any  # (K, X, X)
    B: Any  # (K, X, P)
    T: Any  # (K, X, n)
    c: Any  # (K, X)
    Hx: Any  # (K, n, X)
    Hu: Any  # (K, n, P)
    hc: Any  # (K, n)
    Ht: Any  # (K, n, n)
    unsure: Any  # (K, n) variances of readings beyond their noise


class Readings(NamedTuple):
    """What was read at K instants."""

    y: Any  # (K, n)
    seen: Any  # (K, n) bool
    variance: Any  # (K, n)


class Noise(NamedTuple):
    """The first state, and what drives the system where the random torque has intensity 1; with
    D = X + n. Variances of the random torque go with the square of the intensity."""

    mean: Any  # (X,) first state
    variance: Any  # (D,) its variances, and the random torque's
    decay: Any  # (K, n) of the random torque in each step
    growth: Any  # (K, D) variances added in each step

    def at(self, intensity) -> "Noise":
        """With a random torque of this intensity (rms, in those of intensity 1)."""
        n = self.decay.shape[-1]
        own = jnp.concatenate([jnp.ones(self.mean.shape[0]), jnp.full(n, intensity**2)])
        return self._replace(variance=self.variance * own, growth=self.growth * own)


def _times(A, B) -> Any:
    """A B of small matrices, or A x, as a sum of outer products: XLA makes one vectorised kernel of
    it, five times as fast as its own product of so small matrices."""
    columns = range(A.shape[1])
    if B.ndim == 1:
        return sum(A[:, k] * B[k] for k in columns)
    return sum(A[:, k, None] * B[None, k, :] for k in columns)


class Filtered(NamedTuple):
    """What one pass of the filter leaves at each instant; columns: of the readings, then of each
    regressor (with a minus)."""

    white: Any  # (K, n, 1 + P) whitened innovations
    means: Any  # (K, D, 1 + P) after the readings
    variance: Any  # (K, D, D)
    gains: Any  # (K, n, D)
    S: Any  # (K, n) variances of the innovations
    F: Any  # (K, D, D) transitions


def _filter(system: System, readings: Readings, noise: Noise) -> tuple[Any, Filtered]:
    """Log normaliser -1/2 sum log 2 pi S, and `Filtered`."""
    X, n, P = system.A.shape[-1], system.T.shape[-1], system.B.shape[-1]
    D = X + n
    first = jnp.concatenate([noise.mean, jnp.zeros(n)])[:, None]
    means = jnp.concatenate([first, jnp.zeros((D, P))], 1)

    def step(carry, at):
        M, V, L = carry
        s, r, decay, growth = at
        white, steps, sizes = [], [], []
        for j in range(n):  # a reading after the other: no matrix is inverted
            row = jnp.concatenate([s.Hx[j], s.Ht[j]])
            Vh = _times(V, row)
            S = jnp.sum(row * Vh) + r.variance[j] + s.unsure[j]
            said = jnp.concatenate([(r.y[j] - s.hc[j])[None], -s.Hu[j]])
            new = jnp.where(r.seen[j], said - _times(M.T, row), 0.0)
            gain = jnp.where(r.seen[j], Vh / S, 0.0)
            M, V = M + gain[:, None] * new, V - gain[:, None] * Vh
            white.append(new / jnp.sqrt(S))
            steps.append(gain)
            sizes.append(S)
            L = L - 0.5 * jnp.where(r.seen[j], jnp.log(2 * jnp.pi * S), 0.0)
        V = 0.5 * (V + V.T)
        F = jnp.block([[s.A, s.T], [jnp.zeros((n, X)), jnp.diag(decay)]])
        push = jnp.concatenate([jnp.concatenate([s.c[:, None], s.B], 1), jnp.zeros((n, 1 + P))])
        out = Filtered(jnp.stack(white), M, V, jnp.stack(steps), jnp.stack(sizes), F)
        V = _times(_times(F, V), F.T) + jnp.diag(growth)
        return (_times(F, M) + push, V, L), out

    begin = means, jnp.diag(noise.variance), 0.0
    each = system, readings, noise.decay, noise.growth
    (_, _, L), out = jax.lax.scan(step, begin, each)
    return L, out


class Torques(NamedTuple):
    """Columns as what acts, a third of what they do to a system: torques at each of n joints, then
    of all of them, then what is added to the readings."""

    by_torque: Any  # (K, 3, X, n) how a step answers to torques at its beginning, middle and end
    pushed: Any  # (K, r, n) what torques at its beginning add to the r readings
    joint: tuple[Any, ...]  # of each joint (K, 3, C)
    whole: Any  # (K, 3, n, C)
    sensors: Any  # (K, r, C)

    def torque(self):
        """(K, n, C) at the beginning of each step."""
        at = jnp.eye(len(self.joint))
        parts = [x[:, :1] * at[j, :, None] for j, x in enumerate(self.joint)]
        return jnp.concatenate([*parts, self.whole[:, 0], 0 * self.sensors[:, : len(at)]], -1)

    def inputs(self) -> tuple[Any, Any]:
        """What they do to the system: B (K, X, C) and Hu (K, r, C)."""
        joint = [
            jnp.einsum("kax,kac->kxc", self.by_torque[..., j], x) for j, x in enumerate(self.joint)
        ]
        whole = jnp.einsum("kaxj,kajc->kxc", self.by_torque, self.whole)
        B = jnp.concatenate([*joint, whole], -1)
        acting, C = B.shape[-1], self.sensors.shape[-1]
        B = jnp.pad(B, ((0, 0), (0, 0), (0, C)))
        read = -jnp.einsum("kij,kjc->kic", self.pushed, self.torque())
        return B, read.at[..., acting:].add(self.sensors)


_AT_ONCE = 64  # instants whose columns there are at the same time


@kept(like=(0, 0))
def gram(system: System, more: tuple[Torques, ...], readings: Readings, noise: Noise, intensity):
    """Log normaliser -1/2 sum log 2 pi S, and the Gram matrix (1 + P + C)^2 of the whitened
    innovations: w of the readings, then W of the system's regressors and of C more (e = w + W u).

    The gains come first, of no columns. Along them the next means and the innovations are one
    matrix times the means, and a few instants of columns, of means and of innovations are held at a
    time.
    """
    alone = system._replace(B=system.B[..., :0], Hu=system.Hu[..., :0])
    L, out = _filter(alone, readings, noise.at(intensity))
    K, n, D = out.gains.shape
    C = sum(jax.eval_shape(Torques.inputs, m)[0].shape[-1] for m in more)
    W = 1 + system.B.shape[-1] + C
    H = jnp.concatenate([system.Hx, system.Ht], -1)
    H = jnp.where(readings.seen[..., None], H, 0.0)
    # Means after the readings, and innovations, are linear in the means before and in y, less what
    # is known: from D + n unit columns.
    M, white = jnp.tile(jnp.eye(D, D + n), (K, 1, 1)), []
    for j in range(n):
        new = jnp.eye(D + n)[D + j] - jnp.einsum("ki,kij->kj", H[:, j], M)
        white.append(new / jnp.sqrt(out.S[:, j])[:, None])
        M = M + out.gains[:, j][:, :, None] * new[:, None]
    by = jnp.concatenate([out.F @ M, jnp.stack(white, 1)], 1)  # (K, D + n, D + n)
    by_mean, by_said = by[..., :D], by[..., D:]
    y = jnp.where(readings.seen, readings.y - system.hc, 0.0)
    size = math.gcd(K, _AT_ONCE)

    def part(carry, at):
        M, G = carry
        by_mean, by_said, y, seen, c, B, Hu, more = at
        each = [m.inputs() for m in more]
        push = jnp.concatenate([c[..., None], B, *(x for x, _ in each)], -1)
        read = jnp.concatenate([Hu, *(x for _, x in each)], -1)
        read = jnp.where(seen[..., None], read, 0.0)
        known = by_said @ jnp.concatenate([y[..., None], -read], -1)
        known = known.at[:, : push.shape[1]].add(push)

        def step(M, at):
            by_mean, known = at
            out = by_mean @ M + known
            return out[:D], out[D:]

        M, white = jax.lax.scan(step, M, (by_mean, known))
        white = white.reshape(-1, W)
        return (M, G + white.T @ white), None

    each = by_mean, by_said, y, readings.seen, system.c, system.B, system.Hu, more
    each = jax.tree.map(lambda x: x.reshape(K // size, size, *x.shape[1:]), each)
    M = jnp.zeros((D, W)).at[: len(noise.mean), 0].set(noise.mean)
    (_, G), _ = jax.lax.scan(part, (M, jnp.zeros((W, W))), each)
    return L, G


class Evidences(NamedTuple):
    """A linear system under I random torques, given all readings."""

    log_evidence: Any
    """(I,) log marginal likelihood of the readings, regressors with unit normal priors."""
    regressors: Any  # (I, P) posterior means
    covariance: Any  # (I, P, P)


@kept(like=Evidences(0, 0, 0))
def evidences(system: System, readings: Readings, noise: Noise, intensities) -> Evidences:
    """The evidence of a linear system at each of (I,) intensities of the random torque."""

    def at(intensity):
        L, out = _filter(system, readings, noise.at(intensity))
        evidence, u, factor = _integrated(L, out.white)
        inverse = jax.scipy.linalg.solve_triangular(factor, jnp.eye(len(u)), lower=True)
        return Evidences(evidence, u, inverse.T @ inverse)

    return jax.vmap(at)(intensities)


def _integrated(L, white):
    """Log evidence with the regressors integrated out, their posterior mean, and the Cholesky
    factor of their posterior precision, from whitened innovations (K, n, 1 + P)."""
    white = white.reshape(-1, white.shape[-1])
    gram = white.T @ white
    factor = jnp.linalg.cholesky(gram[1:, 1:] + jnp.eye(len(gram) - 1))
    x = jax.scipy.linalg.solve_triangular(factor, -gram[1:, 0], lower=True)
    u = jax.scipy.linalg.solve_triangular(factor.T, x, lower=False)
    evidence = L - 0.5 * gram[0, 0] + 0.5 * x @ x - jnp.log(jnp.diag(factor)).sum()
    return evidence, u, factor


class Smoothed(NamedTuple):
    """A linear system given all readings, regressors integrated out."""

    log_evidence: Any
    """Log marginal likelihood of the readings, regressors with unit normal priors."""
    regressors: Any  # (P,) posterior mean
    covariance: Any  # (P, P)
    mean: Any  # (K, D) smoothed states, then random torques
    variance: Any  # (K, D) of them, the regressors at their mean


@kept(like=Smoothed(0, 0, 0, 0, 0))
def smooth(system: System, readings: Readings, noise: Noise, intensity) -> Smoothed:
    """The filter, the regressors' posterior, and Bryson and Frazier's smoother at their mean, under
    a random torque of one intensity."""
    L, out = _filter(system, readings, noise.at(intensity))
    evidence, u, factor = _integrated(L, out.white)
    n, D = readings.y.shape[1], out.F.shape[-1]
    H = jnp.concatenate([system.Hx, system.Ht], -1)
    known = jnp.concatenate([jnp.ones(1), u])
    mean, new = out.means @ known, out.white @ known * jnp.sqrt(out.S)
    V, gains, S, F = out.variance, out.gains, out.S, out.F

    def back(carry, at):
        l, Q = carry
        mean, V, F, gains, S, new, H, seen = at
        l, Q = _times(F.T, l), _times(F.T, _times(Q, F))
        out = mean - _times(V, l), jnp.diag(V) - jnp.sum(_times(V, Q) * V, 1)
        for j in reversed(range(n)):
            row, g = jnp.where(seen[j], H[j], 0.0), gains[j]
            l = l - row * (new[j] / S[j] + jnp.sum(g * l))
            # (I - g row)' Q (I - g row) + row row' / S, without a product of matrices.
            Qg = _times(Q, g)
            Q = Q - row[:, None] * Qg - Qg[:, None] * row
            Q = Q + (jnp.sum(g * Qg) + 1.0 / S[j]) * row[:, None] * row
        return (l, Q), out

    end = jnp.zeros(D), jnp.zeros((D, D))
    each = mean, V, F, gains, S, new, H, readings.seen
    _, (mean, variance) = jax.lax.scan(back, end, each, reverse=True)
    covariance = jax.scipy.linalg.cho_solve((factor, True), jnp.eye(len(u)))
    return Smoothed(evidence, u, covariance, mean, variance)

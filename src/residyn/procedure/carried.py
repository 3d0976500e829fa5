"""Errors of steps 1 and 2, carried to the modes.

The modes are a function of the fitted numbers and of the three inertias. The numbers themselves
were fitted with those inertias taken for true, so an error there moves them as well (Eq. 9: all of
them in proportion, if the inertias are wrong in proportion). The implicit function theorem says by
how much: at the best fit J'r = 0, so with A = J'J, d(numbers)/d(inertias) = -A_nn^-1 A_nI.
"""

import dataclasses
import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..fitting import Fit, Mode
from ..fitting.layout import Recorded
from ..fitting.least_squares import predict, whiten
from ..fitting.linalg import PART, Information, information, inverse_of
from ..fitting.problem import Problem, posed
from ..physics.inertia import AbstractInertia
from ..physics.mechanism import PlanarArm
from ..physics.modal import eigenvalues, modes, state_matrix
from ..physics.model import Model

NAMES = ("shoulder", "elbow", "coupling")
MATTERS = 1e-3  # share of a quantity by which a combination that is not seen may move it
_REAL = 1e-9  # share of imaginary part up to which an eigenvalue is real
_AWAY = 1e-6  # share of the fastest eigenvalue from which a real one above zero is not rounding


class Carried(NamedTuple):
    """What the numbers (P,) and the inertias (3,) do not know."""

    numbers: np.ndarray  # (P, P) covariance of the numbers where the recordings see them
    unseen: np.ndarray  # (B, P) combinations that are not seen, as large as their largest number
    inertia: np.ndarray  # (3, 3) covariance of the inertias from step 1, in kg m^2 and kg m
    moved: np.ndarray  # (P, 3) d(numbers)/d(inertias)

    def std(self, value: float, by_number: np.ndarray, by_inertia: np.ndarray) -> float:
        """Standard error of a quantity with these slopes; inf where the recordings leave it open.

        `by_inertia` is its slope with the numbers held.
        """
        open_to = float(np.linalg.norm(self.unseen @ by_number))
        if open_to > MATTERS * abs(value):
            return math.inf
        whole = by_inertia + by_number @ self.moved
        seen = by_number @ self.numbers @ by_number + whole @ self.inertia @ whole
        return float(np.sqrt(seen + open_to**2))


def carried(fit: Fit, inertia: np.ndarray | None) -> Carried:
    """The errors of a fit and of the inertias (3, 3) behind it; None: they are exact."""
    count = len(fit.numbers)
    if inertia is None and np.isfinite(fit.covariance).all():
        # Nothing to be known beyond what the fit says already.
        nothing = np.zeros((0, count)), np.zeros((3, 3)), np.zeros((count, 3))
        return Carried(fit.covariance, *nothing)
    (square, alone), values = _information(fit), np.array([n.value for n in fit.numbers])
    own, cross = square[:count, :count], square[:count, count:]
    inverse, vectors, size, _ = inverse_of(Information(own, alone[:count]))
    # A combination is as large as the largest of its numbers: it may turn all of one into another.
    unseen, members = vectors * size, np.abs(vectors) > PART
    ratios = np.divide(np.abs(values), np.abs(unseen), where=members, out=np.zeros(unseen.shape))
    blind = unseen * np.max(ratios, axis=1, initial=0.0)[:, None]
    known = np.zeros((3, 3)) if inertia is None else inertia
    return Carried(max(1.0, fit.reduced_chi2) * inverse, blind, known, -inverse @ cross)


def _information(fit: Fit) -> Information:
    """What is known at the best fit of the numbers and the inertias."""
    problem, numbers, factors = fit.problem, fit.model.vector(), []
    for i, beside in enumerate(fit.fitted):
        one = jax.tree.map(lambda x, i=i: x[i], problem.recorded)
        slopes = np.asarray(_slopes(problem, one, numbers, jnp.asarray(beside.state)))
        # Memory at the first sample is known to its typical size: a reading like any other.
        memory = len(beside.state) - 2 * len(fit.joints)
        known = np.zeros((memory, slopes.shape[1]))
        if memory:
            known[:, -memory:] = np.diag(1 / np.asarray(problem.scale.states[i, -memory:]))
        factors.append(np.linalg.qr(np.vstack([slopes, known]), mode="r"))
    return information(np.array(factors), len(numbers) + len(NAMES))


@eqx.filter_jit
def _slopes(problem: Problem, one: Recorded, numbers, state):
    """(N, P + 3 + s) derivatives of one recording's whitened residual."""

    def residual(z):
        count = len(numbers)
        mechanism = with_inertias(one.mechanism, z[count : count + 3])
        moved = dataclasses.replace(one, mechanism=mechanism)  # pyrefly: ignore[bad-argument-type]
        predicted = predict(problem, moved, z[:count], z[count + 3 :])
        return whiten(one, predicted).reshape(-1)

    z = jnp.concatenate([numbers, jnp.zeros(3), state])
    return jax.jacfwd(residual)(z)


def inertias(mechanism: AbstractInertia) -> jax.Array:
    """(3,) shoulder, elbow, coupling of an arm."""
    assert isinstance(mechanism, PlanarArm)
    return jnp.stack([mechanism.shoulder, mechanism.elbow, mechanism.coupling])


def with_inertias(mechanism: AbstractInertia, added) -> AbstractInertia:
    """The arm with these (3,) added to its inertias."""
    now = inertias(mechanism) + added
    return eqx.tree_at(lambda a: (a.shoulder, a.elbow, a.coupling), mechanism, tuple(now))


def moved(model: Model, numbers, added) -> Model:
    """The model with these numbers (P,), and these (3,) added to its inertias."""
    return posed(model.with_vector(numbers), with_inertias(model.mechanism, added))


class Rings(NamedTuple):
    """How a model moves about its rest."""

    modes: tuple[Mode, ...]  # those that ring, lowest first
    leaves: bool  # whether it moves away from rest without ringing, as with a negative stiffness


class ModeSlopes(NamedTuple):
    """A mode that rings: frequency (Hz) and damping ratio, and their slopes."""

    values: np.ndarray  # (2,)
    by_number: np.ndarray  # (2, P), inertias held
    by_inertia: np.ndarray  # (2, 3), numbers held


def slopes_of_modes(model: Model, fitted: Model) -> tuple[list[ModeSlopes], np.ndarray]:
    """The modes that ring, lowest first, with slopes in the numbers of the model `fitted`, of which
    `model` may lack some effects; and the state matrix."""
    # Friction of a point in the plane is smoothed near rest: that slope is the integrator's.
    for label in [e.label for e in model.effects if e.grips]:
        model = model.without(label)
    names = [n.name for n in fitted.fitted]
    kept = [names.index(n.name) for n in model.fitted]
    matrix, values, by_number, by_inertia = map(np.asarray, _modes_and_slopes(model))
    slopes = np.zeros((*values.shape, len(names)))
    slopes[..., kept] = by_number
    found = [
        ModeSlopes(values[:, i], slopes[:, i], by_inertia[:, i])
        for i, (frequency, damping) in enumerate(values.T)
        if frequency > 0 and abs(damping) < 1 - 1e-9
    ]
    return found, matrix


def modes_with_errors(model: Model, fitted: Model, errors: Carried) -> Rings:
    """Modes and their errors; `errors` are those of the model `fitted`, of which `model` may lack
    some effects."""
    each, matrix = slopes_of_modes(model, fitted)
    found = []
    for m in each:
        frequency, damping = (
            (float(x), errors.std(float(x), n, i))
            for x, n, i in zip(m.values, m.by_number, m.by_inertia, strict=True)
        )
        found.append(Mode(*frequency, *damping))
    roots = eigenvalues(matrix)
    size = np.abs(roots)
    away = (np.abs(np.imag(roots)) < _REAL * size) & (np.real(roots) > _AWAY * size.max())
    return Rings(tuple(found), bool(away.any()))


@eqx.filter_jit
def _modes_and_slopes(model: Model):
    """State matrix (s, s), frequencies and damping ratios (2, n), and their slopes (2, n, P) and
    (2, n, 3)."""

    def rings(numbers, added):
        return jnp.stack(modes(moved(model, numbers, added)))

    numbers, added = model.vector(), jnp.zeros(3)
    slopes = jax.jacfwd(rings, argnums=(0, 1))(numbers, added)
    return state_matrix(model), rings(numbers, added), *slopes

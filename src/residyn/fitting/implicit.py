"""The fit as a function that JAX can trace: for `jit`, `vmap` and `grad` of whole fits.

`residyn.fit` decides much in Python: where to start, how long a step may be, which readings are
wild. `embed` keeps these decisions of a finished fit and leaves one pure function of arrays: give
it other readings or other bodies, and it descends to their least squares from where that fit stood.

A minimum is differentiated by what it satisfies, not by the way that led to it. At the minimum the
gradient g(y, p) of the cost vanishes, whatever the problem p; so dy/dp = -(dg/dy)^-1 dg/dp, which
takes no memory of the steps (the implicit function theorem).
"""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.flatten_util
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from ..physics.effect import BASE
from ..physics.inertia import AbstractInertia
from ..physics.mechanism import AbstractMechanism
from ..physics.model import Model
from ..physics.parameter import all_floating, stacked
from ..recordings.segments import by_recording
from .least_squares import Compressed, Horizon, compressed, descended, predictions, whiten
from .problem import Problem, Unknowns, posed, ready, tight
from .result import Fit, must_be_fit

_STEPS = 60


class Solution(eqx.Module):
    """Where an embedded fit ended; every field may be differentiated."""

    numbers: Float[Array, " P"]
    """The model's numbers, as `Embedded.names` has them, each in its own unit."""
    states: Float[Array, "R s"]
    """Initial states (q0, v0, z0) of each recording, or of each of its segments."""
    chi2: Float[Array, ""]
    """Sum of squared residuals in units of the noise."""
    covariance: Float[Array, "P P"]
    """Of the numbers, if what is left is white noise of the size stated: (J'J)^-1."""
    converged: Bool[Array, ""]
    steps: Int[Array, ""]
    predicted: Float[Array, "R N n"]
    """Predicted readings, in their units; those of a shorter recording are filled up."""
    model: Model
    """The fitted model, on the first recording's bodies."""


class Embedded(eqx.Module):
    """A fit to do again, as a pytree: from `embed`."""

    problem: Problem
    start: Unknowns
    usable: list[Bool[Array, "N n"]]
    noise: list[Float[Array, " n"]]
    names: tuple[str, ...] = eqx.field(static=True)
    """`effect.number` of each number."""
    segments: tuple[int, ...] = eqx.field(static=True)
    """In how many segments each recording was fitted; R is their sum."""

    # -- variations --------------------------------------------------------------------------

    def with_angles(self, *angles: ArrayLike) -> "Embedded":
        """The same fit to other readings, one array (N, n) in rad or m for each recording, at the
        same instants; NaN is a lost sample.

        **Raises:** `ValueError` for a wrong number of arrays or a wrong shape.
        """
        if len(angles) != len(self.segments):
            raise ValueError(f"{len(angles)} arrays of angles for {len(self.segments)} recordings")
        parts: list[Array] = []
        for i, (given, own) in enumerate(zip(angles, self._by_recording(self.usable), strict=True)):
            x, lengths = jnp.asarray(given, float), [len(part) for part in own]
            shape = sum(lengths), own[0].shape[1]
            if x.shape != shape:
                raise ValueError(
                    f"angles of recording {i + 1} have shape {x.shape}: must be {shape}"
                )
            parts += jnp.split(x, np.cumsum(lengths)[:-1])
        recorded = self.problem.recorded
        grid, weights = jnp.asarray(recorded.angles), jnp.asarray(recorded.weights)
        for i, x in enumerate(parts):
            seen = jnp.isfinite(x) & self.usable[i]
            grid = grid.at[i, : len(x)].set(jnp.where(seen, x, 0.0))
            weights = weights.at[i, : len(x)].set(jnp.where(seen, 1.0 / self.noise[i], 0.0))
        return eqx.tree_at(
            lambda e: (e.problem.recorded.angles, e.problem.recorded.weights),
            self,
            (grid, weights),
        )

    def with_mechanism(self, *mechanisms: AbstractMechanism) -> "Embedded":
        """The same readings on other bodies: one mechanism for each recording, or one for all.

        **Raises:** `ValueError` for a wrong number of mechanisms, other joints or numbers of other
        shapes; `TypeError` for another kind of mechanism.
        """
        count = len(self.segments)
        if len(mechanisms) not in (1, count):
            raise ValueError(f"{len(mechanisms)} mechanisms for {count} recordings")
        given = [_like(self.problem.model.mechanism, m) for m in mechanisms]
        all_of_them = given if len(given) == count else given * count
        pairs = zip(all_of_them, self.segments, strict=True)
        each = [m for m, parts in pairs for _ in range(parts)]
        return eqx.tree_at(
            lambda e: (e.problem.recorded.mechanism, e.problem.model),
            self,
            (stacked(each), posed(self.problem.model, each[0])),
        )

    def with_start(
        self, numbers: Float[Array, " P"], states: Float[Array, "R s"] | None = None
    ) -> "Embedded":
        """The same fit from another start; it must be near enough that no cycle is missed.

        **Raises:** `ValueError` for arrays of other shapes.
        """
        return eqx.tree_at(lambda e: e.start, self, self._at(numbers, states))

    def _at(self, numbers, states) -> Unknowns:
        """A point, scaled; `states` None are those of the start."""
        _must_be_float64()
        own = self.problem.states(self.start) if states is None else jnp.asarray(states, float)
        numbers, scale = jnp.asarray(numbers, float), self.problem.scale
        for words, found, right in (
            ("numbers", numbers, scale.numbers.shape),
            ("states", own, scale.states.shape),
        ):
            if found.shape != right:
                raise ValueError(f"{words} have shape {found.shape}: must be {right}")
        return self.problem.scaled(numbers, own)

    # -- use ---------------------------------------------------------------------------------

    def solve(self) -> Solution:
        """Least squares over all numbers and initial states.

        Differentiable in anything that was put in, in forward and reverse mode, by the implicit
        function theorem. A descent that did not settle says so in `converged`.

        **Raises:** `ValueError` in single precision, in which no fit can settle.
        """
        _must_be_float64()
        return self._solved()

    @eqx.filter_jit
    def _solved(self) -> Solution:
        y, steps, done = minimum(self.problem, self.start)
        squeezed = compressed(self.problem, y)
        numbers = jnp.asarray(self.problem.numbers(y))
        return Solution(
            numbers=numbers,
            states=jnp.asarray(self.problem.states(y)),
            chi2=squeezed.cost,
            covariance=_covariance(self.problem, squeezed)[: len(numbers), : len(numbers)],
            converged=done,
            steps=steps,
            predicted=squeezed.predicted,
            model=self.problem.model.with_vector(numbers),
        )

    def chi2(
        self, numbers: Float[Array, " P"], states: Float[Array, "R s"] | None = None
    ) -> Float[Array, ""]:
        """Sum of squared residuals in units of the noise; minus half of it is the log likelihood,
        but for a constant. `states` None are those of the start."""
        problem, y = self.problem, self._at(numbers, states)
        predicted = predictions(problem, problem.numbers(y), problem.states(y))
        misfit = jax.vmap(whiten)(problem.recorded, predicted)
        # What is known of memories counts as a reading.
        known = y.states[:, 2 * predicted.shape[-1] :]
        return jnp.sum(misfit**2) + jnp.sum(known**2)

    def covariance(
        self, numbers: Float[Array, " P"], states: Float[Array, "R s"] | None = None
    ) -> Float[Array, "U U"]:
        """Of the P numbers and, after them, the R s initial states, U in all, each in its own unit,
        if what is left is white noise of the size stated: the mass matrix of a sampler of `chi2`.

        It is (J'J)^-1 at this point; its first P rows and columns at the minimum are
        `Solution.covariance`. `states` None are those of the start.
        """
        return _covariance(self.problem, compressed(self.problem, self._at(numbers, states)))

    def readings(self, predicted: Float[Array, "R N n"]) -> list[Float[Array, "N n"]]:
        """`Solution.predicted`, recording by recording, each of its own length, whole."""
        pairs = zip(predicted, self.usable, strict=True)
        own = self._by_recording([x[: len(own)] for x, own in pairs])
        return [jnp.concatenate(parts) for parts in own]

    def _by_recording(self, parts: list[Array]) -> list[list[Array]]:
        """Of R segments, those of each recording."""
        ends = np.cumsum(self.segments)
        return [parts[end - n : end] for end, n in zip(ends, self.segments, strict=True)]


def embed(fit: Fit, *, integrator: Any = None) -> Embedded:
    """A finished fit as a function of its readings and bodies, for use inside `jax.jit`, `vmap` and
    `grad`.

    Step, wild readings and start are that fit's. Use it in float64: `jax.config.update(
    "jax_enable_x64", True)`, or inside `with jax.enable_x64(True)`.

    **Arguments:**

    - `integrator`: as of `residyn.fit`; None is that of the fit. With a solver of diffrax, take
      derivatives in forward mode.

    **Raises:** `ValueError` in single precision, in which no fit can settle; `InputError` for an
    integrator that does not exist or cannot integrate an effect of the model; `TypeError` for what
    is no fit.
    """
    must_be_fit(fit)
    _must_be_float64()
    return embedded(fit, integrator)


def _must_be_float64() -> None:
    if not jax.config.jax_enable_x64:  # pyrefly: ignore[missing-attribute]
        raise ValueError(
            "no fit can settle in single precision: embed and solve it in float64, after "
            'jax.config.update("jax_enable_x64", True) or inside `with jax.enable_x64(True)`'
        )


def _like(own: AbstractInertia, given: AbstractMechanism) -> AbstractMechanism:
    """A mechanism that may take the place of another one, as floating numbers."""
    if type(given) is not type(own):
        raise TypeError(f"{type(given).__name__}: must be a {type(own).__name__}, as in the fit")
    if given.joints != own.joints:
        raise ValueError(f"joints are {', '.join(given.joints)}: must be {', '.join(own.joints)}")
    found = all_floating(given)
    shapes = [[jnp.shape(x) for x in jax.tree.leaves(m)] for m in (found, own)]
    if shapes[0] != shapes[1]:
        raise ValueError(
            f"numbers of the {type(own).__name__} have shapes {shapes[0]}: must be {shapes[1]}"
        )
    return found


def embedded(fit: Fit, integrator: Any = None, fixed: bool = True) -> Embedded:
    """`embed`, in float64. Without `fixed` steps, which reverse mode asks for, it is quicker."""
    fitted = fit.fitted
    effects = [e for e in fit.model.effects if e.name not in BASE]
    experiment = fit.experiment
    if integrator is not None:
        experiment = dataclasses.replace(experiment, integrator=integrator)
    recordings = [r.recording for r in fitted]
    here = ready(experiment, recordings, effects)._replace(finer=fit.ready.finer)
    problem = tight(here.problem(fit.model, [r.wild for r in fitted], fixed=fixed)[0])
    start = problem.scaled(fit.model.vector(), jnp.asarray(np.stack([r.state for r in fitted])))
    return Embedded(
        problem=jax.tree.map(lambda x: jnp.asarray(x) if eqx.is_array_like(x) else x, problem),
        start=start,
        usable=[jnp.asarray(~r.wild) for r in fitted],
        noise=[jnp.asarray(r.recording.noise) for r in fitted],
        names=tuple(n.name for n in fit.model.fitted),
        segments=tuple(len(which) for _, which in by_recording(recordings)),
    )


# -- the minimum, and how it moves -----------------------------------------------------------


@eqx.filter_custom_jvp
def minimum(problem: Problem, start: Unknowns):
    """Of a problem from a start: the unknowns, steps, whether they settled."""
    y, _, _, steps, done = descended(Horizon(problem), start, _STEPS)
    return y, steps, done


@minimum.def_jvp
def _minimum_jvp(primals, tangents):
    problem, start = primals
    y, steps, done = minimum(problem, start)
    moving, fixed = eqx.partition(problem, eqx.is_inexact_array)
    moved = jax.tree.map(
        lambda x, t: t if t is not None or x is None else jnp.zeros_like(x),
        moving,
        tangents[0],
        is_leaf=lambda x: x is None,
    )
    flat, back = jax.flatten_util.ravel_pytree(y)

    def gradient(flat, moving):
        slope = _gradient(eqx.combine(moving, fixed), back(flat))
        return jax.flatten_util.ravel_pytree(slope)[0]

    push = jax.jvp(lambda p: gradient(flat, p), (moving,), (moved,))[1]
    curve = jax.jacfwd(lambda z: gradient(z, moving))(flat)
    return (y, steps, done), (back(-jnp.linalg.solve(curve, push)), None, None)


def _gradient(problem: Problem, y: Unknowns) -> Unknowns:
    """Of half of chi-square, J'r, in forward mode: reverse mode would compile for minutes."""
    squeezed = compressed(problem, y)
    local = jnp.einsum("rij,ri->rj", squeezed.factor, squeezed.along)
    p = problem.scale.numbers.shape[0]
    return Unknowns(jnp.sum(local[:, :p], axis=0), local[:, p:])


def _covariance(problem: Problem, squeezed: Compressed) -> Float[Array, "U U"]:
    """(J'J)^-1 of the numbers and, after them, all initial states."""
    scale, p = problem.scale, problem.scale.numbers.shape[0]
    count, each = scale.states.shape
    total = jnp.zeros((p + count * each, p + count * each))
    for i, factor in enumerate(squeezed.factor):
        # Each recording knows of the numbers and of its own state.
        seen = np.r_[:p, p + i * each : p + (i + 1) * each]
        total = total.at[np.ix_(seen, seen)].add(factor.T @ factor)
    size = jnp.concatenate([scale.numbers, scale.states.reshape(-1)])
    return jnp.linalg.inv(total) * size * size[:, None]

"""Numbers that a run of the rig has for itself.

Several runs of one rig share the numbers of a model. A brake that was engaged anew, or a table that
was cleaned, may have changed one of them: a run can then have its own. The effect stays one effect
with more numbers: the shared ones, and for each such run a further set that it takes instead. Which
run it is, the mechanism says (`run`).
"""

import dataclasses
import functools
import inspect
from collections.abc import Sequence

import jax.numpy as jnp

from ..errors import InputError
from ..physics.effect import AbstractEffect
from ..physics.inertia import AbstractInertia
from ..physics.parameter import param, parameters_of

_BY_MECHANISM = [
    name
    for name, method in inspect.getmembers(AbstractEffect, inspect.isfunction)
    if list(inspect.signature(method).parameters)[-1] == "mechanism"
]
"""Methods of an effect that know the mechanism, which is their last argument."""


def with_own(effect: AbstractEffect, runs: Sequence[tuple[int, str]]) -> AbstractEffect:
    """The effect with a set of numbers of its own for each of the `runs`, (number, name), all
    silent, and for no other; the effect itself if it has just these."""
    own = hasattr(type(effect), "own_runs")
    plain: type[AbstractEffect] = type(effect).__mro__[own]
    kind = _kind(plain, tuple(runs))
    if kind is type(effect):
        return effect
    return kind(**{f.name: getattr(effect, f.name) for f in dataclasses.fields(plain)})


def shared(effect: AbstractEffect) -> AbstractEffect:
    """The effect with the numbers alone that all runs share."""
    return with_own(effect, ())


@functools.cache
def _kind(kind: type[AbstractEffect], runs: tuple[tuple[int, str], ...]) -> type[AbstractEffect]:
    if not runs:
        return kind
    fitted = [p for p in parameters_of(kind) if p.fitted]
    if not fitted:
        raise InputError(f"own: {kind.name} has no number that a recording could have for itself")
    # By its class a kept program knows what it is of.
    body: dict = {"__module__": kind.__module__, "__doc__": kind.__doc__, "own_runs": runs}
    body["__annotations__"] = {}
    declared = {f.name: f.default for f in dataclasses.fields(kind)}
    for run, name in runs:
        for p in fitted:
            field = f"{p.field}_{run}"
            body["__annotations__"][field] = object
            body[field] = param(
                f"{p.words}, in {name}",
                p.dimension,
                sign=p.sign,
                silent=p.silent,
                default=declared[p.field],  # pyrefly: ignore[bad-argument-type]
                grid=p.grid,
                joint=p.joint,
                name=f"{p.name} ({name})",
            )

    def here(self, mechanism: AbstractInertia) -> AbstractEffect:
        values = {f.name: getattr(self, f.name) for f in dataclasses.fields(kind)}
        for run, _ in runs:
            now = mechanism.run == run  # pyrefly: ignore[missing-attribute]
            for p in fitted:
                own = getattr(self, f"{p.field}_{run}")
                values[p.field] = jnp.where(now, own, values[p.field])
        return kind(**values)

    for method in _BY_MECHANISM:
        if getattr(kind, method) is getattr(AbstractEffect, method):
            continue

        def called(self, *args, method=method):
            return getattr(here(self, args[-1]), method)(*args)

        body[method] = called
    numbers = "_".join(str(run) for run, _ in runs)
    return type(kind)(f"{kind.__name__}_{numbers}", (kind,), body)

"""Descents of one fit, or of many at once.

A fit is a generator: it yields the descents that it wants and goes on from where they ended. Run
`alone`, each descent is one call of a compiled program. Run `together`, the descents that several
fits want at a time are lanes of one program (`jax.vmap`), divided among all devices; a fit that is
done leaves its lane to the others. What a fit does around its descents (outliers, starts, held-out
recordings) is written once, and the same.
"""

import dataclasses
import functools
import math
from collections.abc import Callable, Generator, Sequence
from numbers import Integral
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from ..errors import quote
from ..physics.parameter import stacked
from ..runtime.export_cache import kept
from .layout import read_of
from .least_squares import (
    ENDED,
    Compressed,
    Horizon,
    descended,
    one_descent,
    one_start,
    side_by_side,
)
from .problem import Problem, Unknowns
from .result import FitError

Result = TypeVar("Result")
_FEW = 8  # starts that a CPU runs one after the other
_STARTS = 16  # starts that a CPU runs side by side: more gain nothing, and wait for more
_STEPS = 10  # of starts side by side, where all wait for the last one
_PART = 8  # the first cycles, where they are no more than this part of the readings


SHARES = 8  # of a descent, at most


class Wanted(NamedTuple):
    """Descents over growing `shares` (0 to 1) of every recording, one after the other; `size` is
    what counts as one sigma, in sigma."""

    problem: Problem
    unknowns: Unknowns
    shares: np.ndarray
    size: np.ndarray

    @classmethod
    def of(cls, problem: Problem, y: Unknowns, shares: Sequence[float], size: float) -> "Wanted":
        """The same, always in arrays of one size."""
        filled = np.zeros(SHARES)
        filled[: len(shares)] = shares
        return cls(problem, y, filled, np.asarray(float(size)))


Fitting = Generator[list[Wanted], Sequence[Any], Result]
"""What yields descents of one problem, is sent where they ended (`least_squares.ENDED`, each), and
returns a result."""


def evaluating(problem: Problem, y: Unknowns) -> Fitting[Compressed]:
    """Residual and Jacobian at these unknowns, by the program of the descents: nothing else need be
    compiled. To an optimiser for which one sigma is infinite all is small, so it goes nowhere."""
    ((_, squeezed, *_),) = yield [Wanted.of(problem, y, [1.0], np.inf)]
    return squeezed


def alone(fitting: Fitting[Result], one: Callable[..., Any] | None = None) -> Result:
    """The result of one fit, its descents one after the other, each by `one`, or by `one_start`;
    where that raises a `FitError`, so does what the fit has asked for."""
    going, one = functools.partial(next, fitting), one or one_start
    try:
        while True:
            wanted = going()
            few = _FEW if jax.default_backend() == "cpu" else 1
            many = len(wanted) > few and wanted[0].shares[0] < 1.0
            try:
                answer = _starts(wanted) if many else [one(*each) for each in wanted]
                going = functools.partial(fitting.send, answer)
            except FitError as error:
                going = functools.partial(fitting.throw, error)
    except StopIteration as end:
        return end.value


def _starts(wanted: list[Wanted]) -> list[Any]:
    """Descents of many starts over the first cycles, side by side: cheap there, but all wait for
    the last one, so they end early."""
    share, size = wanted[0].shares[0], np.max([each.size for each in wanted])
    head = _head(wanted[0].problem, share)

    def run(some: list[Wanted]):
        return _descents_of_starts(head, stacked([each.unknowns for each in some]), share, size)

    most = _STARTS if jax.default_backend() == "cpu" else len(wanted)
    return _side_by_side(run, wanted, min(len(wanted), most))


def _side_by_side(run: Callable[[list[Wanted]], Any], wanted: list[Wanted], width: int):
    """What `run` makes of descents, `width` at a time."""
    found = []
    for first in range(0, len(wanted), width):
        some = wanted[first : first + width]
        out = jax.device_get(run([*some, *[some[-1]] * (width - len(some))]))
        found += [jax.tree.map(lambda x, i=i: x[i], out) for i in range(len(some))]
    return found


def _head(problem: Problem, share: float) -> Problem:
    """The problem with room for its first part only, if the share's readings lie there."""
    instants, room = problem.recorded.row.shape[-1] // _PART, problem.room // _PART
    only = math.ceil(share * int(problem.steps))
    late = np.asarray(problem.recorded.weights)[:, instants:].any(axis=-1)
    if only > room or np.any(late & (np.asarray(problem.recorded.row)[:, instants:] < only)):
        return problem
    first = [x[:, :instants] for x in read_of(problem.recorded)]
    short = eqx.tree_at(lambda p: read_of(p.recorded), problem, first)
    return dataclasses.replace(short, room=room)


@kept(like=ENDED)
def _descents_of_starts(problem: Problem, y: Unknowns, share, size):
    """`one_descent` of starts (S, ...) side by side, over one share."""
    horizon = Horizon.of(problem, share)._replace(size=size)
    ended = side_by_side(lambda start: descended(horizon, start, _STEPS), problem.model)(y)
    return *ended, jnp.ones_like(ended[-1], int)


def lanes(batch: int | None, usual: int) -> int:
    """How many fits run at a time on all devices, `batch` on each; None is `usual`, 1 on a CPU.

    **Raises:** `ValueError` for an empty batch, or what is no whole number.
    """
    devices = jax.devices()
    if batch is None:
        batch = 1 if devices[0].platform == "cpu" else usual
    if not isinstance(batch, Integral) or batch < 1:
        raise ValueError(f"batch = {quote(batch)}: must be a whole number, at least one")
    return int(batch) * len(devices)


def together(fittings: Sequence[Fitting[Result]]) -> list[Result]:
    """The results of some fits, descents of one shape run together. Call it in float64.

    **Raises:** what the first fit that failed raised, when all have ended.
    """
    results: dict[int, Result] = {}
    errors: list[Exception] = []
    answers: dict[int, Sequence[Any] | None] = dict.fromkeys(range(len(fittings)))
    width = len(jax.devices())
    while width < len(fittings):  # few widths, few programs
        width *= 2
    while answers:
        groups: dict[Any, list[tuple[int, Wanted]]] = {}
        for index, answer in answers.items():
            try:
                wanted = fittings[index].send(answer)  # pyrefly: ignore[bad-argument-type]
            except StopIteration as end:
                results[index] = end.value
            except Exception as error:
                errors.append(error)
            else:
                for each in wanted:
                    groups.setdefault(_shape(each), []).append((index, each))
        answers = {}
        for group in groups.values():
            found = _in_lanes([each for _, each in group], width)
            for (index, _), each in zip(group, found, strict=True):
                answers.setdefault(index, []).append(each)  # pyrefly: ignore[missing-attribute]
    for error in errors:
        raise error
    return [results[index] for index in range(len(fittings))]


def _shape(wanted: Wanted) -> Any:
    """All that tells one compiled program from another one."""
    leaves, structure = jax.tree.flatten(wanted)
    return structure, tuple(x.shape if eqx.is_array(x) else x for x in leaves)


def _in_lanes(wanted: list[Wanted], width: int) -> list[Any]:
    """Descents of one shape, `width` at a time, divided among all devices."""
    divided = NamedSharding(Mesh(np.asarray(jax.devices()), ("fits",)), PartitionSpec("fits"))

    def run(some: list[Wanted]):
        arrays, rest = zip(*(eqx.partition(each, eqx.is_array) for each in some), strict=True)
        return run_descents(jax.device_put(stacked(jax.device_get(arrays)), divided), rest[0])

    return _side_by_side(run, wanted, width)


@eqx.filter_jit
def run_descents(arrays, rest):
    """XLA divides the lanes as the inputs are divided."""
    return jax.vmap(lambda own: one_descent(*eqx.combine(own, rest)))(arrays)

"""Many experiments: what a laboratory has at the end of a day.

Compiled programs serve every experiment of the same model whose recordings have about the same
length, so all but the first fits are quick. On a CPU every core has a fit of its own; where JAX has
several devices, or one that is no CPU, fits run in batches that share a program and all devices.
Results are written as they come, a line each (`result_lines`); a run that was killed goes on where
it stopped; one broken recording costs its own line and no other. With an executor of
`concurrent.futures`, or anything that looks like one, such as a Dask cluster's, processes and
machines share the work.
"""

import contextlib
import functools
import itertools
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from typing import Any, NamedTuple

import jax

from ..effects import AbstractEffect
from ..errors import InputError, quote
from ..recordings.experiment import Experiment, load, must_be_experiment
from ..runtime.parallel import cores, in_order
from .fit import fitting
from .lanes import Fitting, alone, lanes, together
from .multistart import DEFAULT_STARTS
from .result import Fit, FitError
from .result_lines import ResultLines, digest

_TOGETHER = 256  # fits on each device that is no CPU; of one with 2000 samples it takes 3 MB
AHEAD = 64  # fits that an executor holds: enough for many workers, little memory


class Each(NamedTuple):
    """What became of one experiment."""

    name: str
    fit: Fit | None
    """None where there is none, where it was done before, or where another process did it."""
    told: dict[str, Any]
    """`name`, `digest` of all it depends on, what was `understood` of a lab's own files (a line
    each), and the fit's `to_dict()` or, in one line, `error`."""
    before: bool = False
    """Whether it was read from the file of an earlier run."""


def fit_many(
    experiments: Iterable[str | os.PathLike[str] | Experiment],
    *,
    effects: Sequence[str | AbstractEffect] = (),
    starts: int = DEFAULT_STARTS,
    out: str | os.PathLike[str] | None = None,
    progress: Callable[[str], None] | None = None,
    executor: Executor | None = None,
    batch: int | None = None,
) -> Iterator[Each]:
    """Fit each of many experiments; an iterator, so that nothing is kept that nobody wants.

    **Arguments:**

    - `experiments`: TOML files, or experiments (told apart by their `path`, else their number).
    - `effects`, `starts`, `progress`: as of `residyn.fit`.
    - `out`: a file of JSON lines to add to. What stands in it already is not fitted again. What
      ended in an error there, or was made of other files, effects, options or another version, is
      fitted again and its old line is taken out, and so is a last line that was cut short.
    - `executor`: where to fit, such as a `ProcessPoolExecutor` (with the start method "spawn": JAX
      does not outlive a fork) or `dask.distributed.Client(...).get_executor()`. Its workers read
      files by the same names, and know the effects of packages but none that were adopted here.
    - `batch`: fits that run together on each device; None is what suits it (1 on a CPU). The
      results of a batch come all at once.

    **Yields:** an `Each` for every experiment, in order (with an executor, as they are done); bad
    input, fits that led nowhere and all other failures of one experiment are lines with an
    `error`, not exceptions.

    **Raises:** `ValueError` for an empty batch, or one beside an executor, whose workers fit one at
    a time; `TypeError` for what is no list, or holds what is neither a path nor an experiment;
    `InputError` if two experiments have the same name, or `out` holds something else, cannot be
    written, or is written by another run.
    """
    if batch is not None and (batch < 1 or executor is not None):
        raise ValueError(f"batch = {batch}: must be at least 1, and not beside an executor")
    if isinstance(experiments, str | os.PathLike | Experiment):
        raise TypeError(f"experiments = {quote(experiments)}: must be a list of them")
    named, seen = [], set()
    for index, one in enumerate(experiments):
        if not isinstance(one, str | os.PathLike):
            must_be_experiment(one)
        name = one.path or f"experiment {index + 1}" if isinstance(one, Experiment) else str(one)
        if name in seen:
            raise InputError(f"{name} is there twice: results could not be told apart")
        seen.add(name)
        named.append((name, one))
    say = progress or (lambda words: None)
    with contextlib.ExitStack() as opened:
        if out is None:
            lines, digests = None, {}
        else:
            digests = {name: digest(one, effects, starts) for name, one in named}
            lines = opened.enter_context(contextlib.closing(ResultLines(out, digests)))
        done = {} if lines is None else lines.done
        before = {name: Each(name, None, told, True) for name, told in done.items()}
        left = [(name, one) for name, one in named if name not in done]
        if executor is None:
            fresh = _in_batches(left, effects, starts, say, lanes(batch, _TOGETHER))
            every = (before[name] if name in before else next(fresh) for name, _ in named)
        else:
            fresh = _by_executor(left, effects, starts, say, executor)
            every = itertools.chain(before.values(), fresh)
        for each in every:
            if lines is not None and not each.before:
                told = {"name": each.name, "digest": digests[each.name]} | each.told
                each = each._replace(told=told)
                lines.add(told)
            yield each


def _in_batches(left, effects, starts: int, say, width: int) -> Iterator[Each]:
    works = []
    for count, (name, one) in enumerate(left, start=1):
        at = f"{name} ({count} of {len(left)}): "
        progress = lambda words, at=at: say(at + words)  # noqa: E731
        works.append((name, one, effects, starts, progress))
    if width == 1:
        calls = [functools.partial(_alone, *each) for each in works]
        # The first one compiles what the others of its kind need.
        yield from in_order(calls[:1], 1)
        yield from in_order(calls[1:], cores())
        return
    for first in range(0, len(works), width):
        with jax.enable_x64(True):
            found = together([_fitted(*each) for each in works[first : first + width]])
        yield from found


def _alone(*given) -> Each:
    return alone(_fitted(*given))


def _by_executor(left, effects, starts: int, say: Callable[[str], None], executor: Executor):
    """Each as it is done, a few waiting their turn."""
    waiting: dict[Future[Each], str] = {}
    todo, count = list(reversed(left)), 0
    while todo or waiting:
        while todo and len(waiting) < AHEAD:
            name, one = todo.pop()
            try:
                waiting[executor.submit(_told, name, one, effects, starts)] = name
            except Exception as error:
                yield _lost(name, error)
        for future in wait(waiting, return_when=FIRST_COMPLETED).done if waiting else ():
            name, count = waiting.pop(future), count + 1
            say(f"{count} of {len(left)} done: {name}")
            try:
                yield future.result()
            except Exception as error:
                yield _lost(name, error)


def _told(*given) -> Each:
    """What travels between processes: numbers, not the recordings they came from."""
    with jax.enable_x64(True):
        return _alone(*given)._replace(fit=None)


def _lost(name: str, error: Exception) -> Each:
    words = f"no result came from the worker, {type(error).__name__}: {error}"
    if isinstance(error, BrokenExecutor):
        words = "the process that was to fit it has died (memory?): run it again"
    return Each(name, None, {"name": name, "error": words})


def _fitted(
    name: str,
    one: str | os.PathLike[str] | Experiment,
    effects: Sequence[str | AbstractEffect],
    starts: int,
    say: Callable[[str], None] = lambda words: None,
) -> Fitting[Each]:
    found, told = None, {"name": name}
    try:
        experiment = one if isinstance(one, Experiment) else load(one)
        told |= {"understood": list(experiment.understood)}
        found = yield from fitting(experiment, effects, starts, say)
        told |= found.to_dict()
    except (InputError, FitError, ValueError) as error:
        told["error"] = str(error)
    except Exception as error:  # a mistake of ours: the others are fitted all the same
        told["error"] = f"this should not have happened, {type(error).__name__}: {error}"
    return Each(name, found, told)

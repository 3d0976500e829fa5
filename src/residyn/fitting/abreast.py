"""Fits of many experiments that descend together.

Every fit asks for descents over a stretch of its recordings, one after the other; all else is
Python. Where several fits run at once, each in a thread, their requests are gathered until all
wait: requests of one shape are then one program, its lanes divided among all devices. No fit knows
of it, so what it does around its descents (wild readings, starts, held-out recordings) is the same.
"""

import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, TypeVar

import equinox as eqx
import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

_Result = TypeVar("_Result")
_here = threading.local()


def lanes(batch: int | None, usual: int) -> int:
    """How many fits run at a time on all devices, `batch` on each; None is `usual`, 1 on a CPU.

    **Raises:** `ValueError` for an empty batch.
    """
    devices = jax.devices()
    if batch is None:
        batch = 1 if devices[0].platform == "cpu" else usual
    if batch < 1:
        raise ValueError(f"batch = {batch}: must be at least 1")
    return batch * len(devices)


def together(works: Sequence[Callable[[], _Result]]) -> list[_Result]:
    """The results of some works, each in a thread of its own, their requests gathered.

    **Raises:** what the first work that failed raised, when all have ended.
    """
    gathering = _Gathering(len(works))

    def one(work: Callable[[], _Result]) -> _Result:
        _here.gathering = gathering
        try:
            return work()
        finally:
            _here.gathering = None
            gathering.leave()

    with ThreadPoolExecutor(max(1, len(works)), "residyn-fits") as threads:
        return [future.result() for future in [threads.submit(one, work) for work in works]]


def asked(program: Callable, alone: Callable, *args) -> Any:
    """`program(*args)`: `alone`, compiled, in a fit by itself; with others', if they are gathered.

    `program` is the function itself, of arrays and pytrees, and returns arrays.
    """
    return _here.gathering.ask(program, args) if gathered() else alone(*args)


def gathered() -> bool:
    """Whether this thread's requests are gathered with others'."""
    return getattr(_here, "gathering", None) is not None


class _Gathering:
    """Requests of some threads; whoever comes last answers them all."""

    def __init__(self, running: int):
        self._lock = threading.Lock()
        self._running = running
        self._waiting: list[_Request] = []

    def ask(self, program: Callable, args: tuple) -> Any:
        future: Future = Future()
        shapes = tuple(x.shape for x in jax.tree.leaves(args) if eqx.is_array(x))
        kind = program, jax.tree.structure(args), shapes
        hash(kind)  # what cannot be grouped fails here, and holds no other fit up
        with self._lock:
            self._waiting.append((kind, args, future))
            due = self._due()
        _answer(due)
        return future.result()

    def leave(self) -> None:
        """One thread has ended: the others may be all that is left to wait for."""
        with self._lock:
            self._running -= 1
            due = self._due()
        _answer(due)

    def _due(self) -> "list[_Request]":
        if not self._waiting or len(self._waiting) < self._running:
            return []
        due, self._waiting = self._waiting, []
        return due


_Request = tuple[tuple, tuple, Future]
"""What tells programs apart (function, inputs' structure and shapes), inputs, the answer."""


def _answer(requests: list[_Request]) -> None:
    groups: dict[tuple, list[tuple[tuple, Future]]] = {}
    for kind, args, future in requests:
        groups.setdefault(kind, []).append((args, future))
    for (program, *_), group in groups.items():
        try:
            with jax.enable_x64(True):  # a setting of each thread, and this one's fit may be over
                results = _abreast(program, [args for args, _ in group])
        except BaseException as error:  # each fit must hear of it: none may wait for ever
            for _, future in group:
                future.set_exception(error)
            continue
        for (_, future), result in zip(group, results, strict=True):
            future.set_result(result)


def _abreast(program: Callable, given: list[tuple]) -> list[Any]:
    """`program` of each of some inputs of one shape, divided among all devices."""
    devices = jax.devices()
    width = len(devices)
    while width < len(given):  # few widths, few programs
        width *= 2
    filled = [*given, *[given[-1]] * (width - len(given))]
    arrays, rest = zip(*(eqx.partition(args, eqx.is_array) for args in filled), strict=True)
    stacked = jax.tree.map(lambda *x: np.stack([np.asarray(each) for each in x]), *arrays)
    divided = NamedSharding(Mesh(np.asarray(devices), ("fits",)), PartitionSpec("fits"))
    out = jax.device_get(_run(program, jax.device_put(stacked, divided), rest[0]))
    return [jax.tree.map(lambda x, i=i: x[i], out) for i in range(len(given))]


@eqx.filter_jit
def _run(program: Callable, stacked, rest):
    """XLA divides the lanes as the inputs are divided."""
    return jax.vmap(lambda arrays: program(*eqx.combine(arrays, rest)))(stacked)

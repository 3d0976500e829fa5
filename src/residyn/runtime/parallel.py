"""Calls side by side: compilation and compiled programs let other threads run."""

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

import jax

Result = TypeVar("Result")


def side_by_side(calls: Sequence[Callable[[], Result]]) -> list[Result]:
    """What each call returns, in float64; as many run at once as there are cores."""
    return list(in_order(calls, min(len(calls), os.cpu_count() or 1)))


def in_order(calls: Iterable[Callable[[], Result]], width: int) -> Iterator[Result]:
    """What each call returns, in float64, one after the other; `width` run at once, and no more are
    begun ahead of the one that is waited for than keep them busy."""

    def one(call: Callable[[], Result]) -> Result:
        with jax.enable_x64(True):  # JAX's settings are each thread's own
            return call()

    if width <= 1:
        yield from map(one, calls)
        return
    pool, begun = ThreadPoolExecutor(width), deque[Future[Result]]()
    try:
        for call in calls:
            begun.append(pool.submit(one, call))
            if len(begun) > 2 * width:
                yield begun.popleft().result()
        while begun:
            yield begun.popleft().result()
    finally:  # whoever interrupts does not wait for what others compile
        pool.shutdown(wait=False, cancel_futures=True)


def cores() -> int:
    """How many programs of one core each run at once: on a CPU its cores, divided among JAX's
    devices; on anything else one, which fills the device."""
    devices = jax.devices()
    if devices[0].platform != "cpu":
        return 1
    return max(1, (os.cpu_count() or 1) // len(devices))

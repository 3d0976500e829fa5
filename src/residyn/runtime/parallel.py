"""Calls side by side: compilation and compiled programs let other threads run."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import jax

Result = TypeVar("Result")


def side_by_side(calls: Sequence[Callable[[], Result]]) -> list[Result]:
    """What each call returns, in float64; as many run at once as there are cores."""

    def one(call: Callable[[], Result]) -> Result:
        with jax.enable_x64(True):  # JAX's settings are each thread's own
            return call()

    if len(calls) == 1:
        return [one(calls[0])]
    pool = ThreadPoolExecutor(os.cpu_count())
    try:
        return list(pool.map(one, calls))
    finally:  # whoever interrupts does not wait for what others compile
        pool.shutdown(wait=False, cancel_futures=True)

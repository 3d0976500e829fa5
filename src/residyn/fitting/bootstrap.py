"""How far numbers scatter: the same fit to many noises, side by side.

A standard error is a prediction: were the recording made again, the numbers would differ by so
much. The bootstrap does it again. It takes the fitted motion for the truth, adds fresh noise of the
size that was found, and fits; what these fits spread by needs no linear theory. Fits run in batches
under `vmap`, a batch's lanes divided among all devices; on a CPU a batch is one fit, and every core
has one of its own. Memory stays that of a few batches.
"""

import functools
from collections.abc import Callable
from numbers import Integral
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from ..errors import quote
from ..runtime.parallel import cores, in_order
from .implicit import Embedded, embedded, minimum
from .lanes import lanes
from .least_squares import first_step, look
from .result import Fit, must_be_fit

_ARRAYS = 200  # of all readings of a fit; the program needs 72, so a third of the memory is taken
_MEMORY = 4e9  # bytes of a device that does not say how many it has
_ROUNDS = 16  # of those one after the other in one call, which costs as much as half a fit


class Bootstrap(NamedTuple):
    """D fits to D noises."""

    names: tuple[str, ...]
    numbers: np.ndarray
    """(D, P), each in its own unit."""
    converged: np.ndarray
    """(D,) whether each settled."""

    @property
    def std(self) -> np.ndarray:
        """(P,) standard deviation of the fits that settled."""
        return np.std(self.numbers[self.converged], axis=0, ddof=1)

    def interval(self, share: float = 0.95) -> np.ndarray:
        """(P, 2) that hold this share of the fits that settled, as much outside on either side."""
        out = 0.5 * (1.0 - share)
        return np.quantile(self.numbers[self.converged], [out, 1.0 - out], axis=0).T


def bootstrap(
    fit: Fit,
    draws: int = 1000,
    *,
    seed: int = 0,
    batch: int | None = None,
    progress: Callable[[str], None] | None = None,
) -> Bootstrap:
    """Parametric bootstrap of a fit: `draws` times fresh noise on the fitted motion, and a fit.

    The noise is white, of the size stated or estimated, times the root of the reduced chi-square
    where more is left. Lost and wild readings stay out. Runs in float64, on all devices that JAX
    has.

    **Arguments:**

    - `draws`: how many fits, at least 2.
    - `seed`: the same seed gives the same noises, whatever the batch.
    - `batch`: fits that run side by side on each device; None is what suits it (1 on a CPU).
    - `progress`: called with a few words now and then.

    **Raises:** `ValueError` for draws or a batch that are no whole number, for fewer than two
    draws, or an empty batch; `TypeError` for what is no fit.
    """
    must_be_fit(fit)
    if not isinstance(draws, Integral) or draws < 2:
        raise ValueError(f"draws = {quote(draws)}: must be a whole number, at least two")
    draws = int(draws)
    devices = jax.devices()
    with jax.enable_x64(True):
        fits = embedded(fit, fixed=False)
        most = lanes(batch, _room(devices[0], fits))
        rounds = -(-draws // most)
        width = -(-draws // (rounds * len(devices))) * len(devices)  # alike, and no more
        each = width * min(_ROUNDS, rounds)
        size = float(np.sqrt(max(1.0, fit.reduced_chi2)))
        whole = [r for r in fit.whole if r.recording.role != "check"]
        noise = [jnp.asarray(size * r.recording.noise) for r in whole]
        mesh = Mesh(np.asarray(devices), ("fits",))
        divided = NamedSharding(mesh, PartitionSpec(None, "fits"))
        seen = tuple(map(np.asarray, look(fits.problem, fits.start, fits.problem.steps)[:2]))
        pairs = zip(whole, fits.readings(jnp.asarray(seen[0])), strict=True)
        truth = [np.where(r.used, x, np.nan) for r, x in pairs]
        fits, seen = eqx.filter_shard((fits, seen), NamedSharding(mesh, PartitionSpec()))
        keys = np.asarray(jax.random.key_data(jax.random.split(jax.random.key(seed), draws)))
        # The last batch is filled up, so that one compiled program serves all.
        keys = np.concatenate([keys, np.repeat(keys[-1:], -draws % each, axis=0)])

        def refitted(first: int):
            some = keys[first : first + each].reshape(-1, width, *keys.shape[1:])
            out = _refits(fits, seen, truth, noise, jax.device_put(some, divided))
            return [np.asarray(x).reshape(each, *x.shape[2:])[: draws - first] for x in out]

        found, starts = [refitted(0)], range(each, draws, each)  # the first one compiles
        rest = in_order([functools.partial(refitted, first) for first in starts], cores())
        for some in rest:
            found.append(some)
            if progress is not None:
                progress(f"{min(len(found) * each, draws)} of {draws} fits")
    numbers, converged = (np.concatenate(x) for x in zip(*found, strict=True))
    return Bootstrap(fits.names, numbers, converged)


def _room(device, fits: Embedded) -> int:
    """How many fits a device that is no CPU has memory for."""
    has = (device.memory_stats() or {}).get("bytes_limit", _MEMORY)
    return max(1, int(has / (_ARRAYS * fits.problem.recorded.angles.nbytes)))


@eqx.filter_jit
def _refits(fits: Embedded, seen, truth, noise, keys):
    """All begin at the fitted motion, with slopes that are known: `seen`."""

    def one(key):
        each = jax.random.split(jax.random.wrap_key_data(key), len(truth))
        angles = [
            q + s * jax.random.normal(k, q.shape)
            for q, s, k in zip(truth, noise, each, strict=True)
        ]
        again = fits.with_angles(*angles)
        begin = first_step(again.problem, fits.start, *seen)
        y, _, converged = minimum(again.problem, begin)
        return again.problem.numbers(y), converged

    def lanes(keys):
        if len(keys) == 1:  # of one lane XLA makes a slower program
            return jax.tree.map(lambda x: x[None], one(keys[0]))
        return jax.vmap(one)(keys)

    return jax.lax.map(lanes, keys)

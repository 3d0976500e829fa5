"""From an experiment to a comparison: fit, look where the residual is, predict the rest."""

from collections.abc import Callable, Sequence

import jax

from ..effects import AbstractEffect
from ..fitting import DEFAULT_STARTS, Fit, fit
from ..recording import Experiment
from .comparison import Comparison
from .horizon import held_out, horizon
from .linear import Near
from .missing import missing_of
from .where import where


def compare(
    experiment: Experiment,
    *,
    effects: Sequence[str | AbstractEffect] = (),
    starts: int = DEFAULT_STARTS,
    progress: Callable[[str], None] | None = None,
) -> Comparison:
    """Fit a model, and say where it fails: at which joint, when, at what swing and frequency.

    No other model is tried. Runs in float64 whatever JAX's setting.

    **Arguments:**

    - `experiment`: from `residyn.load`, or made of arrays.
    - `effects`: what to add to the springs and dampers: `name`, `name:joint`, or an effect.
    - `starts`: how many starts the fit tries, at least 1.
    - `progress`: called with a few words as each phase begins.

    **Returns:** a `Comparison`: print it, or `to_dict()`.

    **Raises:** `FitError` if no start led to finite numbers; `ValueError` for an effect that does
    not exist or does not go with this experiment.
    """
    say = progress or (lambda words: None)
    return compare_fit(fit(experiment, effects=effects, starts=starts, progress=say), say)


def compare_fit(fitted: Fit, progress: Callable[[str], None] | None = None) -> Comparison:
    """The comparison of a fit that is there already; see `compare`."""
    say = progress or (lambda words: None)
    with jax.enable_x64(True):
        say("looking where the residual is")
        near = Near.of(fitted)
        _, slopes = near.look(near.at)
        found = where(near, slopes)
        say("predicting what was held out")
        ahead = held_out(near), horizon(near)
        say("following the missing torque")
        return Comparison(fitted, found, *ahead, missing_of(fitted))

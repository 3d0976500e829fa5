"""Candidates joined to a model and fitted, each from where the screen says."""

from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor

import jax
import numpy as np

from ..fitting.pipeline import refit
from ..fitting.result import FitError
from ..model import Model
from ..parameter import parameters_of
from ..recording import Experiment
from .joined import joined, possible, silent
from .path import with_fields
from .rung import Refit, Step, extends
from .screen import Screened
from .valleys import PROMISED, out_of_valleys

_HOPELESS = 1.5  # times the best, when it should have settled: not worth the time
_WEAK = 0.3  # of the screened strength, for the second start
_AGAIN = 3  # fits that start again
_ENOUGH = 1.1  # times the noise: as good as it gets
_FAR = 10.0  # times the noise: no such fit will come down to it
_THREADS = 2


def refits(step: Step, experiment: Experiment, tried: Sequence[Screened]) -> list[Refit]:
    """Fits of some candidates beside a model; those that led nowhere are left out."""
    each: list[Future[Refit | None]] = []

    def one(screened: Screened, before: Sequence[Future[Refit | None]]) -> Refit | None:
        known = [r for r in (f.result() for f in before) if r is not None and r.possible]
        return _refit(step, experiment, screened, min([step.cost, *(r.cost for r in known)]))

    with ThreadPoolExecutor(_THREADS) as pool:  # compiling is most of it, and leaves Python free
        for i, s in enumerate(tried):
            # Of its neighbour, which is fitted beside it, a candidate must know nothing: what it
            # knew would depend on the machine's mood.
            each.append(pool.submit(one, s, each[: max(0, i + 1 - _THREADS)]))
        found = [r for r in (e.result() for e in each) if r is not None]
    return out_of_valleys(step, experiment, _again(step, experiment, found))


def extending(step: Step, experiment: Experiment, refits: list[Refit]) -> list[Refit]:
    """A law with more to it than another one can do no worse: where its fit did, it begins again
    where that one ended, with a little of what is more."""
    found = []
    for r in refits:
        plain = next((p for p in refits if extends(r, p) and p.cost < r.cost), None)
        if plain is not None:
            own = plain.model.effects[-1]
            values = {p.field: float(getattr(own, p.field)) for p in parameters_of(own)}
            more = {
                p.field: p.silent + _WEAK * (float(getattr(r.screened.effect, p.field)) - p.silent)
                for p in parameters_of(r.effect)
                if p.field not in values and p.fitted and p.silent is not None
            }
            moved = beginning_at(step, plain, r.screened)
            moved = moved._replace(effect=with_fields(moved.effect, {**more, **values}), others=())
            new = _refit(step, experiment, moved, plain.cost, weak=False)
            if new is not None and new.cost < r.cost:
                r = new._replace(effect=r.effect, screened=r.screened)
        found.append(r)
    return found


def _again(step: Step, experiment: Experiment, refits: list[Refit]) -> list[Refit]:
    """Fits that ended far above the best start again where that one has left springs, dampers and
    initial states: a wrong valley of those is the usual reason."""
    best = min((r for r in refits if r.possible), key=lambda r: r.cost, default=None)
    if best is None:
        return refits
    found, left = [], _AGAIN
    for r in sorted(refits, key=lambda r: r.screened.chi2):
        if left and r.cost > PROMISED * best.cost:
            left -= 1
            moved = beginning_at(step, best, r.screened)
            new = _refit(step, experiment, moved, best.cost, weak=False)
            if new is not None and new.cost < r.cost:
                r = new._replace(screened=r.screened)
        found.append(r)
    return found


def beginning_at(step: Step, best: Refit, screened: Screened) -> Screened:
    """A candidate with the springs, dampers and initial states that another one's fit has left."""
    count, size = len(step.fit.numbers), step.near.fitted[0].state.size
    states = np.asarray(best.descent.problem.states(best.descent.unknowns))[:, :size]
    return screened._replace(
        numbers=np.asarray(best.model.vector())[:count],
        states=np.concatenate([states, screened.states[:, size:]], axis=1),
        others=tuple(beginning_at(step, best, s) for s in screened.others),
    )


def _refit(
    step: Step, experiment: Experiment, screened: Screened, least: float, weak: bool = True
) -> Refit | None:
    """Fit a candidate; `least` is the best cost among those that were fitted before."""
    effects = (*step.effects, silent(screened.effect))
    alone = Model(step.fit.model.mechanism, (screened.effect,))
    now = np.asarray(step.fit.model.vector())
    second = np.concatenate([now, np.asarray(alone.vector())])
    for i, n in enumerate(alone.fitted, start=len(now)):
        if n.meaning.silent is not None:
            second[i] = n.meaning.silent + _WEAK * (second[i] - n.meaning.silent)
    states = np.stack([r.state for r in step.near.fitted])
    more = screened.states[:, states.shape[1] :]
    wild = [r.wild for r in step.near.fitted]
    best = None

    def hopeless(cost: float) -> bool:
        return cost > _HOPELESS * max(least, float(step.readings))

    with jax.enable_x64(True):
        # From where the screen says, with the shapes that it likes best; at last from where the
        # model stands. A fit down to the noise needs no other, but for laws with corners: these
        # come down nearly as far with a wrong shape.
        begins = [(joined(step, x), x.states) for x in (screened, *screened.others)]
        begins += [(second, np.concatenate([states, more], axis=1))]
        for numbers, begin in begins if weak else begins[:1]:
            try:
                model, descent = refit(
                    experiment, effects, numbers[None], begin[None], wild, hopeless
                )
            except FitError:
                continue
            if best is None or descent.cost < best.cost:
                could = possible(step, model, descent, alone)
                best = Refit(screened.effect, screened, model, descent, numbers, could)
            noise = float(step.readings)
            enough = _ENOUGH * noise
            if not screened.others or screened.chi2 > _FAR * noise:
                enough = PROMISED * max(screened.chi2, noise)
            if best.cost < enough and not screened.effect.rough:
                break
    return best

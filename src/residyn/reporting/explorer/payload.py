"""What a page holds, as data: JSON, with all arrays in one compressed block of bytes.

Everything that decides is to twelve digits (Gram matrices); what is only drawn is at most
`POINTS` instants of a recording, in 16 bits of its own range.
"""

import base64
import dataclasses
import math
import zlib
from collections.abc import Collection, Sequence
from typing import Any, NamedTuple

import numpy as np

from ... import __version__
from ...diagnosis.columns import Column, strengths
from ...diagnosis.diagnose import values_of
from ...diagnosis.evidence import FURTHER, common_sizes, signed, width_of
from ...diagnosis.missing_torque import missing_of
from ...filtering.law import numbers_of
from ...fitting.result import Fit
from ...recordings.reads import READS
from ...recordings.segments import by_recording
from ..names import lower, unbroken
from .first_order import ErrorGram, FirstOrder
from .study import Study, sum_of

POINTS = 800
"""Instants of a recording that are drawn."""
_RECORDINGS = 8  # that are drawn, at most


class Drawn(NamedTuple):
    """An array that is only drawn."""

    values: Any
    levels: int = 32767  # steps between 0 and its largest size


_COARSE = 1023  # levels of what an effect adds: on a chart of 200 pixels a tenth of one


def packed(tree: Any) -> dict[str, Any]:
    """Any nesting of dictionaries and lists as plain JSON: `tree`, in which an array is where its
    bytes begin in `bytes`, and what is not finite is null.

    Doubles as they are, `Drawn` in at most 16 bits of its largest size and as second differences
    along the last axis, which are small; the first bytes of all numbers first, and so on. Then
    zlib.
    """
    block = bytearray()

    def put(whole: np.ndarray, **about: Any) -> dict[str, Any]:
        about = {"at": len(block), "shape": list(whole.shape), **about}
        size = whole.dtype.itemsize
        block.extend(np.ascontiguousarray(whole).view("u1").reshape(-1, size).T.tobytes())
        return about

    def walk(x: Any) -> Any:
        if isinstance(x, Drawn):
            values = np.asarray(x.values, float)
            seen = np.isfinite(values)
            size = float(np.max(np.abs(values[seen]), initial=0.0)) / x.levels or 1.0
            whole = np.where(seen, np.round(np.where(seen, values, 0.0) / size), -32768)
            steps = np.diff(np.diff(whole.astype("<i4"), prepend=0), prepend=0)
            return put(steps.astype("<u2"), scale=size)
        if isinstance(x, np.ndarray):
            return put(x.astype("<f8"))
        if isinstance(x, dict):
            return {key: walk(value) for key, value in x.items()}
        if isinstance(x, list | tuple):
            return [walk(value) for value in x]
        return None if isinstance(x, float) and not math.isfinite(x) else x

    found = walk(tree)
    return {"tree": found, "bytes": base64.b64encode(zlib.compress(bytes(block), 9)).decode()}


def thinned(count: int) -> np.ndarray:
    """Indices of at most `POINTS` of so many instants, evenly."""
    return np.unique(np.linspace(0, count - 1, min(count, POINTS)).round().astype(int))


def payload(study: Study, *, live: bool = False, name: str = "", toml: str | None = None):
    """All that a page shows of a study before anybody touches it.

    **Arguments:** `live`: whether a server answers it; `name`: what the experiment is called on a
    command line; `toml`: the text of its file.
    """
    experiment, search, screen = study.experiment, study.search, study.screen
    if not live:
        for tried in search.tried:
            study.predicted(sorted(tried))
    held = "check recordings" if experiment.check_recordings else "last third"
    first = study.first_order()
    return {
        "version": __version__,
        "live": live,
        "name": name,
        "toml": toml,
        "joints": list(experiment.joints),
        "units": list(experiment.units or ("",) * len(experiment.joints)),
        "reads": [READS[k] for k in experiment.fit_recordings[0].orders],
        "reading_units": list(experiment.reading_units),
        "base": list(search.fixed),
        "with": [e.label for e in study.effects],
        "held_out": held,
        "recordings": [_recording(r) for r in _shown(study)],
        "candidates": [_candidate(study, s) for s in screen.ranked],
        "prior": {"further": FURTHER, "candidates": len(search.candidates)},
        "screen": {
            "weights": list(map(float, screen.weights)),
            "grams": [_upper(g) for g in screen.grams],
            "size": len(screen.grams[0]),
            "likeliest_base_means": list(screen.base_means),
        },
        "first": None if first is None else _first(study, first),
        "missing": _missing(study),
        **searched(study),
    }  # fmt: skip


def searched(study: Study, since: Sequence[int] = (0, 0)) -> dict[str, Any]:
    """What a search and fits have added: `tried`, `screened`, `unnamed`, `verdict`, `fits` by least
    squares and by the smoother but for the first `since` of each; how many there are is `known`."""
    found, base, tried = study.found, study.search.base, list(study.search.tried.values())
    fits, refits = list(study.fits.items()), list(study.refits)
    return {
        "tried": [
            {"added": list(t.added), "log_evidence": t.log_evidence - base.log_evidence}
            for t in tried
        ],
        "screened": [
            {"added": sorted(key), "gains": {s.effect.label: s.gain for s in screen.ranked}}
            for key, screen in list(study.search.screens.items())
            if key
        ],
        "unnamed": [
            {"beside": list(c.added), "gain": c.log_posterior - parent.log_posterior}
            for c in study.search.curves
            if c.matters and (parent := study.search.tried.get(frozenset(c.added)))
        ],
        "fits": [fitted(study, sorted(k), f) for k, f in fits[since[0]:]]
        + [r for k in refits[since[1]:] if k not in study.fits and (r := refitted(study, k))],
        "known": [len(fits), len(refits)],
        "verdict": None if found is None else {
            "verdict": found.verdict,
            "probability": found.verdict_probability,
            "added": list(found.added),
            "lookalikes": [list(x) for x in found.lookalikes],
            "coloured": found.coloured_noise is not None,
            "check": " ".join(found.words) if found.channels or found.explains_nothing else "",
            "next": "" if found.next_experiment is None else unbroken(found.next_experiment.words),
        },
    }  # fmt: skip


def fitted(study: Study, added: Sequence[str], found: Fit, held: Sequence[str] = ()):
    """One least-squares fit; numbers by the names in `held` were not fitted."""
    own = {id(one.recording): one for one in found.whole}
    curves = [
        Drawn(own[id(r)].predicted[thinned(len(r.time))].T) if id(r) in own else None
        for r in _shown(study)
    ]
    numbers = [_number(n.name, n.value, n.std, n.unit, n.sign, held) for n in found.own_numbers]
    errors = found.ratio, study.held_out(added, found)
    torque = _torque_of(study, added, found)
    return _model(study, added, "refitted", errors, numbers, curves, torque)


def refitted(study: Study, added: Collection[str]) -> dict[str, Any] | None:
    """Least squares by the smoother, with the error on what was held out if that was predicted;
    None if it does not settle."""
    found = study.refit(sorted(added))
    if found is None:
        return None
    scene, path, shown = study.search.scene, found.path, _shown(study)
    curves: list[Any] = [None] * len(shown)
    for i, r in enumerate(scene.recordings[: len(shown)]):
        own, at = scene.grid.of(i), r.time[thinned(len(r.time))] - r.time[0]
        curves[i] = Drawn([np.interp(at, scene.grid.time[own], x) for x in found.predicted[own].T])
    grown = float(np.maximum(1.0, np.max(found.fitted)))  # where the residual is no noise
    signs = {f"{e.label}.{n.name}": n.sign for e in path.effects for n in numbers_of(e)}
    numbers = [
        _number(name, v.value, grown * v.std, v.unit, signs[name])
        for name, v in values_of(scene, path).items()
    ]
    errors = found.fitted, study.predictions.get(frozenset(added))
    return _model(study, sorted(added), "smoothed", errors, numbers, curves, found.torque)


def _number(name: str, value: float, std: float, unit: str, sign: str, held: Sequence[str] = ()):
    return {"name": name, "value": value, "std": std, "unit": unit, "held": name in held,
            "positive": sign == "positive"}  # fmt: skip


def _model(
    study: Study,
    added: Sequence[str],
    how: str,
    errors: tuple[np.ndarray, np.ndarray | None],
    numbers: list[Any],
    curves: list[Any],
    torque: np.ndarray,
) -> dict[str, Any]:
    """A model with its errors over the noise, fitted and held out, and the torque (K, n) of its
    effects along its own motion."""
    beyond, scene = torque - study.base_torque, study.search.scene
    each = [scene.grid.of(i) for i in range(len(scene.recordings))][:_RECORDINGS]
    fitted, held_out = errors
    return {
        "added": list(added),
        "how": how,
        "fitted": fitted.tolist(),
        "held_out": None if held_out is None else held_out.tolist(),
        "numbers": numbers,
        "curves": curves,
        "torque": [Drawn(beyond[own[thinned(len(own))]].T) for own in each],
    }


# -- parts -----------------------------------------------------------------------------------


def _shown(study: Study):
    """The recordings that are drawn: fitted ones, then held-out ones."""
    e = study.experiment
    return [r for r, _ in by_recording((*e.fit_recordings, *e.check_recordings))][:_RECORDINGS]


def _recording(r):
    at = thinned(len(r.time))
    return {
        "name": r.name,
        "role": r.role,
        "start": float(r.time[0]),
        "noise": r.noise.tolist(),
        "time": r.time[at] - r.time[0],
        "angle": Drawn(r.angle[at].T),
    }


def _candidate(study: Study, s: Column):
    effect, scene = s.effect, study.search.scene
    rows = [r.which for r in study.screen.rows if r.effect.label == effect.label]
    own = [r.which for r in study.columns.rows if r.effect.label == effect.label]

    def told(n):
        return {"name": n.name, "words": n.words, "unit": scene.unit(effect, n)}

    written = ("label", "name", "place", "equation", "looks_like", "extends")
    return {
        **{name: getattr(effect, name) for name in written},
        "title": effect.titled(),
        "spoken": lower(effect.titled()),
        "kind": effect.kind(),
        "sticks": effect.dry or effect.follows,
        "oscillates": effect.oscillates is not None,
        "columns": list(own[0]),
        "rows": list(map(list, rows)),
        "best": rows.index(s.which),
        "shape": [
            {**told(n), "value": s.shape[n.field]} for n in numbers_of(effect) if n.silent is None
        ],
        "strengths": [
            {
                **told(n),
                "silent": n.silent,
                "width": width_of(scene, effect, n),
                "signed": signed(n),
            }
            for n in strengths(effect)
        ],
        "sizes": _sizes(s),
    }


def _sizes(s: Column):
    """Each size that the strengths of an effect may have in common: how many times as wide their
    priors are with it, and its log prior. None where they have none in common."""
    group = [own for own in s.strengths[0] if own is not None]
    if len(group) < 2:
        return []
    return [
        {"ratio": each.tolist(), "log_prior": math.log(weight)}
        for each, weight in zip(*common_sizes(group), strict=True)
    ]


def _upper(g: np.ndarray) -> np.ndarray:
    """The upper triangles (..., n (n + 1) / 2) of symmetric matrices, to 40 binary digits (1e-12):
    the last 12 are noise that nothing can compress."""
    rows, columns = np.triu_indices(g.shape[-1])
    bits = np.ascontiguousarray(g[..., rows, columns], float).view(np.int64)
    return ((bits + 0x800) & ~0xFFF).view(float)


def _first(study: Study, first: FirstOrder):
    """The first order; each column's predictions by themselves."""

    def errors(e: ErrorGram):
        return {"size": e.solve.shape[-1], "solve": _upper(e.solve), "joints": _upper(e.joints),
                "noise": e.noise.tolist(), "readings": e.readings.tolist()}  # fmt: skip

    def response(time: np.ndarray, predicted: np.ndarray):
        at = thinned(len(time))
        base, *columns = np.moveaxis(predicted[at], -1, 0)
        return {
            "time": time[at],
            "base": Drawn(base.T),
            "columns": [Drawn(c.T, _COARSE) for c in columns],
        }

    shown = range(len(_shown(study)))
    return {
        "fitted": errors(first.fitted),
        "held_out": errors(first.held_out),
        "predicted": [response(first.time[i], first.predicted[i]) for i in shown],
    }


def _missing(study: Study):
    search = study.search
    scene, g = search.scene, search.scene.grid
    columns = study.columns
    P = sum(len(numbers_of(e)) for e in study.loud.effects)
    by_number = np.moveaxis(np.asarray(columns.linear.by_number), -1, 0)
    found = []
    for i, each in enumerate(missing_of(scene, search.base)[:_RECORDINGS]):
        own = g.of(i)
        at = thinned(len(own))
        t = each.torque
        found.append({
            "recording": each.recording,
            "units": list(each.units),
            "time": t.time[at] - scene.recordings[i].time[0],
            **{k: Drawn(getattr(t, k)[at].T)
               for k in ("angle", "rate", "amplitude", "torque", "std")},
            "columns": _sparse(columns.torque[own[at]]),
            "base": _sparse(by_number[own[at]][..., :P]),
        })  # fmt: skip
    return found


def _sparse(x: np.ndarray):
    """Columns (N, n, C): for each its nonzero joints."""
    return [
        {str(j): Drawn(x[:, j, c], _COARSE) for j in range(x.shape[1]) if np.any(x[:, j, c])}
        for c in range(x.shape[2])
    ]


def _torque_of(study: Study, added: Sequence[str], found: Fit) -> np.ndarray:
    """(K, n) what the effects of a fit resist with along the smoothed motion of its model, N m."""
    path = study.motion(added)
    values = {n.name: n.value for n in found.numbers}
    names = [f"{e.label}.{n.name}" for e in path.effects for n in numbers_of(e)]
    u = np.zeros_like(path.u)
    u[: len(names)] = path.prior.regressors(np.array([values[n] for n in names]))
    return sum_of(study.search.scene.torques(dataclasses.replace(path, u=u)))

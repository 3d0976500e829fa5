"""What a page holds, as data: plain JSON, arrays as base64.

Everything that decides is in full double precision (Gram matrices); what is only drawn is at most
`POINTS` instants of a recording, in 16 bits of its own range.
"""

import base64
import functools
from collections.abc import Callable, Sequence
from typing import Any, ParamSpec, TypeVar

import jax
import numpy as np

from ... import __version__
from ...diagnosis.columns import Columns, strengths
from ...diagnosis.evidence import FURTHER, INDISTINGUISHABLE, signed, width_of
from ...diagnosis.missing_torque import missing_of
from ...filtering.law import numbers_of
from ...filtering.trajectory import Scene, Trajectory, number_slices
from ...fitting.result import Fit
from ...recordings.segments import by_recording
from ...runtime.json import finite
from .first_order import ErrorGram
from .study import Study

POINTS = 1000
"""Instants of a recording that are drawn."""
_RECORDINGS = 8  # that are drawn, at most


_P = ParamSpec("_P")
_R = TypeVar("_R")


def _in_double(work: Callable[_P, _R]) -> Callable[_P, _R]:
    """Runs in float64 whatever JAX's setting."""

    @functools.wraps(work)
    def wrapped(*args: _P.args, **named: _P.kwargs) -> _R:
        with jax.enable_x64(True):
            return work(*args, **named)

    return wrapped


def floats(x) -> dict[str, Any]:
    """An array in double precision."""
    x = np.ascontiguousarray(x, "<f8")
    return {"f8": base64.b64encode(x.tobytes()).decode(), "shape": list(x.shape)}


def shorts(x) -> dict[str, Any]:
    """An array in 16 bits of its largest size; what is not finite is -32768."""
    x = np.asarray(x, float)
    seen = np.isfinite(x)
    size = float(np.max(np.abs(x[seen]), initial=0.0)) / 32767 or 1.0
    whole = np.where(seen, np.round(np.where(seen, x, 0.0) / size), -32768).astype("<i2")
    return {
        "i2": base64.b64encode(np.ascontiguousarray(whole).tobytes()).decode(),
        "scale": size,
        "shape": list(x.shape),
    }


def thinned(count: int) -> np.ndarray:
    """Indices of at most `POINTS` of so many instants, evenly."""
    return np.unique(np.linspace(0, count - 1, min(count, POINTS)).round().astype(int))


@_in_double
def payload(study: Study, *, live: bool = False, name: str = "", toml: str | None = None):
    """All that a page shows of a study before anybody touches it.

    **Arguments:** `live`: whether a server answers it; `name`: what the experiment is called on a
    command line; `toml`: the text of its file.
    """
    experiment, search = study.experiment, study.search
    units = experiment.units or ("rad",) * len(experiment.joints)
    order = [s.effect.label for s in study.screen.ranked]
    first = study.first_order()
    shown = _shown(study)
    held = "check recordings" if experiment.check_recordings else "last third"
    return finite({
        "version": __version__,
        "live": live,
        "name": name,
        "toml": toml,
        "joints": list(experiment.joints),
        "units": list(units),
        "base": list(search.fixed),
        "with": [e if isinstance(e, str) else e.label for e in study.effects],
        "held_out": held,
        "noise": study.fit(()).noise.tolist(),
        "recordings": [_recording(r) for r in shown],
        "candidates": [_candidate(study, label) for label in order],
        "prior": {"further": FURTHER, "candidates": len(search.candidates)},
        "indistinguishable": INDISTINGUISHABLE,
        "screen": _screen(study),
        "first": None if first is None else {
            "fitted": _errors(first.fitted),
            "held_out": _errors(first.held_out),
            "predicted": [
                _response(first.time[i], first.predicted[i]) for i in range(len(shown))
            ],
        },
        "missing": _missing(study),
        **searched(study),
    })  # fmt: skip


@_in_double
def searched(study: Study) -> dict[str, Any]:
    """What a search and fits have added since: `tried`, `screened`, `fits`, `verdict`."""
    found = study.found
    tried = list(study.search.tried.values())
    fits = [fitted(study, sorted(k), f) for k, f in list(study.fits.items())]
    known = {tuple(f["added"]) for f in fits}
    fits += [
        f for t in tried if tuple(sorted(t.added)) not in known and (f := smoothed(study, t.added))
    ]
    return finite({
        "tried": [
            {
                "added": list(t.added),
                "log_evidence": t.log_evidence - study.search.base.log_evidence,
                "complete": t.complete,
            }
            for t in tried
        ],
        "screened": [
            {"added": sorted(key), "gains": {s.effect.label: s.gain for s in screen.ranked}}
            for key, screen in list(study.search.screens.items())
            if key
        ],
        "fits": fits,
        "verdict": None if found is None else {
            "verdict": found.verdict,
            "probability": found.verdict_probability,
            "added": list(found.added),
            "words": list(found.words),
            "lookalikes": [list(x) for x in found.lookalikes],
        },
    })  # fmt: skip


@_in_double
def fitted(study: Study, added: Sequence[str], found: Fit, held: Sequence[str] = ()):
    """One least-squares fit; numbers by the names in `held` were not fitted."""
    beside = study.held_out(added, found)
    shown = {id(r): i for i, r in enumerate(_shown(study))}
    curves: list[Any] = [None] * len(shown)
    for one in found.whole:
        i = shown.get(id(one.recording))
        if i is not None:
            curves[i] = shorts(one.predicted[thinned(len(one.recording.time))].T)
    return finite({
        "added": list(added),
        "how": "refitted",
        "fitted": (found.rmse / found.noise).tolist(),
        "held_out": None if beside is None else beside.tolist(),
        "numbers": [
            {"name": n.name, "words": n.words, "value": n.value, "std": n.std, "unit": n.unit,
             "held": n.name in held, "positive": n.sign == "positive"}
            for n in found.numbers
        ],
        "curves": curves,
        "torque": _torque(study, found),
        "seconds": found.seconds,
    })  # fmt: skip


@_in_double
def smoothed(study: Study, added: Sequence[str]) -> dict[str, Any] | None:
    """A fit by the smoother; None if it does not settle."""
    found = study.quick(added)
    if found is None:
        return None
    scene, path, shown = study.search.scene, found.path, _shown(study)
    seen = np.asarray(scene.linearised(path).seen)
    curves: list[Any] = [None] * len(shown)
    for i, r in enumerate(scene.recordings[: len(shown)]):
        own = np.flatnonzero((scene.grid.run == i) & (np.arange(scene.K) < scene.grid.real))
        at = r.time[thinned(len(r.time))] - r.time[0]
        curves[i] = shorts([np.interp(at, scene.grid.time[own], x) for x in seen[own].T])
    units = scene.mechanisms[0].units
    numbers: list[dict[str, Any]] = []
    assert path.covariance is not None
    slopes = path.prior.slopes(path.u)
    grown = np.maximum(1.0, np.max(found.fitted))  # where the residual is no noise
    spread = grown * np.sqrt(np.diag(path.covariance)[: len(slopes)]) * np.abs(slopes)
    for effect, own in zip(path.effects, number_slices(path.effects), strict=True):
        unit = units[scene.joint_of(effect)] if units else None
        for n, x, std in zip(numbers_of(effect), path.numbers[own], spread[own], strict=True):
            numbers.append({
                "name": f"{effect.label}.{n.name}", "words": n.words, "value": float(x),
                "std": float(std), "unit": n.dimension.unit(unit), "held": False,
                "positive": n.sign == "positive",
            })  # fmt: skip
    return {
        "added": sorted(added),
        "how": "smoothed",
        "fitted": found.fitted.tolist(),
        "held_out": None if found.held_out is None else found.held_out.tolist(),
        "numbers": numbers,
        "curves": curves,
        "torque": _along_itself(study, path),
        "seconds": None,
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
        "time": floats(r.time[at] - r.time[0]),
        "angle": shorts(r.angle[at].T),
    }


def _candidate(study: Study, label: str):
    s = {s.effect.label: s for s in study.screen.ranked}[label]
    effect, scene = s.effect, study.search.scene
    units = scene.mechanisms[0].units
    unit = units[scene.joint_of(effect)] if units else None
    rows = [r for r in study.screen.rows if r.effect.label == label]
    return {
        "label": label,
        "title": effect.titled(),
        "name": effect.name,
        "place": effect.place,
        "kind": effect.kind(),
        "equation": effect.equation,
        "looks_like": effect.looks_like,
        "extends": effect.extends,
        "rows": [list(r.which) for r in rows],
        "best": [r.which for r in rows].index(s.which),
        "gain": s.gain,
        "oscillates": effect.oscillates is not None,
        "shape": [
            {"name": n.name, "words": n.words, "value": s.shape[n.field],
             "unit": n.dimension.unit(unit)}
            for n in numbers_of(effect)
            if n.silent is None
        ],
        "strengths": [
            {
                "name": n.name,
                "words": n.words,
                "unit": n.dimension.unit(unit),
                "silent": n.silent,
                "width": width_of(scene, effect, n),
                "signed": signed(effect, n),
            }
            for n in strengths(effect)
        ],
    }  # fmt: skip


def _screen(study: Study):
    screen = study.screen
    return {
        "weights": list(map(float, screen.weights)),
        "grams": [floats(_upper(g)) for g in screen.grams],
        "size": len(screen.grams[0]),
        "likeliest_base_means": [floats(m) for m in screen.base_means],
    }


def _upper(g: np.ndarray) -> np.ndarray:
    return g[np.triu_indices(len(g))]


def _errors(e: ErrorGram):
    return {
        "solve": floats(e.solve),
        "joints": floats(e.joints),
        "noise": e.noise.tolist(),
        "readings": e.readings.tolist(),
    }


def _response(time: np.ndarray, predicted: np.ndarray):
    """A recording's predictions (N, n, 1 + C), each column in 16 bits of its own."""
    at = thinned(len(time))
    base, *columns = np.moveaxis(predicted[at], -1, 0)
    return {"time": floats(time[at]), "base": shorts(base.T),
            "columns": [shorts(c.T) for c in columns]}  # fmt: skip


def _missing(study: Study):
    search = study.search
    scene, g = search.scene, search.scene.grid
    columns = study.columns()
    P = sum(len(numbers_of(e)) for e in study.loud.effects)
    by_number = np.moveaxis(np.asarray(columns.linear.by_number), -1, 0)
    found = []
    for i, each in enumerate(missing_of(scene, search.base)[:_RECORDINGS]):
        own = np.flatnonzero((g.run == i) & (np.arange(scene.K) < g.real))
        at = thinned(len(own))
        t = each.torque
        found.append({
            "recording": each.recording,
            "units": list(each.units),
            "time": floats(t.time[at] - scene.recordings[i].time[0]),
            **{k: shorts(getattr(t, k)[at].T)
               for k in ("angle", "rate", "amplitude", "torque", "std")},
            "columns": _sparse(columns.torque[own[at]]),
            "base": _sparse(by_number[own[at]][..., :P]),
        })  # fmt: skip
    return found


def _sparse(x: np.ndarray):
    """Columns (N, n, C): for each its nonzero joints."""
    return [
        {str(j): shorts(x[:, j, c]) for j in range(x.shape[1]) if np.any(x[:, j, c])}
        for c in range(x.shape[2])
    ]


def _torque(study: Study, found: Fit):
    """Per drawn fitted recording (n, N): the torque that a fit says the base model lacks along the
    smoothed motion: that of its further effects, and of the change of the others' numbers."""
    search, t = study.search, study.loud
    scene, g = search.scene, search.scene.grid
    known = search.tried.get(frozenset(found.model.labels) - frozenset(search.base.best.labels))
    if known is not None:  # along its own smoothed motion, where it sticks as it should
        return _along_itself(study, known.best)
    values = {n.name: n.value for n in found.numbers}
    names = [f"{e.label}.{n.name}" for e in t.effects for n in numbers_of(e)]
    numbers = np.array([values[n] for n in names])
    change = t.prior.regressors(numbers) - t.u[: len(numbers)]
    by_number = np.moveaxis(np.asarray(scene.linearised(t).by_number), -1, 0)
    total = by_number[..., : len(change)] @ change
    for effect in found.model.effects:
        if effect.label in t.labels or effect.senses:
            continue
        own = numbers_of(effect)
        value = {n.field: values[f"{effect.label}.{n.name}"] for n in own}
        shape = {n.field: value[n.field] for n in own if n.silent is None}
        columns = Columns(scene, t, [effect], [], {effect.label: shape}).torque
        u = np.array([
            (value[n.field] - float(n.silent or 0.0)) / width_of(scene, effect, n)
            for n in strengths(effect)
        ])  # fmt: skip
        if effect.oscillates:  # the phase is the recording's own: whatever it lacks most
            lacks = missing_of(scene, search.base)
            lack = np.concatenate([m.torque.torque for m in lacks]).ravel()
            u = np.linalg.lstsq(columns[: g.real].reshape(len(lack), -1), lack, rcond=None)[0]
        total = total + columns @ u
    return _cut(scene, total)


def _along_itself(study: Study, path: Trajectory) -> list[dict[str, Any]]:
    """The torque that a model has beyond the base model's, each along its own motion."""
    scene = study.search.scene
    own, before = (scene.torques(t) for t in (path, study.search.base.best))
    total = np.sum([*own.values()], axis=0) - np.sum([*before.values()], axis=0)
    return _cut(scene, total)


def _cut(scene: Scene, torque: np.ndarray) -> list[dict[str, Any]]:
    """A torque (K, n), thinned, for each recording that is drawn."""
    g, out = scene.grid, []
    for i in range(min(len(scene.recordings), _RECORDINGS)):
        own = np.flatnonzero((g.run == i) & (np.arange(scene.K) < g.real))
        out.append(shorts(torque[own[thinned(len(own))]].T))
    return out

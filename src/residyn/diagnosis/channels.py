"""Whether the columns of the recordings are what the experiment's file says they are.

Exchanged cables, a reversed sign, degrees, or angles counted from the table instead of from the
link before: the model is right and the readings are another quantity. Each of these is a linear map
of the readings. The base model's density of the mapped readings, times the map's determinant, is
one of the readings: an evidence on the same scale as that of any other model.
"""

import contextlib
import dataclasses
import functools
import itertools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from ..effects import AbstractEffect
from ..errors import InputError
from ..filtering.trajectory import Scene
from ..fitting import FitError
from ..fitting.problem import ready
from ..recordings.arrays import check_enough
from ..recordings.experiment import Experiment
from ..recordings.tables import ArmTable
from ..runtime.parallel import side_by_side
from .evidence import log_prior_model
from .tried import Tried, tried_alone


class Channels(NamedTuple):
    """What the columns of n joints may be instead."""

    words: str
    matrix: np.ndarray  # (n, n) the joints' readings from the columns


class Reassigned(NamedTuple):
    """The base model, with the columns read otherwise."""

    channels: Channels
    tried: Tried
    """As if the noise of the joints were independent, which lowers the evidence a little where a
    column is a sum."""


def assignments(experiment: Experiment) -> list[Channels]:
    """One mistake each: two columns exchanged, one or all reversed, a link's angle to the table,
    degrees."""
    joints, n, first = experiment.joints, len(experiment.joints), experiment.fit_recordings[0]
    eye, found = np.eye(n), []
    kinds = list(zip(experiment.reading_units, first.orders, strict=True))
    for i, j in itertools.combinations(range(n), 2):
        if kinds[i] == kinds[j]:
            order = np.arange(n)
            order[[i, j]] = j, i
            words = f"the columns of {joints[i]} and {joints[j]} are exchanged"
            found.append(Channels(words, eye[order]))
    driven = any(r.drive is not None for r in experiment.fit_recordings)
    if n > 1 or driven:
        found += [
            Channels(f"the sign of {joint}'s column is reversed", eye - 2 * np.diag(eye[j]))
            for j, joint in enumerate(joints)
        ]
    if isinstance(experiment.inertia, ArmTable):
        found.append(Channels("angles are counted the other way round", -eye))
        words = f"{joints[1]}'s column is its link's angle to the table, not to the link before"
        found.append(Channels(words, eye - np.eye(n, k=-1)))
    if set(experiment.units or ()) == {"rad"}:
        found.append(Channels("angles are in degrees, not in rad", np.deg2rad(eye)))
    return found


def reassigned(
    experiment: Experiment, effects: Sequence[str | AbstractEffect], scene: Scene, base: Tried,
    candidates: int, go_on: Callable[[], None] = lambda: None,
) -> list[Reassigned]:  # fmt: skip
    """The base model with some effects under each assignment of the columns that it can move under,
    or until it falls hopelessly behind the columns as they stand (`scene` and `base`). Each is as
    unlikely beforehand as one effect of all `candidates`. `go_on` is called before each iteration.

    A sum of columns is missing where one of them is. Both models are then compared on the readings
    of which sums are left, as if the others told nothing of it; not at all where a joint has none.
    """
    recordings = experiment.fit_recordings
    columns = [np.where(w, np.nan, r.angle) for r, w in zip(recordings, scene.wild, strict=True)]

    def read_as(angles: Sequence[np.ndarray], M: np.ndarray):
        """Scene and base model of readings (N, n) that are `M` times the columns."""
        for x in angles:
            check_enough(x, part=False)
        each = tuple(
            dataclasses.replace(r, angle=x, noise=np.sqrt(np.asarray(r.noise) ** 2 @ (M**2).T))
            for r, x in zip(recordings, angles, strict=True)
        )
        here = ready(dataclasses.replace(experiment, recordings=each), each, effects)
        none = [np.zeros(x.shape, bool) for x in angles]
        # What is linear in the readings is no faster than they are.
        found = Scene(here.recordings, here.mechanisms, none, scene.grid.fast)
        found.catalogued, found.fixed = scene.catalogued, scene.fixed  # one program for all
        return found, here.model.effects

    def under(channels: Channels) -> Reassigned | None:
        M = channels.matrix
        angles = [_sums(x, M) for x in columns]
        left = [_sums(x, np.linalg.inv(M)) for x in angles]
        with contextlib.suppress(FitError, InputError):
            seen, members = read_as(angles, M)
            more = seen.length * float(np.linalg.slogdet(M)[1]) / len(M)
            if np.isnan(np.concatenate(left)).sum() > np.isnan(np.concatenate(columns)).sum():
                alone = tried_alone(*read_as(left, np.eye(len(M))), go_on=go_on)
                more += base.log_evidence - alone.log_evidence
            tried = tried_alone(seen, members, base.log_evidence - more, go_on)
            tried = dataclasses.replace(tried, evidences=tried.evidences + more)
            return Reassigned(channels, tried)
        return None

    each = side_by_side([functools.partial(under, c) for c in assignments(experiment)])
    found = [r for r in each if r is not None]
    prior = log_prior_model(1, candidates + len(found))
    return [r._replace(tried=dataclasses.replace(r.tried, log_prior=prior)) for r in found]


def _sums(columns: np.ndarray, M: np.ndarray) -> np.ndarray:
    """(N, n) `M` times columns (N, n); NaN where one that it takes is missing."""
    return np.where(np.isnan(columns) @ (M != 0).T, np.nan, np.nan_to_num(columns) @ M.T)

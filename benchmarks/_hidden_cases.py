"""Which recordings the hidden-effect benchmark is made of, each remade from its name alone.

A case is one release of one random arm with something hidden in it, and everything random about it
follows from its *seed*, its labels and its noise: so a case needs no file, and the same name means
the same recording to every method. The lists of seeds are frozen. Whatever was tuned, a threshold
or a line of code, was tuned on `TUNING`. `EVIDENCE` was committed before the diagnosis by marginal
likelihood was written, and has been looked at since; `FRESH`, `LATEST` and `UNSEEN` were each
committed before the one run that is reported of them, and looked at after it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tests import rig

TUNING = tuple(range(7001, 7201))
EVIDENCE = tuple(range(883001, 883201))
FRESH = tuple(range(641301, 641501))
LATEST = tuple(range(271801, 272001))
UNSEEN = tuple(range(314601, 314801))
SEEDS = {
    "tuning": TUNING,
    "evidence": EVIDENCE,
    "fresh": FRESH,
    "latest": LATEST,
    "unseen": UNSEEN,
}
"""A case of index i takes the i-th seed of a list. Frozen."""

NOISE = (0.0025, 0.01, 0.05)
"""Shares of the amplitude: of the largest swings of both joints, in the mean (root of squares)."""
PLAN = (
    ("single", NOISE, 3),
    ("none", NOISE[:1], 33),
    ("none", NOISE[1:2], 34),
    ("none", NOISE[2:], 33),
    ("outside", NOISE[1:2], 4),
    ("pairs", NOISE[1:2], 40),
)
"""The published table: what, at which noise, from how many seeds: 540 cases."""
FAIR = (0.02, 0.1)
"""Strength of each of two effects at once, and of `unnamed_laws`: the share of their torque in the
spring's."""

_KINDS = (
    ("coulomb_friction", "stribeck_friction", "bearing_friction"),
    ("quadratic_drag", "bearing_quadratic_drag", "bearing_drag", "coupling_damping"),
    ("asymmetric_damping",),
    ("cubic_stiffness", "asymmetric_stiffness", "dead_zone", "coupling_stiffness"),
    ("hysteresis", "brake_slip"),
    ("constant_torque", "gravity"),
    ("periodic_disturbance",),
    ("stiffness_drift",),
    ("sensor_offset", "sensor_scale", "sensor_delay"),
    ("inertia_error", "wrist_flexibility"),
)
"""Physical kinds: two effects at once are never of one kind."""


@dataclass(frozen=True)
class Spec:
    """A case before it is made."""

    what: str
    """"single", "none", "outside" or "pairs"; of `unnamed_laws`: "unnamed" or "named"."""
    labels: tuple[str, ...]
    """What is hidden: nothing, one effect, or two."""
    noise: float
    seed: int

    @property
    def key(self) -> str:
        """Its name: the same everywhere."""
        return f"{self.what}/{'+'.join(self.labels) or '-'}/{self.noise:g}/{self.seed}"

    @classmethod
    def of(cls, key: str) -> Spec:
        """The case of that name."""
        what, labels, noise, seed = key.split("/")
        return cls(what, () if labels == "-" else tuple(labels.split("+")), float(noise), int(seed))

    def make(self) -> rig.HiddenCase:
        """The recording, and its truth."""
        about = [*"/".join(self.labels).encode(), round(1e6 * self.noise)]
        rng = np.random.default_rng([self.seed, *about])
        strength = None
        if self.what in ("pairs", "unnamed", "named"):
            strength = float(np.exp(rng.uniform(*np.log(FAIR))))
        (case,) = rig.hidden_cases(rng, self.labels, 1, noise_share=self.noise, strength=strength)
        swings = np.abs(case.motion[0]).max(axis=0)
        noise = self.noise * float(np.sqrt(np.mean(swings**2)))
        readings = case.truth + noise / case.noise * (case.q - case.truth)
        return replace(case, q=readings, noise=noise)


def specs(
    what: Sequence[str],
    noise: Sequence[float] = NOISE,
    count: int = 1,
    seeds: str = "tuning",
    only: Sequence[str] = (),
    skip: int = 0,
) -> Iterator[Spec]:
    """Cases of every label: `count` of each at each noise ("none" and "pairs" are one label), of
    all seeds but the first `skip`.

    With `only`, the labels (or bare names, for both joints) to keep: a pair needs one of them, and
    "none" has none.
    """
    for seed in SEEDS[seeds][skip : skip + count]:
        for share in noise:
            for kind in what:
                for labels in _labels(kind, seed, share):
                    names = {x for label in labels for x in (label, label.partition(":")[0])}
                    if not only or names & set(only):
                        yield Spec(kind, labels, share, seed)


def _labels(what: str, seed: int, noise: float) -> list[tuple[str, ...]]:
    if what == "none":
        return [()]
    if what == "pairs":
        return [_pair(np.random.default_rng([seed, round(1e6 * noise), 2]))]
    return [(label,) for label in (rig.OUTSIDE if what == "outside" else rig.NAMES)]


def _pair(rng: np.random.Generator) -> tuple[str, str]:
    """Two labels of different kinds: the kinds alike, then the effects of each."""
    first, second = (
        _KINDS[i][rng.integers(len(_KINDS[i]))] for i in rng.permutation(len(_KINDS))[:2]
    )
    return _place(rng, first), _place(rng, second)


def _place(rng: np.random.Generator, name: str) -> str:
    places = [x for x in rig.NAMES if x.partition(":")[0] == name]
    return places[rng.integers(len(places))]

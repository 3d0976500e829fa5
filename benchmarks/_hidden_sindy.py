"""Another way to name a hidden effect, on the same recordings: PySINDy.

It regresses the torque on a library of the effects' torques and thresholds. It is given all
that residyn is given: the inertias, so that its target is the whole joint torque; the torque
laws with their names; and a threshold and a smoothing tuned on the tuning seeds. Two of its forms:
`stlsq` differentiates the smoothed angles twice, `weak` integrates against smooth windows instead,
which asks for one derivative less (for it the joint torque is the rate of the momentum, less what
the elbow's turning does to that). Each joint has its own regression. Columns and target have unit
rms, so that a coefficient is a share of the torque, and the threshold one too; for they are nearly
parallel (a sine is nearly its angle) the ridge is tuned as well, and whether spring and damper are
taken off the other columns before. It names the effect
with the largest share beside spring and damper, and none where no other term is left. What is not a
function of the readings at one instant cannot be in any such library: effects with memory
(hysteresis, a slipping brake, a flexible wrist), a disturbance of unknown frequency, a wrong
inertia, and whatever errs in the sensors.
"""

from __future__ import annotations

import itertools
import time
import warnings
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from benchmarks._hidden_cases import Spec
from tests import rig

JOINTS = ("shoulder", "elbow")
ABSENT = ("hysteresis", "brake_slip", "wrist_flexibility", "periodic_disturbance", "inertia_error")
"""Effects that the regressions have no terms for; nor have they any for what sensors do."""


class Setting(NamedTuple):
    """What there is to tune."""

    window: float
    """Of the smoothing, in periods of the highest line."""
    threshold: float
    """Share of the torque."""
    ridge: float
    """STLSQ's alpha, per row."""
    cleared: bool
    """Whether spring and damper are taken off all other columns first, and are never dropped."""


TUNED = {
    "stlsq": {
        0.0025: Setting(0.6, 0.04, 1e-2, True),
        0.01: Setting(0.6, 0.04, 5e-2, True),
        0.05: Setting(1.0, 0.04, 5e-2, True),
    },
    "weak": {
        0.0025: Setting(0.3, 0.02, 1e-2, True),
        0.01: Setting(0.6, 0.01, 5e-2, True),
        0.05: Setting(1.0, 0.04, 1e-2, True),
    },
}
"""The best on the tuning seeds by form and noise, of `GRID` (`sindy --tune`): in the mean of the
share of effects named (24 labels; two arms each at 1 %, one at the other noises) and the share of
recordings of nothing to which it added nothing (10 and 6)."""
_THRESHOLDS = (0.002, 0.005, 0.01, 0.02, 0.04)
GRID = (
    *itertools.starmap(
        Setting, itertools.product((0.3, 0.6, 1.0), _THRESHOLDS, (1e-3, 1e-2, 5e-2), (True,))
    ),
    *itertools.starmap(Setting, itertools.product((0.6,), _THRESHOLDS, (2.5e-5, 1e-2), (False,))),
)


def sindy(spec: Spec, tune: bool = False) -> list[dict[str, Any]]:
    """Both forms, as tuned, or at every setting."""
    warnings.simplefilter("ignore")  # that all coefficients vanish is an answer
    case, rows = spec.make(), []
    for form, by_noise in TUNED.items():
        tuned = by_noise[min(by_noise, key=lambda noise: abs(np.log(spec.noise / noise)))]
        for setting in GRID if tune else (tuned,):
            began = time.perf_counter()
            found = names(Regression(case, setting.window), form, *setting[1:])
            row = {"key": spec.key, "what": spec.what, "hidden": list(spec.labels)}
            row |= {"noise": spec.noise, "method": f"{form} {setting}" if tune else form}
            rows.append(row | {"named": found, "seconds": time.perf_counter() - began})
    return rows


def settings(rows: Sequence[dict[str, Any]], best: int = 5) -> str:
    """The best settings by form and noise: mean of the share of effects (of its library) named,
    and the share of recordings of nothing left alone."""
    scores: dict[tuple[str, float], dict[str, dict[str, list[bool]]]] = {}
    for row in rows:
        if "method" in row and not any(x.startswith(("sensor_", *ABSENT)) for x in row["hidden"]):
            form, _, setting = row["method"].partition(" ")
            own = scores.setdefault((form, row["noise"]), {}).setdefault(setting, {})
            right = row["named"][: len(row["hidden"]) or None] == row["hidden"]
            own.setdefault(row["what"], []).append(right)
    lines = []
    for (form, noise), own in sorted(scores.items()):
        order = sorted(own, key=lambda m: -np.mean([np.mean(x) for x in own[m].values()]))
        for m in order[:best]:
            words = ", ".join(f"{what} {np.mean(x):.0%} of {len(x)}" for what, x in own[m].items())
            lines.append(f"{form}, noise {100 * noise:g} %, {m}: {words}")
    return "\n".join(lines)


class Regression:
    """Smoothed motion, the torque that it takes, and the library along it."""

    def __init__(self, case: rig.HiddenCase, window: float, library: Any = None):
        """`library(case, q, v, t, j)`: another one than the catalogue's."""
        from scipy.integrate import cumulative_trapezoid
        from scipy.signal import savgol_filter

        arm, t = case.arm, case.t
        step = t[1] - t[0]
        samples = max(7, round(window / _highest(case.q, step) / step)) | 1
        q, v, a = (savgol_filter(case.q, samples, 5, deriv=k, delta=step, axis=0) for k in range(3))
        self.t = t
        cross, bend = (arm.l1 * arm.coupling * f(arm.theta2 + q[:, 1]) for f in (np.cos, np.sin))
        z11, z12, z22 = arm.shoulder + arm.elbow + 2 * cross, arm.elbow + cross, arm.elbow
        turning = -bend * (v[:, 0] ** 2 + v[:, 0] * v[:, 1])
        self.momentum = np.stack(
            [
                z11 * v[:, 0] + z12 * v[:, 1],
                z12 * v[:, 0] + z22 * v[:, 1] - cumulative_trapezoid(turning, t, initial=0.0),
            ],
            axis=1,
        )
        self.rate = np.stack(
            [
                z11 * a[:, 0] + z12 * a[:, 1] - bend * (2 * v[:, 0] * v[:, 1] + v[:, 1] ** 2),
                z12 * a[:, 0] + z22 * a[:, 1] + bend * v[:, 0] ** 2,
            ],
            axis=1,
        )
        self.library = [(library or _library)(case, q, v, t, j) for j in range(2)]
        self._systems: dict[tuple[str, int], tuple[np.ndarray, np.ndarray]] = {}

    def system(self, method: str, j: int) -> tuple[np.ndarray, np.ndarray]:
        """As the function of that name; worked out once."""
        if (method, j) not in self._systems:
            self._systems[method, j] = system(self, method, j)
        return self._systems[method, j]


def _highest(q: np.ndarray, step: float) -> float:
    """Frequency (Hz) of the highest line that stands out in the readings."""
    taper = np.hanning(len(q))[:, None]
    power = np.sum(np.abs(np.fft.rfft((q - q.mean(axis=0)) * taper, axis=0)) ** 2, axis=1)
    frequency = np.fft.rfftfreq(len(q), step)
    power[frequency > 8.0] = 0.0
    return float(frequency[power > 1e-3 * power.max()].max())


def _library(case: rig.HiddenCase, q, v, t, j: int) -> list[tuple[str, np.ndarray]]:
    """(effect, its torque at joint j but for a factor), the base model's first."""
    arm, joint, other = case.arm, JOINTS[j], 1 - j
    x, w = q[:, j], v[:, j]
    swing, pace = np.abs(x).max(), np.abs(w).max()
    own = {
        "spring": [x],
        "damper": [w],
        "coulomb_friction": [np.sign(w)],
        "stribeck_friction": [np.sign(w) * np.exp(-((w / (0.1 * pace)) ** 2))],
        "quadratic_drag": [w * np.abs(w)],
        "cubic_stiffness": [x**3],
        "asymmetric_stiffness": [np.abs(x)],
        "asymmetric_damping": [np.abs(w)],
        "dead_zone": [np.clip(x, -share * swing, share * swing) for share in (0.15, 0.4)],
        "constant_torque": [np.ones_like(x)],
        "stiffness_drift": [t * x],
    }
    first, second = q[:, 0], q[:, 0] + arm.theta2 + q[:, 1]
    angles = (first, second) if j == 0 else (second,)
    whole = {
        "coupling_stiffness": [q[:, other]],
        "coupling_damping": [v[:, other]],
        "gravity": [f(angle) for angle in angles for f in (np.sin, np.cos)],
        "bearing_drag": [_bearings(case, q, v, 0)[:, j]],
        "bearing_quadratic_drag": [_bearings(case, q, v, 1)[:, j]],
        "bearing_friction": [_bearings(case, q, v, -1)[:, j]],
    }
    named = [(f"{name}:{joint}", c) for name, columns in own.items() for c in columns]
    return named + [(name, c) for name, columns in whole.items() for c in columns]


def _bearings(case: rig.HiddenCase, q, v, power: int) -> np.ndarray:
    """Torques of a force |u|^power u against every bearing's velocity u in the plane."""
    arm = case.arm
    turned = arm.theta2 + q[:, 1]
    reach = np.stack([arm.l1 + arm.l2 * np.cos(turned), arm.l2 * np.sin(turned)])
    tip = np.stack([arm.l2 * np.cos(turned), arm.l2 * np.sin(turned)])
    inner = np.stack([np.full(len(q), arm.l1), np.zeros(len(q))])
    total = np.zeros_like(q)
    for place in case.bearings:
        arms = (inner, 0 * inner) if place == "elbow" else (reach, tip)
        u = arms[0] * v[:, 0] + arms[1] * v[:, 1]  # turned by a right angle, as both arms are
        speed = np.maximum(np.hypot(*u), 1e-9)
        force = u * speed**power
        total += np.stack([np.sum(r * force, axis=0) for r in arms], axis=1)
    return total


def system(here: Regression, method: str, j: int) -> tuple[np.ndarray, np.ndarray]:
    """Library (columns of unit rms) and target (of unit rms) of joint j: at every instant, or
    integrated against windows."""
    import pysindy

    columns = np.stack([c for _, c in here.library[j]], axis=1)
    columns = columns / np.sqrt(np.mean(columns**2, axis=0))
    size = np.sqrt(np.mean(here.rate[:, j] ** 2))
    if method == "stlsq":
        return columns, here.rate[:, j] / size
    np.random.seed(0)  # noqa: NPY002 (where PySINDy draws its windows from)
    library = pysindy.WeakPDELibrary(
        function_library=pysindy.IdentityLibrary(), spatiotemporal_grid=here.t, K=300, p=4
    )
    integrals = np.asarray(library.fit_transform(columns))
    target = np.asarray(library.convert_u_dot_integral(here.momentum[:, [j]] / size))[:, 0]
    scale = np.sqrt(np.mean(target**2))
    return integrals / scale, target / scale


def names(
    here: Regression, method: str, threshold: float, ridge: float, cleared: bool
) -> list[str]:
    """Effects beside the base model's, the largest share first."""
    import pysindy

    shares: dict[str, float] = {}
    for j in range(2):
        columns, target = here.system(method, j)
        labels = [label for label, _ in here.library[j]]
        if cleared:
            base = np.linalg.qr(columns[:, :2])[0]
            columns = columns[:, 2:] - base @ (base.T @ columns[:, 2:])
            target = target - base @ (base.T @ target)
            labels = labels[2:]
        # Columns of unit rms: a coefficient is a share of the torque.
        size = np.sqrt(np.mean(columns**2, axis=0))
        optimizer = pysindy.STLSQ(threshold=threshold, alpha=ridge * len(target), max_iter=30)
        optimizer.fit(columns / size, target[:, None])
        for label, share in zip(labels, optimizer.coef_[0], strict=True):
            if label.partition(":")[0] not in ("spring", "damper") and share:
                shares[label] = shares.get(label, 0.0) + abs(share)
    return sorted(shares, key=lambda label: -shares[label])

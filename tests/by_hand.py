"""Results put together by hand: what is printed and drawn does not depend on how it was found."""

import jax.numpy as jnp
import numpy as np

from residyn.diagnosis import Comparison, Curve, Missing, MissingTorque
from residyn.diagnosis.adequacy import White
from residyn.diagnosis.horizon import Ahead, Error, HeldOut, Horizon
from residyn.diagnosis.result import Candidate, Diagnosis, NextExperiment, Rung, Value
from residyn.diagnosis.where import Cell, Part, Where
from residyn.fitting import Fit, Mode, Number, RecordingFit, mechanism_of, model_for
from residyn.recording import ArmTable, Experiment, Recording

NASTY = "<script>alert('x')</script> & \"q\" $a$ {{ 7*7 }}.csv"
WILD, LOST = 120, slice(200, 240)
JOINTS = ("shoulder", "elbow")
SIZES = (0.2, 0.05), (0.1, 0.1)
SLIP = 0.01
FOUND, RIVAL = "coulomb_friction:elbow", "stribeck_friction:elbow"


def two_modes(time, sizes, slip):
    """Two joints that ring in two modes; `slip` is a small third harmonic of the first."""
    slow, fast = (
        np.exp(-0.02 * 2 * np.pi * f * time) * np.cos(2 * np.pi * f * time) for f in (0.36, 1.9)
    )
    shoulder = sizes[0] * slow + sizes[1] * fast
    return np.stack(
        [shoulder + slip * slow**3, 0.4 * sizes[0] * slow - 3 * sizes[1] * fast], axis=1
    )


def recording(name, role, sizes, seed):
    time = np.arange(800) / 80
    noise = np.array([1e-3, 2e-3])
    angle = two_modes(time, sizes, SLIP)
    angle += noise * np.random.default_rng(seed).standard_normal(angle.shape)
    angle[WILD, 1] += 0.5
    angle[LOST] = np.nan
    return Recording.from_arrays(time, angle, noise=noise, theta2=0.3, name=name, role=role)


def beside(run, sizes, slip=0.0):
    """A recording beside a model that lacks the third harmonic, and finds the wild reading."""
    wild = np.zeros(run.angle.shape, bool)
    wild[WILD, 1] = True
    return RecordingFit(run, two_modes(run.time, sizes, slip), wild, np.zeros(4))


def a_fit(effects=(), slip=0.0, chi2=12.3, **changed):
    """A fit of one recording that is fitted and one that is held out."""
    table = ArmTable((0.4, 0.4), 1.1662, 0.579, 1.4384)
    runs = recording(NASTY, "fit", SIZES[0], 1), recording("check.csv", "check", SIZES[1], 2)
    experiment = Experiment(table, runs)
    model = model_for(mechanism_of(experiment, runs[0]), effects)
    count = len(model.fitted)
    values = np.resize([17.0, 16.0, 0.5, 0.1, 0.2], count)
    std = np.resize([0.02, 0.03, 0.004, 0.003, 0.001], count)
    model = model.with_vector(jnp.asarray(values))
    correlation = np.eye(count)
    correlation[0, 2] = correlation[2, 0] = -0.97
    numbers = tuple(
        Number(n.name, n.meaning.words, v, s, 0.9 * v, n.meaning.dimension.unit("rad"), "any", True)
        for n, v, s in zip(model.fitted, values.tolist(), std.tolist(), strict=True)
    )
    settings = {
        "experiment": experiment,
        "model": model,
        "numbers": numbers,
        "covariance": correlation * std * std[:, None],
        "recordings": tuple(beside(r, s, slip) for r, s in zip(runs, SIZES, strict=True)),
        "reduced_chi2": chi2,
        "modes": (Mode(0.36, 2e-4, 0.02, 1e-4), Mode(1.9, 1e-3, 0.02, 3e-4)),
        "starts": 6,
        "agreeing_starts": 5,
        "converged": True,
        "reason": "converged: the last step was small",
        "steps": 9,
        "seconds": 1.5,
        "warnings": (f"{NASTY}: something <b>doubtful</b>",),
    }
    return Fit(**(settings | changed))


# -- a comparison ----------------------------------------------------------------------------


def a_missing_torque(fit, size):
    """Friction at the elbow, at most so large, with a band."""
    run = fit.recordings[0].recording
    angle = two_modes(run.time, SIZES[0], 0.0)
    rate = np.gradient(angle, run.time, axis=0)
    friction = size * np.tanh(rate / 0.02) * [0.0, 1.0]
    torque = MissingTorque(
        time=run.time,
        angle=angle,
        rate=rate,
        torque=friction + 0.01 * np.sin(run.time)[:, None],
        std=np.full_like(angle, 0.02),
        amplitude=np.abs(angle) + 0.01,
        intensity=np.array([0.1, 0.1]),
        log_likelihood=-10.0,
        log_likelihood_without=-1000.0,
        rms=np.sqrt(np.mean(friction**2, axis=0)),
        share_of_spring=np.array([0.01, 0.2]),
    )
    drawn = [(RIVAL, 0.98), (FOUND, 0.97)]  # the accepted one need not draw best
    curves = tuple(
        Curve(name, share, {f"{name}.torque": (0.2, "N m")}, friction, 0 * friction)
        for name, share in drawn
    )
    return Missing(run.name, ("N m", "N m"), JOINTS, torque, np.cumsum(angle, axis=1), curves)


def a_comparison(fit, times, p):
    """A residual of so many times the noise in every part."""

    def part(name, start, stop, joints=2):
        return Part(name, start, stop, (Cell(100 * times**2, 100.0),) * joints)

    where = Where(
        joints=JOINTS,
        units=("rad", "rad"),
        white={joint: White(p, 0.3, 0.4) for joint in JOINTS},
        joint=(Cell(800 * times**2, 800.0),) * 2,
        time=tuple(part("", 2.5 * i, 2.5 * (i + 1)) for i in range(4)),
        amplitude=tuple(tuple(part("", a / 2, a, 1) for a in (0.2, 0.1, 0.05)) for _ in JOINTS),
        frequency=(part("below mode 1", 0, 0.3), part("mode 1", 0.3, 0.4), part("above", 3, 40)),
    )
    error = an_error(times)
    ahead = tuple(Ahead(2.0 * i, 2.0 * i + 2, an_error(times)) for i in range(3))
    missing = (a_missing_torque(fit, 0.2 if times > 1.5 else 0.0),)
    held = HeldOut("check recordings", error, error)
    return Comparison(fit, where, held, Horizon(3.3, error, ahead), missing)


def an_error(*times):
    ratio = np.resize(np.asarray(times, float), 2)
    return Error(1e-3 * ratio, ratio, np.array([1.0, 1.1]))


# -- diagnoses -------------------------------------------------------------------------------


def a_candidate(effect, probability, screened, refit=None):
    values = {f"{effect}.torque": Value(0.2001, 0.0006, "N m")}
    return Candidate(effect, probability, screened, refit, values)


def a_rung(fit, added=None, dropped=(), held=(46.0, 24.0)):
    """A rung with these held-out errors, in times the noise."""
    check = HeldOut("check recordings", an_error(*held), an_error(7.1, 11.0))
    return Rung(added, tuple(dropped), fit, check, 1e-13 if held[0] > 2 else 0.4)


CANDIDATES = (
    a_candidate(FOUND, 0.93, 243101.0, 248905.0),
    a_candidate(RIVAL, 0.06, 243180.0, 248906.0),
    a_candidate("hysteresis:elbow", 0.004, 200000.0, 230000.0),
    a_candidate("bearing_quadratic_drag", 0.0, 70000.0, -12.0),
    a_candidate("asymmetric_stiffness:shoulder", 0.0, 500.0),
    a_candidate("gravity", 0.0, float("nan")),
)
NEXT = NextExperiment(
    (FOUND, RIVAL), {"shoulder": 0.3, "elbow": -0.1}, 0.3, True, None, 12.3, 2.0,
    "A release from 0.30 rad at the shoulder would tell them apart.",
)  # fmt: skip


def missing():
    """Something was found, and nothing is left."""
    before = a_fit()
    after = a_fit((FOUND,), SLIP, 0.98)
    return Diagnosis(
        verdict="missing",
        ladder=(a_rung(before), a_rung(after, FOUND, held=(1.0, 1.0))),
        candidates=CANDIDATES,
        lookalikes=((FOUND, RIVAL),),
        next_experiment=NEXT,
        missing=(a_missing_torque(before, 0.2),),
        comparison=a_comparison(after, 1.0, 0.4),
        words=(f"{FOUND} is missing (93 %): 0.2001 +/- 0.0006 N m.", "Nothing is left."),
        seconds=31.0,
    )


def adequate():
    """Nothing was missing."""
    fit = a_fit((), SLIP, 1.02)
    return Diagnosis(
        "adequate", (a_rung(fit, held=(1.0, 1.0)),), CANDIDATES[4:], (), None,
        (a_missing_torque(fit, 0.0),), a_comparison(fit, 1.0, 0.4), ("Nothing is missing.",), 12.0,
    )  # fmt: skip


def unexplained():
    """Something is left, whatever was tried: two rungs up, one of them given up again."""
    labels = "quadratic_drag:elbow", "asymmetric_stiffness:shoulder"
    fits = a_fit(), a_fit(labels[:1]), a_fit(labels[1:], 0.5 * SLIP)
    ladder = (
        a_rung(fits[0]),
        a_rung(fits[1], labels[0], held=(20.0, 12.0)),
        a_rung(fits[2], labels[1], labels[:1], held=(15.0, 2.0)),
    )
    return Diagnosis(
        "unexplained", ladder, CANDIDATES, (), None, (a_missing_torque(fits[0], 0.2),),
        a_comparison(fits[2], 6.0, 1e-13), ("Something real is left.",), 40.0,
    )  # fmt: skip

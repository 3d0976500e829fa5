"""Results put together by hand: what is printed and drawn does not depend on how it was found."""

import jax.numpy as jnp
import numpy as np

from residyn.diagnosis import Comparison, Curve, Missing, MissingTorque
from residyn.diagnosis.bands import Band, RecordingBands
from residyn.diagnosis.candidate_tests import Outcome, Test
from residyn.diagnosis.forecast import Ahead, Error, HeldOut, Horizon
from residyn.diagnosis.law import Law
from residyn.diagnosis.residuals import Cell, Part, Where
from residyn.diagnosis.result import (
    Budget,
    Candidate,
    Diagnosis,
    Family,
    ModelState,
    RandomTorque,
    Value,
)
from residyn.effects.found import FoundLaw, FoundNumber
from residyn.fitting import Fit, Mode, Number, RecordingFit, mechanism_of, model_for
from residyn.fitting.linalg import Spread
from residyn.recordings.experiment import Experiment
from residyn.recordings.recording import Recording
from residyn.recordings.tables import ArmTable

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
    runs = runs[0].saying([f"{NASTY}: something <b>doubtful</b>"]), runs[1]
    experiment = Experiment(table, runs)
    model = model_for(mechanism_of(experiment, runs[0]), effects)
    count = len(model.fitted)
    values = np.resize([17.0, 16.0, 0.5, 0.1, 0.2], count)
    std = np.resize([0.02, 0.03, 0.004, 0.003, 0.001], count)
    model = model.with_vector(jnp.asarray(values))
    correlation = np.eye(count)
    correlation[0, 2] = correlation[2, 0] = -0.97
    numbers = tuple(
        Number(n.name, m.words, v, s, 0.9 * v, m.dimension.unit("rad"), m.sign, True)
        for n, v, s in zip(model.fitted, values.tolist(), std.tolist(), strict=True)
        for m in [n.meaning]
    )
    settings = {
        "experiment": experiment,
        "model": model,
        "numbers": numbers,
        "spread": Spread(correlation * std * std[:, None], np.zeros((0, count)), std, np.zeros(0)),
        "recordings": tuple(beside(r, s, slip) for r, s in zip(runs, SIZES, strict=True)),
        "reduced_chi2": chi2,
        **dict.fromkeys(("ready", "problem", "unknowns")),  # of which nothing is said
        "modes": (Mode(0.36, 2e-4, 0.02, 1e-4), Mode(1.9, 1e-3, 0.02, 3e-4)),
        "starts": 6,
        "agreeing_starts": 5,
        "converged": True,
        "reason": "converged: the last step was small",
        "steps": 9,
        "seconds": 1.5,
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

    frequency = part("below mode 1", 0, 0.3), part("mode 1", 0.3, 0.4), part("above", 3, 40)
    bands = tuple(Band(p.name, p.start, p.stop) for p in frequency)
    where = Where(
        joints=JOINTS,
        units=("rad", "rad"),
        white=dict.fromkeys(JOINTS, p),
        line=dict.fromkeys(JOINTS, None),
        joint=(Cell(800 * times**2, 800.0),) * 2,
        time=tuple(part("", 2.5 * i, 2.5 * (i + 1)) for i in range(4)),
        amplitude=tuple(tuple(part("", a / 2, a, 1) for a in (0.2, 0.1, 0.05)) for _ in JOINTS),
        frequency=frequency,
        recordings=(RecordingBands(fit.recordings[0].recording.name, fit.modes, bands),),
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


def a_candidate(effect, probability, log_evidence, iterated=True):
    value = Value(0.2001, 0.0006, "N m")
    values = {f"{effect}.torque": value} if iterated else {}
    if effect == RIVAL:
        values |= {
            f"{effect}.excess": Value(0.0008, 0.0005, "N m"),
            f"{effect}.velocity": Value(0.05, 0.03, "rad/s"),
        }
    return Candidate(effect, probability, log_evidence, iterated, values)


def a_model(fit, *added, held=(46.0, 24.0), log_evidence=0.0):
    """A model on the way with these held-out errors, in times the noise."""
    check = HeldOut("check recordings", an_error(*held), an_error(7.1, 11.0))
    return ModelState(added, fit, check, log_evidence)


def torques(size, band=0.5):
    """What is still missing at the two joints, so large, N m."""
    return tuple(
        RandomTorque(j, "N m", x, (1 - band) * x, (1 + band) * x, x / 2.0 if x else np.nan)
        for j, x in zip(JOINTS, (0.5 * size, size), strict=True)
    )


CANDIDATES = (
    a_candidate(FOUND, 0.93, 0.0),
    a_candidate(RIVAL, 0.06, -2.7),
    a_candidate("hysteresis:elbow", 0.004, -5.4),
    a_candidate("bearing_quadratic_drag", 0.0, -120.0),
    a_candidate("asymmetric_stiffness:shoulder", 0.0, -690.0, iterated=False),
    a_candidate("gravity", 0.0, float("nan"), iterated=False),
)
FAMILIES = (
    Family("dry friction", "elbow", 0.99, ((FOUND, 0.93), (RIVAL, 0.06))),
    Family("hysteresis", "elbow", 0.004, (("hysteresis:elbow", 0.004),)),
)
NEXT = Test(
    release={"shoulder": 0.3, "elbow": -0.1},
    units=("rad", "rad"),
    theta2=0.3,
    air_bearings=True,
    extra_mass=None,
    load=None,
    drive=None,
    duration=20.0,
    entropy=0.01,
    probability_right=0.998,
    between=((FOUND,), (RIVAL,)),
    difference=12.3,
    now=2.0,
    joint="elbow",
    reads="angle",
    unit="rad",
    time=3.2,
    outcomes=(
        Outcome((FOUND,), 0.1, 0.001, 0.998),
        Outcome((RIVAL,), 0.08, 0.001, 0.997),
    ),
    helps=True,
)


def a_law():
    """A law without a name: a torque at the elbow that depends on the rate."""
    grid = np.linspace(-1.0, 1.0, 101)
    number = FoundNumber("a", "strength", "TORQUE", 0.2, True)
    words = "elbow", "rate", "", "a x^3", "from example.toml", (number,), "self.a * x**3"
    visits, named = np.full(101, 1 / 101), ((FOUND, 0.2 * np.sign(grid)),)
    shape = grid, 0.2 * grid**3, np.full(101, 0.01), visits, "N m", "rad/s", named
    return Law("elbow", "rate", "", (), 0.95, 12.0, *shape, found=FoundLaw(*words))


def a_diagnosis(verdict, ladder, **changed):
    """A diagnosis of these models; nothing else was found unless it is given."""
    settings = {
        "verdict": verdict,
        "verdict_probability": 0.999,
        "ladder": tuple(ladder),
        "candidates": CANDIDATES,
        "families": FAMILIES,
        "lookalikes": (),
        "next_experiment": None,
        "missing": (a_missing_torque(ladder[0].fit, 0.2),),
        "still_missing": (a_missing_torque(ladder[-1].fit, 0.0),),
        "laws": (),
        "coloured": None,
        "coloured_noise": None,
        "random_torque": torques(1e-3),
        "parameters": {n.name: Value(n.value, 3 * n.std, n.unit) for n in ladder[-1].fit.numbers},
        "intensity": 1e-4,
        "channels": None,
        "explains_nothing": False,
        "budget": Budget(13, 40, None),
        "seconds": 31.0,
    } | changed
    found = Diagnosis(**settings)
    left = (6.0, 1e-13) if verdict == "unexplained" else (1.0, 0.4)
    found.__dict__["comparison"] = a_comparison(found.fit, *left)
    return found


def missing(**changed):
    """Something was found, and nothing is left."""
    ladder = (
        a_model(a_fit(), log_evidence=-692.0),
        a_model(a_fit((FOUND,), SLIP, 0.98), FOUND, held=(1.0, 1.0)),
    )
    settings = {"lookalikes": ((FOUND, RIVAL),), "next_experiment": NEXT} | changed
    return a_diagnosis("missing", ladder, **settings)


def adequate(**changed):
    """Nothing was missing."""
    fit = a_fit((), SLIP, 1.02)
    settings = {
        "candidates": CANDIDATES[4:],
        "families": (),
        "missing": (a_missing_torque(fit, 0.0),),
    }
    return a_diagnosis("adequate", (a_model(fit, held=(1.0, 1.0)),), **(settings | changed))


def unexplained(**changed):
    """Something is left, whatever was tried."""
    labels = "quadratic_drag:elbow", "asymmetric_stiffness:shoulder"
    fits = a_fit(), a_fit(labels[:1]), a_fit(labels[1:], 0.5 * SLIP, 4.1)
    ladder = (
        a_model(fits[0], log_evidence=-900.0),
        a_model(fits[1], labels[0], held=(20.0, 12.0), log_evidence=-300.0),
        a_model(fits[2], labels[1], held=(15.0, 2.0)),
    )
    family = Family("spring shape", "shoulder", 0.97, ((labels[1], 0.97),))
    settings = {
        "candidates": (a_candidate(labels[1], 0.97, 0.0), *CANDIDATES[:4], CANDIDATES[5]),
        "families": (family, *FAMILIES[1:]),
        "still_missing": (a_missing_torque(fits[2], 0.2),),
        "random_torque": torques(0.1),
        "intensity": 0.05,
    }
    return a_diagnosis("unexplained", ladder, **(settings | changed))

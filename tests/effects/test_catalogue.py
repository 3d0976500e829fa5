"""What every effect of the catalogue must do. A new effect gets these tests by being listed."""

import dataclasses
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import residyn
from residyn.diagnosis.columns import candidates
from residyn.effects import CATALOGUE, effects_named
from residyn.filtering.trajectory import Scene
from residyn.physics.motion import Motion
from residyn.physics.parameter import Scales, parameters_of

with jax.enable_x64(True):
    ARM = residyn.PlanarArm([0.4, 0.4], 1.1662, 0.579, 1.4384, 0.3, bearings=[1, 1], load=1.5)
    HANGING = residyn.PlanarArm([0.4, 0.4], 1.1662, 0.579, 1.4384, 0.0, bearings=[1, 1])
SCALES = Scales(inertia=0.6, frequency=5.0, amplitude=0.2, swing=0.2)


def arm_for(words):
    """An arm on which an effect makes sense."""
    return HANGING if words == "pendulum" else ARM


def instances():
    """Every effect at every place of an arm."""
    return [
        words
        for name, kind in CATALOGUE.items()
        for words in [f"{name}:{place}" for place in kind.places(arm_for(name))] or [name]
    ]


def named(words):
    """The effect and its arm."""
    (effect,) = effects_named(words, arm_for(words))
    return effect, arm_for(words)


def at(effect, factor, scales=SCALES):
    """The effect with its numbers `factor` times their typical size away from silence; shapes stay
    at a typical one."""
    values = {}
    for p in parameters_of(effect):
        size = p.dimension.size(scales)
        if p.silent is not None:
            values[p.field] = jnp.asarray(p.silent + factor * size)
        elif p.grid:
            values[p.field] = jnp.asarray(p.grid[(len(p.grid) - 1) // 2] * size)
    return dataclasses.replace(effect, **values)


def motions(count=20, memory=()):
    """Random instants, the internal states of typical size."""
    rng = np.random.default_rng(0)
    sizes = [each.dimension.size(SCALES) for each in memory]
    for _ in range(count):
        q, v = rng.uniform(-0.5, 0.5, 2), rng.uniform(-1.0, 1.0, 2)
        z = tuple(rng.uniform(-1, 1) * size for size in sizes)
        yield Motion.at(1.3, q, v, z)._replace(grain=1e-3)


def response(model, motion):
    """Everything that an effect can change, as one array."""
    angles = jnp.stack(motion.q)
    late = jnp.stack([jnp.asarray(d, float) for d in model.delays])
    parts = [*model.acceleration(motion), *model.memory_rate(motion)]
    return jnp.concatenate([jnp.stack(parts), model.reading(angles) - angles, late])


def own_part(with_it, motion):
    """`response` less the rates of the internal states."""
    return np.delete(np.array(response(with_it, motion)), slice(2, 2 + len(with_it.memory)))


pytestmark = pytest.mark.usefixtures("float64", "compiled_in_less_time")


def test_where_effects_can_act_is_asked_in_any_precision():
    with jax.enable_x64(False), warnings.catch_warnings():
        warnings.simplefilter("error")  # JAX warns where it cuts an array of the arm short
        assert "bearing_drag" in instances()
        assert "gravity" in instances()


@pytest.mark.parametrize("words", instances())
def test_it_says_what_it_is(words):
    effect, _ = named(words)
    assert effect.label == words
    assert effect.equation
    assert effect.looks_like
    assert effect.source
    for p in parameters_of(effect):
        assert p.words
        assert p.dimension.unit("rad")
        assert "or" in p.dimension.unit() or p.dimension.unit("rad") == p.dimension.unit("m")


@pytest.mark.parametrize("words", instances())
def test_it_is_exactly_absent_at_its_silent_value(words):
    effect, arm = named(words)
    with_it, without = arm + at(effect, 0.0), residyn.Model(arm)
    for motion in motions(memory=effect.memory):
        np.testing.assert_array_equal(own_part(with_it, motion), response(without, motion))


@pytest.mark.parametrize("words", instances())
def test_it_does_something_elsewhere(words):
    effect, arm = named(words)
    with_it, without = arm + at(effect, 0.3), residyn.Model(arm)
    off = [
        np.abs(own_part(with_it, m) - np.array(response(without, m))).max()
        for m in motions(memory=effect.memory)
    ]
    assert max(off) > 1e-3


NOT_OF_LOAD = [w for w in instances() if not CATALOGUE[w.partition(":")[0]].of_load]


@pytest.mark.parametrize("words", NOT_OF_LOAD)
def test_its_typical_size_goes_with_the_unit_of_length(words):
    """The same arm in centimetres: of accelerations, rad/s^2, length is no part. A friction's share
    of a load has no typical size."""
    metres = SCALES._replace(length=0.4)
    centimetres = SCALES._replace(inertia=1e4 * SCALES.inertia, length=40.0)
    effect, arm = named(words)
    small = residyn.PlanarArm([40, 40], 11662, 5790, 143.84, arm.theta2, bearings=[1, 1])
    for motion in motions(5, effect.memory):
        found = own_part(small + at(effect, 0.1, centimetres), motion)
        assert found == pytest.approx(own_part(arm + at(effect, 0.1, metres), motion), rel=1e-9)


@pytest.mark.parametrize("words", instances())
def test_its_derivative_is_the_finite_difference(words):
    effect, arm = named(words)
    model = arm + at(effect, 0.3)
    for motion in motions(4, effect.memory):

        def moved(numbers, q, v, z, motion=motion):
            there = motion._replace(q=tuple(q), v=tuple(v), memory=tuple(z))
            return response(model.with_values(numbers), there)

        z = jnp.asarray([*motion.memory], float)
        point = (model.values(), jnp.stack(motion.q), jnp.stack(motion.v), z)
        direction = jax.tree.map(lambda x: 0.03 + 0.01 * jnp.cos(7.0 * x), point)
        slope = jax.jvp(moved, point, direction)[1]
        step = 1e-5
        ahead, behind = (
            moved(*jax.tree.map(lambda x, d, s=s: x + s * d, point, direction))
            for s in (step, -step)
        )
        np.testing.assert_allclose(slope, (ahead - behind) / (2 * step), rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("words", instances())
def test_it_vmaps_over_its_numbers(words):
    effect, arm = named(words)
    model = arm + at(effect, 0.3)
    factors = jnp.linspace(0.5, 1.5, 4)
    motion = next(motions(1, effect.memory))

    def one(factor):
        return response(
            model.with_values({k: factor * v for k, v in model.values().items()}), motion
        )

    together = jax.vmap(one)(factors)
    np.testing.assert_allclose(together, jnp.stack([one(f) for f in factors]), rtol=1e-12)


@pytest.mark.parametrize("words", [w for w in instances() if named(w)[0].dissipates])
def test_it_loses_energy_if_it_says_so(words):
    effect, arm = named(words)
    effect = at(effect, 0.3)
    for motion in motions(memory=effect.memory):
        torque = np.array(effect.torque(motion, arm))
        assert torque @ np.array(motion.v) >= 0


@pytest.mark.parametrize("words", instances())
def test_its_torque_jumps_only_where_it_says_so(words):
    effect, arm = named(words)
    effect = at(effect, 0.3)
    for motion in motions(3, effect.memory):
        torques = [
            np.array(effect.torque(motion._replace(direction=(d, d)), arm)) for d in (1.0, -1.0)
        ]
        assert (np.abs(torques[0] - torques[1]).max() > 0) == effect.dry


def once(words):
    """Per-joint effects at one joint only, here and there, to save time."""
    name, _, place = words.partition(":")
    if place not in ARM.joints or CATALOGUE[name] is residyn.InertiaError:
        return True
    return place == ARM.joints[len(name) % 2]


FREE = [w for w in instances() if w != "printed_inertia_torque" and once(w)]
BASE = {"spring:shoulder": 16.0, "spring:elbow": 14.0, "damper:shoulder": 0.1, "damper:elbow": 0.08}
# Typical sizes from which an effect is plain to see beside noise of 0.1 % of the amplitude.
PLAIN = {"dead_zone": 0.3, "brake_slip": 0.6, "sensor_delay": 0.05, "wrist_flexibility": 0.1}


# Others of their kind run: the fits of these are `make slow`.
LATER = {
    "asymmetric_damping",
    "asymmetric_stiffness",
    "bearing_friction",
    "bearing_quadratic_drag",
    "brake_slip",
    "constant_torque",
    "coupling_damping",
    "coupling_stiffness",
    "damper",
    "dead_zone",
    "hysteresis",
    "inertia_error",
    "quadratic_drag",
    "sensor_offset",
    "sensor_scale",
    "spring",
    "stiffness_drift",
    "stribeck_friction",
    "wrist_flexibility",
}
EACH = [
    pytest.param(w, marks=pytest.mark.slow) if w.partition(":")[0] in LATER else w for w in FREE
]


@pytest.mark.parametrize("words", EACH)
def test_its_numbers_are_recovered_from_its_own_simulation(words):
    """Within their errors, from a recording made with it and noise."""
    effect, arm = named(words)
    truth = residyn.Model(arm)
    for label, value in BASE.items():
        (base,) = effects_named(label, arm)
        truth = truth + dataclasses.replace(base, **{parameters_of(base)[0].field: value})
    if words not in BASE:
        truth = truth + at(effect, PLAIN.get(effect.name, 0.02))
    rng = np.random.default_rng(0)
    t = np.arange(1500) * 0.01
    q = readings(truth, t) + 2e-4 * rng.standard_normal((1500, 2))
    table = residyn.recording.ArmTable((0.4, 0.4), 1.1662, 0.579, 1.4384)
    bearings = [residyn.recording.Bearing(joint, 1.0, 0.01) for joint in ("elbow", "wrist")]
    recording = residyn.Recording.from_arrays(t, q, theta2=float(arm.theta2), noise=2e-4, load=1.5)
    experiment = residyn.Experiment(table, (recording,), bearings)
    fit = residyn.fit(experiment, effects=[] if words in BASE else [words])
    assert 0.9 < fit.reduced_chi2 < 1.1
    expected = {k: float(v) for k, v in truth.values().items()}
    assert sum(number.determined for number in fit.numbers) >= 4
    for number in fit.numbers:
        if number.determined:
            assert abs(number.value - expected[number.name]) < 4.5 * number.std, number.name


def readings(model, t):
    """What the sensors say from `t` s on after a release from rest (of a late sensor: 0.2 s later,
    so that all it says is of the motion)."""
    lead = 0.2 if any(model.delays) else 0.0
    times = np.concatenate([[0.0], lead + t[lead == 0.0 :]])
    path = residyn.simulate(model, times, [0.3, -0.25], steps=3000)
    return np.asarray(path.readings)[int(lead > 0.0) :]


def test_what_slides_feels_no_sine_of_an_angle():
    def names(mechanism):
        t = np.linspace(0.0, 10.0, 500)
        recording = residyn.Recording.from_arrays(t, np.cos(3.0 * t), noise=1e-3)
        scene = Scene([recording], [mechanism], [np.zeros((500, 1), bool)])
        return [e.name for e in candidates(scene, ())]

    slide = residyn.ConstantInertia([[1.0]], ["cart"], ["m"])
    with pytest.raises(ValueError, match=r"gravity .* cart slides .*constant_torque:cart"):
        effects_named("gravity", slide)
    assert "gravity" not in names(slide)
    assert "pendulum" not in names(slide)
    hanging = residyn.ConstantInertia([[1.0]], ["link"], ["rad"])
    assert "gravity" in names(hanging)
    assert "pendulum" in names(hanging)


def test_only_what_hangs_straight_is_a_pendulum():
    with pytest.raises(ValueError, match=r"hangs straight .* elbow is at 0\.3 rad .* gravity"):
        effects_named("pendulum", ARM)
    assert effects_named("pendulum", HANGING)

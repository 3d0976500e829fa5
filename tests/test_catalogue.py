"""What every effect of the catalogue must do. A new effect gets these tests by being listed."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import residyn
from residyn.effects import CATALOGUE, effects_named
from residyn.motion import Motion
from residyn.parameter import Scales, parameters_of

with jax.enable_x64(True):
    ARM = residyn.PlanarArm([0.4, 0.4], 1.1662, 0.579, 1.4384, 0.3)
SCALES = Scales(inertia=0.6, frequency=5.0, amplitude=0.2)


def instances():
    """Every effect at every place of an arm."""
    return [
        words
        for name, kind in CATALOGUE.items()
        for words in [f"{name}:{place}" for place in kind.places(ARM)] or [name]
    ]


def at(effect, factor):
    """The effect with its numbers `factor` times their typical size away from silence."""
    values = {
        p.field: jnp.asarray(p.silent + factor * p.dimension.size(SCALES))
        for p in parameters_of(effect)
    }
    return dataclasses.replace(effect, **values)


def motions(count=20):
    rng = np.random.default_rng(0)
    for _ in range(count):
        yield Motion.at(1.3, rng.uniform(-0.5, 0.5, 2), rng.uniform(-1.0, 1.0, 2))


@pytest.fixture(autouse=True)
def double():
    with jax.enable_x64(True):
        yield


@pytest.mark.parametrize("words", instances())
def test_it_says_what_it_is(words):
    (effect,) = effects_named(words, ARM)
    assert effect.label == words
    assert effect.equation
    assert effect.looks_like
    assert effect.source
    for p in parameters_of(effect):
        assert p.words
        assert p.dimension.unit("rad")
        assert "or" in p.dimension.unit(None) or p.dimension.unit("rad") == p.dimension.unit("m")


@pytest.mark.parametrize("words", instances())
def test_it_is_exactly_absent_at_its_silent_value(words):
    (effect,) = effects_named(words, ARM)
    silent = at(effect, 0.0)
    with_it, without = ARM + silent, residyn.Model(ARM)
    for motion in motions():
        np.testing.assert_array_equal(
            np.array(with_it.acceleration(motion)), np.array(without.acceleration(motion))
        )


@pytest.mark.parametrize("words", instances())
def test_it_does_something_elsewhere(words):
    (effect,) = effects_named(words, ARM)
    with_it, without = ARM + at(effect, 0.3), residyn.Model(ARM)
    off = [
        np.abs(np.array(with_it.acceleration(m)) - np.array(without.acceleration(m))).max()
        for m in motions()
    ]
    assert max(off) > 1e-3


@pytest.mark.parametrize("words", instances())
def test_its_derivative_is_the_finite_difference(words):
    (effect,) = effects_named(words, ARM)
    effect = at(effect, 0.3)
    for motion in motions(4):

        def acceleration(numbers, q, v, motion=motion):
            model = (ARM + effect).with_values(numbers)
            return jnp.stack(model.acceleration(motion._replace(q=tuple(q), v=tuple(v))))

        model = ARM + effect
        point = (model.values(), jnp.stack(motion.q), jnp.stack(motion.v))
        direction = jax.tree.map(lambda x: 0.3 + 0.1 * jnp.cos(7.0 * x), point)
        slope = jax.jvp(acceleration, point, direction)[1]
        step = 1e-6
        ahead, behind = (
            acceleration(*jax.tree.map(lambda x, d, s=s: x + s * d, point, direction))
            for s in (step, -step)
        )
        np.testing.assert_allclose(slope, (ahead - behind) / (2 * step), rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("words", instances())
def test_it_vmaps_over_its_numbers(words):
    (effect,) = effects_named(words, ARM)
    model = ARM + at(effect, 0.3)
    factors = jnp.linspace(0.5, 1.5, 4)
    motion = next(motions(1))

    def one(factor):
        moved = model.with_values({k: factor * v for k, v in model.values().items()})
        return jnp.stack(moved.acceleration(motion))

    together = jax.vmap(one)(factors)
    np.testing.assert_allclose(together, jnp.stack([one(f) for f in factors]), rtol=1e-12)


@pytest.mark.parametrize("words", instances())
def test_it_loses_energy_if_it_says_so(words):
    (effect,) = effects_named(words, ARM)
    if not effect.dissipates:
        pytest.skip("claims nothing")
    effect = at(effect, 0.3)
    for motion in motions():
        torque = np.array(effect.torque(motion, ARM))
        assert torque @ np.array(motion.v) >= 0


@pytest.mark.parametrize("words", instances())
def test_its_torque_jumps_only_where_it_says_so(words):
    (effect,) = effects_named(words, ARM)
    effect = at(effect, 0.3)
    for motion in motions(3):
        torques = [
            np.array(effect.torque(motion._replace(direction=(d, d)), ARM)) for d in (1.0, -1.0)
        ]
        assert (np.abs(torques[0] - torques[1]).max() > 0) == effect.dry


FREE = [words for words in instances() if words != "printed_inertia_torque"]


@pytest.mark.parametrize("words", FREE)
def test_its_numbers_are_recovered_from_its_own_simulation(words):
    """Within their errors, from a recording made with it and noise."""
    base = ARM
    for joint, k in (("shoulder", 16.0), ("elbow", 14.0)):
        base = base + residyn.Spring(joint, k) if words != f"spring:{joint}" else base
    for joint, c in (("shoulder", 0.1), ("elbow", 0.08)):
        base = base + residyn.Damper(joint, c) if words != f"damper:{joint}" else base
    (effect,) = effects_named(words, ARM)
    small = 0.6 if words.startswith(("spring", "damper")) else 0.02
    truth = base + at(effect, small)
    rng = np.random.default_rng(0)
    t = np.arange(1500) * 0.01
    q = np.asarray(residyn.simulate(truth, t, [0.3, -0.25], steps=3000).q)
    table = residyn.recording.ArmTable((0.4, 0.4), 1.1662, 0.579, 1.4384)
    recording = residyn.Recording.from_arrays(
        t, q + 2e-4 * rng.standard_normal(q.shape), theta2=0.3, noise=2e-4
    )
    extra = [] if words.startswith(("spring", "damper")) else [words]
    fit = residyn.fit(residyn.Experiment(table, (recording,)), effects=extra)
    assert 0.9 < fit.reduced_chi2 < 1.1
    expected = {k: float(v) for k, v in truth.values().items()}
    for number in fit.numbers:
        if number.determined:
            assert abs(number.value - expected[number.name]) < 4.5 * number.std

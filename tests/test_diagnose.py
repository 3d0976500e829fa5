"""`diagnose`: the right name, no name, and no name for what is in no catalogue. The truth is made
by MuJoCo (tests/rig), which shares no code with the package."""

import dataclasses
import json
import math
from pathlib import Path
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import residyn
from residyn.diagnosis import chances as weighing
from residyn.diagnosis import climb as climbing
from residyn.diagnosis import joined, linear, suspects, valleys
from residyn.diagnosis import ladder as rungs
from residyn.diagnosis import path as way
from residyn.diagnosis import refits as refitting
from residyn.diagnosis import screen as screening
from residyn.diagnosis.curves import candidates as candidates_for
from residyn.diagnosis.ladder import (
    Accepted,
    _handed_on,
    _loud,
    matters,
    needless,
    over_noise,
    ranked,
)
from residyn.diagnosis.linear import Near, steadied
from residyn.diagnosis.missing import missing_of
from residyn.diagnosis.missing_torque import missing_torque
from residyn.diagnosis.next_experiment import advise
from residyn.diagnosis.path import Path as Way
from residyn.diagnosis.path import variants
from residyn.diagnosis.rung import Refit, certainty, numbers_price, stand
from residyn.diagnosis.screen import Screened, left_over, pair, screen
from residyn.diagnosis.suspects import search
from residyn.diagnosis.unnamed import Law, Unnamed
from residyn.diagnosis.valleys import out_of_valleys
from residyn.effects import effects_named
from residyn.fitting.pipeline import finish, refit
from residyn.recording import ArmTable, Bearing, InertiaTable
from tests import rig

ARM = rig.paper_twin(0.3)
ARM_BODIES = residyn.PlanarArm([0.4, 0.4], 1.1662, 0.579, 1.4384, 0.3)
DATA = Path(__file__).parents[2] / "shared" / "data"
Q0 = np.array([0.2, -0.15])


def experiment(label=None, values=None, seed=0, noise=5e-4, seconds=12.0, arm=ARM):
    """A release of the paper's arm with one effect hidden."""
    hidden = [rig.Hidden(label, values)] if label else []
    case = rig.record(
        np.random.default_rng(seed), arm, Q0, hidden, seconds=seconds, rate=100.0, noise=noise
    )
    return beside(case)


def beside(case):
    """A rig's case as an experiment."""
    arm = case.arm
    recording = residyn.Recording.from_arrays(case.t, case.q, theta2=arm.theta2, noise=case.noise)
    table = ArmTable((arm.l1, arm.l2), arm.shoulder, arm.elbow, arm.coupling)
    bearings = [Bearing(where, 1e-9, 1e-9) for where in case.bearings]
    return residyn.Experiment(table, (recording,), bearings)


@pytest.fixture(scope="module")
def friction():
    return residyn.diagnose(experiment("coulomb_friction:elbow", {"torque": 0.05}))


def test_friction_is_named_and_the_error_falls(friction):
    assert friction.verdict == "missing"
    assert friction.added == ("coulomb_friction:elbow",)
    value = friction.fit.to_dict()["parameters"]["coulomb_friction:elbow.torque"]
    assert abs(value["value"] - 0.05) < 4 * value["std"]
    base, last = friction.ladder[0], friction.ladder[-1]
    assert (last.times_noise < 1.1).all()
    assert base.times_noise.max() > 3
    assert last.held_out.held_out.ratio.max() < 1.2 < base.held_out.held_out.ratio.max()


def test_the_name_carries_its_evidence(friction):
    first = friction.candidates[0]
    assert first.effect == "coulomb_friction:elbow"
    richer = next(c for c in friction.candidates if c.effect == "stribeck_friction:elbow")
    assert first.probability + richer.probability > 0.99
    assert first.probability >= richer.probability
    # To first order about the motion as it was, the drop is what the refit finds.
    assert first.chi2_drop_screened == pytest.approx(first.chi2_drop_refit, rel=0.2)
    assert sum(c.probability for c in friction.candidates) < 1 + 1e-9
    tried = [c for c in friction.candidates if c.chi2_drop_refit is not None]
    assert len(tried) >= 2
    assert {c.effect for c in friction.candidates} == {
        e.label for e in candidates_for(friction.base.model)
    }


def test_a_law_that_contains_the_named_one_stands_beside_it(friction):
    assert friction.lookalikes == (("coulomb_friction:elbow", "stribeck_friction:elbow"),)


def test_json_is_the_contract(friction):
    found = json.loads(json.dumps(friction.to_dict()))
    assert {"verdict", "added", "ladder", "candidates", "lookalikes", "next_experiment"} <= set(
        found
    )
    for row in found["ladder"]:
        assert {"model", "rmse", "check_rmse", "reduced_chi2"} == set(row)
    for row in found["candidates"]:
        assert set(row) == {
            "effect",
            "probability",
            "chi2_drop_screened",
            "chi2_drop_refit",
            "parameters",
        }
    assert set(found["missing_torque"]) == {"shoulder", "elbow"}
    assert found["ladder"][0]["model"] == list(friction.base.model.labels)


def test_nothing_hidden_nothing_found():
    found = residyn.diagnose(experiment(seed=3))
    assert found.verdict == "adequate"
    assert not found.added
    assert len(found.ladder) == 1
    assert max(c.probability for c in found.candidates) < 0.5


def test_what_is_in_no_catalogue_is_not_forced_into_a_name():
    values = {"torque": 0.2, "waves": 60.0, "phase": 1.0}
    found = residyn.diagnose(experiment("angle_ripple:elbow", values, noise=2e-4), max_effects=1)
    assert found.verdict == "unexplained"
    assert max(c.probability for c in found.candidates) < 0.9


@pytest.mark.slow
def test_no_effect_may_be_added_if_none_is_allowed():
    found = residyn.diagnose(
        experiment("cubic_stiffness:shoulder", {"coefficient": 40.0}), max_effects=0
    )
    assert found.verdict == "unexplained"
    assert not found.added
    assert found.candidates[0].effect == "cubic_stiffness:shoulder"
    with pytest.raises(ValueError, match="max_effects = -1"):
        residyn.diagnose(experiment(), max_effects=-1)


# -- the screen -------------------------------------------------------------------------------


def screened(label, values, **how):
    fit = residyn.fit(experiment(label, values, **how), starts=2)
    with jax.enable_x64(True):
        near = Near.of(fit)
        beside = near.fitted[0]
        found = missing_torque(fit.model, beside.recording, wild=beside.wild, state=beside.state)
        way = Way.of(found, near.problem.steps, 1.0 / fit.modes[0].frequency_hz)
        return near, screen(near, [way], candidates_for(fit.model))[1]


@pytest.mark.parametrize(
    ("label", "values", "field"),
    [
        ("cubic_stiffness:shoulder", {"coefficient": 40.0}, "coefficient"),
        ("quadratic_drag:elbow", {"coefficient": 0.15}, "coefficient"),
        ("hysteresis:shoulder", {"torque": 0.2, "angle": 0.05}, "level"),
        # The same as the other joint's being early, which no sensor is.
        ("sensor_delay:elbow", {"delay": 0.02}, "delay"),
    ],
)
def test_the_screen_finds_the_effect_and_its_strength(label, values, field):
    near, found = screened(label, values)
    assert found[0].effect.label == label
    true = next(iter(values.values()))
    assert float(getattr(found[0].effect, field)) == pytest.approx(true, rel=0.15)
    readings = near.fitted[0].used.sum()
    assert found[0].chi2 < 1.5 * readings < 0.9 * found[-1].chi2
    late = [float(s.effect.delay) for s in found if s.effect.name == "sensor_delay"]
    assert len(late) == 2
    assert min(late) >= 0.0


def test_shapes_are_tried_on_a_grid():
    effect = residyn.Hysteresis("elbow")
    way = Way(0.1, np.zeros(8), *[np.zeros((8, 2))] * 6)
    tried = variants(effect, {"level": 2.0, "angle": 0.3}, [way], 1)
    angles = sorted(float(v.effect.angle) for v in tried)
    assert len(angles) > 3
    assert angles[0] < 0.3 * 0.25 < angles[-1]
    for v in tried:
        assert float(v.effect.level) == 0.0
        assert float(v.at(0).level) == 2.0


@pytest.mark.parametrize("seen_at", [0, 1])
def test_a_line_is_tried_that_stands_out_of_noise_which_grows_with_frequency(seen_at):
    """... at the joint that sees it, for an oscillation of either joint."""
    rng = np.random.default_rng(0)
    h, count = 0.02, 1000
    time = (np.arange(8 * count) + 0.5) * h / 8
    noise = np.gradient(np.gradient(rng.standard_normal((count, 2)), axis=0), axis=0)
    missing = np.repeat(noise, 8, axis=0)
    missing[:, seen_at] += 0.1 * np.sin(2 * np.pi * 2.24 * time)
    q = np.sin(time)[:, None] * [1.0, 0.8]
    way = Way(h, time, q, q, q, q, 0 * q, missing)
    for place, joint in (("shoulder", 0), ("elbow", 1)):
        tried = variants(residyn.PeriodicDisturbance(place), {"level": 1.0}, [way], joint)
        found = [float(v.effect.frequency) for v in tried]
        assert len(found) == len(set(found)) <= 8
        assert min(abs(f - 2.24) for f in found) < 0.03


def test_a_torque_keeps_its_impulse_and_moment_in_every_step():
    h, parts = 0.1, 8
    time = (np.arange(40) + 0.5) * h / parts
    way = Way(h, time, *[np.zeros((40, 1))] * 6)
    torque = np.where(time < 0.17, 1.0, -1.0)[:, None]
    left, right = way.lines(torque)
    assert left.shape == (5, 1)
    np.testing.assert_allclose((left + right)[:, 0] / 2, torque.reshape(5, 8).mean(1))
    s = (np.arange(parts) + 0.5) / parts
    line = left[1, 0] + (right[1, 0] - left[1, 0]) * s
    assert np.mean(s * line) == pytest.approx(np.mean(s * torque.reshape(5, 8)[1]))


# -- what to measure next -----------------------------------------------------------------------


@pytest.mark.slow
def test_another_elbow_angle_tells_gravity_from_a_constant_torque():
    made = experiment("constant_torque:elbow", {"torque": 0.4}, noise=1e-3)
    base = residyn.fit(made, starts=2)
    with jax.enable_x64(True):
        step = stand(base, ())
        r = step.near.fitted[0]
        torque = missing_torque(base.model, r.recording, wild=r.wild, state=r.state)
        rivals = [residyn.ConstantTorque("elbow"), residyn.Gravity()]
        step = search(step, made, [torque], rivals, lambda words: None)
        by_name = {x.label: x for x in step.refits}
        found = advise(step, made, by_name["constant_torque:elbow"], by_name["gravity"])
    assert found.helps
    assert found.difference > 3 * found.now
    assert "gravity" in found.words
    assert "rad" in found.words
    assert set(found.release) == {"shoulder", "elbow"}


# -- joints that rattle ----------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("label", "values"),
    [
        ("dead_zone:shoulder", {"stiffness": ARM.stiffness[0], "gap": 0.05}),
        ("brake_slip:elbow", {"stiffness": ARM.stiffness[1], "angle": 0.03}),
        ("brake_slip:shoulder", {"stiffness": ARM.stiffness[0], "angle": 0.12}),
    ],
)
def test_a_spring_that_is_lost_on_the_way_is_named(label, values):
    """Backlash or a slipping brake in series with the whole spring: springs and dampers are then
    fitted best with hardly a spring, and fits sit in wrong valleys."""
    made = experiment(label, values, noise=2e-3, seconds=20.0)
    found = residyn.diagnose(made)
    assert found.verdict == "missing"
    if label == "brake_slip:shoulder":  # which slips once: a constant torque is the same motion
        assert found.added == ("constant_torque:shoulder",)
        assert label in found.lookalikes[0]
        return
    assert found.added == (label,)
    value = found.fit.to_dict()["parameters"][f"{label}.{list(values)[1]}"]
    assert abs(value["value"] - values[list(values)[1]]) < 4 * value["std"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arm", "q0", "hidden", "noise"),
    [
        (  # half the swing is backlash: no small change of the motion explains that
            rig.Arm(0.515, 0.299, 0.5654, 0.08265, 0.2625, -1.6466, (47.08, 9.66), (0.517, 0.0626)),
            (0.3005, 0.0638),
            {"dead_zone:elbow": {"stiffness": 9.66, "gap": 0.2524}},
            1.27e-3,
        ),
        (  # 0.07 Hz beside a mode that hardly rings off
            rig.Arm(
                0.543, 0.312, 0.4851, 0.02495, 0.1554, -0.132, (2.29, 0.3511), (0.0145, 4.3e-4)
            ),
            (-0.3198, -0.2758),
            {"periodic_disturbance:elbow": {"torque": 3.29e-3, "frequency": 1.2464, "phase": 4.48}},
            9.7e-4,
        ),
        (  # gravity and a coupling promise more, to first order
            rig.Arm(0.265, 0.577, 0.3015, 0.2317, 0.5009, 1.3523, (64.6, 48.09), (0.0672, 0.0368)),
            (-0.2827, -0.3429),
            {"inertia_error:elbow": {"share": 0.0413}},
            9.2e-4,
        ),
        (  # Coulomb friction joins first, and makes way for the law that extends it
            rig.Arm(
                0.5745, 0.599, 1.2531, 0.267, 0.6945, -1.2962, (9.935, 3.028), (0.3066, 2.5e-3)
            ),
            (-0.1026, -0.1441),
            {
                "asymmetric_damping:shoulder": {"damping": 0.1235},
                "stribeck_friction:shoulder": {
                    "torque": 0.0201,
                    "excess": 0.0153,
                    "velocity": 0.0145,
                },
            },
            1.27e-3,
        ),
    ],
)
def test_what_the_screen_misjudges_is_named_all_the_same(arm, q0, hidden, noise):
    each = [rig.Hidden(label, values) for label, values in hidden.items()]
    rng = np.random.default_rng(0)
    case = rig.record(rng, arm, np.array(q0), each, seconds=20.0, rate=100.0, noise=noise)
    found = residyn.diagnose(beside(case))
    assert found.verdict == "missing"
    assert set(found.added) == set(hidden)


@pytest.mark.parametrize(
    ("one", "other", "better"),
    [(44e3, 46e3, False), (30e3, 46e3, True), (1010, 1060, True), (1060, 1010, False)],
)
def test_another_climb_is_preferred_for_what_matters(one, other, better, monkeypatch):
    """Where both leave much more than noise, a little less is no reason for other names."""
    monkeypatch.setattr(climbing, "price", lambda step, first, beside: step.cost)
    steps = [SimpleNamespace(cost=cost, readings=1000) for cost in (one, other)]
    assert climbing.does_better(*steps, 0) is better


@pytest.mark.parametrize(
    ("law", "recordings", "std", "only"),
    [
        (residyn.Hysteresis, 60, (35.0, 13.0), True),
        (residyn.Hysteresis, 60, (0.2, 13.0), False),
        (residyn.Hysteresis, 60, (np.inf, np.inf), True),
        (residyn.Hysteresis, 1, (35.0, 13.0), False),
        (residyn.BrakeSlip, 2, (35.0, 13.0), True),
        (residyn.PeriodicDisturbance, 60, (35.0, 13.0), False),
    ],
)
def test_what_is_all_memory_has_no_name(law, recordings, std, only):
    """The memories of many stretches are any torque; only a strength that is known is an effect."""
    step = SimpleNamespace(near=SimpleNamespace(fitted=[None] * recordings))
    alone = residyn.Model(residyn.ConstantInertia([[1.0]], ["slide"], ["m"]), (law("slide"),))
    assert len(alone.fitted) == 2
    assert joined._only_remembers(step, np.array([3.9, 2.2]), np.array(std), alone) is only


@pytest.mark.parametrize(
    ("frequency", "cost", "could"),
    [
        (0.53, 4000.0, False),  # Hz: beats with a mode of 0.5 Hz less than once in 20 s
        (0.57, 4000.0, True),  # less than two and a half times, but explains everything
        (0.57, 4400.0, False),
        (0.64, 4400.0, True),
        (0.07, 4000.0, False),  # goes through less than two cycles
    ],
)
def test_an_oscillation_near_a_mode_may_mimic_anything_but_not_down_to_the_noise(
    frequency, cost, could, monkeypatch
):
    monkeypatch.setattr(joined, "errors_of", lambda descent, scale: np.full(2, 1e-3))
    effect = residyn.PeriodicDisturbance("slide", 0.2, frequency)
    alone = residyn.Model(residyn.ConstantInertia([[1.0]], ["slide"], ["m"]), (effect,))
    step = SimpleNamespace(
        readings=4000,
        effects=(),
        fit=SimpleNamespace(modes=[SimpleNamespace(frequency_hz=0.5)]),
        near=SimpleNamespace(fitted=[SimpleNamespace(recording=SimpleNamespace(duration=20.0))]),
    )
    assert joined.possible(step, alone, SimpleNamespace(cost=cost), alone) is could


@pytest.mark.parametrize("frequency", [0.57, 0.9])
@pytest.mark.parametrize("left", [4e3, 4e4])
def test_a_mimic_beside_a_mode_is_not_even_screened(frequency, left, monkeypatch):
    """Unless it comes near the noise: here 4000 readings, and a mode of 0.5 Hz."""
    effect = residyn.PeriodicDisturbance("elbow", 0.2, frequency)
    variant = way.Variant(effect, ("torque",), (1.0,), (0.0, 0.5 * np.pi), 1)
    r = SimpleNamespace(recording=SimpleNamespace(duration=20.0))
    fit = SimpleNamespace(modes=[SimpleNamespace(frequency_hz=0.5)])
    near = SimpleNamespace(fit=fit, fitted=[r], readings=4000)
    near.ready = SimpleNamespace(scales=lambda: None)
    answered = screening._Answered([], np.array([0, 0]), None, SimpleNamespace(alone=1e5))
    monkeypatch.setattr(screening, "_variants", lambda *of: [variant])
    monkeypatch.setattr(screening, "_answered", lambda *of: answered)
    monkeypatch.setattr(screening, "_factors", lambda *of: (np.zeros(2), 1e5 - left))
    weighed = SimpleNamespace(chi2=left, _replace=lambda **of: SimpleNamespace(chi2=left))
    monkeypatch.setattr(screening, "_weigh", lambda *of: weighed)
    _, found, _ = screening.screen(near, [], [effect])
    assert bool(found) is (left == 4e3 or frequency == 0.9)


def test_disturbances_are_looked_for_beside_modes_too():
    rng = np.random.default_rng(0)
    time = np.linspace(0.0, 20.0, 1600)
    noise, q, v = rng.standard_normal((3, 1600, 1))
    path = SimpleNamespace(h=0.1, time=time, missing=noise, q=q, v=v)
    found = np.array(way._frequencies(0, [path], [0.5]))
    beside = found[way.resonant(found, [0.5], 20.0)]
    assert set(np.sign(beside - 0.5)) == {-1.0, 1.0}
    assert not any(way.one_with(f, [0.5], 20.0) for f in found)


@pytest.mark.parametrize(
    ("spectra", "shape", "led", "looks"),
    [
        (0.5, 1e-9, True, True),
        (0.5, 1e-9, False, False),  # along the model's own motion there is no noise
        (0.5, 0.5, True, False),
        (1e-9, 1e-9, True, False),  # something else says so, too
    ],
)
def test_what_noise_led_is_not_asked_what_is_left(spectra, shape, led, looks, monkeypatch):
    with jax.enable_x64(True):
        step = stand(residyn.fit(experiment(), starts=1), ())
    white = {j: w._replace(p=spectra) for j, w in step.where.white.items()}
    seen = SimpleNamespace(p=shape)
    step = step._replace(where=dataclasses.replace(step.where, white=white), unnamed=seen)
    step = step._replace(tried=SimpleNamespace(led=led))
    view = SimpleNamespace(near=None, paths=None, led=False)
    monkeypatch.setattr(suspects._View, "of", lambda step, missing: view)
    monkeypatch.setattr(suspects, "screen", lambda *args, **how: (0.0, [], None))
    monkeypatch.setattr(suspects, "left_over", lambda *args: SimpleNamespace(p=0.7))
    assert suspects.seen_afresh(step, ()).unnamed.p == (0.7 if looks else shape)


@pytest.mark.parametrize(
    ("costs", "first"),
    [
        ((4000.0, 4000.0 + 1e-9), "constant_torque"),
        ((4000.0 + 1e-9, 4000.0), "constant_torque"),
        ((4000.5, 4000.0), "sensor_offset"),
    ],
)
def test_rounding_does_not_choose_between_twins(costs, first, monkeypatch):
    monkeypatch.setattr(rungs, "score", lambda step, r: r.cost)
    laws = (residyn.ConstantTorque, residyn.SensorOffset)
    fits = [
        SimpleNamespace(effect=law("elbow"), cost=c, possible=True)
        for law, c in zip(laws, costs, strict=True)
    ]
    for order in (fits, fits[::-1]):
        assert ranked(SimpleNamespace(refits=order))[0].effect.name == first


def test_a_joint_that_hardly_damps_is_not_led_along_noise():
    """Its fit is near the noise, and knows the motion better than smoothed readings do."""
    arm = rig.Arm(0.58, 0.588, 0.4467, 0.1059, 0.1937, 1.2578, (5.965, 21.11), (0.0117, 0.0046))
    hidden = [rig.Hidden("constant_torque:elbow", {"torque": -0.0545})]
    rng, q0 = np.random.default_rng(0), np.array([0.0843, -0.3194])
    case = rig.record(rng, arm, q0, hidden, seconds=20.0, rate=100.0, noise=0.0118)
    with jax.enable_x64(True):
        step = stand(residyn.fit(beside(case)), ())
        torques = [m.torque for m in missing_of(step.fit, ())]
        weak = [i for i, n in enumerate(step.fit.numbers) if n.name == "damper:shoulder.damping"]
        values = np.asarray(step.fit.model.vector()).copy()
        values[weak] = 1e-6
        fit = dataclasses.replace(step.fit, model=step.fit.model.with_vector(jnp.asarray(values)))
        near = step.near._replace(fit=fit)
        assert steadied(near) is not near
        view = suspects._View.of(step._replace(near=near), torques)
        assert not view.led


def test_noise_far_above_the_modes_hides_no_disturbance():
    """The noise of a torque grows as the square of the frequency; the short step of a law with
    corners would show all of it."""
    rng = np.random.default_rng(0)
    h, parts = 0.0128, way._PARTS
    time = (np.arange(1560 * parts) + 0.5) * h / parts
    knots = np.arange(0.0, 20.0, 0.01)
    rough = np.gradient(np.gradient(rng.standard_normal(len(knots))))
    missing = 30 * np.interp(time, knots, rough) + np.sin(2 * np.pi * 6.0 * time)
    slow = np.sin(2 * np.pi * time)
    columns = [np.stack([x, x], axis=1) for x in (missing, slow, np.gradient(slow))]
    path = SimpleNamespace(h=h, time=time, missing=columns[0], q=columns[1], v=columns[2])
    found = np.array(way._frequencies(0, [path], [1.4, 2.5]))
    assert found.max() <= 5 * 2.5
    assert np.abs(found - 6.0).min() < 0.1


@pytest.mark.parametrize(
    ("best", "again"),
    [
        (9e3, ["brake_slip", "coulomb_friction", "bearing_friction"]),
        (4e3, ["coulomb_friction"]),
    ],
)
def test_who_may_have_lost_its_way_is_fitted_by_name(best, again, monkeypatch):
    """Laws that stick or rattle, each of them once: all, if nothing explains what is missing, else
    those that promised much of what the best one brings and brought less."""
    asked = []
    monkeypatch.setattr(valleys, "afresh", lambda step, made, r: asked.append(r.effect.name) or r)
    monkeypatch.setattr(valleys, "worth", lambda effect, step: 20.0)
    tried = (
        (residyn.BrakeSlip, best, 17e3, False),
        (residyn.CoulombFriction, 12e3, 15e3, False),
        (residyn.BearingFriction, 12e3, 5e3, False),
        (residyn.Hysteresis, 12e3, 15e3, True),
        (residyn.CubicStiffness, 12e3, 15e3, False),
    )
    fits = [
        SimpleNamespace(
            effect=law() if law is residyn.BearingFriction else law("elbow"),
            label=law.name,
            cost=cost,
            by_name=done,
            screened=SimpleNamespace(drop=drop),
        )
        for law, cost, drop, done in tried
    ]
    assert valleys.none_lost(SimpleNamespace(readings=4000, cost=2e4), None, fits) == fits
    assert asked == again


@pytest.mark.parametrize(("cost", "found"), [(5e3, None), (9e3, "periodic_disturbance:elbow")])
def test_an_oscillation_beside_a_mode_must_explain_everything(cost, found, monkeypatch):
    def by_name(step, made, effect):
        for place, left in (("shoulder", 8e3), ("elbow", 4e3)):
            if effect.place == place:
                yield np.zeros(1), None, SimpleNamespace(cost=left)

    monkeypatch.setattr(valleys, "_by_name", by_name)
    kinds = [residyn.CubicStiffness("elbow")]
    kinds += [residyn.PeriodicDisturbance(joint) for joint in ("shoulder", "elbow")]
    screened = [SimpleNamespace(effect=e) for e in kinds]
    step, fits = SimpleNamespace(readings=4000, cost=1e5), [SimpleNamespace(cost=cost)]
    refit = valleys.beside_a_mode(step, None, screened, fits)
    assert (refit and refit.label) == found


def test_whom_the_screen_puts_further_down_is_fitted_next():
    """Of those not fitted yet, who promises half of what the best one does."""
    drops = {"gravity": 1e5, "dead_zone": 8e4, "hysteresis": 6e4, "cubic_stiffness": 4e4}
    kinds = {n: effects_named(n, ARM_BODIES)[-1] for n in drops}
    model = residyn.Model(ARM_BODIES)
    step = SimpleNamespace(
        readings=4000, fit=SimpleNamespace(model=model), near=SimpleNamespace(fitted=[None])
    )
    found = [SimpleNamespace(effect=kinds[n], drop=d, chi2=2e5 - d) for n, d in drops.items()]
    next_ = suspects._next_best(step, found, found[:1])
    assert [s.effect.name for s in next_] == ["dead_zone", "hysteresis"]
    # Four fifths of the best promise are enough to be among the first, beyond the three best.
    chi2s = (4.1e3, 3e4, 3.5e4, 4e4, 6e4)
    first = [SimpleNamespace(effect=kinds["gravity"], drop=2e5 - c, chi2=c) for c in chi2s]
    assert len(suspects._promising(step, first, 2e5, True, 6)) == 4


def test_a_law_takes_over_from_the_one_that_it_extends():
    """Both at one joint: only the sum of their torques is known, and one of them is to go."""
    model = (
        residyn.Model(ARM_BODIES)
        + residyn.Spring("elbow", 10.0)
        + residyn.CoulombFriction("elbow", 0.5)
    )
    model = model + residyn.StribeckFriction("elbow", -0.2, 0.1, 0.05)
    numbers = [SimpleNamespace(name=n.name) for n in model.fitted]
    fit = SimpleNamespace(model=model, numbers=numbers)
    handed = dict(zip([n.name for n in numbers], _handed_on(fit, model.effects[1]), strict=True))
    assert handed["stribeck_friction:elbow.torque"] == pytest.approx(0.3)
    assert handed["stribeck_friction:elbow.excess"] == pytest.approx(0.1)
    assert handed["spring:elbow.stiffness"] == pytest.approx(10.0)


@pytest.mark.parametrize(("cost", "said"), [(4010.0, ("gravity",)), (4100.0, ())])
def test_a_law_that_does_the_work_of_two_is_said_beside_each(cost, said):
    def end(cost, *labels):
        names = SimpleNamespace(model=SimpleNamespace(labels=("spring:elbow", *labels)))
        return SimpleNamespace(fit=names, cost=cost, readings=4000)

    two = end(4005.0, "constant_torque:elbow", "constant_torque:shoulder", "dead_zone:elbow")
    others = [end(cost, "gravity", "dead_zone:elbow")]
    for name in ("constant_torque:elbow", "constant_torque:shoulder"):
        assert weighing.together(two, others, name) == said
    assert weighing.together(two, others, "dead_zone:elbow") == ()


def test_a_fit_out_of_step_begins_again():
    """A slipping brake whose fit was left with a spring that is 40 % too soft: no small step leads
    out of there. From where a fit by name begins, it ends at the noise."""
    made = experiment(
        "brake_slip:elbow", {"stiffness": ARM.stiffness[1], "angle": 0.03}, noise=2e-3
    )
    base, effect = residyn.fit(made, starts=1), residyn.BrakeSlip("elbow")
    with jax.enable_x64(True):
        step = stand(base, ())
        model = residyn.Model(base.model.mechanism, (*base.model.effects, effect))
        shoulder, _, *damping = (n.value for n in base.numbers)
        bad = np.array([[shoulder, 0.6 * ARM.stiffness[1], *damping, 0.6 * ARM.stiffness[1], 0.3]])
        assert [n.meaning.field for n in model.fitted][-2:] == ["stiffness", "angle"]
        (r,) = step.near.fitted
        states = np.append(r.state, 0.0)[None, None]
        lost, descent = refit(made, (effect,), bad, states, [r.wild])
        noise = step.readings
        left = SimpleNamespace(chi2=noise, states=states[0])
        was = Refit(effect, left, lost, descent, bad[0], True)
        (now,) = out_of_valleys(step, made, [was])
    assert was.cost > 3 * noise
    assert now.cost < 1.1 * noise
    found = dict(zip([n.name for n in now.model.fitted], now.model.vector(), strict=True))
    assert found["brake_slip:elbow.angle"] == pytest.approx(0.03, rel=0.1)


@pytest.mark.parametrize("stiffness", [1e-4, 0.02, 8.0])
def test_a_model_without_a_spring_is_led_with_one(stiffness):
    """... at a step that follows the motion, however slow the model is that was fitted. One that
    swings less than once in the recording is none."""
    fit = residyn.fit(experiment(), starts=1)
    slow = fit.model.with_values({"spring:elbow.stiffness": stiffness})
    begun = [dataclasses.replace(n, start=n.value) for n in fit.numbers]
    with jax.enable_x64(True):
        near = Near.of(dataclasses.replace(fit, model=slow, numbers=tuple(begun)))
        led = steadied(near)
    values = led.fit.model.values()
    if stiffness == 8.0:
        assert led is near
    else:
        assert 1.0 < float(values["spring:elbow.stiffness"]) < 300.0
        assert float(values["spring:shoulder.stiffness"]) == pytest.approx(
            ARM.stiffness[0], rel=0.1
        )
    assert int(led.problem.steps) >= int(near.problem.steps)


def test_gravity_holds_a_joint_as_a_spring_does():
    fit = residyn.fit(experiment(), effects=["gravity"], starts=1)
    lost = {"spring:elbow.stiffness": 1e-4, "gravity.moment1": 0.0}
    steady = []
    for moment in (0.0, 16.0):
        model = fit.model.with_values({**lost, "gravity.moment2": moment})
        begun = [dataclasses.replace(n, start=n.value) for n in fit.numbers]
        with jax.enable_x64(True):
            near = Near.of(dataclasses.replace(fit, model=model, numbers=tuple(begun)))
            steady.append(steadied(near) is near)
    assert steady == [False, True]


# -- measured -----------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.skipif(not (DATA / "double_pendulum").is_dir(), reason="measured data are not here")
@pytest.mark.parametrize(("start", "stop", "least"), [(30, 40, 2.9e-3), (8, 13, 3.8e-3)])
def test_a_hanging_arm_feels_gravity(start, stop, least):
    table = ArmTable((0.1727, 0.2), 5.648e-3, 3.146e-3, 1.6072e-2)  # its authors' estimate
    time, angle, _, _ = residyn.recording.read_csv(DATA / "double_pendulum" / "free_swing.csv", 2)
    recording = residyn.Recording.from_arrays(time, angle, start=start, stop=stop, theta2=0.0)
    found = residyn.diagnose(residyn.Experiment(table, (recording,)))
    assert found.added[0] == "gravity"
    assert math.sqrt(np.mean(np.square(found.fit.rmse))) < least


@pytest.mark.skipif(not (DATA / "carts").is_dir(), reason="measured data are not here")
def test_a_cart_has_dry_friction():
    path = DATA / "carts" / "low_spring_loaded_1.csv"
    time, angle, _, _ = residyn.recording.read_csv(path, 1)
    recording = residyn.Recording.from_arrays(time, angle, start="release", name=path.name)
    table = InertiaTable(("cart",), ((0.5685 + 0.986,),), ("m",))
    found = residyn.diagnose(residyn.Experiment(table, (recording,)), max_effects=1)
    assert found.added[0].partition(":")[0] in ("coulomb_friction", "stribeck_friction")
    assert math.hypot(*found.ladder[0].fit.rmse) > 4 * math.hypot(*found.ladder[1].fit.rmse)


@pytest.mark.slow
def test_jax_sees_plain_arrays(friction):
    """The named model is a model like any other: it simulates, and differentiates."""
    model = friction.fit.model

    def end(torque):
        moved = model.with_values({"coulomb_friction:elbow.torque": torque})
        steps = 200
        return residyn.simulate(moved, jnp.linspace(0.0, 2.0, 5), Q0, steps=steps).q[-1, 1]

    with jax.enable_x64(True):
        slope = jax.grad(end)(0.05)
        step = (end(0.0501) - end(0.0499)) / 2e-4
    assert float(slope) == pytest.approx(float(step), rel=1e-3)


@pytest.mark.slow
def test_an_effect_that_has_become_needless_is_dropped():
    """Friction was hidden; a cubic spring that had joined before it goes, friction stays."""
    made = experiment("coulomb_friction:elbow", {"torque": 0.05})
    both = residyn.fit(made, effects=["cubic_stiffness:elbow", "coulomb_friction:elbow"], starts=2)
    with jax.enable_x64(True):
        step = stand(both, [e for e in both.model.effects if e.name not in ("spring", "damper")])
        left = needless(step, made, 0)
    assert [e.label for e in left.effects] == ["coulomb_friction:elbow"]
    assert left.cost < 1.01 * step.cost


@pytest.mark.slow
def test_two_simple_effects_are_not_one_with_many_numbers():
    """Gravity's four numbers explain most of both, and it joins first."""
    labels = ("constant_torque:elbow", "stiffness_drift:elbow")
    rng = np.random.default_rng([7008, *"/".join(labels).encode(), 10000])
    strength = float(np.exp(rng.uniform(*np.log((0.02, 0.1)))))
    (case,) = rig.hidden_cases(rng, labels, 1, noise_share=0.01, strength=strength)
    found = residyn.diagnose(beside(case))
    assert set(found.added) == set(labels)
    assert found.verdict == "missing"


class Seen:
    """A rung as `climb` sees it: what has joined, what that leaves, what else was fitted."""

    readings, near = 4000, SimpleNamespace(fitted=[None])
    fitted = (  # what that leaves, and its numbers
        (residyn.Gravity(), 5e3, 4),
        (residyn.ConstantTorque("elbow"), 5.4e3, 1),
        (residyn.StiffnessDrift("elbow"), 9e4, 1),
    )

    def __init__(self, cost, *names):
        self.cost = cost
        self.effects = tuple(next(e for e, *_ in self.fitted if e.name == n) for n in names)
        mechanism = residyn.ConstantInertia(((2.9, 1.0), (1.0, 0.6)), ("shoulder", "elbow"))
        self.fit = SimpleNamespace(model=residyn.Model(mechanism, self.effects))
        self.screened, self.refits = (
            (),
            tuple(
                SimpleNamespace(label=e.label, cost=c, numbers=n, possible=True)
                for e, c, n in self.fitted
            ),
        )

    def price(self, effect):
        return next(n for e, _, n in self.fitted if e.name == effect.name) * math.log(4000)

    def _replace(self, screened, refits):
        left = Seen(self.cost)
        left.screened, left.refits = screened, refits
        return left


@pytest.mark.parametrize(("instead", "first"), [(4010.0, "constant_torque"), (4040.0, "gravity")])
def test_the_ladder_is_climbed_again_without_a_law_with_many_numbers(instead, first, monkeypatch):
    """Three numbers more are worth 25 of chi-square among 4000 readings, and no more."""
    base, drift = Seen(1.2e5), "stiffness_drift"
    begun = []

    def up(self, step, candidates):
        begun.append([r.label for r in step.refits] + [c.label for c in candidates])
        if "gravity" in begun[-1]:
            return [base, Seen(5e3, "gravity"), Seen(4e3, "gravity", drift)]
        return [step, Seen(5.4e3, "constant_torque"), Seen(instead, "constant_torque", drift)]

    monkeypatch.setattr(climbing._Ladder, "up", up)
    steps, _ = climbing.climb(None, base, [], 3, lambda words: None)
    assert [e.name for e in steps[-1].effects] == [first, drift]
    assert len(begun) == 2


@pytest.mark.parametrize(("instead", "names"), [(4005.0, 2), (4015.0, 1), (4200.0, 1)])
def test_a_lone_law_with_many_numbers_is_no_likelier_than_two_with_fewer(
    instead, names, monkeypatch
):
    """Two numbers less are worth 17 of chi-square, and a second name costs 7 of them."""
    base, drift = Seen(1.2e5), "stiffness_drift"
    alone = Seen(4000.0, "gravity")

    def up(self, step, candidates):
        if any(r.label == "gravity" for r in step.refits):
            return [base, alone]
        return [step, Seen(5.4e3, "constant_torque"), Seen(instead, "constant_torque", drift)]

    monkeypatch.setattr(climbing._Ladder, "up", up)
    steps, others = climbing.climb(None, base, [], 3, lambda words: None)
    assert len(steps[-1].effects) == names
    assert others[0].cost == (4000.0 if names == 2 else instead)


def test_a_lone_law_that_extends_another_one_is_not_climbed_without():
    step, place = Seen(1.2e5), "elbow"
    rich, plain = residyn.StribeckFriction(place), residyn.CoulombFriction(place)
    step.refits = [
        SimpleNamespace(label=e.label, cost=c, numbers=n, possible=True)
        for e, c, n in [(rich, 4e3, 3), (plain, 5e3, 1)]
    ]
    assert climbing.without(step, rich) is not None  # another effect has joined beside it
    assert climbing.without(step, rich, room=True) is None


def test_a_lone_law_with_one_number_more_leaves_no_room_for_another_name():
    alone = Seen(1.2e5)
    alone.refits[0].numbers = 2
    assert climbing.without(alone, residyn.Gravity()) is not None
    assert climbing.without(alone, residyn.Gravity(), room=True) is None


@pytest.mark.parametrize("cost", [4200.0, 4100.0])
def test_a_law_that_did_worse_than_the_one_it_extends_begins_where_that_ended(cost, monkeypatch):
    rich, plain = residyn.StribeckFriction("elbow", 9.0, 0.4, 0.2), residyn.CoulombFriction("elbow")
    base = residyn.Model(ARM_BODIES) + residyn.Spring("elbow", 10.0)
    model = base + residyn.CoulombFriction("elbow", 0.5)
    states = np.array([[0.1, 0.2, 0.3, 0.4]])
    descent = SimpleNamespace(
        unknowns=None, problem=SimpleNamespace(states=lambda unknowns: states), cost=4150.0
    )
    screened = Screened(rich, 0.0, 0.0, np.array([3.0]), np.zeros((1, 4)), None)  # pyright: ignore
    step = SimpleNamespace(
        fit=SimpleNamespace(numbers=[None]),
        near=SimpleNamespace(fitted=[SimpleNamespace(state=states[0])]),
    )
    both = [
        Refit(plain, None, model, descent, np.zeros(2), True),  # pyright: ignore
        Refit(rich, screened, None, SimpleNamespace(cost=cost), np.zeros(4), True),  # pyright: ignore
    ]
    begun = []

    def again(step, experiment, moved, least, weak):
        begun.append(moved)
        return both[1]._replace(descent=SimpleNamespace(cost=4149.0))

    monkeypatch.setattr(refitting, "_refit", again)
    found = refitting.extending(step, None, both)
    if cost < 4150.0:
        assert not begun
        assert found == both
        return
    assert [r.cost for r in found] == [4150.0, 4149.0]
    (moved,) = begun
    assert moved.numbers == pytest.approx([10.0])
    assert moved.states == pytest.approx(states)
    law = moved.effect
    assert (law.level, law.excess, law.velocity) == pytest.approx((0.5, 0.3 * 0.4, 0.2))


@pytest.mark.parametrize(("left", "plain"), [(4100.0, True), (8000.0, False)])
def test_what_is_plain_needs_no_prediction(left, plain):
    """All but 1 % of what was over the noise is explained; nobody could predict anything."""

    def rung(cost):
        fitted = SimpleNamespace(
            used=np.ones(4000, bool),
            residual=np.full(4000, math.sqrt(cost / 4000)),
            recording=SimpleNamespace(noise=1.0, role="fit"),
        )
        fit = SimpleNamespace(recordings=[fitted])
        return SimpleNamespace(fit=fit, cost=cost, readings=4000, white=1e-9, held_out=None)

    assert matters(rung(4e5), rung(left)) is plain


@pytest.mark.parametrize(
    ("ends", "settled"),
    [
        ([(500.0, True)], True),
        ([(500.0, False), (499.9, False)], True),  # 80 more steps gained nothing
        ([(500.0, False), (300.0, False)], False),
        ([(500.0, False), (300.0, True)], True),
        ([(math.inf, False)], False),
    ],
)
def test_a_part_that_no_longer_gains_has_settled(ends, settled, monkeypatch):
    """Along a kink of dry friction a search may not end by itself where nothing is left to gain."""
    ends = iter(ends)

    def polish(problem, start, shares, size):
        cost, converged = next(ends)
        return SimpleNamespace(cost=cost, converged=converged, unknowns=start)

    monkeypatch.setattr(linear, "polish", polish)
    monkeypatch.setattr(linear, "reweighted", lambda problem, wild: problem)
    recording = SimpleNamespace(angle=np.zeros((4, 1)))
    fit = SimpleNamespace(reduced_chi2=1.0)
    near = SimpleNamespace(
        _pairs=lambda kept: [(kept[0], SimpleNamespace(recording=recording))],
        problem=None, at=np.zeros(1), fit=fit,
    )  # fmt: skip
    assert Near.refitted(near, [np.ones(4, bool)])[1] is settled
    assert next(ends, None) is None


@pytest.mark.parametrize(
    ("before", "after", "ahead", "enough"),
    [
        (1.18, 1.02, 0.99, True),  # nine tenths of what was over the noise, a tenth of nothing else
        (1.18, 1.10, 0.99, False),
        (1.18, 1.02, 1.01, False),
        (400.0, 300.0, 0.9, True),
        (400.0, 340.0, 0.9, False),
    ],
)
def test_near_the_noise_what_matters_is_the_share_of_what_is_over_it(before, after, ahead, enough):
    def rung(chi2, held):
        fitted = SimpleNamespace(
            used=np.ones(4000, bool),
            residual=np.full(4000, math.sqrt(chi2)),
            recording=SimpleNamespace(noise=1.0, role="fit"),
        )
        held_out = SimpleNamespace(held_out=SimpleNamespace(ratio=np.array([held])))
        known = {"fit": SimpleNamespace(recordings=[fitted]), "cost": 4000 * chi2}
        return SimpleNamespace(**known, readings=4000, white=1e-9, held_out=held_out)

    assert matters(rung(before, 1.0), rung(after, ahead)) is enough


@pytest.mark.parametrize(("stiffness", "loud"), [(0.1, False), (9.0, True)])
def test_a_shape_is_no_proof_of_an_effect(stiffness, loud):
    """A gap known to 1 %, of a spring that may be none."""
    model = residyn.Model(
        residyn.ConstantInertia(((1.0,),), ("j",)), (residyn.DeadZone("j", stiffness, 0.5),)
    )
    assert [n.meaning.field for n in model.fitted] == ["stiffness", "gap"]
    numbers = [SimpleNamespace(value=x) for x in (stiffness, 0.5)]
    fit = SimpleNamespace(model=model, numbers=numbers, covariance=np.diag([1.0, 0.005**2]))
    assert (_loud(fit, [0, 1]) > 23.0) is loud


def weighed(monkeypatch, screened=(), free=(), excess=0.3, **costs):
    """Shares of effects (`name`: chi-square with it at the elbow) beside 4000 readings; of those
    that were only screened, at first order; those that are `free` have a number too many."""
    monkeypatch.setattr(weighing, "temper", lambda step: 1.0)
    laws = "CoulombFriction", "StribeckFriction", "CubicStiffness", "QuadraticDrag"
    kinds = {e.name: e for e in (getattr(residyn, law)("elbow") for law in laws)}
    ended = kinds | {"stribeck_friction": residyn.StribeckFriction("elbow", 1.0, excess)}
    numbers = {"stribeck_friction": 3, **dict.fromkeys(free, 2)}
    paid = {n: (numbers.get(n, 1) - (n in free)) * math.log(4000) for n in costs}
    one = SimpleNamespace(cost=5e3, readings=4000, screened=(), refits=[])
    one.fit = residyn.fit(experiment(), starts=1)
    seen = {n: SimpleNamespace(effect=kinds[n], chi2=4000.0) for n in (*costs, *screened)}
    one.screened = tuple(seen.values())
    one.refits = [
        SimpleNamespace(effect=kinds[n], label=kinds[n].label, cost=c, possible=True,
                        numbers=numbers.get(n, 1), screened=seen[n],
                        model=SimpleNamespace(effects=(ended[n],)),
                        price=lambda readings, n=n: paid[n])
        for n, c in costs.items()
    ]  # fmt: skip
    return {k.partition(":")[0]: x for k, x in weighing._among(one).items()}


@pytest.mark.parametrize("richer", [4000.0, 3993.0])
def test_a_law_that_cannot_be_told_from_a_simpler_one_keeps_its_share(richer, monkeypatch):
    found = weighed(monkeypatch, coulomb_friction=4000.0, stribeck_friction=richer)
    assert 0.1 < found["stribeck_friction"] <= found["coulomb_friction"] < 0.9


@pytest.mark.parametrize("excess", [0.3, -0.3])
def test_a_law_that_brings_what_noise_seldom_does_beyond_a_simpler_one_is_likelier(
    excess, monkeypatch
):
    """Two numbers more: noise brings 9.2 once in a hundred. But not one that bends to what is left
    with a strength that no friction has."""
    found = weighed(monkeypatch, excess=excess, coulomb_friction=4000.0, stribeck_friction=3989.0)
    if excess > 0:
        assert found["stribeck_friction"] > 0.9
    else:
        assert found["stribeck_friction"] <= found["coulomb_friction"]


def test_a_number_that_nothing_determines_costs_nothing(monkeypatch):
    """Of two that explain the same the simpler one is named, and no surer than the other."""
    same = {"cubic_stiffness": 4000.0, "quadratic_drag": 4000.0}
    found = weighed(monkeypatch, free=["quadratic_drag"], **same)
    assert found["quadratic_drag"] == pytest.approx(found["cubic_stiffness"])
    # However well it explains: what costs less makes it no likelier than who is ranked before it.
    found = weighed(
        monkeypatch, free=["quadratic_drag"], cubic_stiffness=4000.0, quadratic_drag=3995.0
    )
    assert found["quadratic_drag"] == pytest.approx(found["cubic_stiffness"])


def test_how_well_numbers_are_known_apart():
    """Two numbers of which only the sum shows, one that the model's own does as well, one by
    itself; each 50 standard errors."""
    x = np.random.default_rng(0).normal(size=(400, 3))
    x *= 50.0 / np.linalg.norm(x, axis=0)
    own, sums, alone = x.T
    columns = np.stack([own, sums, sums, 2.0 * own, alone], axis=1)
    square = columns.T @ columns
    assert certainty(square, np.array([1, 2])) == pytest.approx([0.0, 2 * 2500.0], rel=0.05)
    assert certainty(square, np.array([3])) == pytest.approx([0.0], abs=1e-3)
    assert certainty(square, np.array([4])) == pytest.approx([2500.0], rel=0.05)
    most = math.log(4000)
    assert numbers_price(np.array([0.0, 1e9]), 2, 4000) == pytest.approx(most)
    assert numbers_price(np.array([0.0, 1.0]), 3, 4000) == pytest.approx(most + math.log(2.0))


def test_the_number_of_a_step_and_of_its_candidate_cost_the_same():
    """One is had from the descent, the other from the slopes beside the readings."""
    hidden = [rig.Hidden("brake_slip:elbow", {"stiffness": 2.8, "angle": 0.12})]
    made = rig.record(
        np.random.default_rng(1), ARM, Q0, hidden, seconds=12.0, rate=100.0, noise=0.02
    )
    case = beside(made)
    with jax.enable_x64(True):
        base = stand(residyn.fit(case, starts=1), ())
        effect = residyn.BrakeSlip("elbow")
        start = np.array([*ARM.stiffness, *ARM.damping, 2.8, 0.12])
        wild = [r.wild for r in base.near.fitted]
        model, descent = refit(case, (effect,), start[None], None, wild)
        new = Refit(effect, None, model, descent, start, True)  # pyright: ignore
        step = stand(finish(case, model, start, descent, 0.0), (effect,))
        cost = new.price(base.readings)
    assert cost < 1.8 * math.log(base.readings)
    assert cost == pytest.approx(step.price(effect), abs=0.5)


def test_names_share_what_they_have_with_those_of_a_climb_that_ended_as_well(monkeypatch):
    elbow = residyn.ConstantTorque("elbow"), residyn.StiffnessDrift("elbow")
    model = residyn.Model(residyn.PlanarArm([0.4, 0.4], 1.2, 0.6, 1.4), elbow)
    base, last, other = (
        SimpleNamespace(effects=e, fit=SimpleNamespace(model=model))
        for e in ((), elbow, (residyn.Gravity(), elbow[1]))
    )
    monkeypatch.setattr(weighing, "temper", lambda step: 1.0)
    prices = {id(last): 4000.0, id(other): 4000.0 + 2.0 * math.log(3.0)}
    monkeypatch.setattr(weighing, "price", lambda step, first, beside: prices[id(step)])
    before = {elbow[0].label: 0.8, elbow[1].label: 0.9, "gravity": 0.0, "cubic_stiffness": 0.1}
    found = weighing._shared([base, last], [other], before)
    assert found[elbow[0].label] == pytest.approx(0.75 * 0.8)
    assert found["gravity"] == pytest.approx(0.25 * 0.8)
    assert found[elbow[1].label] == pytest.approx(0.9)  # named by both
    assert found["cubic_stiffness"] == pytest.approx(0.75 * 0.1)
    assert weighing._shared([base, last], [], before) == before


def test_who_did_not_join_has_what_those_have_left_who_did(monkeypatch):
    """Hysteresis was the likeliest at first; two simpler effects together leave nothing for it."""
    monkeypatch.setattr(weighing, "_among", lambda step: step.shares)
    monkeypatch.setattr(weighing, "_known", lambda *rest: 1.0)
    monkeypatch.setattr(weighing, "temper", lambda step: 1.0)
    drift, offset = residyn.StiffnessDrift("elbow"), residyn.ConstantTorque("elbow")
    model = residyn.Model(residyn.PlanarArm([0.4, 0.4], 1.2, 0.6, 1.4), (drift, offset))
    shares = [{"hysteresis:elbow": 0.99, drift.label: 0.9}, {offset.label: 0.97}, {}]
    known = {"white": 0.5, "readings": 4000, "fit": SimpleNamespace(model=model), "unnamed": None}
    steps = [
        SimpleNamespace(shares=x, effects=e, **known)
        for x, e in zip(shares, [(), (drift,), (drift, offset)], strict=True)
    ]
    found = weighing.chances(steps)
    assert found["hysteresis:elbow"] == pytest.approx(0.1)
    assert (found[drift.label], found[offset.label]) == pytest.approx((0.9, 0.97))


@pytest.mark.parametrize(
    ("one", "other", "kin"),
    [
        (residyn.BrakeSlip("elbow"), residyn.ConstantTorque("elbow"), True),
        (residyn.ConstantTorque("elbow"), residyn.BrakeSlip("elbow"), True),
        (residyn.StribeckFriction("elbow"), residyn.CoulombFriction("elbow"), True),
        (residyn.BrakeSlip("elbow"), residyn.ConstantTorque("shoulder"), False),
        (residyn.CubicStiffness("elbow"), residyn.ConstantTorque("elbow"), False),
    ],
)
def test_whose_motion_may_be_the_same(one, other, kin):
    assert suspects.resemble(one, other) is kin


@pytest.mark.parametrize(
    ("left", "offset", "found"),
    [
        (4100.0, 4105.0, ["brake_slip:elbow"]),
        (4100.0, 9e4, ["brake_slip:elbow", "sensor_offset:elbow"]),  # ended elsewhere: once more
        (3e4, 9e4, []),
    ],
)
def test_only_kin_of_those_that_are_nearly_the_best_are_fitted(left, offset, found):
    """Beside 1e5 that the base model leaves, and a law that comes to the noise."""
    names = (
        "brake_slip:elbow",
        "brake_slip:shoulder",
        "sensor_offset:elbow",
        "cubic_stiffness:elbow",
    )
    effects = [effects_named(name, ARM_BODIES)[0] for name in names]
    screened = [SimpleNamespace(effect=e) for e in effects]
    fitted = [
        SimpleNamespace(effect=e, label=e.label, cost=cost, possible=True)
        for e, cost in [
            (residyn.CubicStiffness("elbow"), 4000.0),
            (residyn.ConstantTorque("elbow"), left),
            (residyn.SensorOffset("elbow"), offset),
        ]
    ]
    fit = SimpleNamespace(model=residyn.Model(ARM_BODIES))
    near = SimpleNamespace(fitted=[None])
    step = SimpleNamespace(cost=1e5, readings=4000, fit=fit, near=near)
    pairs = suspects._kin(step, screened, fitted)
    assert [s.effect.label for s, _ in pairs] == found
    assert all(twin is fitted[1] for _, twin in pairs)


def test_a_twin_that_ended_lower_leads_the_best_out_of_its_valley(monkeypatch):
    """A constant torque is stuck at 1.2 times the noise; the brake that it resembles is not, and
    the torque begins again from there. Those that ended together are not fitted once more."""
    names = ("constant_torque:elbow", "brake_slip:elbow", "sensor_offset:elbow")
    effects = [effects_named(name, ARM_BODIES)[0] for name in names]
    screened = [SimpleNamespace(effect=e) for e in effects]
    costs = [iter(each) for each in ([4850.0, 4030.0], [4031.0], [4850.0, 4600.0])]
    calls = []

    def fits(step, experiment, some):
        calls.append([s.effect.label for s in some])
        left = [next(costs[names.index(s.effect.label)]) for s in some]
        pairs = zip(some, left, strict=True)
        return [
            SimpleNamespace(effect=s.effect, label=s.effect.label, cost=cost, possible=True)
            for s, cost in pairs
        ]

    monkeypatch.setattr(suspects, "refits", fits)
    monkeypatch.setattr(suspects, "beginning_at", lambda step, twin, s: s)
    fit = SimpleNamespace(model=residyn.Model(ARM_BODIES))
    step = SimpleNamespace(cost=1e5, readings=4000, fit=fit, near=SimpleNamespace(fitted=[None]))
    first, view = fits(step, None, screened[:1]), SimpleNamespace(sharper=list)
    found, tried = suspects._with_twins(step, None, view, screened, first, lambda words: None)
    assert [set(labels) for labels in calls] == [
        set(names[:1]),
        set(names[1:]),
        {names[0], names[2]},
    ]
    assert {r.label: r.cost for r in found} == dict(
        zip(names, (4030.0, 4031.0, 4600.0), strict=True)
    )
    assert len(tried) == 4


def test_a_twin_of_the_best_is_fitted_though_the_screen_puts_it_low():
    """Springs and dampers have found some other way, with an elbow that has no spring: along it a
    constant torque explains nothing, and a shifted sensor, the same motion, does."""
    label = "constant_torque:elbow"
    rng = np.random.default_rng([7124, *label.encode(), 50000])
    (case,) = rig.hidden_cases(rng, (label,), 1, noise_share=0.05)
    swings = np.abs(case.motion[0]).max(axis=0)
    noise = 0.05 * float(np.sqrt(np.mean(swings**2)))  # of the largest swings, not of all
    readings = case.truth + noise / case.noise * (case.q - case.truth)
    made = dataclasses.replace(case, q=readings, noise=noise)
    found = residyn.diagnose(beside(made))
    chance = {c.effect: c.probability for c in found.candidates}
    assert found.verdict == "missing"
    assert chance["constant_torque:elbow"] > 0.2
    assert "constant_torque:elbow" in {*found.added, *(x for g in found.lookalikes for x in g)}


def test_who_was_only_screened_is_believed_as_far_as_screens_keep_their_promises(monkeypatch):
    only = ("cubic_stiffness",)
    kept = weighed(monkeypatch, only, coulomb_friction=4000.0, quadratic_drag=4002.0)
    broken = weighed(monkeypatch, only, coulomb_friction=4000.0, quadratic_drag=4400.0)
    assert kept["cubic_stiffness"] > 0.3
    assert broken["cubic_stiffness"] < 0.01


def test_who_takes_over_from_a_simpler_law_is_as_sure_as_that_was(monkeypatch):
    """Dry friction was sure; whether it falls off hardly is."""
    monkeypatch.setattr(weighing, "_among", lambda step: step.shares)
    monkeypatch.setattr(weighing, "_known", lambda *rest: 0.8)
    plain, rich = residyn.CoulombFriction("elbow"), residyn.StribeckFriction("elbow")
    model = residyn.Model(residyn.PlanarArm([0.4, 0.4], 1.2, 0.6, 1.4), (rich,))
    shares = [{plain.label: 0.9, rich.label: 0.05}, {rich.label: 0.1}, {}]
    known = {"white": 0.0, "readings": 4000, "fit": SimpleNamespace(model=model), "unnamed": None}
    steps = [
        SimpleNamespace(shares=x, effects=e, **known)
        for x, e in zip(shares, [(), (plain,), (rich,)], strict=True)
    ]
    found = weighing.chances(steps)
    assert found[rich.label] == pytest.approx(0.9 * 0.8)
    assert found[plain.label] < 0.1


def test_what_two_share_is_what_is_left_over_the_noise():
    """A tenth of chi-square may be half of what there is to explain."""
    step = SimpleNamespace(readings=4000)
    assert over_noise(4400.0, step) == 400.0
    assert over_noise(4200.0, step) == 0.5 * over_noise(4400.0, step)
    assert over_noise(3900.0, step) == 0.0


# -- torques of any shape ------------------------------------------------------------------


@pytest.fixture(scope="module")
def clean():
    """A clean arm's fit, searched: what the later rungs look with."""
    made = experiment(seed=3)
    with jax.enable_x64(True):
        step = stand(residyn.fit(made, starts=1), ())
        torque = [m.torque for m in missing_of(step.fit, ())]
        return search(step, made, torque, candidates_for(step.fit.model), lambda words: None)


def looked(step, residual):
    """The step's first-order look at another residual (N, n), rad."""
    (one,) = step.near.fitted
    recording = dataclasses.replace(one.recording, angle=one.predicted + residual)
    near = step.near._replace(fitted=(dataclasses.replace(one, recording=recording),))
    with jax.enable_x64(True):
        return left_over(near, step.slopes, step.tried)


def test_noise_is_not_taken_for_a_torque(clean):
    rng = np.random.default_rng(0)
    shape = clean.near.fitted[0].predicted.shape
    p = np.array([looked(clean, 5e-4 * rng.standard_normal(shape)).p for _ in range(100)])
    # Corrected as if all shapes were independent, p is larger than a uniform number, if anything.
    assert np.mean(p < 0.05) <= 0.12
    assert np.mean(p < 0.5) <= 0.65
    assert p.min() > 1e-4


def test_a_short_push_is_seen_where_and_when_it_was(clean):
    """A push too small for the whiteness test; its answer is that of another simulator."""
    values = {"torque": 0.02, "time": 5.0, "width": 0.3}
    pushed, quiet = (
        rig.record(np.random.default_rng(1), ARM, Q0, hidden, seconds=12.0, rate=100.0, noise=1e-12)
        for hidden in ([rig.Hidden("burst:elbow", values)], [])
    )
    noise = 5e-4 * np.random.default_rng(2).standard_normal(pushed.q.shape)
    seen = looked(clean, pushed.q - quiet.q + noise)
    assert seen.p < 1e-6
    said, when = seen.words.removesuffix(" s").rsplit(" ", 1)
    assert said == "acted on the elbow about"
    assert abs(float(when) - 5.0) < 1.0


def test_two_hidden_effects_are_found_together():
    """Screened as a pair, the larger torque first, where each alone leaves much."""
    hidden = [
        rig.Hidden("coulomb_friction:elbow", {"torque": 0.02}),
        rig.Hidden("cubic_stiffness:shoulder", {"coefficient": 40.0}),
    ]
    made = rig.record(
        np.random.default_rng(4), ARM, Q0, hidden, seconds=12.0, rate=100.0, noise=5e-4
    )
    table = experiment().inertia
    recording = residyn.Recording.from_arrays(made.t, made.q, theta2=ARM.theta2, noise=5e-4)
    with jax.enable_x64(True):
        fit = residyn.fit(residyn.Experiment(table, (recording,)), starts=1)
        near, (missing,) = Near.of(fit), missing_of(fit, ())
        way = Way.of(missing.torque, near.problem.steps, 1 / fit.modes[0].frequency_hz)
        some = [
            e
            for e in candidates_for(fit.model)
            if e.name
            in ("coulomb_friction", "cubic_stiffness", "quadratic_drag", "constant_torque")
        ]
        _, found, kept = screen(near, [way], some)
        labels = {s.effect.label for s in found}
        one, other, left = pair(near, kept, labels)
        less = pair(near, kept, labels - {other})
    assert (one, other) == ("cubic_stiffness:shoulder", "coulomb_friction:elbow")
    assert left < 1.5 * made.q.size
    assert left < 0.7 * found[0].chi2
    assert other not in less[:2]  # who is no candidate any more is not found


def ladder(monkeypatch, plan):
    """The rungs of a ladder where effect i of `plan` joins firmly (True), waits (False)
    or does not join (None)."""

    class Rung:
        def __init__(self, count):
            self.effects = tuple(f"e{i}" for i in range(count))
            self.screened, self.unnamed = (), None
            model = type("M", (), {"labels": self.effects})
            self.fit = type("F", (), {"model": model})

    def accepted(step, chosen, made, stands):
        firm = plan[len(step.effects)] if len(step.effects) < len(plan) else None
        if firm is None:
            return None
        new = Rung(len(step.effects) + 1)
        new.effects = (*new.effects[:-1], type("E", (), {"label": "next"}))
        return Accepted(new, firm)

    def looked_at(step, missing):
        step.looked_at = True
        return step

    def accepted_if_seen(step, *rest):
        assert step.looked_at  # before anything is made of what is left
        return accepted(step, *rest)

    monkeypatch.setattr(climbing, "seen_afresh", looked_at)
    monkeypatch.setattr(climbing, "search", lambda step, *rest: step)
    monkeypatch.setattr(climbing, "ranked", lambda step: ["best"])
    monkeypatch.setattr(climbing, "accepted", accepted_if_seen)
    monkeypatch.setattr(climbing, "with_another", lambda step, made: None)
    monkeypatch.setattr(climbing, "needless", lambda step, made, first: step)
    return len(climbing._Ladder(None, [], 0, 3, lambda words: None).up(Rung(0), [])) - 1


@pytest.mark.parametrize(
    ("plan", "rungs"),
    [
        ([None], 0),
        ([True, None], 1),
        ([False, None], 0),  # what it waited for did not come: taken back
        ([False, True, None], 2),
        ([True, False, None], 1),
        ([True, False, True], 3),
        ([True, True, False], 2),  # no rung is left to wait for
    ],
)
def test_what_waits_stands_only_with_the_next(plan, rungs, monkeypatch):
    assert ladder(monkeypatch, plan) == rungs


@pytest.mark.parametrize(
    ("left", "bends", "named"),
    [
        (5.0, 0.95, "coulomb_friction:elbow"),  # bends to what neither explains
        (5.0, 0.70, "stribeck_friction:elbow"),  # matters
        (1.0, 0.95, "stribeck_friction:elbow"),  # only noise is left: chi-square can be believed
    ],
)
def test_a_law_with_more_to_it_must_matter_beside_the_simpler_one(left, bends, named):
    readings = 4000
    laws = residyn.CoulombFriction("elbow"), residyn.StribeckFriction("elbow")
    costs = left * readings / bends, left * readings
    refits = [
        SimpleNamespace(
            effect=e,
            label=e.label,
            cost=c,
            numbers=n,
            possible=True,
            model=SimpleNamespace(effects=(e,)),
        )
        for e, c, n in zip(laws, costs, (1, 3), strict=True)
    ]
    step = SimpleNamespace(refits=refits, cost=100.0 * readings, readings=readings)
    assert ranked(step)[0].label == named


@pytest.mark.parametrize(
    ("drop", "freedom", "believed"),
    [
        (800.0, 1, False),  # as much as both, with one number
        (802.0, 5, True),  # as much, with more numbers than both have
        (770.0, 1, True),  # 30 less: what the second name explained
        (0.0, 0, True),
    ],
)
def test_one_law_of_no_name_may_be_likelier_than_two_names(drop, freedom, believed):
    arm = residyn.ConstantInertia(((2.9, 1.0), (1.0, 0.6)), ("shoulder", "elbow"))
    names = [
        e for x in ("quadratic_drag", "stribeck_friction") for e in effects_named(f"{x}:elbow", arm)
    ]
    law = Law("depends on the rate of the elbow", drop, freedom)
    first = SimpleNamespace(
        effects=(), cost=4800.0, readings=4000, unnamed=Unnamed(1e-9, "", 0.0, law)
    )

    def odds(*kept):
        model = residyn.Model(arm, kept)
        near = SimpleNamespace(fitted=[None])
        last = SimpleNamespace(
            effects=kept, cost=4000.0, readings=4000, near=near, fit=SimpleNamespace(model=model)
        )
        return weighing.one_law([first, last])

    assert (odds(*names) < 1.0) == believed
    first.refits = [SimpleNamespace(label=names[0].label, screened=SimpleNamespace(drop=800.0))]
    assert odds(names[0]) == 0.0  # so much that first order cannot be believed


@pytest.mark.parametrize(
    ("screened", "drop", "expected"),
    [
        (79.0, 80.0, 0.1 * math.exp(0.5)),  # the law does a little more
        (79.0, 60.0, 0.1 * math.exp(-9.5)),
        (70.0, 80.0, 0.0),  # first order was wrong about the name
    ],
)
def test_a_weak_law_has_those_of_no_catalogue_for_rivals(screened, drop, expected):
    arm = residyn.ConstantInertia(((2.9, 1.0), (1.0, 0.6)), ("shoulder", "elbow"))
    (name,) = effects_named("quadratic_drag:elbow", arm)
    law = Law("depends on the rate of the elbow", drop, 1)
    known = {"readings": 4000, "near": SimpleNamespace(fitted=[None])}
    refits = [SimpleNamespace(label=name.label, screened=SimpleNamespace(drop=screened))]
    first = SimpleNamespace(
        effects=(), cost=4080.0, unnamed=Unnamed(1e-9, "", 0.0, law), refits=refits, **known
    )
    fit = SimpleNamespace(model=residyn.Model(arm, (name,)))
    last = SimpleNamespace(effects=(name,), cost=4000.0, fit=fit, **known)
    assert weighing.one_law([first, last]) == pytest.approx(expected)

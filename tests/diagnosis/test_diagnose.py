"""`diagnose`: the right name, no name, and no name for what is in no catalogue. The truth is made
by MuJoCo (tests/rig), which shares no code with the package; what decides is held against closed
forms in test_evidence.py."""

import copy
import dataclasses
import itertools
import json
import math
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.stats import norm

import residyn
from residyn import effects
from residyn.diagnosis.candidate_tests import Rival
from residyn.diagnosis.channels import reassigned
from residyn.diagnosis.diagnose import Posterior
from residyn.diagnosis.evidence import (
    EXPLAINS_NOTHING,
    IN_PLAY,
    INTENSITIES,
    laplace_about,
    non_normal_priors,
    over_intensities,
)
from residyn.diagnosis.iteration import settle
from residyn.diagnosis.linearised_fit import Hopeless, minimum
from residyn.diagnosis.missing_torque import missing_of, scene_of
from residyn.diagnosis.residuals import coloured
from residyn.diagnosis.search import Search
from residyn.diagnosis.simulated import simulated
from residyn.diagnosis.tried import Tried, tried_alone
from residyn.fitting.problem import Unknowns, reweighted
from residyn.physics.effect import JointEffect
from residyn.physics.parameter import ANGLE, TORQUE, Dimension, param
from residyn.recordings.tables import ArmTable, Bearing, InertiaTable
from residyn.reporting.numbers import percent
from tests import rig

ARM = rig.paper_twin(0.3)
TABLE = ArmTable((ARM.l1, ARM.l2), ARM.shoulder, ARM.elbow, ARM.coupling)
SECONDS, RATE, NOISE = 6.0, 80.0, 5e-4
COULOMB = ("coulomb_friction:elbow", {"torque": 0.05})
CUBIC = ("cubic_stiffness:shoulder", {"coefficient": 60.0})
DELAY = ("sensor_delay:elbow", {"delay": 0.02})
BURST = ("burst:elbow", {"torque": 0.2, "time": 3.0, "width": 0.3})


def release(*hidden, q0=(0.2, -0.15), seed=0):
    """A release of the arm with some effects hidden."""
    each = [rig.Hidden(label, values) for label, values in hidden]
    rng = np.random.default_rng(seed)
    return rig.record(rng, ARM, q0, each, seconds=SECONDS, rate=RATE, noise=NOISE)


def recording(time, angle, name="release", **given):
    return residyn.Recording.from_arrays(
        time, angle, name=name, noise=NOISE, theta2=ARM.theta2, **given
    )


def experiment(*recordings):
    return residyn.Experiment(TABLE, recordings)


def of(case, angle=None, name="release"):
    return recording(case.t, case.q if angle is None else angle, name)


def diagnosed(*hidden, **how):
    return residyn.diagnose(experiment(of(release(*hidden))), **how)


def parameter(found, name):
    value = found.fit.to_dict()["parameters"][name]
    return value["value"], value["std"]


def contract(found):
    """The JSON, but for the clock."""
    known = json.loads(json.dumps(found.to_dict()))
    known.pop("seconds")
    known["fit"].pop("seconds", None)
    return known


@pytest.fixture(scope="module")
def friction():
    return diagnosed(COULOMB)


@pytest.fixture(scope="module")
def clean():
    return diagnosed()


@pytest.fixture(scope="module")
def outside():
    """A push at the elbow that comes and goes, which is in no catalogue."""
    return release(BURST)


@pytest.fixture(scope="module")
def unexplained(outside):
    return residyn.diagnose(experiment(of(outside)), max_effects=1)


# -- one effect, none, two ------------------------------------------------------------------------


def test_dry_friction_is_named_at_its_joint_and_the_error_falls(friction):
    assert friction.verdict == "missing"
    assert friction.verdict_probability > 0.99
    assert friction.added == ("coulomb_friction:elbow",)
    first = friction.families[0]
    assert (first.name, first.place) == ("dry friction", "elbow")
    assert first.probability > 0.99
    value, std = parameter(friction, "coulomb_friction:elbow.torque")
    assert abs(value - 0.05) < 4 * std
    base, last = friction.ladder
    assert (base.added, last.added) == ((), friction.added)
    assert base.times_noise.max() > 3
    assert (last.times_noise < 1.1).all()
    assert last.held_out.held_out.ratio.max() < 1.3 < base.held_out.held_out.ratio.max()


@pytest.mark.parametrize(
    "hidden",
    [pytest.param((), marks=pytest.mark.slow), (DELAY,)],
    ids=["nothing", "a delay"],
)
def test_a_rest_that_was_estimated_is_a_number_of_the_base_model(hidden):
    """The estimate is off by half a milliradian and more, as large as the noise and white in no
    way; each recording's own, and no effect of the arm."""
    seen, off = [], []
    for i, (zero, q0) in enumerate([((0.013, -0.02), (0.2, -0.15)), ((0.04, 0.01), (-0.1, 0.2))]):
        case = release(*hidden, q0=q0, seed=50 + i)
        seen.append(recording(case.t, case.q + zero, f"release {i}", rest="estimate"))
        off.append(seen[i].angle[0] - case.q[0])
    found = residyn.diagnose(experiment(*seen))
    assert found.added == tuple(label for label, _ in hidden)
    assert found.verdict == ("missing" if hidden else "adequate")
    assert found.verdict_probability > 0.95
    for run, own in enumerate(("", " (release 1)")):
        for joint, name in enumerate(TABLE.joints):
            value, std = parameter(found, f"sensor_offset:{name}.offset{own}")
            assert abs(value - off[run][joint]) < 4 * std
            assert std < 1e-4


def test_the_next_experiment_is_for_two_explanations_that_cannot_be_told_apart(friction):
    assert friction.next_experiment is None  # two laws of one family at one place: one explanation
    known = [
        effects.CoulombFriction("elbow"),
        effects.StribeckFriction("elbow"),
        effects.CubicStiffness("elbow"),
    ]
    friction_, excess, cubic = (e.label for e in known)

    def rivals(nats, curve=-50.0):
        logs = {(friction_,): 0.0, (excess,): -1.0, (cubic,): nats, (): -10.0}
        tried = {
            frozenset(added): Tried(
                added, np.full(len(INTENSITIES), x), friction.search.best.best, 0
            )
            for added, x in logs.items()
        }
        base = tried[frozenset()]
        law = {"log_posterior": curve, "added": (), "matters": True, "weights": base.weights,
               "enough": base.enough}  # fmt: skip
        curves = [SimpleNamespace(**law)]
        search = SimpleNamespace(
            candidates=known, tried=tried, passed={}, curves=curves, reassigned=None,
            base=tried[frozenset()], scene=friction.search.scene,
        )  # fmt: skip
        models, p = Posterior(search).rivals()
        return [m.added for m in models], p

    models, p = rivals(-2.0)
    assert models == [(friction_,), (cubic,)]
    np.testing.assert_allclose(p[1] / p[0], np.exp(-2.0) / (1 + np.exp(-1.0)))
    assert rivals(-4.0)[0] == [(friction_,)]
    # Not where a law without a name leaves them next to nothing.
    assert rivals(-2.0, curve=2000.0)[0] == []


def test_a_model_fits_no_worse_than_one_that_it_contains(friction, monkeypatch):
    """Also where its descent begins with springs so stiff that no phase is right."""
    tried = next(t for t in friction.search.tried.values() if t.added == friction.added)
    lost = dataclasses.replace(tried.best, u=tried.best.u + 300.0 * (tried.best.u != 0))
    monkeypatch.setattr(type(tried), "starts", lambda tried, scene: (lost,))
    with jax.enable_x64(True):
        again = friction.fits.fitted(tried)
    assert again.model.labels == friction.fit.model.labels
    assert again.reduced_chi2 < 1.02 * friction.base.reduced_chi2


def test_of_one_printed_probability_the_better_evidence_is_first(friction, clean):
    for found in (friction, clean):
        rows = [(percent(c.probability), c.log_evidence) for c in found.candidates]
        each = [[x for _, x in own] for _, own in itertools.groupby(rows, lambda row: row[0])]
        assert any(len(own) > 3 for own in each)
        assert all(own == sorted(own, reverse=True) for own in each)


def test_law_and_place_share_the_probability_of_their_family(friction):
    by_name = {c.effect: c.probability for c in friction.candidates}
    assert friction.candidates[0].effect == "coulomb_friction:elbow"
    members = dict(friction.families[0].members)
    assert {"coulomb_friction:elbow", "stribeck_friction:elbow"} <= set(members)
    assert all(members[label] == by_name[label] for label in members)
    # Two laws of one family are next to never in one model: their shares add up.
    assert sum(members.values()) == pytest.approx(friction.families[0].probability, abs=1e-3)


def test_what_the_model_still_lacks_is_small_beside_the_spring(friction):
    for each in friction.random_torque:
        assert each.low <= each.rms <= each.high
        assert each.share_of_spring < 0.01
    left = friction.still_missing[0].torque.rms
    assert friction.missing[0].torque.rms[1] > 10 * left[1]
    assert left == pytest.approx([each.rms for each in friction.random_torque])


def test_where_no_random_torque_is_needed_its_band_still_has_an_end(friction, clean):
    """All up to a ten-thousandth of the spring's torque is one cell of the grid."""
    assert all(each.rms == 0 for each in friction.random_torque)
    for found in (friction, clean):
        assert all(each.low == 0 < each.high < 1e-3 for each in found.random_torque)
        assert "What may still be missing is no more than" in found.words[-1]


def test_the_right_effect_draws_the_curve_of_the_torque_that_is_missing():
    case = release((COULOMB[0], {"torque": 0.15}), q0=(0.25, -0.2))
    with jax.enable_x64(True):
        scene, base = scene_of(experiment(of(case)), ())
        search = Search(scene, base)
        search.extend(search.base, 1)
        model = search.tried[frozenset([COULOMB[0]])]
        (found,) = missing_of(scene, search.base, [(model, COULOMB[0])])
    (best,) = found.curves_at(1)
    ((value, unit),) = best.values.values()
    assert unit == "N m"
    assert value == pytest.approx(0.15, rel=0.1)
    assert best.share > 0.75  # the smoothed torque rounds friction's jumps
    assert not np.any(best.torque[:, 0])
    assert found.curves_at(0) == ()


def test_nothing_hidden_nothing_found(clean):
    assert clean.verdict == "adequate"
    assert clean.verdict_probability > 0.95
    assert clean.added == ()
    assert len(clean.ladder) == 1
    assert max(c.probability for c in clean.candidates) < 0.05


def test_what_is_in_no_catalogue_is_not_forced_into_a_name(unexplained):
    assert unexplained.verdict == "unexplained"
    assert unexplained.verdict_probability > 0.95
    assert max(c.probability for c in unexplained.candidates) < 0.9
    # Relative to the best model with names only, of which a single name is one.
    assert max(c.log_evidence for c in unexplained.candidates) < 1.0
    elbow = unexplained.random_torque[1]
    assert elbow.low > 0.02  # N m of 0.2


def test_a_disturbance_much_faster_than_the_arm_rings_is_found():
    """It moves the arm by no more than the noise, and no random torque is like it."""
    torque, frequency = 0.6, 7.3
    found = diagnosed(("periodic_disturbance:elbow", {"torque": torque, "frequency": frequency}))
    assert found.added == ("periodic_disturbance:elbow",)
    for name, truth in (("torque", torque), ("frequency", frequency)):
        value, std = parameter(found, f"periodic_disturbance:elbow.{name}")
        assert abs(value - truth) < 4 * std
    assert found.fit.reduced_chi2 < 1.2


def test_a_line_that_no_random_torque_shows_is_surely_missing():
    """A floor that shakes a mass at twice its mode: in each reading it is half a noise."""
    time = np.arange(0.0, 15.0, 0.01)

    def rate(t, x):
        pushed = 0.1 * np.sin(2 * np.pi * 7.3 * t + 0.3)
        return [x[1], (-800.0 * x[0] - 1.2 * x[1] - pushed) / 2.0]

    clean = solve_ivp(rate, (0.0, 15.0), [0.01, 0.0], t_eval=time, rtol=1e-9, atol=1e-12).y[0]
    noise = 5e-5 * np.random.default_rng(0).standard_normal(len(time))
    read = residyn.Recording.from_arrays(time, (clean + noise)[:, None])
    table = InertiaTable(("mass",), [[2.0]], ("m",))
    found = residyn.diagnose(residyn.Experiment(table, (read,)))
    assert found.verdict == "missing"
    assert found.added == ("periodic_disturbance:mass",)
    assert found.verdict_probability > 0.95
    frequency, std = parameter(found, "periodic_disturbance:mass.frequency")
    assert abs(frequency - 7.3) < 3 * std


def test_a_residual_that_is_not_white_is_told_from_noise():
    clean = release()
    hum = 8e-4 * np.sin(2 * np.pi * 33.0 * clean.t)[:, None] * [0, 1]
    fits = [residyn.fit(experiment(of(clean, clean.q + off)), starts=1) for off in (0.0, hum)]
    with jax.enable_x64(True):
        assert coloured(fits[0]) is None
        left = coloured(fits[1])
    assert left.joint == "elbow"
    assert left.frequency_hz == pytest.approx(33.0, abs=0.05)
    assert left.ratio == pytest.approx(np.hypot(1.0, 8e-4 / NOISE / 2**0.5), rel=0.1)


def test_a_late_sensor_is_no_torque():
    found = diagnosed(DELAY, max_effects=1)
    assert found.verdict == "missing"
    assert found.added == ("sensor_delay:elbow",)
    assert found.candidates[0].probability > 0.99
    value, std = parameter(found, "sensor_delay:elbow.delay")
    assert abs(value - 0.02) < 4 * std


def test_a_brake_that_slips_in_every_swing_is_told_from_a_smooth_loop():
    # Its corners need the motion's own slip, and the turning points between two readings.
    found = diagnosed(("brake_slip:elbow", {"stiffness": 15.0, "angle": 0.08}), max_effects=1)
    assert (found.verdict, found.added) == ("missing", ("brake_slip:elbow",))
    assert found.families[0].probability > 0.99
    value, std = parameter(found, "brake_slip:elbow.angle")
    assert abs(value - 0.08) < 4 * std


def test_a_brake_without_stiffness_does_not_stand_for_a_constant_torque():
    # To first order about none, one that slipped beforehand is a constant torque.
    case = release(("constant_torque:elbow", {"torque": 0.1}))
    with jax.enable_x64(True):
        scene, base = scene_of(experiment(of(case)), ())
        search = Search(scene, base)
        search.extend(search.base, 1)
    assert search.best.added == ("constant_torque:elbow",)


def test_a_hand_that_rings_at_its_own_frequency_is_found_at_it():
    # Its frequency lies between those of the grid, and rings in what the model leaves.
    hand = {"inertia": 0.02 * ARM.elbow, "frequency": 1.35, "damping_ratio": 0.01}
    case = release(("wrist_flexibility", hand))
    with jax.enable_x64(True):
        scene, base = scene_of(experiment(of(case)), ())
        search = Search(scene, base)
        search.extend(search.base, 1)
    assert search.best.added == ("wrist_flexibility",)
    found = search.best.best.numbers[-3:]
    np.testing.assert_allclose(found, list(hand.values()), rtol=0.05)


def test_a_model_whose_motion_runs_away_when_smoothed_again_has_the_one_it_was_iterated_to():
    case = release(COULOMB)
    with jax.enable_x64(True):
        scene, base = scene_of(experiment(of(case)), ())
        tried = Search(scene, base).base
        lost = SimpleNamespace(linearised=scene.linearised, smoothed=lambda *given: None)
        assert tried.over_torques(lost) == [(1.0, tried.best)]
        total = sum(weight for weight, _ in tried.over_torques(scene))
    assert total == pytest.approx(1.0)


def test_springs_alone_are_smoothed_to_the_motion_that_was_read():
    """About rest an arm is linear, without Coriolis torques; its evidence there says nothing."""
    arm = rig.Arm(
        l1=0.55, l2=0.35, shoulder=2.662, elbow=0.411, coupling=1.11,
        stiffness=(48.0, 9.5), damping=(0.35, 0.06),
    )  # fmt: skip
    hidden = [rig.Hidden("cubic_stiffness:elbow", {"coefficient": 25.0})]
    rng = np.random.default_rng(20)
    case = rig.record(rng, arm, (0.12, -0.35), hidden, seconds=15.0, noise=3e-4)
    scene, base = scene_of_case(case)
    with jax.enable_x64(True):
        path = tried_alone(scene, base).best.path[: len(case.t), :2]
    assert (np.sqrt(np.mean((path - case.truth) ** 2, axis=0)) < 2 * case.noise).all()


def of_rig(rng, label, strength=None):
    """A hidden case in noise of 1 % of the swings."""
    (case,) = rig.hidden_cases(rng, label, 1, strength=strength)
    noise = 0.01 * float(np.sqrt(np.mean(np.abs(case.motion[0]).max(axis=0) ** 2)))
    q = case.truth + noise / case.noise * (case.q - case.truth)
    return dataclasses.replace(case, q=q, noise=noise)


def strong_friction():
    """A friction of 6 % of the spring's torque at full swing."""
    rng = np.random.default_rng([5100, *b"coulomb_friction:shoulder"])
    strength = float(np.exp(rng.uniform(*np.log([0.01, 0.3]))))
    return of_rig(rng, "coulomb_friction:shoulder", strength)


def friction_that_is_higher_near_rest():
    """A friction that Coulomb's law leaves much of."""
    label = "stribeck_friction:shoulder"
    return of_rig(np.random.default_rng([7003, *label.encode(), 10_000]), label)


def slipping_brake():
    """A brake that slips in the first swings."""
    return release(("brake_slip:elbow", {"stiffness": 8.0, "angle": 0.1}))


def scene_of_case(case):
    """Springs and dampers beside the recording of a hidden case."""
    arm = case.arm
    table = ArmTable((arm.l1, arm.l2), arm.shoulder, arm.elbow, arm.coupling)
    seen = residyn.Recording.from_arrays(case.t, case.q, noise=case.noise, theta2=arm.theta2)
    return scene_of(residyn.Experiment(table, (seen,)), ())


@pytest.mark.parametrize(
    "made", [strong_friction, friction_that_is_higher_near_rest, slipping_brake]
)
def test_what_sticks_is_found_from_afar_as_from_its_own_numbers(made):
    case = made()
    arm, (hidden,) = case.arm, case.hidden
    assert case.motion is not None
    scene, base = scene_of_case(case)
    with jax.enable_x64(True):
        search = Search(scene, base)
        search.extend(search.base, 1)
        found = search.tried[frozenset([hidden.label])]
        start = found.best
        numbers = np.array([*arm.stiffness, *arm.damping, *hidden.values.values()])
        u, path = np.array(start.u), np.array(start.path)
        u[: len(numbers)] = start.prior.regressors(numbers)
        n = len(case.t)
        path[:n, :2], path[:n, 2:4] = case.motion
        true = scene.consistent(dataclasses.replace(start, u=u, path=path))
        ((evidences, _),) = settle(scene, [true], 1e-3)
    best = over_intensities(evidences)
    assert found.log_evidence > best - 1.0
    assert best > search.base.log_evidence + 100.0


@pytest.mark.parametrize(
    ("seed", "joint"),
    [
        (7091, "elbow"),  # about too small a strength, its angle would move beyond the swing
        (7092, "shoulder"),  # a larger angle and more damping look the same at first
    ],
)
def test_a_brake_in_series_with_the_whole_spring_is_told_from_hysteresis(seed, joint):
    label = f"brake_slip:{joint}"
    case = of_rig(np.random.default_rng([seed, *label.encode(), 10_000]), label)
    scene, base = scene_of_case(case)
    with jax.enable_x64(True):
        search = Search(scene, base)
        search.extend(search.base, 1)
    assert search.best.added == (label,)
    values = list(case.hidden[0].values.values())
    np.testing.assert_allclose(search.best.best.numbers[-2:], values, rtol=0.05)


def test_without_a_random_torque_the_filter_has_the_evidence_of_exact_simulation(friction):
    scene = friction.search.scene
    # Of a smooth model; of one that sticks, which the filter does a little late (nats).
    for labels, within in (((), 0.2), (friction.added, 5.0)):
        tried = friction.search.tried[frozenset(labels)]
        with jax.enable_x64(True):
            t, *_ = tried.starts(scene)
            found = scene.evidences(t, scene.linearised(t), [0.0] * 4)
            filtered = (
                found.log_evidence[0]
                + non_normal_priors(t.effects, t.prior, found.regressors, found.covariance)[0]
            )
            exact = simulated(scene, t, friction.fits.of(tried)).log_evidence
        assert exact == pytest.approx(filtered, abs=within)


@pytest.mark.parametrize(("behind", "simulated"), [(2.9, True), (20.0, False)])
def test_what_the_filter_cannot_tell_from_a_complete_model_is_simulated(clean, behind, simulated):
    """However much likelier a random torque is by the filter, whose evidence errs by nats."""
    search, label, asked = copy.copy(clean.search), "cubic_stiffness:elbow", []
    evidences = np.full(len(INTENSITIES), -100.0)
    evidences[-3:] = 0.0, -behind, -behind
    model = Tried((label,), evidences, dataclasses.replace(search.base.best), 0.0)
    search.exact = lambda model: asked.append(model.added)
    search.tried = {**search.tried, frozenset([label]): model}
    search.beside(search.base, label)
    assert model.complete < 0.5
    assert asked == [(label,)] * simulated


def test_slopes_too_steep_for_arithmetic_leave_no_evidence_of_exact_simulation(
    friction, monkeypatch
):
    """A Stribeck velocity that runs to nothing makes all readings answer to one jump."""

    def steep(problem, at, **rest):
        found = minimum(problem, at, **rest)
        return found._replace(square=1e34 * np.ones_like(found.square))

    monkeypatch.setattr("residyn.diagnosis.simulated.minimum", steep)
    tried = friction.search.tried[frozenset()]
    with jax.enable_x64(True):
        exact = simulated(friction.search.scene, tried.best, friction.fits.of(tried))
    assert exact is None


def test_a_descent_that_would_end_too_high_ends_early(friction):
    near = friction.fits.of(friction.search.base)
    off = Unknowns(1.01 * np.asarray(near.unknowns.numbers), np.asarray(near.unknowns.states))
    with jax.enable_x64(True):
        whole = minimum(near.problem, off)
        allowed = minimum(near.problem, off, enough=1.5 * whole.cost)
        with pytest.raises(Hopeless):
            minimum(near.problem, off, enough=0.5 * whole.cost)
    assert allowed.cost == whole.cost
    assert allowed.steps == whole.steps > 1


def test_a_descent_over_a_part_of_the_readings_predicts_all_of_them(friction):
    near = friction.fits.of(friction.search.base)
    dropped = [r.recording.time[:, None] > 0.3 * r.recording.time[-1] for r in near.fitted]
    late = [np.broadcast_to(d, r.used.shape) for d, r in zip(dropped, near.fitted, strict=True)]
    with jax.enable_x64(True):
        found = minimum(reweighted(near.problem, late), near.unknowns)
        whole = minimum(near.problem, found.at, most=0)
    assert found.steps > 0
    np.testing.assert_allclose(found.predicted, whole.predicted, rtol=1e-12, atol=1e-15)


def test_an_unknown_that_all_but_moves_no_reading_leaves_a_gram_matrix_positive(friction):
    near = friction.fits.of(friction.search.base)
    with jax.enable_x64(True):
        found = minimum(near.problem, near.unknowns, most=0)
    # All move the readings alike, one of them less than arithmetic holds all digits of.
    size = np.ones(found.square.shape[-1])
    size[1] = 2e-157
    square = np.broadcast_to(size[:, None] * size, found.square.shape)
    little = found._replace(square=square, slope=found.slope * size)
    factor = np.asarray(little.compressed()[1])
    assert np.isfinite(factor).all()


def test_numbers_of_a_model_in_play_are_those_of_its_exact_simulation():
    """Not of the filter, whose steps are long for a fast mode that is read twenty times a cycle."""
    arm = dataclasses.replace(ARM, stiffness=(30.0, 120.0), damping=(0.02, 0.02))
    rng = np.random.default_rng(5)
    case = rig.record(rng, arm, (0.2, -0.15), [], seconds=20.0, rate=50.0, noise=NOISE)
    found = residyn.diagnose(experiment(recording(case.t, case.q)), max_effects=0)
    with jax.enable_x64(True):
        rival = Rival.of(found.search.scene, found.search.base)
    each = zip(found.fit.numbers, np.asarray(rival.model.vector()), strict=True)
    assert max(abs(n.value - x) / n.std for n, x in each) < 0.5


def test_models_in_play_have_the_evidence_of_exact_simulation(clean, friction):
    with jax.enable_x64(True):
        for found in (clean, friction):
            search = found.search
            lowest = search.best.log_posterior + math.log(IN_PLAY)
            known = [t for t in search.tried.values() if t.log_posterior > lowest]
            assert search.best in known
            for t in (t for t in known if t.complete > 0.5):
                exact = simulated(search.scene, t.best, found.fits.of(t)).log_evidence
                assert t.evidences[-1] == pytest.approx(exact, abs=1e-6)


def test_friction_that_holds_the_arm_leaves_nothing():
    """In the filter the arm creeps where it is held, as if a torque were missing."""
    label = "bearing_friction"
    case = release((label, {"force": 0.3}))
    on = [Bearing("elbow", 1e-9, 1e-9), Bearing("wrist", 1e-9, 1e-9)]
    seen = recording(case.t[:240], case.q[:240])
    found = residyn.diagnose(residyn.Experiment(TABLE, (seen,), on), max_effects=1)
    assert (found.verdict, found.added) == ("missing", (label,))
    assert found.verdict_probability > 0.95
    value, std = parameter(found, f"{label}.force")
    assert abs(value - 0.3) < 4 * std


def test_two_effects_are_found_one_after_the_other():
    found = diagnosed(COULOMB, CUBIC, max_effects=2)
    assert found.verdict == "missing"
    assert set(found.added) == {COULOMB[0], CUBIC[0]}
    likely = {(f.name, f.place) for f in found.families if f.probability > 0.9}
    assert likely == {("dry friction", "elbow"), ("spring shape", "shoulder")}
    falling = [step.times_noise.max() for step in found.ladder]
    assert falling[0] > falling[-1]
    assert falling[-1] < 1.1


def test_a_joint_whose_springs_slacken_in_its_few_swings_lacks_friction_and_a_spring_shape():
    """A quarter of what pulls back is left: no reason to look for a wrong unit."""
    time = np.arange(0, 2, 0.01)

    def rates(_, x):
        q, v = x
        slack = 0.6 * np.sign(q) * max(abs(q) - 0.03, 0.0)
        return v, -(300 * (q - slack) + 3 * v + np.tanh(v / 2e-3)) / 0.8

    angle = solve_ivp(rates, (0, 2), (0.126, 0.0), t_eval=time, rtol=1e-8, max_step=2e-3).y[0]
    angle = 2e-3 * np.round((angle + 2e-4 * np.random.default_rng(1).standard_normal(200)) / 2e-3)
    seen = residyn.Recording.from_arrays(time, angle[:, None])
    table = InertiaTable(("axis",), ((0.8,),), ("rad",))
    with jax.enable_x64(True):
        search = Search(*scene_of(residyn.Experiment(table, (seen,)), ()))
        search.run(2)
        found = Posterior(search).families()
    assert search.best.intensity < EXPLAINS_NOTHING
    assert {f.name for f in found[:2]} == {"dry friction", "spring shape"}
    assert all(f.probability > 0.3 for f in found[:2])
    assert all(f.probability < 0.1 for f in found[2:])


def rubbing(seed, begin, resists, friction, torque, pace, step, every, count, noise, rest=0.0):
    """A search on a joint of 1 kg m^2 that rubs, by Moreau's time stepping: `count` readings,
    `every` so many steps. `torque` (N m, rms) and `pace` (rad/s) are a random torque's."""
    rng, angle = np.random.default_rng(seed), []
    q, v, push = begin, 0.0, 0.0
    for i in range(count * every):
        if i % every == 0:
            angle.append(q)
        push += torque * math.sqrt(2 * pace * step) * rng.standard_normal() - pace * step * push
        q += 0.5 * step * v
        free = v + step * (push - resists(q, v))
        v = math.copysign(max(abs(free) - friction * step, 0.0), free)
        q += 0.5 * step * v
    seen = rest + np.array(angle) + noise * rng.standard_normal(count)
    one = residyn.Recording.from_arrays(step * every * np.arange(count), seen[:, None])
    table = InertiaTable(("axis",), ((1.0,),), ("rad",))
    return Search(*scene_of(residyn.Experiment(table, (one,)), ()))


def test_an_effect_is_asked_beside_the_best_model_without_it(friction):
    """A third effect leaves all that two effects, or one of them, leave, and a hundredth of what
    springs and dampers leave: beside these alone it would be sure."""
    known = effects.CoulombFriction("elbow"), effects.CubicStiffness("elbow"), effects.AirDrag()
    labels = tuple(e.label for e in known)
    one, two, needed = labels[:1], labels[:2], {(): 0.1}  # each with one needs less

    def probability(*which):
        tried = {
            frozenset(x): dataclasses.replace(
                friction.search.base, added=x, best=friction.search.best.best,
                evidences=np.where(np.array(INTENSITIES) == needed.get(x, 1e-3), 0.0, -100.0),
                log_prior=0.0 if x == labels else -50.0,
            )
            for x in which
        }  # fmt: skip
        search = SimpleNamespace(
            candidates=known, tried=tried, passed={}, curves=[], reassigned=None,
            base=tried[frozenset()], scene=friction.search.scene,
        )  # fmt: skip
        return Posterior(search).of(labels[2:])

    asked = probability((), two, labels)
    assert asked == pytest.approx(probability((), one, two, labels))
    assert asked == pytest.approx(probability((), one, labels))
    assert asked < 0.5 < probability((), labels)


def test_models_in_play_are_tried_without_each_of_their_effects():
    """Whether a hardening spring beside friction and a random torque is at work, and friction
    beside the spring, shows beside the models without them."""
    with jax.enable_x64(True):
        search = rubbing(
            1, 0.2, lambda q, v: 100 * q + 80 * q**3 + 0.4 * v, friction=2.0, torque=0.06,
            pace=10.0, step=1e-3, every=10, count=340, noise=1e-4,
        )  # fmt: skip
        search.run(2)
    lowest = search.best.log_posterior + math.log(IN_PLAY)
    in_play = [m for m in search.tried.values() if m.log_posterior > lowest]
    assert max(len(m.added) for m in in_play) == 2
    for model in in_play:
        for label in model.added:
            assert frozenset(model.added) - {label} in search.tried, (model.added, label)


class Waves(JointEffect):
    """A torque that goes up and down with the angle."""

    name = "waves"
    height: float = param("height", TORQUE)
    period: float = param(
        "period", ANGLE, sign="positive", silent=None, default=0.1, grid=(0.3, 0.5, 0.8)
    )

    def joint_torque(self, motion):
        return self.height * jnp.sin(2 * math.pi * motion.q / self.period)


class WavesAndHard(Waves):
    """... on a spring that hardens."""

    name = "waves_and_hard"
    extends = "waves"
    cubic: float = param("hardening", residyn.parameter.CUBIC)

    def joint_torque(self, motion):
        return super().joint_torque(motion) + self.cubic * motion.q**3


def test_a_simpler_law_begins_with_the_shapes_of_the_law_that_it_is_part_of(monkeypatch):
    base = {name: effects.CATALOGUE[name] for name in ("spring", "damper")}
    monkeypatch.setattr(effects, "CATALOGUE", base)
    residyn.adopt(Waves)
    residyn.adopt(WavesAndHard)
    with jax.enable_x64(True):
        search = rubbing(
            1, 0.2, lambda q, v: 100 * q + 2 * np.sin(2 * math.pi * q / 0.08) + 0.4 * v,
            friction=0.0, torque=0.0, pace=10.0, step=1e-3, every=10, count=340, noise=1e-4,
        )  # fmt: skip
        search.beside(search.base, "waves_and_hard:axis")
        search.reduce()
    simpler = search.tried[frozenset({"waves:axis"})]
    assert simpler.best.numbers[-1] == pytest.approx(0.08, rel=0.01)


def test_a_model_that_sticks_has_its_evidence_along_the_motion_that_it_keeps():
    """A brake that holds throughout is a shifted zero, and its angle of slip is not seen; where it
    slips there is no shift."""
    with jax.enable_x64(True):
        search = rubbing(
            1, 1.0, lambda q, v: 8 * q + 0.024 * v, friction=0.08, torque=0.016, pace=2.5,
            step=2e-3, every=20, count=1000, noise=1e-3, rest=0.015,
        )  # fmt: skip
        model = search.beside(
            search.beside(search.base, "coulomb_friction:axis"), "brake_slip:axis"
        )
        t, linear = model.best, search.scene.linearised(model.best)
        logs, u, covariance = search.scene.evidences(t, linear, [model.intensity])
        (again,) = laplace_about(logs, u, covariance, t.u)
    assert again == pytest.approx(model.evidences.max(), abs=5.0)


def test_a_pendulum_in_air_lacks_gravity_and_drag_and_needs_no_spring():
    # At such angles the sine is a cubic spring but for 0.5 % of the torque.
    time, moment = np.arange(0, 31, 1 / 16), 1.5

    def rates(_, x):
        q, v = x
        return v, -(moment * np.sin(q) + 2e-3 * v + 3e-3 * v * abs(v)) / 0.06

    angle = solve_ivp(rates, (0, 31), (0.9, 0.0), t_eval=time, rtol=1e-10, atol=1e-12).y[0]
    angle = angle + 2e-3 * np.random.default_rng(1).standard_normal(len(time))
    seen = residyn.Recording.from_arrays(time, angle[:, None], noise=2e-3)
    found = residyn.diagnose(
        residyn.Experiment(InertiaTable(("axis",), ((0.06,),), ("rad",)), (seen,)), max_effects=2
    )
    assert found.verdict == "missing"
    assert set(found.added) == {"pendulum", "quadratic_drag:axis"}
    assert all(family.probability > 0.9 for family in found.families[:2])
    value, std = parameter(found, "pendulum.moment1")
    assert abs(value - moment) < 4 * std
    value, std = parameter(found, "quadratic_drag:axis.coefficient")
    assert abs(value - 3e-3) < 4 * std


def test_two_laws_of_damping_are_found_together_where_each_alone_leaves_as_much():
    # At the largest swing friction is 0.2 % of the spring's torque, drag 0.8 %, the damper 0.3 %: a
    # larger damper takes most of the other two up.
    inertia, stiffness, friction, drag, damping = 0.05, 1.94, 3e-3, 6e-4, 1e-3
    h, v, angle = 1 / 16_000, 0.0, [0.7]
    while len(angle) < 1000:  # at 40 Hz; dry friction exactly, once a step (Moreau 1988)
        q = angle[-1]
        for _ in range(400):
            q += 0.5 * h * v
            v -= h * (stiffness * q + damping * v + drag * abs(v) * v) / inertia
            v -= math.copysign(min(abs(v), h * friction / inertia), v)
            q += 0.5 * h * v
        angle.append(q)
    noisy = np.array(angle) + 5e-4 * np.random.default_rng(1).standard_normal(len(angle))
    seen = residyn.Recording.from_arrays(np.arange(1000) / 40, noisy[:, None])
    found = residyn.diagnose(
        residyn.Experiment(InertiaTable(("axis",), ((inertia,),), ("rad",)), (seen,))
    )
    assert found.verdict == "missing"
    assert set(found.added) == {"coulomb_friction:axis", "quadratic_drag:axis"}
    assert all(family.probability > 0.9 for family in found.families[:2])
    for name, truth in (
        ("damper:axis.damping", damping),
        ("coulomb_friction:axis.torque", friction),
        ("quadratic_drag:axis.coefficient", drag),
    ):
        value, std = parameter(found, name)
        assert abs(value - truth) < 4 * std


# -- recordings of other kinds --------------------------------------------------------------------


def test_lost_and_wild_readings_change_no_name():
    case, rng = release(CUBIC), np.random.default_rng(5)
    angle = case.q.copy()
    angle[rng.choice(len(angle), 40, replace=False), 0] = np.nan
    angle[200:204] = np.nan
    angle[[50, 120, 333], 1] += 60 * NOISE
    found = residyn.diagnose(experiment(of(case, angle)), max_effects=1)
    assert found.verdict == "missing"
    assert found.added == (CUBIC[0],)
    value, std = parameter(found, f"{CUBIC[0]}.coefficient")
    assert abs(value - 60.0) < 4 * std


def test_recordings_of_one_name_and_clock_have_their_own_outliers_and_starts():
    time = np.arange(401) / RATE
    q = np.array([0.1, -0.05])[:, None] * np.exp(-0.2 * time) * np.cos(8.0 * time)
    q = q + NOISE * np.random.default_rng(0).standard_normal(q.shape)
    q[0, [60, 200, 330]] += 0.1
    runs = [residyn.Recording.from_arrays(time, x, noise=NOISE) for x in q]
    table = InertiaTable(("cart",), ((1.0,),), ("m",))
    found = residyn.diagnose(residyn.Experiment(table, tuple(runs)), max_effects=0)
    assert [int(r.wild.sum()) for r in found.fit.recordings] == [3, 0]
    starts = [r.state[0] for r in found.fit.recordings]
    np.testing.assert_allclose(starts, [0.1, -0.05], atol=1e-3)


@pytest.mark.parametrize("ratio", [1.5, 2.4])
def test_a_motion_that_does_not_ring_lacks_nothing(ratio):
    """What accelerates is then a small difference of what spring and damper do."""
    mass, stiffness = 2.0, 80.0
    time = np.arange(500) / 100.0
    slow, fast = np.sqrt(stiffness / mass) * (ratio + np.array([-1, 1]) * np.sqrt(ratio**2 - 1))
    q = 0.05 * (fast * np.exp(-slow * time) - slow * np.exp(-fast * time)) / (fast - slow)
    q = q + 2e-4 * np.random.default_rng(21).standard_normal(len(time))
    seen = residyn.Recording.from_arrays(time, q[:, None], noise=2e-4)
    table = InertiaTable(("cart",), ((mass,),), ("m",))
    found = residyn.diagnose(residyn.Experiment(table, (seen,)))
    assert found.verdict == "adequate"
    assert found.added == ()
    damping, std = parameter(found, "damper:cart.damping")
    assert abs(damping - 2 * ratio * np.sqrt(stiffness * mass)) < 4 * std


def test_a_driven_arm_tells_its_friction():
    time = np.arange(round(SECONDS * RATE) + 1) / RATE
    pushed = lambda t: 0.4 * np.sin(4.0 * t)  # noqa: E731
    q, _ = rig.simulate(
        ARM, time, [0.1, 0.0], [0.0, 0.0], frictionloss=(0.0, 0.06),
        torque=lambda t, q, v: (0.0, pushed(t)),
    )  # fmt: skip
    q = q + NOISE * np.random.default_rng(0).standard_normal(q.shape)
    drive = np.stack([0 * time, pushed(time)], axis=1)
    found = residyn.diagnose(experiment(recording(time, q, drive=drive)), max_effects=1)
    assert found.verdict == "missing"
    assert (found.families[0].name, found.families[0].place) == ("dry friction", "elbow")


def test_readings_in_degrees_are_no_motion_of_this_arm(outside):
    """57 times the angle, at which the arm would whirl: there is nothing to search from. One second
    of it is followed in as many steps as six of the others."""
    time, angle = outside.t[:80], np.rad2deg(outside.q[:80])
    found = residyn.diagnose(
        experiment(recording(time, angle, stated=["q1", "q2"])), max_effects=1, starts=1
    )
    assert found.explains_nothing
    assert found.verdict == "unexplained"
    assert found.added == ()


@pytest.mark.parametrize(
    ("columns", "words", "hidden"),
    [
        ([[0, 1], [1, 0]], "the columns of shoulder and elbow are exchanged", ()),
        ([[1, 0], [0, -1]], "the sign of elbow's column is reversed", ()),
        ([[1, 0], [1, 1]], "elbow's column is its link's angle to the table", ()),
        ([[0, 1], [1, 0]], "the columns of shoulder and elbow are exchanged", (COULOMB,)),
    ],
    ids=["exchanged", "reversed", "to the table", "exchanged, and with friction"],
)
def test_columns_that_are_not_what_the_file_says_are_told_and_no_effect_is_named(
    columns, words, hidden
):
    case = release(*hidden)
    seen = recording(case.t[:240], case.q[:240] @ np.array(columns).T)
    found = residyn.diagnose(experiment(seen), max_effects=1)
    assert found.verdict == "unexplained"
    assert found.channels is not None
    assert found.channels.words.startswith(words)
    assert found.channels.probability > 0.99
    assert found.channels.complete is not bool(hidden)
    assert max((c.probability for c in found.candidates), default=0.0) < 0.01
    assert words in " ".join(found.words)


def test_columns_are_told_from_the_readings_that_there_are():
    """One column lost in every third row, with a far reading: exchanged, the evidence is that of
    the right columns; of sums, that the others are missing there says nothing."""
    case = release()
    q = np.array(case.q[:240])
    q[50, 0] += 0.1

    def told(columns):
        with jax.enable_x64(True):
            read = experiment(recording(case.t[:240], columns))
            scene, effects = scene_of(read, ())
            base = tried_alone(scene, effects)
            each = reassigned(read, (), scene, base, len(scene.catalogued))
        return base.log_evidence, {r.channels.words: r.tried.log_evidence for r in each}

    to_table = np.cumsum(q, axis=1)
    q[::3, 0] = to_table[::3, 0] = np.nan
    right, _ = told(q)
    _, each = told(q[:, ::-1])
    exchanged = "the columns of shoulder and elbow are exchanged"
    assert each[exchanged] == pytest.approx(right, abs=1.0)
    assert max(each, key=lambda words: each[words]) == exchanged
    base, each = told(to_table)
    likeliest = max(each, key=lambda words: each[words])
    assert likeliest.startswith("elbow's column is its link's angle to the table")
    assert each[likeliest] > base + 500
    q[::2, 0] = q[1::2, 1] = np.nan  # the joints in turn: no sum is left
    _, each = told(q[:, ::-1])
    assert max(each, key=lambda words: each[words]) == exchanged


def test_noise_alone_has_the_evidence_of_noise():
    """From the rates of such readings alone the base model comes to no motion: hundreds of
    thousands of nats less."""
    noise = 0.4
    time = np.arange(0, SECONDS, 1 / RATE)
    angle = noise * np.random.default_rng(0).standard_normal((len(time), 2))
    seen = residyn.Recording.from_arrays(time, angle, noise=noise, theta2=ARM.theta2)
    with jax.enable_x64(True):
        scene, base = scene_of(experiment(seen), ())
        found = tried_alone(scene, base).log_evidence
    alone = norm.logpdf(angle, scale=noise).sum()
    assert alone - 50.0 < found < alone + 5.0  # less what numbers and first states cost


def test_small_angles_in_degrees_are_told_from_large_ones_in_rad():
    case = release(q0=(0.03, -0.02))
    angle, noise = np.rad2deg(case.q), np.rad2deg(NOISE)
    seen = residyn.Recording.from_arrays(case.t, angle, noise=noise, theta2=ARM.theta2)
    found = residyn.diagnose(experiment(seen), max_effects=1)
    assert found.channels is not None
    assert found.channels.words == "angles are in degrees, not in rad"
    assert found.added == ()
    # The fit of what explains nothing is that of `fit`.
    alone = residyn.fit(experiment(seen))
    assert found.base.reduced_chi2 == pytest.approx(alone.reduced_chi2, rel=1e-3)


# -- what a user brings ---------------------------------------------------------------------------

TORQUE = Dimension("N m", "N", lambda s: s.inertia * s.frequency**2 * s.amplitude)


class Push(JointEffect):
    """One push, half way: a exp(-((t - 3 s) / 0.3 s)^2)."""

    name = "push"
    equation = "a exp(-((t - 3) / 0.3)^2)"
    height: float = param("its highest torque", TORQUE)

    def joint_torque(self, motion):
        import jax.numpy as jnp

        return self.height * jnp.exp(-(((motion.t - 3.0) / 0.3) ** 2))


def test_an_effect_of_the_user_is_found_where_it_has_no_other_name(outside, monkeypatch):
    monkeypatch.setattr(effects, "CATALOGUE", effects.CATALOGUE | {"push": Push})
    found = residyn.diagnose(experiment(of(outside)), max_effects=1)
    assert found.verdict == "missing"
    assert found.added == ("push:elbow",)
    assert found.candidates[0].probability > 0.99
    height, std = parameter(found, "push:elbow.height")
    assert abs(height - 0.2) < 4 * std


def test_an_effect_that_is_in_the_model_from_the_start_is_no_candidate():
    found = diagnosed(COULOMB, effects=["coulomb_friction:elbow"], max_effects=1)
    assert found.verdict == "adequate"
    assert "coulomb_friction:elbow" in found.base.model.labels
    others = {c.effect for c in found.candidates}
    assert "coulomb_friction:shoulder" in others
    assert "coulomb_friction:elbow" not in others


# -- stopped early, asked wrongly -----------------------------------------------------------------


def test_a_budget_ends_the_search_with_the_best_so_far():
    found = diagnosed(COULOMB, budget=1e-3)
    assert found.budget.stopped == "budget"
    assert found.added == ()
    assert found.ladder[0].times_noise.max() > 3
    assert found.budget.models == 1


@pytest.mark.parametrize(
    ("phase", "turn"), [("simulating", 1), ("screening", 2), ("looking for a law", 1)]
)
def test_ctrl_c_keeps_what_was_found(phase, turn):
    """Pressed before the first exact simulation, as the second round begins, and while laws without
    a name are sought. What is then in play is simulated exactly, all of it."""
    rounds = []

    def progress(words):
        if words.startswith(phase):
            rounds.append(words)
            if len(rounds) == turn:
                raise KeyboardInterrupt

    found = diagnosed(CUBIC, progress=progress)
    assert found.budget.stopped == "interrupted"
    assert found.added == (CUBIC[0],)
    assert found.fit.rmse.max() < 1.1 * NOISE
    assert found.search.best.simulated is not None


def test_a_fixed_number_of_effects_is_not_exceeded():
    """Two are hidden; that something is then left is unexplained, as with `outside` above."""
    with jax.enable_x64(True):
        scene, base = scene_of(experiment(of(release(COULOMB, CUBIC))), ())
        search = Search(scene, base)
        search.run(1)
    assert len(search.best.added) == 1


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"max_effects": -1}, "max_effects = -1"),
        ({"starts": 0}, "starts = 0"),
        ({"budget": 0.0}, "budget = 0.0"),
        ({"effects": ["coulomb_fricton"]}, "coulomb_friction"),
        ({"effects": ["coulomb_friction:knee"]}, "knee"),
    ],
)
def test_bad_arguments_are_refused_by_name(wrong, words):
    with pytest.raises(ValueError, match=words):
        residyn.diagnose(experiment(recording(np.arange(50) / 50, np.zeros((50, 2)))), **wrong)


# -- the same every time, and for machines --------------------------------------------------------


def test_the_same_recording_has_the_same_diagnosis(clean):
    assert contract(diagnosed()) == contract(clean)


def test_json_is_the_contract(friction):
    found = contract(friction)
    assert set(found) == {
        "verdict", "verdict_probability", "words", "added", "ladder", "candidates", "families",
        "lookalikes", "next_experiment", "missing_torque", "random_torque", "budget", "fit", "laws",
        "channels", "parameters", "coloured", "coloured_noise",
    }  # fmt: skip
    assert set(found["parameters"]) == set(found["fit"]["parameters"])
    assert found["ladder"][0]["model"] == list(friction.base.model.labels)
    for row in found["ladder"]:
        assert set(row) == {"model", "rmse", "check_rmse", "reduced_chi2", "log_evidence"}
    for row in found["candidates"]:
        assert set(row) == {"effect", "probability", "log_evidence", "parameters"}
        assert row["log_evidence"] <= 0
    for row in found["families"]:
        assert set(row) == {"name", "place", "probability", "members", "without_a_name"}
    assert set(found["random_torque"]) == set(found["missing_torque"]) == {"shoulder", "elbow"}
    for row in found["random_torque"].values():
        assert set(row) == {"rms", "low", "high", "unit", "share_of_spring"}
    assert set(found["budget"]) == {"models", "candidates", "stopped"}
    assert found["budget"]["candidates"] == len(found["candidates"])
    assert found["budget"]["stopped"] is None


def test_an_effect_that_is_given_has_the_evidence_of_one_that_is_found():
    """Hysteresis, by Bouc and Wen's law: without a strength nothing leads to its angle, so it joins
    springs and dampers as a candidate does."""
    time = np.arange(0, 4, 0.01)

    def rates(_, x):
        q, v, z = x
        torque = 300 * q + 0.4 * v + 0.6 * z
        return v, -torque / 1.5, (v - abs(v) * z) / 0.01

    angle = solve_ivp(rates, (0, 4), (0.03, 0, 0), t_eval=time, rtol=1e-9, max_step=5e-3).y[0]
    angle = angle + 2e-5 * np.random.default_rng(2).standard_normal(len(time))
    seen = residyn.Recording.from_arrays(time, angle[:, None], noise=2e-5)
    table = InertiaTable(("cart",), ((1.5,),), ("m",))
    rig = residyn.Experiment(table, (seen,))
    with jax.enable_x64(True):
        given = tried_alone(*scene_of(rig, ["hysteresis"]))
        search = Search(*scene_of(rig, ()))
        added = search.beside(search.base, "hysteresis:cart")
    assert given.log_evidence == pytest.approx(added.log_evidence, abs=1.0)


def a_joint_that_turns(torque, begin=0.2, **how):
    """A joint of 1 kg m^2 on a spring of 100 N m/rad, from SciPy, and a torque (q, v) besides."""
    time = np.arange(0, 15, 0.02)
    found = solve_ivp(
        lambda _, x: (x[1], -100 * x[0] - 0.4 * x[1] - torque(*x)), (0, 15), (begin, 0.0),
        t_eval=time, rtol=1e-12, atol=1e-14,
    ).y  # fmt: skip
    seen = residyn.Recording.from_arrays(time, found[int("reads" in how)], **how)
    return residyn.Experiment(InertiaTable(("axis",), ((1.0,),), ("rad",)), (seen,))


def test_a_recording_without_any_noise_is_diagnosed():
    with jax.enable_x64(True):
        found = residyn.diagnose(a_joint_that_turns(lambda q, v: 200 * q**3))
    assert found.added == ("cubic_stiffness:axis",)
    assert found.verdict == "missing"
    (cubic,) = (n for n in found.fit.numbers if n.name == "cubic_stiffness:axis.coefficient")
    assert cubic.value == pytest.approx(200, rel=1e-5)


def test_what_no_reading_could_show_is_not_named():
    """A constant torque moves a joint's rest, of which a sensor of its rate knows nothing."""
    noise = 0.01 * np.random.default_rng(0).standard_normal(750)
    one = a_joint_that_turns(lambda q, v: 0.5 * np.tanh(v / 1e-3), reads="rate")
    (seen,) = one.recordings
    seen = residyn.Recording.from_arrays(seen.time, seen.angle[:, 0] + noise, reads="rate")
    with jax.enable_x64(True):
        found = residyn.diagnose(dataclasses.replace(one, recordings=(seen,)))
    each = {c.effect: c.probability for c in found.candidates}
    assert each["coulomb_friction:axis"] + each["stribeck_friction:axis"] > 0.9
    assert each.get("constant_torque:axis", 0.0) == 0.0
    assert found.next_experiment is None or found.next_experiment.helps


@pytest.mark.parametrize(("drag", "begin"), [(0.01, 1.0), (0.1, 1.2)])
def test_two_effects_that_say_little_alone_are_found_together(drag, begin):
    """A pendulum in air: gravity without its drag, and drag without its gravity, leave a motion
    that Dahl's friction comes nearer to. And the models on the way are in the order of their
    evidence, however the search came there."""
    noise = 1e-3 * np.random.default_rng(0).standard_normal(750)
    one = a_joint_that_turns(lambda q, v: 40 * np.sin(q) + drag * v * abs(v), begin=begin)
    (seen,) = one.recordings
    seen = residyn.Recording.from_arrays(seen.time, seen.angle[:, 0] + noise)
    with jax.enable_x64(True):
        found = residyn.diagnose(dataclasses.replace(one, recordings=(seen,)))
    assert set(found.added) == {"pendulum", "quadratic_drag:axis"}
    alone = {c.effect: c.log_evidence for c in found.candidates}
    joined = [x for model in found.ladder for x in model.added]
    assert joined == sorted(found.added, key=lambda x: -alone[x])


def test_a_check_recording_that_runs_away_costs_its_prediction_alone():
    """A spring that softens, fitted to small swings, has no rest that large ones come back to."""
    table, runs = InertiaTable(("joint",), [[0.3]], ("rad",)), []
    for role, start, soft in (("fit", 0.2, 60.0), ("check", 0.9, 0.0)):
        time = np.arange(0.0, 6.0, 0.01)
        path = solve_ivp(
            lambda _, x, soft=soft: [x[1], (-9.4 * x[0] + soft * x[0] ** 3 - 0.05 * x[1]) / 0.3],
            (0.0, time[-1]), [start, 0.0], t_eval=time, rtol=1e-10, atol=1e-12,
        )  # fmt: skip
        angle = path.y[:1].T + 1e-4 * np.random.default_rng(0).standard_normal((len(time), 1))
        runs.append(residyn.Recording.from_arrays(time, angle, noise=1e-4, role=role, name=role))
    experiment = residyn.Experiment(table, tuple(runs))
    found = residyn.diagnose(experiment, effects=["cubic_stiffness:joint"], max_effects=0)
    value = found.parameters["cubic_stiffness:joint.coefficient"].value
    assert value == pytest.approx(-60.0, rel=0.05)
    assert found.models[-1].held_out is None
    assert str(found)  # it is said without

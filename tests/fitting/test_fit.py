"""The fit, end to end, on MuJoCo arms whose truth is known."""

import dataclasses
import math
from pathlib import Path

import jax
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import residyn
from residyn.fitting import initial_guess, lanes
from residyn.fitting.covariance import numbers_of, spread_of
from residyn.fitting.least_squares import Compressed, Polished, compressed
from residyn.fitting.linalg import Spread
from residyn.fitting.multistart import distinct
from residyn.fitting.problem import Unknowns, model_for, ready
from residyn.recordings.tables import ArmTable, Bearing, InertiaTable
from tests import by_hand

rig = pytest.importorskip("tests.rig")

DATA = Path(__file__).parents[3] / "shared" / "data"


def experiment(case, *, noise=None, **changes) -> residyn.Experiment:
    arm = case.arm
    table = ArmTable((arm.l1, arm.l2), arm.shoulder, arm.elbow, arm.coupling)
    settings = {"theta2": arm.theta2, "noise": noise} | changes
    return residyn.Experiment(table, (residyn.Recording.from_arrays(case.t, case.q, **settings),))


def clean_case(seed, **kwargs):
    """An arm whose joint dampings are both of ordinary size."""
    rng = np.random.default_rng(seed)
    for _ in range(50):
        case = next(rig.clean_cases(rng, 1, damping_ratio=(0.005, 0.05), **kwargs))
        if min(case.arm.damping) > 0.1 * max(case.arm.damping):
            return case
    raise AssertionError("no such arm")


@pytest.fixture(scope="module")
def case():
    return clean_case(3, noise=5e-4)


@pytest.fixture(scope="module")
def fit(case):
    return residyn.fit(experiment(case))


def relative_errors(fit, case):
    truth = np.array([*case.arm.stiffness, *case.arm.damping])
    return np.abs(np.array([n.value for n in fit.numbers[:4]]) / truth - 1)


def test_a_start_alone_takes_all_its_horizons_in_one_call(case, fit, monkeypatch):
    asked = []
    call = lanes.one_start

    def counted(problem, y, shares, size):
        asked.append(shares[shares > 0])
        return call(problem, y, shares, size)

    monkeypatch.setattr(lanes, "one_start", counted)
    alone = residyn.fit(experiment(case), starts=1)
    assert "1 of 1" not in str(alone)  # which would say nothing
    grown, *exact = asked
    assert len(grown) == 3
    assert (np.diff(grown) > 0).all()
    assert [list(shares) for shares in exact] == [[1.0], [1.0]]  # the integration's error
    assert (
        max(abs(a.value - b.value) / b.std for a, b in zip(alone.numbers, fit.numbers, strict=True))
        < 1e-3
    )


@pytest.mark.parametrize("seed", range(4))
def test_clean_arms_are_fitted_from_default_settings(seed):
    case = clean_case([5, seed], noise=5e-4)
    fit = residyn.fit(experiment(case))
    off = relative_errors(fit, case)
    assert off[:2].max() < 0.005
    assert off[2:].max() < 0.03
    assert 0.9 < fit.reduced_chi2 < 1.1
    assert fit.converged
    assert fit.agreeing_starts >= 4


def test_names_units_and_json_are_the_contract(fit):
    found = fit.to_dict()
    assert found["model"] == ["spring:shoulder", "spring:elbow", "damper:shoulder", "damper:elbow"]
    assert found["parameters"]["spring:elbow.stiffness"]["unit"] == "N m/rad"
    assert found["parameters"]["damper:elbow.damping"].keys() == {"value", "std", "unit"}
    keys = (
        "model parameters rmse noise ratio reduced_chi2 check_rmse recordings modes modes_of starts"
    )
    keys += " agreeing_starts integrator integration_error integration_error_checked objective"
    assert set(found) == {*keys.split(), "converged", "stands", "unphysical", "seconds", "warnings"}
    assert found["check_rmse"] is None
    assert set(found["rmse"]) == {"shoulder", "elbow"}
    assert found["modes"][0]["frequency_hz"] < found["modes"][1]["frequency_hz"]


def test_modes_match_the_rig_within_their_errors(fit, case):
    frequency, damping = case.arm.modes()
    for mode, f, z in zip(fit.modes, frequency, damping, strict=True):
        assert abs(mode.frequency_hz - f) < max(4 * mode.frequency_hz_std, 1e-3 * f)
        assert abs(mode.damping_ratio - z) < max(4 * mode.damping_ratio_std, 2e-3 * z + 1e-5)
        assert 0 < mode.frequency_hz_std < 0.01 * f


def test_report_reads_like_lmfits(fit):
    text = str(fit)
    for word in ("+/-", "start", "agree", "N m/rad", "Hz", "x noise", "converged"):
        assert word in text
    assert max(map(len, text.splitlines())) <= 80


def test_wild_readings_are_found_set_aside_and_counted(case):
    rng = np.random.default_rng(1)
    q = case.q.copy()
    rows = rng.choice(len(q), 12, replace=False)
    q[rows, rng.integers(0, 2, 12)] += rng.choice([-1, 1], 12) * rng.uniform(0.02, 2.0, 12)
    fit = residyn.fit(experiment(dataclasses.replace(case, q=q)))
    assert relative_errors(fit, case)[:2].max() < 0.005
    assert 0.9 < fit.reduced_chi2 < 1.1
    assert fit.recordings[0].wild.sum() == pytest.approx(12, abs=2)
    assert any("outlier" in w for w in fit.warnings)


def test_lost_and_uneven_samples(case):
    rng = np.random.default_rng(2)
    keep = np.sort(rng.choice(len(case.t), 1500, replace=False))
    q = case.q[keep].copy()
    q[rng.random(q.shape) < 0.1] = np.nan
    q[300:380, 1] = np.nan
    fit = residyn.fit(experiment(dataclasses.replace(case, t=case.t[keep], q=q)))
    assert relative_errors(fit, case)[:2].max() < 0.005
    assert 0.85 < fit.reduced_chi2 < 1.1


def test_several_recordings_share_their_numbers_and_check_ones_are_held_out(case):
    rng = np.random.default_rng(4)
    recordings = []
    for i, role in enumerate(("fit", "fit", "check", "check", "check")):
        arm = dataclasses.replace(case.arm, theta2=case.arm.theta2 + 0.4 * i)
        t = np.arange(800 + 150 * i) * 0.01
        q, _ = rig.simulate(arm, t, rig.random_release(rng))
        q = q + 5e-4 * rng.standard_normal(q.shape)
        recordings.append(
            residyn.Recording.from_arrays(
                t, q, theta2=arm.theta2, noise=5e-4, role=role, name=f"{i}.csv"
            )
        )
    base = experiment(case)
    fit = residyn.fit(residyn.Experiment(base.inertia, tuple(recordings)))
    assert relative_errors(fit, case)[:2].max() < 0.003
    assert [r.recording.name for r in fit.recordings] == [f"{i}.csv" for i in range(5)]
    alone = residyn.fit(residyn.Experiment(base.inertia, (recordings[0],)), starts=2)
    surer = [b.std / one.std for b, one in zip(fit.numbers, alone.numbers, strict=True)]
    assert max(surer) < 1
    assert min(surer) < 0.9
    # Held-out recordings come down to the noise, though their numbers were never fitted to them.
    np.testing.assert_allclose(fit.check_rmse, 5e-4, rtol=0.1)
    wrong = dataclasses.replace(recordings[2], angle=recordings[2].angle * 1.1)
    spoilt = residyn.Experiment(base.inertia, (*recordings[:2], wrong))
    other = residyn.fit(spoilt, starts=2)
    values = [[n.value for n in f.numbers] for f in (fit, other)]
    np.testing.assert_allclose(values[0], values[1], rtol=1e-5)


def test_a_short_recording_takes_no_wide_kernel_from_a_long_one(case):
    """Noise of 5e-3 rad at 500 Hz, which narrow kernels let through."""
    rng, noise, t = np.random.default_rng(1), 5e-3, np.arange(5000) / 500
    q, _ = rig.simulate(case.arm, t, np.array([0.1, -0.05]))
    q = q + noise * rng.standard_normal(q.shape)
    long = residyn.Recording.from_arrays(t, q, theta2=case.arm.theta2, noise=noise)
    part = slice(0, 150, 5)
    short = dataclasses.replace(long, time=t[part], angle=q[part], name="short")
    one = residyn.Experiment(experiment(case).inertia, (long, short))
    with jax.enable_x64(True):
        numbers, _ = initial_guess.first_guess(ready(one, one.fit_recordings, ()), 1)
    np.testing.assert_allclose(numbers[0, :2], case.arm.stiffness, rtol=0.05)


def held_out(case, lost=0, **more):
    """The case, read once more and held out, the elbow's first readings lost."""
    base, angle = experiment(case, noise=5e-4), case.q.copy()
    angle[:lost, 1] = np.nan
    check = residyn.Recording.from_arrays(
        case.t, angle, theta2=case.arm.theta2, noise=5e-4, role="check", name="check.csv", **more
    )
    return dataclasses.replace(base, recordings=(*base.recordings, check))


def test_a_held_out_recording_may_begin_with_lost_readings(case):
    fit = residyn.fit(held_out(case, lost=100), starts=1)
    np.testing.assert_allclose(fit.check_rmse, 5e-4, rtol=0.1)


def test_a_held_out_recording_that_could_not_be_is_named(case):
    with pytest.raises(residyn.FitError, match=r"^check\.csv \(held out\): no start led to"):
        residyn.fit(held_out(case, drive=np.full(case.q.shape, 1e15)), starts=1)


@pytest.mark.slow
def test_bearing_drag_is_fitted_though_all_check_recordings_are_bare():
    """What is not on a held-out recording's bearings need not be there to be named."""
    unloaded = pytest.importorskip("tests.rig.unloaded")
    wanted = [unloaded.Release(0.3), unloaded.Release(0.9, bearings=False)]
    cases = unloaded.releases(wanted, drag=0.3, seconds=8.0)
    table = rig.paper_twin(0.3)
    arm = ArmTable((table.l1, table.l2), table.shoulder, table.elbow, table.coupling)
    bearings = [Bearing(at, 1.9635, 0.00245437) for at in ("elbow", "wrist")]
    recordings = [
        residyn.Recording.from_arrays(c.t, c.q, theta2=c.arm.theta2, noise=1e-3, role=role,
                                      air_bearings=role == "fit")
        for c, role in zip(cases, ("fit", "check"), strict=True)
    ]  # fmt: skip
    fit = residyn.fit(
        residyn.Experiment(arm, tuple(recordings), bearings), effects=["bearing_drag"], starts=2
    )
    assert fit.check_rmse is not None
    assert np.isfinite(fit.check_rmse).all()


def test_starts_that_segments_confirm_are_counted_as_they_agree():
    """Where a law leaves something, and starts agree, segments end in the same place."""
    arm, drag = rig.paper_twin(0.3), rig.Hidden("quadratic_drag:elbow", {"coefficient": 0.5})
    made = rig.record(
        np.random.default_rng(1), arm, [0.2, 0.1], [drag], seconds=10.0, rate=100.0, noise=3e-4
    )
    wrong = residyn.fit(experiment(made), effects=["coulomb_friction:elbow"], starts=3)
    assert wrong.reduced_chi2 > 1.1
    assert wrong.agreeing_starts == 3


@pytest.mark.slow
def test_hidden_coulomb_friction_shows_and_then_fits():
    rng = np.random.default_rng([8, 1])
    case = next(rig.friction_cases(rng, 1, noise=2e-4, share=(0.03, 0.05)))
    joint = int(np.argmax(case.frictionloss))
    name = ("shoulder", "elbow")[joint]
    base = residyn.fit(experiment(case, noise=2e-4))
    assert base.reduced_chi2 > 4
    assert any("misses something" in w for w in base.warnings)
    right = residyn.fit(experiment(case, noise=2e-4), effects=[f"coulomb_friction:{name}"])
    assert 0.9 < right.reduced_chi2 < 1.15
    assert right.numbers[-1].name == f"coulomb_friction:{name}.torque"
    assert right.numbers[-1].value == pytest.approx(max(case.frictionloss), rel=0.01)


def test_driven_recording_of_a_cart_without_spring():
    rng = np.random.default_rng(6)
    t = np.arange(4000) * 0.002
    force = 30 * np.sin(3 * t) + 10 * np.sign(np.sin(7 * t))
    q, _ = rig.simulate(rig.Cart(4.0, 0.0, 6.0), t, [0.0], drive=force[:, None])
    recording = residyn.Recording.from_arrays(
        t, q + 1e-4 * rng.standard_normal(q.shape), drive=force[:, None], noise=1e-4
    )
    table = InertiaTable(("cart",), ((4.0,),), ("m",))
    fit = residyn.fit(residyn.Experiment(table, (recording,)))
    values = {n.name: n for n in fit.numbers}
    assert values["damper:cart.damping"].value == pytest.approx(6.0, rel=0.01)
    assert values["damper:cart.damping"].unit == "N s/m"
    assert abs(values["spring:cart.stiffness"].value) < 0.2
    assert fit.reduced_chi2 < 1.3


def test_asking_for_inertia_and_stiffness_at_once_is_told_why_not(case):
    effects = [f"inertia_error:{part}" for part in ("shoulder", "elbow", "coupling")]
    fit = residyn.fit(experiment(case), effects=effects)
    assert any("Eq. 9" in w for w in fit.warnings)
    assert not any(n.determined for n in fit.numbers)
    assert all(p["std"] is None for p in fit.to_dict()["parameters"].values())


def test_two_inertia_errors_can_be_found(case):
    wrong = ArmTable(
        (case.arm.l1, case.arm.l2),
        case.arm.shoulder,
        case.arm.elbow * 1.04,
        case.arm.coupling,
    )
    fit = residyn.fit(
        dataclasses.replace(experiment(case), inertia=wrong), effects=["inertia_error:elbow"]
    )
    share = fit.numbers[-1]
    assert share.determined
    assert share.value == pytest.approx(1 / 1.04 - 1, abs=4 * share.std + 1e-4)
    line = next(line for line in str(fit).splitlines() if line.startswith("    inertia "))
    assert float(line.split()[2]) == pytest.approx(case.arm.elbow, rel=0.01)


def test_a_joint_that_does_not_move_is_named():
    rng = np.random.default_rng(1)
    t = np.arange(1000) * 0.01
    q = np.stack([0.1 * np.exp(-0.1 * t) * np.cos(4 * t), 0 * t], axis=1)
    table = InertiaTable(("a", "b"), ((1.0, 0.0), (0.0, 1.0)), ("rad", "rad"))
    recording = residyn.Recording.from_arrays(t, q + 1e-3 * rng.standard_normal(q.shape))
    fit = residyn.fit(residyn.Experiment(table, (recording,)))
    moving = next(n for n in fit.numbers if n.name == "spring:a.stiffness")
    assert moving.value == pytest.approx(16, rel=0.01)
    assert any("b hardly moves" in w for w in fit.warnings)


def test_unknown_effects_joints_and_doubles_are_one_clear_line(case):
    made = experiment(case)
    for effects, words in (
        (["coulomb_fricton"], "did you mean"),
        (["coulomb_friction:wrist"], "shoulder, elbow"),
        (["spring"], "already"),
        (["gravity:elbow"], "whole mechanism"),
        ("gravity", r"must be a list, as \["),
        ([residyn.CoulombFriction], "give its name"),
    ):
        with pytest.raises(ValueError, match=words) as caught:
            residyn.fit(made, effects=effects)
        assert "\n" not in str(caught.value)
    for starts in (0, 2.5, "6"):
        with pytest.raises(ValueError, match="whole number, at least one"):
            residyn.fit(made, starts=starts)
    for other in ("x.toml", made.recordings[0]):
        taking = residyn.fit, residyn.diagnose, residyn.compare, residyn.plan, residyn.detectable
        for call in (*taking, residyn.unload, residyn.inertia, residyn.race):
            with pytest.raises(TypeError, match=r"is no experiment: residyn\.load reads one"):
                call(other)
        for call in (residyn.bootstrap, residyn.embed):
            with pytest.raises(TypeError, match=r"is no fit: residyn\.fit makes one"):
                call(other)
    with pytest.raises(TypeError, match="must be a list"):
        next(residyn.fit_many("x.toml"))
    with pytest.raises(TypeError, match="None is no experiment"):
        next(residyn.fit_many([None]))


def test_fitting_needs_no_setting_and_changes_none(case):
    assert not jax.config.jax_enable_x64
    fit = residyn.fit(experiment(case), starts=1)
    assert not jax.config.jax_enable_x64
    assert relative_errors(fit, case)[:2].max() < 0.005


def test_same_recording_same_fit(case, fit):
    again = residyn.fit(experiment(case))
    assert [n.value for n in again.numbers] == [n.value for n in fit.numbers]


@pytest.mark.parametrize("second", ["shorter", "slower arm"])
def test_a_fit_of_a_second_recording_compiles_nothing(case, second, monkeypatch):
    first = residyn.fit(experiment(case), starts=np.int64(3))
    if second == "shorter":
        other = dataclasses.replace(case, t=case.t[:1500], q=case.q[:1500] + 1e-5)
    else:  # the same readings, taken three times as slowly
        other = dataclasses.replace(case, t=3.0 * case.t)
    compiled = []
    original = jax._src.compiler.compile_or_get_cached

    def counting(*args, **kwargs):
        compiled.append(args[1])
        return original(*args, **kwargs)

    monkeypatch.setattr(jax._src.compiler, "compile_or_get_cached", counting)
    again = residyn.fit(experiment(other), starts=3)
    names = [str(module.operation.attributes["sym_name"]) for module in compiled]
    assert not any(own in name for name in names for own in ("one_start", "solve", "matri")), names
    if second == "slower arm":
        assert again.modes[0].frequency_hz == pytest.approx(
            first.modes[0].frequency_hz / 3, rel=1e-3
        )


def test_an_arm_that_rests_elsewhere_is_fitted_from_its_own_stiffness():
    """Springs that hold it away from zero look soft, or negative, if its rest is taken for zero.
    The fit then damps the elbow without bounds, and integration steps follow only so far."""
    arm, push = rig.paper_twin(0.3), rig.Hidden("constant_torque:elbow", {"torque": 8.0})
    made = rig.record(
        np.random.default_rng(1), arm, [0.15, 0.1], [push], seconds=8.0, rate=50.0, noise=8e-3
    )
    assert abs(made.truth[:, 1].mean()) > 0.05
    found = residyn.fit(experiment(made), starts=1)
    starts = np.array([n.start for n in found.numbers[:2]])
    np.testing.assert_allclose(starts, arm.stiffness, rtol=0.2)
    assert found.shortened is not None
    assert found.integration_steps < 64 * found.shortened[0]


@pytest.mark.parametrize("seed", range(3))
def test_a_gap_far_smaller_than_the_swing_is_found(seed):
    """All that readings tell at first is stiffness times gap: a hyperbola in the plane of both."""

    def rates(t, y, k=76.5, gap=1.38e-3):
        return y[1], -(k * np.sign(y[0]) * max(abs(y[0]) - gap, 0.0) + 0.37 * y[1]) / 1.5

    time, rng = np.arange(0.0, 18.0, 0.02), np.random.default_rng(seed)
    how = {"t_eval": time, "rtol": 1e-9, "atol": 1e-12, "max_step": 2e-3}
    motion = solve_ivp(rates, (0.0, 18.0), (0.09, 0.0), **how).y[0]
    angle = motion + 5e-5 * rng.standard_normal(len(time))
    cart = InertiaTable(("cart",), ((1.5,),), ("m",))
    recording = residyn.Recording.from_arrays(time, angle[:, None], noise=5e-5)
    fit = residyn.fit(residyn.Experiment(cart, (recording,)), effects=["dead_zone"], starts=1)
    assert fit.converged
    truth = {"spring:cart.stiffness": 76.5, "dead_zone:cart.stiffness": 76.5}
    truth |= {"damper:cart.damping": 0.37, "dead_zone:cart.gap": 1.38e-3}
    for n in fit.numbers:
        assert abs(n.value - truth[n.name]) < 3 * n.std, n.name


def test_starts_that_meet_go_on_as_one():
    """... those far behind do not, and those elsewhere do."""

    def end(number, cost):
        at = Unknowns(np.array([number]), np.zeros((1, 1)))
        seen = Compressed(np.zeros(0), np.diag([10.0, 1.0])[None], np.zeros((1, 2)), np.zeros(1))
        return Polished(at, seen, cost, 3, True)

    found = distinct(
        [end(1.2, 9.0), end(1.0, 8.0), end(1.04, 8.5), end(1.01, 900.0), end(5.0, 300.0)]
    )
    assert [(float(e.unknowns.numbers[0]), e.agreeing) for e in found] == [(1.0, 3), (1.2, 1)]


def test_many_recordings_in_one_fit():
    """More recordings than the start looks at, each with a state of its own: all are weighed."""
    rng = np.random.default_rng(7)
    arm, t, noise = rig.paper_twin(0.3), np.arange(300) * 0.01, 1e-3
    truth, recordings = rig.simulate(arm, t, np.array([0.2, -0.1]))[0], []
    for _ in range(70):
        q = truth + noise * rng.standard_normal(truth.shape)
        recordings.append(residyn.Recording.from_arrays(t, q, theta2=arm.theta2, noise=noise))
    table = ArmTable((arm.l1, arm.l2), arm.shoulder, arm.elbow, arm.coupling)
    few = residyn.fit(residyn.Experiment(table, tuple(recordings[:7])), starts=1)
    fit = residyn.fit(residyn.Experiment(table, tuple(recordings)), starts=1)
    assert fit.converged
    assert 0.95 < fit.reduced_chi2 < 1.05
    for number, other, true in zip(
        fit.numbers, few.numbers, [*arm.stiffness, *arm.damping], strict=True
    ):
        assert abs(number.value - true) < 4 * number.std
        # Ten times the readings, a third of the error.
        assert number.std == pytest.approx(other.std / np.sqrt(10), rel=0.05)


@pytest.mark.parametrize("seed", [4, 5])
def test_a_start_stays_where_numbers_can_be(seed):
    """Gravity and springs pull alike in a small swing: noise must not drive them apart."""
    case = clean_case(seed, noise=5e-3)
    made = experiment(case, noise=5e-3)
    here = ready(made, made.fit_recordings, ["gravity"])
    with jax.enable_x64(True):
        numbers, _ = initial_guess.first_guess(here, 6)
        assert np.all(np.abs(numbers) < 50 * here.typical())


def test_first_cycles_that_lead_away_are_not_the_last_word():
    """A brake that slips in the first swing and holds then: the first cycles know no spring."""
    arm = rig.Arm(0.348, 0.354, 2.4517, 1.3187, 4.1587, -0.7143, (70.6, 236.4), (0.2756, 0.5289))
    hidden = [rig.Hidden("brake_slip:shoulder", {"stiffness": 70.6, "angle": 0.03795})]
    rng, q0 = np.random.default_rng(0), np.array([0.1542, -0.0791])
    case = rig.record(rng, arm, q0, hidden, seconds=20.0, rate=100.0, noise=3.06e-4)
    fit = residyn.fit(experiment(case, noise=3.06e-4))
    assert np.all(np.isfinite(fit.rmse))
    # Springs and dampers cannot explain it, but a joint at rest would leave as much as it moved.
    assert np.all(fit.rmse < np.sqrt(np.mean(case.q**2, axis=0)))


@pytest.mark.parametrize(
    ("arm", "q0", "label", "values", "noise"),
    [
        (
            rig.Arm(0.394, 0.36, 2.246, 0.4903, 2.0056, -1.8605, (261.8, 91.7), (0.526, 0.072)),
            (-0.1527, -0.2044),
            "periodic_disturbance:elbow",
            {"torque": 0.2425, "frequency": 0.7001, "phase": 5.1},
            0.01,
        ),
        (
            rig.Arm(0.5264, 0.5484, 1.3467, 0.5839, 1.4011, 1.6905, (28.55, 124.5), (0.548, 0.312)),
            (0.1029, -0.3126),
            "hysteresis:shoulder",
            {"torque": 0.0588, "angle": 0.03094},
            0.0116,
        ),
    ],
)
def test_a_slow_start_does_not_spoil_the_others(arm, q0, label, values, noise):
    """In 5 % noise the surest candidate may be one that has lost the fast mode. Integrated with its
    step, none of the others would get anywhere."""
    for seed in (4, 6, 12):
        rng = np.random.default_rng(seed)
        hidden = [rig.Hidden(label, values)]
        case = rig.record(rng, arm, np.array(q0), hidden, seconds=20.0, rate=100.0, noise=noise)
        fit = residyn.fit(experiment(case, noise=noise))
        assert fit.reduced_chi2 < 1.2
        for number, true in zip(fit.numbers, arm.stiffness, strict=False):
            assert number.value == pytest.approx(true, rel=0.1)


@pytest.mark.parametrize(
    ("arm", "q0", "label", "values", "noise"),
    [
        (
            rig.Arm(0.3524, 0.3151, 1.047, 0.2927, 0.8147, 1.588, (14.34, 17.26), (0.061, 0.0066)),
            (0.3457, -0.2988),
            "periodic_disturbance:shoulder",
            {"torque": 0.07306, "frequency": 0.42732, "phase": 3.62},
            0.01853,
        ),
        pytest.param(
            rig.Arm(0.551, 0.3057, 2.3245, 0.1093, 0.6297, 0.8752, (15.26, 11.04), (0.108, 0.0107)),
            (0.1537, 0.1195),
            "periodic_disturbance:elbow",
            {"torque": 0.09484, "frequency": 5.58063, "phase": 0.83655},
            1.449e-3,
            marks=pytest.mark.slow,
        ),
        (
            rig.Arm(0.323, 0.3992, 1.729, 2.115, 4.796, -1.4275, (71.27, 344.9), (1.4765, 0.3919)),
            (-0.11682, 0.25658),
            "brake_slip:shoulder",
            {"stiffness": 71.27, "angle": 0.02558},
            2.067e-3,
        ),
    ],
)
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_a_fit_by_name_begins_again_from_springs_and_dampers(arm, q0, label, values, noise, seed):
    """From the closed form all starts may end in local minima, or in motions that cannot be."""
    hidden, rng = [rig.Hidden(label, values)], np.random.default_rng(seed)
    case = rig.record(rng, arm, np.array(q0), hidden, seconds=20.0, rate=100.0, noise=noise)
    fit = residyn.fit(experiment(case, noise=noise), effects=[label])
    assert fit.reduced_chi2 < 1.1
    (strength,) = [n for n in fit.numbers if n.name in (f"{label}.{next(iter(values))}",)]
    assert strength.value == pytest.approx(next(iter(values.values())), abs=4 * strength.std)


@pytest.mark.slow
@pytest.mark.skipif(not (DATA / "carts").is_dir(), reason="measured data are not here")
def test_many_starts_are_no_worse_than_one_where_no_first_cycles_are_typical():
    """Three runs of a cart, with friction and hysteresis: their first cycles show no memory."""
    paths = sorted((DATA / "carts").glob("high_spring_loaded_*.csv"))
    runs = [residyn.recording.read_csv(path, 1)[:2] for path in paths]
    table = InertiaTable(("cart",), ((1.5545,),), ("m",))
    recordings = [residyn.Recording.from_arrays(t, x, start="release") for t, x in runs]
    made = residyn.Experiment(table, tuple(recordings))
    one, many = (
        residyn.fit(made, effects=["coulomb_friction", "hysteresis"], starts=n) for n in (1, 6)
    )
    assert many.rmse[0] < 1.05 * one.rmse[0]


def ready_for():
    made = experiment(clean_case(0))
    return ready(made, made.fit_recordings, [])


def test_of_candidates_that_are_alike_one_is_tried_first():
    k, c = np.array([16.0, 16.0]), np.array([0.1, 0.1])
    factors = [(1e-3, 1.0), (1.1e-3, 1.2), (1.0, 1.0), (1.1, 3.0), (9.0, 1.0)]
    rows = [np.append(f * k, g * c) for f, g in factors]
    with jax.enable_x64(True):
        assert initial_guess.various(ready_for(), np.array(rows)) == [0, 2, 4, 1, 3]
        assert initial_guess.various(ready_for(), np.zeros((0, 4))) == []


@pytest.mark.parametrize(
    ("factors", "sets"),
    [((1e-3, 1.0, 1.1, 1e-3), 1.1), ((1.0,), 1.0), ((1e-3, 1.0, 1.1, 0.9, 1e6), 1.1)],
)
def test_the_step_is_one_that_most_starts_can_live_with(factors, sets):
    """Too slow a mode spoils all others; a single absurd one costs time for nothing."""
    rows = np.array([[16.0 * f, 16.0 * f, 0.1, 0.1] for f in factors])
    with jax.enable_x64(True):
        assert np.asarray(initial_guess.resolving(ready_for(), rows).vector())[0] == 16.0 * sets


def test_a_base_that_no_arm_has_is_said_first():
    """A growing oscillation, and a spring that pushes: seen beyond their errors, and said first."""
    t = np.arange(400) / 50.0
    noise = 1e-3 * np.random.default_rng(0).standard_normal(len(t))
    table = InertiaTable(("cart",), ((2.0,),), ("m",))

    def fitted(q):
        recording = residyn.Recording.from_arrays(t, q + noise, noise=1e-3)
        return residyn.fit(residyn.Experiment(table, (recording,)))

    grows = fitted(0.02 * np.exp(0.2 * t) * np.cos(5 * t))
    assert [n.name for n in grows.unphysical] == ["damper:cart.damping"]
    assert grows.warnings[0].startswith("damper:cart.damping = -0.798 +/- ")
    assert "negative beyond its error" in grows.warnings[0]
    assert "grows: not physical" in str(grows)
    falls = fitted(0.1 * np.exp(-0.2 * t) * np.cos(5 * t))
    assert falls.unphysical == ()
    damper = next(n for n in grows.numbers if n.name == "damper:cart.damping")
    other = dataclasses.replace(damper, name="damper_of_mine:cart.damping")
    assert dataclasses.replace(grows, numbers=(other,)).unphysical == ()  # a user's own effect
    # Errors hold the size of the residual already.
    assert dataclasses.replace(grows, reduced_chi2=1e6).unphysical == grows.unphysical
    undamped = fitted(0.1 * np.cos(5 * t))  # its sign is chance
    assert undamped.unphysical == ()


def test_a_number_without_any_effect_is_not_determined():
    # One link carries no second one, whose weight would pull.
    t = np.arange(400) * 0.02
    noise = 1e-3 * np.random.default_rng(0).standard_normal(400)
    q = 0.3 * np.exp(-0.05 * t) * np.cos(5 * t) + noise
    table = InertiaTable(("link",), ((2.0,),), ("rad",))
    seen = residyn.Recording.from_arrays(t, q[:, None], noise=1e-3)
    fit = residyn.fit(residyn.Experiment(table, (seen,)), effects=["pendulum"])
    none = [i for i, n in enumerate(fit.numbers) if n.name == "pendulum.moment2"]
    assert fit.open_groups == (tuple(none),)
    assert [n.determined for n in fit.numbers] == [i not in none for i in range(4)]
    assert np.isnan(fit.covariance[none]).all()
    # It enters no equation: nothing is said of it.
    shown = str(fit), str(fit.model), fit.to_csv(), fit.to_latex(), str(fit.to_dict())
    assert all("moment2" not in text and "of link 2" not in text for text in shown)
    assert all("moment1" in text or "of link 1" in text for text in shown)


@pytest.mark.parametrize("seed", [5, 22])
def test_numbers_that_are_hardly_determined_settle_within_their_errors(seed):
    """Of a cart that creeps back with one time constant, stiffness and damping are known together
    only. They need not stand still to more digits than the data give."""
    time = np.arange(600) * 0.02
    noise = 1e-4 * np.random.default_rng(seed).standard_normal(len(time))
    made = residyn.Recording.from_arrays(time, 0.05 * np.exp(-3 * time) + noise, noise=1e-4)
    cart = InertiaTable(("cart",), ((1.0,),), ("m",))
    found = residyn.fit(residyn.Experiment(cart, (made,)))
    assert found.reduced_chi2 == pytest.approx(1, abs=0.2)
    assert found.converged
    assert "settle" not in " ".join(found.warnings)


def test_what_numbers_only_set_together_has_its_error():
    """In a small swing a spring and gravity are told by their sum only, which sets the mode; what
    little gravity alone does there, a frequency that rises as the swing dies away, is in the
    error."""
    t = np.arange(600) * 0.02
    noise = 1e-4 * np.random.default_rng(0).standard_normal(len(t))
    q = 0.02 * np.exp(-0.1 * t) * np.cos(5 * t) + noise
    table = InertiaTable(("disc",), ((0.05,),), ("rad",))
    seen = residyn.Experiment(table, (residyn.Recording.from_arrays(t, q[:, None], noise=1e-4),))
    spring, both = residyn.fit(seen), residyn.fit(seen, effects=["pendulum"])
    open_to = {n.name for n in both.numbers if n.acts and not n.determined}
    assert open_to == {"spring:disc.stiffness", "pendulum.moment1"}
    (known,), (found,) = spring.modes, both.modes
    true = np.sqrt(25.01) / (2 * np.pi)
    assert abs(found.frequency_hz - true) < 3 * found.frequency_hz_std < 1e-3 * true
    # The scatter over twelve such recordings is 3.2 times that of the spring alone.
    assert found.frequency_hz_std == pytest.approx(3.6 * known.frequency_hz_std, rel=0.1)
    assert found.damping_ratio_std == pytest.approx(known.damping_ratio_std, rel=0.01)
    assert both.to_dict()["modes"][0]["frequency_hz_std"] == found.frequency_hz_std


@pytest.mark.parametrize(
    ("blind", "groups", "said"),
    [
        (
            [[1, -1, 0, 0]],
            ((0, 1),),
            ["only a combination of {0}, {1}: changing them together leaves"],
        ),
        (
            [[1, 1, 1, 0]],
            ((0, 1, 2),),
            ["only 2 combinations of {0}, {1}, {2}: changing them together leaves"],
        ),
        # Two ways among the same numbers are said once, whichever two vectors span them.
        (
            [[1, 1, -1, -1], [1, -2, 2, -1]],
            ((0, 1, 2, 3),),
            [
                "only 2 combinations of {0}, {1}, {2}, {3}: changing them together in 2 "
                "independent ways leaves"
            ],
        ),
        # Two of different numbers are told apart, also where the vectors mix them.
        ([[0, 1, 0, 1], [0, 1, 0, -1]], ((1,), (3,)), ["{1} is not", "{3} is not"]),
    ],
)
def test_what_the_recordings_leave_open_is_said_once(blind, groups, said):
    fit, blind = by_hand.a_fit(), np.array(blind, float)
    blind = blind / np.linalg.norm(blind, axis=1, keepdims=True)
    spread = Spread(1e-6 * np.eye(4), blind, np.ones(4), np.ones(len(blind)))
    fit = dataclasses.replace(fit, spread=spread)
    assert fit.open_groups == groups
    told = [words for words in fit.warnings if "not determined" in words or "only" in words]
    names = [n.name for n in fit.numbers]
    assert len(told) == len(said)
    assert all(s.format(*names) in words for s, words in zip(said, told, strict=True))


@pytest.mark.parametrize(("torque", "unseen"), [(0.05, ()), (1e-4, ("stribeck_friction:elbow",))])
def test_strengths_that_are_told_by_their_sum_are_seen_by_it(torque, unseen):
    """Far below its velocity Stribeck's law is Coulomb's, of torque and excess together."""
    fit = by_hand.a_fit(("stribeck_friction:elbow",), chi2=1.0)
    names = [n.name.rpartition(".")[2] for n in fit.numbers]
    values = {"torque": torque, "excess": -0.3 * torque}
    numbers = [
        dataclasses.replace(n, value=values.get(x, n.value), std=np.inf, determined=False)
        if x in values
        else n
        for n, x in zip(fit.numbers, names, strict=True)
    ]
    blind = np.array([[{"torque": 1.0, "excess": -1.0}.get(x, 0.0) for x in names]])
    spread = Spread(1e-6 * np.eye(len(names)), blind / np.sqrt(2), np.ones(len(names)), np.ones(1))
    fit = dataclasses.replace(fit, numbers=tuple(numbers), spread=spread)
    assert fit.unseen == unseen
    both = dataclasses.replace(
        fit, spread=spread._replace(blind=np.eye(len(names)), variance=np.ones(len(names)))
    )
    assert both.unseen == ("stribeck_friction:elbow",)  # nothing of it is determined


def test_a_coupling_of_joints_in_m_and_rad_is_in_J_per_m_and_rad():
    """V = k q1 q2: a force on the cart in proportion to an angle, and the other way round."""
    pair = residyn.ConstantInertia([[2.0, 0.3], [0.3, 0.5]], ("cart", "pole"), ("m", "rad"))
    model = model_for(pair, ["coupling_stiffness", "coupling_damping"])
    size = len(model.fitted)
    spread = Spread(np.eye(size), np.eye(0, size), np.ones(size), np.zeros(0))
    numbers = numbers_of(model, np.zeros(size), spread)
    units = {n.name: n.unit for n in numbers}
    assert units["spring:cart.stiffness"] == "N/m"
    assert units["spring:pole.stiffness"] == "N m/rad"
    assert units["coupling_stiffness.stiffness"] == "N/rad"
    assert units["coupling_damping.damping"] == "N s/rad"
    for line in str(model).splitlines()[1:]:
        name, _, unit = line.split(maxsplit=2)
        assert unit == units[name]
    turning = dataclasses.replace(model, mechanism=dataclasses.replace(pair, units=("rad", "rad")))
    assert "coupling_stiffness.stiffness  0 N m/rad\n" in f"{turning}\n"


def rubbing(t, start, mass, stiffness, damping, friction):
    """Angles of one sprung mass with viscous and dry friction, in closed form: from each turning
    point half a damped cycle about a rest that friction shifts, until it holds."""
    decay, shift = damping / (2 * mass), friction / stiffness
    w = np.sqrt(stiffness / mass - decay**2)
    q, turn, since = np.full(len(t), start), start, 0.0
    while abs(turn) > shift:
        rest = np.sign(turn) * shift
        own = t >= since
        s = t[own] - since
        q[own] = rest + (turn - rest) * np.exp(-decay * s) * (
            np.cos(w * s) + decay / w * np.sin(w * s)
        )
        turn, since = rest - (turn - rest) * np.exp(-decay * np.pi / w), since + np.pi / w
        q[t >= since] = turn
    return q


@pytest.mark.parametrize("seed", range(4))
def test_how_often_a_joint_swings_before_it_sticks_is_found(seed):
    """A whole number: off by one is a minimum of its own."""
    truth = 0.8, 60.0, 0.12, 0.05
    t = np.arange(0.0, 15.0, 0.02)
    q = rubbing(t, 0.12, *truth) + 1e-3 * np.random.default_rng(seed).standard_normal(len(t))
    table = InertiaTable(("cart",), ((truth[0],),), ("m",))
    seen = residyn.Recording.from_arrays(t, q[:, None])
    effects = ["coulomb_friction:cart", "quadratic_drag:cart"]
    fit = residyn.fit(residyn.Experiment(table, (seen,)), effects=effects)
    assert fit.reduced_chi2 < 1.1
    for number, value in zip(fit.numbers, (*truth[1:], 0.0), strict=True):
        assert abs(number.value - value) < 4 * number.std, number.name


def test_what_acts_with_a_strength_that_is_not_told_is_not_called_unseen():
    """A brake that never slips holds the joint aside, with any share of its spring: where it rests
    says that there is one, and no more."""
    time, noise = np.arange(0, 6, 0.02), 1e-3
    ringing = 0.01 + 0.2 * np.exp(-0.05 * time) * np.cos(5.0 * time)
    ringing += np.random.default_rng(0).normal(0, noise, len(time))
    run = residyn.Recording.from_arrays(time, ringing, noise=noise)
    table = InertiaTable(("cart",), ((2.0,),), ("m",))
    said = residyn.fit(residyn.Experiment(table, (run,)), effects=["brake_slip"], starts=1).warnings
    assert not any("brake_slip:cart is not seen" in words for words in said)
    assert any(
        "without brake_slip:cart more is left than chance explains" in words for words in said
    )


def test_a_disturbance_much_faster_than_the_arm_rings_is_fitted():
    """All starts agree on a minimum in which it does nothing. The truth in closed form: a free
    vibration and a forced one."""
    inertia, stiffness, damping, torque, frequency = 0.3, 12.0, 0.06, 3.7, 8.0
    time, pace = np.arange(0.0, 10.0, 0.01), 2 * np.pi * frequency
    decay = damping / (2 * inertia)
    ringing = np.sqrt(stiffness / inertia - decay**2)
    forced = torque / (stiffness - inertia * pace**2 + 1j * damping * pace)
    angle = 0.25 * np.exp(-decay * time) * np.cos(ringing * time)
    angle = angle + np.imag(forced * np.exp(1j * pace * time))
    angle = angle + 5e-4 * np.random.default_rng(3).standard_normal(len(time))
    seen = residyn.Recording.from_arrays(time, angle[:, None], noise=5e-4)
    table = InertiaTable(("joint",), ((inertia,),), ("rad",))
    found = residyn.fit(residyn.Experiment(table, (seen,)), effects=["periodic_disturbance"])
    assert found.reduced_chi2 < 1.1
    values = {n.name: n for n in found.numbers}
    for name, truth in (("torque", torque), ("frequency", frequency)):
        number = values[f"periodic_disturbance:joint.{name}"]
        assert abs(abs(number.value) - truth) < 4 * number.std


@pytest.mark.parametrize("seed", range(3))
def test_standard_errors_are_those_of_the_model_and_not_of_its_steps(seed):
    """Of a weak hysteresis strength, angle and sharpness are known along a ridge; slopes that are
    wrong by per cents would tell where on it. The motion is SciPy's, of Bouc and Wen's equations.
    """
    torque, angle, sharpness, sigma = 0.02, 0.05, 1.0, 2e-4

    def rates(_, x):
        q, v, z = x
        loaded = abs(z) ** sharpness if v * z > 0 else 0.0
        return v, -9.0 * q - 0.03 * v - torque * z, v / angle * (1.0 - loaded)

    t = np.linspace(0.0, 20.0, 2001)
    begin = 0.3, 0.0, 1.0 - math.exp(-0.3 / angle)
    how = {"rtol": 1e-9, "atol": 1e-12, "max_step": 0.01}
    q = solve_ivp(rates, (0.0, 20.0), begin, t_eval=t, **how).y[0]
    q = q + sigma * np.random.default_rng(seed).standard_normal(len(t))
    recording = residyn.Recording.from_arrays(t, q, noise=sigma)
    mechanism = residyn.ConstantInertia([[1.0]], ["joint"], ["rad"])
    found = residyn.fit(residyn.Experiment(mechanism, (recording,)), effects=["hysteresis"])
    finer = found.ready._replace(finer=16 * found.ready.finer)
    with jax.enable_x64(True):
        problem, _ = finer.problem(found.model, [r.wild for r in found.fitted])
        states = np.stack([r.state for r in found.fitted])
        there = compressed(problem, problem.scaled(found.model.vector(), states))
    sizes, chi2 = np.asarray(problem.scale.numbers), max(1.0, found.reduced_chi2)
    exact = spread_of(np.asarray(there.factor), sizes, chi2).std
    np.testing.assert_allclose([n.std for n in found.numbers], exact, rtol=0.15)

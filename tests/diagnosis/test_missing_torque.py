"""The missing torque beside a known one, on MuJoCo data; and the curves that belong over it."""

import jax
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import residyn
from residyn.diagnosis import missing_torque
from residyn.diagnosis.evidence import prior_of
from residyn.diagnosis.missing_torque import restoring_torque
from residyn.filtering.trajectory import Scene
from tests import rig

ARM = rig.paper_twin(0.3)
NOISE = 3e-4


pytestmark = pytest.mark.usefixtures("compiled_in_less_time")


def base(**change):
    """The arm's true springs and dampers, some of them changed."""
    arm = residyn.PlanarArm(
        [ARM.l1, ARM.l2], ARM.shoulder, ARM.elbow, ARM.coupling, ARM.theta2, [1, 1]
    )
    model = residyn.Model(arm)
    for joint, k, c in zip(arm.joints, ARM.stiffness, ARM.damping, strict=True):
        k = k * change.get(joint, 1.0)
        model = model + residyn.Spring(joint, k) + residyn.Damper(joint, c)
    return model


FRICTION = rig.Hidden("coulomb_friction:elbow", {"torque": 0.15})


def recorded(*hidden, seconds=10.0, rate=100.0):
    """A release with some effects hidden."""
    rng = np.random.default_rng(0)
    return rig.record(rng, ARM, [0.25, -0.2], hidden, seconds=seconds, rate=rate, noise=NOISE)


def as_recording(case, keep=slice(None), angle=None):
    angle = case.q if angle is None else angle
    return residyn.Recording.from_arrays(case.t[keep], angle[keep], noise=NOISE, theta2=ARM.theta2)


@pytest.fixture(scope="module")
def friction():
    return recorded(FRICTION)


@pytest.fixture(scope="module")
def found(friction):
    """What springs and dampers alone lack."""
    return missing_torque(base(), as_recording(friction))


def agreement(found, case, joint):
    """Correlation with the truth, and the share of instants at which the 95 % band holds it, of
    what no spring and damper can say.

    The model's numbers are estimated beside the torque, and its dampers take what goes with the
    rate: of dry friction under a swing that does not decay, 8 / pi^2 of the power. So parts in
    proportion to angles and rates are taken off both. The instants are those of the filter's own
    grid.
    """
    inside = slice(6, -6)
    true = np.interp(found.time, case.t, case.torque[:, joint])[inside]
    tau, std = found.torque[inside, joint], found.std[inside, joint]
    linear = np.concatenate([found.angle, found.rate], axis=1)[inside]
    true, tau = (x - linear @ np.linalg.lstsq(linear, x, rcond=None)[0] for x in (true, tau))
    return np.corrcoef(tau, true)[0, 1], np.mean(np.abs(tau - true) <= 1.96 * std)


def test_it_finds_a_step_of_friction_at_its_joint(friction, found):
    correlation, held = agreement(found, friction, 1)
    # A step is smoothed over the random torque's correlation time, a radian of the ringing.
    assert correlation > 0.9
    assert held > 0.95
    # The shoulder lacks nothing, and its band says so.
    assert np.mean(np.abs(found.torque[:, 0]) <= 1.96 * found.std[:, 0]) > 0.95


def test_its_share_is_of_all_that_pulls_the_joint_back():
    """Of gravity beside a spring; of the spring alone it would be four times as large."""
    stiffness, moment, t = 0.5, 1.5, np.arange(0.0, 10.0, 0.02)

    def rates(_, x):
        missing = 0.02 * x[1] * abs(x[1])
        return x[1], -(stiffness * x[0] + moment * np.sin(x[0]) + 0.01 * x[1] + missing) / 0.1

    q = solve_ivp(rates, (0, 10), (0.8, 0.0), t_eval=t, rtol=1e-10, atol=1e-12).y[0]
    q = q + NOISE * np.random.default_rng(0).standard_normal(len(t))
    model = residyn.Model(residyn.ConstantInertia([[0.1]], ["axis"], ["rad"]))
    for effect in (residyn.Spring("axis", stiffness), residyn.Damper("axis", 0.01)):
        model = model + effect
    model = model + residyn.Pendulum(moment, 0.0)
    found = missing_torque(model, residyn.Recording.from_arrays(t, q[:, None], noise=NOISE))
    own = stiffness * found.angle[:, 0] + moment * np.sin(found.angle[:, 0])
    whole = found.rms[0] / found.share_of_spring[0]
    assert whole == pytest.approx(np.sqrt(np.mean(own**2)), rel=0.02)


def test_what_moves_joints_without_springs_is_what_the_motors_leave_over_friction():
    """Z q'' of two coupled slides in two recordings, of which one carries a load."""
    t = np.arange(0.0, 2.0, 0.02)
    force = 3.0 * np.stack([np.sin(3 * t), np.cos(5 * t)], axis=1)
    place = np.stack([0.2 * np.sin(2 * t), 0.1 * np.cos(4 * t)], axis=1)
    runs = [residyn.Recording.from_arrays(t, place, noise=NOISE, drive=force) for _ in range(2)]
    slides = [
        residyn.ConstantInertia([[2.0, 0.7], [0.7, 1.5 + load]], ["a", "b"], ["m", "m"])
        for load in (0.0, 4.0)
    ]
    dampers = [residyn.Damper(joint) for joint in "ab"]
    with jax.enable_x64(True):
        scene = Scene(runs, slides, [np.zeros(place.shape, bool)] * 2)
        begun = scene.start(dampers, prior_of(scene, dampers))
        begun.u[:2] = begun.prior.regressors(np.array([0.4, 0.9]))
        found = restoring_torque(scene, begun)
    expected = scene.grid.drive[:, 0] - begun.path[:, 2:4] * [0.4, 0.9]
    np.testing.assert_allclose(found[scene.real], expected[scene.real], atol=1e-9)


def test_a_clean_arm_lacks_next_to_nothing():
    case = recorded()
    found = missing_torque(base(), as_recording(case))
    assert np.all(found.share_of_spring < 1e-3)


def test_lost_uneven_and_wild_samples_do_not_spoil_it(friction):
    rng = np.random.default_rng(1)
    keep = np.sort(rng.choice(len(friction.t), 850, replace=False))
    angle = friction.q.copy()
    angle[rng.choice(len(angle), 40, replace=False), 0] = np.nan
    angle[400:404] = np.nan
    wild = rng.choice(np.arange(20, 980), 5, replace=False)
    angle[wild, 1] += 40 * NOISE * rng.choice([-1.0, 1.0], 5)
    spoilt = as_recording(friction, keep, angle)
    bad = residyn.recording.wild_samples(spoilt.time, spoilt.angle, NOISE)
    seen = missing_torque(base(), spoilt, wild=bad)
    correlation, held = agreement(seen, friction, 1)
    assert correlation > 0.9
    assert held > 0.95


def test_springs_and_dampers_are_not_bent_to_stand_in_for_it(friction, found):
    """The model's numbers are estimated beside the torque: it does not matter where they start."""
    bent = missing_torque(base(elbow=0.97), as_recording(friction))
    np.testing.assert_allclose(bent.torque, found.torque, atol=0.05 * found.rms.max())


def test_the_model_that_has_the_effect_lacks_nothing(friction, found):
    model = base() + residyn.CoulombFriction("elbow", 0.15)
    left = missing_torque(model, as_recording(friction))
    assert left.rms[1] < 0.3 * found.rms[1]

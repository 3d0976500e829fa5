"""Every effect of the catalogue beside MuJoCo: the same numbers, the same motion.

The truth comes from the rig, which shares no code with the package and uses MuJoCo's own springs,
friction, tendons, gravity and bodies wherever it has them.
"""

import jax.numpy as jnp
import numpy as np
import pytest

import residyn
from residyn.effects import effects_named
from residyn.physics.modal import fastest
from tests.rig import NAMES, Arm, Hidden, hidden_cases, record

# Largest error as a share of the amplitude: twenty times below the noise of a good recording
# (0.25 %) where all is smooth, five times below it where joints stick or bearings stop.
SMOOTH, DRY = 1.2e-4, 5e-4


pytestmark = pytest.mark.usefixtures("float64", "compiled_in_less_time")


def truth(case):
    """The model that was simulated, as the package has it."""
    a = case.arm
    bearings = [case.bearings.count(where) for where in ("elbow", "wrist")]
    arm = residyn.PlanarArm([a.l1, a.l2], a.shoulder, a.elbow, a.coupling, a.theta2, bearings)
    model = residyn.Model(arm)
    for joint, k, c in zip(arm.joints, a.stiffness, a.damping, strict=True):
        model = model + residyn.Spring(joint, k) + residyn.Damper(joint, c)
    for hidden in case.hidden:
        (effect,) = effects_named(hidden.label, arm)
        model = model + effect
    known = {n.name for n in model.numbers}
    values = {name: x for name, x in case.numbers.items() if name in known}
    return model.with_values({name: jnp.asarray(x) for name, x in values.items()})


def remembered(case, model):
    """What the internal states hold at the first sample beyond what their effects begin with."""
    phase = [x for name, x in case.numbers.items() if name.endswith(".phase")]
    return np.asarray(phase or np.zeros(len(model.memory)))


def predicted(case):
    """The readings that the package predicts from the true state."""
    model = truth(case)
    lead = max(float(jnp.asarray(d)) for d in model.delays)
    # A late sensor's arm was released that much before the first sample.
    times = case.t if lead == 0.0 else np.concatenate([[-lead], case.t])
    path = residyn.simulate(model, times, case.q0, z0=remembered(case, model))
    return np.asarray(path.readings)[len(times) - len(case.t) :]


@pytest.mark.parametrize("label", NAMES)
def test_it_moves_as_in_mujoco(label):
    (case,) = hidden_cases(np.random.default_rng(7), label, 1, seconds=12.0)
    off = np.abs(predicted(case) - case.truth).max() / np.abs(case.truth).max()
    dry = truth(case).dry
    assert off < (DRY if dry else SMOOTH)


@pytest.mark.parametrize("theta2", [0.0, -0.02, 0.4, 2.0])
def test_bearings_hold_an_arm_in_any_pose(theta2):
    """Stretched out, the wrist's bearing can push along one direction only, and the elbow's takes
    what that leaves: where both stop, the arm stays, and does not creep back."""
    arm = Arm(0.57, 0.42, 0.4, 0.04, 0.126, theta2, (16.0, 6.4), (0.25, 0.012))
    hidden = [Hidden("bearing_friction", {"force": 0.04})]
    rng = np.random.default_rng(0)
    case = record(rng, arm, np.array([-0.17, -0.077]), hidden, seconds=12.0, rate=50.0, noise=1e-6)
    swing = np.abs(case.truth).max(axis=0)
    late = case.t > 9.0
    assert np.ptp(case.truth[late], axis=0).max() < 1e-6, "it is to be stuck by then"
    off = predicted(case) - case.truth
    assert np.abs(off[late]).max() < 5 * DRY * swing.max()
    assert np.ptp(off[late], axis=0).max() < 0.1 * DRY * swing.max()


def test_what_turns_about_a_wrist_that_hardly_moves_is_not_held_yet():
    """Nearly stretched out, an arm may move while its wrist all but rests: friction that could hold
    it takes a third of a second to stop it, in which it goes 0.4 % of its swing."""
    arm = Arm(0.5538, 0.4937, 0.5358, 0.0661, 0.2028, 0.1214, (2.074, 1.665), (9.4e-3, 9.48e-3))
    hidden = [
        Hidden("bearing_quadratic_drag", {"coefficient": 0.1034}),
        Hidden("bearing_friction", {"force": 0.02512}),
    ]
    rng, q0 = np.random.default_rng(0), np.array([-0.23564, 0.06831])
    case = record(rng, arm, q0, hidden, seconds=14.0, rate=100.0, noise=1e-6)
    swing, late = np.abs(case.truth).max(), case.t > 11.0
    assert np.ptp(case.truth[late], axis=0).max() < 1e-6, "it is to be stuck by then"
    assert np.abs(predicted(case) - case.truth)[late].max() < 4 * DRY * swing


@pytest.mark.parametrize(
    ("arm", "q0", "force"),
    [
        (
            Arm(0.35, 0.32, 0.416, 0.0789, 0.373, -1.64, (3.43, 1.69), (0.0062, 0.0189)),
            (-0.16, 0.285),
            0.0458,
        ),
        (
            Arm(0.521, 0.532, 0.527, 0.119, 0.259, 1.652, (31.4, 17.5), (0.196, 0.0042)),
            (0.358, 0.324),
            0.874,
        ),
    ],
)
def test_the_smoothing_of_a_bearings_friction_takes_no_energy(arm, q0, force):
    """The wrist passes through rest without turning aside: cycle after cycle, whatever smooths the
    friction there must not change what it takes."""
    hidden = [Hidden("bearing_friction", {"force": force})]
    rng = np.random.default_rng(0)
    case = record(rng, arm, np.array(q0), hidden, seconds=20.0, rate=100.0, noise=1e-6)
    off = np.sqrt(np.mean((predicted(case) - case.truth) ** 2, axis=0))
    assert off.max() < DRY * np.abs(case.truth).max()


def test_a_joint_that_is_free_in_its_gap_is_as_stiff_as_ever_outside():
    """At rest, all of the spring is lost; the step must follow what it does beyond the gap. Cycle
    after cycle in and out of it, errors grow: by default half a per cent of the swing is left."""
    arm = Arm(0.565, 0.35, 0.4947, 0.0437, 0.192, -1.836, (4.917, 7.807), (0.103, 0.0171))
    hidden = [Hidden("dead_zone:elbow", {"stiffness": 7.807, "gap": 0.04})]
    rng = np.random.default_rng(0)
    case = record(rng, arm, np.array([0.1, -0.3]), hidden, seconds=20.0, rate=100.0, noise=1e-6)
    off = np.sqrt(np.mean((predicted(case) - case.truth) ** 2, axis=0))
    assert off.max() < 0.01 * np.abs(case.truth).max()
    sprung = residyn.Model(truth(case).mechanism, truth(case).effects[:4])
    assert fastest(truth(case)) == pytest.approx(fastest(sprung), rel=1e-6)

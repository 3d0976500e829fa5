"""What only the rig can do with hidden effects, and what is drawn.

That each effect of the catalogue moves an arm as it must is for
`effects/test_effects_against_mujoco.py`: there the package, which has written every law down by
itself, is what the rig is compared with. Here are laws of no catalogue, the torque that is told
beside a motion, and the draws.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

pytest.importorskip("mujoco")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.rig import (
    NAMES,
    OUTSIDE,
    UNNAMED,
    Hidden,
    hidden_cases,
    paper_twin,
    random_arm,
    random_hidden,
    random_release,
    record,
    simulate,
)
from tests.rig.hidden import prepare, run
from tests.test_rig import eq1

JOINTS = ("shoulder", "elbow")
Law = Callable[[dict[str, float], float, float, float], float]

# The laws of no catalogue, once more: torques on the left side of Eq. 1, of (t, q, v).
LAWS: dict[str, Law] = {
    "angle_ripple": lambda n, t, q, v: n["torque"] * math.sin(n["waves"] * q + n["phase"]),
    "burst": lambda n, t, q, v: n["torque"] * math.exp(-(((t - n["time"]) / n["width"]) ** 2)),
    "fifth_power_drag": lambda n, t, q, v: n["coefficient"] * v**5,
    "loosening": lambda n, t, q, v: (
        -0.5 * n["stiffness"] * q * (1 + math.tanh((t - n["time"]) / n["width"]))
    ),
    "magnet": lambda n, t, q, v: (
        n["torque"]
        * (q - n["angle"])
        / n["width"]
        * math.exp(-(((q - n["angle"]) / n["width"]) ** 2))
    ),
}
TOGETHER = ("fifth_power_drag:elbow", "magnet:elbow", "loosening:shoulder", "sensor_scale:elbow")


@pytest.mark.parametrize("labels", [*((x,) for x in OUTSIDE), TOGETHER], ids="+".join)
def test_laws_of_no_catalogue_move_the_arm_and_are_told(labels):
    """The motion solves Eq. 1 with the laws' torques, and the torque that is told is theirs."""
    rng = np.random.default_rng([1, len(labels[0])])
    (case,) = hidden_cases(rng, labels, 1, seconds=4.0, strength=0.05, noise_share=0.0)

    def torque(t, q, v):
        total = np.zeros(2)
        for hidden in case.hidden:
            name, _, place = hidden.label.partition(":")
            if name in LAWS:
                j = JOINTS.index(place)
                total[j] -= LAWS[name](dict(hidden.values), t, q[j], v[j])
        return total

    q, v = case.motion
    truth = eq1(case.arm, case.t, case.q0, torque)
    assert np.max(np.abs(q - truth[:, :2])) < 1e-6 * np.max(np.abs(q))
    told = np.array([-torque(*row) for row in zip(case.t, q, v, strict=True)])
    assert np.max(np.abs(case.torque - told)) < 1e-7 * np.max(np.abs(told))
    scale = 1.0 + case.numbers.get("sensor_scale:elbow.error", 0.0)
    np.testing.assert_allclose(case.q, q * [1.0, scale], atol=1e-15)


@pytest.mark.parametrize("name", UNNAMED)
def test_a_law_of_no_catalogue_is_the_torque_that_the_arm_lacks(name):
    """By MuJoCo's inverse dynamics along the motion, which know nothing of the law."""
    rng = np.random.default_rng(3)
    (case,) = hidden_cases(rng, f"{name}:elbow", 1, strength=0.05, seconds=4.0)
    law, numbers = UNNAMED[name], case.hidden[0].values
    (q, v), found = case.motion, case.torque
    x = {"angle": q[:, 1], "rate": v[:, 1], "time": case.t}[law.variable]
    expected = np.array([law.value(dict(numbers), float(y)) for y in x])
    if law.factor == "direction":
        expected *= np.sign(v[:, 1])
    size = np.abs(expected).max()
    moving = slice(5, None)  # a release from rest: dry friction has no direction yet
    assert np.abs(found[moving, 1] - expected[moving]).max() < 5e-3 * size
    assert np.abs(found[:, 0]).max() < 5e-3 * size


def test_friction_holds_the_links_while_the_hand_rings_on():
    arm, t = paper_twin(1.1), np.arange(1001) / 100.0
    hand = {"inertia": 0.03, "frequency": 2.0, "damping_ratio": 0.001}
    hidden = [Hidden("bearing_friction", {"force": 1.5}), Hidden("wrist_flexibility", hand)]
    made = run(prepare(arm, [0.3, -0.2], hidden, ("elbow", "wrist")), t)
    last = slice(-300, None)
    assert np.max(np.abs(made.v[last, :2])) < 1e-8
    assert np.max(np.ptp(made.q[last, :2], axis=0)) < 1e-8
    # On the held arm it rings as it would on a bench.
    state = np.array([[0.0, 1.0], [-((4 * math.pi) ** 2), -2 * 0.001 * 4 * math.pi]])
    free = np.array([made.q[-300, 2], made.v[-300, 2]])
    assert np.abs(free[1]) > 0.1
    after = expm(state * (t[-1] - t[-300])) @ free
    assert [made.q[-1, 2], made.v[-1, 2]] == pytest.approx(after, rel=1e-4, abs=1e-6)


def test_a_stiff_wrist_is_the_arm_that_is_given():
    rng = np.random.default_rng(9)
    arm = replace(paper_twin(0.8), link1_moment=1.5)
    hand = {"inertia": 0.05, "frequency": 80.0, "damping_ratio": 0.3, "mass": 0.4, "offset": 0.15}
    tilted = random_hidden(rng, "gravity", arm, [0.2, 0.3], 0.05)
    wrist = Hidden("wrist_flexibility", hand)
    both, one = (
        record(rng, arm, [0.2, 0.3], hidden, seconds=1.5, noise=0.0)
        for hidden in ([wrist, tilted], [tilted])
    )
    assert np.max(np.abs(both.motion[0] - one.motion[0])) < 2e-3 * 0.3


# -- what is drawn ---------------------------------------------------------------------------


@pytest.mark.parametrize("label", [*NAMES, *OUTSIDE])
def test_silent_without_strength(label):
    rng = np.random.default_rng(13)
    (case,) = hidden_cases(rng, label, 1, strength=0.0, seconds=2.0, noise_share=0.0)
    clean = simulate(case.arm, case.t, case.q0)[0]
    assert np.max(np.abs(case.q - clean)) < 1e-7
    if case.torque is not None:
        assert np.max(np.abs(case.torque)) < 1e-9


@pytest.mark.parametrize("label", [*NAMES, *OUTSIDE])
def test_draws_are_arms_that_could_be(label):
    rng = np.random.default_rng(14)
    for _ in range(10):
        arm, q0 = random_arm(rng), random_release(rng)
        n = random_hidden(rng, label, arm, q0).values
        assert all(math.isfinite(x) and x != 0.0 for x in n.values())
        name, _, place = label.partition(":")
        j = int(place == "elbow")
        if name == "coupling_damping":
            assert n["damping"] ** 2 < math.prod(arm.damping)
        if name == "asymmetric_damping":
            assert abs(n["damping"]) < arm.damping[j]
        if name == "dead_zone":
            assert 0.0 < n["stiffness"] <= arm.stiffness[j]
        if name == "wrist_flexibility":
            replace(arm, elbow=arm.elbow - n["inertia"]).bodies()
        if name == "inertia_error":
            replace(arm, **{place: getattr(arm, place) * (1 + n["share"])}).bodies()


def test_cases_repeat_and_know_their_noise():
    labels = ["coulomb_friction:elbow", "sensor_offset:elbow"]
    first, again = (
        next(hidden_cases(np.random.default_rng(15), labels, 1, seconds=3.0)) for _ in range(2)
    )
    np.testing.assert_array_equal(first.q, again.q)
    assert [h.label for h in first.hidden] == labels
    assert "sensor_offset:elbow.offset" in first.numbers
    spread = np.sqrt(np.mean(np.var(first.motion[0], axis=0)))
    assert first.noise == pytest.approx(0.0025 * spread)
    assert np.std(first.q - first.truth) == pytest.approx(first.noise, rel=0.1)


def test_unknown_and_repeated_effects_are_refused():
    arm, rng = paper_twin(), np.random.default_rng(16)
    with pytest.raises(ValueError, match="knows no effect"):
        record(rng, arm, 0.1, [Hidden("gremlin:elbow", {})])
    twice = [Hidden("constant_torque:elbow", {"torque": 0.1})] * 2
    with pytest.raises(ValueError, match="hidden twice"):
        record(rng, arm, 0.1, twice)

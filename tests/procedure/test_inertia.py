"""Step 1: inertias from driven tests, against MuJoCo and against closed forms."""

import dataclasses
import json
import math

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import residyn
from residyn.cli import main
from residyn.errors import InputError
from residyn.recordings.csv import write_csv
from residyn.recordings.experiment import Experiment
from residyn.recordings.recording import Recording
from residyn.recordings.tables import ArmTable, Bearing
from tests.rig import random_arm
from tests.rig.driven import ELBOW, SHOULDER, drive, paper_tests, sines

TARGET = 3e-3
"""What step 1 must reach on the paper's rig: a relative error."""


def truth_of(arm):
    return np.array([arm.shoulder, arm.elbow, arm.coupling])


def recording_of(test, name="test.csv"):
    return Recording.from_arrays(
        test.t, test.q, drive=test.u, theta2=test.arm.theta2, role="inertia", name=name
    )


def experiment_of(tests):
    arm = tests[0].arm
    table = ArmTable((arm.l1, arm.l2))
    recordings = [recording_of(t, name=f"test{i}.csv") for i, t in enumerate(tests, 1)]
    return Experiment(table, tuple(recordings))


@pytest.fixture(scope="module")
def paper():
    """Tests I to III on the paper's rig, without noise."""
    return paper_tests()


@pytest.fixture(scope="module")
def found(paper):
    rng = np.random.default_rng(0)
    return residyn.inertia(experiment_of([test.read(rng) for test in paper]))


# -- the paper's rig -------------------------------------------------------------------------


def test_paper_rig_comes_out_below_three_in_a_thousand(paper, found):
    off = found.values / truth_of(paper[0].arm) - 1
    assert np.abs(off).max() < TARGET, off
    assert abs(found.composite().value / 2.9640 - 1) < TARGET
    for test, one in zip(paper, found.tests, strict=True):
        assert one.inertia.value == pytest.approx(test.composite, rel=TARGET)
        assert one.friction["coulomb_friction"].value == pytest.approx(
            (0.05, 0.02)[test.joint], rel=0.05
        )
        assert one.friction["viscous_friction"].value == pytest.approx(0.1, rel=0.05)
        assert one.test.torque_noise == pytest.approx(5e-3 * np.max(np.abs(test.u)), rel=0.1)
    assert not found.warnings


def test_acceleration_noise_and_a_brake_that_gives_harm_the_papers_way_more(paper):
    """Errors over a few readings of the same motion: Eq. 12 to 15, and the weak form."""
    truth, ours, theirs = truth_of(paper[0].arm), [], []
    for seed in range(6):
        rng = np.random.default_rng([seed, 1])
        result = residyn.inertia(experiment_of([t.read(rng, angle_noise=1e-4) for t in paper]))
        ours.append(result.values / truth - 1)
        theirs.append(result.least_squares / truth - 1)
    assert np.sqrt(np.mean(np.square(ours), axis=0)).max() < 2e-3
    assert np.sqrt(np.mean(np.square(theirs), axis=0)).max() > 1e-2


@pytest.mark.slow
def test_errors_are_honest(paper):
    """Pulls of the three inertias and of every test's numbers, over seeds."""
    truth, arms, tests, chi2 = truth_of(paper[0].arm), [], [], []
    for seed in range(24):
        rng = np.random.default_rng([seed, 2])
        result = residyn.inertia(experiment_of([t.read(rng) for t in paper]))
        arms.append((result.values - truth) / result.std)
        tests.append(
            [
                (r.inertia.value - t.composite) / r.inertia.std
                for r, t in zip(result.tests, paper, strict=True)
            ]
        )
        chi2 += [r.solved.chi2 for r in result.tests]
    for pulls in (np.array(arms), np.array(tests)):
        assert 0.7 < np.sqrt(np.mean(pulls**2)) < 1.3  # 72 pulls, three at a time not independent
        assert np.abs(pulls).max() < 4.5
    assert np.mean(chi2) == pytest.approx(1, abs=0.05)


def test_covariance_of_the_three_is_that_of_eq_14(found):
    p, q, e = (t.inertia.std for t in found.tests)
    cosines = np.cos([t.test.theta2 for t in found.tests[:2]])
    apart = 2 * 0.4 * (cosines[0] - cosines[1])
    assert found.elbow.std == pytest.approx(e)
    assert found.coupling.std == pytest.approx(math.hypot(p, q) / apart)
    assert found.composite(found.tests[0].test.theta2).std == pytest.approx(p)
    assert found.composite(found.tests[0].test.theta2).value == pytest.approx(
        found.tests[0].inertia.value
    )


# -- any arm ---------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [0, *(pytest.param(s, marks=pytest.mark.slow) for s in (1, 2))])
def test_random_arms(seed):
    """Other arms, trajectories, angles, sampling; brakes that give; more tests than unknowns."""
    rng = np.random.default_rng([seed, 3])
    arm = dataclasses.replace(random_arm(rng), theta2=0.0)
    t = np.arange(1200) / rng.choice([50.0, 100.0])
    poses = [(SHOULDER, th) for th in rng.permutation([0.2, 1.0, 2.0, -2.8])[: rng.integers(3, 5)]]
    tests = []
    for joint, theta2 in [*poses, (ELBOW, 0.5)]:
        size, pace = rng.uniform(0.3, 0.6), rng.uniform(0.15, 0.4)
        own = np.diag(arm.mass_matrix())
        inertia, other = own[joint], own[1 - joint]
        torque = inertia * size * (2 * math.pi * pace) ** 2
        tests.append(
            drive(
                dataclasses.replace(arm, theta2=float(theta2)),
                joint,
                t,
                trajectory=sines((size, pace, 1.0), (0.3 * size, 1.7 * pace, 0.0)),
                viscous=rng.uniform(0.0, 0.2) * torque,
                offset=rng.uniform(-0.1, 0.1) * torque,
                brake=(300 * other, 1.0 * other),
            ).read(rng, angle_noise=3e-4)
        )
    result = residyn.inertia(experiment_of(tests))
    pulls = (result.values - truth_of(arm)) / result.std
    assert np.abs(pulls).max() < 4.5
    assert np.abs(result.values / truth_of(arm) - 1).max() < 0.02
    assert result.reduced_chi2 is not None


def rigid(inertia, q, v, a, joint, *, coulomb=0.0, viscous=0.0, offset=0.0):
    """Angles and torques of one joint led by hand through (q, v, a), the other held for good."""
    angle, torque = np.zeros((len(q), 2)), np.zeros((len(q), 2))
    angle[:, joint] = q
    torque[:, joint] = inertia * a + coulomb * np.sign(v) + viscous * v + offset
    return angle, torque


def wave(t, size=0.8, pulse=1.1, phase=0.4):
    x = pulse * t + phase
    return size * np.sin(x), size * pulse * np.cos(x), -size * pulse**2 * np.sin(x)


def rigid_experiment(truth, angles, t=None, noise=1e-4, seed=0, table=None, **friction):
    """Shoulder at each of the elbow's `angles`, elbow at 0: Eq. 10 and 11 to the letter."""
    rng, recordings = np.random.default_rng(seed), []
    t = np.arange(2000) / 100 if t is None else t
    for i, (joint, theta2) in enumerate([*[(0, th) for th in angles], (1, 0.0)]):
        row = np.array([0, 1, 0]) if joint else np.array([1, 1, 0.8 * math.cos(theta2)])
        q, u = rigid(row @ truth, *wave(t), joint, **friction)
        u[:, joint] += 1e-3 * np.ptp(u[:, joint]) * rng.standard_normal(len(t))
        q += noise * rng.standard_normal(q.shape)
        recordings.append(
            Recording.from_arrays(
                t, q, drive=u, theta2=theta2, role="inertia", name=f"test{i + 1}.csv"
            )
        )
    return Experiment(table or ArmTable((0.4, 0.4)), tuple(recordings))


@settings(max_examples=12)
@given(
    shoulder=st.floats(0.2, 20),
    elbow=st.floats(0.05, 5),
    share=st.floats(-0.9, 0.9),
    angle=st.floats(0.7, 3.1),
    coulomb=st.floats(0, 1),
    viscous=st.floats(0, 1),
    offset=st.floats(-0.3, 0.3),
)
def test_any_arm_that_could_be_built(shoulder, elbow, share, angle, coulomb, viscous, offset):
    truth = np.array([shoulder, elbow, share * math.sqrt(shoulder * elbow) / 0.4])
    friction = {"coulomb": coulomb * elbow, "viscous": viscous * elbow, "offset": offset * elbow}
    result = residyn.inertia(rigid_experiment(truth, [0.0, angle], **friction))
    assert np.abs((result.values - truth) / result.std).max() < 5
    for test in result.tests:
        for name, value in zip(test.friction, friction.values(), strict=True):
            number = test.friction[name]
            assert abs(number.value - value) < 5 * number.std


TRUTH = np.array([1.2, 0.6, 1.4])


def test_uneven_times_lost_and_wild_readings():
    rng = np.random.default_rng(5)
    t = np.sort(np.arange(2000) / 100 + 2e-3 * rng.standard_normal(2000))
    whole = rigid_experiment(TRUTH, [0.0, 1.5], t=t, coulomb=0.2, viscous=0.1)
    recordings = []
    for r in whole.recordings:
        q, u = r.angle.copy(), r.drive.copy()
        q[rng.random(q.shape) < 0.05] = np.nan
        q[700:760] = np.nan
        q[[300, 900], :] += 0.05
        u[rng.random(len(u)) < 0.02] = np.nan
        recordings.append(
            Recording.from_arrays(r.time, q, drive=u, theta2=r.theta2, role="inertia", name=r.name)
        )
    result = residyn.inertia(dataclasses.replace(whole, recordings=tuple(recordings)))
    assert np.abs((result.values - TRUTH) / result.std).max() < 4.5
    assert np.abs(result.values / TRUTH - 1).max() < 0.01


@pytest.mark.parametrize("lost", [slice(60), slice(-60, None)])
def test_readings_lost_at_an_end(lost):
    whole = rigid_experiment(TRUTH, [0.0, 1.5], coulomb=0.2, viscous=0.1)
    recordings = []
    for r in whole.recordings:
        q = r.angle.copy()
        q[lost] = np.nan
        recordings.append(
            Recording.from_arrays(
                r.time, q, drive=r.drive, theta2=r.theta2, role="inertia", name=r.name
            )
        )
    result = residyn.inertia(dataclasses.replace(whole, recordings=tuple(recordings)))
    assert np.abs((result.values - TRUTH) / result.std).max() < 4.5
    assert np.abs(result.values / TRUTH - 1).max() < 0.01


def test_readings_without_noise():
    result = residyn.inertia(rigid_experiment(TRUTH, [0.0, 1.5], noise=0.0, coulomb=0.2))
    assert result.values == pytest.approx(TRUTH, rel=1e-3)


def test_a_joint_that_slides_one_way_has_no_offset_of_its_own():
    t = np.arange(2000) / 100
    motion = 2 * t + 0.5 * np.sin(1.3 * t), 2 + 0.65 * np.cos(1.3 * t), -0.845 * np.sin(1.3 * t)
    recordings = list(rigid_experiment(TRUTH, [0.0, 1.5]).recordings)
    q, u = rigid(TRUTH[1], *motion, 1, coulomb=0.1, viscous=0.2)
    rng = np.random.default_rng(0)
    q, u[:, 1] = q + 1e-4 * rng.standard_normal(q.shape), u[:, 1] + 1e-3 * rng.standard_normal(2000)
    how = {"drive": u, "role": "inertia", "name": "test3.csv", "stated": ["q2"]}
    recordings[2] = Recording.from_arrays(t, q, **how)
    result = residyn.inertia(Experiment(ArmTable((0.4, 0.4)), tuple(recordings)))
    assert result.elbow.value == pytest.approx(0.6, rel=0.01)
    assert result.tests[2].friction["offset"] is None
    assert result.to_dict()["tests"][2]["offset"] is None
    assert "slid one way" in str(result)


def test_torque_that_a_brake_holds_with_is_no_drive():
    whole = rigid_experiment(TRUTH, [0.0, 1.5])
    first = whole.recordings[0]
    u = first.drive.copy()
    u[:, 1] = 5.0 * np.sin(first.time)
    held = Recording.from_arrays(first.time, first.angle, drive=u, role="inertia", name="held.csv")
    result = residyn.inertia(dataclasses.replace(whole, recordings=(held, *whole.recordings[1:])))
    assert result.values == pytest.approx(TRUTH, rel=5e-3)


def test_bearings_that_were_off_are_put_on_again():
    """Eq. 5: tests without them give the same arm, bearings on."""
    bearings = (Bearing("elbow", 1.9635, 0.00245437), Bearing("wrist", 1.9635, 0.00245437))
    added = np.array([2 * 1.9635 * 0.16, 2 * 0.00245437 + 1.9635 * 0.16, 1.9635 * 0.4])
    on, off = rigid_experiment(TRUTH, [0.0, 1.5]), rigid_experiment(TRUTH - added, [0.0, 1.5])
    bare = [dataclasses.replace(r, air_bearings=False) for r in off.recordings]
    for recordings in (bare, [*bare[:2], *on.recordings]):
        result = residyn.inertia(Experiment(on.inertia, tuple(recordings), bearings))
        assert result.values == pytest.approx(TRUTH, rel=5e-3)


def test_runs_in_float64_whatever_jax_is_set_to(paper):
    tests = [t.read(np.random.default_rng(0)) for t in paper]
    with jax.enable_x64(False):
        one = residyn.inertia(experiment_of(tests))
    with jax.enable_x64(True):
        other = residyn.inertia(experiment_of(tests))
    assert one.values.dtype == np.float64
    assert one.values == pytest.approx(other.values, rel=1e-12)


# -- what it says ----------------------------------------------------------------------------


def test_eq_16_amplifies_the_error_as_it_says():
    """Two elbow angles ever closer: the factor is the one by which coupling's error grows."""
    for angle in (2.0, 0.6, 0.3):
        experiment = rigid_experiment(TRUTH, [0.0, angle])
        result = residyn.inertia(experiment)
        apart = 1 - math.cos(angle)
        assert result.separation.span == pytest.approx(apart, rel=1e-2)
        composites = np.array([t.inertia.value for t in result.tests[:2]])
        expected = np.linalg.norm(composites) / (0.8 * apart) / result.coupling.value
        assert result.separation.amplification == pytest.approx(expected, rel=1e-2)
        assert result.separation.excess == pytest.approx(2 / apart, rel=1e-2)
        assert "Eq. 16" in str(result)
        close = any("elbow angles are close" in w for w in result.warnings)
        assert close == (angle == 0.3)


def test_elbow_angles_are_no_further_apart_by_more_tests_at_them():
    once, often = (residyn.inertia(rigid_experiment(TRUTH, [0.0, 0.6] * n)) for n in (1, 3))
    assert often.separation.excess == pytest.approx(once.separation.excess, rel=1e-2)
    assert often.separation.amplification < 0.7 * once.separation.amplification
    assert "cosines 1.000, 0.825 differ" in " ".join(str(often).split())
    best = residyn.inertia(rigid_experiment(TRUTH, [0.0, math.pi, math.pi]))
    assert best.separation.excess == pytest.approx(1, rel=1e-2)


def test_friction_that_is_more_is_said_and_enlarges_the_errors():
    """Ten per cent of Stribeck-like friction at slow sliding."""
    t = np.arange(2000) / 100
    whole = rigid_experiment(TRUTH, [0.0, 1.5])
    q, v, a = wave(t)
    angle, u = rigid(0.6, q, v, a, 1)
    u[:, 1] += 0.3 * np.sign(v) * np.exp(-np.abs(v) / 0.2)
    rng = np.random.default_rng(0)
    u[:, 1] += 1e-3 * rng.standard_normal(2000)
    angle += 1e-4 * rng.standard_normal(angle.shape)
    odd = Recording.from_arrays(t, angle, drive=u, role="inertia", name="stribeck.csv")
    result = residyn.inertia(dataclasses.replace(whole, recordings=(*whole.recordings[:2], odd)))
    plain = residyn.inertia(whole)
    assert any("stribeck.csv" in w and "friction is more" in w for w in result.warnings)
    assert result.elbow.std > 3 * plain.elbow.std


def test_noise_that_is_overstated_is_said():
    whole = rigid_experiment(TRUTH, [0.0, 1.5], noise=1e-4)
    loud = [dataclasses.replace(r, noise=10 * r.noise) for r in whole.recordings]
    result = residyn.inertia(dataclasses.replace(whole, recordings=tuple(loud)))
    assert result.values == pytest.approx(TRUTH, rel=1e-2)
    assert all("noise is overstated" in w for w in result.warnings)
    assert len(result.warnings) == 3


def test_tests_that_contradict_each_other_are_named():
    whole = rigid_experiment(TRUTH, [0.0, 1.0, 2.0])
    wrong = dataclasses.replace(whole.recordings[1], theta2=1.3)
    result = residyn.inertia(
        dataclasses.replace(whole, recordings=(whole.recordings[0], wrong, *whole.recordings[2:]))
    )
    assert any("tests disagree" in w for w in result.warnings)
    assert residyn.inertia(whole).warnings == ()


def test_inertias_that_the_experiment_has_are_compared():
    table = ArmTable((0.4, 0.4), 1.2, 0.7, 1.4)
    result = residyn.inertia(rigid_experiment(TRUTH, [0.0, 1.5], table=table))
    assert [w for w in result.warnings if "elbow = 0.7" in w]
    assert not [w for w in result.warnings if "shoulder = 1.2" in w]


def test_a_braked_elbow_off_its_pose_is_taken_as_read():
    whole = rigid_experiment(TRUTH, [0.0, 1.5])
    last = whole.recordings[1]
    angle = last.angle + np.array([0.0, 1.5])
    moved = Recording.from_arrays(
        last.time, angle, drive=last.drive, role="inertia", name="moved.csv", theta2=0.0
    )
    result = residyn.inertia(
        dataclasses.replace(whole, recordings=(whole.recordings[0], moved, whole.recordings[2]))
    )
    assert result.values == pytest.approx(TRUTH, rel=5e-3)
    assert any("moved.csv" in w and "q2 = 1.5" in w for w in result.warnings)


def lines_of_refusal():
    good = rigid_experiment(TRUTH, [0.0, 1.5])
    one, two, elbow = good.recordings
    cart = residyn.recording.InertiaTable(("cart",), ((1.0,),))
    t, still = one.time, np.zeros((2000, 2))
    swapped = one.angle[:, ::-1]
    both = one.angle + [[0.0, 1.0]] * np.sin(t)[:, None]

    def test(angle, drive):
        return Recording.from_arrays(
            t, angle, drive=drive, role="inertia", name="odd.csv", noise=1e-4
        )

    return {
        "none": (good, [], ["no recording", "inertia"]),
        "no elbow": (good, [one, two], ["elbow driven", "Eq. 10"]),
        "no shoulder": (good, [elbow], ["two with the shoulder driven"]),
        "one shoulder": (good, [one, elbow], ["another elbow angle", "Eq. 16", "theta2 = "]),
        "same cosine": (
            good,
            [dataclasses.replace(one, theta2=0.3), dataclasses.replace(one, theta2=-0.3), elbow],
            ["0.3", "-0.3", "one cosine", "Eq. 16"],
        ),
        "both move": (good, [test(both, one.drive), two, elbow], ["odd.csv", "both joints move"]),
        "no torque": (
            good,
            [test(one.angle, still), two, elbow],
            ["odd.csv", "nothing was driven"],
        ),
        "columns": (
            good,
            [test(swapped, one.drive), two, elbow],
            ["odd.csv", "columns"],
        ),
        "no arm": (
            Experiment(cart, (Recording.from_arrays(t, t, noise=1e-3),)),
            None,
            ["[arm]", "[inertia]"],
        ),
    }


@pytest.mark.parametrize("case", lines_of_refusal())
def test_bad_input_is_one_line(case):
    experiment, recordings, words = lines_of_refusal()[case]
    if recordings is not None:
        experiment = dataclasses.replace(experiment, recordings=tuple(recordings))
    with pytest.raises(residyn.InputError) as end:
        residyn.inertia(experiment)
    line = str(end.value)
    assert "\n" not in line
    for word in words:
        assert word in line


def lines_of_failure():
    good = rigid_experiment(TRUTH, [0.0, 1.5])
    t, elbow = good.recordings[0].time, good.recordings[2]
    rng = np.random.default_rng(0)

    def test(q, v, a, t=t, inertia=3.0, noise=1e-4):
        angle, u = rigid(inertia, q, v, a, 0, coulomb=0.1)
        u[:, 0] += 1e-2 * rng.standard_normal(len(t))
        angle += noise * rng.standard_normal(angle.shape)
        return Recording.from_arrays(t, angle, drive=u, role="inertia", name="odd.csv")

    steady = 0.48 * t - 4.8, 0.48 + 0 * t, 0 * t
    short = t[:40]
    return (
        {
            "noise alone": (test(*wave(t, size=1e-6), noise=1e-3), ["too little", "noise"]),
            "steady": (test(*steady), ["does not stand out"]),
            "short": (test(*wave(short), t=short), ["samples"]),
            "sign": (test(*wave(t), inertia=-3.0), ["negative", "u1"]),
            "fast": (test(*wave(t, size=0.5, pulse=100.0)), ["reversals"]),
        },
        elbow,
        good,
    )


@pytest.mark.parametrize("case", lines_of_failure()[0])
def test_numbers_that_cannot_be_had_are_one_line(case):
    cases, elbow, good = lines_of_failure()
    recording, words = cases[case]
    with pytest.raises(residyn.FitError) as end:
        residyn.inertia(
            dataclasses.replace(good, recordings=(recording, good.recordings[1], elbow))
        )
    line = str(end.value)
    assert "\n" not in line
    assert "odd.csv" in line
    for word in words:
        assert word in line


# -- the command -----------------------------------------------------------------------------


def write(folder, recordings, head="[arm]\nlink_lengths = [0.4, 0.4]\n"):
    text = head
    for i, r in enumerate(recordings, 1):
        write_csv(folder / f"test{i}.csv", r.time, r.angle, r.drive)
        text += f'\n[[recordings]]\nfile = "test{i}.csv"\ntheta2 = {r.theta2!r}\nrole = "inertia"\n'
    (folder / "tests.toml").write_text(text)


@pytest.fixture
def command(tmp_path, monkeypatch, capsys):
    """Writes recordings, and runs a command where they are."""
    monkeypatch.chdir(tmp_path)

    def run(recordings, *words, **options):
        write(tmp_path, recordings, **options)
        status = main([*(words or ("inertia", "tests.toml")), "--no-cache"])
        out, err = capsys.readouterr()
        return status, out, err

    return run


def test_command_prints_an_arm_that_other_commands_read(command, tmp_path, paper, found):
    rng = np.random.default_rng(0)
    recordings = [recording_of(t.read(rng)) for t in paper]
    status, out, err = command(recordings, "inertia", "tests.toml", "--json", "out.json")
    assert (status, err) == (0, "")
    assert all(len(line) <= 80 for line in out.splitlines())
    for words in ("[[Tests]]", "test1.csv: shoulder driven", "Coulomb friction", "[[Eq. 16]]"):
        assert words in out
    head = out[out.index("[arm]") :]
    (tmp_path / "arm.toml").write_text(
        head + '\n[[recordings]]\nfile = "test1.csv"\ntheta2 = 0.0\n'
    )
    table = residyn.load(tmp_path / "arm.toml").inertia
    assert truth_of(table) == pytest.approx(found.values, rel=1e-4)

    result = json.loads((tmp_path / "out.json").read_text())
    for i, name in enumerate(("shoulder", "elbow", "coupling")):
        assert result[name]["value"] == pytest.approx(found.values[i], rel=1e-6)
        assert result[name]["std"] == pytest.approx(found.std[i], rel=1e-6)
    assert [t["recording"] for t in result["tests"]] == ["test1.csv", "test2.csv", "test3.csv"]
    assert [t["joint"] for t in result["tests"]] == ["shoulder", "shoulder", "elbow"]
    for test in result["tests"]:
        for name in ("composite_inertia", "coulomb_friction", "viscous_friction", "offset"):
            assert test[name]["std"] > 0
    assert result["warnings"] == []


def test_command_keeps_words_off_the_json(command):
    recordings = rigid_experiment(TRUTH, [0.0, 1.5]).recordings
    status, out, err = command(recordings, "inertia", "tests.toml", "--json", "-")
    assert status == 0
    assert json.loads(out)["elbow"]["value"] == pytest.approx(0.6, rel=1e-2)
    assert "[arm]" in err


@pytest.mark.parametrize("kept", [[0, 1], "steady"])
def test_command_fails_in_one_line(command, kept):
    """A recording is missing (2); nothing accelerates, so that the numbers cannot be had (1)."""
    recordings, status = list(rigid_experiment(TRUTH, [0.0, 1.5]).recordings), 2
    if kept == "steady":
        recordings[0], status = lines_of_failure()[0]["steady"][0], 1
    else:
        recordings = [recordings[i] for i in kept]
    ended, out, err = command(recordings)
    assert (ended, out) == (status, "")
    assert err.startswith("residyn: ")
    assert err.count("\n") == 1
    assert ("does not stand out" if status == 1 else "elbow driven") in err


def test_a_failure_tells_that_the_drive_was_filled_in():
    recordings = list(rigid_experiment(TRUTH, [0.0, 1.5]).recordings)
    t, angle, drive = (getattr(recordings[0], key) for key in ("time", "angle", "drive"))
    lost = drive.copy()
    lost[:1900, 0] = np.nan
    recordings[0] = Recording.from_arrays(t, angle, drive=lost, role="inertia", name="odd.csv")
    with pytest.raises(residyn.FitError, match=r"odd\.csv: u1 has 1900 missing values, filled in"):
        residyn.inertia(Experiment(ArmTable((0.4, 0.4)), tuple(recordings)))


def test_command_shows_numbers_that_are_no_arms_and_fails(command):
    """A second test whose pose is told wrong makes coupling larger than any body allows."""
    one, two, elbow = rigid_experiment(TRUTH, [0.0, 1.5]).recordings
    status, out, err = command([one, dataclasses.replace(two, theta2=0.6), elbow])
    assert status == 1
    assert "[[Inertia]]" in out
    assert "[arm]" not in out
    assert "no arm's inertia" in err
    assert err.count("\n") == 1


def test_command_refuses_driven_tests_in_other_units(command):
    one, two, elbow = rigid_experiment(TRUTH, [0.0, 1.5]).recordings
    ms = dataclasses.replace(one, time=one.time * 1000)
    degrees = dataclasses.replace(one, angle=np.degrees(one.angle))
    posed = dataclasses.replace(two, theta2=90.0)
    for recordings, words in (
        ([ms, two, elbow], ["test1.csv", "milliseconds", 't = "ms"']),
        ([degrees, two, elbow], ["test1.csv", "in degrees", 'q1 = "deg"']),
        ([one, posed, elbow], ["test2.csv", "theta2 = 90: in degrees"]),
    ):
        status, out, err = command(recordings)
        assert (status, out, err.count("\n")) == (2, "", 1)
        assert all(word in err for word in words)


def test_a_driven_joint_may_turn_round_where_the_unit_is_stated(tmp_path):
    tests = rigid_experiment(TRUTH, [0.0, 1.5]).recordings
    large = [dataclasses.replace(r, angle=10 * r.angle, drive=10 * r.drive) for r in tests]
    write(tmp_path, large)
    with pytest.raises(InputError, match="in degrees"):
        residyn.load(tmp_path / "tests.toml")
    text = (tmp_path / "tests.toml").read_text()
    text = text.replace("role", 'units = { q1 = "rad", q2 = "rad" }\nrole')
    (tmp_path / "tests.toml").write_text(text)
    values = residyn.inertia(residyn.load(tmp_path / "tests.toml")).values
    assert values == pytest.approx(TRUTH, rel=1e-2)


def test_a_pose_beyond_half_a_turn_is_doubted():
    experiment = rigid_experiment(TRUTH, [0.0, 1.5 - 2 * math.pi])
    found = residyn.inertia(experiment)
    assert [w for w in found.warnings if "theta2 = -4.78" in w and "in degrees?" in w]
    assert "in degrees?" in str(found)


def test_other_commands_want_the_inertias_first(command):
    recordings = rigid_experiment(TRUTH, [0.0, 1.5]).recordings
    status, out, err = command(recordings, "fit", "tests.toml")
    assert (status, out) == (2, "")
    assert err.count("\n") == 1

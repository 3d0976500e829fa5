"""What is seen before a fit: said of recordings that no ringing arm makes, and of no others."""

import dataclasses

import numpy as np
import pytest

from residyn import demo
from residyn.errors import InputError
from residyn.recordings.columns import Table
from residyn.recordings.csv import read_csv, write_csv
from residyn.recordings.experiment import Experiment, load
from residyn.recordings.recording import Recording
from residyn.recordings.sanity import not_free
from residyn.recordings.tables import ArmTable
from tests.recordings.test_recording import DATA, measured
from tests.rig import draw
from tests.rig.cases import clean_cases
from tests.rig.hidden import hidden_cases

ALONE = ("bearing", "wrist_flexibility", "coupling", "gravity")
UNITS = ("rad", "rad")


def doubted(recording, units=UNITS, said=(), **keys):
    lines = np.arange(len(recording.time))
    table = Table(recording.time, recording.angle, None, lines, frozenset(said))
    return not_free(recording, units, table, keys)


def seen(time, angle, units=UNITS, said=(), **keys):
    found = doubted(Recording.from_arrays(time, angle, noise=1e-3), units, said, **keys)
    return None if found is None else found.words


@pytest.mark.parametrize("label", [*draw.JOINT, *draw.ARM])
def test_nothing_is_said_of_an_arm_with_something_hidden_in_it(label):
    rng = np.random.default_rng(len(label))
    own = label if label.startswith(ALONE) else f"{label}:{rng.choice(['shoulder', 'elbow'])}"
    for noise in (0.0025, 0.05):
        (case,) = hidden_cases(rng, own, 1, seconds=6.0, noise_share=noise)
        assert seen(case.t, case.q) is None


def test_nothing_is_said_of_clean_arms_and_of_the_demo():
    for case in clean_cases(np.random.default_rng(0), 10, seconds=8.0):
        assert seen(case.t, case.q) is None
    with demo.experiment_file() as path:
        assert len(load(path).recordings) == 2


@measured
def test_what_is_said_of_measured_recordings():
    for path in sorted(DATA.glob("carts/*.csv")):
        time, angle, _, _ = read_csv(path, 1)
        assert "stands still" in seen(time, angle, ("m",))  # and is pulled by hand
        free = Recording.from_arrays(time, angle, start="release")
        assert doubted(free, ("m",)) is None
    time, angle, _, _ = read_csv(DATA / "double_pendulum" / "free_swing.csv", 2)
    assert seen(time, angle) is None
    time, angle, _, _ = read_csv(DATA / "air_track" / "one_mass_1.csv", 1)
    assert seen(time, angle, ("m",)) is None


@pytest.fixture(scope="module")
def good():
    (case,) = clean_cases(np.random.default_rng(4), 1, seconds=20.0, amplitude=(0.1, 0.3))
    return case.t, case.q


def test_angles_of_an_encoder_with_its_own_zero(good):
    time, angle = good
    for degrees in ((12.3, 28.6), (-12.3, -28.6), (0.0, 40.0), (-40.0, 0.0)):
        off = np.radians(degrees)
        line = seen(time, angle + off)
        if sum(x != 0 for x in degrees) == 1 and line is None:
            continue  # as if that brake had slipped
        assert "rings about" in line
        assert 'rest = "estimate"' in line
        assert seen(time, angle + off, rest=[0, 0]) is None
        found = Recording.from_arrays(time, angle + off, rest="estimate", noise=1e-3)
        assert doubted(found) is None
        np.testing.assert_allclose(found.angle, angle, atol=2e-3)


def test_a_gyroscope_with_a_zero_of_its_own_is_told_of_its_readings(good):
    time, angle = good
    rates = Recording.from_arrays(time, angle + 0.9, reads="rate", noise=1e-3)
    found = doubted(rates, ("rad/s", "rad/s"))
    assert found.key == "rest"
    assert "rad/s): at rest it must read 0; " in found.words
    assert "angle" not in found.words


def test_a_joint_that_stands_still_away_from_zero_is_not_counted_from_rest(good):
    time, angle = good
    line = seen(time, np.column_stack([angle[:, 0], 0.5 + 1e-3 * np.sin(50 * time)]))
    assert "q2 rings about 0.5 rad" in line


def test_degrees_and_milliseconds(good):
    time, angle = good
    line = seen(time, np.degrees(angle))
    assert "in degrees?" in line
    assert 'units = { q1 = "deg" }' in line
    assert seen(time, np.degrees(angle), said=("q1", "q2")) is None
    for factor, unit in ((1e3, "ms"), (1e4, "ms"), (1e6, "us")):
        line = seen(factor * time, angle)
        assert "is" in line
        assert f'units = {{ t = "{unit}" }}' in line
        assert seen(factor * time, angle, said=("t",)) is None


@pytest.mark.parametrize("run", [1, 12])
def test_the_code_of_a_lost_sample_is_no_angle(good, run):
    time, angle = good
    lost = np.arange(len(time)) % 97 < run
    for code, unit in ((-999.0, 1.0), (9999.0, np.degrees(1.0))):
        coded = np.where(lost[:, None], code, unit * angle)
        line = seen(time, coded)
        assert f"q1 = {code:.4g} rad" in line
        assert f"({lost.sum()} readings)" in line
        assert "the code of a lost sample? that is an empty cell or nan" in line
        assert "in degrees?" not in line
    assert seen(time, np.where(lost[:, None], np.nan, angle)) is None


def test_outliers_are_not_in_degrees(good):
    time, angle = good
    spikes = np.arange(len(time)) % 67 == 30
    off = np.where(spikes[:, None], 40.0 + np.arange(len(time))[:, None], angle)
    assert spikes.mean() > 0.01
    assert "in degrees?" not in str(seen(time, off))
    with_own = Experiment(ArmTable((0.4, 0.4), 1.2, 0.6, 1.4), (Recording.from_arrays(time, off),))
    assert not any("in degrees" in line for line in with_own.warnings)


@pytest.mark.parametrize("hold", [0.6, 2.0, 10.0])
def test_a_hold_before_the_release(good, hold):
    time, angle = good
    count = round(hold / (time[1] - time[0]))
    noise = 1e-3 * np.random.default_rng(0).standard_normal((count, 2))
    held = np.concatenate([angle[0] + noise, angle])
    clock = np.arange(len(held)) * (time[1] - time[0])
    line = seen(clock, held)
    assert "stands still for the first" in line
    assert 'start = "release"' in line
    assert float(line.split("first ")[1].split()[0]) == pytest.approx(hold, rel=0.04)
    assert seen(clock, held, start=0.0) is None


def test_a_piece_of_a_swing_or_an_oscillation_that_grows_was_not_held(good):
    time, angle = good
    for count in (25, 60, 150):
        for first in (0, 200):
            line = seen(time[:count], angle[first : first + count])
            assert line is None or "stands still" not in line
    grows = 1e-3 * np.exp(time / 3)[:, None] * np.cos(5 * time)[:, None] * [1.0, 0.5]
    assert seen(time, grows) is None


def test_an_arm_that_moves_not_at_all_or_is_driven_is_no_ringing_arm(good):
    time, angle = good
    assert seen(time, 0 * angle) is None
    recording = Recording.from_arrays(time, angle + 3.0, drive=0 * angle, noise=1e-3)
    assert doubted(recording) is None


def test_the_file_says_how_or_the_line_names_the_key(good, tmp_path):
    time, angle = good
    write_csv(tmp_path / "x.csv", time, angle + np.array([0.4, -0.5]))
    arm = "link_lengths = [0.4, 0.4]\nshoulder = 1.2\nelbow = 0.6\ncoupling = 1.4\n"
    toml = f'[arm]\n{arm}[[recordings]]\nfile = "x.csv"\ntheta2 = 0\n'
    path = tmp_path / "x.toml"
    path.write_text(toml)
    with pytest.raises(InputError, match=r"x\.toml: \[\[recordings\]\] 1: x\.csv: q\d rings about"):
        load(path)
    path.write_text(toml + 'rest = "estimate"\n')
    (recording,) = load(path).recordings
    np.testing.assert_allclose(recording.angle, angle, atol=2e-3)
    assert recording.understood.startswith("rest at q1 0.")
    path.write_text(toml + 'role = "check"\n')
    with pytest.raises(InputError, match="every recording"):
        load(path)
    assert dataclasses.is_dataclass(recording)


@pytest.mark.parametrize("slips", [False, True])
def test_a_zero_that_all_recordings_share_is_no_slip_of_a_brake(tmp_path, slips):
    """A brake that holds 0.1 m lets the rest go along with the release; a zero stays."""
    time = np.linspace(0, 10, 1001)
    ring = np.exp(-0.2 * time) * np.cos(9.0 * time)
    for i, first in enumerate((0.65, 0.61, 0.58)):
        rest = first - 0.1 if slips else 0.52
        x = rest + (first - rest) * ring
        write_csv(tmp_path / f"{i}.csv", time, x[:, None])
    entries = "".join(f'[[recordings]]\nfile = "{i}.csv"\n' for i in range(3))
    text = '[inertia]\njoints = ["cart"]\nunits = ["m"]\nmatrix = [[1.0]]\n' + entries
    (tmp_path / "x.toml").write_text(text)
    if slips:
        assert len(load(tmp_path / "x.toml").recordings) == 3
        return
    with pytest.raises(InputError, match=r"x\.toml: q1 rings about 0\.52, 0\.52, 0\.52 in"):
        load(tmp_path / "x.toml")
    for entry in ('rest = "estimate"', "rest = [0]"):
        said = text.replace("[[recordings]]", f"[[recordings]]\n{entry}")
        (tmp_path / "y.toml").write_text(said)
        assert len(load(tmp_path / "y.toml").recordings) == 3

"""Recordings and experiments: what is read, what is refused in which words, what is estimated."""

import dataclasses
import io
import math
import re
import sys
from pathlib import Path

import numpy as np
import pytest

import residyn
from residyn.errors import InputError
from residyn.physics.mechanism import ConstantInertia, PlanarArm
from residyn.recordings.csv import read_csv, write_csv
from residyn.recordings.experiment import Experiment, load
from residyn.recordings.noise import estimate_noise
from residyn.recordings.outliers import outlier_mask
from residyn.recordings.recording import Recording
from residyn.recordings.release import release_time
from residyn.recordings.tables import ArmTable, Bearing, InertiaTable
from tests.rig import Arm, simulate

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
measured = pytest.mark.skipif(not DATA.is_dir(), reason="no measured recordings here")

ARM = """[arm]
link_lengths = [0.4, 0.4]
shoulder = 1.1662
elbow = 0.579
coupling = 1.4384
"""
CART = """[inertia]
joints = ["cart"]
matrix = [[0.5685]]
"""
BEARING = """[[air_bearings]]
joint = "wrist"
mass = 1.9635
inertia = 0.00245437
"""
BENT = PlanarArm([0.4, 0.4], 1.1662, 0.579, 1.4384, theta2=0.3)
SLIDING = ConstantInertia(np.diag([2.0, 1.0]))
ARM_TABLE = residyn.ArmTable((0.4, 0.4), 1.1662, 0.579, 1.4384)


def entry(*lines, file="two.csv"):
    return "\n".join(["[[recordings]]", f'file = "{file}"', *lines, ""])


def ringing(rng, seconds=20.0, rate=100.0, noise=0.01, modes=None):
    """Two damped modes, let go from rest: time, readings and the sigma that is in them."""
    t = np.arange(round(seconds * rate)) / rate
    modes = np.exp(rng.uniform(math.log(0.2), math.log(5), 2)) if modes is None else modes
    y = np.zeros_like(t)
    for frequency in modes:
        damping = 2 * math.pi * frequency * math.exp(rng.uniform(math.log(0.002), math.log(0.05)))
        swing = rng.uniform(0.2, 1) * np.cos(2 * math.pi * frequency * t + rng.uniform(0, 0.5))
        y += np.exp(-damping * t) * swing
    sigma = noise * np.abs(y).max()
    return t, y + sigma * rng.standard_normal(len(t)), sigma


def sticking(frequency, rate, friction, seconds=15.0):
    """An oscillator with Coulomb friction (a share of the first spring force) until it sticks.

    Exact: half periods of a cosine about where the spring balances friction.
    """
    t = np.arange(round(seconds * rate)) / rate
    phase = 2 * frequency * t
    half = np.floor(phase).astype(int)
    swing = np.maximum(1 - friction * (2 * half + 1), 0)
    last = np.flatnonzero(1 - 2 * friction * np.arange(half[-1] + 1) <= friction)
    rest = last[0] if len(last) else half[-1] + 1
    sign = (-1.0) ** half
    free = sign * (swing * np.cos(np.pi * (phase - half)) + friction)
    return t, np.where(half < rest, free, (-1.0) ** rest * (1 - 2 * friction * rest))


@pytest.fixture
def folder(tmp_path):
    """A folder with a recording of one joint, one of two, and one that is driven."""
    rng = np.random.default_rng(0)
    t, q, _ = ringing(rng, modes=(1.0, 2.0))
    write_csv(tmp_path / "one.csv", t, q)
    write_csv(tmp_path / "two.csv", t, np.stack([q, -q], axis=1))
    write_csv(tmp_path / "other.csv", t, np.stack([-q, q], axis=1))
    write_csv(tmp_path / "driven.csv", t, np.stack([q, -q], axis=1), np.ones((len(t), 2)))
    return tmp_path


def experiment(folder, *parts):
    path = folder / "experiment.toml"
    path.write_text("\n".join(parts), encoding="utf-8")
    return load(path)


def refusal(folder, *parts):
    """The words with which an experiment is refused: one line that names the file."""
    with pytest.raises(InputError) as caught:
        experiment(folder, *parts)
    line = str(caught.value)
    assert "experiment.toml" in line
    assert len(line.splitlines()) == 1
    return line


# Reading a CSV file


def csv(folder, text, joints=1):
    path = folder / "try.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_csv(path, joints)


def test_reads_columns_in_any_order(tmp_path):
    time, angle, drive, lines = csv(tmp_path, "q2, u1 ,t,q1\n2,5,0,1\n4,6,0.5,3\n", joints=2)
    assert time.tolist() == [0, 0.5]
    assert angle.tolist() == [[1, 2], [3, 4]]
    assert drive is not None
    assert drive.tolist() == [[5, 0], [6, 0]]
    assert lines.tolist() == [2, 3]


@pytest.mark.parametrize(
    "text",
    [
        "t,q1\n0,1\n1,\n2,nan\n3,4\n",
        "t,q1\r\n0,1\r\n1,\r\n2,NaN\r\n3,4\r\n\r\n\r\n",
        "\ufefft,q1\n0,1\n1, \n2, NAN \n3,4",
        " t , q1 \n0 , 1\n 1,\n2,nan\n3,4\n  \n",
    ],
    ids=["plain", "crlf and blank lines", "byte order mark", "spaces"],
)
def test_tolerates(tmp_path, text):
    time, angle, drive, _ = csv(tmp_path, text)
    assert time.tolist() == [0, 1, 2, 3]
    np.testing.assert_array_equal(angle[:, 0], [1, np.nan, np.nan, 4])
    assert drive is None


@pytest.mark.parametrize(
    ("text", "joints", "words"),
    [
        ("", 1, ["is empty"]),
        ("\n\n", 1, ["is empty"]),
        ("t,q1\n", 1, ["no data rows"]),
        ("when,q1\n0,1\n", 1, ["line 1", "no column t", 'has "when", "q1"', "columns = {"]),
        ("0,1\n1,2\n", 1, ["line 1", "names of the columns"]),
        ("t|q1\n0|1\n", 1, ["line 1", "no column t", 'has "t|q1"']),
        ("t;q1\n0;1,5\n1;1.5\n2;1,5\n", 1, ["line 2", "1,5", "decimal sign is", "decimal says"]),
        ("t,q1\n0,0,1,5\n", 1, ["line 2", "4 cells", "decimal commas need another separator"]),
        ("t [h],q1\n0,1\n", 1, ["line 1", '"t [h]"', '"h"', "must be s, ms, us, ns"]),
        ("t,q1 (turns)\n0,1\n", 1, ["line 1", '"turns"', 'units = { q1 = "..." } says which']),
        ("t,q1,q1\n0,1,2\n", 1, ["line 1", '"q1"', "twice"]),
        ("t,q1,q2\n0,1,2\n", 1, ["line 1", "2 q columns", "1 joint"]),
        ("t,q1\n0,1\n", 2, ["line 1", "no column q2"]),
        ("t,q1,u2\n0,1,2\n", 1, ["line 1", '"u2"']),
        ("t,q1\n0,1\n1\n", 1, ["line 3", "1 cell;"]),
        ("t,q1\n0,1\n1,2,3\n", 1, ["line 3", "3 cells"]),
        ("t,q1\n0,1\n\n1,x\n", 1, ["line 4", '"x"']),
        ("t,q1\n0,1\n1,1_0\n", 1, ["line 3", '"1_0"']),
        ("t,q1\n0,\u0661\n", 1, ["line 2", "no number"]),
        ("t,q1\n0,1\n1,inf\n", 1, ["line 3", "infinite"]),
        ("t,q1\n0,1\n1,1e999\n", 1, ["line 3", "infinite"]),
        ("t,q1\n0,1\n,2\n", 1, ["line 3", "no time"]),
        ("t,q1\n0,1\n2,2\n2,3\n", 1, ["line 4", "t = 2"]),
        ("t,q1\n0,1\n2,2\n1,3\n", 1, ["line 4", "t = 1", "t = 2"]),
        (b"t,q1\n0,1\n1,\xff\n", 1, ["line 3", "no number"]),
        (b"t,q1\n0,\x00\n", 1, ["line 2", "not text"]),
    ],
)
def test_refuses(tmp_path, text, joints, words):
    with pytest.raises(InputError) as caught:
        csv(tmp_path, text, joints)
    line = str(caught.value)
    assert len(line.splitlines()) == 1
    for word in ["try.csv", *words]:
        assert word in line


def test_a_cell_too_many_beside_decimal_points_is_no_decimal_comma(tmp_path):
    with pytest.raises(InputError, match=r"line 3: has 3 cells; the header names 2 columns$"):
        csv(tmp_path, "t,q1\n0,1.5\n1,2.5,3\n", 1)


def test_refuses_no_file_and_a_folder(tmp_path):
    with pytest.raises(InputError, match=r"none\.csv: there is no such file"):
        read_csv(tmp_path / "none.csv", 1)
    with pytest.raises(InputError, match="is a folder"):
        read_csv(tmp_path, 1)


def test_one_joint_is_written_without_its_axis():
    file = io.StringIO()
    write_csv(file, np.array([0.0, 1.0]), np.array([2.0, 3.0]))
    assert file.getvalue().startswith("t,q1\n")


def test_refuses_to_write_what_it_could_not_read(tmp_path):
    with pytest.raises(InputError, match="finite"):
        write_csv(tmp_path / "x.csv", np.array([0.0, 1.0]), np.array([1.0, np.inf]))
    with pytest.raises(InputError, match="shape"):
        write_csv(tmp_path / "x.csv", np.array([0.0, 1.0]), np.zeros((3, 1)))
    with pytest.raises(InputError, match="cannot be written"):
        write_csv(tmp_path / "no" / "x.csv", np.array([0.0, 1.0]), np.zeros((2, 1)))


# An experiment


def test_reads_an_experiment(folder):
    here = experiment(
        folder,
        ARM,
        BEARING,
        entry("theta2 = 0.3", "noise = 0.001", "start = 1.0", "stop = 20.0"),
        entry(
            "theta2 = 0",
            "noise = [0.001, 0.002]",
            'role = "check"',
            "air_bearings = false",
            file="other.csv",
        ),
        entry("theta2 = 0.1", 'role = "inertia"', file="driven.csv"),
    )
    assert here.inertia == ArmTable((0.4, 0.4), 1.1662, 0.579, 1.4384)
    assert here.bearings == (Bearing("wrist", 1.9635, 0.00245437),)
    assert here.joints == ("shoulder", "elbow")
    assert here.units == ("rad", "rad")
    assert here.path.endswith("experiment.toml")
    first, second, third = here.recordings
    assert here.fit_recordings == (first,)
    assert here.check_recordings == (second,)
    assert first.name == "two.csv"
    assert first.theta2 == 0.3
    assert first.time[0] == 1.0
    assert first.time[-1] == 19.99
    assert first.duration == pytest.approx(18.99)
    assert first.noise.tolist() == [0.001, 0.001]
    assert first.noise_given
    assert first.drive is None
    assert second.noise.tolist() == [0.001, 0.002]
    assert not second.air_bearings
    assert not third.noise_given
    assert third.drive is not None
    assert here.warnings == ()


def test_reads_a_constant_inertia(folder):
    here = experiment(folder, CART, 'units = ["m"]', entry("extra_mass = 0.986", file="one.csv"))
    assert here.joints == ("cart",)
    assert here.units == ("m",)
    assert here.recordings[0].extra_mass == 0.986
    assert experiment(folder, CART, entry(file="one.csv")).units is None


def test_reads_standard_input(folder, monkeypatch):
    text = CART + entry(file="one.csv")
    monkeypatch.chdir(folder)
    stream = io.TextIOWrapper(io.BytesIO(text.encode()), encoding="utf-8")
    monkeypatch.setattr(sys, "stdin", stream)
    assert load("-").recordings[0].name == "one.csv"
    monkeypatch.setattr(sys, "stdin", io.StringIO("x ="))
    with pytest.raises(InputError, match="standard input: "):
        load("-")


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        # the file
        (["x = "], ["line 1", "TOML"]),
        ([ARM, "shoulder = 2", entry()], ["line 7", "shoulder is there twice"]),
        (["[" * 5000], ["TOML"]),
        (["x = " + "9" * 5000], ["TOML"]),
        # its tables
        ([entry()], ["neither [arm] nor [inertia]"]),
        ([entry("theta2 = 0")], ["neither [arm] nor [inertia]"]),
        ([ARM, CART, entry()], ["both [arm] and [inertia]"]),
        ([ARM], ["[[recordings]]"]),
        (["recordings = 1", ARM], ["[[recordings]]"]),
        (['recordings = ["a.csv"]', ARM], ["[[recordings]]"]),
        (["arm = 3", entry()], ["[arm]"]),
        (["[[arm]]", entry()], ["[arm]"]),
        ([ARM.replace("arm", "arms"), entry()], ['"arms"', 'did you mean "arm"?']),
        ([ARM, "sholder = 1", entry()], ["[arm]", '"sholder"', "shoulder"]),
        ([ARM, entry("nosie = 1")], ["[[recordings]] 1", '"nosie"', "noise"]),
        ([ARM, entry("xyz = 1")], ['"xyz"', "extra_mass"]),
        # [arm]
        ([ARM.replace("1.1662", "true"), entry()], ["shoulder = true"]),
        ([ARM.replace("1.1662", '"1"'), entry()], ['shoulder = "1"', "kg m^2"]),
        ([ARM.replace("1.1662", "nan"), entry()], ["shoulder = nan"]),
        ([ARM.replace("1.1662", "-1"), entry()], ["shoulder = -1", "above 0"]),
        ([ARM.replace("0.579", "0"), entry()], ["elbow = 0"]),
        ([ARM.replace("1.4384", "inf"), entry()], ["coupling = inf"]),
        ([ARM.replace("[0.4, 0.4]", "[0.4]"), entry()], ["link_lengths", "must be two lengths"]),
        ([ARM.replace("[0.4, 0.4]", "[0.4, -1]"), entry()], ["link_lengths = -1"]),
        ([ARM.replace("[0.4, 0.4]", "0.4"), entry()], ["link_lengths = 0.4", "[l1, l2]"]),
        ([ARM.replace("1.4384", "2.5"), entry()], ["coupling = 2.5", "real arm"]),
        ([ARM.replace("elbow", "# elbow"), entry()], ["elbow missing", "Eq. 9", "inertia"]),
        (["[arm]\nlink_lengths = [1, 1]", entry()], ["shoulder, elbow, coupling", "ratios"]),
        (["[arm]", entry()], ["link_lengths is missing"]),
        # [inertia]
        (["[inertia]\njoints = ['a']", entry()], ["matrix is missing"]),
        (["[inertia]\nmatrix = [[1]]", entry()], ["joints is missing"]),
        (["[inertia]\njoints = []\nmatrix = []", entry()], ["joints is empty"]),
        (["[inertia]\njoints = 'a'\nmatrix = [[1]]", entry()], ["joints", "list"]),
        (["[inertia]\njoints = ['']\nmatrix = [[1]]", entry()], ["joints", "empty"]),
        (["[inertia]\njoints = ['a:b']\nmatrix = [[1]]", entry()], ['"a:b"']),
        (["[inertia]\njoints = ['a.b']\nmatrix = [[1]]", entry()], ['"a.b"']),
        (["[inertia]\njoints = [1]\nmatrix = [[1]]", entry()], ["joints has 1"]),
        (["[inertia]\njoints = ['a', 'a']\nmatrix = [[1]]", entry()], ['"a" twice']),
        (["[inertia]\njoints = ['a']\nmatrix = [[1, 2]]", entry()], ["matrix", "1 by 1"]),
        (["[inertia]\njoints = ['a']\nmatrix = 1", entry()], ["matrix", "1 by 1"]),
        (["[inertia]\njoints = ['a']\nmatrix = [['1']]", entry()], ['matrix = "1"']),
        (["[inertia]\njoints = ['a']\nmatrix = [[-1]]", entry()], ["positive definite"]),
        (
            ["[inertia]\njoints = ['a', 'b']\nmatrix = [[1, 2], [2, 1]]", entry()],
            ["positive definite"],
        ),
        (
            ["[inertia]\njoints = ['a', 'b']\nmatrix = [[1, 0.2], [0.1, 1]]", entry()],
            ["matrix = [[1.0, 0.2], [0.1, 1.0]]: must be finite and symmetric"],
        ),
        ([CART, "units = ['deg']", entry()], ["units", '"m" or "rad"']),
        # [[air_bearings]]
        ([ARM, BEARING.replace("wrist", "hand"), entry()], ["[[air_bearings]] 1", '"hand"']),
        ([ARM, BEARING.replace("1.9635", "-1"), entry()], ["mass = -1"]),
        ([ARM, BEARING.replace("mass", "# mass"), entry()], ["mass is missing"]),
        ([ARM, BEARING.replace("1.9635", "1963.5"), entry()], ["air_bearings", "no real arm"]),
        ([CART, BEARING, entry(file="one.csv")], ["air_bearings", "[arm]"]),
        ([ARM, entry("air_bearings = false")], ["air_bearings = false", "[[air_bearings]]"]),
        # [[recordings]]
        ([ARM, "[[recordings]]"], ["[[recordings]] 1", "file is missing"]),
        ([ARM, "[[recordings]]\nfile = 1"], ["file = 1"]),
        ([ARM, entry(file="none.csv")], ["[[recordings]] 1", "none.csv", "no such file"]),
        ([ARM, entry(file="a\\u0000b")], ["[[recordings]] 1", "cannot be read"]),
        ([ARM, entry(file=".")], ["is a folder"]),
        ([ARM, entry(file="one.csv")], ["one.csv, line 1", "no column q2"]),
        ([CART, entry()], ["two.csv, line 1", "2 q columns"]),
        ([ARM, entry('role = "chekc"')], ['role = "chekc"', 'did you mean "check"']),
        ([ARM, entry("role = 1")], ["role = 1"]),
        ([ARM, entry('role = "check"')], ["every recording", "check"]),
        ([ARM, entry('role = "inertia"')], ["two.csv", "u1, u2"]),
        ([ARM, entry('theta2 = "0.3"')], ['theta2 = "0.3"', "rad"]),
        ([ARM, entry("theta2 = nan")], ["theta2 = nan"]),
        ([CART, entry("theta2 = 0", file="one.csv")], ["theta2", "[inertia]"]),
        ([ARM, entry("noise = 0")], ["noise = 0"]),
        ([ARM, entry("noise = true")], ["noise = true"]),
        ([ARM, entry("noise = [1, 2, 3]")], ["noise has 3 numbers", "2 joints"]),
        ([ARM, entry("noise = [1, -2]")], ["noise = -2"]),
        ([ARM, entry("start = -5")], ["start = -5", "0 to 19.99 s"]),
        ([ARM, entry("start = 30")], ["start = 30"]),
        ([ARM, entry("start = true")], ["start = true"]),
        ([ARM, entry('start = "peak"')], ['start = "peak"', '"release"']),
        ([ARM, entry("stop = 30")], ["stop = 30", "0 to 19.99 s"]),
        ([ARM, entry("stop = -1")], ["stop = -1"]),
        ([ARM, entry('stop = "end"')], ['stop = "end"']),
        ([ARM, entry("start = 5", "stop = 5")], ["start = 5", "before stop = 5"]),
        ([ARM, entry("start = 19.9")], ["10 samples", "between start and stop", "20"]),
        ([ARM, entry("air_bearings = 1")], ["air_bearings = 1", "true or false"]),
        (
            [
                ARM,
                entry('own = ["coulomb_friction:elbow"]', "stop = 9"),
                entry("start = 9.5", 'own = ["spring:elbow"]'),
            ],
            ["two.csv: own is", "coulomb_friction:elbow", "spring:elbow", "in another", "one set"],
        ),
        (
            [ARM, entry('own = ["coulomb_friction:elbow"]', "stop = 9"), entry("start = 9.5")],
            ["two.csv: own is [] in one recording of this name"],
        ),
        ([ARM, entry('own = "coulomb_friction:elbow"')], ["own = ", "must be a list of effects"]),
        ([ARM, entry("extra_mass = 1")], ["extra_mass", "[inertia] only"]),
        ([CART, entry("extra_mass = -1", file="one.csv")], ["extra_mass = -1"]),
    ],
)
def test_refuses_an_experiment(folder, parts, words):
    line = refusal(folder, *parts)
    for word in words:
        assert word in line


def test_refuses_no_experiment(tmp_path):
    with pytest.raises(InputError, match="no such file; a TOML file was expected"):
        load(tmp_path / "none.toml")
    (tmp_path / "x.toml").write_bytes(b"\xff\xfe[\x00a")
    with pytest.raises(InputError, match=r"x\.toml, line 1: is not UTF-8"):
        load(tmp_path / "x.toml")


def test_a_name_can_neither_break_the_line_nor_steer_a_terminal(folder):
    line = refusal(folder, ARM, entry(file="a\\nb\\u001b[2J"))
    assert "\x1b" not in line
    assert "\\x1b" in line


def test_inertia_may_be_missing_where_it_is_what_is_looked_for(folder):
    arm = "[arm]\nlink_lengths = [0.4, 0.4]\n"
    here = experiment(folder, arm, entry("theta2 = 0", 'role = "inertia"', file="driven.csv"))
    assert here.inertia == ArmTable((0.4, 0.4), None, None, None)
    line = refusal(folder, arm, entry('role = "inertia"', file="driven.csv"), entry())
    assert "residyn inertia" in line


def test_says_what_it_assumed_about_the_elbow(folder):
    (warning,) = experiment(folder, ARM, entry()).warnings
    assert "two.csv: theta2" in warning
    assert "0 rad is taken" in warning


def test_says_when_a_check_is_none(folder):
    fitted, held = entry("theta2 = 0"), entry("theta2 = 0", 'role = "check"', "start = 15")
    (warning,) = experiment(folder, ARM, fitted, held).warnings
    assert "two.csv: 500 of its samples" in warning
    fitted = entry("theta2 = 0", "stop = 14.99")
    assert experiment(folder, ARM, fitted, held).warnings == ()


def test_windows_of_one_file_are_one_run(folder):
    """A check on a part of a run has the numbers of that run."""
    own = 'own = ["coulomb_friction:elbow"]'
    parts = [entry(own, "theta2 = 0", words) for words in ("stop = 5", "start = 5.5\nstop = 9")]
    held = entry("theta2 = 0", 'role = "check"', "start = 9.5")
    here = experiment(folder, ARM, *parts, held, entry("theta2 = 0", file="other.csv"))
    assert here.own == {"coulomb_friction:elbow": ((1, "two.csv"),)}
    assert [here.run_of(r) for r in here.recordings] == [1, 1, 1, 0]


def test_says_when_readings_are_fitted_twice(folder):
    (folder / "copy.csv").write_bytes((folder / "two.csv").read_bytes())
    one, copy = entry("theta2 = 0"), entry("theta2 = 0").replace("two.csv", "copy.csv")
    assert experiment(folder, ARM, one).warnings == ()
    (warning,) = experiment(folder, ARM, one, copy).warnings
    assert warning.startswith(
        "copy.csv: has the readings of two.csv, so that they are fitted twice"
    )
    (warning,) = experiment(folder, ARM, one, one).warnings
    assert warning.startswith("two.csv: is listed twice, so that its readings are fitted twice")


def test_an_experiment_made_in_python_is_held_to_the_same():
    recording = Recording.from_arrays(*ringing(np.random.default_rng(0))[:2])
    with pytest.raises(InputError, match="angle has 1 joints, the experiment has 2"):
        Experiment(ArmTable((0.4, 0.4), 1.0, 0.5, 0.1), (recording,))
    with pytest.raises(InputError, match="real arm"):
        ArmTable((1.0, 0.4), 1.0, 0.5, 1.0)
    with pytest.raises(InputError, match="positive definite"):
        InertiaTable(("a",), ((0.0,),))
    table = InertiaTable(["a", "b"], np.array([[2, 1], [1, 2]]), ["m", "rad"])  # type: ignore
    assert table == InertiaTable(("a", "b"), ((2.0, 1.0), (1.0, 2.0)), ("m", "rad"))
    here = Experiment(InertiaTable(("a",), ((1.0,),)), (recording,))
    assert here.fit_recordings == (recording,)


@pytest.mark.parametrize(
    ("bodies", "stated", "words"),
    [
        (BENT, {"theta2": 0.9}, "theta2 = 0.9, but PlanarArm has 0.3 .* residyn.ArmTable takes"),
        (BENT, {"load": 2.0}, "load = 2, but PlanarArm has 0"),
        (SLIDING, {"extra_mass": 0.5}, "ConstantInertia has 0 .* residyn.InertiaTable takes"),
        (ARM_TABLE, {"extra_mass": 0.5}, "extra_mass = 0.5, but ArmTable has 0"),
    ],
)
def test_a_pose_or_a_load_that_bodies_cannot_follow_is_refused(bodies, stated, words):
    t, q, _ = ringing(np.random.default_rng(0))
    q = np.stack([q, -q], axis=1)
    own = {key: getattr(bodies, key, 0.0) for key in stated}
    silent, same, other = (Recording.from_arrays(t, q, **how) for how in ({}, own, stated))
    assert Experiment(bodies, [silent]).recordings == (silent,)
    assert Experiment(bodies, [same, same]).recordings == (same, same)
    with pytest.raises(InputError, match=f"recording: .*{words}"):
        Experiment(bodies, [same, other])
    of_masses = residyn.InertiaTable(("a", "b"), ((2, 0), (0, 1)))
    table = of_masses if "extra_mass" in stated else ARM_TABLE
    assert Experiment(table, [same, other]).recordings == (same, other)


def test_what_is_no_inertia_and_no_recording_is_told():
    t, q, _ = ringing(np.random.default_rng(0))
    with pytest.raises(TypeError, match='"arm" is no inertia'):
        Experiment("arm", [Recording.from_arrays(t, q)])  # type: ignore
    with pytest.raises(TypeError, match="ndarray is no recording"):
        Experiment(ARM_TABLE, [q])  # type: ignore


# A recording


def test_counts_and_keeps_what_was_lost():
    t, q, _ = ringing(np.random.default_rng(0))
    q[10:15] = np.nan
    here = Recording.from_arrays(t, np.stack([q, q], axis=1))
    assert here.lost == 10
    assert here.joints == 2
    assert np.isnan(here.angle[10:15]).all()
    with pytest.raises(ValueError, match="read-only"):
        here.angle[0] = 0
    with pytest.raises(dataclasses.FrozenInstanceError):
        here.name = "other"  # type: ignore


def test_copies_what_it_is_given():
    t, q, _ = ringing(np.random.default_rng(0))
    here = Recording.from_arrays(t, q)
    q[:] = 0
    assert here.angle.any()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"angle": np.zeros(5)}, "angle has shape"),
        ({"angle": np.full(400, np.nan)}, "q1 has no reading"),
        ({"angle": np.r_[np.ones(10), np.full(390, np.nan)]}, "q1 has 10 readings; at least 20"),
        ({"angle": np.r_[np.inf, np.ones(399)]}, "infinite"),
        ({"angle": ["a"] * 400}, "array of numbers"),
        ({"angle": np.ones(400) * 1j}, "array of numbers"),
        ({"time": np.zeros(400)}, "sample 1: t = 0 does not come after"),
        ({"time": np.r_[np.nan, 1:400]}, "sample 0 has no time"),
        ({"time": np.zeros((400, 1))}, "time has shape"),
        ({"time": np.arange(400).astype("timedelta64[ms]")}, "array of numbers"),
        ({"drive": np.zeros((400, 2))}, "drive has shape"),
        ({"drive": np.full(400, np.nan)}, "u1 has no value"),
        ({"noise": "x"}, "noise"),
        ({"role": "fitted"}, 'did you mean "fit"'),
        ({"theta2": None}, "theta2 = None"),
        ({"start": [1]}, "start = "),
        ({"time": [], "angle": []}, "0 samples"),
    ],
)
def test_refuses_arrays(change, words):
    given = {"time": np.arange(400) / 100, "angle": np.sin(np.arange(400) / 10)}
    with pytest.raises(InputError) as caught:
        Recording.from_arrays(**(given | change), name="mine")
    assert str(caught.value).startswith("mine: ")
    assert words in str(caught.value)


def test_a_masked_reading_is_a_lost_one():
    t, q, _ = ringing(np.random.default_rng(0))
    here = Recording.from_arrays(t, np.ma.masked_array(q, np.arange(len(q)) < 3))
    assert here.lost == 3


def test_a_gap_in_the_drive_is_filled_and_said():
    t, q, _ = ringing(np.random.default_rng(0))
    drive = 2 * t
    drive[5:8] = np.nan
    here = Recording.from_arrays(t, q, drive=drive)
    assert here.drive is not None
    np.testing.assert_allclose(here.drive[:, 0], 2 * t)
    assert here.warnings == ("recording: u1 has 3 missing values, filled in linearly",)


def test_a_joint_that_never_moves_is_a_warning():
    t, q, sigma = ringing(np.random.default_rng(0))
    here = Recording.from_arrays(t, np.stack([q, np.full_like(q, 0.3)], axis=1))
    assert here.noise == pytest.approx([sigma, sigma], rel=0.1)
    assert any("q2 never moves" in warning for warning in here.warnings)
    here = Recording.from_arrays(t, np.full_like(q, 0.3), noise=0.1)
    assert here.warnings == ("recording: q1 never moves: all its readings are the same",)
    assert Recording.from_arrays(t, np.zeros_like(q)).noise > 0


@pytest.mark.parametrize(
    ("scale", "word"), [(100, "sample count"), (1e3, "milli"), (1e6, "micro"), (1e9, "nano")]
)
def test_warns_of_a_clock_that_does_not_count_seconds(scale, word):
    t, q, _ = ringing(np.random.default_rng(0))
    (warning,) = Recording.from_arrays(t * scale, q).warnings
    assert word in warning
    assert "must be in s" in warning


def test_refuses_degrees_of_a_file_and_of_arrays(folder):
    t, q, _ = ringing(np.random.default_rng(0), modes=(1.0, 2.0))
    table = [np.degrees(0.3 * q), np.degrees(0.2 * q)]
    write_csv(folder / "degrees.csv", t, np.stack(table, axis=1))
    line = refusal(folder, ARM, entry("theta2 = 17", file="degrees.csv"))
    assert "theta2 = 17: in degrees? it must be in rad" in line
    line = refusal(folder, ARM, entry("theta2 = 0.3", file="degrees.csv"))
    assert "degrees.csv: q1 reaches" in line
    assert 'units = { q1 = "deg" }' in line
    units = 'units = { q1 = "deg", q2 = "deg" }'
    assert experiment(folder, ARM, entry("theta2 = 0.3", units, file="degrees.csv")).warnings == ()
    for beyond in (5, -3.2):
        entries = entry(f"theta2 = {beyond}", units, file="degrees.csv")
        (line,) = experiment(folder, ARM, entries).warnings
        assert f"theta2 = {beyond}: in degrees?" in line
    angles = np.stack(table, axis=1)
    for bodies in (ARM_TABLE, BENT):
        made = Recording.from_arrays(t, angles, theta2=17 if bodies is ARM_TABLE else 0.3)
        with pytest.raises(InputError, match=r"recording: .*: in degrees\?"):
            Experiment(bodies, (made,))
        made = Recording.from_arrays(t, angles, theta2=0.3)
        with pytest.raises(InputError, match=r"recording: q1 reaches .*: in degrees\?.* stated ="):
            Experiment(bodies, (made,))
        made = Recording.from_arrays(t, angles, theta2=0.3, stated=["q1", "q2"])
        assert Experiment(bodies, (made,)).warnings == ()
    # The same numbers may be millimetres where nothing says they are angles.
    write_csv(folder / "mm.csv", t, table[0])
    assert experiment(folder, CART, entry(file="mm.csv")).warnings == ()
    (line,) = experiment(folder, CART, 'units = ["m"]', entry(file="mm.csv")).warnings
    assert "mm.csv: q1 reaches" in line
    assert "in mm? it must be in m" in line
    stated = entry('units = { q1 = "mm" }', file="mm.csv")
    assert experiment(folder, CART, 'units = ["m"]', stated).warnings == ()


@pytest.mark.parametrize("role", ["fit", "inertia"])
def test_a_unit_that_is_stated_is_not_doubted(folder, role):
    t = np.arange(200.0)
    angle = 7.0 * np.stack([np.cos(0.2 * t), np.cos(0.3 * t)], axis=1)
    write_csv(folder / "slow.csv", t, angle, np.ones((200, 2)))
    keys = f'role = "{role}"', "theta2 = 0", "noise = 0.01"
    for unit, doubt in (("t", "t goes up by 1:"), ("q1", "q1 reaches 7"), ("q2", "q2 reaches 7")):
        left = {"t": "s", "q1": "rad", "q2": "rad"}
        del left[unit]
        units = ", ".join(f'{key} = "{value}"' for key, value in left.items())
        given = ARM, entry(*keys, f"units = {{ {units} }}", file="slow.csv")
        assert doubt in refusal(folder, *given)
    units = 'units = { t = "s", q1 = "rad", q2 = "rad" }'
    assert experiment(folder, ARM, entry(*keys, units, file="slow.csv")).warnings == ()


# Noise


@pytest.mark.parametrize("rate", [50, 100, 200])
@pytest.mark.parametrize("noise", [0.001, 0.01, 0.05])
def test_noise_is_right_within_five_percent(rate, noise):
    rng = np.random.default_rng(0)
    ratios = []
    for _ in range(30):
        t, q, sigma = ringing(rng, seconds=6000 / rate, rate=rate, noise=noise)
        ratios.append(estimate_noise(t, q)[0] / sigma)
    assert np.max(np.abs(np.array(ratios) - 1)) < 0.05
    assert np.mean(ratios) == pytest.approx(1, abs=0.01)


def test_noise_of_a_short_recording_has_no_bias():
    rng = np.random.default_rng(1)
    cases = [ringing(rng, seconds=10, rate=50, noise=0.01) for _ in range(100)]
    ratios = [estimate_noise(t, q)[0] / sigma for t, q, sigma in cases]
    assert np.mean(ratios) == pytest.approx(1, abs=0.03)


def test_noise_is_blind_to_wild_and_lost_readings_and_uneven_sampling():
    rng = np.random.default_rng(2)
    t = np.sort(rng.uniform(0, 60, 6000))
    q = np.exp(-0.1 * t) * np.cos(2 * np.pi * 1.3 * t) + 0.01 * rng.standard_normal(len(t))
    q[rng.random(len(t)) < 0.01] += rng.choice([-1, 1]) * 0.5
    q[1000:1200] = np.nan
    q[rng.random(len(t)) < 0.1] = np.nan
    assert estimate_noise(t, q) == pytest.approx([0.01], rel=0.06)


def test_noise_is_not_fooled_by_friction():
    rng = np.random.default_rng(3)
    for frequency, friction in ((0.5, 0.01), (1, 0.01), (2, 0.01), (2, 0.003)):
        t, q = sticking(frequency, 100, friction, seconds=40)
        seen = estimate_noise(t, q + 1e-3 * rng.standard_normal(len(t)))
        assert seen == pytest.approx([1e-3], rel=0.06)


def test_noise_of_an_encoder_is_at_least_its_rounding():
    t, q = sticking(2, 200, 0.05)  # at rest for most of the time
    step = 1e-3
    assert estimate_noise(t, step * np.rint(q / step)) == pytest.approx(
        [step / math.sqrt(12)], rel=0.25
    )
    # Printed with few digits, the steps are not quite equal.
    printed = np.array([float(f"{x:.9g}") for x in step / 7 * np.rint(7 * q / step)])
    assert estimate_noise(t, printed)[0] >= step / 7 / math.sqrt(12) * 0.999


def test_noise_that_is_not_there_is_said():
    t = np.arange(2000) / 100
    q = 0.2 * np.exp(-0.1 * t) * np.cos(5 * t)
    here = Recording.from_arrays(t, q)
    assert here.noise[0] == pytest.approx(1e-5 * np.sqrt(np.mean(q**2)), rel=0.1)
    assert "noise of q1 could not be seen" in here.warnings[0]


# Wild readings


def test_hardly_any_clean_reading_is_wild():
    rng = np.random.default_rng(4)
    found = total = 0
    for rate in (50, 100, 200):
        for frequency in (0.5, 1, 2, 4):
            for friction in (0.01, 0.05):
                t, q = sticking(frequency, rate, friction)
                for noise in (0, 1e-4, 1e-3, 1e-2):
                    wild = outlier_mask(t, q + noise * rng.standard_normal(len(t)))
                    found += int(wild.sum())
                    total += wild.size
    assert total > 150_000
    assert found < 1e-4 * total


def test_a_motion_that_is_livelier_just_after_the_release_is_not_wild():
    t, found = np.arange(1000) / 50, 0
    slow = 0.05 * np.exp(-0.1 * t) * np.cos(3.5 * t)
    fast = 0.05 * np.exp(-2 * t) * np.cos(20 * t)  # over after a tenth of the recording
    for seed in range(20):
        noise = 7e-4 * np.random.default_rng(seed).standard_normal(len(t))
        found += int(outlier_mask(t, slow + fast + noise, 7e-4).sum())
    assert found <= 1


@pytest.mark.parametrize("noise", [1e-3, 1e-2])
def test_finds_spikes(noise):
    rng = np.random.default_rng(5)
    hit = count = wrong = total = 0
    for frequency in (0.5, 1, 2):
        t, q = sticking(frequency, 100, 0.01, seconds=60)
        bad = np.zeros(len(t), dtype=bool)
        bad[rng.choice(np.arange(20, len(t) - 20, 25), 60, replace=False)] = True
        size = noise * rng.uniform(9, 30, len(t)) * rng.choice([-1, 1], len(t))
        q = q + noise * rng.standard_normal(len(t)) + np.where(bad, size, 0)
        for known in (None, noise):
            wild = outlier_mask(t, q, known)[:, 0]
            hit, count = hit + int((wild & bad).sum()), count + int(bad.sum())
            wrong, total = wrong + int((wild & ~bad).sum()), total + len(t)
    assert hit > 0.98 * count
    assert wrong < 3e-4 * total


@pytest.mark.parametrize("share", [0.01, 0.03, 0.05])
def test_spikes_are_found_where_most_stretches_have_one(share):
    """Each is in all degrees of its stretch, so that most of these seem to be noise of its size."""
    rng = np.random.default_rng(5)
    t = np.arange(1600) / 80
    q = 0.2 * np.exp(-0.03 * t) * np.cos(6 * t) + 0.1 * np.exp(-0.1 * t) * np.sin(12 * t)
    q = q + 8e-4 * rng.standard_normal(len(t))
    spikes = rng.random(len(t)) < share
    q[spikes] += rng.choice([-1, 1], spikes.sum()) * rng.uniform(0.05, 0.3, spikes.sum())
    wild = outlier_mask(t, q[:, None])[:, 0]
    assert (wild & spikes).sum() >= 0.95 * spikes.sum()
    assert (wild & ~spikes).sum() <= 0.4 * spikes.sum()
    assert estimate_noise(t, q[:, None]) == pytest.approx([8e-4], rel=0.15)


@pytest.mark.parametrize("size", [1.0, 17.4])
def test_finds_spikes_however_large(size):
    t, q = sticking(1.0, 100, 0.01, seconds=20)
    q = q + 1e-4 * np.random.default_rng(7).standard_normal(len(t))
    q[[300, 900]] = size
    q[1500:1504] = -size
    assert np.flatnonzero(outlier_mask(t, q)).tolist() == [300, 900, 1500, 1501, 1502, 1503]


@pytest.mark.parametrize("length", [2, 3, 4])
def test_finds_short_runs(length):
    rng = np.random.default_rng(6)
    t, q = sticking(1.0, 100, 0.01, seconds=60)
    bad = np.zeros(len(t), dtype=bool)
    for first in range(50, len(t) - 50, 150):
        bad[first : first + length] = True
    q = q + 1e-3 * rng.standard_normal(len(t)) + 0.02 * bad
    q = np.where(np.arange(len(t)) % 97 == 5, np.nan, q)
    wild = outlier_mask(t, np.stack([q, -q], axis=1))
    assert wild.shape == (len(t), 2)
    lost = np.isnan(q)
    assert (wild[bad & ~lost] == 1).mean() > 0.97
    assert wild[~bad].mean() < 3e-4
    assert not wild[lost].any()


# The release


def braked_arm(rng, rate, seconds=15.0):
    """Two joints of a linear arm, let go from rest: exact, by its modes."""
    matrix = np.array([[2.5, 0.8], [0.8, 0.6]])
    stiffness = np.diag(rng.uniform([20, 5], [80, 30]))
    low = np.linalg.inv(np.linalg.cholesky(matrix))
    squares, shapes = np.linalg.eigh(low @ stiffness @ low.T)
    shapes = low.T @ shapes
    start = rng.uniform(0.05, 0.4, 2) * rng.choice([-1, 1], 2)
    t = np.arange(round(seconds * rate)) / rate
    w = np.sqrt(squares)
    z = 0.01 * w
    wd = np.sqrt(w**2 - z**2)
    wave = np.exp(-z * t[:, None]) * (np.cos(wd * t[:, None]) + z / wd * np.sin(wd * t[:, None]))
    return t, wave * np.linalg.solve(shapes, start) @ shapes.T, 2 * np.pi / w[0]


@pytest.mark.parametrize("rate", [50, 100, 200])
def test_finds_the_release_of_an_arm(rate):
    rng = np.random.default_rng(7)
    late = []
    for _ in range(20):
        _t, q, period = braked_arm(rng, rate)
        pull, hold = round(rng.uniform(0.5, 2) * rate), round(rng.uniform(0, 3) * rate)
        ramp = (1 - np.cos(np.linspace(0, np.pi, pull)))[:, None] / 2 * q[0]
        before = np.concatenate([np.zeros((rate, 2)), ramp, np.repeat(q[:1], hold, axis=0)])
        q = np.concatenate([before, q])
        q = q + 1e-3 * rng.standard_normal(q.shape)
        found = release_time(np.arange(len(q)) / rate, q)
        late.append((found - len(before) / rate) / period)
    # Never while the hand is on, and at the cost of a small part of the slow period.
    assert min(late) > -1.5 / rate
    assert np.median(late) < 0.1
    assert max(late) < 1


@pytest.mark.parametrize(
    ("theta2", "q0"),
    [(1.2, (0.15, 0.2)), (1.2, (0.15, 0.0)), (-0.8, (0.1, 0.15)), (2.0, (0.2, 0.2))],
)
def test_an_arm_with_its_elbow_bent_is_let_go_when_it_is(theta2, q0):
    """Its inertia's own torques are a tenth of those of the springs, and no hand's."""
    arm = Arm(
        l1=0.55, l2=0.35, shoulder=2.055, elbow=0.3115, coupling=0.83, theta2=theta2,
        stiffness=(48.0, 9.5), damping=(0.7, 0.15),
    )  # fmt: skip
    q, _ = simulate(arm, np.arange(1500) / 100, q0)
    held = np.concatenate([np.repeat(q[:1], 150, axis=0), q])
    noise = np.random.default_rng(9).standard_normal(held.shape)
    for sigma in (0.0, 3e-4):
        readings = held + sigma * noise
        here = Recording.from_arrays(np.arange(len(held)) / 100, readings, start="release")
        assert 1.5 <= here.time[0] < 1.6  # of 1.4 to 1.9 s that a swing takes
        assert here.understood == f"release found at {here.time[0]:g} s"
        assert release_time(np.arange(len(q)) / 100, readings[150:]) == 0.0


def test_a_recording_that_begins_free_is_kept_whole():
    rng = np.random.default_rng(8)
    t, q, period = braked_arm(rng, 100)
    assert release_time(t, q + 1e-3 * rng.standard_normal(q.shape)) < 0.1 * period
    here = Recording.from_arrays(t, q + 1e-3 * rng.standard_normal(q.shape), start="release")
    assert here.time[0] < 0.1 * period


def test_a_release_needs_a_decay():
    t = np.arange(500) / 100
    for q in (np.exp(2 * t), np.ones(500)):
        with pytest.raises(InputError, match="give start in seconds"):
            Recording.from_arrays(t, q, start="release")


def test_release_does_not_look_past_the_stop():
    _t, q = sticking(1.0, 100, 0.01)
    q = np.concatenate([np.zeros(100), q, 5 * q])
    here = Recording.from_arrays(np.arange(len(q)) / 100, q, start="release", stop=15.0)
    assert 0.9 < here.time[0] < 1.2
    assert here.time[-1] == 15.0


# Measured recordings


def carts():
    return sorted((DATA / "carts").glob("*.csv")) if DATA.is_dir() else []


@measured
@pytest.mark.parametrize("path", carts(), ids=[path.stem for path in carts()])
def test_carts(path):
    time, angle, _, _ = read_csv(path, 1)
    step = 0.001 / 56  # one encoder count
    assert 1.0 <= estimate_noise(time, angle)[0] / (step / math.sqrt(12)) < 1.25
    assert outlier_mask(time, angle).sum() <= 1
    here = Recording.from_arrays(time, angle, start="release", name=path.name)
    assert here.warnings == ()

    q = angle[:, 0] - np.median(angle[-50:])
    stiffness = 712.6 if "high" in path.stem else 175.3
    mass = 0.5685 + (0.986 if "loaded" in path.stem else 0)
    period = 2 * np.pi * math.sqrt(mass / stiffness)
    peak = int(np.abs(q).argmax())
    assert 0 <= here.time[0] - time[peak] < period / 4

    # The acceleration from there on is the spring's, the rest being friction: no hand.
    w = max(2, round(period / 0.005 / 18))
    window = np.polynomial.polynomial.polyvander(np.arange(-w, w + 1) * 0.005, 4)
    place, speed, half = np.linalg.pinv(window)[:3]
    free = int(np.searchsorted(time, here.time[0] - 1e-9))
    at = np.arange(free + w // 2, free + round(period / 0.005))
    near = q[at[:, None] + np.arange(-w, w + 1)]
    x, v, a = near @ place, near @ speed, 2 * near @ half
    law = np.stack([x, v, np.sign(v)], axis=1)
    fitted = np.linalg.lstsq(law, a, rcond=None)[0]
    assert -fitted[0] == pytest.approx(stiffness / mass, rel=0.06)
    assert np.abs(a - law @ fitted).max() < 0.15 * np.abs(a).max()


@measured
@pytest.mark.parametrize(
    ("file", "joints"),
    [
        ("double_pendulum/free_swing.csv", 2),
        ("emps/identification.csv", 1),
        ("emps/validation.csv", 1),
        ("air_track/one_mass_1.csv", 1),
    ],
)
def test_measured_recordings_raise_no_doubt(file, joints):
    time, angle, drive, _ = read_csv(DATA / file, joints)
    here = Recording.from_arrays(time, angle, drive=drive)
    assert here.warnings == ()
    assert outlier_mask(time, angle).mean() < 1e-3
    units = ("rad",) * joints if "pendulum" in file else ("m",) * joints
    names = tuple("ab"[:joints])
    table = InertiaTable(names, tuple(map(tuple, np.eye(joints).tolist())), units)
    assert Experiment(table, (here,)).warnings == ()
    if "air_track" in file:  # read to whole pixels
        assert here.noise[0] == pytest.approx(1e-3 / math.sqrt(12), rel=0.3)
        assert release_time(time, angle) == 0.0  # it begins free, at its largest


def test_a_million_samples_become_means_and_that_is_said():
    t = np.arange(1_000_001) / 1e4
    q = 0.1 * np.exp(-0.02 * t) * np.cos(9 * t) + 1e-3 * np.random.default_rng(0).standard_normal(
        len(t)
    )
    q[5], q[7777], q[400:440] = 3.0, -2.0, np.nan
    here = Recording.from_arrays(t, q)
    assert len(here.time) == 90_909
    np.testing.assert_allclose(np.diff(here.time), 11e-4)
    np.testing.assert_allclose(here.noise, 1e-3 / np.sqrt(11), rtol=0.02)
    truth = 0.1 * np.exp(-0.02 * here.time) * np.cos(9 * here.time)
    assert np.nanmax(np.abs(here.angle[:, 0] - truth)) < 3e-3
    assert here.lost == 4
    assert "has 1000001 samples: means of 11 are taken, which leaves 90909" in here.warnings[0]
    given = Recording.from_arrays(t, q, noise=1e-3)
    np.testing.assert_allclose(given.noise, 1e-3 / np.sqrt(11))


def sliding(time, amplitude, slip):
    """Where a mass on a spring of 1 swing/s is, (N, 1) m, let go at rest `amplitude` from the
    spring's own rest and braked by dry friction that holds it `slip` from there."""
    half = np.floor(2 * time).astype(int)
    stops = max(0, math.ceil((amplitude - slip) / (2 * slip)))
    half, phase = np.minimum(half, stops), np.where(half < stops, 2 * np.pi * time, np.pi * stops)
    size = np.where(half < stops, amplitude - (2 * half + 1) * slip, 0.0)
    last = (-1.0) ** stops * (amplitude - 2 * stops * slip)
    return np.where(half < stops, size * np.cos(phase) + (-1.0) ** half * slip, last)[:, None]


@pytest.mark.parametrize(("amplitude", "seconds"), [(0.11, 8.0), (0.11, 40.0), (0.05, 20.0)])
def test_a_rest_is_found_from_the_ringing_and_not_from_where_dry_friction_holds(amplitude, seconds):
    slip = 0.006
    time = np.arange(0.0, seconds, 0.01)
    rng = np.random.default_rng(0)
    angle = 0.12 + sliding(time, amplitude, slip) + 1e-4 * rng.standard_normal((len(time), 1))
    assert abs(angle[-1, 0] - 0.12) > 0.3 * slip
    found = Recording.from_arrays(time, angle, rest="estimate")
    assert angle[0, 0] - found.angle[0, 0] == pytest.approx(0.12, abs=0.02 * slip)
    (line,) = [x for x in found.warnings if "known roughly" in x]
    swings = float(re.search(r"with (\S+) swings", line)[1])
    assert swings == pytest.approx(amplitude / (4 * slip), rel=0.3)


def test_a_rest_that_is_known_roughly_is_each_recordings_own():
    time = np.arange(0.0, 3.0, 0.01)
    angle = 0.2 + 0.04 * np.exp(-0.1 * time) * np.cos(2 * np.pi * time)
    found = Recording.from_arrays(time, angle[:, None], rest="estimate")
    (line,) = [x for x in found.warnings if "known roughly" in x]
    assert 'own = ["sensor_offset"] in all of these but one' in line
    assert found.rest_estimated
    assert not Recording.from_arrays(time, angle[:, None], rest=[0.2]).rest_estimated


@pytest.mark.parametrize("first", [0.3, 0.1])
def test_the_rest_of_what_never_moves_is_where_it_stands(first):
    angle = np.full((200, 1), 0.3)
    angle[0] = first
    found = Recording.from_arrays(np.arange(200) * 0.02, angle, rest="estimate", noise=1e-3)
    np.testing.assert_allclose(found.angle[1:], 0.0, atol=1e-3)


def test_a_file_in_which_no_joint_moves_says_so_whatever_its_rest(tmp_path):
    rows = [f"{0.02 * i:.2f},0.3" for i in range(200)]
    (tmp_path / "one.csv").write_text("\n".join(["t,q1", *rows]))
    table = "[inertia]\njoints = ['cart']\nunits = ['m']\nmatrix = [[1.0]]\n"
    text = f"{table}[[recordings]]\nfile = 'one.csv'\nrest = 'estimate'\n"
    (tmp_path / "e.toml").write_text(text)
    with pytest.raises(InputError, match="no joint moves"):
        load(tmp_path / "e.toml")


def test_one_sample_is_called_one():
    with pytest.raises(InputError, match="has 1 sample; at least"):
        Recording.from_arrays(np.zeros(1), np.zeros((1, 1)))

"""A lab's own files in an experiment: marker files, C3D, MATLAB, Parquet; what is refused."""

import numpy as np
import pytest
from scipy.io import savemat

from residyn.cli import main
from residyn.errors import InputError
from residyn.recordings.csv import write_csv
from residyn.recordings.experiment import load
from residyn.recordings.motion_capture import angles as motion_capture
from residyn.recordings.motion_capture.trajectories import read_trajectories
from tests.marker_files import placed, swinging, vicon

NAMES = ["Shoulder", "Elbow", "Wrist"]
ARM = """[arm]
link_lengths = [0.4, 0.3]
shoulder = 1.1662
elbow = 0.579
coupling = 1.2
"""
MARKERS = 'markers = ["Shoulder", "Elbow", "Wrist"]'


def positions(frames=200):
    """(frames, 3, 3) m, and the angles that are in them."""
    _, angle, pose = swinging(np.random.default_rng(0), frames=frames, bend=0.9)
    return placed(angle, [0.4, 0.3]), angle, pose


def experiment(folder, *lines, file="trial.csv"):
    path = folder / "experiment.toml"
    path.write_text("\n".join([ARM, "[[recordings]]", f'file = "{file}"', *lines, ""]))
    return load(path)


def refusal(folder, *lines, file="trial.csv"):
    with pytest.raises(InputError) as caught:
        experiment(folder, *lines, file=file)
    line = str(caught.value)
    assert "experiment.toml: [[recordings]] 1" in line
    assert file in line
    assert len(line.splitlines()) == 1
    return line


def trial(folder, text, name="trial.csv"):
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


# Vicon's CSV


@pytest.mark.parametrize(
    "options",
    [
        {"newline": "\r\n"},
        {"between": ";"},
        {"between": ";", "decimal": ","},
        {"between": "\t"},
        {"unit": "m"},
        {"unit": "cm"},
        {"subject": ""},
        {"tail": ",,"},
        {"before": "\n"},
        {"before": "Devices\n1000\n,,Force\nFrame,Sub Frame,Fx\n,,N\n1,0,3\n1,1,4\n"},
        {"after": "\nModel Outputs\n100\n,,Arm:Angle,,\nFrame,Sub Frame,X,Y,Z\n"},
        {"first": 4711},
    ],
    ids=lambda options: next(iter(options)),
)
def test_reads_what_nexus_and_others_write(tmp_path, options):
    here, _, _ = positions()
    here[7, 1] = np.nan
    text = vicon(here, NAMES, rate=250, **options)
    found = read_trajectories(trial(tmp_path, b"\xef\xbb\xbf" + text.encode()))
    np.testing.assert_allclose(found.of(NAMES), here, atol=1e-6)
    np.testing.assert_allclose(found.time, np.arange(200) / 250)
    assert found.frame[0] == options.get("first", 1)


@pytest.mark.parametrize("encoding", ["cp1252", "utf-16"])
def test_a_marker_file_is_text_as_any_table_is(tmp_path, encoding):
    here, _, _ = positions()
    trial(tmp_path, vicon(here, NAMES, subject="Prüfling:").encode(encoding))
    (seen,) = experiment(tmp_path, 'markers = ["Prüfling:Shoulder", "Elbow", "Wrist"]').recordings
    assert seen.joints == 2


def test_frames_that_are_not_there_leave_a_gap_in_time(tmp_path):
    lines = vicon(positions()[0], NAMES).split("\n")
    del lines[50:60]
    time = read_trajectories(trial(tmp_path, "\n".join(lines))).time
    assert np.diff(time).max() == pytest.approx(0.11)


def test_a_marker_at_the_very_origin_or_half_seen_is_lost(tmp_path):
    here, _, _ = positions()
    here[3, 0] = 0.0
    here[4, 1, 2] = np.nan
    found = read_trajectories(trial(tmp_path, vicon(here, NAMES))).of(NAMES)
    assert np.isnan(found[3, 0]).all()
    assert np.isnan(found[4, 1]).all()


@pytest.mark.parametrize(
    ("line", "text", "words"),
    [
        (2, "fast", '"fast" is no number'),
        (2, "0", "no frame rate"),
        (3, ",,,,,", "names no marker"),
        (3, ",,A,,,A,,,B,,", 'marker "A" appears twice'),
        (4, "Time,X,Y,Z", "line 1: after"),
        (5, ",,in,in,in,in,in,in,in,in,in", 'unit "in": must be mm, cm, m'),
        (9, "x,0,1,2,3", '"x" is no number of a frame'),
        (9, "2,0,1,2,3", "frame 2 comes after frame 3"),
        (9, "4,0,1,2,three", '"three" is no number'),
    ],
)
def test_refuses_with_the_line(tmp_path, line, text, words):
    lines = vicon(positions()[0], NAMES).split("\n")
    lines[line - 1] = text
    trial(tmp_path, "\n".join(lines))
    said = refusal(tmp_path, MARKERS)
    assert words in said
    assert f"line {line}" in said or "line 1:" in said


def test_names_that_two_subjects_have_must_be_given_in_full(tmp_path):
    here, _, _ = positions()
    both = np.concatenate([here, here + 1], axis=1)
    names = [f"{who}:{name}" for who in ("A", "B") for name in NAMES]
    path = trial(tmp_path, vicon(both, names, subject=""))
    with pytest.raises(InputError, match='could be "A:Shoulder" and "B:Shoulder"'):
        motion_capture.read(path, NAMES)
    assert motion_capture.read(path, names[3:]).repairs == ()


# C3D


def c3d_file(path, position, unit="mm", labels=NAMES):
    ezc3d = pytest.importorskip("ezc3d")
    contents = ezc3d.c3d()
    contents["parameters"]["POINT"]["RATE"]["value"] = [100]
    contents["parameters"]["POINT"]["LABELS"]["value"] = labels
    contents["parameters"]["POINT"]["UNITS"]["value"] = [unit]
    points = np.ones((4, position.shape[1], len(position)))
    points[:3] = position.transpose(2, 1, 0) * (1000 if unit == "mm" else 1)
    contents["data"]["points"] = points
    contents.write(str(path))


@pytest.mark.parametrize("unit", ["mm", "m"])
def test_c3d_gives_what_csv_gives(tmp_path, unit):
    here, _, _ = positions()
    here[20:24, 2] = np.nan
    here[80:120, [1, 2]] = here[80:120, [2, 1]]
    c3d_file(tmp_path / "trial.c3d", here, unit)
    trial(tmp_path, vicon(here, NAMES))
    one = motion_capture.read(tmp_path / "trial.c3d", NAMES)
    other = motion_capture.read(tmp_path / "trial.csv", NAMES)
    np.testing.assert_allclose(one.angle, other.angle, atol=1e-5)
    assert one.repairs == other.repairs
    seen = experiment(tmp_path, MARKERS, file="trial.c3d").recordings[0]
    assert seen.joints == 2


def test_refuses_what_is_no_c3d(tmp_path):
    pytest.importorskip("ezc3d")
    trial(tmp_path, "t,q1\n", "trial.c3d")
    assert "is not a C3D file" in refusal(tmp_path, MARKERS, file="trial.c3d")
    trial(tmp_path, b"\x02\x50" + bytes(2000), "half.c3d")
    assert "half.c3d" in refusal(tmp_path, MARKERS, file="half.c3d")
    assert "there is no such file" in refusal(tmp_path, MARKERS, file="none.c3d")


@pytest.mark.parametrize(
    ("module", "extra", "file"),
    [("ezc3d", "residyn[c3d]", "trial.c3d"), ("pyarrow", "residyn[parquet]", "trial.parquet")],
)
def test_a_missing_extra_is_named(tmp_path, monkeypatch, module, extra, file):
    monkeypatch.setitem(__import__("sys").modules, module, None)
    trial(tmp_path, b"\x02\x50", file)
    assert f"pip install '{extra}'" in refusal(tmp_path, *[MARKERS] * ("c3d" in file), file=file)


# In an experiment


def test_an_experiment_reads_markers_and_says_what_it_repaired(tmp_path):
    here, angle, pose = positions(1500)
    here[300:400, [1, 2]] = here[300:400, [2, 1]]
    here[700:705, 2] = np.nan
    trial(tmp_path, vicon(here, NAMES))
    loaded = experiment(tmp_path, MARKERS)
    (seen,) = loaded.recordings
    assert seen.name == "trial.csv"
    assert seen.theta2 == pytest.approx(pose[1], abs=2e-3)
    np.testing.assert_allclose(np.ptp(seen.angle - angle, axis=0)[0], 0, atol=1e-4)
    assert seen.lost == 5
    text = "\n".join(loaded.warnings)
    assert 'trial.csv: "Elbow" and "Wrist" had exchanged labels from 3 to 3.99 s' in text
    assert 'trial.csv: "Wrist": lost in 5 of 1500 frames' in text
    assert "0 rad is taken" not in text


def test_the_keys_are_checked(tmp_path):
    here, angle, _ = positions()
    trial(tmp_path, vicon(here, NAMES))
    assert 'the file has "Arm:Shoulder", "Arm:Elbow"' in refusal(tmp_path)
    assert "must have 3, one more than links" in refusal(tmp_path, 'markers = ["Elbow", "Wrist"]')
    assert "must be three numbers" in refusal(tmp_path, MARKERS, "normal = [0, 1]")
    assert "must point somewhere" in refusal(tmp_path, MARKERS, "normal = [0, 0, 0]")
    assert "needs the drive" in refusal(tmp_path, MARKERS, 'role = "inertia"')
    write_csv(tmp_path / "plain.csv", np.arange(200) / 100, angle)
    assert "markers is for files of markers" in refusal(tmp_path, MARKERS, file="plain.csv")
    assert experiment(tmp_path, "normal = [0, 0, 1]", MARKERS).recordings[0].joints == 2


def test_a_sliding_joint_has_no_marker_angles(tmp_path):
    trial(tmp_path, vicon(positions()[0], NAMES))
    path = tmp_path / "cart.toml"
    table = '[inertia]\njoints = ["a", "b"]\nunits = ["m", "rad"]\nmatrix = [[1, 0], [0, 1]]\n'
    path.write_text(f'{table}[[recordings]]\nfile = "trial.csv"\n{MARKERS}\n')
    with pytest.raises(InputError, match="markers give angles, but a joint is in m"):
        load(path)


def test_the_command_ends_with_two_and_one_line(tmp_path, capsys):
    trial(tmp_path, vicon(positions()[0], NAMES))
    path = tmp_path / "experiment.toml"
    path.write_text(f'{ARM}[[recordings]]\nfile = "trial.csv"\nmarkers = ["Elbow"]\n')
    assert main(["fit", str(path), "--no-cache"]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert "markers has 1 names" in err.splitlines()[-1]


# MATLAB and Parquet


def table():
    """Columns by name, with a lost sample and a drive."""
    _, angle, _ = swinging(np.random.default_rng(1), frames=100)
    angle[3, 1] = np.nan
    t = np.arange(100) / 100
    return {"t": t, "q1": angle[:, 0], "q2": angle[:, 1], "u2": np.sin(t)}


def as_variables(c):
    return c | {"note": "made by hand", "other": np.eye(3)}


def as_columns(c):
    return {name: column[:, None] for name, column in c.items()}


def as_struct(c):
    return {"trial": c}


def as_matrices(c):
    return {
        "t": c["t"],
        "q": np.stack([c["q1"], c["q2"]], axis=1),
        "u": np.stack([0 * c["t"], c["u2"]], axis=1),
    }


@pytest.mark.parametrize("form", [as_variables, as_columns, as_struct, as_matrices])
def test_reads_matlab(tmp_path, form):
    columns = table()
    savemat(tmp_path / "trial.mat", form(columns))
    (seen,) = experiment(tmp_path, "theta2 = 0", file="trial.mat").recordings
    np.testing.assert_array_equal(seen.angle, np.stack([columns["q1"], columns["q2"]], axis=1))
    assert seen.drive is not None
    np.testing.assert_array_equal(seen.drive[:, 1], columns["u2"])
    assert not seen.drive[:, 0].any()


def test_reads_parquet(tmp_path):
    arrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    columns = table()
    cells = {name: arrow.array(column, from_pandas=True) for name, column in columns.items()}
    parquet.write_table(
        arrow.table(cells | {"__index_level_0__": np.arange(100)}), tmp_path / "trial.parquet"
    )
    (seen,) = experiment(tmp_path, "theta2 = 0", file="trial.parquet").recordings
    np.testing.assert_array_equal(seen.angle, np.stack([columns["q1"], columns["q2"]], axis=1))
    assert seen.drive is not None


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"t": None}, "no column t; must have the columns t,q1,q2, and u1,u2 if driven"),
        ({"q2": None}, "there is no column q2"),
        ({"q3": np.zeros(100)}, 'has 3 q columns, up to "q3", but the experiment has 2 joints'),
        ({"q1": np.zeros(99)}, "q1 has shape (99,): must be (100,), as long as t"),
        ({"q1": "zeros"}, "q1 must have numbers"),
        ({"t": np.zeros(100)}, "time must increase"),
    ],
)
def test_refuses_matlab(tmp_path, change, words):
    columns = {k: v for k, v in (table() | change).items() if v is not None}
    savemat(tmp_path / "trial.mat", columns)
    assert words in refusal(tmp_path, file="trial.mat")


def test_a_name_twice_in_a_file_matters_where_it_is_needed(tmp_path):
    arrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    columns = table()
    for name, words in (("note", ""), ("q1", 'column "q1" appears twice')):
        names = [*columns, "note", name]
        cells = [arrow.array(column) for column in (*columns.values(), columns["t"], columns["t"])]
        parquet.write_table(arrow.table(cells, names=names), tmp_path / "trial.parquet")
        if words:
            assert words in refusal(tmp_path, file="trial.parquet")
        else:
            assert experiment(tmp_path, "theta2 = 0", file="trial.parquet").recordings
    savemat(tmp_path / "trial.mat", columns | {"q": np.zeros((100, 2))})
    assert 'column "q1" appears twice' in refusal(tmp_path, file="trial.mat")


def test_a_reading_is_named_by_its_sample_where_a_file_has_no_lines(tmp_path):
    t = np.arange(200) / 50
    angle = 0.2 * np.stack([np.cos(9 * t), np.cos(15 * t)], axis=1)
    angle[50:71, 1] = 17.44
    savemat(tmp_path / "trial.mat", {"t": t, "q": angle})
    said = refusal(tmp_path, "theta2 = 0", 'units = { q2 = "rad" }', file="trial.mat")
    assert "samples 50 to 70 (21 readings)" in said


@pytest.mark.parametrize("file", ["x.mat", "x.c3d", "x.pq", "x.csv"])
def test_a_recording_in_the_place_of_an_experiment_is_sent_to_what_reads_it(tmp_path, file):
    trial(tmp_path, vicon(positions()[0], NAMES), file)
    with pytest.raises(InputError, match="is a recording and no experiment") as caught:
        load(tmp_path / file)
    assert f'name it in an experiment file, as file = "{file}"' in str(caught.value)
    assert "residyn new" not in str(caught.value)


def test_a_damaged_matlab_file_is_refused(tmp_path):
    savemat(tmp_path / "trial.mat", table(), do_compression=True)
    content = bytearray((tmp_path / "trial.mat").read_bytes())
    content[200:260] = bytes(60)
    trial(tmp_path, bytes(content), "trial.mat")
    assert "is no MATLAB file that can be read" in refusal(tmp_path, file="trial.mat")


def test_refuses_what_is_neither(tmp_path):
    pytest.importorskip("pyarrow")
    for name in ("trial.mat", "trial.parquet"):
        trial(tmp_path, "t,q1\n0,1\n" * 40, name)
        assert "that can be read" in refusal(tmp_path, file=name)
        assert "there is no such file" in refusal(tmp_path, file=f"no-{name}")
    trial(tmp_path, b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + bytes(400), "new.mat")
    assert "save it with '-v7'" in refusal(tmp_path, file="new.mat")
    savemat(tmp_path / "two.mat", {"a": table(), "b": table()})
    assert "several structs" in refusal(tmp_path, file="two.mat")

"""`residyn example` and `residyn new`: what they write is ready to run, or says what is missing."""

import numpy as np
import pytest

from residyn.cli import main
from residyn.demo import EXAMPLES
from residyn.errors import InputError
from residyn.recordings.experiment import load
from tests.recordings.test_csv_dialects import COLUMNS, DIALECTS, T, table

Q = np.stack([0.2 * np.cos(40 * T), -0.1 * np.cos(70 * T)], axis=1)
FILLED = {"link_lengths": "[0.4, 0.4]", "shoulder": "1.2", "elbow": "0.6", "coupling": "1.4"}


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_is_written_whole_and_once(name, tmp_path, capsys):
    folder = tmp_path / "new" / "folder"
    assert main(["example", str(folder), name]) == 0
    out = capsys.readouterr().out
    assert f"next: {EXAMPLES[name][2]} {folder / EXAMPLES[name][1]}" in out
    experiment = load(folder / EXAMPLES[name][1])
    assert {r.name for r in experiment.recordings} <= {f.name for f in folder.iterdir()}
    assert all(r.understood == "" for r in experiment.recordings)
    assert (folder / "pendulum-LICENSE.txt").exists() == (name == "pendulum")
    assert main(["example", str(folder), name]) == 2
    assert "is there already" in capsys.readouterr().err


def test_all_examples_go_into_one_folder(tmp_path):
    assert {main(["example", str(tmp_path), name]) for name in EXAMPLES} == {0}


def test_examples_that_are_none(tmp_path, capsys):
    assert main(["example", str(tmp_path), "nothing"]) == 2
    assert "it is release, driven, bearings, pendulum" in capsys.readouterr().err
    (tmp_path / "file").write_text("")
    assert main(["example", str(tmp_path / "file" / "folder")]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_the_inertias_of_the_driven_example(tmp_path, capsys):
    main(["example", str(tmp_path), "driven"])
    assert main(["inertia", str(tmp_path / "driven.toml"), "--no-cache"]) == 0
    line = next(x for x in capsys.readouterr().out.splitlines() if x.startswith("shoulder = "))
    assert float(line.split()[2]) == pytest.approx(2.9640 - 0.5920 - 0.8 * 1.4384, rel=0.01)


def made(folder, *files):
    """The text that `residyn new` writes, and the experiment once each "?" is filled in."""
    path = folder / "new.toml"
    assert main(["new", str(path), *map(str, files)]) == 0
    text = path.read_text()
    lines = []
    for line in text.splitlines():
        key = line.split(" = ")[0]
        value = FILLED.get(key, "0.3" if key == "theta2" else None)
        lines.append(f"{key} = {value}" if "?" in line and value else line)
    (folder / "filled.toml").write_text("\n".join(lines))
    return text, load(folder / "filled.toml")


def test_new_from_a_german_file(tmp_path, capsys):
    header = "Zeit [ms];Schulter (Grad);Ellbogen (Grad);Bemerkung"
    content = table(
        header, 1e3 * T, np.degrees(Q), sep=";", point=",", more=lambda i: ["gut"], above="Labor\n"
    )
    (tmp_path / "x.csv").write_bytes(content.encode("latin-1"))
    text, experiment = made(tmp_path, tmp_path / "x.csv")
    assert COLUMNS in text
    assert 'file = "x.csv"' in text
    np.testing.assert_allclose(experiment.recordings[0].angle, Q, atol=1e-9)
    assert 'next: fill in each "?"' in capsys.readouterr().out
    with pytest.raises(InputError, match="link_lengths"):
        load(tmp_path / "new.toml")
    assert main(["new", str(tmp_path / "new.toml"), str(tmp_path / "x.csv")]) == 2


HEADER = "Zeit [ms];Schulter (Grad);Ellbogen (Grad)"
SPOILT = {
    "no reading": ([HEADER, *(f"{10 * i},0;nan;nan" for i in range(30))], "q1 has no reading"),
    "no rows": (["Labor", HEADER], "has a header but no data rows"),
    "commas for all": (
        [HEADER.replace(";", ","), "0,0,4,0000,-2,9940", "10,0,3,9688,-2,9435"],
        "x.csv, line 2: has 6 cells; the header names 3 columns; a comma between cells cannot be",
    ),
    "t alone": (["t,", "0,1", "1,2"], 'x.csv: has no column of angles beside "t"'),
    "a drive alone": (["t,u1", "0,1", "1,2"], 'x.csv: has no column of angles beside "t"'),
    "time stamps": (
        ["Stamp,Angle (rad)", "2026-01-01T00:00:00.00Z,0.2", "2026-01-01T00:00:00.02Z,0.1"],
        'x.csv, line 2: t = "2026-01-01T00:00:00.00Z" is no number; times are in s',
    ),
    "time stamps beside numbers": (
        ["t,q1,q2", "2024-01-01 10:00:00.000,0,0.2", "2024-01-01 10:00:00.010,1,0.1"],
        'x.csv, line 2: t = "2024-01-01 10:00:00.000" is no number; times are in s',
    ),
    "a name twice": (
        [HEADER.replace("Ellbogen", "Schulter"), "0,0;4,0;-2,9", "10,0;3,9;-2,8"],
        'x.csv, line 1: two columns are called "Schulter (Grad)"',
    ),
}


@pytest.mark.parametrize(("lines", "says"), SPOILT.values(), ids=SPOILT)
def test_new_says_what_is_wrong_below_a_header(tmp_path, capsys, lines, says):
    (tmp_path / "x.csv").write_text("\n".join([*lines, ""]))
    assert main(["new", str(tmp_path / "new.toml"), str(tmp_path / "x.csv")]) == 2
    assert says in capsys.readouterr().err
    assert not (tmp_path / "new.toml").exists()


def test_new_says_what_it_has_seen(tmp_path):
    time = np.arange(1500) / 100
    ring = np.stack([0.2 * np.cos(3 * time), -0.1 * np.cos(7 * time)], axis=1)
    ring = np.exp(-0.1 * time)[:, None] * ring
    held = np.concatenate([np.tile(ring[0], (200, 1)), ring]) + np.array([0.5, -0.6])
    rows = np.column_stack([10.0 * np.arange(len(held)), np.degrees(held)])
    np.savetxt(tmp_path / "x.csv", rows, delimiter=",", header="t,q1,q2", comments="")
    text, experiment = made(tmp_path, tmp_path / "x.csv")
    assert 'units = { t = "ms", q1 = "deg", q2 = "deg" }' in text
    assert 'start = "release"' in text
    assert 'rest = "estimate"' in text
    assert text.count("# seen: ") == 3
    np.testing.assert_allclose(
        np.nanmax(np.abs(experiment.recordings[0].angle), axis=0), [0.2, 0.1], rtol=0.1
    )


def test_new_takes_times_in_s_beside_a_clock(tmp_path):
    rows = [f"10:00:00,{t},{a},{b}" for t, (a, b) in zip(T, Q, strict=True)]
    (tmp_path / "x.csv").write_text("\n".join(["Time,Elapsed (s),q1,q2", *rows]))
    text, _ = made(tmp_path, tmp_path / "x.csv")
    assert 'columns = { t = "Elapsed (s)", q1 = "q1", q2 = "q2" }' in text


def test_new_does_not_guess_what_a_count_of_samples_is(tmp_path):
    rows = np.column_stack([np.arange(len(T)), Q])
    np.savetxt(tmp_path / "x.csv", rows, delimiter=",", header="sample,q1,q2", comments="")
    assert main(["new", str(tmp_path / "new.toml"), str(tmp_path / "x.csv")]) == 0
    text = (tmp_path / "new.toml").read_text()
    assert 'units = { t = "?" }' in text
    assert 't from "sample", q1' in text
    assert "# seen: t goes up by 1" in text
    with pytest.raises(InputError, match="1 units, theta2: write numbers"):
        load(tmp_path / "new.toml")


def test_new_reads_rates_where_a_unit_says_so(tmp_path):
    rows = [f"{t},{30 / np.pi * q},1" for t, q in zip(T, Q[:, 0], strict=True)]
    (tmp_path / "x.csv").write_text("\n".join(["Time (s),Speed (rpm),Count", *rows]))
    assert main(["new", str(tmp_path / "new.toml"), str(tmp_path / "x.csv")]) == 0
    text = (tmp_path / "new.toml").read_text()
    assert 'reads = "rate"' in text
    assert 'units = ["rad"]' in text
    (tmp_path / "new.toml").write_text(text.replace('"?"', "0.05"))
    (recording,) = load(tmp_path / "new.toml").recordings
    assert recording.reads == ("rate",)
    np.testing.assert_allclose(recording.angle[:, 0], Q[:, 0], atol=1e-12)


def test_new_from_driven_recordings_takes_no_rest_off(tmp_path):
    assert main(["example", str(tmp_path), "driven"]) == 0
    text, experiment = made(tmp_path, *sorted(tmp_path.glob("*.csv")))
    assert "rest =" not in text
    assert len(experiment.recordings) == 3
    assert all(r.drive is not None and r.drive.any() for r in experiment.recordings)


def test_new_takes_a_drive_for_no_angle(tmp_path):
    content = table("Time,ch1,ch2,u1", T, Q, more=lambda i: [str(i)])
    (tmp_path / "x.csv").write_text(content)
    text, experiment = made(tmp_path, tmp_path / "x.csv")
    assert 'columns = { t = "Time", q1 = "ch1", q2 = "ch2" }' in text
    assert experiment.recordings[0].drive[:, 0].tolist() == list(range(len(T)))


def test_new_refuses_files_of_different_mechanisms(tmp_path, capsys):
    (tmp_path / "arm.csv").write_text(table("t,q1 (deg),q2 (deg)", T, np.degrees(Q)))
    (tmp_path / "carts.csv").write_text(table("t,q1 (cm),q2 (cm)", T, 100 * Q))
    files = str(tmp_path / "arm.csv"), str(tmp_path / "carts.csv")
    assert main(["new", str(tmp_path / "x.toml"), *files]) == 2
    line = capsys.readouterr().err
    assert f"carts.csv: has joints in m, m, {files[0]} in rad, rad: an experiment is of one" in line
    assert 'write the unit behind its name, as "q1 (m)"' in line


def test_new_for_one_sliding_joint_and_for_what_is_no_table(tmp_path, capsys):
    lines = [f"{t},{100 * q}" for t, q in zip(T, Q[:, 0], strict=True)]
    (tmp_path / "x.csv").write_text("\n".join(["Time (s),Cart (mm)", *lines]))
    text, _ = main(["new", str(tmp_path / "a.toml"), str(tmp_path / "x.csv")]), None
    text = (tmp_path / "a.toml").read_text()
    assert 'units = ["m"]' in text
    assert 'columns = { t = "Time (s)", q1 = "Cart (mm)" }' in text
    for name, content in (("y.csv", "nothing\nof use\n"), ("z.csv", "1,2\n3,4\n")):
        (tmp_path / name).write_text(content)
        assert main(["new", str(tmp_path / "b.toml"), str(tmp_path / name)]) == 2
        assert "no line of names above columns of numbers" in capsys.readouterr().err
    assert main(["new", str(tmp_path / "x.csv"), "b.toml"]) == 2
    assert len(DIALECTS) >= 30


UNSAID = {
    "nothing": ("t,q1", "t in s, q1 in rad?", True),
    "of the time": ("a,b (cm)", "t in s?", False),
    "of the joint": ("Time (ms),b", "q1 in rad?", True),
    "all of it": ("t (s),q1 (rad)", None, False),
    "of an arm": ("t (s),q1,q2", "q1 in rad, q2 in rad?", False),
}


@pytest.mark.parametrize(("header", "says", "of_joint"), UNSAID.values(), ids=UNSAID)
def test_new_says_which_units_the_file_does_not_say(tmp_path, header, says, of_joint):
    n = header.count(",")
    (tmp_path / "x.csv").write_text(table(header, T, Q[:, :n]))
    assert main(["new", str(tmp_path / "new.toml"), str(tmp_path / "x.csv")]) == 0
    text = (tmp_path / "new.toml").read_text()
    lines = [line for line in text.splitlines() if "the file does not say" in line]
    comments = [f"# the file does not say: {says}"] if says else []
    assert [line for line in lines if line.startswith("#")] == comments
    assert [line.split(" = ")[0] for line in lines if not line.startswith("#")] == (
        ["units"] if of_joint else []
    )
    assert ("no arm of two links takes [inertia]" in text) == (n == 2)
    first = [line for line in text.splitlines()[: 4 + n] if " # " in line]
    assert len({line.index(" # ") for line in first}) == 1


@pytest.mark.parametrize(("unit", "mass"), [("cm", "kg"), ("rad", "kg m^2")])
def test_new_says_in_which_unit_a_mass_is(tmp_path, unit, mass):
    rows = (f"{t:.2f},{0.2 * np.cos(3 * t):.5f}" for t in np.arange(0, 15, 0.01))
    (tmp_path / "x.csv").write_text("\n".join([f"Time (s),x ({unit})", *rows, ""]))
    assert main(["new", str(tmp_path / "new.toml"), str(tmp_path / "x.csv")]) == 0
    (line,) = [
        x for x in (tmp_path / "new.toml").read_text().splitlines() if x.startswith("matrix")
    ]
    assert line.split("# ")[1] == mass


def test_new_names_the_column_that_one_of_the_files_lacks(tmp_path, capsys):
    (tmp_path / "two.csv").write_text(table("t,q1,q2", T, Q))
    (tmp_path / "one.csv").write_text(table("t,q1", T, Q[:, :1]))
    one, two = str(tmp_path / "one.csv"), str(tmp_path / "two.csv")
    for files in ((one, two), (two, one)):
        assert main(["new", str(tmp_path / "x.toml"), *files]) == 2
        assert f'{one}: has no column "q2", as {two} has' in capsys.readouterr().err

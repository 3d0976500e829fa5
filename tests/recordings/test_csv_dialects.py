"""Tables as labs write them: names, units, separators, decimal signs, lines above and beside."""

import numpy as np
import pytest
from scipy.io import savemat

from residyn.cli import main
from residyn.cli._work import load as cli_load
from residyn.errors import InputError
from residyn.recordings.experiment import load
from residyn.recordings.new_experiment import experiment_text

ARM = """[arm]
link_lengths = [0.4, 0.3]
shoulder = 1.1662
elbow = 0.579
coupling = 1.2
"""
N = 60
T = np.round(np.arange(N) * 0.0125, 6)
Q = (
    np.round(np.stack([0.2 * np.cos(14 * T) - 0.01, -0.15 * np.cos(23 * T + 0.3)], axis=1) / 1e-6)
    * 1e-6
)
DEG = np.degrees(Q)


def table(header, t, q, *, sep=",", point=".", above="", quoted=False, more=None, end="\n"):
    """A file's text; `more(i)` are further cells of row i."""
    rows = []
    for i in range(N):
        cells = [f"{x:.12g}" for x in (t[i], *q[i])]
        cells = [cell.replace(".", point) for cell in cells] + (more(i) if more else [])
        rows.append(sep.join(f'"{cell}"' if quoted else cell for cell in cells))
    return above + end.join([header, *rows, ""])


MS = 1e3 * T
COLUMNS = 'columns = { t = "Zeit [ms]", q1 = "Schulter (Grad)", q2 = "Ellbogen (Grad)" }'
GERMAN = "Zeit [ms];Schulter (Grad);Ellbogen (Grad)"
DIALECTS = {
    "as we write it": (table("t,q1,q2", T, Q), ""),
    "upper case": (table("T,Q1,Q2", T, Q), ""),
    "names of the joints": (table("Time [s],Shoulder [rad],Elbow [rad]", T, Q), ""),
    "degrees in round brackets": (table("Time (s),Shoulder (deg),Elbow (deg)", T, DEG), ""),
    "milliseconds": (table("time_ms,q1_deg,q2_deg", MS, DEG), ""),
    "DIN 1313": (table("t/ms,q1/mrad,q2/mrad", MS, 1e3 * Q), ""),
    "in words": (table("time in microseconds,q1 in degrees,q2 in degrees", 1e6 * T, DEG), ""),
    "degree signs": (table("t [s],q1 [°],q2 [°]", T, DEG), ""),
    "Latin-1": (table("t [µs];q1 [°];q2 [°]", 1e6 * T, DEG, sep=";").encode("latin-1"), ""),
    "UTF-16 of a spreadsheet": (table("t\tq1\tq2", T, Q, sep="\t").encode("utf-16"), ""),
    "byte order mark": (b"\xef\xbb\xbf" + table("t,q1,q2", T, Q).encode(), ""),
    "names of the joints in German": (table(GERMAN, MS, DEG, sep=";", point=","), ""),
    "names of the joints in another order": (
        table("Zeit [s];Coude [rad];Épaule [rad]", T, Q[:, ::-1], sep=";"),
        "",
    ),
    "German": (table(GERMAN, MS, DEG, sep=";", point=","), COLUMNS),
    "German in Latin-1 with Windows' line ends": (
        table("Prüfung;;\r\n" + GERMAN, MS, DEG, sep=";", point=",", end="\r\n").encode("cp1252"),
        COLUMNS,
    ),
    "semicolons and points": (table("t;q1;q2", T, Q, sep=";"), ""),
    "semicolons and commas": (table("t;q1;q2", T, Q, sep=";", point=","), ""),
    "tabs": (table("t\tq1\tq2", T, Q, sep="\t"), ""),
    "tabs and commas": (table("t\tq1\tq2", T, Q, sep="\t", point=","), ""),
    "blanks, as numpy writes": (table("# t q1 q2", T, Q, sep=" "), ""),
    "bars, by key": (table("t|q1|q2", T, Q, sep="|"), 'separator = "|"'),
    "blanks around": (table("t , q1 , q2", T, Q, sep=" , "), ""),
    "quoted": (table('"t","q1","q2"', T, Q, quoted=True), ""),
    "quoted decimal commas between commas": (
        table('"t","q1","q2"', T, Q, quoted=True, point=","),
        "",
    ),
    "the decimal sign by key": (
        table("t;q1;q2", T, Q, sep=";", point=","),
        'decimal = ","\nseparator = ";"',
    ),
    "comments above": (table("t,q1,q2", T, Q, above="# braked arm\n% run 3\n\n"), ""),
    "lines above": (
        table("Time;q1;q2", T, Q, sep=";", point=",", above="Logger v2;;\nRate;100,0;Hz\n\n"),
        "",
    ),
    "units below": (table("Time,q1,q2\nms,deg,deg", MS, DEG), ""),
    "units below, in brackets": (table("Time;q1;q2\n[ms];[deg];[deg]", MS, DEG, sep=";"), ""),
    "further columns": (
        table("t,q1,q2,Temperature (C),note", T, Q, more=lambda i: [str(20 + i), "ok"]),
        "",
    ),
    "further columns with blanks": (
        table("t;q1;q2;comment", T, Q, sep=";", more=lambda i: ["all well, 3.2 V" * (i % 2)]),
        "",
    ),
    "a further column in quotes": (
        table("t,q1,q2,comment", T, Q, more=lambda i: ['"one, two"']),
        "",
    ),
    "a very long note in quotes": (
        table("t,q1,q2,comment", T, Q, more=lambda i: [f'"one, {"o" * 140_000 * (i == 9)}"']),
        "",
    ),
    "a quote in quotes": (table("t,q1,q2,comment", T, Q, more=lambda i: ['"a ""b"", c"']), ""),
    "a separator at each end": (table("t,q1,q2,", T, Q, more=lambda i: [""]), ""),
    "units by key": (table("t,q1,q2", MS, DEG), 'units = { t = "ms", q1 = "deg", q2 = "deg" }'),
    "key before header": (table("t [s],q1 [rad],q2", T, DEG), 'units = { q1 = "deg", q2 = "deg" }'),
    "names by key": (
        table("clock,ch7,ch1,ch2", T, np.column_stack([0 * T, Q])),
        'columns = { t = "clock", q1 = "ch1", q2 = "CH2" }',
    ),
    "names by key without their units": (
        table("Clock (s),Left (deg),Right (deg)", T, DEG),
        'columns = { t = "Clock", q1 = "Left", q2 = "Right" }',
    ),
    "a typographic minus": (table("t,q1,q2", T, Q).replace("-", "\u2212"), ""),
    "Fortran's exponents": (
        "t,q1,q2\n"
        + "".join(
            f"{a:.9E},{b:.9E},{c:.9E}\n".replace("E", "D") for a, (b, c) in zip(T, Q, strict=True)
        ),
        "",
    ),
    "rest": (table("t,q1,q2", T, Q + np.array([0.3, -0.2])), "rest = [0.3, -0.2]"),
    "rest in degrees' file": (
        table("t,q1,q2", T, DEG + np.degrees([0.3, -0.2])),
        'units = { q1 = "deg", q2 = "deg" }\nrest = [0.3, -0.2]',
    ),
}


def read(folder, content, keys="", name="x.csv"):
    """The one recording of an experiment."""
    (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    path = folder / "x.toml"
    path.write_text(f'{ARM}\n[[recordings]]\nfile = "{name}"\ntheta2 = 0\nnoise = 1e-3\n{keys}\n')
    (recording,) = load(path).recordings
    return recording


NAMES = {
    "shoulder and elbow": ("Elbow (deg);Shoulder (deg)", "21"),
    "words among others": ("Winkel Ellbogen (deg);Winkel Schulter (deg)", "21"),
    "one of the two": ("other angle (deg);shoulder angle (deg)", "21"),
    "the other of the two": ("elbow encoder (deg);encoder (deg)", "21"),
    "numbers": ("Winkel 2 (deg);Winkel 1 (deg)", "21"),
    "numbers of two digits": ("ch9 (deg);ch10 (deg)", "12"),
    "our own names": ("Q2;Q1", "21"),
    "nothing": ("left (deg);right (deg)", ""),
    "both in both": ("shoulder-elbow A (deg);elbow-shoulder B (deg)", ""),
}


@pytest.mark.parametrize(("header", "order"), NAMES.values(), ids=NAMES)
def test_new_takes_the_joints_by_their_names_or_says_that_it_does_not(tmp_path, header, order):
    cells = header.split(";")
    (tmp_path / "x.csv").write_text(table(f"t;{header}", T, DEG if "deg" in header else Q, sep=";"))
    text = experiment_text([tmp_path / "x.csv"], tmp_path)
    first, second = (cells[int(i) - 1] for i in order or "12")
    assert f'columns = {{ t = "t", q1 = "{first}", q2 = "{second}" }}' in text
    assert ("# seen: no name says which column is which joint" in text) == (not order)


@pytest.mark.parametrize(("content", "keys"), DIALECTS.values(), ids=DIALECTS)
def test_reads_to_the_same_numbers(tmp_path, content, keys):
    recording = read(tmp_path, content, keys)
    np.testing.assert_allclose(recording.time, T, rtol=0, atol=1e-12)
    np.testing.assert_allclose(recording.angle, Q, rtol=0, atol=1e-12)


DRIVES = {
    "u1, N m": 1.0,
    "u1 in mN m": 1e-3,
    "u1_N m": 1.0,
    "u1 / N m": 1.0,
    "u1, in N·m": 1.0,
}


@pytest.mark.parametrize(("header", "size"), DRIVES.items(), ids=DRIVES)
def test_a_drive_whose_unit_has_a_blank(tmp_path, header, size):
    content = table(f"t;q1;q2;{header}", T, Q, sep=";", more=lambda i: [str(i)])
    drive = read(tmp_path, content).drive
    assert drive is not None
    np.testing.assert_allclose(drive[:, 0], size * np.arange(N))


RATES = {
    "{}_rad/s": 1.0,
    "{}, deg/s": np.pi / 180,
    "{} in deg/s": np.pi / 180,
    "{}/(deg/s)": np.pi / 180,
    "{} [degrees/s]": np.pi / 180,
    "{} [degree/s]": np.pi / 180,
    "{} [dps]": np.pi / 180,
    "{} [radians/s]": 1.0,
    "{} in 1/s": 1.0,
    "{}, 1/min": 2 * np.pi / 60,
}


@pytest.mark.parametrize(("header", "size"), RATES.items(), ids=RATES)
def test_rates_in_units_with_a_slash(tmp_path, header, size):
    names = ";".join(["t", header.format("q1"), header.format("q2")])
    recording = read(tmp_path, table(names, T, Q / size, sep=";"), 'reads = "rate"')
    np.testing.assert_allclose(recording.angle, Q, rtol=0, atol=1e-9)


def test_lost_samples_however_they_are_written(tmp_path):
    lines = table("t;q1;q2", T, Q, sep=";", point=",").split("\n")
    for i, lost in enumerate(("", "nan", "NaN", "NA", "#N/A", "null", " ")):
        cells = lines[i + 1].split(";")
        lines[i + 1] = ";".join([cells[0], lost, cells[2]])
    angle = read(tmp_path, "\n".join(lines)).angle
    assert np.isnan(angle[:7, 0]).all()
    np.testing.assert_allclose(angle[7:, 0], Q[7:, 0], atol=1e-12)
    np.testing.assert_allclose(angle[:, 1], Q[:, 1], atol=1e-12)


def test_what_was_understood_is_said_in_one_line(tmp_path, capsys):
    assert read(tmp_path, *DIALECTS["as we write it"]).understood == ""
    assert read(tmp_path, *DIALECTS["comments above"]).understood == ""
    assert read(tmp_path, *DIALECTS["German"]).understood == (
        't from "Zeit [ms]" in ms, q1 from "Schulter (Grad)" in deg, '
        'q2 from "Ellbogen (Grad)" in deg; semicolons between cells; decimal commas'
    )
    assert read(tmp_path, *DIALECTS["further columns"]).understood == (
        't in s, q1 in rad, q2 in rad; not read: "Temperature (C)", "note"'
    )
    assert read(tmp_path, *DIALECTS["lines above"]).understood.endswith("header in line 4")
    assert read(tmp_path, *DIALECTS["rest"]).understood == "rest at q1 0.3, q2 -0.2, taken off"
    for name, lines in (("German", 1), ("as we write it", 0)):
        read(tmp_path, *DIALECTS[name])
        cli_load(str(tmp_path / "x.toml"))
        out, err = capsys.readouterr()
        assert (out, err.count("\n")) == ("", lines)
        assert err.startswith("residyn: x.csv: t from" * lines)
        assert main(["explore", str(tmp_path / "x.toml"), "--with", "nothing", "--no-cache"]) == 2
        assert capsys.readouterr().err.count("residyn: x.csv: t from") == lines


def test_matlab_has_names_and_units_too(tmp_path):
    savemat(tmp_path / "x.mat", {"clock": MS, "left": DEG[:, 0], "right": DEG[:, 1], "w": "note"})
    keys = (
        'columns = { t = "clock", q1 = "left", q2 = "right" }\n'
        'units = { t = "ms", q1 = "deg", q2 = "deg" }'
    )
    content = (tmp_path / "x.mat").read_bytes()
    recording = read(tmp_path, content, keys, name="x.mat")
    np.testing.assert_allclose(recording.angle, Q, atol=1e-12)
    assert recording.understood.startswith('t from "clock" in ms')
    with pytest.raises(InputError, match="separator is for CSV files"):
        read(tmp_path, content, 'separator = ";"', name="x.mat")


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ('columns = "t"', "columns = "),
        ("columns = {}", "must be a table"),
        ('columns = { time = "t" }', 'columns has "time": its keys are t, q1, ...'),
        ('columns = { q3 = "q2" }', "there is no joint for q3: 2 joints"),
        ("columns = { t = 1 }", "columns: t = 1"),
        ('columns = { t = "clock" }', 'no column "clock" for t; it has "t", "q1", "q2"'),
        ('columns = { t = "tt" }', 'did you mean "t"?'),
        ('columns = { q1 = "q1", q2 = "q" }', 'it has "t", "q1", "q2"; did you mean "q2"?'),
        ('columns = { q1 = "q2", q2 = "q" }', 'did you mean "q1"?'),
        ('columns = { q1 = "q2", q2 = "q2" }', '"q2" twice'),
        ('columns = { q1 = "q2" }', "one column stands for two"),
        ('units = { t = "h" }', 'units: t = "h": must be s, ms, us, ns'),
        ('units = { q1 = "mm" }', 'units: q1 = "mm": must be rad, deg, mrad'),
        ('units = { u1 = "N m", q9 = "deg" }', "there is no joint for q9"),
        ("units = 3", "units = 3: must be a table"),
        ('separator = ""', 'separator = ""'),
        ('separator = "ab"', 'must be one character, as ";"'),
        ('separator = ","\ndecimal = ","', "are both"),
        ('decimal = "x"', 'decimal = "x": must be "." or ","'),
        ('decimal = ","', 'the decimal sign is "," here'),
        ('rest = "estimated"', 'rest = "estimated": must be "estimate", or 2 numbers'),
        ("rest = [0.1]", "rest = [0.1]: must be"),
        ("rest = 0.1", "rest = 0.1: must be"),
        ('rest = [0.1, "x"]', 'rest = "x"'),
        ("rest = [0.1, inf]", "rest = inf"),
        ("dezimal = 1", 'did you mean "decimal"?'),
    ],
)
def test_keys_are_checked(tmp_path, keys, says):
    with pytest.raises(InputError) as caught:
        read(tmp_path, table("t,q1,q2", T, Q), keys)
    assert says in str(caught.value)
    assert "x.toml: [[recordings]] 1" in str(caught.value)


def test_the_only_column_of_angles_is_what_to_write(tmp_path):
    for header, right in (("t,q1,Low (deg)", 'q2 = "Low (deg)"'), ("t,Up (deg),Low", 'q1 = "Up')):
        with pytest.raises(InputError) as caught:
            read(tmp_path, table(header, T, Q))
        assert f"as columns = {{ {right}" in str(caught.value)
    with pytest.raises(InputError, match=r'q1 = "\.\.\." }; it has'):
        read(tmp_path, table("t,Up (deg),Low (deg)", T, Q))


def test_a_column_that_is_another_joints_is_no_suggestion(tmp_path):
    content = table("t,q1 (rad),q3 (rad)", T, Q)
    with pytest.raises(InputError, match='did you mean "q3 ') as caught:
        read(tmp_path, content, 'columns = { q1 = "q1", q2 = "q2 (rad)" }')
    assert str(caught.value).count('"q1 (rad)"') == 1
    with pytest.raises(InputError, match="for q2") as caught:
        read(tmp_path, table("t,q1 (rad),x", T, Q), 'columns = { q1 = "q1", q2 = "q2 (rad)" }')
    assert "did you mean" not in str(caught.value)

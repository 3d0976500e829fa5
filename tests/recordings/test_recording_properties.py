"""Whatever a file holds, it is read or refused in one line: never another exception."""

import math
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from residyn.errors import InputError
from residyn.recordings.csv import read_csv, write_csv
from residyn.recordings.experiment import load
from residyn.recordings.noise import estimate_noise
from residyn.recordings.outliers import outlier_mask
from residyn.recordings.recording import Recording

relaxed = settings(suppress_health_check=[HealthCheck.too_slow])
FOLDER = tempfile.TemporaryDirectory()
CSV, TOML = Path(FOLDER.name, "try.csv"), Path(FOLDER.name, "try.toml")
HERE = Path(FOLDER.name, "here.csv")
TIME = np.arange(60) / 50
ANGLE = (
    np.stack([np.cos(5 * TIME), np.sin(7 * TIME)], axis=1) + 0.01 * np.sin(1e4 * TIME**2)[:, None]
)
write_csv(HERE, TIME, ANGLE, ANGLE)


def read_or_refused(read: Callable[[], object], *names: str) -> None:
    try:
        read()
    except InputError as error:
        line = str(error)
        assert line.strip()
        assert line.isprintable()
        assert len(line.splitlines()) == 1
        assert not names or any(name in line for name in names)


@given(st.binary(max_size=200), st.integers(1, 2))
@relaxed
def test_any_bytes_as_csv(data, joints):
    CSV.write_bytes(data)
    read_or_refused(lambda: read_csv(CSV, joints), "try.csv")


CELLS = st.sampled_from(
    [
        *("", " ", "nan", "NaN", "-nan", "inf", "-Infinity", "1e999", "1e-400", "-0.0"),
        *("x", "1_0", "0x1", "1d5", "nan(1)", "1 2", "1;2", '"1"', "#1", "+1.", ".5"),
        *("\u0661", "\x0b", "1\u2028"),
    ]
)


@st.composite
def spoilt_tables(draw):
    """A good table in which a few things were changed."""
    rows = [["t", "q1", "q2", "u1"]]
    rows += [[repr(x) for x in row] for row in np.c_[TIME, ANGLE, TIME][:30].tolist()]
    for _ in range(draw(st.integers(0, 4))):
        i = draw(st.integers(0, len(rows) - 1))
        j = draw(st.integers(0, max(len(rows[i]) - 1, 0)))
        change = draw(st.sampled_from(["cell", "drop", "add", "swap", "twice", "lose", "blank"]))
        if change == "cell" and rows[i]:
            rows[i][j] = draw(st.one_of(CELLS, st.text(max_size=5)))
        elif change == "drop" and rows[i]:
            del rows[i][j]
        elif change == "add":
            rows[i].insert(j, draw(CELLS))
        elif change == "swap":
            k = draw(st.integers(0, len(rows) - 1))
            rows[i], rows[k] = rows[k], rows[i]
        elif change == "twice":
            rows.insert(i, list(rows[i]))
        elif change == "lose" and len(rows) > 1:
            del rows[i]
        elif change == "blank":
            rows.insert(i, [])
    end = draw(st.sampled_from(["\n", "\r\n", "\r"]))
    return end.join(",".join(row) for row in rows) + draw(st.sampled_from(["", end, end * 3]))


@given(spoilt_tables())
@relaxed
def test_a_spoilt_csv(text):
    CSV.write_bytes(text.encode("utf-8", "surrogatepass"))
    read_or_refused(lambda: read_csv(CSV, 2), "try.csv")


READINGS = st.floats(-1e30, 1e30)  # any that a recording may have


@given(st.data(), st.integers(1, 3), st.booleans())
@relaxed
def test_a_written_csv_reads_back_exactly(data, joints, driven):
    time = np.unique(data.draw(arrays.arrays(float, st.integers(1, 20), elements=READINGS)))
    assume(len(time) == 1 or np.median(np.diff(time)) >= 1e-9)
    table = arrays.arrays(
        float, (len(time), joints), elements=st.one_of(READINGS, st.just(math.nan))
    )
    angle, drive = data.draw(table), data.draw(table) if driven else None
    write_csv(CSV, time, angle, drive)
    back = read_csv(CSV, joints)
    np.testing.assert_array_equal(back[0], time)
    np.testing.assert_array_equal(back[1], angle)
    np.testing.assert_array_equal(np.signbit(back[1]), np.signbit(angle))
    assert (back[2] is None) == (drive is None)
    if drive is not None:
        np.testing.assert_array_equal(back[2], drive)


@given(st.one_of(st.text(max_size=100), st.text("[]=.\"'#\n arm12,{}", max_size=60)))
@relaxed
def test_any_text_as_toml(text):
    TOML.write_bytes(text.encode("utf-8", "surrogatepass"))
    read_or_refused(lambda: load(TOML), "try.toml")


def good() -> dict:
    return {
        "arm": {"link_lengths": [0.4, 0.4], "shoulder": 1.2, "elbow": 0.6, "coupling": 1.0},
        "air_bearings": [{"joint": "elbow", "mass": 1.0, "inertia": 0.002}],
        "recordings": [
            {"file": "here.csv", "theta2": 0.3, "noise": 0.01, "start": 0.0, "stop": 1.1},
            {"file": "here.csv", "role": "check", "noise": [0.1, 0.1], "air_bearings": False},
            {"file": "here.csv", "role": "inertia", "start": "release", "theta2": 0},
        ],
    }


def other() -> dict:
    matrix = [[1.0, 0.2], [0.2, 1.0]]
    return {
        "inertia": {"joints": ["a", "b"], "matrix": matrix, "units": ["rad", "m"]},
        "recordings": [{"file": "here.csv", "extra_mass": 0.5}],
    }


def as_toml(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (int, float)):
        return repr(value)
    if isinstance(value, str):
        plain = value.replace("\\", "\\\\").replace('"', '\\"')
        return '"' + "".join(c if c.isprintable() else f"\\U{ord(c):08x}" for c in plain) + '"'
    if isinstance(value, list):
        return "[" + ", ".join(map(as_toml, value)) + "]"
    assert isinstance(value, dict)
    return "{" + ", ".join(f"{as_toml(k)} = {as_toml(v)}" for k, v in value.items()) + "}"


WORDS = st.text(st.characters(exclude_categories=["Cs"]), max_size=6)
VALUES = st.one_of(
    st.sampled_from([0, -1, 1, 1e308, -1e-320, 10**400, math.nan, math.inf, True, False]),
    st.sampled_from(["", "x", "release", "fit", "check", "inertia", "wrist", ".", "a:b", "\x00"]),
    st.floats(),
    WORDS,
    st.lists(st.one_of(st.floats(), WORDS, st.booleans()), max_size=3),
    st.dictionaries(WORDS, st.integers(), max_size=2),
    st.just([[1.0, 2.0], [2.0, 1.0]]),
)


@st.composite
def spoilt_experiments(draw):
    """A good experiment in which a few things were changed."""
    root = draw(st.sampled_from([good, other]))()
    for _ in range(draw(st.integers(0, 3))):
        table = root
        while True:  # down to some table
            inner = [v for v in table.values() if isinstance(v, dict)]
            inner += [w for v in table.values() if isinstance(v, list) for w in v]
            inner = [v for v in inner if isinstance(v, dict)]
            if not inner or not draw(st.integers(0, 3)):
                break
            table = draw(st.sampled_from(inner))
        change = draw(st.sampled_from(["delete", "value", "add"]))
        if change == "add" or not table:
            names = st.sampled_from(["theta2", "units", "arm", "inertia", "extra_mass", "nois"])
            table[draw(st.one_of(names, WORDS))] = draw(VALUES)
            continue
        key = draw(st.sampled_from(sorted(table)))
        if change == "delete":
            del table[key]
        else:
            table[key] = draw(VALUES)
    return root


@given(spoilt_experiments())
@settings(relaxed, max_examples=200)
def test_a_spoilt_experiment(tables):
    lines = (f"{as_toml(key)} = {as_toml(value)}" for key, value in tables.items())
    TOML.write_text("\n".join(lines), encoding="utf-8")
    read_or_refused(lambda: load(TOML), "try.toml")


@pytest.mark.parametrize("tables", [good(), other()], ids=["arm", "inertia"])
def test_unspoilt_they_are_read(tables):
    TOML.write_text("\n".join(f"{k} = {as_toml(v)}" for k, v in tables.items()), encoding="utf-8")
    assert len(load(TOML).recordings) == len(tables["recordings"])


ANY = st.one_of(st.floats(-10, 10), st.floats(), st.sampled_from([0.0, 1.0, math.nan]))


@given(st.data(), st.integers(1, 70), st.sampled_from([None, "release"]))
@settings(relaxed, max_examples=150)
def test_any_arrays(data, count, start):
    """Numbers that no arm produced are refused, or have a positive noise."""
    steps = data.draw(arrays.arrays(float, count, elements=st.floats(1e-6, 1e6)))
    angle = data.draw(arrays.arrays(float, (count, 2), elements=ANY))

    def read():
        here = Recording.from_arrays(np.cumsum(steps), angle, start=start)
        assert (here.noise > 0).all()
        assert np.isfinite(here.noise).all()
        assert here.angle.shape == (len(here.time), 2)

    read_or_refused(read, "recording")
    read_or_refused(lambda: outlier_mask(np.cumsum(steps), angle))


@given(st.integers(0, 100), st.floats(-80, 80), st.floats(-1e3, 1e3))
@settings(relaxed, max_examples=50)
def test_noise_scales_with_the_readings(seed, power, offset):
    rng = np.random.default_rng(seed)
    noisy = ANGLE + 0.02 * rng.standard_normal(ANGLE.shape)
    one = estimate_noise(TIME, noisy)
    np.testing.assert_allclose(
        estimate_noise(TIME, noisy * 2.0**power), one * 2.0**power, rtol=1e-3
    )
    np.testing.assert_allclose(estimate_noise(TIME * 3 + offset, noisy), one, rtol=1e-3)

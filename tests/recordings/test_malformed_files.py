"""What is malformed ends with status 2 and one line that names where; never a traceback.

Which words refuse which table, key or cell is in `test_recording.py`, and not repeated here.
"""

import io
import os
import sys

import numpy as np
import pytest

from residyn.cli import main

T = np.arange(200) / 50
Q = np.stack([0.2 * np.cos(9 * T), -0.1 * np.cos(15 * T)], axis=1)
HEADER = "t,q1,q2"
ROWS = [f"{t:.2f},{a:.6f},{b:.6f}" for t, (a, b) in zip(T, Q, strict=True)]
GOOD = "\n".join([HEADER, *ROWS, ""])
ARM = """[arm]
link_lengths = [0.4, 0.4]
shoulder = 1.2
elbow = 0.6
coupling = 1.4
"""
RECORDING = '[[recordings]]\nfile = "x.csv"\ntheta2 = 0.1\n'

NOTED = "\n".join(["x,y," + HEADER, *("a,b," + line for line in ROWS), ""])


def row(i, text):
    """The good file with another row."""
    lines = [HEADER, *ROWS, ""]
    lines[i] = text
    return "\n".join(lines)


def scaled(time=T, angle=Q, header=HEADER):
    cells = np.column_stack([time, angle])
    return "\n".join([header, *(",".join(f"{x:.17g}" for x in line) for line in cells), ""])


CSV = {
    "no t": GOOD.replace(HEADER, "x,q1,q2"),
    "three joints": GOOD.replace(HEADER, "t,q1,q3"),
    "t twice": GOOD.replace(HEADER, "t,t,q1"),
    "a unit of another quantity": GOOD.replace(HEADER, "t,q1 [mm],q2"),
    "angle in seconds": GOOD.replace(HEADER, "t,q1 [s],q2"),
    "one row": "t,q1,q2\n0,0.1,0.2\n",
    "ten rows": "\n".join([HEADER, *ROWS[:10]]),
    "an empty row of commas": row(7, ",,"),
    "a footer": GOOD + "end of the measurement\n",
    "a second header": row(90, HEADER),
    "a clock": row(7, "12:30:01,0.1,0.2"),
    "a date": row(7, "2024-03-01,0.1,0.2"),
    "hexadecimal": row(7, "0.12,0x1F,0.2"),
    "two points": row(7, "0.12,1.2.3,0.2"),
    # A cell less than the header has, but as many separators.
    "a comma in quotes": NOTED.replace("a,b,0.12,", '"a,b",0.12,'),
    "a lost note": NOTED.replace(",", " ").replace("a b 0.12 ", " b 0.12 "),
    "thousands": row(7, '0.12,"1,234.5",0.2'),
    "1e99": row(7, "0.12,1e99,0.2"),
    "1e99 seconds": GOOD + "1e99,0.1,0.2\n",
    "time backwards": "\n".join([HEADER, *ROWS[::-1]]),
    "steps of 1e-200 s": scaled(T * 1e-200),
    "steps of 1e-12 s": scaled(T * 1e-12),
    "milliseconds": scaled(T * 1e3),
    "microseconds": scaled(T * 1e6),
    "samples": scaled(np.arange(200)),
    "a hold": scaled(angle=np.concatenate([np.tile(Q[0], (100, 1)), Q[:100]])),
    "an arm that never moves": scaled(angle=0 * Q + [0.1, 0.0]),
    "every reading lost": "\n".join([HEADER, *(f"{t:.2f},," for t in T)]),
    "one joint lost": "\n".join([HEADER, *(f"{t:.2f},0.1," for t in T)]),
    "nearly all lost": "\n".join([HEADER, *ROWS[:15], *(f"{t:.2f},," for t in T[15:])]),
    "an angle that wraps": scaled(angle=(Q + np.pi) % (2 * np.pi)),
    "decimal commas between commas": GOOD.replace(".", ","),
    "semicolons and a mix of signs": row(7, "0,12,0.1,0.2").replace(",", ";"),
    "zeros of a crash": b"\0" * 5000,
    "zeros after rows": GOOD.encode()[:3000] + b"\0" * 5000,
    "a picture": b"\x89PNG\r\n\x1a\n" + bytes(range(256)) * 20,
    "random bytes": np.random.default_rng(0).bytes(5000),
    "a spreadsheet": b"PK\x03\x04\x14\x00\x06\x00" + np.random.default_rng(1).bytes(5000),
    "a page": "<!DOCTYPE html>\n<html><body>Not found</body></html>\n",
    "JSON": '{"t": [0, 1], "q1": [0, 1]}\n',
    "TOML": ARM,
    "half a UTF-16 file": GOOD.encode("utf-16")[:1001],
    "one endless line": "t,q1,q2," + "0.1," * 50_000,
    "drive of a third joint": "\n".join(["t,q1,q2,u3", *(f"{r},0" for r in ROWS)]),
    "no drive to be had": "\n".join(["t,q1,q2,u1", *(f"{r}," for r in ROWS)]),
}
TOML = {
    "half a string": f'{ARM}\n[[recordings]]\nfile = "x.c',
    "an inertia of 1e99": ARM.replace("1.2", "1e99") + RECORDING,
    "a path of Windows": f'{ARM}[[recordings]]\nfile = "C:\\data\\x.csv"\n',
}
KEYS = {
    "no file": 'file = ""',
    "a device": 'file = "/dev/zero"',
    "a pipe": 'file = "pipe"',
    "a very long name": f'file = "{"x" * 5000}"',
    "normal of no markers": "normal = [0, 0, 1]",
}


@pytest.fixture
def refused(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)

    def check(*words):
        assert main(words) == 2
        out, err = capsys.readouterr()
        assert out == ""
        assert err.count("\n") == 1, err
        assert "x.toml" in err
        assert "should not have happened" not in err
        assert len(err) < 1000
        return err

    return check


def write(name, content):
    with open(name, "wb") as file:
        file.write(content if isinstance(content, bytes) else content.encode())


@pytest.mark.parametrize("content", CSV.values(), ids=CSV)
def test_recordings(refused, content):
    write("x.csv", content)
    write("x.toml", ARM + RECORDING)
    refused("fit", "x.toml", "--no-cache")


def test_a_sign_for_a_lost_sample_is_named_with_its_lines(refused):
    angle = np.degrees(Q + 1e-4 * np.random.default_rng(0).standard_normal(Q.shape))
    angle[50:71, 1] = 999.0
    angle[120, 0] = -999.0  # alone it is an outlier, which a fit sets aside
    write("x.csv", scaled(angle=angle, header="t,q1 (deg),q2 (deg)"))
    write("x.toml", ARM + RECORDING)
    said = refused("fit", "x.toml", "--no-cache")
    assert "x.csv: q2 = 17.44 rad (999 deg), lines 52 to 72 (21 readings)" in said
    assert main(["new", "y.toml", "x.csv"]) == 2


@pytest.mark.parametrize("content", TOML.values(), ids=TOML)
def test_experiments(refused, content):
    write("x.csv", GOOD)
    write("x.toml", content)
    refused("fit", "x.toml", "--no-cache")


@pytest.mark.parametrize("key", KEYS.values(), ids=KEYS)
def test_keys(refused, key):
    write("x.csv", GOOD)
    os.mkfifo("pipe")
    own = key.split(" = ")[0]
    kept = [line for line in RECORDING.splitlines() if line.split(" = ")[0] != own]
    write("x.toml", "\n".join([ARM, *kept, key, ""]))
    refused("diagnose", "x.toml", "--no-cache")


MANY = ARM + RECORDING.replace("[[recordings]]", "[recordings]")
WRITTEN = {
    "a decimal comma": (ARM.replace("0.6", "0,6"), 'line 4: "elbow = 0,6": a number has a decimal'),
    "quotes": (
        ARM.replace("0.6", '"0.6"'),
        'elbow = "0.6": must be a number above 0 (kg m^2), without',
    ),
    "quotes and a comma": (ARM.replace("0.6", '"0,6"'), "without quotes, with a decimal point"),
    "words": (ARM.replace("0.6", '"much"'), "must be a number above 0 (kg m^2)\n"),
    "a table of many": (MANY, "each under a line [[recordings]]"),
    "a table of many, twice": (
        MANY + RECORDING.replace("[[recordings]]", "[recordings]  # another"),
        "line 9: [recordings] is there twice; each stands under a line of its own, [[recordings]]",
    ),
    "a table twice": (ARM + ARM, "line 6: [arm] is there twice\n"),
    "a key twice": (ARM + "elbow = 0.7", "line 6: elbow is there twice in its table"),
    "millimetres": (ARM.replace("0.4", "400"), "are the lengths in m?"),
    "no real arm, in metres": (ARM.replace("1.4", "2.2"), "would have no inertia\n"),
    "a mass": (ARM + "m1 = 4", "coupling = m2 c2 (docs/lab-files.md)"),
    "a length": (ARM + "l_1 = 0.4", "shoulder = J1 + m1 c1^2 + m2 l1^2"),
    "a wrong letter": (ARM.replace("link", "lenk"), 'did you mean "link_lengths"?'),
    "the rest of the elbow": (ARM + "theta2 = 0", "[arm] has link_lengths"),
    "question marks": (
        ARM.replace("[0.4, 0.4]", '["?", "?"]').replace("0.6", '"?"')
        + RECORDING
        + RECORDING.replace("0.1", '"?"'),
        '"?" is left in [arm] link_lengths, elbow; [[recordings]] 2 theta2: write numbers',
    ),
}


@pytest.mark.parametrize(("content", "says"), WRITTEN.values(), ids=WRITTEN)
def test_what_people_write_is_told_in_their_words(refused, content, says):
    write("x.csv", GOOD)
    write("x.toml", content if "[recordings]" in content else f"{content}\n{RECORDING}")
    assert says in refused("fit", "x.toml", "--no-cache")


class Endless(io.RawIOBase):
    """What `yes` writes."""

    def readable(self):
        return True

    def readinto(self, buffer):
        buffer[:] = b"y" * len(buffer)
        return len(buffer)


def test_standard_input_without_an_end(monkeypatch, capsys):
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BufferedReader(Endless())))
    assert main(["fit", "-", "--no-cache"]) == 2
    assert capsys.readouterr().err == (
        "residyn: standard input: has more than 10 MB, too large for a TOML file\n"
    )


def test_the_good_ones_are_good(tmp_path, monkeypatch):
    """Else nothing above is due to what it names."""
    from residyn.recordings.experiment import load

    monkeypatch.chdir(tmp_path)
    write("x.csv", GOOD)
    write("x.toml", ARM + RECORDING)
    (recording,) = load("x.toml").recordings
    assert (recording.warnings, recording.understood) == ((), "")

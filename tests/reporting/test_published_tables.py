"""What a paper takes: tables in LaTeX and CSV, and pictures whose fonts print."""

import csv
import dataclasses
import io
import re

import matplotlib as mpl
import numpy as np
import pytest

from residyn.fitting import Number
from residyn.reporting import figures as plot
from residyn.reporting.layout import typeset
from residyn.reporting.names import own_name
from residyn.reporting.numbers import measured
from tests import by_hand


@pytest.fixture(scope="module")
def fit():
    return by_hand.a_fit((by_hand.FOUND,))


def read(text):
    return list(csv.DictReader(io.StringIO(text)))


def rows_of(latex):
    """The cells of each row of a LaTeX text."""
    lines = [line for line in latex.splitlines() if line.endswith(r"\\")]
    return [[cell.strip() for cell in line.removesuffix(r"\\").split(" & ")] for line in lines]


def well_formed(latex):
    """Braces and dollars close, nothing is left that LaTeX would stop at."""
    plain = latex.replace("% needs", "").replace("\\%", "").replace("\\_", "").replace("\\$", "")
    plain = plain.replace("\\&", "").replace("\\#", "")
    assert plain.count("{") == plain.count("}")
    assert plain.count("$") % 2 == 0
    outside = re.sub(r"\$[^$]*\$", "", plain)
    assert not re.search(r"[_^%#~]", outside)
    assert latex.isascii()


# -- numbers ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "std", "text"),
    [
        (16.6712, 0.0213, r"$16.671 \pm 0.021$"),
        (16.6712, 0.0097, r"$16.6712 \pm 0.0097$"),
        (-0.5, 0.3, r"$-0.50 \pm 0.30$"),
        (1.234e-5, 3.1e-7, r"$1.234 \times 10^{-5} \pm 3.1 \times 10^{-7}$"),
        (1.234e7, 3.1e5, r"$1.234 \times 10^{7} \pm 3.1 \times 10^{5}$"),
        (0.0, 0.02, r"$0.000 \pm 0.020$"),
        (-0.0001, 0.02, r"$0.000 \pm 0.020$"),
        (16.6712, float("nan"), "$16.67$"),
        (float("nan"), float("nan"), "?"),
    ],
)
def test_a_value_ends_where_its_error_ends(value, std, text):
    assert typeset(measured(value, std)) == text


def test_the_printed_value_and_error_are_the_numbers():
    random = np.random.default_rng(0)
    for _ in range(300):
        std = 10 ** random.uniform(-9, 5)
        value = std * 10 ** random.uniform(-1, 5) * random.choice([-1, 1])
        each = typeset(measured(value, std)).strip("$").split(r" \pm ")
        a, b = (float(re.sub(r" \\times 10\^\{(.*)\}", r"e\1", x)) for x in each)
        assert abs(a - value) <= 0.051 * std
        assert abs(b / std - 1) <= 0.051


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ("N m/rad", r"N\,m/rad"),
        ("N m s^2/rad^2", r"N\,m\,s$^2$/rad$^2$"),
        ("N m/(rad s)", r"N\,m/(rad\,s)"),
        ("µrad", r"\textmu{}rad"),
        ("0.98 ×10⁻³", r"$0.98$ $\times$10$^-$$^3$"),
        ("> 99 %", r"$>$\,99\,\%"),
        ("0.90 mrad (1.1 ×)", r"$0.90$\,mrad ($1.1$ $\times$)"),
    ],
)
def test_units_are_upright(given, text):
    assert typeset(given) == text


def test_words_of_users_are_shown_as_they_are():
    assert typeset("a_b & 5 % of $1 {x}") == r"a\_b \& 5\,\% of \$1 \{x\}"
    assert typeset("run-2.csv, x^y") == r"run-2.csv, x\textasciicircum{}y"


# -- a fit -----------------------------------------------------------------------------------


def test_a_fit_in_latex(fit):
    latex = fit.to_latex()
    well_formed(latex)
    rows = rows_of(latex)
    assert {len(row) for row in rows} == {4}
    assert ["spring, shoulder", "joint stiffness", r"$17.000 \pm 0.020$", r"N\,m/rad"] in rows
    assert ["mode 1", "natural frequency", r"$0.36000 \pm 0.00020$", "Hz"] in rows
    assert latex.count(r"\midrule") == 3
    for word in ("rms residual", "held out", "reduced chi-square", "toprule", "bottomrule"):
        assert word in latex


def test_a_fit_in_csv(fit):
    rows = read(fit.to_csv())
    assert list(rows[0]) == ["name", "value", "std", "unit"]
    found = {row["name"]: row for row in rows}
    for n in fit.numbers:
        row = found[n.name]
        assert (float(row["value"]), float(row["std"]), row["unit"]) == (n.value, n.std, n.unit)
    assert float(found["check_rmse:elbow"]["value"]) == fit.check_rmse[1]
    assert found["rmse:elbow"]["unit"] == "rad"
    assert found["reduced_chi2"]["std"] == ""


def test_a_number_that_a_recording_has_for_itself_stands_at_the_place_of_its_effect(fit):
    name = f"{by_hand.FOUND}.torque (run2.csv)"
    own = dataclasses.replace(fit.numbers[-1], name=name, words="torque, in run2.csv")
    latex = dataclasses.replace(fit, numbers=(*fit.numbers, own)).to_latex()
    well_formed(latex)
    cells = [row[:2] for row in rows_of(latex)]
    assert ["Coulomb friction, elbow", "torque, in run2.csv"] in cells
    assert own_name(name) == "torque (run2.csv)"


def test_what_is_not_determined_says_so(fit):
    first = dataclasses.replace(fit.numbers[0], std=float("inf"), determined=False)
    assert isinstance(first, Number)
    odd = dataclasses.replace(fit, numbers=(first, *fit.numbers[1:]), modes=())
    assert "not determined" in odd.to_latex()
    assert read(odd.to_csv())[0]["std"] == ""
    assert odd.to_latex().count(r"\midrule") == 2


# -- a diagnosis -----------------------------------------------------------------------------


@pytest.mark.parametrize("which", ["missing", "adequate", "unexplained"])
def test_a_diagnosis_in_latex(which):
    found = getattr(by_hand, which)()
    latex = found.to_latex()
    well_formed(latex)
    ladder, candidates = latex.split("\n\n")
    head, *rows = rows_of(ladder)
    assert head[1] == "shoulder fitted"
    assert {len(row) for row in rows} == {6}
    assert {len(row) for row in rows_of(candidates)} == {4}
    assert len(rows) == len(found.ladder)
    if which == "missing":
        assert rows_of(ladder)[-1][0] == "+ Coulomb friction, elbow"
        assert rows_of(candidates)[1][0] == "Coulomb friction, elbow"
        assert rows_of(candidates)[1][2] == "0"
        assert rows_of(candidates)[1][3] == r"torque $0.20010 \pm 0.00060$\,N\,m"


def test_a_diagnosis_without_anything_held_out():
    found = by_hand.missing()
    ladder = tuple(dataclasses.replace(r, held_out=None) for r in found.ladder)
    bare = dataclasses.replace(found, ladder=ladder)
    assert {len(row) for row in rows_of(bare.to_latex().split("\n\n")[0])} == {4}
    assert "check_rmse" not in bare.to_csv()


def test_a_diagnosis_in_csv():
    found = by_hand.missing()
    rows = read(found.to_csv())
    assert list(rows[0]) == ["table", "model", "name", "value", "std", "unit"]
    ladder = [row for row in rows if row["table"] == "ladder"]
    assert [r["model"] for r in ladder if r["name"] == "reduced_chi2"] == [
        "springs and dampers",
        "+ coulomb_friction:elbow",
    ]
    check = next(r for r in ladder if r["name"] == "check_rmse:shoulder")
    assert float(check["value"]) == found.ladder[0].held_out.held_out.rmse[0]
    candidates = [row for row in rows if row["table"] == "candidate"]
    own = [r for r in candidates if r["model"] == by_hand.RIVAL]
    assert [r["name"] for r in own][:2] == ["probability", "log_evidence"]
    assert float(own[1]["value"]) == -2.7
    told = {row["model"] for row in candidates}
    assert told == {c.effect for c in found.candidates}


# -- pictures --------------------------------------------------------------------------------


@pytest.mark.parametrize("users", [{}, {"pdf.fonttype": 3, "svg.fonttype": "none"}])
def test_fonts_of_pictures_print(fit, users):
    with mpl.rc_context(users):
        for figure in (plot.overlay(fit), plot.ladder(by_hand.missing())):
            data = {}
            for kind in ("pdf", "svg"):
                buffer = io.BytesIO()
                figure.savefig(buffer, format=kind)
                data[kind] = buffer.getvalue()
            assert b"/FontFile2" in data["pdf"] or b"/Type0" in data["pdf"]
            assert b"/Type3" not in data["pdf"]
            assert b"<text" not in data["svg"]
            assert b"<path" in data["svg"]
        for name, value in users.items():
            assert mpl.rcParams[name] == value

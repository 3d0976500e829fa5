"""What a user sees of a diagnosis: the printout, the pictures, the page, the command."""

import dataclasses
import json
import math
import re

import pytest

import residyn.diagnosis
from residyn import plot, report
from residyn.cli import main
from residyn.diagnosis import printed
from residyn.diagnosis.result import Value
from residyn.fitting import FitError
from tests import by_hand
from tests.by_hand import FOUND, NEXT, RIVAL, a_candidate, a_rung
from tests.legible import legible

KINDS = {"missing": by_hand.missing, "adequate": by_hand.adequate}
KINDS["unexplained"] = by_hand.unexplained
CONTRACT = {
    "verdict",
    "added",
    "ladder",
    "candidates",
    "lookalikes",
    "next_experiment",
    "missing_torque",
}


@pytest.fixture(scope="module")
def found():
    return {name: make() for name, make in KINDS.items()}


# -- the printout ----------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_it_begins_with_the_verdict_and_fits_80_columns(found, kind):
    text = str(found[kind])
    assert text.startswith(found[kind].words[0][:40])
    assert max(map(len, text.splitlines())) <= 80
    assert text.endswith(str(found[kind].fit))


def test_it_shows_the_ladder_and_the_suspects(found):
    text = str(found["missing"])
    for line in (
        r"springs and dampers +3\.\d x +46 x",
        r"\+ coulomb_friction:elbow +1\.0 x +1\.0 x +1\.0 x +1\.0 x +0\.980",
        r"coulomb_friction:elbow +93 % +243101 +248905\n +torque 0\.20010 \+/- 0\.00060 N m",
        r"hysteresis:elbow +< 1 %",
        r"bearing_quadratic_drag +< 1 % +70000 +-12",
        r"and 2 more that were screened",
        r"cannot be told from stribeck_friction:elbow",
        NEXT.words[:40],
    ):
        assert re.search(line, text), line


def test_what_was_dropped_is_said(found):
    text = str(found["unexplained"])
    assert "+ asymmetric_stiffness:shoulder" in text
    assert "without quadratic_drag:elbow" in text
    assert found["unexplained"].added == ("asymmetric_stiffness:shoulder",)


def test_more_joints_than_columns_stand_under_each_other(found):
    rung = found["missing"].ladder[0]
    lines = printed._stacked(rung, rung.fit.joints)
    assert "springs and dampers" in lines[0]
    assert [line.split()[0] for line in lines[1:]] == ["shoulder", "elbow"]
    assert all("x fitted" in line and "x held out" in line for line in lines[1:])


def test_the_users_own_effects_are_part_of_the_base():
    assert printed.base_name(by_hand.a_fit()) == "springs and dampers"
    assert printed.base_name(by_hand.a_fit(("gravity",))) == "springs and dampers + gravity"


@pytest.mark.parametrize(
    ("label", "words"),
    [
        (FOUND, "coulomb_friction at the elbow"),
        ("gravity", "gravity"),
        ("inertia_error:elbow", "inertia_error:elbow"),
        ("inertia_error:coupling", "inertia_error:coupling"),
    ],
)
def test_names_with_their_places(label, words):
    assert printed.at_place(label, by_hand.JOINTS) == words


@pytest.mark.parametrize(
    ("probability", "words"),
    [(0.934, "93 %"), (1.0, "> 99 %"), (0.0, "< 1 %"), (0.5, "50 %"), (math.nan, "?")],
)
def test_nothing_is_certain(probability, words):
    assert printed.percent(probability) == words


def test_an_unknown_error_is_left_out():
    assert printed.value_words(Value(0.25, math.nan, "rad/s")) == "0.2500 rad/s"
    assert printed.value_words(Value(0.25, 0.01, "1")) == "0.250 +/- 0.010"


def test_the_dictionary_keeps_the_contract(found):
    for diagnosis in found.values():
        result = diagnosis.to_dict()
        assert set(result) >= CONTRACT
        assert set(result["ladder"][0]) == {"model", "rmse", "check_rmse", "reduced_chi2"}
        json.dumps(result, allow_nan=False)
    first = found["missing"].to_dict()["candidates"][0]
    keys = {"effect", "probability", "chi2_drop_screened", "chi2_drop_refit", "parameters"}
    assert set(first) == keys


# -- the pictures ----------------------------------------------------------------------------


@pytest.mark.parametrize("narrow", [False, True], ids=["wide", "narrow"])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("draw", ["ladder", "suspects"])
def test_no_word_of_a_picture_is_cut_or_covered(found, kind, draw, narrow, monkeypatch):
    words = legible(getattr(plot, draw)(found[kind], narrow=narrow), monkeypatch)
    if draw == "ladder":
        assert any(w.startswith("the noise") for w in words)
        assert any("springs and dampers" in w for w in words)


@pytest.mark.parametrize("narrow", [False, True], ids=["wide", "narrow"])
def test_many_rungs_are_listed_beneath(found, narrow, monkeypatch):
    ladder = found["missing"].ladder
    each = [a_rung(ladder[0].fit, f"quadratic_drag:{j}", held=(9, 7)) for j in by_hand.JOINTS]
    many = dataclasses.replace(found["missing"], ladder=(*ladder[:1], *each, *each, *ladder[1:]))
    words = legible(plot.ladder(many, narrow=narrow), monkeypatch)
    assert "5  + coulomb_friction at the elbow" in words


def test_a_ladder_without_held_out_errors_can_be_drawn(found, monkeypatch):
    ladder = [dataclasses.replace(rung, held_out=None) for rung in found["missing"].ladder]
    bare = dataclasses.replace(found["missing"], ladder=tuple(ladder))
    words = legible(plot.ladder(bare), monkeypatch)
    assert not [w for w in words if "held out" in w]
    assert "held out" not in str(bare).partition("[[Suspects]]")[0]


def test_all_suspects_screened_only(found, monkeypatch):
    few = tuple(a_candidate(name, 0.0, 3.0) for name in (FOUND, RIVAL))
    words = legible(
        plot.suspects(dataclasses.replace(found["adequate"], candidates=few)), monkeypatch
    )
    assert words.count("not tried") == 2


# -- the page --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def pages(found):
    made = {}
    for kind, d in found.items():
        fits = [("first", d.base), ("last", d.fit)] if kind == "missing" else [("only", d.fit)]
        made[kind] = report.render(fits, diagnosis=d)
    return made


def headings(page):
    return [
        re.sub(r"<.*?>", "", h).strip() for h in re.findall(r"<h[12]>(.*?)</h[12]>", page, re.S)
    ]


def test_the_page_begins_with_the_verdict_and_the_falling_error(pages, found):
    page = pages["missing"]
    assert headings(page) == [
        "What is missing: coulomb_friction at the elbow",
        "The suspects",
        "What cannot be told apart",
        "What to measure next",
        "What is left",
        "1. first",
        "2. last",
    ]
    head = page[: page.index("<h2>")]
    assert head.count("<figure>") == 1
    assert "0.2001 ±" in head
    for words in ("46 ×", "0.980", "hysteresis", NEXT.words, "(accepted)"):
        assert words in page or words.replace(":", ":<wbr>") in page
    assert "The torque that it still lacks is estimated as" in page


def test_the_accepted_effect_is_drawn_over_the_torque_of_the_first_model(pages):
    words = pages["missing"].partition("The torque that the first model lacks")[2]
    assert f"Blue: what {FOUND} would draw" in words
    assert "shoulder: " not in words.partition("<h2>")[0]  # it does not act there


def test_what_nothing_explains_is_shown_first(pages):
    first = headings(pages["unexplained"])[:3]
    assert first[0].endswith("and something that no effect explains")
    assert first[1:] == ["The torque that is still missing", "The suspects"]


def test_a_page_of_nothing_missing(pages):
    assert headings(pages["adequate"])[0] == "Nothing is missing"
    assert "What cannot be told apart" not in pages["adequate"]


def test_names_from_files_are_only_words(pages):
    for page in pages.values():
        assert "<script" not in page
        assert "49" not in re.findall(r"alert.{20}", page)


# -- the command -----------------------------------------------------------------------------

CART = """
[inertia]
joints = ["cart"]
units = ["m"]
matrix = [[1.0]]

[[recordings]]
file = "one.csv"
noise = 1e-4
"""


@pytest.fixture
def command(tmp_path, monkeypatch, capsys):
    """Runs `diagnose` where only the reading is real; what it asked for is in `asked`."""
    (tmp_path / "cart.toml").write_text(CART)
    rows = (f"{i / 100:.2f},{0.05 * math.cos(i / 10)!r}" for i in range(300))
    (tmp_path / "one.csv").write_text("\n".join(["t,q1", *rows, ""]))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("residyn.cli._diagnose.set_up_jax", lambda cache: None)
    asked = {}

    def run(*words, result=None):
        def diagnose(experiment, **named):
            asked.update(named)
            if isinstance(result, Exception):
                raise result
            return result

        monkeypatch.setattr(residyn.diagnosis, "diagnose", diagnose, raising=False)
        status = main(["diagnose", "cart.toml", *words])
        return status, *capsys.readouterr(), asked

    return run


def test_the_command_passes_everything_on(command, found):
    words = ["--with", "gravity", "--with", "wind", "--max-effects", "2", "--starts", "4"]
    status, out, err, asked = command(*words, result=found["missing"])
    assert (status, err) == (0, "")
    assert out == f"{found['missing']}\n"
    del asked["progress"]
    assert asked == {"effects": ["gravity", "wind"], "max_effects": 2, "starts": 4}


def test_the_command_writes_json_and_a_report(command, found, tmp_path):
    status, out, err, _ = command("--json", "-", "--report", "d.html", result=found["adequate"])
    assert status == 0
    assert json.loads(out)["verdict"] == "adequate"
    assert err.endswith("report: d.html\n")
    page = (tmp_path / "d.html").read_text()
    assert headings(page)[-1] == "cart.toml: springs and dampers"


@pytest.mark.parametrize(
    ("words", "result", "status", "line"),
    [
        (["--max-effects", "-1"], None, 2, "--max-effects"),
        (["--max-effects", "some"], None, 2, "--max-effects"),
        (["--json", "one.csv"], None, 2, "input"),
        ([], ValueError('there is no effect "wind"'), 2, "wind"),
        ([], FitError("no start led to finite numbers"), 1, "no start"),
    ],
)
def test_the_command_complains_in_one_line(command, words, result, status, line):
    ended, out, err, _ = command(*words, result=result)
    assert (ended, out) == (status, "")
    assert err.startswith("residyn: ")
    assert err.count("\n") == 1
    assert line in err


def test_numbers_that_did_not_settle_are_exit_status_1(command, found):
    d = found["adequate"]
    rough = dataclasses.replace(d.ladder[0].fit, converged=False, reason="step limit reached")
    rung = dataclasses.replace(d.ladder[0], fit=rough)
    status, out, err, _ = command(result=dataclasses.replace(d, ladder=(rung,)))
    assert status == 1
    assert "[[Ladder]]" in out
    assert err == "residyn: step limit reached\n"

"""What a user sees of a diagnosis: its sentences, the printout, the pictures, the page, the
command."""

import dataclasses
import json
import math
import re
from types import SimpleNamespace

import numpy as np
import pytest

from residyn import reporting as report
from residyn.diagnosis.evidence import prior_of
from residyn.diagnosis.missing_torque import scene_of
from residyn.diagnosis.residuals import Coloured
from residyn.diagnosis.result import Budget, ChannelError, ColouredNoise, Family
from residyn.effects import ConstantTorque, StribeckFriction, catalogue
from residyn.recordings.tables import InertiaTable
from residyn.reporting import diagnosis as text
from residyn.reporting import figures as plot
from residyn.reporting import fit as about_fits
from residyn.reporting import laws as about_laws
from residyn.reporting import names, numbers
from residyn.reporting.compare import draw_torque
from tests import by_hand
from tests.by_hand import FOUND, NEXT, RIVAL, a_candidate, a_model
from tests.chromium import driver
from tests.legible import legible

KINDS = {"missing": by_hand.missing, "adequate": by_hand.adequate}
KINDS["unexplained"] = by_hand.unexplained
CONTRACT = {
    "verdict",
    "verdict_probability",
    "words",
    "added",
    "ladder",
    "candidates",
    "families",
    "lookalikes",
    "next_experiment",
    "missing_torque",
    "random_torque",
    "budget",
}


pytestmark = pytest.mark.usefixtures("pictures_not_written")


@pytest.fixture(scope="module")
def found():
    return {name: make() for name, make in KINDS.items()}


# -- the sentences ---------------------------------------------------------------------------


def family(probability, name="dry friction", effect=FOUND):
    return Family(name, "elbow", probability, ((effect, probability),))


def test_family_and_place_come_first_then_the_law_with_its_numbers(found):
    words = found["missing"].words
    assert words[0] == "Dry friction at the elbow is missing (99 %)."
    assert words[1] == (
        "Within dry friction, the law is most likely Coulomb friction (93 %; torque 0.2000 +/- "
        "0.0010 N m); Stribeck friction (6 %) is possible too."
    )


@pytest.mark.usefixtures("float64")
def test_a_law_that_is_enough_says_what_the_next_one_would_add():
    """In its place beside what else was added, not alone beside springs and dampers."""
    pull = "constant_torque:elbow"
    families = (
        Family("dry friction", "elbow", 1.0, ((FOUND, 0.999), (RIVAL, 0.001))),
        Family("offset", "elbow", 1.0, ((pull, 0.999),)),
    )
    candidates = a_candidate(FOUND, 0.999, 0.0), a_candidate(RIVAL, 0.001, -7.4)
    fit = by_hand.a_fit((pull, FOUND), by_hand.SLIP, 0.98)
    ladder = by_hand.a_model(by_hand.a_fit()), by_hand.a_model(fit, FOUND, held=(1.0, 1.0))
    alone = by_hand.missing(families=families, candidates=candidates, lookalikes=())
    found = dataclasses.replace(alone, ladder=ladder)
    assert "is enough; Stribeck friction (< 1 %) is not needed." in " ".join(found.words)
    scene, base = scene_of(fit.experiment, ())
    members = (*base, ConstantTorque("elbow"), StribeckFriction("elbow"))
    prior = prior_of(scene, members)
    known = np.append(np.full(len(prior.mean) - 3, 0.01), [0.2, 3e-5, 0.05])
    t = scene.start(members, prior)
    u = np.append(prior.regressors(known), t.u[len(known) :])
    at = dataclasses.replace(t, u=u, covariance=1e-12 * np.eye(len(u)))
    tried = {frozenset({pull, RIVAL}): SimpleNamespace(posterior=at)}
    searched = dataclasses.replace(found, search=SimpleNamespace(scene=scene, tried=tried))
    words = " ".join(searched.words)
    value = re.search(r"is enough; Stribeck friction \(< 1 %\) would add excess (\S+)", words)
    assert value
    assert float(value[1]) == pytest.approx(3e-5, rel=1e-2)
    assert "possible" not in words


@pytest.mark.parametrize(
    ("probability", "says"),
    [
        (0.9999, "Dry friction at the elbow is missing (> 99 %)."),
        (0.95, "Dry friction at the elbow is missing (95 %)."),
        (0.7, "Dry friction at the elbow is probably missing (70 %)."),
        (0.3, "Dry friction at the elbow may be missing (30 %)."),
    ],
)
def test_no_sentence_is_surer_than_its_probability(probability, says):
    made = by_hand.missing(families=(family(probability),), verdict_probability=0.8)
    assert made.words[0] == says


def test_what_is_sure_is_not_hedged_though_its_name_is_not():
    """Something is missing for sure; which of three it is, is not."""
    others = (family(0.3, "hysteresis", "hysteresis:elbow"), family(0.29, "gravity", "gravity"))
    made = by_hand.missing(families=(family(0.4), *others), lookalikes=())
    assert made.words[0] == (
        "Something is missing that the catalogue has (> 99 %), most likely dry friction at the "
        "elbow (40 %)."
    )
    said = "Also possible: hysteresis at the elbow (30 %) and gravity at the elbow (29 %)."
    assert said in made.words


def test_a_kind_whose_law_has_no_name_is_said_first():
    kind = Family("dry friction", "elbow", 0.72, ((FOUND, 0.09),), 0.63)
    ladder = by_hand.adequate().ladder
    made = by_hand.a_diagnosis("unexplained", ladder, families=(kind,))
    assert made.added == ()
    assert made.words[:2] == (
        "Dry friction at the elbow is probably missing (72 %), of a law that the catalogue does "
        "not have.",
        "Something is missing that no effect of the catalogue explains (> 99 %).",
    )
    sure = Family("dry friction", "elbow", 0.99, ((FOUND, 0.09),), 0.9)
    made = by_hand.a_diagnosis("unexplained", ladder, families=(sure,))
    assert made.words[0] == (
        "Dry friction at the elbow is missing (99 %), of a law that the catalogue does not have."
    )
    assert "no effect of the catalogue" not in " ".join(made.words)
    made = by_hand.a_diagnosis("unexplained", ladder, families=(kind,))
    assert "Also possible" not in " ".join(made.words)
    assert text.title_of(made).startswith("What is missing: dry friction at the elbow")


def test_what_can_be_counted_has_an_article_in_a_sentence():
    kinds = {kind.kind() for kind in catalogue().values()} - {"spring", "viscous damper"}
    counted = {
        "constant torque", "dead zone (backlash)", "periodic disturbance", "slipping brake",
        "relaxing spring", "curved sensor", "sensor delay", "sensor offset", "sensor scale",
        "flexible wrist", "inertia error", "inertia torque as printed (Eq. 3)", "spring",
        "viscous damper",
    }  # fmt: skip
    for kind in catalogue().values():
        title = names.lower(kind.titled())
        assert names.counted(title) == (title in counted), title
    assert {kind for kind in kinds if names.an(kind) == kind} == {
        "dry friction", "gravity", "stiffness drift", "stiffness between joints"
    }  # fmt: skip
    assert names.an("offset") == "an offset"
    law = Family("damping law", "elbow", 0.99, (("quadratic_drag:elbow", 0.9), (FOUND, 0.09)))
    offset = Family("offset", None, 0.03, (("constant_torque:elbow", 0.03),))
    label = "quadratic_drag:elbow"
    ladder = by_hand.missing().ladder[0], a_model(by_hand.a_fit((label,), 0.0, 1.0), label)
    made = by_hand.a_diagnosis("missing", ladder, families=(law, offset))
    assert made.words[0] == "A damping law at the elbow is missing (99 %)."
    assert made.words[1].startswith("Among damping laws, the law is most likely quadratic drag (")
    assert "Beside a damping law at the elbow, an offset (3 %) is possible too." in made.words
    assert text.title_of(made) == "What is missing: a damping law at the elbow"
    assert "Damping law, elbow" in str(text.families_table(made).rows)
    unsure = dataclasses.replace(law, probability=0.96), offset
    assert "Also possible: an offset (3 %)." in dataclasses.replace(made, families=unsure).words


def test_what_takes_up_a_part_is_said_once_to_be_no_cause():
    made = by_hand.unexplained()
    wrong = tuple(dataclasses.replace(f, probability=0.001) for f in made.families)
    words = " ".join(dataclasses.replace(made, families=wrong).words)
    assert "A spring shape at the shoulder takes up a part of it, but cannot be its cause" in words
    assert words.count("no effect of the catalogue explains") == 1
    assert "What is missing beside asymmetric stiffness at the shoulder is a torque of" in words


def test_that_nothing_explains_it_is_said_first_where_it_is_surer_than_the_names():
    made = by_hand.unexplained()
    unsure = tuple(dataclasses.replace(f, probability=0.42) for f in made.families)
    doubted = dataclasses.replace(made, families=unsure)
    assert doubted.words[:2] == (
        "Something is missing that no effect of the catalogue explains (> 99 %).",
        "A spring shape at the shoulder may be missing (42 %).",
    )
    words = " ".join(doubted.words)
    assert words.count("no effect of the catalogue explains") == 1
    assert "What is missing is a torque of" in words
    assert text.title_of(doubted).startswith("Something is missing that no effect")
    assert made.words[0] == "A spring shape at the shoulder is missing (97 %)."


def test_a_law_without_a_name_is_said_beside_what_it_joins():
    law = dataclasses.replace(by_hand.a_law(), beside=("constant_torque:elbow", FOUND))
    (said,) = [x for x in by_hand.unexplained(laws=(law,)).words if "what has no name" in x]
    assert said == (
        "Beside a constant torque at the elbow and Coulomb friction at the elbow, what has no name "
        "is a torque at the elbow that depends on the rate (95 %)."
    )


def test_the_numbers_of_a_formula_stay_under_its_law():
    numbers_of = dict.fromkeys("abcd", (0.42, 0.0015, "N m"))
    formula = SimpleNamespace(
        equation="sign(q') (a sin(2 pi q/period) + b cos(2 pi q/period))", parameters=numbers_of
    )
    law = dataclasses.replace(by_hand.a_law(), formula=formula)
    _head, *lines = about_laws.text(by_hand.unexplained(laws=(law,)))
    first = next(i for i, line in enumerate(lines) if "A torque at the elbow" in line)
    last = next(i for i, line in enumerate(lines) if "--found" in line)
    told = lines[first + 1 : last]
    assert len(told) > 2
    assert all(line.startswith(" " * 6) and len(line) <= 80 for line in told), told


def test_what_is_possible_only_beside_what_is_sure_says_so():
    other = family(0.03, "inertia error", "inertia_error:elbow")
    sure = by_hand.missing(families=(family(0.9999), other), lookalikes=())
    said = "Beside dry friction at the elbow, an inertia error at the elbow (3 %) is possible too."
    assert said in sure.words
    instead = by_hand.missing(families=(family(0.96), other), lookalikes=())
    assert "Also possible: an inertia error at the elbow (3 %)." in instead.words


def test_how_far_the_error_falls_and_how_small_the_rest_is(found):
    words = " ".join(found["missing"].words)
    falls = (
        r"With Coulomb friction at the elbow the error at the shoulder falls from 3\.\d to 1\.0 "
    )
    assert re.search(falls, words)
    assert "(held out: from 46 to 1.0)" in words
    assert "no more than 0.0015 N m rms at the elbow" in words
    assert "0.075 % of the restoring torque (95 % band)." in words


def test_what_nothing_explains_is_measured_beside_spring_and_damper(found):
    words = " ".join(found["unexplained"].words)
    share = text.explained_share(found["unexplained"])
    assert share == pytest.approx(1 - (4.1 - 1) / (12.3 - 1))
    assert "that explains 73 % of the squared error above the noise" in words
    assert "Something more is missing that no effect of the catalogue explains (> 99 %)" in words
    assert "0.10 N m rms at the elbow (95 % band 0.050 to 0.15; 5.0 % of the rest" in words
    for n in found["unexplained"].fit.numbers[-len(found["unexplained"].added) :]:
        beside = found["unexplained"].parameters[n.name]
        assert beside.std > n.std
        assert numbers.measured(beside.value, beside.std, beside.unit) in words
    rate = found["unexplained"].still_missing[0].torque.rate[:, 1]
    damper = next(n for n in found["unexplained"].fit.numbers if n.name.startswith("damper:elbow"))
    ratio = 0.1 / (damper.value * np.sqrt(np.mean(rate**2)))
    assert f"the damping by {numbers.share(ratio)}" in words


def test_nothing_found_and_yet_something_missing():
    made = by_hand.unexplained()
    bare = dataclasses.replace(made, ladder=made.ladder[:1])
    words = " ".join(bare.words)
    assert words.startswith(
        "Something is missing that no effect of the catalogue explains (> 99 %)."
    )
    assert "What is missing is a torque of" in words
    assert "explains 0 %" not in words


def test_columns_that_are_wrong_are_all_that_is_said(monkeypatch):
    clause = "the columns of shoulder and elbow are exchanged"
    for complete, so in ((True, "to within the noise"), (False, "alone explain more than any")):
        made = by_hand.unexplained(channels=ChannelError(clause, 0.999, complete))
        words = " ".join(made.words)
        assert words.startswith(f"It seems that {clause} (> 99 %): read so, springs and dampers ")
        assert so in words
        assert "missing" not in words
        assert text.title_of(made) == "The columns of the recordings are not what the file says"
        bare = dataclasses.replace(made, ladder=made.ladder[:1])
        shown = " ".join(legible(plot.ladder(bare), monkeypatch))
        assert "the columns are to be put right first" in shown
        assert "catalogue" not in shown


@pytest.mark.parametrize(
    ("count", "says"),
    [
        (1, "Something is missing (> 99 %); no effect was tried yet."),
        (2, "Something is missing that no effect that was tried explains (> 99 %)."),
    ],
)
def test_a_search_cut_short_does_not_blame_the_catalogue(count, says, monkeypatch):
    made = by_hand.unexplained(budget=Budget(count, 40, "budget"))
    bare = dataclasses.replace(made, ladder=made.ladder[:1])
    words = " ".join(bare.words)
    assert f"after {('one model', '2 models')[count - 1]}" in words
    assert says in words
    shown = " ".join([words, text.title_of(bare), *legible(plot.ladder(bare), monkeypatch)])
    assert "catalogue" not in shown
    assert ("effect that was tried" in shown) == (count == 2)


def test_a_disturbance_may_be_in_the_sensor(found):
    """In a linear rig a sine of the sensor's zero and one of a force have the same readings."""
    says = "A sensor whose zero swings at the frequency of the disturbance"
    label = "periodic_disturbance:elbow"
    ladder = by_hand.missing().ladder[0], a_model(by_hand.a_fit((label,), 0.0, 1.0), label)
    kinds = (Family("periodic disturbance", "elbow", 0.99, ((label, 0.99),)),)
    made = by_hand.missing(families=kinds, lookalikes=())
    assert says in " ".join(dataclasses.replace(made, ladder=ladder).words)
    assert says not in " ".join(found["missing"].words)


def test_nothing_missing(found):
    words = found["adequate"].words
    assert words[0] == "Nothing is missing that these recordings could show (> 99 %)."
    unsure = by_hand.adequate(verdict_probability=0.6).words
    assert unsure[0] == "Probably nothing is missing (60 %)."


def test_readings_that_no_torque_explains_are_said_to_be_so():
    left = Coloured("elbow", 1.71, 50.02)
    found = dataclasses.replace(by_hand.adequate(coloured=left), verdict="unexplained")
    words = " ".join(found.words)
    assert words.startswith("No effect of the catalogue explains all of these readings (> 99 %).")
    assert (
        "What is left at the elbow is 1.7 times the noise, and not white, most of all at" in words
    )
    assert "50.02 Hz" in words
    assert "Nothing is missing" not in words
    beside = by_hand.missing(coloured=left._replace(frequency_hz=None))
    words = " ".join(dataclasses.replace(beside, verdict="unexplained").words)
    assert words.startswith("Dry friction at the elbow is missing")
    assert "1.7 times the noise, and not white;" in words


def test_noise_that_is_not_white_is_no_fault_of_the_model():
    """Where the diagnosis says so, and that nothing is missing, all that is said of the fit
    agrees."""
    noise = ColouredNoise(0.08, {"shoulder": (1e-3, "rad"), "elbow": (2e-3, "rad")})
    fit = by_hand.a_fit((), by_hand.SLIP, 3.16)
    ladder = (a_model(fit, held=(1.8, 1.8)),)
    assert "the model misses something" in " ".join(fit.warnings)
    found = by_hand.a_diagnosis("adequate", ladder, families=(), coloured_noise=noise)
    (line,) = [x for x in found.fit.warnings if "times the noise" in x]
    assert "it is noise that is not white" in line
    assert "too small" in line
    (last,) = found.models
    compared = by_hand.a_comparison(found.fit, 1.8, 1e-13)
    assert compared.explained
    page = report.render([("only", last.fit)], diagnosis=found)
    said = [str(found), str(found.to_dict()), *about_fits.verdict(last.fit), *compared.words, page]
    assert not [x for x in said if "misses something" in x or "missing in the model" in x]
    left = dataclasses.replace(found, verdict="unexplained")
    assert "the model misses something" in " ".join(left.fit.warnings)
    assert left.models == left.ladder


def test_what_may_still_be_missing_is_no_secret():
    words = by_hand.missing(verdict_probability=0.7).words
    assert "That it is this and nothing else is not sure (70 %)." in words


def test_what_has_no_name_may_be_in_the_place_of_what_was_added():
    """Names leave only noise, and a law without a name would, too. A name that is likely to be at
    work is beside it."""
    left = by_hand.torques(1e-3, 1.0)
    doubted = (by_hand.a_candidate("asymmetric_stiffness:shoulder", 0.45, 0.0),)
    settings = {"verdict_probability": 0.54, "random_torque": left}
    made = by_hand.unexplained(**settings, candidates=doubted)
    assert "Something more" in " ".join(by_hand.unexplained(**settings).words)
    words = " ".join(made.words)
    assert (
        "Beside asymmetric stiffness at the shoulder only noise is left; but a law that no effect "
        "of the catalogue has may be there instead (54 %)."
    ) in words
    assert "Something more" not in words
    assert text.title_of(made).endswith(
        "spring shape at the shoulder, or something that no effect of the catalogue explains"
    )
    # What has no name was described: the torque that is missing is the one without it.
    law = " ".join(by_hand.unexplained(laws=(by_hand.a_law(),)).words)
    assert "Without that law, something more is missing that no effect of the" in law
    beside = by_hand.unexplained(verdict_probability=0.54)
    assert "Something more" in " ".join(beside.words)
    assert " and something that" in text.title_of(beside)


def test_a_model_of_nothing_says_what_to_check():
    made = by_hand.unexplained(explains_nothing=True)
    words = " ".join(made.words)
    assert words.startswith("The model does not explain this motion, so no effect can be named")
    for check in ("units", "rest", "column", "inertias"):
        assert check in words
    assert "is missing" not in words


def test_numbers_that_cannot_be_are_said_first():
    made = by_hand.missing()
    fit = made.fit
    numbers = tuple(
        dataclasses.replace(n, value=-0.5, std=0.01) if n.name.startswith("damper:elbow") else n
        for n in fit.numbers
    )
    last = dataclasses.replace(made.ladder[-1], fit=dataclasses.replace(fit, numbers=numbers))
    wrong = dataclasses.replace(made, ladder=(made.ladder[0], last))
    assert wrong.words[0].startswith("This model cannot be right: damper:elbow.damping is -0.500")
    within = tuple(dataclasses.replace(n, std=1.0) for n in numbers)
    last = dataclasses.replace(last, fit=dataclasses.replace(fit, numbers=within))
    unsure = dataclasses.replace(made, ladder=(made.ladder[0], last))
    assert unsure.words[0].startswith("Dry friction")


@pytest.mark.parametrize(("why", "says"), [("interrupted", "Ctrl-C"), ("budget", "budget")])
def test_a_search_that_was_ended_says_so(why, says):
    made = by_hand.missing(budget=Budget(7, 40, why))
    assert says in made.words[0]
    assert "after 7 models" in made.words[0]
    assert "best so far" in made.words[0]
    assert made.to_dict()["budget"] == {"models": 7, "candidates": 40, "stopped": why}


# -- the printout ----------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_it_begins_with_the_verdict_and_fits_80_columns(found, kind):
    printed = str(found[kind])
    assert printed.startswith(found[kind].words[0][:40])
    assert max(map(len, printed.splitlines())) <= 80
    assert printed.endswith(str(found[kind].fit))


def test_a_row_of_the_models_names_all_that_joined():
    ladder, labels = by_hand.missing().ladder, (FOUND, "gravity")
    both = a_model(by_hand.a_fit(labels, by_hand.SLIP, 0.98), *labels)
    made = dataclasses.replace(by_hand.missing(), ladder=(ladder[0], both))
    assert text.models(made)[-1].strip() == "+ gravity"
    assert text.models_table(made).rows[1][0] == "+ Coulomb friction, elbow + gravity"
    assert f"ladder,+ {FOUND} + gravity,reduced_chi2" in text.csv(made)


def test_it_shows_the_models_and_the_candidates(found):
    printed = str(found["missing"])
    for line in (
        r"springs and dampers +3\.\d x +46 x",
        r"\+ Coulomb friction, elbow +1\.0 x +1\.0 x +1\.0 x +1\.0 x +0\.980",
        r"Coulomb friction, elbow +93 % +0\n +torque 0\.20010 \+/- 0\.00060 N m",
        r"Hysteresis, elbow +< 1 % +-5\.4",
        r"Coulomb friction at the elbow cannot be told from Stribeck",
        NEXT.words[:40],
    ):
        assert re.search(line, printed), line


def test_what_is_known_to_first_order_only_is_marked(found):
    printed = "\n".join(text.candidates(found["adequate"]))
    assert re.search(r"Asymmetric stiffness, shoulder +< 1 % +-690 \(1st order\)", printed)


def test_what_a_dash_for_held_out_means_is_said(found):
    made = by_hand.missing()
    first, last = made.ladder
    each = first, dataclasses.replace(first, held_out=None), last
    each = tuple(
        dataclasses.replace(m, held_out=m.held_out and m.held_out._replace(what="last third"))
        for m in each
    )
    few = dataclasses.replace(made, ladder=each)
    assert "-: that fit did not settle" in " ".join(" ".join(text.models(few)).split())
    assert "did not settle" not in str(found["missing"])
    rows = text.models_table(few).rows
    assert [row[2] == "-" for row in rows] == [False, True, False]


def test_what_is_left_of_the_way_is_said(found):
    assert "+ asymmetric" in str(found["unexplained"])
    assert found["unexplained"].added == ("asymmetric_stiffness:shoulder",)


def test_more_joints_than_columns_stand_under_each_other(found):
    joints, rmse = ("a", "b", "c"), [0.0, 0.0, 0.0]
    model = SimpleNamespace(labels=())
    fit = SimpleNamespace(joints=joints, model=model, reduced_chi2=2, rmse=rmse)
    held = SimpleNamespace(what="last third", held_out=SimpleNamespace(ratio=[4, 5, 6], rmse=rmse))
    step = SimpleNamespace(fit=fit, held_out=held, times_noise=[1, 2, 3], added=())
    lines = text.models(SimpleNamespace(fit=fit, models=(step,), laws=()))
    shown = [line.split()[-6:] for line in lines[-3:]]
    assert shown[0] == ["a", "1.0", "x", "4.0", "x", "2.00"]
    assert [row[-6] for row in shown] == ["a", "b", "c"]
    assert lines[-3].strip().startswith("springs and dampers")


def test_the_users_own_effects_are_part_of_the_base():
    assert names.base_name(by_hand.a_fit()) == "springs and dampers"
    assert names.base_name(by_hand.a_fit(("gravity",))) == "springs and dampers + gravity"


@pytest.mark.parametrize(
    ("label", "words"),
    [
        (FOUND, "Coulomb friction at the elbow"),
        ("gravity", "Gravity"),
        ("inertia_error:coupling", "Inertia error (coupling)"),
        ("my_own_law:elbow", "My own law at the elbow"),
    ],
)
def test_names_with_their_places(label, words):
    assert names.at_place(label, by_hand.JOINTS) == words


@pytest.mark.parametrize("person", ["Coulomb", "Dahl", "Stribeck"])
def test_persons_keep_their_capital_within_a_sentence(person):
    assert names.named([f"{person.lower()}_friction"], ("cart",)).startswith(f"{person} friction")


def test_one_joint_goes_without_saying():
    assert names.at_place("coulomb_friction:cart", ("cart",)) == "Coulomb friction"


@pytest.mark.parametrize(
    ("probability", "words"),
    [(0.934, "93 %"), (1.0, "> 99 %"), (0.0, "< 1 %"), (0.5, "50 %"), (math.nan, "?")],
)
def test_nothing_is_certain(probability, words):
    assert numbers.percent(probability) == words


def test_an_unknown_error_is_left_out():
    assert numbers.measured(0.25, math.nan, "rad/s") == "0.2500 rad/s"
    assert numbers.measured(0.25, 0.01, "1") == "0.250 +/- 0.010"


def test_the_dictionary_keeps_the_contract(found):
    model_keys = {"model", "rmse", "check_rmse", "reduced_chi2", "log_evidence"}
    for diagnosis in found.values():
        result = diagnosis.to_dict()
        assert set(result) >= CONTRACT
        assert set(result["ladder"][0]) == model_keys
        torque = result["random_torque"]["elbow"]
        assert set(torque) == {"rms", "low", "high", "unit", "share_of_spring"}
        json.dumps(result, allow_nan=False)
    first = found["missing"].to_dict()["candidates"][0]
    assert set(first) == {"effect", "probability", "log_evidence", "parameters"}
    kind = found["missing"].to_dict()["families"][0]
    assert set(kind) == {"name", "place", "probability", "members", "without_a_name"}


# -- the pictures ----------------------------------------------------------------------------


@pytest.mark.parametrize("narrow", [False, True], ids=["wide", "narrow"])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("draw", ["ladder", "candidates"])
def test_no_word_of_a_picture_is_cut_or_covered(found, kind, draw, narrow, monkeypatch):
    words = legible(getattr(plot, draw)(found[kind], narrow=narrow), monkeypatch)
    if draw == "ladder":
        assert any(w.startswith("the noise") for w in words)
        assert any("springs and dampers" in w for w in words)


@pytest.mark.parametrize("narrow", [False, True], ids=["wide", "narrow"])
def test_many_models_are_listed_beneath(found, narrow, monkeypatch):
    ladder = found["missing"].ladder
    each = [a_model(ladder[0].fit, f"quadratic_drag:{j}", held=(9, 7)) for j in by_hand.JOINTS]
    many = dataclasses.replace(found["missing"], ladder=(*ladder[:1], *each, *each, *ladder[1:]))
    words = legible(plot.ladder(many, narrow=narrow), monkeypatch)
    assert any("5  + Coulomb friction at the elbow" in w for w in words)


def test_a_ladder_without_held_out_errors_can_be_drawn(found, monkeypatch):
    ladder = [dataclasses.replace(step, held_out=None) for step in found["missing"].ladder]
    bare = dataclasses.replace(found["missing"], ladder=tuple(ladder))
    words = legible(plot.ladder(bare), monkeypatch)
    assert not [w for w in words if "held out" in w]
    assert "held out" not in "\n".join(text.models(bare))


def test_candidates_known_to_first_order_have_their_own_colour(found, monkeypatch):
    few = tuple(a_candidate(name, 0.0, -3.0, iterated=False) for name in (FOUND, RIVAL))
    made = dataclasses.replace(found["adequate"], candidates=few)
    assert "to first order only" in legible(plot.candidates(made), monkeypatch)
    tried = tuple(a_candidate(name, 0.0, -3.0) for name in (FOUND, RIVAL))
    made = dataclasses.replace(found["adequate"], candidates=tried)
    assert "to first order only" not in legible(plot.candidates(made), monkeypatch)


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
        "What is missing: dry friction at the elbow",
        "What it might be",
        "What cannot be told apart",
        "What to measure next",
        "What is left",
        "1. first",
        "2. last",
        "Words on this page",
    ]
    head = page[: page.index("<h2>")]
    assert head.count("<figure>") == 1
    assert "±\u00a00.0010" in head
    for words in (
        "46 ×",
        "0.980",
        "hysteresis",
        names.unbroken(NEXT.words)[:120],
        "angle of the elbow after 3.20 s",
        "0.0800\u00a0±\u00a00.0010\u00a0rad",
        "(added)",
        "Dry friction at the elbow",
    ):
        assert words in page or words.replace(":", ":<wbr>") in page
    assert "The torque that this model still lacks" in page
    assert "<dt>evidence</dt>" in page


def test_the_added_effect_is_drawn_over_the_torque_of_the_first_model(pages, found):
    words = pages["missing"].partition("The torque that the first model lacks")[2]
    lacked, joint = text.torques_first_lacked(found["missing"])[0]
    drawn, torque = lacked.curves_at(joint)[0], lacked.torque.torque[:, joint]
    left = torque - (drawn.torque + drawn.changed)[:, joint]
    part = names.unbroken(numbers.share(1 - np.sum(left**2) / np.sum(torque**2)))
    assert f"Blue: Coulomb friction at the elbow, which explains {part} of its" in words
    assert "shoulder: " not in words.partition("<h2>")[0]  # it does not act there


def test_what_nothing_explains_is_shown_first(pages):
    first = headings(pages["unexplained"])[:3]
    assert first[0].endswith("and something that no effect of the catalogue explains")
    assert first[1:] == ["The torque that is still missing", "What it might be"]


def test_the_picture_says_that_nothing_is_left_where_the_verdict_does(found, monkeypatch):
    for kind, made in found.items():
        words = " ".join(legible(plot.ladder(made), monkeypatch))
        assert ("nothing is left to explain" in words) == (kind != "unexplained")


def test_a_law_without_a_name_has_a_curve_and_a_class(monkeypatch):
    made = by_hand.unexplained(laws=(by_hand.a_law(),))
    what = "torque at the elbow that depends on the rate"
    printed = str(made)
    assert what in " ".join(printed.split())
    assert max(map(len, printed.splitlines())) <= 80
    page = report.render([("only", made.fit)], diagnosis=made)
    assert "A law without a name" in headings(page)
    assert what in page
    assert "class ElbowRateLaw(JointEffect):" in page
    for narrow in (False, True):
        words = legible(plot.law(made.laws[0], narrow=narrow), monkeypatch)
        assert {"rate (rad/s)", "at the elbow (N m)", "95 % band"} <= set(words)


def test_the_error_falls_with_a_law_without_a_name_too(monkeypatch):
    alone = by_hand.unexplained()
    model = a_model(by_hand.a_fit(alone.added, 0.0, 1.0), "elbow_rate_law:elbow", held=(14.0, 1.0))
    law = dataclasses.replace(by_hand.a_law(), beside=alone.added, model=model)
    made = by_hand.unexplained(laws=(law,))
    said = "With the law without a name as well the error at the elbow stays 1.0 times the noise"
    assert f"{said} (held out: from 2.0 to 1.0)." in made.words
    assert made.fit is made.ladder[-1].fit
    row = next(x for x in str(made).splitlines() if "+ a torque at the elbow" in x)
    assert row.split()[-5:] == ["1.0", "x", "1.0", "x", "1.00"], row
    words = " ".join(legible(plot.ladder(made), monkeypatch))
    assert "a torque at the elbow" in " ".join(words.split())
    assert made.to_dict()["laws"][0]["fitted"]["check_rmse"]["elbow"] == pytest.approx(1e-3)
    # Whose numbers are shown is said beside them.
    without = "These numbers are those of the model without the law that has no name."
    assert f"{without} [[Model]]" in " ".join(str(made).split())
    page = report.render([("first", made.base), ("last", made.fit)], diagnosis=made)
    assert page.count(without) == 1
    assert without in page.rpartition("<h3>Numbers</h3>")[2]
    # Beside other names it is no step on from these.
    other = by_hand.unexplained(laws=(dataclasses.replace(law, beside=()),))
    assert other.models == other.ladder
    assert without not in str(other)


def test_where_joints_slide_it_is_of_positions_and_forces(monkeypatch):
    def slides(fit):
        experiment = dataclasses.replace(
            fit.experiment, inertia=InertiaTable(fit.joints, ((1.0, 0.0), (0.0, 1.0)), ("m", "m"))
        )
        return dataclasses.replace(fit, experiment=experiment)

    of_arm = by_hand.unexplained()
    law = dataclasses.replace(by_hand.a_law(), variable="angle", unit="N", variable_unit="m")
    missing = tuple(each._replace(units=("N", "N")) for each in of_arm.missing)
    made = by_hand.a_diagnosis(
        "unexplained",
        [dataclasses.replace(step, fit=slides(step.fit)) for step in of_arm.ladder],
        laws=(law,),
        families=of_arm.families,
        missing=missing,
        still_missing=missing,
        random_torque=tuple(dataclasses.replace(r, unit="N") for r in of_arm.random_torque),
    )
    page = report.render([("only", made.fit)], diagnosis=made)
    words = re.sub(r"<(style|pre).*?</\1>|<[^>]*>", " ", page, flags=re.S) + " ".join(made.words)
    words += " ".join(legible(plot.law(law), monkeypatch))
    words += " ".join(legible(draw_torque(made.fit.experiment, missing[0], 1), monkeypatch))
    for said in ("The force that is still missing", "restoring force", "depends on the position"):
        assert said in words
    assert set(re.findall(r".{20}(?:angle|torque(?! [\d.]+)).{9}", words)) == set()


def test_a_page_of_nothing_missing(pages):
    assert headings(pages["adequate"])[0] == "Nothing is missing"
    assert "What cannot be told apart" not in pages["adequate"]


def test_on_a_phone_tables_stay_within_the_page_and_wide_pictures_scroll(tmp_path, monkeypatch):
    wide = '<svg xmlns="http://www.w3.org/2000/svg" width="800" height="9"/>'
    monkeypatch.setattr("residyn.reporting.figures.inline.svg", lambda figure: wide)
    first, second, *_ = by_hand.missing().candidates
    long = {n: v._replace(std=1e-8) for n, v in first.parameters.items()}
    each = zip((first, second), (long, {}), strict=True)
    few = tuple(dataclasses.replace(c, parameters=values) for c, values in each)
    made = by_hand.missing(candidates=few, laws=(by_hand.a_law(),))
    path = tmp_path / "page.html"
    page = report.render([("last", made.fit)], diagnosis=made)
    path.write_text(re.sub(r"<source .*?>", "", page, flags=re.S), encoding="utf-8")
    browser = driver(400, 900)
    try:
        browser.get(path.as_uri())
        widths = browser.execute_script("return [...document.images].map((x) => x.width)")
        assert set(widths) == {800}
        law = "document.querySelector('pre')"
        assert browser.execute_script(f"return {law}.scrollWidth > {law}.clientWidth")
        root = "document.documentElement"
        assert browser.execute_script(f"return {root}.scrollWidth <= {root}.clientWidth")
        empty = browser.find_elements("css selector", "td:empty")
        assert empty
        assert not any(cell.is_displayed() for cell in empty)
    finally:
        browser.quit()


def test_names_from_files_are_only_words(pages):
    for page in pages.values():
        assert "<script" not in page
        assert "49" not in re.findall(r"alert.{20}", page)


def test_nothing_is_said_of_what_changes_numbers_that_did_not_settle():
    made = by_hand.unexplained()
    *first, last = made.ladder
    rough = dataclasses.replace(last.fit, converged=False, reason="step limit reached")
    rough = dataclasses.replace(made, ladder=(*first, dataclasses.replace(last, fit=rough)))
    said = [" ".join(" ".join(x.words).split()) for x in (made, rough)]
    assert ["it changes the stiffness" in words for words in said] == [True, False]

"""The explorer's page: its numbers against Python's, and a real browser, live and from a file."""

import copy
import dataclasses
import json
import math
import shutil
import subprocess
import sys
import tomllib
import urllib.error
import urllib.request
from importlib.resources import files

import jax
import numpy as np
import pytest
from scipy.special import log_ndtr

import residyn
from residyn import demo
from residyn.diagnosis.evidence import log_prior_model, subset
from residyn.filtering.law import numbers_of
from residyn.filtering.trajectory import number_slices
from residyn.recordings.tables import InertiaTable
from residyn.reporting.explorer import page
from residyn.reporting.explorer.hidden import hide_one
from residyn.reporting.explorer.payload import Drawn, packed, payload
from residyn.reporting.explorer.study import Study
from residyn.reporting.numbers import times
from residyn.runtime.export_cache import keep_in
from tests.chromium import complaints, driver, until

FRICTION = "coulomb_friction:elbow"
SMOOTH = "cubic_stiffness:elbow"
NASTY = "<img src=x onerror=document.title='out'></script>.csv"


@pytest.fixture(scope="module", autouse=True)
def programs(tmp_path_factory):
    """A cache that the server's process shares with this one."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        residyn.set_up()
        yield
    keep_in(None)


@pytest.fixture(scope="module")
def study():
    """Two fitted recordings of three seconds, with markup in a file's name."""
    with demo.experiment_file() as path:
        whole = residyn.load(path)
    cut = [
        dataclasses.replace(r, time=r.time[:300], angle=r.angle[:300], role="fit", name=name)
        for r, name in zip(whole.recordings, (NASTY, "check.csv"), strict=True)
    ]
    return Study(dataclasses.replace(whole, recordings=tuple(cut)))


@pytest.fixture(scope="module")
def data(study):
    return payload(study, name="a'b <i>.toml", toml="# the file\n")


@pytest.fixture(scope="module")
def offline(data, tmp_path_factory):
    """A browser that shows the page from a file."""
    path = tmp_path_factory.mktemp("page") / "page.html"
    path.write_text(alone(data), encoding="utf-8")
    browser = driver()
    try:
        browser.get(path.as_uri())
        until(lambda: browser.find_elements("css selector", ".chip"), 20)
        yield browser
    finally:
        browser.quit()


def alone(data):
    """A whole page around a payload."""
    head = '<meta charset="utf-8"><meta name="viewport" content="width=device-width">'
    body = f'<body class="explorer-live">{page.piece(data)}</body>'
    return f"<!DOCTYPE html><html><head>{head}</head>{body}</html>"


def ask(browser, script, *arguments):
    """Run a script with the page's own modules: `m.name`, imported by the import map."""
    names = ["linear_algebra", "arrays", "evidence", "first_order", "words", "saving"]
    imports = ", ".join(f'import("explorer/{n}.js")' for n in names)
    body = (
        f"const done = arguments[arguments.length - 1], given = [...arguments].slice(0, -1);"
        f"Promise.all([{imports}]).then((all) => {{ const m = Object.assign({{}}, ...all);"
        "const message = document.getElementById('residyn-explorer-data').textContent;"
        f"return m.opened(JSON.parse(message)).then((data) => {{ {script} }}).then(done);"
        "}).catch((e) => done('failed: ' + e));"
    )
    return browser.execute_async_script(body, *arguments)


def strengths_in(gram, which):
    """Strengths of some columns together, in widths of their priors."""
    i = [c + 1 for c in which]
    return np.linalg.solve(gram.solve[np.ix_(i, i)] + np.eye(len(i)), -gram.solve[i, 0])


def times_noise_in(gram, strengths, which):
    """The rms error of each joint over the noise with some columns at some strengths."""
    i, v = [0, *(c + 1 for c in which)], np.concatenate([[1.0], strengths])
    energy = np.einsum("jab,a,b->j", gram.joints[:, i][:, :, i], v, v) + gram.noise
    return np.sqrt(np.maximum(energy, 0.0) / np.maximum(gram.readings, 1.0))


def chip(browser, label):
    return browser.find_element("css selector", f'.chip[data-effect="{label}"]')


def toggle(browser, label):
    """Click a chip, in one go: a live page may draw it anew at any time."""
    script = "document.querySelector(`.chip[data-effect='${arguments[0]}']`).click()"
    browser.execute_script(script, label)


def pressed(browser, label):
    script = "return document.querySelector(`.chip[data-effect='${arguments[0]}']`).ariaPressed"
    return browser.execute_script(script, label) == "true"


def click(browser, element):
    browser.execute_script("arguments[0].click()", element)


def text(browser, selector):
    """What stands in an element; in one go, as the page may draw it anew at any time."""
    script = "return document.querySelector(arguments[0])?.innerText ?? ''"
    return browser.execute_script(script, selector)


# -- the page's own arithmetic ----------------------------------------------------------------


def test_linear_algebra_against_numpy(offline):
    random = np.random.default_rng(3)
    a = random.standard_normal((40, 7)) * [1, 30, 1e-2, 5, 1, 1, 100]
    gram = a.T @ a
    gain, mean, covariance = subset(gram, [4, 0, 2])
    found = ask(
        offline,
        "const r = m.subset((i, j) => given[0][i][j], given[1]);"
        "return [r.gain, [...r.mean], [...r.spread]];",
        gram.tolist(),
        [4, 0, 2],
    )
    assert found[0] == pytest.approx(gain, rel=1e-10)
    assert found[1] == pytest.approx(mean, rel=1e-8)
    assert found[2] == pytest.approx(np.sqrt(np.diag(covariance)), rel=1e-9)
    v = np.array([1.0, 0.3, -2.0])
    chosen = gram[np.ix_([0, 2, 6], [0, 2, 6])]
    form = ask(
        offline,
        "return m.quadratic((i, j) => given[0][i][j], [1, 5], [0.3, -2]);",
        gram.tolist(),
    )
    assert form == pytest.approx(v @ chosen @ v, rel=1e-12)


def test_arrays_arrive_as_they_were_sent(offline):
    random = np.random.default_rng(4)
    waves = np.cumsum(random.standard_normal((3, 500)), axis=1)
    waves[1, 7] = np.nan
    sent = {"a": {"b": [random.standard_normal((2, 5)), Drawn(waves)]}, "c": [1.5, math.inf]}
    found = ask(
        offline,
        "return m.opened(given[0]).then((x) => [[...x.a.b[0].values], x.a.b[0].shape,"
        "[...x.a.b[1].values].map((v) => Number.isNaN(v) ? null : v), x.c]);",
        packed(sent),
    )
    assert found[0] == sent["a"]["b"][0].ravel().tolist()
    assert found[1] == [2, 5]
    drawn = np.array([math.nan if x is None else x for x in found[2]]).reshape(waves.shape)
    half = np.nanmax(np.abs(waves)) / 32767 / 2
    np.testing.assert_allclose(drawn, waves, atol=1.01 * half, rtol=0)
    assert found[3] == [1.5, None]


def test_the_normal_distribution_function_against_scipy(offline):
    x = [-300.0, -40.0, -5.0, -2.1, -2.0, -1.9, -0.3, 0.0, 0.7, 2.0, 2.9, 3.5, 8.0, 30.0]
    found = ask(offline, "return given[0].map(m.logNormal);", x)
    assert found == pytest.approx(log_ndtr(x), rel=1e-9, abs=1e-12)


def test_evidence_is_pythons(offline, study):
    # What sticks is ranked by more than the first order, which is all that the page has.
    ranked = [s for s in study.screen.ranked if not (s.effect.dry or s.effect.follows)]
    labels = [s.effect.label for s in ranked]
    script = "const e = new m.Evidence(data); return given[0].map((x) => e.gainOfOneMore([], x));"
    first = ask(offline, "return new m.Evidence(data).gain([]).gain;")
    assert first == pytest.approx(0.0, abs=1e-9)
    found = ask(offline, script, labels)
    assert found == pytest.approx([s.gain for s in ranked], rel=1e-6, abs=1e-6)
    sets = [[0, 1], [0, 5, 9], [2, 3, 4, 8]]
    script = "const e = new m.Evidence(data); return given[0].map((x) => e.gain(x).gain);"
    found = ask(offline, script, [[labels[i] for i in s] for s in sets])
    wanted = [study.screen.gain([ranked[i] for i in s])[0] for s in sets]
    assert found == pytest.approx(wanted, rel=1e-6, abs=1e-6)
    script = "const e = new m.Evidence(data); return [0, 1, 3].map((n) => e.logPrior(n));"
    priors = ask(offline, script)
    count = len(study.search.candidates)
    assert priors == pytest.approx([log_prior_model(n, count) for n in (0, 1, 3)], rel=1e-12)


def test_where_a_joint_may_stick_a_probability_is_the_searchs_or_is_not_known(offline):
    script = """
        const e = new m.Evidence(data);
        const model = (added, log_evidence) => ({ added, log_evidence });
        const [dry, other, smooth] = given;
        const found = () => [[dry], [other], [dry, smooth]].map((chosen) => {
            const each = e.probabilities(chosen);
            return [dry, other, smooth].map((x) => each.get(x).probability);
        });
        const nothing = { tried: [], screened: [], unnamed: [] };
        const tried = [model([], 0), model([dry], 900), model([other], 880)];
        e.keep({ ...nothing, tried });
        const before = found();
        e.keep({ ...nothing, screened: [{ added: [dry], gains: { [smooth]: -2 } }] });
        const after = found();
        e.keep({ ...nothing, unnamed: [{ beside: [], gain: 960 }] });
        return [before, after, found(), [[], [dry]].map((chosen) => e.ofUnnamed(chosen))];"""
    given = FRICTION, "stribeck_friction:elbow", SMOOTH
    before, after, beside, unnamed = ask(offline, script, *given)
    assert unnamed == pytest.approx([1, 0], abs=1e-9)
    assert beside[1:] == after[1:]
    alone, other, both = before
    assert alone[:2] == pytest.approx([1, 0], abs=1e-3)
    assert other[:2] == pytest.approx([1, 1], abs=1e-3)
    assert alone[2] is other[2] is None
    assert both == [None, None, None]
    alone, other, both = after
    assert 0 < alone[2] < 0.05
    assert 0 < both[2] < 0.05  # beside friction: that it is needed
    assert other[2] is both[0] is None


def test_first_order_errors_are_pythons(offline, study):
    with jax.enable_x64(True):
        first = study.first_order()
    assert first is not None
    rows = {row.effect.label: row.which for row in study.columns.rows}
    sticks = {
        row.effect.label for row in study.columns.rows if row.effect.dry or row.effect.follows
    }
    assert FRICTION in sticks
    for labels in ([], [SMOOTH, "gravity"], *([label] for label in rows)):
        which = [i for label in labels for i in rows[label]]
        found = ask(
            offline,
            "const e = new m.Evidence(data), f = new m.FirstOrder(data, e).model(given[0]);"
            "return [f.fitted, f.held_out];",
            labels,
        )
        if sticks & {*labels}:  # where a joint may stick nothing is linear: no answer
            assert found == [None, None]
            continue
        for errors, gram in zip(found, (first.fitted, first.held_out), strict=True):
            wanted = times_noise_in(gram, strengths_in(gram, which), which)
            assert errors == pytest.approx(wanted, rel=1e-6)


def test_the_first_order_of_nothing_added_is_the_fit(study):
    with jax.enable_x64(True):
        first = study.first_order()
    fit = study.fit(())
    assert first is not None
    errors = times_noise_in(first.fitted, np.zeros(0), [])
    assert errors == pytest.approx(fit.rmse / fit.noise, rel=0.1)


@pytest.mark.parametrize(
    "added", [["cubic_stiffness:elbow"], ["cubic_stiffness:elbow", "cubic_stiffness:shoulder"]]
)
def test_a_refit_by_the_smoother_is_the_fit_where_nothing_sticks(study, added):
    near, fit = study.refit(added), study.predict(added)
    values = {
        f"{e.label}.{n.name}": x
        for e, own in zip(near.path.effects, number_slices(near.path.effects), strict=True)
        for n, x in zip(numbers_of(e), near.path.numbers[own], strict=True)
    }
    off = [(values[n.name] - n.value) / n.std for n in fit.numbers]
    assert np.max(np.abs(off)) < 0.2
    assert near.fitted == pytest.approx(fit.rmse / fit.noise, rel=0.01)
    assert study.predicted(added) == pytest.approx(study.held_out(added, fit), rel=0.1)


def test_a_refit_ends_at_its_next_step_where_nobody_waits_for_it_any_more(study):
    steps = iter([None])
    with pytest.raises(StopIteration):
        study.refit(["gravity"], lambda: next(steps))
    assert frozenset(["gravity"]) not in study.refits
    assert study.refit(["gravity"]) is not None


def test_what_is_held_out_without_bearings_has_their_effects_and_feels_none():
    whole = residyn.load(files("residyn") / "data" / "bearings" / "bearings.toml")
    cut = [dataclasses.replace(r, time=r.time[:150], angle=r.angle[:150]) for r in whole.recordings]
    own = Study(dataclasses.replace(whole, recordings=(cut[0], cut[2])), ["bearing_drag"])
    first, (there, path, _) = own.first_order(), own.beside
    assert first.held_out.solve.shape == first.fitted.solve.shape
    for columns, feels in ((own.columns, True), (own.columns_along(there, path), False)):
        (row,) = (row for row in columns.rows if row.effect.label == "bearing_friction")
        (column,), (torque, reading) = row.which, columns.inputs
        assert torque[..., column].any() == feels
        assert not reading[..., column].any()


def test_what_is_hidden_shows_and_is_not_told(study):
    with jax.enable_x64(True):
        made, effect = hide_one(study, np.random.default_rng(1))
    assert effect.label in {e.label for e in study.search.candidates}
    for hidden, real in zip(made.recordings, study.experiment.recordings, strict=True):
        assert effect.name not in hidden.name
        assert hidden.angle.shape == real.angle.shape
        assert np.isfinite(hidden.angle).all()


@pytest.fixture(scope="module")
def rates(study):
    """The same of gyroscopes, under a load."""

    def read(r):
        angle = np.gradient(r.angle, r.time, axis=0)
        return dataclasses.replace(r, angle=angle, reads=("rate", "rate"), load=2.0)

    fit, found = study.fit(()), copy.copy(study)
    runs = [dataclasses.replace(b, recording=read(b.recording)) for b in fit.recordings]
    found.fits = {frozenset(): dataclasses.replace(fit, recordings=tuple(runs))}
    recordings = tuple(b.recording for b in runs)
    found.experiment = dataclasses.replace(study.experiment, recordings=recordings)
    return found


def test_of_gyroscopes_rates_are_made_under_the_same_load(rates):
    with jax.enable_x64(True):
        made, _ = hide_one(rates, np.random.default_rng(1))
    for hidden, real in zip(made.recordings, rates.experiment.recordings, strict=True):
        assert (hidden.reads, hidden.load) == (real.reads, real.load)
        assert (hidden.noise == real.noise).all()
        assert (np.abs(np.log(np.std(hidden.angle, axis=0) / np.std(real.angle, axis=0))) < 1).all()


def test_axes_have_the_units_of_readings(data, rates, offline):
    assert (data["reads"], data["reading_units"]) == (["angle"] * 2, ["rad"] * 2)
    table = InertiaTable(("a", "b"), ((1.0, 0.0), (0.0, 1.0)))
    unknown = copy.copy(rates)
    unknown.experiment = dataclasses.replace(rates.experiment, inertia=table, bearings=())
    for study, units, readings in ((rates, "rad", "rad/s"), (unknown, "", "")):
        told = payload(study, live=True)
        assert (told["units"], told["reads"]) == ([units] * 2, ["rate"] * 2)
        assert told["reading_units"] == [readings] * 2
    script = "return [m.inUnit('rate', 'rad', '/s'), m.inUnit('rate', '', '/s')];"
    assert ask(offline, script) == ["rate, rad/s", "rate"]


def test_a_live_search_says_what_a_diagnosis_does_and_the_page_what_to_check(study, offline):
    swapped = [dataclasses.replace(r, angle=r.angle[:, ::-1]) for r in study.experiment.recordings]
    made = dataclasses.replace(study.experiment, recordings=tuple(swapped))
    live = Study(made)
    found = live.diagnose()
    assert found.channels == residyn.diagnose(made).channels is not None
    told = payload(live)["verdict"]
    assert "exchanged" in told["check"]
    script = """
        const model = { how: "", fitted: [9, 9] };
        const more = { base: model, chosen: [], candidates: new Map(), joints: ["a", "b"] };
        const likeliest = { label: "none of the candidates" };
        return m.verdict({ model, ...more, likeliest, found: given[0] }).words;
    """
    words = ask(offline, script, told)
    assert words[0] == told["check"]
    assert len(words) == 2  # and nothing of what may be missing


@pytest.mark.parametrize("chosen", [[], ["cubic_stiffness:elbow"]], ids=["base", "with an effect"])
@pytest.mark.parametrize("verdict", ["missing", "unexplained"])
def test_what_leaves_as_little_as_noise_is_no_better_than_the_verdict(offline, verdict, chosen):
    script = """
        const model = { how: "", fitted: [0.6] };
        const candidates = new Map(data.candidates.map((c) => [c.label, c]));
        const [verdict, chosen] = given;
        const found = { verdict, probability: 0.94, lookalikes: [], check: "", next: "" };
        const more = { base: model, chosen, candidates, joints: ["elbow"] };
        const told = m.verdict({ model, ...more, found });
        return [told.good, told.words.join(" ")];
    """
    good, words = ask(offline, script, verdict, chosen)
    assert good == (verdict == "missing")
    assert ("but noise" in words) == good
    yet = "Yet no effect that was tried explains all of these readings (94\u00a0%)."
    assert words.endswith(yet) != good


@pytest.mark.parametrize(
    ("then", "said"),
    [
        ((9.1, 8.0), ("stays at 9.1", "at 8.0")),
        ((9.1, 1.0), ("stays at 9.1", "it falls from 8.0 to 1.0")),
        ((1.5, 9.0), ("falls from 9.1 to 1.5", "it rises from 8.0 to 9.0")),
        ((1.5, 1.6), ("falls from 9.1 to 1.5", "from 8.0 to 1.6")),
    ],
)
def test_a_fall_is_told_of_fitted_and_of_held_out_readings(offline, then, said):
    script = """
        const told = ([fitted, held_out]) => ({ how: "", fitted: [fitted], held_out: [held_out] });
        const chosen = ["cubic_stiffness:elbow"], joints = ["elbow"];
        const candidates = new Map(data.candidates.map((c) => [c.label, c]));
        const [base, model] = [told([9.1, 8.0]), told(given[0])];
        const heldOut = "check recordings";
        return m.verdict({ model, base, chosen, candidates, joints, heldOut }).words[0];
    """
    words = " times the noise, and on the held-out recordings ".join(said)
    expected = f"With cubic stiffness the error at the elbow {words}."
    assert ask(offline, script, then) == expected


def test_words(offline):
    script = "return [m.command(given[0], ['x:y z']), ...given[1].map(m.times)];"
    errors = [10.4, 9.97, 3.14, 0.98, 0.1, 0.0314]
    found = ask(offline, script, "a'b <i>.toml", errors)
    assert found == ["residyn fit 'a'\\''b <i>.toml' --with 'x:y z'", *map(times, errors)]


def test_what_is_saved_is_an_experiment_file_whatever_names_say(offline):
    number = {"name": "a\nb = 2", "value": 1.5, "std": 0.25, "unit": "1"}
    saved = ask(offline, "return m.toml(given[0], given[1], given[2]);", "a = 1\n", "fit", [number])
    assert tomllib.loads(saved) == {"a": 1}
    assert "1.50 ± 0.25" in saved


# -- the page from a file ---------------------------------------------------------------------


def test_a_click_answers_in_every_part_of_the_page(offline):
    before = text(offline, ".bars"), text(offline, ".verdict")
    toggle(offline, SMOOTH)
    assert pressed(offline, SMOOTH)
    assert text(offline, ".status").startswith("first order")
    assert text(offline, ".bars") != before[0]
    assert "With cubic stiffness at the elbow the error" in text(offline, ".verdict")
    assert len(offline.find_elements("css selector", ".step")) == 2
    assert "Cubic stiffness" in text(offline, ".numbers")
    click(offline, offline.find_elements("css selector", ".step")[0])  # back down the staircase
    assert not pressed(offline, SMOOTH)
    assert (text(offline, ".bars"), text(offline, ".verdict")) == before
    assert complaints(offline) == []


def test_bars_of_joints_and_of_models_share_one_scale(offline):
    bars = """return [...document.querySelectorAll(arguments[0])].map((x) =>
        [x.querySelector(".value").textContent, x.querySelector(".fill").style.width,
         x.querySelector(".track").style.getPropertyValue("--one"), x.innerText])"""
    toggle(offline, SMOOTH)
    joints = offline.execute_script(bars, ".bars .bar")[::2]  # those that were fitted
    models = offline.execute_script(bars, ".step")
    assert len(models) == 2
    error, wide, one, _ = max(joints, key=lambda x: float(x[0].split()[0]))
    assert models[1][:3] == [error, wide, one]
    assert any(joint in models[1][3] for joint in ("shoulder", "elbow"))
    ticks = """return [...document.querySelectorAll(".axis .track small")].map((x) =>
        [+x.textContent, x.style.left])"""
    places = dict(map(tuple, offline.execute_script(ticks)))
    at = {x: float(place.rstrip("%")) for x, place in places.items()}
    size, noise = (float(place.rstrip("%")) for place in (wide, one))
    assert at[1] == pytest.approx(noise, abs=1e-3)
    below, above = (math.log(float(error.split()[0]) / x) for x in (1, 2))
    assert (size - at[1]) / (size - at[2]) == pytest.approx(below / above, rel=0.05)
    toggle(offline, SMOOTH)


def test_chips_stand_in_the_order_of_the_numbers_they_show(offline):
    percents = """return [...document.querySelectorAll(".chip[aria-pressed=false] .p")]
        .map((x) => x.textContent.startsWith("<") ? 0 : parseInt(x.textContent.replace(">", "")))"""
    first = "return document.querySelector('.chip').dataset.effect"
    for label in (SMOOTH, "gravity"):
        toggle(offline, label)
        numbers = offline.execute_script(percents)
        assert numbers == sorted(numbers, reverse=True)
        assert chip(offline, SMOOTH).get_property("textContent").endswith("needed")
        assert offline.execute_script(first) == SMOOTH  # what is added, as it came
    for label in ("gravity", SMOOTH):
        toggle(offline, label)


def test_where_a_joint_may_stick_no_first_order_is_shown(offline):
    toggle(offline, FRICTION)
    assert text(offline, ".status").startswith("no first-order answer")
    assert text(offline, ".bars").count("not known") == 4
    assert "is not known before a fit" in text(offline, ".verdict")
    assert chip(offline, SMOOTH).get_property("textContent").endswith("not known")
    assert offline.execute_script(
        "return [...document.querySelectorAll('.bars .fill')].every((bar) => bar.hidden)"
    )
    toggle(offline, FRICTION)
    assert "not known" not in text(offline, ".bars")


def test_the_keyboard_alone_reaches_and_does_everything(offline):
    from selenium.webdriver.common.keys import Keys

    active = "const e = document.activeElement; "
    offline.execute_script("document.activeElement.blur(); scrollTo(0, 0)")
    press = offline.switch_to.active_element.send_keys
    reached = set()
    for _ in range(60):
        press(Keys.TAB)
        press = offline.switch_to.active_element.send_keys
        kind = offline.execute_script(active + "return e.className || e.type || e.tagName")
        assert offline.execute_script(
            active + "return e.tagName === 'BODY' || getComputedStyle(e).outlineStyle !== 'none'"
        ), f"one does not see that {kind} has the focus"
        if kind in reached and kind == "BODY":
            break
        reached.add(kind)
    assert {"chip", "SUMMARY", "action", "step", "tab", "range"} <= reached

    def at(selector, key, which=0):
        found = offline.find_elements("css selector", selector)[which]
        offline.execute_script("arguments[0].focus()", found)
        offline.switch_to.active_element.send_keys(key)

    at("summary", Keys.ENTER)
    hidden = offline.find_elements("css selector", "details .chip")[0].get_attribute("data-effect")
    at("details .chip", Keys.SPACE)
    assert pressed(offline, hidden)
    focus = offline.execute_script(active + "return e.dataset.effect")
    assert focus == hidden  # it went up among the chips that are shown first, and the focus with it
    at(".step", Keys.ENTER)
    assert not pressed(offline, hidden)
    at(".panel .tab", Keys.SPACE, 1)
    tabs = "return [...document.querySelectorAll('.tab')].map((t) => t.ariaPressed)"
    assert offline.execute_script(tabs)[:2] == ["false", "true"]
    at(".panel .tab", Keys.SPACE, 0)
    at(".actions .action", Keys.ENTER)
    until(lambda: "residyn fit" in text(offline, ".said"), 10)
    assert complaints(offline) == []


def test_markup_in_names_stays_text(offline):
    assert "a'b <i>.toml" in text(offline, "h2.kind")  # in a report: a section of it
    assert offline.title == ""  # where a script in a name would have written
    assert offline.find_elements("css selector", ".explorer img, .explorer i") == []
    assert NASTY in text(offline, ".tabs")


def test_the_page_asks_for_nothing(offline):
    asked = offline.execute_script(
        "return performance.getEntriesByType('resource').map((e) => e.name)"
        ".filter((n) => !n.startsWith('data:') && !n.startsWith('blob:'))"
    )
    assert asked == []


def test_a_stretch_of_time_by_a_drag_across_a_chart(offline):
    from selenium.webdriver import ActionChains

    chart = offline.find_element("css selector", ".curves .u-over")
    offline.execute_script("arguments[0].scrollIntoView({ block: 'center' })", chart)
    wide = chart.size["width"]
    drag = ActionChains(offline).move_to_element_with_offset(chart, -wide // 4, 0)
    drag.click_and_hold().move_by_offset(wide // 2, 0).release().perform()
    whole = offline.find_element("css selector", ".stretch button")
    assert whole.is_enabled()
    times = [float(x.text.split()[0]) for x in offline.find_elements("css selector", "output")]
    last = 4 * (times[1] - times[0]) / 2  # half of the recording, from a quarter on
    assert times == pytest.approx([last / 4, 3 * last / 4], abs=last / 40)
    click(offline, whole)
    assert not whole.is_enabled()


def test_a_stretch_of_time_by_keyboard(offline):
    from selenium.webdriver.common.keys import Keys

    slider = offline.find_element("css selector", ".stretch input")
    whole = offline.find_element("css selector", ".stretch button")
    assert not whole.is_enabled()
    slider.send_keys(*[Keys.PAGE_UP] * 3)
    assert whole.is_enabled()
    assert slider.get_attribute("aria-valuetext") == "0.90 s"
    whole.send_keys(Keys.ENTER)
    assert not whole.is_enabled()


# Contrast of words against what is behind them (WCAG 2.1).
CONTRAST = """
const light = (c) => {
  const [r, g, b] = c.match(/[\\d.]+/g).slice(0, 3)
    .map((x) => x / 255).map((x) => (x <= 0.03928 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4));
  return 0.2126 * r + 0.7152 * g + 0.0722 * b;
};
const behind = (e) => {
  for (; e; e = e.parentElement) {
    const c = getComputedStyle(e).backgroundColor;
    if (!/, 0\\)$/.test(c)) return light(c);
  }
  return 1;
};
const selectors = [".kind", ".verdict", ".status", ".note", ".chip .title", ".chip small",
  ".chip .p", ".bar small", ".bar .value", ".step .what", ".tab",
  ".action:enabled", ".numbers th", "h3"];
return selectors.map((s) => {
  const e = document.querySelector(s);
  const [a, b] = [light(getComputedStyle(e).color), behind(e)].sort((x, y) => y - x);
  return [s, (a + 0.05) / (b + 0.05)];
});
"""


@pytest.mark.parametrize("dark", [False, True])
def test_all_fits_at_400_pixels_and_can_be_read(data, tmp_path, dark):
    path = tmp_path / "page.html"
    joints = ["<b>shoulder</b>", "elbow</script>"]
    slide = {"units": ["m", "m"], "missing": [{**m, "units": ["N", "N"]} for m in data["missing"]]}
    path.write_text(alone({**data, "joints": joints, **slide}), encoding="utf-8")
    browser = driver(400, 900, dark=dark)
    try:
        browser.get(path.as_uri())
        until(lambda: browser.find_elements("css selector", ".chip"), 20)
        width = "return document.documentElement.scrollWidth"
        until(lambda: browser.execute_script(width) <= 400, 20)
        background = "return getComputedStyle(document.body).backgroundColor"
        assert (browser.execute_script(background) == "rgb(255, 255, 255)") is not dark
        faint = [found for found in browser.execute_script(CONTRAST) if found[1] < 4.5]
        assert faint == []
        panel = browser.find_elements("css selector", ".panel")[-2].text
        assert "The force that springs and dampers lack" in panel
        assert "an S against the position" in panel
        assert "\nagainst position" in panel
        # Names of joints are text.
        assert joints[0] in text(browser, ".bars")
        assert browser.find_elements("css selector", ".explorer b b, .explorer h3 b") == []
        assert complaints(browser) == []
    finally:
        browser.quit()


def test_in_a_report_the_page_stands_for_the_tables_but_in_print_and_without_scripts(
    data, tmp_path
):
    whole = alone(data).replace("</body>", '<div class="in-full">tables</div></body>')
    start = '<script type="module">import "explorer/explorer.js";</script>'
    assert start in whole
    path, bare = tmp_path / "page.html", tmp_path / "bare.html"
    path.write_text(whole, encoding="utf-8")
    bare.write_text(whole.replace(start, ""), encoding="utf-8")
    browser = driver()

    def seen(selector):
        return browser.find_element("css selector", selector).is_displayed()

    try:
        browser.get(path.as_uri())
        until(lambda: browser.find_elements("css selector", ".chip"), 20)
        assert not seen(".in-full")
        button = browser.find_elements("css selector", ".explorer > .actions button")[-1]
        click(browser, button)
        assert seen(".in-full")
        click(browser, button)
        assert not seen(".in-full")
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
        assert seen(".in-full")
        assert not seen(".chip")
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})
        browser.get(bare.as_uri())
        assert seen(".in-full")
        assert not seen(".explorer")
    finally:
        browser.quit()


def test_a_payload_is_small_and_plain(data):
    assert len(json.dumps(packed(data), allow_nan=False)) < 1_000_000


# -- live -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    """The server of two short recordings, one held out."""
    folder = tmp_path_factory.mktemp("live")
    with demo.experiment_file() as path:
        shutil.copy(path, folder / "experiment.toml")
        for name in ("release.csv", "check.csv"):
            lines = (path.parent / name).read_text().splitlines()[:301]
            (folder / name).write_text("\n".join(lines) + "\n")
    command = [sys.executable, "-m", "residyn", "explore", str(folder / "experiment.toml")]
    with subprocess.Popen(
        [*command, "--no-browser"], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as running:
        assert running.stdout is not None
        yield running.stdout.readline().strip(), folder
        running.kill()


@pytest.fixture(scope="module")
def live(address):
    browser = driver()
    try:
        browser.get(address[0])
        until(lambda: browser.find_elements("css selector", ".chip"), 240)
        yield browser
    finally:
        browser.quit()


def refitted(browser):
    status = text(browser, ".status")
    return status.startswith("refitted") and "..." not in status


def test_live_the_exact_fit_replaces_the_first_order_and_says_so(live):
    from selenium.webdriver.common.keys import Keys

    chip(live, FRICTION).send_keys(Keys.SPACE)  # by keyboard alone
    until(lambda: refitted(live))
    assert "Coulomb friction at the elbow" in text(live, ".verdict")
    row = next(r for r in text(live, ".numbers").splitlines() if r.startswith("Coulomb"))
    assert abs(float(row.split(": torque")[1].split()[0]) - 0.2) < 0.01
    assert live.switch_to.active_element.get_attribute("data-effect") == FRICTION  # focus stays
    assert complaints(live) == []


def test_live_a_number_that_is_moved_is_held_and_let_go(live):
    from selenium.webdriver.common.keys import Keys

    until(lambda: refitted(live))
    slider = live.find_elements("css selector", ".slide input")[-1]
    before = text(live, ".bars")
    slider.send_keys(Keys.PAGE_UP)
    until(lambda: refitted(live) and "held" in text(live, ".numbers"))
    until(lambda: text(live, ".numbers").count("held") == 1 and text(live, ".bars") != before)
    holds = live.find_elements("css selector", ".hold input")
    assert [h.is_selected() for h in holds] == [False] * (len(holds) - 1) + [True]
    holds[-1].send_keys(Keys.SPACE)
    until(lambda: refitted(live) and "held" not in text(live, ".numbers"))
    assert text(live, ".bars") == before
    narrow = {"width": 400, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    live.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", narrow)
    # The charts follow in the browser's next frame.
    until(lambda: live.execute_script("return document.documentElement.scrollWidth") <= 400, 20)
    live.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", {**narrow, "width": 1280})
    assert complaints(live) == []


def test_a_page_from_elsewhere_is_refused_even_if_it_knows_the_token(offline, address):
    script = """
        const [address, done] = arguments;
        const ask = (what, how) => fetch(address + what, how).then((a) => a.type, () => "refused");
        const form = { method: "POST", mode: "no-cors", body: "{}" };
        Promise.all([ask("api/0/state", {}), ask("api/0/hide", form)]).then(done);
    """
    assert offline.execute_async_script(script, address[0]) == ["refused", "refused"]
    with urllib.request.urlopen(f"{address[0]}api/0/state") as answer:
        assert json.load(answer)["error"] == ""
    with pytest.raises(urllib.error.HTTPError):  # the form has begun nothing
        urllib.request.urlopen(f"{address[0]}api/1/state")
    complaints(offline)  # the browser's own, of what was refused


def test_live_two_windows_at_once_do_not_disturb_each_other(live, address):
    other = driver()
    try:
        other.get(address[0])
        until(lambda: other.find_elements("css selector", ".chip"))
        assert not pressed(other, FRICTION)
        if not pressed(live, FRICTION):
            toggle(live, FRICTION)
        toggle(live, FRICTION)  # off, in the one
        toggle(other, SMOOTH)  # on, in the other
        toggle(live, FRICTION)
        until(lambda: refitted(live) and refitted(other))
        assert "Coulomb friction at the elbow" in text(live, ".verdict")
        assert "cubic stiffness at the elbow" in text(other, ".verdict")
        assert not pressed(live, SMOOTH)
        assert complaints(other) == []
    finally:
        other.quit()


def test_live_without_an_answer_the_headline_says_so(live):
    until(lambda: refitted(live))
    cut = {"latency": 0, "downloadThroughput": -1, "uploadThroughput": -1}
    live.execute_cdp_cmd("Network.enable", {})
    live.execute_cdp_cmd("Network.emulateNetworkConditions", {**cut, "offline": True})
    toggle(live, SMOOTH)
    until(lambda: "The server does not answer" in text(live, ".verdict"), 20)
    live.execute_cdp_cmd("Network.emulateNetworkConditions", {**cut, "offline": False})
    toggle(live, SMOOTH)
    until(lambda: refitted(live) and "does not answer" not in text(live, ".verdict"))
    complaints(live)  # the browser's own, of what was not answered


def test_live_recordings_that_are_new_or_changed_are_offered_and_read_by_a_click(live, address):
    _, folder = address
    lines = (folder / "check.csv").read_text().splitlines()
    (folder / "check.csv").write_text("\n".join(lines[:-20]) + "\n")
    shutil.copy(folder / "release.csv", folder / "more.csv")
    until(lambda: "more.csv" in text(live, ".banner"))
    assert "check.csv changed on disk" in text(live, ".banner")
    buttons = "const all = [...document.querySelectorAll('.banner button')]; "
    said = live.execute_script(buttons + "return all.map((b) => b.textContent)")
    assert said == ["Read again", "Add this recording"]
    live.execute_script(buttons + "all[1].click()")
    until(lambda: "more.csv" in text(live, ".tabs"), 240)
    assert "changed on disk" not in text(live, ".banner")
    assert complaints(live) == []

"""The page and its pictures: complete, self-contained, safe, and nothing cut off."""

import dataclasses
import re
from html.parser import HTMLParser
from urllib.parse import unquote
from xml.etree import ElementTree

import numpy as np
import pytest

import residyn
from residyn import reporting as report
from residyn.diagnosis.forecast import Error, HeldOut
from residyn.effects import catalogue
from residyn.recordings.tables import Bearing
from residyn.reporting import figures as plot
from residyn.reporting import fit as about_fits
from residyn.reporting import names, numbers
from residyn.reporting import page as pages
from residyn.reporting.figures.motion import thinned
from residyn.reporting.layout import filled
from tests.by_hand import LOST, NASTY, WILD, a_comparison, a_fit
from tests.legible import legible


@pytest.fixture(scope="module")
def fit():
    return a_fit()


@pytest.fixture(scope="module")
def page(fit, tmp_path_factory):
    path = tmp_path_factory.mktemp("report") / "two.html"
    report.write_report(path, [("Springs & dampers", fit), (f"again {NASTY}", fit)])
    return path.read_text(encoding="utf-8")


class Tags(HTMLParser):
    """Every tag with its attributes, and the text outside of style."""

    def __init__(self, page):
        super().__init__()
        self.tags, self.words, self.inside = [], [], []
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        self.inside.append(tag)

    def handle_endtag(self, tag):
        while self.inside and self.inside.pop() != tag:
            pass

    def handle_data(self, data):
        if "style" not in self.inside:
            self.words.append(data)


def test_page_loads_nothing(page):
    tags = Tags(page).tags
    assert not {tag for tag, _ in tags} & {"script", "link", "iframe", "object", "embed", "base"}
    for _, attributes in tags:
        for key in ("src", "href", "srcset", "data", "action"):
            assert attributes.get(key, "#").startswith(("data:image/svg+xml,", "#"))
        assert not [key for key in attributes if key.startswith("on")]
    # The names of the standards are addresses that nothing fetches; beyond them there is none.
    beside = re.sub(r"data:image[^\"]*", "", page)
    assert "http" not in beside
    assert "@import" not in page
    assert "url(" not in beside
    assert not re.search(r"url\((?!%23)", page)  # in a picture, to its own parts


def pictures(page):
    for code in re.findall(r'data:image/svg\+xml,([^"\s]+)', page):
        yield unquote(code)


def test_pictures_load_nothing_either(page):
    found = list(pictures(page))
    assert len(found) == 2 * (1 + 2 * (2 + 1))  # wide and narrow: errors, two motions, a spectrum
    for svg in found:
        for element in ElementTree.fromstring(svg).iter():
            assert element.tag.rpartition("}")[2] not in ("script", "foreignObject", "image")
            for key, value in element.attrib.items():
                if key.rpartition("}")[2] == "href":
                    assert value.startswith("#")


def test_names_from_files_are_only_words(page):
    parsed = Tags(page)
    assert "script" not in {tag for tag, _ in parsed.tags}
    assert "b" not in {tag for tag, _ in parsed.tags}
    assert NASTY in " ".join("".join(parsed.words).split())


def test_page_says_everything(page, fit):
    words = " ".join("".join(Tags(page).words).split())
    for number in fit.numbers:
        assert number.name in words
        assert number.words in words
    for line in (*fit.warnings, fit.reason, *about_fits.verdict(fit), residyn.__version__):
        assert line in words
    assert "-0.970" in words
    for line in ("5 of 6", "N m/rad", "frequency (Hz)", "held-out", "Springs & dampers"):
        assert line in words


def test_page_of_a_comparison_has_one_verdict(fit, monkeypatch):
    monkeypatch.setattr("residyn.reporting.figures.inline.svg", lambda figure: "<svg/>")
    compared = a_comparison(fit, 6.0, 1e-13)
    page = report.render([("one", fit)], compared)
    assert page.count('class="verdict') == 1
    assert "whiteness test" in page.partition('class="verdict')[2].partition("</p>")[0]


def test_page_of_one_fit_has_no_comparison(fit, monkeypatch):
    monkeypatch.setattr("residyn.reporting.figures.inline.svg", lambda figure: "<svg/>")
    one = report.render([("Only", fit)])
    assert "models of the same recordings" not in one
    assert "<h1>Only</h1>" in one


def test_a_picture_is_the_same_each_time(fit):
    assert plot.svg(plot.spectrum(fit)) == plot.svg(plot.spectrum(fit))


def test_an_unwritable_path_is_said(fit, tmp_path, monkeypatch):
    monkeypatch.setattr(pages, "render", lambda *_: "")
    with pytest.raises(residyn.InputError, match="cannot be written"):
        report.write_report(tmp_path / "no" / "such.html", [("a", fit)])


# -- pictures --------------------------------------------------------------------------------


@pytest.mark.parametrize("narrow", [False, True], ids=["wide", "narrow"])
@pytest.mark.parametrize("kind", ["overlay", "spectrum", "errors"])
def test_no_word_of_a_picture_is_cut_or_covered(fit, kind, narrow, monkeypatch):
    names = ["springs and dampers", "with coulomb_friction:elbow"]
    figure = {
        "overlay": lambda: plot.overlay(fit, narrow=narrow),
        "spectrum": lambda: plot.spectrum(fit, narrow=narrow),
        "errors": lambda: plot.errors([fit, fit], names, narrow=narrow),
    }[kind]()
    assert len(legible(figure, monkeypatch)) >= 15


def test_every_axis_has_a_unit(fit):
    for figure in (plot.overlay(fit), plot.spectrum(fit), plot.errors([fit], ["a"])):
        for axes in figure.axes:
            labels = [axes.get_xlabel(), axes.get_ylabel()]
            assert all(re.search(r"\((s|Hz|m?rad|µrad)\)$", label) for label in labels if label)


def test_lost_readings_are_gaps_and_wild_ones_are_marked(fit):
    figure = plot.overlay(fit, fit.recordings[:1])
    main = figure.axes[0]
    measured, model, *_ = main.get_lines()
    lost = np.asarray(measured.get_xdata())[np.isnan(np.asarray(measured.get_ydata(), float))]
    assert abs(lost.min() - LOST.start / 80) < 0.05
    assert abs(LOST.stop / 80 - lost.max()) < 0.05
    assert np.isfinite(np.asarray(model.get_ydata(), float)).all()
    elbow = figure.axes[4]
    marked = [line for line in elbow.get_lines() if line.get_marker() == "x"]
    assert list(np.asarray(marked[0].get_xdata())) == [WILD / 80]


def test_long_recordings_are_thinned_and_look_the_same():
    time = np.arange(100_000) / 1000
    values = np.sin(7 * time)
    values[[123, 54_321]] = 5, -5
    values[70_000:70_500] = np.nan
    few, thin = thinned(time, values, 4.0)
    assert len(few) == len(thin) < 2000
    assert (np.diff(few) >= 0).all()
    assert (np.nanmax(thin), np.nanmin(thin)) == (5, -5)
    assert np.isnan(thin[(few > 69.6) & (few < 70.9)]).any()


def test_the_users_own_style_is_left_alone(fit):
    import matplotlib as mpl

    before = dict(mpl.rcParams)
    plot.errors([fit], ["a"])
    assert dict(mpl.rcParams) == before


# -- words and numbers -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "unit", "words"),
    [
        (0.00123, "rad", "1.23 mrad"),
        (0.5, "rad", "0.500 rad"),
        (5.3e-6, "m", "5.30 µm"),
        (2.0, None, "2.00"),
        (2e-4, None, "0.200 ×10⁻³"),
        (0.0, "m", "0 m"),
        (float("nan"), "m", "? m"),
    ],
)
def test_amounts(value, unit, words):
    assert numbers.amount(value, unit) == words


@pytest.mark.parametrize(
    ("value", "std", "words"),
    [
        (16.6702, 0.00247, ("16.6702", "0.0025")),
        (712.6, 3.2, ("712.6", "3.2")),
        (7126.0, 320.0, ("7126", "320")),
        (-0.1, 0.02, ("-0.100", "0.020")),
        (-0.4, 20.0, ("0", "20")),
        (2e-5, 3e-7, ("2.000e-05", "3.0e-07")),
        (-2e95, 5.0, ("-2.000000000000000e+95", "5.0e+00")),
    ],
)
def test_values_with_errors(value, std, words):
    assert numbers.with_error(value, std) == words


def test_an_unknown_error_is_no_number():
    assert numbers.with_error(1.25, float("inf"))[0] == "1.25000"


def test_verdict_names_the_misfit(fit):
    assert not about_fits.explained(fit)
    words = " ".join(about_fits.verdict(fit))
    assert "misses something" in words
    assert "shoulder" in words
    assert "elbow" in words


def test_a_recording_that_the_model_does_not_explain_is_seen(fit):
    good, odd = (dataclasses.replace(r) for r in fit.whole)
    good.predicted[:] = good.recording.angle
    odd.predicted[:, 1] = odd.recording.angle[:, 1] + 6 * odd.recording.noise[1]
    seen = dataclasses.replace(fit, recordings=(good, odd))
    rows = about_fits.recordings_table(seen).rows
    assert [row[0] for row in rows] == [NASTY, "check.csv (held out)"]
    assert rows[0][2:] == ["0 x", "0 x"]
    assert rows[1][3] == "6.0 x"
    told = seen.to_dict()["recordings"]
    assert [(r["name"], r["role"]) for r in told] == [(NASTY, "fit"), ("check.csv", "check")]
    assert told[1]["ratio"]["elbow"] == pytest.approx(6.0)
    assert told[1]["rmse"]["elbow"] == pytest.approx(6.0 * odd.recording.noise[1])
    assert told[1]["readings"] == int(odd.used.sum())


def test_errors_are_in_times_the_noise_of_each_recording(fit):
    """An exact encoder and a short run of a poor camera: each is off by its own noise."""
    each = []
    for count, noise, times_noise, role in (
        (3000, 1e-5, 1.0, "fit"),
        (100, 0.1, 1.0, "fit"),
        (600, 1e-5, 2.0, "check"),
        (20, 0.1, 2.0, "check"),
    ):
        time = np.arange(count) / 100
        angle = np.tile(np.cos(time)[:, None], 2)
        run = residyn.Recording.from_arrays(time, angle, noise=noise, role=role)
        off = times_noise * noise * np.where(np.arange(count) % 2, 1, -1)[:, None]
        each.append(residyn.fitting.RecordingFit(run, angle + off, angle > 2, np.zeros(4)))
    mixed = dataclasses.replace(fit, recordings=tuple(each), reduced_chi2=1.0)
    for error in about_fits.joint_errors(mixed):
        assert error.ratio == pytest.approx(1.0)
        assert error.check_ratio == pytest.approx(2.0)
        assert error.noise == pytest.approx(((3000 * 1e-10 + 100 * 1e-2) / 3100) ** 0.5)
    assert mixed.to_dict()["ratio"] == pytest.approx({"shoulder": 1.0, "elbow": 1.0})
    assert " 1.0 times the noise at the shoulder" in about_fits.verdict(mixed)[0]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({}, ""),
        ({"theta2": 1.0}, "theta2 = 0.3 rad"),
        ({"theta2": 1.0, "load": 2.0}, "theta2 = 0.3 rad, load = 0 N"),
        ({"air_bearings": False}, "on the bearings"),
    ],
)
def test_modes_say_which_recording_they_are_of(change, words, monkeypatch):
    monkeypatch.setattr("residyn.reporting.figures.inline.svg", lambda figure: "<svg/>")
    fit = a_fit()
    one, two = fit.recordings
    one = dataclasses.replace(one, recording=dataclasses.replace(one.recording, name="one.csv"))
    two = dataclasses.replace(two, recording=dataclasses.replace(two.recording, **change))
    bearings = (Bearing("elbow", 0.1, 0.001),)
    fit = dataclasses.replace(
        fit,
        recordings=(one, two),
        experiment=dataclasses.replace(fit.experiment, bearings=bearings),
    )
    expected = f", as in one.csv ({words})" if words else ""
    head = "[[Modes]]  natural frequency, damping ratio" + expected
    assert re.search(r"Hz   [\d.]+ \+/- [\d.]+ %", str(fit))
    assert f"{head} 1 0.36" in " ".join(str(fit).split()).replace("]] ", "]]  ")
    assert f"rings in small motion{expected}." in report.render([("one", fit)])
    told = fit.to_dict()["modes_of"]
    assert (told["recording"], told["theta2"], told["air_bearings"]) == ("one.csv", 0.3, True)


@pytest.mark.parametrize(
    ("chi2", "words"),
    [
        (0.3, "overstated"),
        (1.0, "noise alone"),
        (1.5, "a little"),
        (9.0, "missing"),
    ],
)
def test_chi_square_in_words(chi2, words):
    assert words in about_fits.chi2_words(chi2)


def test_a_prediction_is_worse_only_where_it_is():
    fit = a_fit()
    found = a_comparison(fit, 6.0, 1e-13)

    def last(held, fitted):
        error = [Error(1e-3 * np.array(x), np.array(x), np.ones(2)) for x in (held, fitted)]
        return dataclasses.replace(found, held_out=HeldOut("last third", *error)).words[-1]

    one = "is off by 26 and 34 times the noise: at the shoulder worse than where it was fitted (16"
    assert f"{one} times)." in last((26.0, 34.0), (16.0, 39.0))
    assert last((26.0, 64.0), (16.0, 39.0)).endswith(
        "worse than where it was fitted (16 and 39 times)."
    )
    assert "worse" not in last((16.0, 34.0), (16.0, 39.0))


def test_noise_that_is_too_large_is_said_to_be_what_it_is():
    assert all(r.recording.noise_given for r in a_fit().fitted)
    fit = a_fit(chi2=0.3)
    (line,) = [x for x in fit.warnings if "that noise is too large" in x]
    assert "below what the stated noise allows" in line
    runs = [dataclasses.replace(r.recording, noise_given=False) for r in fit.recordings]
    each = zip(fit.recordings, runs, strict=True)
    fit = dataclasses.replace(
        fit, recordings=tuple(dataclasses.replace(r, recording=x) for r, x in each)
    )
    assert any("below what the estimated noise allows" in x for x in fit.warnings)


def test_stated_noise_may_be_right_where_readings_repeat_each_other():
    def line(step):
        fit = a_fit(chi2=0.3)
        each = [
            dataclasses.replace(x, angle=np.round(x.angle / step) * step)
            for x in (r.recording for r in fit.recordings)
        ]
        each = zip(fit.recordings, each, strict=True)
        fit = dataclasses.replace(
            fit, recordings=tuple(dataclasses.replace(r, recording=x) for r, x in each)
        )
        (found,) = [x for x in fit.warnings if "below what the stated noise allows" in x]
        return found

    assert line(3e-3).endswith("the errors may be too small")
    assert line(1e-5).endswith("and so are the errors above")


def test_a_long_name_and_a_long_value_stand_apart():
    first, *rest = a_fit().numbers
    long = dataclasses.replace(first, name=first.name.ljust(36, "x"), value=-0.00294024)
    text = str(a_fit(numbers=(long, *rest)))
    assert f"{long.name} -0.00294024" in text


def test_lines_break_neither_a_number_from_its_unit_nor_a_unit():
    amounts = (
        "0.00014 N m rms",
        "3 N m s^2/rad^2",
        "2 +/- 1 kg m^2",
        "12 x noise",
        "3 N m/(rad s)",
    )
    for room in range(18, 40):
        lines = filled(" and ".join(amounts), width=room)
        assert all(any(x.removesuffix(" rms") in line for line in lines) for x in amounts)


def test_an_error_as_large_as_its_number_and_a_negative_one():
    first, *rest = a_fit().numbers
    sure = dataclasses.replace(first, name="quadratic_drag:shoulder.coefficient", value=-0.0328083)
    fit = a_fit(numbers=(dataclasses.replace(sure, std=0.0327, unit="N m s^2/rad^2"), *rest))
    text = str(fit)
    assert "-0.0328083 +/- 0.0327 (100 %)" in text
    assert max(map(len, text.splitlines())) <= 80
    assert (
        f"{sure.name} is negative, which physics does not allow, but by less than two errors"
        in (" ".join(fit.warnings))
    )


def test_a_joint_with_a_number_goes_without_an_article():
    assert names.placed("gravity", "joint1", ("joint1", "elbow")) == "gravity at joint1"
    assert names.placed("gravity", "elbow", ("joint1", "elbow")) == "gravity at the elbow"


def test_what_a_slipping_brake_is_of_does_not_read_as_another_effect():
    assert catalogue()["brake_slip"].kind() not in {
        k.titled().lower() for k in catalogue().values()
    }

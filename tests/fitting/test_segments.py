"""Driven motion that nothing pulls back: fitted in segments, so that what is missing is a torque
and not where it has led to."""

import dataclasses

import jax
import numpy as np
import pytest

import residyn
from residyn.diagnosis import compare_fit
from residyn.recordings.segments import segments_of
from residyn.recordings.tables import InertiaTable

MASS, VISCOUS, DRY, NOISE = 20.0, 60.0, 8.0, 2e-5


def slide(seconds=8.0, dry=DRY, spring=0.0, seed=0):
    """A slide led to and fro by a position controller; small steps of its own, every hundredth
    kept. The drive is held over each sample, as a digital controller does."""
    steps, h = 100, 1e-4
    count = round(seconds / (steps * h))
    q, v = 0.0, 0.0
    angle, drive = np.empty(count), np.empty(count)
    for i in range(count):
        t = i * steps * h
        wanted = 0.1 * np.sin(2 * np.pi * 0.5 * t) + 0.05 * np.sin(2 * np.pi * 0.17 * t)
        angle[i] = q
        drive[i] = 4000.0 * (wanted - q) - 300.0 * v
        for _ in range(steps):
            free = drive[i] - VISCOUS * v - spring * q
            # What friction it takes to stop within this step, but no more than there is.
            held = np.clip(free + MASS * v / h, -dry, dry)
            v += h * (free - held) / MASS
            q += h * v
    rng = np.random.default_rng(seed)
    time = np.arange(count) * steps * h
    return time, angle + NOISE * rng.standard_normal(count), drive


def experiment(*recordings):
    return residyn.Experiment(InertiaTable(("slide",), ((MASS,),), ("m",)), recordings)


def recorded(name="slide.csv", role="fit", **kind):
    time, angle, drive = slide(**kind)
    # The drive is held over the sample, and a recording's is a straight line between two.
    middle = 0.5 * (drive + np.concatenate([drive[:1], drive[:-1]]))
    return residyn.Recording.from_arrays(
        time, angle, drive=middle, noise=NOISE, name=name, role=role
    )


@pytest.fixture(scope="module")
def fit():
    check = recorded("check.csv", "check", seed=1)
    return residyn.fit(experiment(recorded(), check), effects=["coulomb_friction"], starts=1)


def test_friction_of_a_driven_slide_is_found(fit):
    found = {n.name: n.value for n in fit.numbers}
    assert found["damper:slide.damping"] == pytest.approx(VISCOUS, rel=0.03)
    assert found["coulomb_friction:slide.torque"] == pytest.approx(DRY, rel=0.03)


def test_segments_are_told_of_once_and_drawn_as_one(fit):
    assert len(fit.recordings) > 16
    said = [w for w in fit.warnings if "nothing pulls it back" in w]
    assert [w.partition(":")[0] for w in said] == ["slide.csv", "check.csv"]
    assert [r.recording.name for r in fit.whole] == ["slide.csv", "check.csv"]
    for whole in fit.whole:
        assert whole.predicted.shape == whole.recording.angle.shape
    assert "slide.csv (" in str(fit)
    assert np.sqrt(np.nanmean(fit.whole[1].residual ** 2)) == pytest.approx(
        fit.check_rmse[0], rel=1e-9
    )


def test_an_embedded_fit_takes_a_recording_whole(fit):
    (_, angle, _), noise = slide(), np.random.default_rng(7).standard_normal(800)
    with jax.enable_x64(True):
        fits = residyn.embed(fit)
        again = fits.with_angles(angle[:, None] + 0.1 * NOISE * noise[:, None])
        numbers = fits.problem.numbers(fits.start)
        chi2 = float(fits.chi2(numbers))
        assert 0 < abs(float(again.chi2(numbers)) - chi2) < 0.3 * chi2
        padded = np.zeros((sum(fits.segments), len(fits.problem.recorded.row[0]), 1))
        assert [x.shape for x in fits.readings(padded)] == [(800, 1)]
        with pytest.raises(ValueError, match="shape"):
            fits.with_angles(angle[1:, None])


def test_every_search_fits_the_same_segments(fit):
    how = {"effects": ["coulomb_friction"], "starts": 1}
    other = residyn.fit(experiment(recorded()), method="random", **how)
    names = [[r.recording.name for r in found.fitted] for found in (fit, other)]
    assert names[0] == names[1]
    for a, b in zip(fit.numbers, other.numbers, strict=True):
        assert abs(a.value - b.value) < 0.1 * a.std


@pytest.mark.slow
def test_what_a_spring_pulls_back_stays_whole():
    fit = residyn.fit(experiment(recorded(dry=0.0, spring=400.0)), starts=1)
    assert len(fit.recordings) == 1
    assert fit.numbers[0].value == pytest.approx(400.0, rel=0.02)


@pytest.mark.slow
def test_friction_is_named():
    found = residyn.diagnose(experiment(recorded()), starts=1, max_effects=1)
    assert (found.families[0].name, found.families[0].place) == ("dry friction", "slide")
    assert len(found.missing) == 1
    assert found.missing[0].recording == "slide.csv"


def test_segments_without_a_reading_bound_no_spectrum():
    whole = recorded(dry=0.0)
    lost = (whole.time > 3.1) & (whole.time < 4.5)
    angle = np.where(lost[:, None], np.nan, whole.angle)
    fit = residyn.fit(experiment(dataclasses.replace(whole, angle=angle)), starts=1)
    assert min(r.used.sum() for r in fit.recordings) == 0
    found = compare_fit(fit, missing=())
    assert np.isfinite(found.where.white["slide"])
    assert sum(c["share"] for c in found.where.to_dict()["frequency"]) == pytest.approx(1)


def test_over_a_gap_in_time_there_is_no_cut():
    """A recorder that was paused: no segment is empty, nor shorter than its own initial state."""
    time = np.concatenate([np.arange(50) / 50, 100 + np.arange(51) / 50])
    made = residyn.Recording.from_arrays(time, np.sin(time), noise=1e-3)
    parts = segments_of(made, 1.0)
    assert len(parts) > 1
    assert min(len(p.time) for p in parts) > 2
    np.testing.assert_array_equal(np.concatenate([p.time for p in parts]), time)

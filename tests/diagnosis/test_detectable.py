"""The atlas: from which strength an effect would show, and be told from its rivals."""

import json
import math

import jax
import numpy as np
import pytest
from scipy.stats import norm

import residyn
from residyn.cli import main
from residyn.diagnosis import detectable
from residyn.diagnosis.columns import Column
from residyn.diagnosis.detectable import Atlas, Detectable, Rivals
from residyn.diagnosis.evidence import INTENSITIES, log_prior_intensity, subset
from residyn.effects import CubicStiffness, QuadraticDrag
from residyn.recordings.tables import InertiaTable

pytestmark = pytest.mark.usefixtures("compiled_in_less_time")

CART = InertiaTable(("cart",), ((2.0,),), ("m",))


def one_release(noise):
    """A cart on a spring and a damper, let go 0.1 m from where it rests."""
    time = np.arange(0.0, 10.0, 0.02)
    q = (0.1 * np.exp(-0.2 * time) * np.cos(6.0 * time))[:, None]
    q = q + noise * np.random.default_rng(1).standard_normal(q.shape)
    return residyn.Experiment(CART, (residyn.Recording.from_arrays(time, q, noise=noise),))


@pytest.fixture(scope="module")
def atlases():
    return {noise: detectable(one_release(noise)) for noise in (1e-4, 2e-4)}


def test_evidences_are_those_of_the_readings_that_are_drawn():
    """A Gram matrix of two candidates' responses and of noise, under each random torque; readings
    are noise and half a width of both candidates."""
    rng, count = np.random.default_rng(2), len(INTENSITIES)
    responses = rng.standard_normal((count, 6, 2)) * [3.0, 1.0]
    noise, logs = rng.standard_normal((count, 6, 5)), rng.standard_normal(count)
    white = np.concatenate([responses, noise], -1)
    with jax.enable_x64(True):
        effects = CubicStiffness("cart"), QuadraticDrag("cart")
        rows = [Column(e, {}, (i,), np.zeros((0, 0))) for i, e in enumerate(effects)]
        rivals = Rivals(rows, logs, np.swapaxes(white, 1, 2) @ white)
        base, each = rivals.evidences(np.array([0.5, 0.5]))
    for k, prior in enumerate(log_prior_intensity(INTENSITIES)):
        for d, e in enumerate(noise[k].T):
            y = e + responses[k].sum(1) / 2
            whole = np.column_stack([-y, responses[k]])
            known = logs[k] + prior - y @ y / 2
            assert base[d, k] == pytest.approx(known)
            for i in (0, 1):
                expected, mean, covariance = subset(whole.T @ whole, [i])
                sided = norm.logcdf(mean[0] / math.sqrt(covariance[0, 0])) + math.log(2.0)
                assert each[i, d, k] == pytest.approx(known + expected + (sided if i else 0.0))


def test_what_a_small_random_torque_takes_up_is_not_named():
    """One column, seen without a random torque only; one takes it up at a price of `logs`."""
    rng, none = np.random.default_rng(3), np.array(INTENSITIES) == 0
    white = rng.standard_normal((100, 51)) * none[:, None, None]
    white[none, :, 0] = 0.5
    grams = np.swapaxes(white, 1, 2) @ white
    rows = [Column(CubicStiffness("cart"), {}, (0,), np.zeros((0, 0)))]

    def named(price):
        logs = np.where(none, 0.0, np.where(np.array(INTENSITIES) == 1e-3, -20.0 - price, -1e9))
        return Rivals(rows, logs, grams).counted(np.array([1.2]), 0, [])[0]

    with jax.enable_x64(True):
        assert named(1e9) > 0.9  # such a torque is as good as impossible
        assert named(0.0) < 0.1  # likelier than noise without it


def test_what_leaves_the_base_model_no_probability_at_all_is_named():
    """Readings of 50 widths: the base model is tens of thousands of nats behind."""
    none = np.array(INTENSITIES) == 0
    white = np.random.default_rng(3).standard_normal((100, 51)) * none[:, None, None]
    white[none, :, 0] = 0.5
    rows = [Column(CubicStiffness("cart"), {}, (0,), np.zeros((0, 0)))]
    with jax.enable_x64(True), np.errstate(all="raise", under="ignore"):
        rivals = Rivals(rows, np.where(none, 0.0, -1e9), np.swapaxes(white, 1, 2) @ white)
        assert rivals.counted(np.array([50.0]), 0, [])[:2] == (1.0, 1.0)


def test_twice_the_noise_hides_twice_the_strength(atlases):
    quiet, loud = ({e.effect: e for e in a.effects} for a in atlases.values())
    for label in ("cubic_stiffness:cart", "quadratic_drag:cart", "stiffness_drift:cart"):
        assert loud[label].shows == pytest.approx(2 * quiet[label].shows, rel=0.2)


def test_what_moves_alike_is_never_told(atlases):
    """A constant force shifts where the cart rests, and so does a shifted sensor."""
    for atlas in atlases.values():
        known = {e.effect: e for e in atlas.effects}
        one = known["constant_torque:cart"]
        assert one.shows is not None
        assert one.told is None
        assert one.rival == "sensor_offset:cart"
        cubic = known["cubic_stiffness:cart"]
        assert cubic.told is not None
        assert cubic.told >= cubic.shows


def test_it_reads_in_80_columns_and_as_json(atlases):
    atlas = atlases[1e-4]
    assert max(map(len, str(atlas).splitlines())) <= 80
    told = json.loads(json.dumps(atlas.to_dict(), allow_nan=False))
    assert told["noise"] == {"cart": 1e-4}
    assert [e["effect"] for e in told["effects"]] == [e.effect for e in atlas.effects]
    shares = [e["share"] for e in told["effects"] if e["share"] is not None]
    assert shares == sorted(shares)


def test_shape_numbers_have_their_units():
    size = 0.1, 0.02, None, None, None
    bend = {"angle": "m", "sharpness": "1"}
    made = (
        Detectable("dead_zone:elbow", "stiffness", "N m/rad", {"gap": 0.02}, {"gap": "rad"}, *size),
        Detectable("dead_zone:slide", "stiffness", "N/m", {"gap": 0.02}, {"gap": "m"}, *size),
        Detectable(
            "hysteresis:slide", "torque", "N", {"angle": 0.05, "sharpness": 1.0}, bend, *size
        ),
        Detectable(
            "periodic_disturbance:elbow",
            "sine",
            "N m",
            {"frequency": 2.8},
            {"frequency": "Hz"},
            *size,
        ),
    )
    words = str(Atlas(made, ("elbow", "slide"), ("rad", "m/s"), (1e-3, 1e-3), 20.0))
    told = " ".join(words.split())
    assert "at gap 0.020 rad" in told
    assert "at gap 0.020 m" in told
    assert "at angle 0.050 m, sharpness 1.0" in told
    assert "at frequency 2.8 Hz" in told


def test_noise_is_in_the_unit_of_what_is_read():
    time = np.arange(0.0, 4.0, 0.02)
    rate = (0.6 * np.exp(-0.2 * time) * np.sin(6.0 * time))[:, None]
    recording = residyn.Recording.from_arrays(time, rate, noise=2e-4, reads="rate")
    atlas = detectable(residyn.Experiment(CART, (recording,)))
    assert atlas.units == ("m/s",)
    assert "(noise: cart 0.20 mm/s)" in " ".join(str(atlas).split())


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["gravity", "--detectable", "x.toml"], "leave the rest out"),
        (["--json", "x.json"], "--json goes with --detectable"),
        (["--detectable", "none.toml"], "none.toml"),
    ],
)
def test_what_does_not_go_together_is_one_line(words, said, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["effects", *words]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert said in err

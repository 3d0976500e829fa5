"""Where a model fails: on MuJoCo arms whose truth is known, and part by part."""

import dataclasses
import json

import jax
import numpy as np
import pytest
from scipy.stats import kstest

import residyn
from residyn.cli import main
from residyn.diagnosis import compare_fit
from residyn.diagnosis.bands import bands
from residyn.diagnosis.linearised_fit import Tangent, spread
from residyn.diagnosis.residuals import Cell, Part
from residyn.diagnosis.spectrum import energies, spectrum, strips
from residyn.diagnosis.whiteness import Grid, hangs, narrow_bands, strongest_line, whiteness_of
from residyn.fitting import Mode, RecordingFit
from residyn.recordings.tables import ArmTable, InertiaTable

rig = pytest.importorskip("tests.rig")

pytestmark = pytest.mark.usefixtures("compiled_in_less_time", "pictures_not_written")

ARM = rig.paper_twin(0.3)
TABLE = ArmTable((ARM.l1, ARM.l2), ARM.shoulder, ARM.elbow, ARM.coupling)
NOISE = 1e-3
TIME = np.arange(1201) / 100
CART = InertiaTable(("cart",), ((1.0,),), ("m",))
FILE = '[inertia]\njoints = ["cart"]\nunits = ["m"]\nmatrix = [[1.0]]\n\n[[recordings]]\n'


def recording(seed=0, q0=(0.25, -0.3), friction=(0.0, 0.0), t=TIME, lost=0.0, **options):
    """One release of the arm, read with noise."""
    rng = np.random.default_rng(seed)
    q, _ = rig.simulate(ARM, t, q0, frictionloss=friction)
    q = q + NOISE * rng.standard_normal(q.shape)
    q[rng.random(q.shape) < lost] = np.nan
    if lost:
        q[400:460, 1] = np.nan
    settings = {"theta2": ARM.theta2, "noise": NOISE} | options
    return residyn.Recording.from_arrays(t, q, **settings)


def compared(*recordings):
    return residyn.compare(residyn.Experiment(TABLE, recordings), starts=2)


def quickly(*recordings, table=TABLE):
    """Without following the missing torque, which has tests of its own."""
    return compare_fit(residyn.fit(residyn.Experiment(table, recordings), starts=2), missing=())


@pytest.fixture(scope="module")
def clean():
    return compared(recording())


@pytest.fixture(scope="module")
def wrong():
    return quickly(recording(friction=(0.0, 0.1)))


def cart_motion(friction):
    q, _ = rig.simulate(rig.Cart(1.0, 100.0, 0.3), TIME[:1001], [0.05], frictionloss=[friction])
    return q + 1e-4 * np.random.default_rng(1).standard_normal(q.shape)


# -- what it says ----------------------------------------------------------------------------


def test_a_right_model_leaves_nothing(clean):
    assert clean.explained
    assert min(clean.where.white.values()) > 0.01
    assert clean.words[0].startswith("Nothing is left that the noise does not explain")
    assert "as it should be" in clean.words[-1]
    assert len(clean.words) == 2
    for part in (*clean.where.time, *(p for parts in clean.where.amplitude for p in parts)):
        for cell in part.cells:
            assert abs(cell.ratio - 1) < 4 / np.sqrt(2 * cell.freedom)
    assert clean.held_out.what == "last third"
    np.testing.assert_allclose(clean.held_out.held_out.ratio, 1, atol=0.15)
    assert (clean.held_out.held_out.expected >= 1).all()


def test_a_wrong_model_is_told_and_where(wrong):
    assert not wrong.explained
    assert wrong.where.white["elbow"] < 1e-12
    words = " ".join(wrong.words)
    assert wrong.words[0].startswith("The model misses something")
    for said in ("mrad at the elbow", "times the noise", "most at the elbow", "around mode 1"):
        assert said in words
    assert "worse than where it was fitted" in wrong.words[-1]
    assert 2 <= len(wrong.words) <= 5
    assert "friction" not in words  # no search: no name


def test_friction_on_a_cart_shows_late_and_at_small_swings():
    made = residyn.Recording.from_arrays(TIME[:1001], cart_motion(0.03), noise=1e-4)
    found = quickly(made, table=CART)
    words = " ".join(found.words)
    assert "It fails most late" in words
    assert "worst at small swings" in words
    last = found.where.time[-1]
    assert last.whole.ratio > 1.5 * found.where.joint[0].ratio
    assert (last.start, last.stop) == (8.75, 10.0)


@pytest.mark.parametrize(("window", "word"), [(0, "early"), (2, "midway"), (7, "late")])
def test_early_and_late_are_the_first_and_the_last_third(clean, window, word):
    """The third of eight windows, from 7.5 s to 11.25 s of 30 s, is neither."""
    loud, quiet = (Cell(x, 100.0) for x in (900.0, 100.0))
    time = [
        Part("", 3.75 * i, 3.75 * (i + 1), (quiet, loud if i == window else quiet))
        for i in range(8)
    ]
    changed = {
        "time": tuple(time),
        "joint": (quiet, loud),
        "white": {"shoulder": 0.5, "elbow": 0.0},
    }
    at = dataclasses.replace(clean.where, **changed)
    found = dataclasses.replace(clean, where=at)
    assert f"most at the elbow, {word} (3.0 times" in " ".join(found.words)
    assert "p of whiteness test (0.001) 0.50 < 1e-12" in " ".join(str(found).split())


def test_it_begins_with_the_verdict_and_fits_80_columns(clean, wrong):
    for found in (clean, wrong):
        text = str(found)
        assert " ".join(text.split()).startswith(found.words[0])
        assert str(found.fit) in text
        assert max(map(len, text.splitlines())) <= 80
        for heading in (
            "[[Where]]",
            "time since",
            "swing at the elbow",
            "[[Held out]]",
            "[[Horizon]]",
        ):
            assert heading in text


@pytest.mark.parametrize(("lost", "noise"), [(0.0, None), (0.05, 1e-4)])
def test_a_line_above_all_modes_is_not_white(lost, noise):
    """Mains hum of 50.02 Hz, read at 64 Hz."""
    t, rng = np.arange(1001) / 64, np.random.default_rng(7)
    q = 0.05 * np.exp(-0.15 * t) * np.cos(10 * t) + 1e-4 * rng.standard_normal(t.shape)
    q += 1e-4 * np.sin(2 * np.pi * 50.02 * t)
    q[rng.random(t.shape) < lost] = np.nan
    found = quickly(residyn.Recording.from_arrays(t, q, noise=noise), table=CART)
    assert found.p < 1e-6
    assert found.to_dict()["where"]["line"] == {"cart": pytest.approx(13.98, abs=0.02)}
    assert "there is a line of 13.9" in " ".join(found.words)


def test_noise_that_was_not_stated_is_not_called_stated(clean):
    """An estimate that is half the noise, as of readings that a filter has smoothed."""
    runs = [
        dataclasses.replace(r.recording, noise_given=False, noise=r.recording.noise / 2)
        for r in clean.fit.fitted
    ]
    found = compare_fit(residyn.fit(residyn.Experiment(TABLE, runs), starts=2), missing=())
    assert "more noise than was estimated" in " ".join(found.words)


def test_noise_that_is_stated_wrongly_is_no_failure_of_the_model():
    for factor, said in ((0.5, "more noise than was stated"), (2.0, "more than these readings")):
        found = quickly(recording(noise=factor * NOISE))
        assert found.explained
        assert said in " ".join(found.words)


# -- the numbers -----------------------------------------------------------------------------


def check_shares(found):
    where = found.where.to_dict()
    assert sum(c["share"] for c in where["joint"].values()) == pytest.approx(1)
    for name in ("time", "amplitude", "frequency"):
        assert sum(c["share"] for c in where[name]) == pytest.approx(1)
    for name in ("time", "frequency"):
        for joint, cell in where["joint"].items():
            shares = [part["joints"][joint]["share"] for part in where[name]]
            assert sum(shares) == pytest.approx(cell["share"])
    for joint, cell in where["joint"].items():
        shares = [c["share"] for c in where["amplitude"] if c["joint"] == joint]
        assert sum(shares) == pytest.approx(cell["share"])


def test_shares_add_up_to_one(clean, wrong):
    check_shares(clean)
    check_shares(wrong)


def test_the_error_grows_with_the_horizon(wrong):
    ahead = wrong.horizon.ahead
    assert len(ahead) == 8
    assert ahead[0].start == 0
    assert ahead[-1].stop == pytest.approx(8.0)
    assert wrong.horizon.seconds == pytest.approx(4.0)
    assert ahead[-1].error.ratio[0] > 2 * wrong.horizon.fitted.ratio[0]
    assert (ahead[-1].error.expected < 2).all()


def test_json_is_the_fits_and_more(clean):
    found = clean.to_dict()
    assert found.items() >= clean.fit.to_dict().items()
    more = {"words", "where", "held_out", "horizon", "missing_torque", "runs"}
    assert set(found) - set(clean.fit.to_dict()) == more
    where = found["where"]
    assert set(where) == {"white", "line", "joint", "time", "amplitude", "frequency"}
    assert set(where["white"]) == set(where["joint"]) == {"shoulder", "elbow"}
    assert where["time"][0].keys() == {"start", "stop", "share", "ratio", "joints"}
    bands = {"name", "start", "stop", "share", "ratio", "joints", "recordings"}
    assert where["frequency"][0].keys() == bands
    assert where["amplitude"][0].keys() == {"joint", "unit", "start", "stop", "share", "ratio"}
    assert found["held_out"].keys() == {"what", "joints", "fitted"}
    assert found["held_out"]["joints"]["elbow"].keys() == {"rmse", "ratio", "expected"}
    assert found["horizon"].keys() == {"seconds", "fitted", "ahead"}
    assert found["horizon"]["ahead"][0].keys() == {"start", "stop", "joints"}
    json.dumps(found, allow_nan=False)


def test_lost_and_uneven_samples():
    rng = np.random.default_rng(3)
    found = quickly(recording(seed=1, lost=0.1))
    assert found.explained
    check_shares(found)
    spoilt = quickly(recording(seed=1, lost=0.1, friction=(0.0, 0.1)))
    assert not spoilt.explained
    check_shares(spoilt)
    # What the lost samples hide must not turn up at frequencies where nothing is.
    assert spoilt.where.frequency[-1].whole.ratio < 1.1
    uneven = TIME + np.append(0.0, rng.uniform(-0.004, 0.004, len(TIME) - 1))
    found = quickly(recording(seed=2, t=uneven))
    assert found.explained
    check_shares(found)


def test_several_recordings_and_checks(clean):
    two = recording(seed=5, q0=(0.2, 0.3), t=TIME[:901], name="two")
    check = recording(seed=6, q0=(0.1, 0.35), role="check", name="check")
    found = quickly(recording(), two, check)
    assert found.explained
    check_shares(found)
    assert found.held_out.what == "check recordings"
    assert "held-out recordings" in found.words[-1]
    np.testing.assert_allclose(found.held_out.held_out.ratio, 1, atol=0.15)
    np.testing.assert_allclose(found.held_out.held_out.rmse, found.fit.check_rmse)
    assert [p.stop for p in found.where.time] == [p.stop for p in clean.where.time]


def test_looking_again_compiles_nothing(clean, monkeypatch):
    compiled = []
    original = jax._src.compiler.compile_or_get_cached

    def counting(*args, **kwargs):
        compiled.append(str(args[1].operation.attributes["sym_name"]))
        return original(*args, **kwargs)

    monkeypatch.setattr(jax._src.compiler, "compile_or_get_cached", counting)
    again = compare_fit(clean.fit, missing=())
    assert again.p == clean.p
    assert not any("polish" in name or "look" in name for name in compiled), compiled


def test_a_recording_too_short_to_cut_still_compares(clean, monkeypatch):
    monkeypatch.setattr("residyn.diagnosis.forecast.LEAST", 10_000)
    found = compare_fit(clean.fit, missing=())
    assert found.horizon is None
    assert found.held_out is None
    assert found.to_dict()["horizon"] is None
    assert "[[Horizon]]" not in str(found)
    assert len(found.words) == 1


def test_changes_no_setting(clean):
    assert not jax.config.jax_enable_x64


# -- the parts -------------------------------------------------------------------------------


def noise_less_fit(rng, time, unknowns, lost):
    """White noise less its part along random smooth columns, as spectra of two joints."""
    size = (len(time), 2)
    weights = [np.where(rng.random(size) < lost, 0.0, 1.0)]
    phase = np.cos(2 * np.pi * rng.uniform(0.3, 2.5, unknowns) * time[:, None, None])
    slopes = [phase * rng.standard_normal((1, 2, unknowns))]
    tangent = Tangent.of(slopes, weights, unknowns // 2)
    units = [rng.standard_normal(size) * weights[0]]
    units = [u - p for u, p in zip(units, tangent.part(units), strict=True)]
    made = residyn.Recording.from_arrays(time, np.zeros(size) + time[:, None], noise=1.0)
    beside = RecordingFit(made, made.angle, weights[0] == 0, np.zeros(4))
    return [row[0] for row in strips([beside], units, tangent, weights)], beside


MODES = [Mode(0.7, 0.0, 0.01, 0.0), Mode(2.0, 0.0, 0.03, 0.0)]


def test_the_test_is_calibrated():
    rng = np.random.default_rng(8)
    time = np.sort(rng.uniform(0, 12, 600))
    chances = []
    for _ in range(60):
        rows, beside = noise_less_fit(rng, time, 10, 0.1)
        narrow = narrow_bands(bands([MODES], [beside]), 12.0)
        chances += [whiteness_of([spectrum(row, narrow[0][-1].stop)], narrow) for row in rows]
    assert kstest(chances, "uniform").pvalue > 0.01
    assert np.mean(np.array(chances) < 0.05) < 0.12


@pytest.mark.parametrize("lost", [0.0, 0.05])
def test_a_line_is_found_at_any_frequency_and_seldom_in_noise(lost):
    rng = np.random.default_rng(12)
    time, chances = np.arange(600) / 50, []
    for _ in range(50):
        for row in noise_less_fit(rng, time, 10, lost)[0]:
            chances.append(strongest_line([row])[0])
            f = rng.uniform(0.2, 24.8)
            line = row.used * 0.6 * np.sin(2 * np.pi * f * time + rng.uniform(0, 6))
            p, found = strongest_line([row._replace(residual=row.residual + line)])
            assert p < 1e-3
            assert abs(found.frequency - f) < 0.5 / 12
    assert min(chances) > 1e-3
    assert np.mean(np.array(chances) < 0.05) < 0.1


@pytest.mark.parametrize("cycles", [0.8, 1.0, 1.5, 2.5, 7.3])
def test_what_hardly_repeats_is_no_line(cycles):
    """It is not white all the same."""
    time = np.arange(700) / 50
    (row, _), _ = noise_less_fit(np.random.default_rng(3), time, 4, 0.0)
    slow = 2.0 * np.sin(2 * np.pi * cycles * time / time[-1] + 0.4)
    p, found = strongest_line([row._replace(residual=row.residual + slow)])
    assert p < 1e-3
    if cycles < 2:
        assert found is None
    else:
        assert found.frequency == pytest.approx(cycles / time[-1], abs=0.3 / time[-1])
    louder = row.residual + slow + 4.0 * np.sin(2 * np.pi * 9.1 * time)
    assert strongest_line([row._replace(residual=louder)])[1].frequency == pytest.approx(9.1, 1e-2)


def test_energies_add_up_and_have_their_expectation():
    rng = np.random.default_rng(9)
    time = np.arange(800) * 0.02
    ratios = []
    for _ in range(20):
        rows, beside = noise_less_fit(rng, time, 8, 0.2)
        (cut,) = bands([MODES], [beside])
        one = spectrum(rows[0], cut[-1].start)
        energy, freedom = energies(one, [one.columns(b.start, b.stop) for b in cut[:-1]])
        assert (energy >= 0).all()
        assert energy.sum() <= one.energy
        assert freedom.sum() < one.freedom
        ratios.append((energy.sum() / freedom.sum(), one.energy / one.freedom))
    np.testing.assert_allclose(np.mean(ratios, axis=0), 1, atol=0.06)


def test_long_recordings_are_averaged_in_blocks_and_keep_their_lines():
    rng = np.random.default_rng(10)
    time = np.arange(20_000) * 0.001
    row = noise_less_fit(rng, time, 4, 0.0)[0][0]
    row = row._replace(residual=row.residual + 0.3 * np.sin(2 * np.pi * 0.7 * time))
    one = spectrum(row, 5.0)
    inside = one.columns(0.6, 0.8)
    assert one.products[inside] @ one.products[inside] > 0.8 * 0.3**2 * len(time) / 2
    np.testing.assert_allclose(np.diag(one.overlap), 1)


def test_bands_cover_every_frequency_once():
    made = recording(t=TIME)
    beside = RecordingFit(made, made.angle, np.zeros(made.angle.shape, bool), np.zeros(4))
    close = [Mode(1.0, 0.0, 0.01, 0.0), Mode(1.05, 0.0, 0.01, 0.0)]
    high = [Mode(0.02, 0.0, 0.01, 0.0), Mode(44.0, 0.0, 0.01, 0.0)]
    for modes in (MODES, close, high, MODES[:1], []):
        (cut,) = bands([modes], [beside])
        assert cut[0].start == 0
        assert cut[-1].name == "above"
        assert cut[-1].stop == pytest.approx(50)
        assert [b.stop for b in cut[:-1]] == [b.start for b in cut[1:]]
        assert all(b.stop > b.start for b in cut)
    names = [b.name for b in bands([MODES], [beside])[0]]
    for name in ("below mode 1", "mode 1", "2 x mode 1", "mode 2", "3 x mode 2"):
        assert name in names


def test_bands_are_about_each_recordings_own_modes():
    made = [recording(t=TIME), recording(t=TIME)]
    fitted = [RecordingFit(r, r.angle, np.zeros(r.angle.shape, bool), np.zeros(4)) for r in made]

    def modes(*frequencies):
        return [Mode(f, 0.0, 0.01, 0.0) for f in frequencies]

    each = bands([modes(0.9, 4.0), modes(0.6, 3.1)], fitted)
    assert [b.name for b in each[0]] == [b.name for b in each[1]]
    for cut, low, high in zip(each, (0.9, 0.6), (4.0, 3.1), strict=True):
        assert cut[0].start == 0
        assert [b.stop for b in cut[:-1]] == [b.start for b in cut[1:]]
        at = {"mode 1": low, "2 x mode 1": 2 * low, "mode 2": high, "2 x mode 2": 2 * high}
        for name, f in at.items():
            (band,) = [b for b in cut if b.name == name]
            assert band.start < f < band.stop
    narrow = narrow_bands(each, 12.0)
    assert [b.name for b in narrow[0]] == [b.name for b in narrow[1]]
    # On the other side of mode 2 a multiple is another band: it is none of all recordings.
    crossed = bands([modes(1.5, 4.0), modes(1.5, 2.2)], fitted)
    assert "2 x mode 1" not in {b.name for cut in crossed for b in cut}
    assert "2 x mode 1" in {b.name for b in bands([modes(1.5, 4.0)], fitted[:1])[0]}


def test_what_is_at_each_recordings_mode_is_said_to_be_at_a_mode():
    """Carts of 1 and 3 kg: the slower one's mode is far below the first one's."""
    made = []
    for seed, extra in enumerate((0.0, 2.0)):
        cart = rig.Cart(1.0 + extra, 100.0, 0.3)
        q, _ = rig.simulate(cart, TIME, [0.05], frictionloss=[0.05])
        q = q + 1e-4 * np.random.default_rng(seed).standard_normal(q.shape)
        name = f"{extra:g}.csv"
        settings = {"noise": 1e-4, "extra_mass": extra, "load": 9.81, "name": name}
        made.append(residyn.Recording.from_arrays(TIME, q, **settings))
    found = quickly(*made, table=CART)
    slow, fast = 10 / (2 * np.pi * np.sqrt(3)), 10 / (2 * np.pi)
    for own, f in zip(found.where.recordings, (fast, slow), strict=True):
        assert own.modes[0].frequency_hz == pytest.approx(f, rel=0.02)
    share = {p.name: p.whole.energy / found.where.total for p in found.where.frequency}
    assert share["mode 1"] > 0.8
    assert share["below mode 1"] < 0.1
    total = sum(p.whole.energy for p in found.where.frequency)
    assert total == pytest.approx(found.where.total)
    words = " ".join(found.words)
    assert "around mode 1 (0.9" in words
    assert " to 1.59 Hz)" in words
    assert "a line of" not in words
    told = next(b for b in found.to_dict()["where"]["frequency"] if b["name"] == "mode 1")
    assert told["start"] < fast < told["stop"]
    assert told["recordings"]["0.csv"] == {k: told[k] for k in ("start", "stop")}
    assert told["recordings"]["2.csv"]["start"] < slow < told["recordings"]["2.csv"]["stop"]
    assert "frequency, Hz, as in 0.csv" in str(found)


def test_rounding_of_a_smooth_curve_is_known():
    rng = np.random.default_rng(11)
    angle, step = np.linspace(-0.02, 0.03, 40), 1.5e-3
    grid = Grid.of(np.round(rng.uniform(-0.1, 0.1, 4000) / step) * step)
    assert grid.step == pytest.approx(step, rel=1e-9)
    for shake in (0.1, 0.3):
        read = angle + shake * step * rng.standard_normal((20_000, 1))
        mean = (np.round(read / step) * step).mean(axis=0) - angle
        left = np.full(10, np.hypot(shake * step, step / np.sqrt(12)))
        assert grid.matters(left)
        np.testing.assert_allclose(grid.error(angle, left), mean, atol=0.02 * step)
    assert not grid.matters(np.full(10, step))
    assert Grid.of(rng.standard_normal(500)).step == 0
    time = np.arange(1000) * 0.01
    swing = 0.05 * np.exp(-time) * np.sin(6 * time)
    still = hangs(time, swing, grid, 2 * np.pi / 6)
    assert not still[:300].any()
    assert still[-100:].all()


def test_a_pure_encoder_is_no_failure_of_the_model():
    made = recording(q0=(0.12, -0.1))
    truth, _ = rig.simulate(ARM, TIME, (0.12, -0.1))
    q = np.round(truth / 2e-3) * 2e-3
    pure = dataclasses.replace(made, angle=q, noise=np.full(2, 2e-3 / np.sqrt(12)))
    assert quickly(pure).p > 0.01


def test_spread_is_least_squares_own():
    rng = np.random.default_rng(12)
    slopes = [rng.standard_normal((30, 2, 5)), rng.standard_normal((20, 2, 5))]
    weights = [rng.uniform(0.5, 2.0, (30, 2)), rng.uniform(0.5, 2.0, (20, 2))]
    weights[0][20:] = 0.0
    columns = np.zeros((100, 8))  # 2 numbers, 3 of each recording
    columns[:60, :5] = slopes[0].reshape(60, 5)
    columns[60:, :2] = slopes[1].reshape(40, 5)[:, :2]
    columns[60:, 5:] = slopes[1].reshape(40, 5)[:, 2:]
    whitened = columns * np.concatenate([w.ravel() for w in weights])[:, None]
    square = whitened.T @ whitened + np.diag([0, 0, 0, 0, 1, 0, 0, 1])
    known = np.sqrt(np.einsum("ij,jk,ik->i", columns, np.linalg.inv(square), columns))
    found = np.concatenate([s.ravel() for s in spread(slopes, weights, 2, 1)])
    np.testing.assert_allclose(found, known, rtol=1e-6)


# -- the command -----------------------------------------------------------------------------


@pytest.fixture
def folder(tmp_path, monkeypatch):
    names = ("jax_enable_x64", "jax_compilation_cache_dir")
    more = (
        "jax_persistent_cache_min_compile_time_secs",
        "jax_persistent_cache_min_entry_size_bytes",
    )
    before = {name: jax.config.values[name] for name in (*names, *more)}
    rows = zip(TIME[:1001], cart_motion(0.03)[:, 0], strict=True)
    text = "\n".join(["t,q1", *(f"{t:.2f},{float(q)!r}" for t, q in rows), ""])
    (tmp_path / "cart.csv").write_text(text)
    (tmp_path / "cart.toml").write_text(FILE + 'file = "cart.csv"\nnoise = 1e-4\n')
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    for name, value in before.items():
        jax.config.update(name, value)


def test_the_command(folder, capsys):
    words = ["compare", "cart.toml", "--starts", "2", "--no-cache"]
    assert main([*words, "--json", "-", "--report", "cart.html"]) == 0
    out, err = capsys.readouterr()
    found = json.loads(out)
    assert found["where"]["white"]["cart"] < 1e-6
    assert found["model"] == ["spring:cart", "damper:cart"]
    assert err.startswith("The model misses something")
    assert (folder / "cart.html").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["none.toml"], "none.toml"),
        (["cart.toml", "--with", "coulomb"], "coulomb_friction"),
        (["cart.toml", "--json", "cart.csv"], "input"),
        (["cart.toml", "--method", "levenberg"], "--method"),
    ],
)
def test_bad_input_is_one_line(folder, capsys, words, named):
    assert main(["compare", *words, "--no-cache"]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("residyn: ")
    assert err.count("\n") == 1
    assert named in err


def test_without_a_period_nothing_hangs():
    """A driven slide rings in no mode: the motion may stand still, and is no ringing that ended."""
    time = np.arange(50) / 10.0
    still = hangs(time, 0.0 * time, Grid(0.0, 1e-3), np.inf)
    assert still.shape == time.shape
    assert not still.any()

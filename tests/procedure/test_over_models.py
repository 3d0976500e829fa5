"""Step 3 over models: the mixture's bands, and where its variance comes from."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.stats import norm

import residyn
from residyn.diagnosis.candidate_tests import Rival
from residyn.diagnosis.evidence import prior_of
from residyn.diagnosis.iteration import settle
from residyn.diagnosis.missing_torque import scene_of
from residyn.diagnosis.plan import InPlay
from residyn.diagnosis.search import Search
from residyn.diagnosis.tried import Tried, tried_alone
from residyn.effects import BearingDrag
from residyn.procedure.carried import NAMES, inertias, slopes_of_modes
from residyn.procedure.over_models import (
    Bare,
    ModeOver,
    OverModels,
    Spread,
    errors_of,
    modes_over,
    quantile,
    with_and_without_drag,
)
from residyn.procedure.unload import bare
from residyn.recordings.tables import ArmTable, Bearing
from tests.by_hand import NEXT

ARM = ArmTable((0.4, 0.4), 1.2, 0.6, 1.4)
BEARINGS = (Bearing("elbow", 0.1, 1e-4), Bearing("wrist", 0.1, 1e-4))
NOISE = 1e-3


pytestmark = pytest.mark.usefixtures("float64", "compiled_in_less_time")


@pytest.fixture(scope="module")
def two():
    """An arm on bearings that drag, and what springs and dampers make of it, with drag and
    without."""
    time = np.arange(0.0, 8.0, 0.02)
    still = residyn.Recording.from_arrays(time, np.sin(time)[:, None] * [1, 1], noise=NOISE)
    experiment = residyn.Experiment(ARM, (still,), BEARINGS)
    mechanism = residyn.fitting.mechanism_of(experiment, still)
    model = residyn.fitting.model_for(mechanism, ["bearing_drag"])
    truth = model.with_values({
        "spring:shoulder.stiffness": 40.0, "spring:elbow.stiffness": 30.0,
        "damper:shoulder.damping": 0.2, "damper:elbow.damping": 0.1,
        "bearing_drag.coefficient": 0.4,
    })  # fmt: skip
    q = np.asarray(residyn.simulate(truth, time, [0.2, -0.15]).q)
    q = q + NOISE * np.random.default_rng(0).standard_normal(q.shape)
    made = residyn.Recording.from_arrays(time, q, noise=NOISE, theta2=1.0)
    made = dataclasses.replace(made, theta2=0.0)
    experiment = residyn.Experiment(ARM, (made,), BEARINGS)
    scene, base = scene_of(experiment, ())
    both = (*base, BearingDrag())
    (found,) = settle(scene, [scene.start(both, prior_of(scene, both))], 1.0)
    assert found is not None
    models = [tried_alone(scene, base), Tried(("bearing_drag",), *found, log_prior=0.0)]
    return experiment, scene, models, truth


def test_inertias_that_are_off_by_one_share_move_stiffness_and_damping_by_it(two):
    """Eq. 9."""
    _, scene, (base, _), _ = two
    errors = errors_of(scene, Rival.of(scene, base), np.eye(3))
    sizes = np.asarray(inertias(scene.mechanisms[0]))
    np.testing.assert_allclose(errors.moved @ sizes, base.best.numbers, rtol=0.02)


def test_so_they_move_no_frequency_on_the_bearings(two):
    _, scene, (base, _), _ = two
    rival = Rival.of(scene, base)
    sizes = np.asarray(inertias(scene.mechanisms[0]))
    errors = errors_of(scene, rival, np.outer(sizes, sizes) * 0.01)
    mode = modes_over([Bare(rival.model, rival.model, errors)], np.ones(1))[0]
    for spread in (mode.frequency_hz, mode.damping_ratio):
        assert spread.std * np.sqrt(spread.from_inertias) < 1e-3 * abs(spread.mean)


def test_damping_in_orbit_with_and_without_the_name(two):
    """Springs and dampers alone keep the drag; the band over both models holds the truth."""
    experiment, scene, models, truth = two
    recording = experiment.recordings[0]
    off = bare(experiment, truth, recording)
    expected = slopes_of_modes(off, truth)[0][0].values[1]
    rivals = [Rival.of(scene, m) for m in models]
    each = [
        Bare(bare(experiment, r.model, recording), r.model, errors_of(scene, r, None))
        for r in rivals
    ]
    p = np.exp([m.log_evidence for m in models] - np.max([m.log_evidence for m in models]))
    spread = modes_over(each, p / p.sum())[0].damping_ratio
    assert spread.low < expected < spread.high
    alone = [modes_over([b], np.ones(1))[0].damping_ratio for b in each]
    assert abs(alone[0].mean - expected) > 10 * spread.std  # what the base model says
    assert spread.from_name + spread.from_numbers + spread.from_inertias == pytest.approx(1.0)


def test_drag_of_the_bearings_is_as_likely_as_not_before_the_recordings(two):
    experiment, *_, truth = two
    time = experiment.recordings[0].time
    little = truth.with_values({"bearing_drag.coefficient": 0.01})
    q = np.asarray(residyn.simulate(little, time, [0.2, -0.15]).q)
    q = q + NOISE * np.random.default_rng(0).standard_normal(q.shape)
    made = residyn.Recording.from_arrays(time, q, noise=NOISE)
    scene, base = scene_of(dataclasses.replace(experiment, recordings=(made,)), ())
    search = Search(scene, base)
    assert [m.added for m in search.tried.values()] == [()]
    models, p, left_out = with_and_without_drag(search)
    logs = {m.added: math.log(x) - m.log_evidence for m, x in zip(models, p, strict=True)}
    none = logs.pop(())
    prior = {k: math.exp(x - none) for k, x in logs.items()}
    assert prior.pop(("bearing_drag",)) == pytest.approx(1 / 4)
    # Its law is not known: others that damp the whole mechanism are as likely.
    assert prior
    assert set(prior) <= {("air_drag",), ("bearing_quadratic_drag",), ("coupling_damping",)}
    assert list(prior.values()) == pytest.approx([1 / 4] * len(prior))
    # As large as effects that are worth a name is not what so little drag is known to be.
    known = {frozenset(m.added): m.log_evidence for m in models}
    drag = frozenset(["bearing_drag"])
    assert known[drag] > search.tried[drag].log_evidence + 0.5
    assert left_out < 1e-9


def test_an_arm_without_bearings_has_no_drag_of_theirs(two):
    experiment, *_ = two
    scene, base = scene_of(dataclasses.replace(experiment, bearings=()), ())
    models, p, _ = with_and_without_drag(Search(scene, base))
    assert [m.added for m in models] == [()]
    assert p == pytest.approx([1.0])


def test_where_the_variance_comes_from(two):
    """Law of total variance, over two models that are alike likely."""
    experiment, scene, models, _ = two
    rivals = [Rival.of(scene, m) for m in models]
    recording = experiment.recordings[0]
    each = [
        Bare(bare(experiment, r.model, recording), r.model, errors_of(scene, r, None))
        for r in rivals
    ]
    both = modes_over(each, np.array([0.5, 0.5]))[0].damping_ratio
    one, other = (modes_over([b], np.ones(1))[0].damping_ratio for b in each)
    assert both.std**2 * both.from_name == pytest.approx((one.mean - other.mean) ** 2 / 4)
    within = (one.std**2 + other.std**2) / 2
    assert both.std**2 * both.from_numbers == pytest.approx(within)
    assert (one.from_name, one.from_numbers) == (0.0, pytest.approx(1.0))


def test_quantiles_of_a_mixture():
    p, mean, std = np.array([0.3, 0.7]), np.array([0.0, 5.0]), np.array([1.0, 2.0])
    for q in (0.025, 0.5, 0.975):
        x = quantile(q, p, mean, std)
        assert p @ norm.cdf((x - mean) / std) == pytest.approx(q, abs=1e-9)
    assert quantile(0.975, np.ones(1), np.zeros(1), np.ones(1)) == pytest.approx(1.959964, abs=1e-5)


def test_it_reads_in_80_columns():
    known = Spread(0.5, 0.49, 0.51, 0.005, 0.2, 0.5, 0.3)
    found = OverModels(
        models=(InPlay(("bearing_drag",), 0.7), InPlay((), 0.3)),
        left_out=0.0,
        poses=((0.3, (ModeOver(known, known, 1.0),) * 2),),
        next_test=dataclasses.replace(NEXT, band=0.004),
        narrows="damping_ratio",
        joints=("shoulder", "elbow"),
    )
    text = str(found)
    assert max(map(len, text.splitlines())) <= 80
    assert "drag of the air bearings" in text
    assert "70 %" in text
    assert "was as likely as not beside each model" in " ".join(text.split())
    assert "0.4900 to 0.5100 Hz" in text
    assert "49.00 to 51.00 %" in text
    assert "expected to narrow it to +/- 0.40 %." in " ".join(text.split())
    assert list(found.to_dict()) == [
        "models", "left_out", "stopped", "poses", "narrows", "next_test",
    ]  # fmt: skip
    assert len(NAMES) == 3

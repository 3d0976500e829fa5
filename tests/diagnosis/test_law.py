"""A law without a name: a free curve's band against a known curve, the right joint and variable in
MuJoCo arms (tests/rig) with laws of no catalogue, no curve where a name or nothing is hidden, and a
class that is loaded and fitted from the file that was written."""

import dataclasses

import jax
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import residyn
from residyn import effects
from residyn.cli import main
from residyn.diagnosis import formula, free_curves
from residyn.diagnosis.evidence import (
    INTENSITIES,
    NEGLIGIBLE,
    conditional,
    prior_of,
    subset,
)
from residyn.diagnosis.free_curves import Along, Kind, Place, heights_of, points, splines
from residyn.diagnosis.law import curve_models
from residyn.diagnosis.search import Search
from residyn.diagnosis.tried import tried_alone
from residyn.effects import Damper, Spring
from residyn.filtering.free_curve import HEIGHTS, FreeCurve
from residyn.filtering.trajectory import Scene
from residyn.physics.motion import JointMotion
from residyn.physics.parameter import parameters_of
from residyn.recordings.tables import ArmTable
from tests import rig

CART = residyn.ConstantInertia([[2.0]], joints=("cart",), units=("m",))
NOISE = 5e-4
ARM = rig.paper_twin(0.3)
TABLE = ArmTable((ARM.l1, ARM.l2), ARM.shoulder, ARM.elbow, ARM.coupling)


@pytest.fixture(autouse=True)
def as_before(monkeypatch):
    """The catalogue is left as it was."""
    monkeypatch.setattr(effects, "CATALOGUE", dict(effects.CATALOGUE))


def a_cart(curve, seed=0):
    """A cart on a spring with a torque f(angle) beside it: its scene and a smoothed trajectory."""

    class Hidden(residyn.JointEffect):
        name = "hidden"

        def joint_torque(self, motion):
            return curve(motion.q)

    model = CART + Spring("cart", 80.0) + Damper("cart", 0.4) + Hidden("cart")
    t = np.arange(600) * 0.02
    q = np.asarray(residyn.simulate(model, t, [0.4], steps=3000).q)
    q = q + NOISE * np.random.default_rng(seed).standard_normal(q.shape)
    recording = residyn.Recording.from_arrays(t, q, noise=NOISE)
    scene = Scene([recording], [CART], [np.zeros(q.shape, bool)])
    base = scene.start(
        [Spring("cart"), Damper("cart")], prior_of(scene, [Spring("cart"), Damper("cart")])
    )
    for x in (0.3, 0.1, 0.1):
        base = scene.smoothed(base, scene.linearised(base), x)
    return scene, base


def bump(q):
    return 1.5 * jax.numpy.exp(-(((q - 0.1) / 0.08) ** 2))


def test_splines_add_up_to_one():
    x = np.linspace(-0.3, 0.7, 200)
    assert np.allclose(splines(x, -0.3, 0.7).sum(axis=1), 1.0, atol=1e-6)


def test_a_curve_s_columns_are_the_slopes_of_its_torque():
    with jax.enable_x64(True):
        scene, base = a_cart(bump)
        place = Place(Kind("angle"), 0, -0.4, 0.4)
        mean = np.random.default_rng(1).standard_normal(free_curves.SPLINES)
        law = free_curves.Posterior(np.zeros(0), mean, np.zeros(0), np.zeros(0))
        along = Along(scene, base)
        held = free_curves.with_curve(scene, base, place, law.heights)
        torque = scene.torques(held)["free_curve:cart"][:, 0]
        columns = splines(along.variable("angle", 0), -0.4, 0.4).toarray().T[:, : scene.K]
        assert np.allclose(mean @ columns, torque, atol=1e-9)


def test_a_model_with_a_curve_has_the_program_of_the_one_without():
    with jax.enable_x64(True):
        scene, base = a_cart(bump)
        place = Place(Kind("rate", "direction"), 0, -1.0, 1.0)
        held = free_curves.with_curve(scene, base, place, np.ones(HEIGHTS))

        def program(t):
            return jax.tree.map(np.shape, scene.tabulated(t))

        assert program(held) == program(base)


def test_a_formula_is_the_curve_of_its_terms():
    place = Place(Kind("angle"), 0, -0.37, 0.4)
    x = np.linspace(place.low, place.high, 1001)
    for column in formula.columns_of(place):
        shapes = dict(zip((n for n, _ in column.term.shapes), column.shape, strict=True))
        for part, heights in zip(column.term.parts, formula.parts_of(place, column).T, strict=True):
            exact = formula.value_of(part, x, formula.scale_of(place), shapes)
            error = splines(x, place.low, place.high, HEIGHTS) @ heights - exact
            assert np.sqrt(np.mean(error**2)) < 2e-4 * np.abs(exact).max()


def test_a_power_of_the_size_is_written_so():
    for kind in free_curves.KINDS:
        for term in formula.grammar(Place(kind, 0, -0.4, 0.4)):
            if term.family == "power":
                assert ["abs" in part for part in term.parts] == [
                    "|" in word for word in term.words
                ]


def test_terms_that_have_a_name_are_laws_of_the_catalogue():
    """Each at unit strength is one of its laws at unit strength, but for a constant."""
    laws = {
        ("angle", ""): "constant_torque cubic_stiffness asymmetric_stiffness cogging",
        ("rate", ""): "quadratic_drag asymmetric_damping",
        ("time", ""): "constant_torque",
        ("time", "angle"): "stiffness_drift",
        ("angle", "direction"): "coulomb_friction",
        ("time", "direction"): "coulomb_friction",
    }
    x = np.linspace(-0.4, 0.4, 81)
    for kind, terms in formula.NAMED.items():
        names = laws[kind].split()
        assert len(names) == len(terms)
        for name, term in zip(names, terms, strict=True):
            effect = effects.catalogue()[name]("cart")
            own = [n for n in parameters_of(effect) if n.silent is not None]
            shapes = {k: 0.3 for k, _ in term.shapes}
            assert formula.grammar(Place(kind, 0, -0.4, 0.4)).count(term) == 1
            for part, number in zip(term.parts, own, strict=True):
                effect = dataclasses.replace(effect, **{n.field: 0.0 for n in own}, **shapes)
                effect = dataclasses.replace(effect, **{number.field: 1.0})
                torque = []
                for a in x:
                    at = {"time": 0.0, "angle": 1.0, "rate": 1.0, kind.variable: a}
                    at |= {"angle": 1.0} if kind.factor == "angle" else {}
                    motion = JointMotion(at["time"], at["angle"], at["rate"], 1.0)
                    torque.append(float(effect.joint_torque(motion)))
                value = formula.value_of(part, x, 1.0, shapes)
                assert np.ptp(np.array(torque) - value) < 1e-6


def test_the_size_of_a_curve_is_one_in_all_units():
    """A cart read in centimetres, with its forces in N/100, has the same gain from a curve as in
    metres: its prior width is of the torque, whatever the unit of the variable."""
    gains = []
    for unit in (1.0, 100.0):
        model = CART + Spring("cart", 80.0) + Damper("cart", 0.4)
        t = np.arange(400) * 0.02
        with jax.enable_x64(True):
            q = np.asarray(residyn.simulate(model, t, [0.4], steps=2000).q)
            q = unit * (q + NOISE * np.random.default_rng(3).standard_normal(q.shape))
            recording = residyn.Recording.from_arrays(t, q, noise=unit * NOISE)
            scene = Scene([recording], [CART], [np.zeros(q.shape, bool)])
            own = [Spring("cart"), Damper("cart")]
            base = scene.start(own, prior_of(scene, own))
            for x in (0.3, 0.1, 0.1):
                base = scene.smoothed(base, scene.linearised(base), x)
            alone = scene.evidences(base, scene.linearised(base), [0.01]).log_evidence[0]
            found = free_curves.screen(Along(scene, base), [0.01])
            order = sorted(found, key=lambda s: s.place.kind)
            gains.append([s.posterior.evidences[0] - alone for s in order])
    assert np.allclose(*gains, atol=1e-3)


def test_the_band_holds_a_known_curve_and_the_curve_is_found():
    with jax.enable_x64(True):
        scene, base = a_cart(bump)
        along = Along(scene, base)
        found = free_curves.screen(along, [0.1, 0.01, 0.0])
        assert found[0].place.kind == Kind("angle")
        settled = free_curves.settled_curve(
            scene, (), base, found[0].place, found[0].posterior, 0.1, 0.0
        )
        assert INTENSITIES[int(np.argmax(settled.evidences))] < NEGLIGIBLE
        x = np.linspace(settled.place.low, settled.place.high, 81)
        # Beside the line, which the spring takes up.
        off = np.eye(81) - np.outer(x, x) / (x @ x)
        rows = off @ splines(x, settled.place.low, settled.place.high)
        std = np.sqrt(np.einsum("gi,ij,gj->g", rows, settled.curve.covariance, rows))
        error = rows @ settled.curve.mean - off @ np.asarray(bump(x))
        assert np.mean(np.abs(error) < 1.96 * std) > 0.85
        assert std.max() < 0.2  # of 1.5 N


def test_a_curve_s_evidence_is_at_most_its_highest_likelihood():
    """Of a disc that rings for five minutes: whitened slopes are then as large as 1e6, and as good
    as parallel."""
    t = np.arange(0.0, 300.0, 0.04)

    def rates(_, x):
        q, v = x
        return v, -(0.03 * q + 4e-5 * v + 4e-4 * v * abs(v)) / 0.02

    q = solve_ivp(rates, (0, 300), (0.8, 0.0), t_eval=t, rtol=1e-9, atol=1e-11).y[:1].T
    q = q + 3e-4 * np.random.default_rng(0).standard_normal(q.shape)
    disc = residyn.ConstantInertia([[0.02]], joints=("disc",), units=("rad",))
    recording = residyn.Recording.from_arrays(t, q, noise=3e-4)
    with jax.enable_x64(True):
        scene = Scene([recording], [disc], [np.zeros(q.shape, bool)])
        base = tried_alone(scene, [Spring("disc"), Damper("disc")])
        each = heights_of(splines(points(0.0, 1.0), 0.0, 1.0).toarray())
        for law in free_curves.screen(Along(scene, base.best), [0.0]):
            if law.place.kind not in (Kind("time", "rate"), Kind("rate")):
                continue
            settled = free_curves.settle(scene, base.best, law.place, law.posterior, 0.01)
            given = [law.place], [each], INTENSITIES, settled.law.heights
            grams = Along(scene, settled.best).gram(*given)
            for total, gram, evidence in zip(*grams, settled.evidences, strict=True):
                u = np.linalg.lstsq(gram[1:, 1:], -gram[1:, 0], rcond=None)[0]
                assert evidence < total - 0.5 * (gram[0, 0] + u @ gram[1:, 0])


def test_what_is_held_is_taken_away_again():
    """Linearised with a curve in it, the evidence of the model without the curve is the same."""
    with jax.enable_x64(True):
        scene, base = a_cart(lambda q: 0.0 * q)
        place = Place(Kind("time"), 0, 0.0, 12.0)  # linear in nothing but the heights
        heights = 0.1 * np.ones(HEIGHTS)
        held = free_curves.with_curve(scene, base, place, heights)
        logs, own = [], np.eye(HEIGHTS)[:, :40]
        for t, at in ((base, None), (held, heights)):
            total, grams = Along(scene, t).gram([place], [own], [0.0], at)
            evidence, rest = conditional(grams[0], len(base.u))
            logs.append((total[0] + evidence, subset(rest, np.arange(40))[0]))
        assert np.allclose(*logs, atol=1e-5)


def test_a_curve_has_an_evidence_along_a_motion_that_does_not_visit_it():
    """Its prior is known before the motion is: here one that stands still, at the end of all that
    was visited."""
    with jax.enable_x64(True):
        scene, base = a_cart(bump)
        (first, *_) = free_curves.screen(Along(scene, base), [0.1])
        still = dataclasses.replace(base, path=np.full_like(base.path, 2.0 * base.path.max()))
        found = first.posterior.beside(Along(scene, still), first.place, [0.1, 0.0])
    assert not np.isnan(found.evidences).any()
    assert np.isfinite(found.mean).all()


def test_a_formula_whose_motion_runs_away_has_no_evidence(monkeypatch):
    """Above the density of the readings without a residual there is rounding only."""
    with jax.enable_x64(True):
        scene, base = a_cart(lambda q: 0.0 * q)
        along = Along(scene, base)
        place = Place(Kind("angle"), 0, *along.span("angle", 0))
        column = next(c for c in formula.columns_of(place) if not c.shape)
        held = formula.Sum(place, (column,), 0.0, 0.0, np.zeros(len(column.term.parts)))
        evidence = held.beside(along, place, [0.1, 0.0]).evidences
        between = float(np.mean(evidence))
        monkeypatch.setattr(Scene, "highest", between)
        known = held.beside(along, place, [0.1, 0.0]).evidences
    np.testing.assert_array_equal(known, np.where(evidence < between, evidence, -np.inf))


# -- arms from MuJoCo ------------------------------------------------------------------------------


def diagnosed(*hidden, seed=0, **how):
    each = [rig.Hidden(label, values) for label, values in hidden]
    rng = np.random.default_rng(seed)
    case = rig.record(rng, ARM, (0.3, -0.25), each, seconds=6.0, rate=80.0, noise=NOISE)
    recording = residyn.Recording.from_arrays(
        case.t, case.q, name="release.csv", noise=NOISE, theta2=ARM.theta2
    )
    return residyn.diagnose(residyn.Experiment(TABLE, (recording,)), **how)


@pytest.fixture(scope="module")
def quintic():
    return diagnosed(("fifth_power_drag:elbow", {"coefficient": 0.02}), max_effects=1)


def test_a_law_of_no_catalogue_is_found_at_its_joint_with_its_formula(quintic):
    assert quintic.verdict == "unexplained"
    assert quintic.added == ()
    law = quintic.laws[0]
    assert (law.joint, law.variable, law.factor) == ("elbow", "rate", "")
    assert law.probability > 0.9
    assert law.formula.families == ("power",)
    truth = law.on_grid(0.02 * law.grid**5)
    inside = np.abs(law.mean - truth) < 1.96 * law.std
    assert np.sum(law.visits * inside) > 0.8
    assert law.model.held_out.held_out.ratio.max() < 1.2


def test_a_law_that_a_name_comes_near_is_found_beside_it():
    """A dead zone and a cog nearly make an exponential stop: names alone leave no torque."""
    values = {"torque": 0.08, "angle": 0.2, "width": 0.06, "side": 1.0}
    found = diagnosed(("exponential_stop:elbow", values))
    assert (found.verdict, found.added) == ("unexplained", ())
    law = found.laws[0]
    assert (law.joint, law.variable, law.factor) == ("elbow", "angle", "")
    assert law.probability > 0.9
    kind = found.families[0]
    assert (kind.name, kind.place) == ("spring shape", "elbow")
    assert kind.unnamed > 0.8
    assert law.probability == pytest.approx(kind.unnamed)
    assert found.words[0].startswith("A spring shape at the elbow is ")
    assert law.formula is not None
    assert law.formula.families == ("exponential",)
    rise, error, _ = law.formula.parameters["rise"]
    assert 0 < error < rise


def test_a_curve_beside_names_is_tried_beside_fewer():
    """Whether a name is at work shows beside the curve without it, however far behind that was at
    first order: here two names that only a prior speaks for."""
    with jax.enable_x64(True):
        scene, _ = a_cart(bump)
        search = Search(scene, [Spring("cart"), Damper("cart")])
        one = search.beside(search.base, "quadratic_drag:cart")
        two = one and search.beside(one, "asymmetric_stiffness:cart")
        search.beside(search.base, "asymmetric_stiffness:cart")
        assert two is not None
        surely = np.where(np.array(INTENSITIES) == 0, two.evidences.max(), -1e3)
        best = dataclasses.replace(two, evidences=surely, log_prior=1e3)
        search.tried[frozenset(best.added)] = best
        found = {frozenset(m.added) for m in curve_models(search) if m.place.kind == Kind("angle")}
    assert found == {frozenset(best.added[:k]) for k in (1, 2)} | {frozenset(best.added[1:])}


def test_the_written_file_loads_and_fits(quintic, tmp_path):
    law = quintic.laws[0]
    path = tmp_path / "found_effects.py"
    path.write_text(law.found.text(path.name))
    assert effects.load_effects(path) == (law.found.name,)
    assert main(["effects", law.found.name, "--effects", str(path)]) == 0
    fit = residyn.fit(quintic.fit.experiment, effects=[law.found.label], starts=1)
    assert fit.reduced_chi2 < 1.1
    ((_, (value, std, unit)),) = law.formula.parameters.items()
    (number,) = (n for n in fit.numbers if n.name.startswith(law.found.name))
    assert number.unit == unit == "N m"
    assert abs(number.value - value) < 0.1 * std


def test_a_name_wins_where_there_is_one():
    found = diagnosed(("quadratic_drag:elbow", {"coefficient": 0.05}))
    assert found.verdict == "missing"
    assert found.added == ("quadratic_drag:elbow",)
    assert not found.laws or found.laws[0].probability < 0.5


def test_nothing_is_found_where_nothing_is():
    found = diagnosed()
    assert found.verdict == "adequate"
    assert found.laws == ()
    assert found.to_dict()["laws"] == []


def test_a_free_curve_is_no_effect_of_the_catalogue():
    assert FreeCurve.name not in effects.catalogue()

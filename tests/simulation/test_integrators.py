"""Integrators of the user's own, and how exact the default's steps were."""

import dataclasses
import json
import math

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import residyn
from residyn.cli import main
from residyn.diagnosis.linearised_fit import on_host
from residyn.fitting import FitError, integration
from residyn.fitting.conclusion import finishing
from residyn.fitting.integration import checked, corrected, too_coarse
from residyn.fitting.lanes import alone, evaluating
from residyn.fitting.least_squares import one_start
from residyn.fitting.multistart import Descent, descending
from residyn.fitting.problem import Ready, ready
from residyn.recordings.tables import InertiaTable
from tests.exact import EXACT, IMPLICIT, LaggingDrag, dry_motion, error_of, recorded, two_joints

TIME = np.arange(400) / 50


pytestmark = pytest.mark.usefixtures("compiled_in_less_time")


def off(one, other):
    """Between the numbers of two fits, in standard errors."""
    pairs = zip(one.numbers, other.numbers, strict=True)
    return max(abs(a.value - b.value) / b.std for a, b in pairs)


@pytest.fixture(scope="module")
def smooth():
    return recorded(two_joints(residyn.CubicStiffness("tip", 30.0)), TIME)


@pytest.fixture(scope="module")
def usual(smooth):
    return residyn.fit(smooth, effects=["cubic_stiffness:tip"], starts=1)


# -- the user's integrator -------------------------------------------------------------------


@pytest.mark.parametrize("solver", ["Tsit5", diffrax.Dopri8(), "StickSlip"])
def test_another_solver_gives_the_same_fit(smooth, usual, solver):
    fit = residyn.fit(smooth, effects=["cubic_stiffness:tip"], starts=1, integrator=solver)
    assert off(fit, usual) < 0.01
    name = solver if isinstance(solver, str) else "Dopri8"
    assert fit.integrator == name
    assert name in str(fit)
    assert usual.integrator == "fixed"


def test_every_simulation_of_a_fit_goes_through_diffrax(smooth, monkeypatch):
    asked = []
    solve = diffrax.diffeqsolve

    def watched(terms, solver, *args, **more):
        asked.append(type(solver).__name__)
        return solve(terms, solver, *args, **more)

    monkeypatch.setattr(diffrax, "diffeqsolve", watched)
    jax.clear_caches()
    residyn.fit(smooth, starts=1)
    assert asked == []
    # Of tolerances that no other test has, so that it is traced here.
    residyn.fit(smooth, starts=1, integrator=residyn.Integrator("Bosh3", rtol=3e-5, atol=1e-7))
    assert set(asked) == {"Bosh3"}


def test_the_integration_error_compiles_no_further_program(smooth):
    happened: list[str] = []

    def listen(event, duration_secs, **more):
        if event == "/jax/core/compile/backend_compile_duration":
            happened.append(more.get("fun_name", "a program"))

    jax.clear_caches()
    # It stays: JAX 0.8 takes none back.
    jax.monitoring.register_event_duration_secs_listener(listen)
    jax.jit(lambda x: x + 1.0)(0.0)
    assert happened
    fit = residyn.fit(smooth, starts=1, progress=lambda words: happened.append(f": {words}"))
    assert 0.0 < fit.integration_error < 1.0
    end = happened.index(": errors, modes and held-out recordings")
    assert happened[end + 1 :] == []


def test_smaller_tolerances_come_nearer_to_the_truth(smooth):
    loose, fine = (
        residyn.fit(
            smooth,
            effects=["cubic_stiffness:tip"],
            starts=1,
            integrator=residyn.Integrator("Bosh3", rtol=rtol, atol=1e-3 * rtol),
        )
        for rtol in (1e-4, 1e-7)
    )
    with jax.enable_x64(True):
        errors = [checked(fit)[0] for fit in (loose, fine)]
    assert errors[1] < errors[0]


def test_simulate_takes_any_integrator():
    with jax.enable_x64(True):
        model = two_joints()
        paths = [
            residyn.simulate(model, TIME, [0.2, -0.1], integrator=i).q
            for i in (None, "Tsit5", "Dopri8", EXACT, diffrax.Dopri5())
        ]
    for path in paths:
        np.testing.assert_allclose(path, paths[3], atol=2e-5)
    np.testing.assert_allclose(paths[2], paths[3], atol=1e-7)


def test_a_solver_of_diffrax_differentiates_in_the_mode_of_its_adjoint():
    cart = residyn.ConstantInertia([[1.0]], ["cart"], ["m"]) + residyn.Spring("cart", 9.0)

    def last(stiffness, **how):
        stiffer = cart.with_values({"spring:cart.stiffness": stiffness})
        how = {"steps": 20, "integrator": "Dopri8"} | how
        return residyn.simulate(stiffer, [0.0, 1.0], [0.1], **how).q[-1, 0]

    with jax.enable_x64(True):
        exact = -0.1 * np.sin(3.0) / 6.0  # d/dk of 0.1 cos(sqrt(k) t), k = 9, t = 1
        forward = jax.jacfwd(lambda k: last(k, adjoint=diffrax.ForwardMode()))(9.0)
        assert float(forward) == pytest.approx(exact, rel=1e-6)


def test_a_drive_that_jumps_is_followed(smooth):
    recording = smooth.recordings[0]
    drive = np.zeros_like(recording.angle)
    drive[100:200, 0] = 1.0
    driven = dataclasses.replace(recording, drive=drive)
    made = dataclasses.replace(smooth, recordings=(driven,))
    with jax.enable_x64(True):
        from residyn.fitting.least_squares import predict

        model = two_joints()
        found = []
        for integrator in (None, "Tsit5"):
            own = dataclasses.replace(made, integrator=integrator)
            here = ready(own, own.fit_recordings, ())
            wild = [np.zeros(recording.angle.shape, bool)]
            problem, _ = here._replace(finer=2).problem(
                here.model.with_vector(model.vector()), wild
            )
            one = jax.tree.map(lambda x: jnp.asarray(x)[0], problem.recorded)
            state = jnp.array([0.2, -0.1, 0.0, 0.0])
            found.append(
                jax.jit(lambda v, p=problem, o=one, s=state: predict(p, o, v, s))(model.vector())
            )
    np.testing.assert_allclose(found[0][:400], found[1][:400], atol=2e-6)


def test_an_embedded_fit_takes_an_integrator(smooth):
    short = dataclasses.replace(
        smooth.recordings[0], time=TIME[:60], angle=smooth.recordings[0].angle[:60]
    )
    made = dataclasses.replace(smooth, recordings=(short,))
    fit = residyn.fit(made, starts=1)
    with jax.enable_x64(True):
        plain = residyn.embed(fit)
        other = residyn.embed(fit, integrator="Tsit5")
        assert other.problem.integrator.name == "Tsit5"
        numbers = jnp.asarray(fit.model.vector())
        # Away from the minimum, where the slope is 0.
        slope = jax.jacfwd(plain.chi2)(1.1 * numbers)
        np.testing.assert_allclose(jax.jacfwd(other.chi2)(1.1 * numbers), slope, rtol=1e-3)


# -- what a solver cannot do -----------------------------------------------------------------


@pytest.mark.parametrize("effect", ["coulomb_friction:tip", "brake_slip:base"])
def test_a_solver_that_cannot_stick_is_refused_in_one_line(smooth, effect):
    with pytest.raises(residyn.InputError, match=f"Tsit5 cannot integrate {effect}") as raised:
        residyn.fit(smooth, effects=[effect], integrator="Tsit5")
    assert "StickSlip" in str(raised.value)
    assert len(str(raised.value).splitlines()) == 1


def test_stick_slip_steps_are_handed_to_diffrax():
    model = two_joints(residyn.CoulombFriction("tip", 0.1))
    with jax.enable_x64(True):
        own, handed = (
            residyn.simulate(model, TIME, [0.2, -0.1], steps=600, integrator=i).q
            for i in (None, "StickSlip")
        )
    np.testing.assert_allclose(own, handed, atol=1e-12)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"solver": "Euler99"}, "there is no such solver"),
        ({"solver": diffrax.Euler()}, "estimates no error"),
        ({"solver": 3}, "must be a name or a diffrax solver"),
        ({"rtol": -1.0}, "rtol = -1"),
        ({"atol": "x"}, "atol"),
        ({"controller": diffrax.ConstantStepSize()}, "must adapt the step"),
        ({"adjoint": "backward"}, "must be an adjoint"),
        ({"max_steps": 0}, "max_steps = 0"),
        ({"controller": diffrax.PIDController(jnp.ones(1), jnp.ones(1))}, "plain numbers"),
    ],
)
def test_integrators_that_cannot_be(given, said):
    with pytest.raises(residyn.InputError, match=said):
        residyn.Integrator(**given)


def test_a_fit_needs_an_adjoint_in_forward_mode(smooth):
    backward = residyn.Integrator(adjoint=diffrax.RecursiveCheckpointAdjoint())
    with pytest.raises(residyn.InputError, match="forward mode"):
        residyn.fit(smooth, integrator=backward)


# -- how exact the steps were ----------------------------------------------------------------


def test_the_stated_error_is_the_true_one(usual):
    error = error_of(usual)
    assert 0.5 < usual.integration_error / error < 2.0
    with jax.enable_x64(True):
        assert 0.5 < checked(usual)[0] / error < 2.0


@pytest.fixture(scope="module")
def cart():
    """A cart on a spring with dry friction, by DOP853 from one reversal to the next."""
    time = np.arange(500) / 50
    q = dry_motion(
        lambda q, v: (np.eye(1), -40.0 * q - 0.1 * v), np.array([0.3]), np.array([0.2, 0.0]), time
    )
    q = q + 1e-4 * np.random.default_rng(0).standard_normal(q.shape)
    recording = residyn.Recording.from_arrays(time, q, noise=1e-4)
    return residyn.Experiment(InertiaTable(("cart",), [[1.0]], ("m",)), (recording,))


def test_the_stated_error_is_the_true_one_with_dry_friction(cart):
    fit = residyn.fit(cart, effects=["coulomb_friction"], starts=2)
    assert 0.5 < fit.integration_error / error_of(fit) < 2.0


def test_dry_motion_is_the_closed_form():
    # Without a damper a cart on a spring loses 2 F/k at every half swing, and rests within F/k.
    k, friction, time = 40.0, 0.7, np.arange(600) / 100
    push = lambda q, v: (np.eye(1), -k * q)  # noqa: E731
    q = dry_motion(push, np.array([friction]), np.array([0.2, 0.0]), time)[:, 0]
    half = np.floor(time * np.sqrt(k) / np.pi)
    swings = np.floor((0.2 * k / friction + 1) / 2)
    middle = friction / k * (-1) ** half
    size = 0.2 - (2 * half + 1) * friction / k
    closed = middle + size * np.cos(np.sqrt(k) * time)
    rest = (-1) ** swings * (0.2 - 2 * swings * friction / k)
    np.testing.assert_allclose(q, np.where(half < swings, closed, rest), atol=1e-10)


def test_the_error_of_coarse_steps_is_not_in_the_numbers(smooth, monkeypatch):
    """Steps 1.8 times as long leave 19 times the error; numbers stay those of an exact solver."""
    exact = residyn.fit(smooth, effects=["cubic_stiffness:tip"], starts=1, integrator="Dopri8")
    steps = Ready.steps
    monkeypatch.setattr(Ready, "steps", lambda *given: math.ceil(steps(*given) / 1.8))
    fit = residyn.fit(smooth, effects=["cubic_stiffness:tip"], starts=1)
    # It could have moved the numbers by so many standard errors.
    assert fit.integration_error * math.sqrt(2 * len(TIME)) > 0.5
    assert off(fit, exact) < 0.02


def test_a_correction_that_the_model_does_not_follow_is_not_made(usual):
    with jax.enable_x64(True):
        problem, y = usual.problem, usual.unknowns
        here = alone(evaluating(problem, y))
        cost = float(np.sum(here.along**2) + np.sum(here.beside**2))
        wild = [~r.used for r in usual.recordings]
        descent = Descent(usual.ready, problem, wild, y, here, cost, 1, True)
        moved, times = [], 1.0

        def one(which, where, shares, size):
            at, found, *rest = one_start(which, where, shares, size)
            moved.append(where is not y)
            more = found._replace(beside=times * found.beside) if moved[-1] else found
            return at, more, *rest

        for times in (1.0, 10.0):
            moved.clear()
            found, *_ = alone(corrected(descent, usual.experiment.fit_recordings), one)
            assert moved == [False, True]
            assert (found is descent) == (times == 10.0)


def test_steps_that_are_too_coarse_are_refined_and_that_is_said(smooth, monkeypatch):
    steps = Ready.steps
    coarse = lambda self, *given: max(16, math.ceil(steps(self, *given) * 0.2))  # noqa: E731
    usual = residyn.fit(smooth, effects=["cubic_stiffness:tip"], starts=1)
    monkeypatch.setattr(
        Ready, "steps", lambda self, *given: self.finer * coarse(self._replace(finer=1), *given)
    )
    fit = residyn.fit(smooth, effects=["cubic_stiffness:tip"], starts=1)
    (said,) = [w for w in fit.warnings if "integration steps left an error" in w]
    assert str(fit.integration_steps) in said
    assert fit.integration_steps < usual.integration_steps * 2
    assert fit.integration_error < 0.1
    assert off(fit, usual) < 0.1


def test_a_search_by_other_means_goes_on_with_shorter_steps_too(usual, monkeypatch):
    """As a diagnosis does, which descends by a program of its own; and as often as it takes."""
    steps = Ready.steps
    coarse = lambda self, *given: max(16, math.ceil(steps(self, *given) * 0.2))  # noqa: E731
    monkeypatch.setattr(
        Ready, "steps", lambda self, *given: self.finer * coarse(self._replace(finer=1), *given)
    )
    monkeypatch.setattr(integration, "MOST_AT_ONCE", 2)
    numbers = np.array([n.value for n in usual.numbers])
    near = np.array([[r.state for r in usual.fitted]])
    wild = [r.wild for r in usual.fitted]
    with jax.enable_x64(True):
        begun = usual.ready, usual.model, numbers[None], wild
        descent = alone(descending(*begun, near=near), on_host)
        fit = alone(finishing(usual.experiment, numbers, descent, 0.0), on_host)
    assert fit.shortened is not None
    assert fit.shortened[1] > 0.1
    assert fit.integration_steps == 4 * fit.shortened[0]
    assert fit.integration_error < 0.1
    assert off(fit, usual) < 0.1


def test_an_error_counts_beside_what_the_model_misses(usual):
    assert too_coarse(0.11, 1.0)
    assert not too_coarse(0.11, 4.0)
    assert too_coarse(math.inf, 100.0)
    worse = dataclasses.replace(usual, integration_error=0.3, reduced_chi2=100.0)
    assert not [w for w in worse.warnings if "integration" in w]


def test_an_error_that_stays_large_is_warned_of(usual):
    bad = dataclasses.replace(usual, integration_error=0.3)
    (said,) = [w for w in bad.warnings if "integration" in w]
    assert "0.3 of the noise" in said
    assert 'solver = "Tsit5" under [integrator]' in said
    assert not [w for w in usual.warnings if "integration" in w]


@pytest.fixture(scope="module")
def stiff():
    # The lag of 0.1 ms is too short to change anything.
    return recorded(two_joints(residyn.QuadraticDrag("tip", 0.4)), TIME[:100])


def test_steps_that_are_too_coarse_for_a_stiff_effect_are_named(stiff):
    with pytest.raises(FitError, match=r'too coarse .* solver = "Kvaerno5" under \[integrator\]'):
        residyn.fit(stiff, effects=[LaggingDrag("tip")], starts=1)


@pytest.mark.slow  # an implicit solver and its derivatives compile for half a minute
def test_a_stiff_effect_is_fitted_by_an_implicit_solver(stiff):
    fit = residyn.fit(stiff, effects=[LaggingDrag("tip")], starts=1, integrator=IMPLICIT)
    plain = residyn.fit(stiff, effects=["quadratic_drag:tip"], starts=1)
    assert fit.converged
    assert off(fit, plain) < 0.2


# -- the command and the file ----------------------------------------------------------------


@pytest.fixture
def file(tmp_path, smooth):
    residyn.recording.write_csv(tmp_path / "free.csv", TIME, smooth.recordings[0].angle)
    text = (
        '[inertia]\njoints = ["base", "tip"]\nunits = ["rad", "rad"]\n'
        "matrix = [[1.0, 0.3], [0.3, 0.5]]\n[[recordings]]\n"
        'file = "free.csv"\nnoise = 1e-3\n'
    )

    def write(more=""):
        path = tmp_path / "arm.toml"
        path.write_text(text + more)
        return str(path)

    return write


def test_the_file_names_an_integrator_and_the_command_line_goes_before_it(file, capsys):
    path = file('[integrator]\nsolver = "Tsit5"\nrtol = 1e-7\natol = 1e-9\n')
    assert residyn.load(path).integrator == residyn.Integrator("Tsit5", 1e-7, 1e-9)
    assert main(["fit", path, "--integrator", "fixed", "--no-cache", "--json", "-"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["integrator"] == "fixed"
    assert 0 < told["integration_error"] < 0.1


def test_the_error_is_checked_where_that_is_asked(file, capsys):
    assert main(["fit", file(), "--check-integration", "--no-cache", "--json", "-"]) == 0
    got = capsys.readouterr()
    told = json.loads(got.out)
    assert told["integration_error_checked"] == pytest.approx(told["integration_error"], rel=0.5)
    assert "against Dopri8" in got.err


@pytest.mark.parametrize(
    ("more", "words", "said"),
    [
        ('[integrator]\nsolver = "Euler99"\n', [], "arm.toml: [integrator]: solver"),
        ("[integrator]\nrtol = 1e-8\n", [], "[integrator]: solver is missing"),
        ('[integrator]\nsolver = "Tsit5"\nrtol = -1\n', [], "[integrator]: rtol = -1"),
        ('[integrator]\nsolvr = "Tsit5"\n', [], 'did you mean "solver"'),
        ("", ["--integrator", "Euler99"], "--integrator: solver"),
        ("", ["--integrator", "Tsit5", "--with", "coulomb_friction:tip"], "cannot integrate"),
    ],
)
def test_bad_input_is_one_line_and_status_two(file, more, words, said, capsys):
    assert main(["fit", file(more), "--no-cache", *words]) == 2
    error = capsys.readouterr().err.strip()
    assert said in error
    assert len(error.splitlines()) == 1

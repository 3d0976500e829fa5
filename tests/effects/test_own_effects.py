"""Effects that users bring: as in the README, from a file, from an installed package."""

import importlib.metadata
import json
import re
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import residyn
from residyn import effects
from residyn.cli import main
from residyn.fitting.integration import stable
from residyn.fitting.problem import ready

ROOT = "self.coefficient * jnp.sign(motion.v) * jnp.sqrt(jnp.abs(motion.v))"
README = Path(__file__).parents[2] / "README.md"


@pytest.fixture(autouse=True)
def as_before(monkeypatch):
    """The catalogue is left as it was."""
    monkeypatch.setattr(effects, "CATALOGUE", dict(effects.CATALOGUE))
    yield
    effects.adopt_installed.cache_clear()


@pytest.fixture
def own(tmp_path):
    """The README's file of effects."""
    (text,) = [
        block
        for block in re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)
        if "class " in block
    ]
    path = tmp_path / "my_effects.py"
    path.write_text(text)
    return path


@pytest.fixture
def experiment(tmp_path, own):
    """A cart on a spring that has the README's effect."""
    effects.load_effects(own)
    mechanism = residyn.ConstantInertia([[1.0]], ["cart"], ["m"])
    (quintic,) = effects.effects_named("quintic_stiffness:cart", mechanism)
    model = mechanism + residyn.Spring("cart", 40.0) + residyn.Damper("cart", 0.1) + quintic
    model = model.with_values({"quintic_stiffness:cart.coefficient": 60.0})
    t = np.arange(1000) * 0.01
    q = np.asarray(residyn.simulate(model, t, [0.5], steps=2000).q)
    q = q + 5e-4 * np.random.default_rng(0).standard_normal(q.shape)
    residyn.recording.write_csv(tmp_path / "cart.csv", t, q)
    path = tmp_path / "cart.toml"
    path.write_text(
        '[inertia]\njoints = ["cart"]\nunits = ["m"]\nmatrix = [[1.0]]\n'
        '[[recordings]]\nfile = "cart.csv"\nnoise = 5e-4\n'
    )
    effects.CATALOGUE.pop("quintic_stiffness")
    return path


def test_the_readmes_effect_is_fitted_from_its_file(own, experiment, capsys):
    words = [str(experiment), "--effects", str(own), "--with", "quintic_stiffness", "--json", "-"]
    assert main(["fit", *words]) == 0
    found = json.loads(capsys.readouterr().out)
    number = found["parameters"]["quintic_stiffness:cart.coefficient"]
    assert number["unit"] == "N/m^5"
    assert abs(number["value"] - 60.0) < 4 * number["std"] < 6.0
    assert found["reduced_chi2"] < 1.2


@pytest.mark.parametrize(
    ("command", "option"), [("fit", "--json"), ("fit --each", "--json"), ("diagnose", "--found")]
)
def test_it_is_not_written_over(own, experiment, capsys, command, option):
    before = own.read_bytes()
    what = experiment.parent if "--each" in command else experiment
    words = [*command.split(), str(what), "--effects", str(own), option, str(own)]
    assert main(words) == 2
    assert f"{option} {own}: is an input" in capsys.readouterr().err
    assert own.read_bytes() == before


def test_one_with_an_infinite_slope_at_rest_leaves_no_modes_and_that_is_said(
    own, experiment, capsys
):
    text = own.read_text().replace("self.coefficient * motion.q**5", ROOT)
    own.write_text(f"import jax.numpy as jnp\n{text}")
    words = ["--effects", str(own), "--with", "quintic_stiffness", "--json", "-"]
    # It is not what the cart has: whether such a fit settles is not asked here.
    assert main(["fit", str(experiment), *words]) in (0, 1)
    found = json.loads(capsys.readouterr().out)
    assert found["modes"] == []
    said = "there are no modes: at rest the slope of quintic_stiffness:cart is infinite"
    assert any(line.startswith(said) for line in found["warnings"])


def test_it_is_listed_and_shown(own, capsys):
    assert main(["effects", "--effects", str(own)]) == 0
    assert "quintic_stiffness" in capsys.readouterr().out
    assert main(["effects", "quintic_stiffness", "--effects", str(own)]) == 0
    out = capsys.readouterr().out
    assert "end of the swing" in out
    assert "parameters\n" in out
    assert "source\n" not in out  # no heading of what the class does not say


def test_python_takes_an_instance():
    class Stop(residyn.JointEffect):
        name = "stop"
        strength: float = residyn.param("how hard", residyn.parameter.TORQUE)

        def joint_torque(self, motion):
            return self.strength * motion.q**7

    residyn.adopt(Stop)
    mechanism = residyn.ConstantInertia([[1.0]], ["cart"], ["m"])
    assert (mechanism + Stop("cart")).labels == ("stop:cart",)
    assert effects.effects_named("stop:cart", mechanism)[0] == Stop("cart")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (None, "no such file"),
        ("x = 1\n", "defines no effect"),
        ("class (:\n", "line 1"),
        ("import residyn\n\n1 / 0\n", "line 3: ZeroDivisionError"),
        ("from residyn import JointEffect\nclass Mine(JointEffect):\n    pass\n", 'name = "mine"'),
        (
            'from residyn import JointEffect\nclass Mine(JointEffect):\n    name = "mine"\n',
            "lacks the method joint_torque",
        ),
        (
            'from residyn import JointEffect\nclass Mine(JointEffect):\n    name = "spring"\n'
            "    def joint_torque(self, motion):\n        return 0.0\n",
            '"spring" is taken',
        ),
    ],
)
def test_a_bad_file_is_told_in_one_line(tmp_path, capsys, text, says):
    path = tmp_path / "mine.py"
    if text is not None:
        path.write_text(text)
    assert main(["effects", "--effects", str(path)]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "mine.py" in line
    assert says in line


@pytest.mark.parametrize(
    ("law", "says"),
    [
        ("return motion.qd", "line 6: AttributeError: 'JointMotion' object has no attribute 'qd'; "
         "a motion has t, q, v, direction"),
        ("if motion.q > 0: return 1.0", "line 6: a number that JAX traces has no truth value"),
        ("return max(motion.q, 0.0)", "jnp.minimum for min"),
        ("return math.sin(motion.q)", "line 6: float() and math take no number that JAX traces"),
        ("return np.sin(motion.q)", "line 6: NumPy and math take no number that JAX traces"),
        ("pass", "line 5: joint_torque returns nothing: must be the torque, a number"),
        ("return 'much'", 'line 5: joint_torque returns "much", a str'),
        ("return np.ones(2)", "line 5: joint_torque returns an array of shape (2,)"),
        ("return 1 / 0", "line 6: ZeroDivisionError"),
        ("return self.much", "has no attribute 'much'"),
    ],
)  # fmt: skip
def test_a_mistake_in_a_law_is_told_with_its_line(tmp_path, capsys, law, says):
    path = tmp_path / "mine.py"
    path.write_text(
        "import math; import numpy as np\nfrom residyn import JointEffect\n"
        f'class Mine(JointEffect):\n    name = "mine"\n'
        f"    def joint_torque(self, motion):\n        {law}\n"
    )
    assert main(["effects", "--effects", str(path)]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert line.startswith(f"residyn: {path}: line ")
    assert says in line


@pytest.mark.parametrize(
    ("body", "says"),
    [
        (
            "def joint_rate(self, motion): return motion.v",
            "line 7: joint_rate returns a number: must be a tuple of rates, one number for each",
        ),
        ("def joint_rate(self, motion): return motion.v, 0.0", "returns (a number, a number)"),
        ("def joint_rate(self, motion): return (jnp.ones(2),)", "(an array of shape (2,))"),
        ("def joint_follow(self, motion): return motion.q", "joint_follow returns a number"),
        (
            "def reading(self, angles, mechanism): return 2 * angles[0]",
            "line 7: reading returns an array of shape (3,): must be a tuple of one array for each",
        ),
        ("def reading(self, angles, mechanism): return angles[:1]", "reading returns ("),
        ("def reading(self, angles, mechanism): return 0.0, 0.0", "(a number, a number)"),
        ("def delays(self, mechanism): return 0.0", "delays returns a number"),
    ],
)  # fmt: skip
def test_whatever_a_law_returns_is_checked(tmp_path, body, says):
    path = tmp_path / "mine.py"
    path.write_text(
        "import jax.numpy as jnp; from residyn import JointEffect, Memory, parameter\n"
        'class Mine(JointEffect):\n    name = "mine"\n'
        '    memory = (Memory("x", parameter.ANGLE),)\n'
        f"    def joint_torque(self, motion):\n        return 0.0\n    {body}\n"
    )
    with pytest.raises(residyn.InputError, match=re.escape(says)):
        residyn.load_effects(path)


class Stop(residyn.JointEffect):
    name = "own_stop"
    stiffness: float = residyn.param("stiffness", residyn.parameter.STIFFNESS)

    def joint_torque(self, motion):
        return self.stiffness * motion.q if motion.q > 0.1 else 0.0


class Nameless(Stop):
    name = None


class ShapeOnly(residyn.JointEffect):
    name = "own_shape"
    gap: float = residyn.param("gap", residyn.parameter.ANGLE, silent=None, default=0.1)

    def joint_torque(self, motion):
        return self.gap * motion.q


@pytest.mark.parametrize(
    ("kind", "says"),
    [
        (Stop, r"own_stop:cart: line \d+: a number that JAX traces has no truth value"),
        (Nameless, "Nameless needs a name"),
        (ShapeOnly, "own_shape:cart: ShapeOnly: has shapes only"),
    ],
)
def test_an_instance_is_checked_as_a_file_is(kind, says):
    time = np.linspace(0.0, 4.0, 80)
    run = residyn.Recording.from_arrays(time, 0.1 * np.cos(6 * time)[:, None], name="run")
    bodies = residyn.ConstantInertia([[1.0]], ["cart"], ["m"])
    with pytest.raises(residyn.InputError, match=says):
        residyn.fit(residyn.Experiment(bodies, [run]), effects=[kind("cart")], starts=1)


class Logarithm(residyn.JointEffect):
    name = "own_logarithm"
    torque_at_1: float = residyn.param("torque", residyn.parameter.TORQUE)

    def joint_torque(self, motion):
        return self.torque_at_1 * jnp.log(motion.q)


def test_a_law_or_a_number_that_is_not_finite_is_named():
    time = np.linspace(0.0, 4.0, 80)
    run = residyn.Recording.from_arrays(time, 0.1 * np.cos(6 * time)[:, None], name="run")
    bodies = residyn.ConstantInertia([[1.0]], ["cart"], ["m"])
    model = bodies + residyn.Spring("cart", 36.0)
    endless, wild = Logarithm("cart", 0.1), residyn.CoulombFriction("cart", np.nan)
    words = "at rest the torque of own_logarithm:cart, or its slope, is not finite"
    for call in (residyn.simulate, lambda model, t, q0: residyn.steps_for(model, t[-1])):
        with pytest.raises(ValueError, match=words):
            call(model + endless, time, [0.1])
    rig = residyn.Experiment(bodies, [run])
    here = ready(rig, [run], [endless])
    with pytest.raises(residyn.FitError, match=words):
        stable(here, here.model.with_vector(here.typical()))
    words = "own_logarithm:cart: its torque is not finite along the readings of run"
    with pytest.raises(residyn.InputError, match=words):
        residyn.fit(rig, effects=[endless], starts=1)
    words = "coulomb_friction:cart.torque = nan: must be finite"
    with pytest.raises(ValueError, match=words):
        residyn.simulate(model + wild, time, [0.1], steps=50)
    with pytest.raises(ValueError, match=words):
        residyn.fit(rig, effects=[wild], starts=1)


def test_a_model_takes_no_effect_without_a_name():
    with pytest.raises(TypeError, match="Nameless needs a name"):
        residyn.ConstantInertia([[1.0]], ["cart"], ["m"]) + Nameless("cart", 3.0)


def test_a_simulation_tells_a_mistake_in_a_law_from_traced_steps():
    model = residyn.ConstantInertia([[1.0]], ["cart"], ["m"]) + residyn.Spring("cart", 4.0)
    with pytest.raises(residyn.InputError, match=r"own_stop:cart: line \d+: .* no truth value"):
        residyn.simulate(model + Stop("cart", 3.0), [0.0, 1.0], [0.2])


@pytest.mark.parametrize(
    ("numbers", "says"),
    [
        ({"a": {"silent": None, "default": 5.0}}, "Mine: has shapes only (silent=None)"),
        ({"a": {}, "b": {"silent": None, "default": 0.0}}, "grid of the shape b (silent=None)"),
        (
            {"a": {}, "b": {"silent": None, "default": 1.0, "grid": (-0.5, 0.0, 0.5)}},
            "must be positive",
        ),
    ],
)
def test_numbers_that_a_diagnosis_could_not_find_are_refused(numbers, says):
    declared = {k: residyn.param(k, residyn.parameter.RATIO, **how) for k, how in numbers.items()}
    body = {"name": "mine", "joint_torque": lambda self, motion: self.a, **declared}
    kind = type(residyn.JointEffect)(
        "Mine", (residyn.JointEffect,), {**body, "__annotations__": dict.fromkeys(numbers, float)}
    )
    with pytest.raises(residyn.InputError, match=re.escape(says)):
        residyn.adopt(kind)


def test_installed_packages_offer_effects(own, monkeypatch):
    (kind,) = effects.read_effects(own)

    class Point:
        name, value = "quintic", "somewhere:QuinticStiffness"

        def load(self):
            return kind

    effects.adopt_installed.cache_clear()
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: [Point()])
    assert effects.catalogue()["quintic_stiffness"] is kind


def test_an_installed_package_that_offers_no_effect_is_named(monkeypatch):
    class Point:
        name, value = "broken", "somewhere:nothing"

        def load(self):
            return 3

    effects.adopt_installed.cache_clear()
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: [Point()])
    with pytest.raises(residyn.InputError, match="entry point broken"):
        effects.catalogue()

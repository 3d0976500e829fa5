"""A law that was found, as a class in a file: it loads like any effect's, and step 3 asks whose it
is."""

import numpy as np
import pytest

import residyn
from residyn import effects
from residyn.effects.found import FoundLaw, FoundNumber
from residyn.errors import InputError
from residyn.physics.motion import JointMotion
from residyn.procedure import check_unload
from residyn.procedure.over_models import without_effects_of_bearings
from residyn.recordings.experiment import Experiment
from residyn.recordings.recording import Recording
from residyn.recordings.tables import ArmTable, Bearing

LAW = FoundLaw(
    "elbow", "rate", "", "a (q'/0.4)^5 (q' in rad/s)", "found in release.csv, 2026-11-24",
    (FoundNumber("a", "strength of its power", "TORQUE", 0.25, True),), "self.a * (x / 0.4) ** 5",
)  # fmt: skip


@pytest.fixture
def loaded(tmp_path, monkeypatch):
    """Brings the law, with one line of its file exchanged."""

    def bring(old="", new=""):
        monkeypatch.setattr(effects, "CATALOGUE", dict(effects.CATALOGUE))
        path = tmp_path / "found_effects.py"
        path.write_text(LAW.text(path.name).replace(old, new))
        assert effects.load_effects(path) == (LAW.name,)
        return effects.catalogue()[LAW.name]

    return bring


def test_the_class_has_the_torque_the_equation_and_the_source(loaded):
    kind = loaded()
    effect = kind("elbow")
    assert effect.label == LAW.label
    assert effect.equation == LAW.equation
    assert effect.source == LAW.source
    torque = effect.joint_torque(JointMotion(0.0, 0.0, 0.8, 1.0, (), 0.0))
    assert float(torque) == pytest.approx(0.25 * 2**5)


def test_step_3_asks_whether_it_is_of_the_bearings_or_of_the_joint(loaded):
    loaded()
    t = np.arange(100) * 0.01
    still = Recording.from_arrays(t, np.zeros((100, 2)), noise=1e-3)
    arm = ArmTable((0.4, 0.4), 1.2, 0.6, 1.4)
    experiment = Experiment(arm, (still,), [Bearing("elbow", 0.1, 1e-3)])
    asks = r"bearings or of the joint.*found_effects\.py"
    with pytest.raises(InputError, match=asks):
        residyn.unload(experiment, effects=[LAW.label])
    with pytest.raises(InputError, match=asks):  # in a diagnosis it may join
        check_unload(experiment, diagnosed=True)
    check_unload(experiment)


@pytest.mark.parametrize("answer", [True, False])
def test_what_the_file_answers_is_what_step_3_does(loaded, answer):
    kind = loaded("of_bearings = None", f"of_bearings = {answer}")
    arm = residyn.PlanarArm((0.4, 0.4), 1.2, 0.6, 1.4)
    model = residyn.Model(arm, (residyn.Spring("elbow", 9.0), kind("elbow")))
    left = without_effects_of_bearings(model).labels
    assert (LAW.label in left) is not answer

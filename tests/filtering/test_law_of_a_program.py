"""What a compiled program holds: the laws of a catalogue, whichever of them a model has."""

from residyn import effects
from residyn.effects.own_numbers import with_own
from residyn.filtering.law import catalogue_on, laws_for
from residyn.physics.mechanism import ConstantInertia

CART = ConstantInertia([[1.5]], ("cart",), ("m",))


def test_models_whose_effects_have_numbers_of_a_runs_own_share_one_program():
    """Else each candidate of a diagnosis would be compiled by itself."""
    own = with_own(effects.SensorOffset("cart"), [(1, "a")])
    catalogued = catalogue_on(CART)
    each = [laws_for([own, *more], catalogued) for more in ((), (effects.CoulombFriction("cart"),))]
    assert each[0] == each[1]
    assert set(laws_for([], catalogued).names) == set(each[0].names)

"""What a compiled program holds: the laws of a catalogue, whichever of them a model has."""

from residyn import effects
from residyn.effects.own_numbers import with_own
from residyn.filtering.law import catalogue_on, laws_for
from residyn.physics.mechanism import ConstantInertia

CART = ConstantInertia([[1.5]], ("cart",), ("m",))
OWN = with_own(effects.SensorOffset("cart"), [(1, "a")])


def test_models_that_have_an_effect_of_no_catalogue_share_one_program():
    """Else each candidate of a diagnosis would be compiled by itself."""
    catalogued = catalogue_on(CART)
    models = [OWN], [OWN, effects.CoulombFriction("cart")]
    one, other = (laws_for(each, catalogued, [OWN.label]) for each in models)
    assert one == other
    assert set(laws_for([], catalogued).names) == set(one.names)


def test_a_model_of_no_search_has_a_program_without_the_catalogue():
    assert laws_for([OWN], catalogue_on(CART)).names == ()

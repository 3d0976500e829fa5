"""What a compiled program holds: the laws of a catalogue, whichever of them a model has."""

import numpy as np

from residyn import effects
from residyn.effects.own_numbers import with_own
from residyn.filtering.law import catalogue_on, each_number, laws_for, tabulated
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


def test_the_order_of_a_models_effects_makes_no_other_program():
    other = with_own(effects.SensorOffset("other"), [(1, "a")])
    both = [OWN, other], [other, OWN]
    assert laws_for(both[0]) == laws_for(both[1])


def test_what_a_search_adds_at_one_joint_has_room_from_the_first():
    base = [effects.Spring("cart"), effects.Damper("cart")]
    added = [effects.CoulombFriction("cart"), effects.CubicStiffness("cart")]
    added += [effects.QuadraticDrag("cart")]
    shapes = []
    for members in (base, base + added):
        values = np.zeros(len(each_number(members)))
        laws = laws_for(base + added)
        table = tabulated(laws, members, CART.joints, values, values, 2)
        shapes.append(table.joint.law.shape)
    assert shapes[0] == shapes[1]


def test_a_model_of_no_search_has_a_program_without_the_catalogue():
    assert laws_for([OWN], catalogue_on(CART)).names == ()

"""Does anything hold the motion where it is? If not, long recordings are fitted in stretches.

A joint with a spring comes back: the error of a simulated swing stays of the size of the swing. A
driven joint without one integrates every newton that the model misses, twice, over the whole
recording; such a fit hears of nothing but the slowest part of what is missing, and sits in wrong
valleys besides. Its rate is forgotten within a time constant (inertia over damping). So that is how
long a stretch is: then what is missing shows as what it is, a torque, at the instant at which it
acts. Each stretch begins with a state of its own.
"""

import dataclasses

import numpy as np

from ..physics.modal import concrete_state_matrix, modes_of
from ..physics.model import Model
from ..recordings.experiment import Experiment
from ..recordings.recording import Recording
from ..recordings.segments import segments_of

_CYCLES = 1.0  # of a mode in the recording: fewer, and it holds nothing in place
_SAMPLES = 40  # of a stretch, at least
_FEWEST = 8  # stretches: a recording that would not make so many is left as it is


def stretch_of(model: Model, recording: Recording) -> float | None:
    """How long the stretches are to be that a recording is cut into, s; None if it is to stay
    whole. `model` is about right: its modes decide."""
    driven = recording.drive is not None and bool(np.any(recording.drive))
    if not driven or recording.segment_of is not None:
        return None
    values = np.linalg.eigvals(np.asarray(concrete_state_matrix(model)))
    frequency, damping = (np.asarray(x) for x in modes_of(values))
    rings = (frequency * recording.duration > _CYCLES) & (np.abs(damping) < 1 - 1e-9)
    if rings.all():
        return None
    fades = -values.real[np.abs(values.imag) < 1e-9 * np.abs(values)]
    if not fades.size or fades.max() <= 0:
        return None
    # Slower modes of other joints must be seen to ring in a stretch, too.
    longest = max([1.0 / float(fades.max()), *(1.0 / frequency[rings])])
    least = _SAMPLES * float(np.median(np.diff(recording.time)))
    seconds = max(longest, least)
    return seconds if recording.duration > _FEWEST * seconds else None


def without_drift(experiment: Experiment, model: Model) -> Experiment:
    """The experiment with driven recordings of what nothing pulls back cut into stretches; itself
    if there are none."""
    found: list[Recording] = []
    for recording in experiment.recordings:
        seconds = None if recording.role == "inertia" else stretch_of(model, recording)
        if seconds is None:
            found.append(recording)
            continue
        doubt = (
            "driven, and nothing pulls it back: a simulation of the whole drifts away. It is "
            f"fitted in stretches of {seconds:.2g} s, each with an initial state of its own"
        )
        found += segments_of(recording.saying([doubt]), seconds)
    if len(found) == len(experiment.recordings):
        return experiment
    return dataclasses.replace(experiment, recordings=tuple(found))

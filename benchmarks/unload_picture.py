"""The picture of the decay put right: writes docs/images/unload.svg.

    python -m benchmarks.unload_picture                     diagnose, then unload
    python -m benchmarks.unload_picture EFFECT [EFFECT...]  unload with these

The rig of `paper_tables drag`: bearings with drag and friction, two elbow angles. Above, a
recording on the bearings as two models fit it; below, the same arm without bearings as both predict
it. Nothing was fitted to the lower one but the state in which it begins.
"""

from __future__ import annotations

import sys
from pathlib import Path

import jax
import numpy as np
from matplotlib.figure import Figure

import residyn
from benchmarks import _unloading
from residyn.reporting.figures.style import MEASURED, MODEL, RESIDUAL, WIDE, styled
from tests.rig.arm import paper_twin

IMAGE = Path(__file__).parents[1] / "docs/images/unload.svg"
SHOULDER = 0


def main(effects: list[str]) -> None:
    """Unload twice, draw, and say what was drawn."""
    experiment = _unloading.dragged()
    named = effects or residyn.diagnose(_unloading.fitted_only(experiment)).added
    viscous, right = (residyn.unload(experiment, effects=e) for e in ((), named))
    print(viscous, right, sep="\n\n")
    figure = picture(viscous, right)
    figure.savefig(IMAGE, facecolor="white", bbox_inches="tight", metadata={"Date": None})


@styled
def picture(viscous: residyn.Unloading, right: residyn.Unloading) -> Figure:
    """The shoulder at the first elbow angle: fitted on bearings, predicted without."""
    figure = Figure(figsize=(WIDE, 4.6), layout="constrained")
    fitted, predicted = figure.subplots(2, 1, sharex=True)
    recording = right.fit.recordings[0].recording
    fitted.set_title("On its air bearings: fitted")
    _measured(fitted, recording)
    for found, colour in ((viscous, RESIDUAL), (right, MODEL)):
        fitted.plot(recording.time, found.fit.recordings[0].predicted[:, SHOULDER], color=colour)
    # Both predictions from one state, as in orbit: the one that suits the recording best.
    check = right.check[0]
    recording = check.beside.recording
    predicted.set_title("Without bearings: predicted")
    _measured(predicted, recording)
    names = (
        "springs and dampers; bearings' inertia off",
        f"with {' and '.join(right.left_out)}; all of the bearings off",
    )
    for found, colour, name in zip((viscous, right), (RESIDUAL, MODEL), names, strict=True):
        with jax.enable_x64(True):
            state = check.beside.state
            motion = residyn.simulate(found.unloaded, recording.time, state[:2], state[2:4])
        wrong = _unloading.errors_in_orbit(found.without_bearings[0], paper_twin(recording.theta2))
        label = f"{name}: decay rate {_size(wrong[1])} off"
        predicted.plot(recording.time, np.asarray(motion.q)[:, SHOULDER], color=colour, label=label)
    for ax in (fitted, predicted):
        ax.set_ylabel("shoulder (rad)")
        ax.margins(x=0)
        for line in ax.lines[1:]:
            line.set_linewidth(1.1)
    predicted.set_xlabel("time (s)")
    figure.legend(*predicted.get_legend_handles_labels(), loc="outside upper left")
    return figure


def _measured(ax, recording: residyn.Recording) -> None:
    angle = recording.angle[:, SHOULDER]
    ax.plot(recording.time, angle, color=MEASURED, lw=3.2, label="measured (MuJoCo)")


def _size(share: float) -> str:
    return f"{100 * abs(share):.2g} %" if abs(share) < 0.995 else f"{100 * abs(share):.0f} %"


if __name__ == "__main__":
    main(sys.argv[1:])

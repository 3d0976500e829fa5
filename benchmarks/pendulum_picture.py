"""The picture of the measured pendulum: writes docs/images/pendulum.svg.

    python -m benchmarks.pendulum_picture [EFFECT...]    air_drag, if none is given

The shipped example (`residyn example FOLDER pendulum`): gravity and viscous joints, its authors'
model, fitted to 5 s and carried on for 7 more; beside it the same with the effects.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import residyn
from residyn.reporting.figures.style import MEASURED, MODEL, RESIDUAL, WIDE, styled

ROOT = Path(__file__).parents[1]
IMAGE = ROOT / "docs/images/pendulum.svg"
EXAMPLE = ROOT / "src/residyn/data/pendulum/pendulum.toml"
ELBOW = 1


def main(effects: list[str]) -> None:
    """Fit twice, draw, and say what was drawn."""
    experiment = residyn.load(EXAMPLE)
    base = residyn.fit(experiment, effects=["gravity"])
    full = residyn.fit(experiment, effects=["gravity", *effects])
    print(base, full, sep="\n\n")
    figure = picture(base, full, effects)
    figure.savefig(IMAGE, facecolor="white", bbox_inches="tight", metadata={"Date": None})


@styled
def picture(base: residyn.Fit, full: residyn.Fit, effects: list[str]) -> Figure:
    """The elbow as measured and predicted, and what is left of it, fitted and carried on."""
    figure = Figure(figsize=(WIDE, 4.6), layout="constrained")
    angle, left = figure.subplots(2, 1, sharex=True)
    for beside in full.recordings:
        r = beside.recording
        angle.plot(r.time, r.angle[:, ELBOW], color=MEASURED, lw=3.2, label="measured")
    names = "gravity, viscous joints", f"with {' and '.join(effects).replace('_', ' ')}"
    for fit, colour, name in zip((base, full), (RESIDUAL, MODEL), names, strict=True):
        errors = " and ".join(
            f"{1e3 * np.sqrt(np.nanmean(b.residual**2)):.2g} mrad {words}"
            for b, words in zip(fit.recordings, ("fitted", "later"), strict=True)
        )
        for beside in fit.recordings:
            r = beside.recording
            angle.plot(r.time, beside.predicted[:, ELBOW], color=colour, lw=1.1)
            left.plot(r.time, 1e3 * beside.residual[:, ELBOW], color=colour, lw=0.9,
                      label=f"{name}: {errors}")  # fmt: skip
    for ax in (angle, left):
        ax.axvline(full.recordings[1].recording.time[0], color="0.6", lw=0.8, ls=":")
        ax.margins(x=0)
    angle.set_title(
        "A measured double pendulum: fitted to the left of the line, predicted after it"
    )
    angle.set_ylabel("elbow (rad)")
    left.set_ylabel("what is left (mrad)")
    left.set_xlabel("time (s)")
    lines = {text: line for ax in (angle, left)
             for line, text in zip(*ax.get_legend_handles_labels(), strict=True)}  # fmt: skip
    figure.legend([*lines.values()], [*lines], loc="outside upper left")
    return figure


if __name__ == "__main__":
    main(sys.argv[1:] or ["air_drag"])

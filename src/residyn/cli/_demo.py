"""`residyn demo`."""

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING

from .._units import amount, ratio
from . import _options
from ._experiment import fitted
from ._shell import NoNumbers, Outputs, progress, set_up_jax

if TYPE_CHECKING:
    from rich.console import Console

    from .._verdict import JointError
    from ..fitting.result import Fit

_REPORT = "residyn-demo.html"
_TEXT = 88
_BAR = 16
"""Letters of the longest bar of the table by time window."""


def demo(
    json: _options.Json = None,
    report: _options.Report = _REPORT,
    no_cache: _options.NoCache = False,
) -> None:
    """A shipped recording with a hidden effect; needs no files."""
    out = Outputs(json, report or _REPORT)
    set_up_jax(not no_cache)
    with progress() as say:
        say("loading")
        from .. import _verdict, recording
        from .. import demo as shipped

        with shipped.experiment_file() as path:
            experiment = recording.load(path)
    words = out.words
    _opening(words)

    words.print("1. Springs and dampers alone, the model of the paper\n", style="bold")
    base = fitted(experiment, (), _options.STARTS)
    words.print(str(base), soft_wrap=True)
    errors = _verdict.joint_errors(base)
    words.print("\nThe curves lie on each other, nearly. But what is left is not noise:\n")
    _windows(words, base)

    words.print(f"2. The same with {shipped.HIDDEN}\n", style="bold")
    full = fitted(experiment, (shipped.HIDDEN,), _options.STARTS)
    words.print(str(full), soft_wrap=True)
    words.print()

    words.print("3. Side by side\n", style="bold")
    names = ("springs and dampers", f"with {shipped.HIDDEN}")
    _comparison(words, names, (errors, _verdict.joint_errors(full)))
    out.write_json(full.to_dict())
    out.write_report(list(zip(names, (base, full), strict=True)))
    words.print(f"\nReport with pictures: {Path(out.report or _REPORT).resolve()}", soft_wrap=True)
    if not (base.converged and full.converged):
        raise NoNumbers("the demo's fit did not settle")


def _opening(words: "Console") -> None:
    what = (
        "Two releases of a braked two-joint arm on an air-bearing table, 20 s each at 100 Hz with "
        "1 mrad of noise: one to fit, one held out. A simulator that is no part of this package "
        "made them, with one effect hidden in the elbow that is neither a spring nor a damper."
    )
    words.print(textwrap.fill(what, min(words.width, _TEXT)), end="\n\n")


def _windows(words: "Console", fit: "Fit") -> None:
    """The residual of the first recording along time, in units of the noise."""
    from rich.table import Table

    from ..demo import by_window

    edges, sizes = by_window(fit.recordings[0])
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column("time", justify="right", no_wrap=True)
    for joint in fit.experiment.joints:
        table.add_column(f"{joint}: rms residual / noise", no_wrap=True)
    unit = _BAR / sizes[sizes == sizes].max()
    for start, stop, row in zip(edges, edges[1:], sizes, strict=False):
        bars = (f"{ratio(size):>4} {'█' * max(1, round(size * unit))}" for size in row)
        table.add_row(f"{start:.1f}-{stop:.1f} s", *bars)
    words.print(table)
    words.print("\nNoise alone would leave 1.0 in every window.\n")


def _comparison(
    words: "Console", names: tuple[str, ...], models: "tuple[list[JointError], ...]"
) -> None:
    from rich.table import Table

    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column("rms residual (x noise)", no_wrap=True)
    table.add_column("recording", no_wrap=True)
    for error in models[0]:
        table.add_column(error.joint, no_wrap=True)
    for name, errors in zip(names, models, strict=True):
        fitted = [_cell(e.rmse, e.ratio, e) for e in errors]
        table.add_row(name, "fitted", *fitted)
        table.add_row("", "held out", *[_cell(e.check, e.check_ratio, e) for e in errors])
    noise = [f"{amount(e.noise, e.unit)} (1.0 x)" for e in models[0]]
    table.add_row("noise of a reading", "", *noise)
    words.print(table)


def _cell(error: float | None, times: float | None, joint: "JointError") -> str:
    if error is None or times is None:
        return ""
    return f"{amount(error, joint.unit)} ({ratio(times)} x)"

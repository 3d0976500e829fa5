"""`residyn demo`."""

from typing import TYPE_CHECKING

from .. import reporting
from ..reporting.numbers import times
from . import _options
from ._shell import progress, set_up_jax
from ._work import Work, computing, models, must_stand

if TYPE_CHECKING:
    from rich.console import Console

    from ..fitting.result import Fit

_REPORT = "residyn-demo.html"
_BAR = 16  # letters of the longest bar of the table by time window


def demo(
    json: _options.Json = None,
    report: _options.Report = _REPORT,
    no_cache: _options.NoCache = False,
) -> None:
    """Find what is hidden in a shipped recording: the whole loop. It needs no files."""
    out = Work(json, report or _REPORT)
    set_up_jax(not no_cache)
    with progress("loading"):
        from .. import demo as shipped
        from ..recordings.experiment import load
        from ..reporting import diagnosis as text
        from ..reporting.layout import filled

        with shipped.experiment_file() as path:
            experiment = load(path)
    words = out.words
    intro = (
        "Two releases of a braked two-joint arm on an air-bearing table, 20 s each at 100 Hz with "
        "1 mrad of noise: one to fit, one held out. A simulator that is no part of this package "
        "made them, with something hidden in the arm that is neither a spring nor a damper."
    )
    words.print("\n".join(filled(intro)), end="\n\n", soft_wrap=True)

    words.print("1. Springs and dampers alone, the model of the paper\n", style="bold")
    with computing() as say:
        from ..fitting import fit

        base = fit(experiment, starts=_options.STARTS, progress=say)
    words.print(str(base), soft_wrap=True)
    words.print("\nThe curves lie on each other, nearly. But what is left is not noise:\n")
    _windows(words, base)

    words.print("2. What is missing?\n", style="bold")
    with computing() as say:
        from ..diagnosis import diagnose

        found = diagnose(experiment, starts=_options.STARTS, progress=say)
    told = [*filled(" ".join(found.words)), "", *text.candidates(found)]
    told += [*text.lookalikes(found), *text.next_experiment(found)]
    words.print("\n".join(told), soft_wrap=True)

    if found.added:
        words.print(f"\n3. With {' and '.join(found.added)}\n", style="bold")
        words.print(str(found.fit), soft_wrap=True)

    words.print("\n4. The error falling\n", style="bold")
    words.print("\n".join(text.models(found)), soft_wrap=True)
    # Nothing above has looked at what was hidden.
    named, hidden = " and ".join(found.added) or "nothing", shipped.HIDDEN
    right = " Right." * (found.added == (hidden,))
    words.print(f"\nNamed: {named}. Hidden was: {hidden}.{right}\n")
    out.write(found, lambda path: reporting.write_report(path, models(found), diagnosis=found))
    must_stand(found.fit)


def _windows(words: "Console", fit: "Fit") -> None:
    """The residual along time, in units of the noise."""
    from ..diagnosis.linearised_fit import predictions
    from ..diagnosis.residuals import where
    from ..reporting.layout import Table, printed

    windows = where(fit, predictions(fit, fit.unknowns)[1]).time
    head, rows = ["time", *(f"{joint}: rms residual / noise" for joint in fit.joints)], []
    unit = _BAR / max(cell.ratio for window in windows for cell in window.cells)
    for start, stop, cells in (window[1:] for window in windows):
        bars = (f"{times(c.ratio):>4} {'█' * max(1, round(c.ratio * unit))}" for c in cells)
        rows.append([f"{start:.1f}-{stop:.1f} s", *bars])
    table = Table(head, rows, left=range(1, len(head)))
    words.print("\n".join(printed(table, indent=0)), soft_wrap=True)
    words.print("\nNoise alone would leave 1.0 in every window.\n")

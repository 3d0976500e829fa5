"""`compare`, `diagnose` and `plan`: what the model misses, and what to measure next."""

from typing import Annotated

from .. import reporting
from . import _options
from ._shell import INTERRUPTED, NoNumbers
from ._work import Work, computing, models, must_stand, title


def compare(
    experiment: _options.Experiment,
    effects: _options.With = None,
    own: _options.Effects = None,
    starts: _options.Starts = _options.STARTS,
    json: _options.Json = None,
    report: _options.Report = None,
    no_cache: _options.NoCache = False,
) -> None:
    """Fit, and say where the model fails. When, at what swing, and at what frequency."""
    out = Work(json, report)
    loaded = out.begin(experiment, own, no_cache, named={"--with": effects or []})
    with computing() as say:
        from ..diagnosis import compare_fit
        from ..fitting import fit

        fitted = fit(loaded, effects=effects or [], starts=starts, progress=say)
        result = compare_fit(fitted, say)
    fits = [(title(experiment), fitted)]
    out.give(result, lambda path: reporting.write_report(path, fits, compared=result))
    must_stand(fitted)


def diagnose(
    experiment: _options.Experiment,
    effects: _options.With = None,
    most: _options.MaxEffects = _options.MAX_EFFECTS,
    own: _options.Effects = None,
    starts: _options.Starts = _options.STARTS,
    budget: _options.Budget = None,
    json: _options.Json = None,
    report: _options.Report = None,
    table: _options.Table = None,
    found_file: _options.Found = None,
    no_cache: _options.NoCache = False,
) -> None:
    """Name the effect that is missing, add it, and see the error fall."""
    out = Work(json, report, table, found_file)
    loaded = out.begin(experiment, own, no_cache, named={"--with": effects or []})
    how = {"effects": effects or [], "max_effects": most, "starts": starts, "budget": budget}
    with computing() as say:
        from ..diagnosis import diagnose

        found = diagnose(loaded, **how, progress=say)
    fits = models(found, title(experiment))
    out.give(found, lambda path: reporting.write_report(path, fits, diagnosis=found))
    if found.budget.stopped == "interrupted":
        raise NoNumbers("interrupted: the best so far is above", INTERRUPTED)
    must_stand(found.fit)


def plan(
    experiment: _options.Experiment,
    effects: _options.With = None,
    tests: Annotated[int, _options.number("--tests K", "How many tests to plan.", least=1)] = 3,
    most: _options.MaxEffects = _options.MAX_EFFECTS,
    own: _options.Effects = None,
    starts: _options.Starts = _options.STARTS,
    budget: _options.Budget = None,
    json: _options.Json = None,
    no_cache: _options.NoCache = False,
) -> None:
    """Plan the next tests, within [limits]. Each says what its outcomes would mean."""
    out = Work(json)
    loaded = out.begin(experiment, own, no_cache, named={"--with": effects or []})
    how = {"effects": effects or [], "max_effects": most, "starts": starts, "budget": budget}
    with computing() as say:
        from ..diagnosis import diagnose
        from ..diagnosis import plan as planned

        found = diagnose(loaded, **how, progress=say)
        result = planned(found, tests=tests, progress=say)
    out.give(result)
    if found.budget.stopped == "interrupted":
        raise NoNumbers("interrupted: planned from the best so far", INTERRUPTED)
    must_stand(found.fit)

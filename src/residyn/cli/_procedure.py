"""`residyn inertia` and `residyn unload`: steps 1 and 3 of the paper, around the fit."""

from typing import Annotated

from .. import reporting
from ..errors import InputError, inside
from . import _options
from ._shell import INTERRUPTED, NoNumbers
from ._work import Work, computing, floats_of, must_stand, title


def inertia(
    experiment: _options.Experiment,
    json: _options.Json = None,
    report: _options.Report = None,
    no_cache: _options.NoCache = False,
) -> None:
    """Find the arm's inertias from driven tests. The [arm] table is printed too."""
    out = Work(json, report)
    loaded = out.begin(experiment, None, no_cache)
    with computing() as say, inside(experiment):
        from .. import procedure

        say("solving Eq. 10 and 11")
        result = procedure.inertia(loaded)
    out.give(result, lambda path: reporting.write_page(path, result, title(experiment)))
    if result.problem is not None:
        raise NoNumbers(result.problem)
    out.words.print(f"\n{result.to_toml()}", soft_wrap=True, end="")


def unload(
    experiment: _options.Experiment,
    effects: _options.With = None,
    own: _options.Effects = None,
    starts: _options.Starts = _options.STARTS,
    inertia_std: Annotated[
        str | None,
        _options.option(
            "--inertia-std A,B,C",
            "Standard errors of shoulder, elbow (kg m^2) and coupling (kg m) from step 1, to "
            'carry over. Recordings with role = "inertia" give them too.',
        ),
    ] = None,
    diagnose: Annotated[
        bool,
        _options.option(
            "--diagnose",
            "Diagnose first: the modes without bearings over all models that the recordings "
            "leave in play, with their probabilities.",
        ),
    ] = False,
    most: _options.MaxEffects = _options.MAX_EFFECTS,
    budget: _options.Budget = None,
    json: _options.Json = None,
    report: _options.Report = None,
    no_cache: _options.NoCache = False,
) -> None:
    """Take the air bearings off: how the arm rings in orbit. Their drag and friction leave too."""
    if not diagnose and (most != _options.MAX_EFFECTS or budget is not None):
        raise InputError("--max-effects and --budget go with --diagnose")
    out = Work(json, report)
    names = "shoulder (kg m^2)", "elbow (kg m^2)", "coupling (kg m)"
    std = None if inertia_std is None else floats_of("--inertia-std", inertia_std, names, least=0)
    loaded = out.begin(experiment, own, no_cache, named={"--with": effects or []})
    how = {"effects": effects or [], "starts": starts}
    with computing() as say, inside(experiment):
        from .. import diagnosis, procedure

        first = None
        if diagnose:
            procedure.check_unload(loaded, effects or [], std, diagnosed=True)
            first = diagnosis.diagnose(loaded, **how, max_effects=most, budget=budget, progress=say)
        found = procedure.unload(loaded, **how, inertia_std=std, diagnosis=first, progress=say)
    out.words.print(str(found.fit), soft_wrap=True)
    out.give(found, lambda path: reporting.write_page(path, found, title(experiment)))
    if first is not None and first.budget.stopped == "interrupted":
        raise NoNumbers("interrupted: over the models that were tried so far", INTERRUPTED)
    if found.fit.stands and not found.physical:
        raise NoNumbers(found.unphysical[0])
    must_stand(found.fit)

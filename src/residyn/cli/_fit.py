"""`residyn fit`, of one experiment or of every one in a folder."""

import contextlib
import json as json_
import multiprocessing
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING

from .. import reporting
from ..errors import InputError, inside
from ..reporting.numbers import plain, times, with_error
from ..runtime.json import finite
from . import _options
from ._shell import NoNumbers, progress, set_up_jax, tell, work_begins
from ._work import Work, bring, computing, must_stand, title

if TYPE_CHECKING:
    from ..fitting.batch import Each

_WORTH = 64
"""Experiments for each of several processes: one starts in the time of some forty fits."""
NOTHING = "nothing"
"""Of --against: no effect, springs and dampers alone."""


def fit(
    experiment: _options.OneExperiment = None,
    each: _options.Each = None,
    jobs: _options.Jobs = None,
    effects: _options.With = None,
    against: _options.Against = None,
    own: _options.Effects = None,
    starts: _options.Starts = _options.STARTS,
    method: _options.Method = _options.METHODS[0],
    integrator: _options.Integrator = None,
    check_integration: _options.CheckIntegration = False,
    seed: _options.Seed = 0,
    json: _options.Json = None,
    report: _options.Report = None,
    table: _options.Table = None,
    no_cache: _options.NoCache = False,
) -> None:
    """Fit springs, dampers and other effects to recordings."""
    _options.must_be_method("--method", method)
    if method not in _options.DESCENTS and starts != _options.STARTS:
        raise InputError(
            "--starts goes with --method levenberg or random; what else there is has no starts"
        )
    if method not in _options.SEEDED and seed != 0:
        raise InputError(f"--seed goes with a --method that draws; {method} does not")
    if each is not None:
        others = {
            "EXPERIMENT": experiment,
            "--report": report,
            "--table": table,
            "--against": against,
            "--integrator": integrator,
            "--method": method != _options.METHODS[0] or None,
            "--check-integration": check_integration or None,
        }
        wrong = [name for name, value in others.items() if value is not None]
        if wrong:
            raise InputError(f"--each {each} does not go with {', '.join(wrong)}")
        bring(own)
        return _fit_each(each, effects or [], own, starts, json, no_cache, jobs)
    if jobs is not None:
        raise InputError(f"--jobs {jobs} goes with --each FOLDER")
    if against is not None and table is not None:
        raise InputError("--table is of one model; it goes without --against")
    if experiment is None:
        raise InputError("an EXPERIMENT is needed, a TOML file, or --each FOLDER")
    out = Work(json, report, table)
    given = {"--with": effects or [], "--against": [e for e in against or [] if e != NOTHING]}
    loaded = out.begin(experiment, own, no_cache, integrator, given)
    both = list(given.values())[: 1 if against is None else 2]
    if against is not None:
        with computing():
            from ..fitting.problem import ready

            one, other = (set(ready(loaded, loaded.fit_recordings, x).model.labels) for x in both)
        if one == other:
            raise InputError(
                f"--against {' '.join(against)}: is the model that it would stand beside; name "
                "other effects than those of --with"
            )
    how = {"starts": starts, "method": method, "check_integration": check_integration}
    if seed:
        how["seed"] = seed
    with computing() as say:
        from ..fitting import fit

        fits = [fit(loaded, effects=names, progress=say, **how) for names in both]
    if against is not None:
        from ..reporting.side_by_side import SideBySide, headings

        found = SideBySide(*fits)
        out.give(found, lambda path: reporting.write_report(path, headings(found)))
        for name, one in zip("AB", fits, strict=True):
            must_stand(one, f"{name}: ")
        return
    result = fits[0]
    out.words.print(str(result), soft_wrap=True)
    if result.misses:
        out.words.print(
            f"the model misses something: residyn diagnose {experiment}", soft_wrap=True
        )
    headed = [(title(experiment), result)]
    out.write(result, lambda path: reporting.write_report(path, headed))
    must_stand(result)


def _fit_each(
    folder: str,
    effects: Sequence[str],
    own: Sequence[str] | None,
    starts: int,
    json: str | None,
    no_cache: bool,
    jobs: int | None,
) -> None:
    """Fit every experiment of a folder, a line each as it is done, in `jobs` processes; as many as
    there are cores, if each has as many experiments as pay for its start."""
    if not Path(folder).is_dir():
        raise InputError(f"--each {folder}: there is no such folder")
    files = sorted(str(file) for file in Path(folder).glob("*.toml"))
    if not files:
        raise InputError(f"--each {folder}: no experiment in it; must hold files that end in .toml")
    out = Work(json)
    out.spare([Path(file) for file in (*files, *(own or ()))])
    set_up_jax(not no_cache)
    from ..runtime.parallel import cores

    jobs = jobs or max(1, min(cores(), len(files) // _WORTH))
    to_terminal, bad = json == "-", 0
    with progress() as say, _workers(min(jobs, len(files)), own, not no_cache) as executor:
        from ..effects import kind_named
        from ..fitting import fit_many

        work_begins()
        with inside("--with"):  # of no file's making, so that it is no file's error
            for words in effects:
                kind_named(words)
        how = {"effects": effects, "starts": starts, "progress": say, "executor": executor}
        for each in fit_many(files, out=None if to_terminal else json, **how):
            for line in each.told.get("understood", ()):
                tell(f"{Path(each.name).name}: {line}")
            out.words.print(_line(each), soft_wrap=True)
            if to_terminal:
                print(json_.dumps(finite(each.told), allow_nan=False), flush=True)
            bad += not each.told.get("stands") or bool(each.told["unphysical"])
    if bad:
        raise NoNumbers(
            f"{bad} of {len(files)} experiments could not be fitted, did not settle or are not "
            "physical"
        )


@contextlib.contextmanager
def _workers(
    jobs: int, own: Sequence[str] | None, cache: bool
) -> Iterator[ProcessPoolExecutor | None]:
    """So many processes; none for one job, which this process does itself."""
    if jobs == 1:
        yield None
        return
    pool = ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn"), _prepare, (own, cache))
    try:
        yield pool
    finally:  # whoever interrupts does not want to wait for what is still to do
        pool.shutdown(cancel_futures=True)


def _prepare(own: Sequence[str] | None, cache: bool) -> None:
    from ..effects import load_effects

    set_up_jax(cache)
    for file in own or ():
        load_effects(file)


def _line(each: "Each") -> str:
    name, told = Path(each.name).name, each.told
    if "error" in told:
        return f"{name}: {told['error']}"
    numbers = ", ".join(f"{k} = {_number(v)}" for k, v in told["parameters"].items())
    before = " (done before)" if each.before else ""
    settled = "" if told["stands"] else ", not settled"
    settled += "".join(f", {name} negative, which is not physical" for name in told["unphysical"])
    error = ", ".join(
        f"{joint} {times(ratio)} x noise"
        for joint, ratio in told["ratio"].items()
        if ratio is not None
    )
    chi2 = told["reduced_chi2"]
    chi2 = "?" if chi2 is None else plain(chi2, 3)
    return f"{name}: {numbers}; rms error {error}; reduced chi2 {chi2}{settled}{before}"


def _number(number: dict[str, float | None]) -> str:
    value, std = number["value"], number["std"]
    if value is None or std is None:
        return f"{'?' if value is None else plain(value, 5)} (not determined)"
    return " +/- ".join(with_error(value, std))

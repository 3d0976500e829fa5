"""`residyn fit --each FOLDER`."""

import contextlib
import json as json_
import math
import multiprocessing
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from ..errors import InputError
from ..reporting.numbers import plain, with_error
from ..runtime.json import finite
from ._shell import DONE, NO_NUMBERS, Outputs, complain, progress, set_up_jax

if TYPE_CHECKING:
    from ..fitting.batch import Each


def fit_each(
    folder: str,
    effects: Sequence[str],
    own: Sequence[str] | None,
    starts: int,
    json: str | None,
    no_cache: bool,
    jobs: int,
) -> None:
    """Fit every experiment of a folder, a line each as it is done, in `jobs` processes.

    **Raises:** `InputError` for a folder without experiments, or a file of results that is none or
    cannot be written.
    """
    files = experiments_in(folder)
    out = Outputs(json, None)
    out.spare([Path(file) for file in files])
    set_up_jax(not no_cache)
    lines = json == "-"
    bad = 0
    with progress() as say, _workers(min(jobs, len(files)), own, not no_cache) as executor:
        from ..fitting import fit_many

        to = None if lines else json
        every = fit_many(
            files, effects=effects, starts=starts, out=to, progress=say, executor=executor
        )
        for each in every:
            out.words.print(_line(each), soft_wrap=True)
            if lines:
                print(json_.dumps(finite(each.told), allow_nan=False), flush=True)
            bad += "error" in each.told
    if bad:
        of = f"{bad} of {len(files)} experiments"
        raise typer.Exit(complain(f"{of} could not be fitted", NO_NUMBERS))
    raise typer.Exit(DONE)


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


def experiments_in(folder: str) -> list[str]:
    """The TOML files in a folder, by name.

    **Raises:** `InputError` if there is no such folder, or none in it.
    """
    path = Path(folder)
    if not path.is_dir():
        raise InputError(f"--each {folder}: there is no such folder")
    files = sorted(str(file) for file in path.glob("*.toml"))
    if not files:
        raise InputError(f"--each {folder}: no experiment in it; must hold files that end in .toml")
    return files


def _line(each: "Each") -> str:
    name, told = Path(each.name).name, each.told
    if "error" in told:
        return f"{name}: {told['error']}"
    numbers = ", ".join(f"{k} = {_number(v)}" for k, v in told["parameters"].items())
    before = " (done before)" if each.before else ""
    settled = "" if told["converged"] else ", not settled"
    return f"{name}: {numbers}; reduced chi2 {told['reduced_chi2']:.3g}{settled}{before}"


def _number(number: dict[str, float | None]) -> str:
    value, std = number["value"], number["std"]
    if value is None or std is None:
        return f"{plain(math.nan if value is None else value, 5)} (not determined)"
    return " +/- ".join(with_error(value, std))

"""`residyn fit --each FOLDER`."""

import json as json_
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from .._input import InputError
from .._json import finite
from ._shell import DONE, NO_NUMBERS, Outputs, complain, progress, set_up_jax

if TYPE_CHECKING:
    from ..fitting.many import Each


def fit_each(
    folder: str, effects: Sequence[str], starts: int, json: str | None, no_cache: bool
) -> None:
    """Fit every experiment of a folder, a line each as it is done.

    **Raises:** `InputError` for a folder without experiments, or a file of results that is none or
    cannot be written.
    """
    files = experiments_in(folder)
    out = Outputs(json, None)
    out.spare([Path(file) for file in files])
    set_up_jax(not no_cache)
    lines = json == "-"
    bad = 0
    with progress() as say:
        from ..fitting import fit_many

        every = fit_many(
            files, effects=effects, starts=starts, out=None if lines else json, progress=say
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
    numbers = ", ".join(f"{k} = {v['value']:.5g}" for k, v in told["parameters"].items())
    before = " (done before)" if each.before else ""
    settled = "" if told["converged"] else ", not settled"
    return f"{name}: {numbers}; reduced chi2 {told['reduced_chi2']:.3g}{settled}{before}"

"""Many experiments, one after the other: what a laboratory has at the end of a day.

Compiled programs serve every experiment of the same model whose recordings have about the same
length, so all but the first fits are quick. Results are written as they come, a line each; a run
that was killed goes on where it stopped; one broken recording costs its own line and no other.
"""

import json
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from .._json import finite
from ..effects import AbstractEffect
from ..recording import Experiment, InputError, load
from .pipeline import DEFAULT_STARTS, fit
from .result import Fit, FitError


class Each(NamedTuple):
    """What became of one experiment."""

    name: str
    fit: Fit | None
    """None where there is none, or where it was done before."""
    told: dict[str, Any]
    """`name`, and the fit's `to_dict()` or, in one line, `error`."""
    before: bool = False
    """Whether it was read from the file of an earlier run."""


def fit_many(
    experiments: Iterable[str | os.PathLike[str] | Experiment],
    *,
    effects: Sequence[str | AbstractEffect] = (),
    starts: int = DEFAULT_STARTS,
    out: str | os.PathLike[str] | None = None,
    progress: Callable[[str], None] | None = None,
) -> Iterator[Each]:
    """Fit each of many experiments; an iterator, so that nothing is kept that nobody wants.

    **Arguments:**

    - `experiments`: TOML files, or experiments (told apart by their `path`, else their number).
    - `effects`, `starts`, `progress`: as of `residyn.fit`.
    - `out`: a file of JSON lines to add to. What stands in it already is not fitted again; what
      ended in an error there is. A last line that was cut short is taken out.

    **Yields:** an `Each` for every experiment, in order; bad input and fits that led nowhere are
    lines with an `error`, not exceptions.

    **Raises:** `InputError` if two experiments have the same name, or `out` holds something else.
    """
    named, seen = [], set()
    for index, one in enumerate(experiments):
        name = one.path or f"experiment {index + 1}" if isinstance(one, Experiment) else str(one)
        if name in seen:
            raise InputError(f"{name} is there twice: results could not be told apart")
        seen.add(name)
        named.append((name, one))
    done = {} if out is None else _done(Path(out))
    for count, (name, one) in enumerate(named, start=1):
        if name in done:
            yield Each(name, None, done[name], True)
            continue

        def say(words: str, at: str = f"{name} ({count} of {len(named)}): ") -> None:
            if progress is not None:
                progress(at + words)

        found, told = None, {"name": name}
        try:
            experiment = one if isinstance(one, Experiment) else load(one)
            found = fit(experiment, effects=effects, starts=starts, progress=say)
            told |= found.to_dict()
        except (InputError, FitError, ValueError) as error:
            told["error"] = str(error)
        if out is not None:
            with open(out, "a", encoding="utf-8") as file:
                file.write(json.dumps(finite(told)) + "\n")
        yield Each(name, found, told)


def _done(path: Path) -> dict[str, dict[str, Any]]:
    """The results that a file holds, by name; an unfinished last line is cut off."""
    if not path.exists():
        return {}
    found, good = {}, 0
    data = path.read_bytes()
    for number, line in enumerate(data.splitlines(keepends=True), start=1):
        try:
            told = json.loads(line)
            name = told["name"]
        except (ValueError, KeyError, TypeError):
            if number == data.count(b"\n") + 1:  # no newline: the run was killed while it wrote
                with path.open("r+b") as file:
                    file.truncate(good)
                break
            raise InputError(
                f"{path}: line {number}: no result of a fit; must be a file that an earlier run "
                "wrote, or a new one"
            ) from None
        good += len(line)
        if "error" not in told:
            found[name] = told
    return found

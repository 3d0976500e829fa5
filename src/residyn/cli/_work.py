"""What all commands do around their work: read an experiment, show progress, write results."""

import contextlib
import dataclasses
import itertools
import json
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError, inside, number
from ..files import check_writable, write
from ..runtime.json import finite
from ._shell import NoNumbers, console, progress, set_up_jax, tell, work_begins

if TYPE_CHECKING:
    from rich.console import Console

    from ..diagnosis.result import Diagnosis
    from ..fitting.result import Fit
    from ..recordings.experiment import Experiment

_ENDINGS = {"--report": (".html", ".htm"), "--table": (".tex", ".csv"), "--found": (".py",)}


class Work:
    """Where the results of a command go. Made before the long work: a wrong path costs no wait."""

    def __init__(
        self,
        json_file: str | None = None,
        report: str | None = None,
        table: str | None = None,
        found: str | None = None,
    ):
        self.json_file, self.report, self.table, self.found = json_file, report, table, found
        given = {"--json": json_file, "--report": report, "--table": table, "--found": found}
        self._files = {option: path for option, path in given.items() if path is not None}
        for option, path in self._files.items():
            right = _ENDINGS.get(option)
            if right is not None and Path(path).suffix not in right:
                raise InputError(f"{option} {path}: must end in {' or '.join(right)}")
        written = [(option, path) for option, path in self._files.items() if path != "-"]
        for (one, path), (other, own) in itertools.combinations(written, 2):
            if _same(path, own):
                raise InputError(f"{other} and {one} are the same file, {own}")
        for option, path in written:
            with inside(option):
                check_writable(path)

    @property
    def words(self) -> "Console":
        """Standard output, unless that is for the JSON."""
        return console(stderr=self.json_file == "-")

    def begin(
        self,
        path: str,
        own: Sequence[str] | None,
        no_cache: bool,
        integrator: str | None = None,
        named: Mapping[str, Sequence[str]] | None = None,
    ) -> "Experiment":
        """Make JAX and the user's own effects ready, and read the experiment; `named`: by option,
        the effects that must go with it."""
        set_up_jax(not no_cache)
        bring(own)
        experiment = load(path)
        if integrator is not None:
            from ..simulation.integrator import Integrator

            with inside("--integrator"):
                experiment = dataclasses.replace(experiment, integrator=Integrator(integrator))
        self.spare(input_files(path, experiment, own))
        for option, effects in (named or {}).items():
            must_go_with(experiment, option, effects)
        return experiment

    def spare(self, inputs: Sequence[Path]) -> None:
        """Refuse to write over a file that was read."""
        for option, path in self._files.items():
            if any(_same(path, each) for each in inputs):
                raise InputError(f"{option} {path}: is an input of this experiment; choose another")

    def give(self, result: Any, page: Callable[[str], None] | None = None) -> None:
        """Print a result and write what was asked for; `page` writes the report to a path."""
        self.words.print(str(result), soft_wrap=True)
        self.write(result, page)

    def write(self, result: Any, page: Callable[[str], None] | None = None) -> None:
        """Write what was asked for, as `give`."""
        if self.json_file is not None:
            told = finite(result.to_dict())
            text = json.dumps(told, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
            if self.json_file == "-":
                sys.stdout.write(text)
                sys.stdout.flush()
            else:
                with inside("--json"):
                    write(self.json_file, text)
        if self.table is not None:
            text = result.to_latex() if Path(self.table).suffix == ".tex" else result.to_csv()
            with inside("--table"):
                write(self.table, text)
            self.words.print(f"table: {self.table}", soft_wrap=True)
        if self.found is not None:
            self._write_found(result, self.found)
        if self.report is not None and page is not None:
            with progress("writing the report"):
                page(self.report)
            self.words.print(f"report: {self.report}", soft_wrap=True)

    def _write_found(self, result: "Diagnosis", file: str) -> None:
        """Write the law without a name as an effect, if there is one."""
        law = next((law.found for law in result.laws if law.found is not None), None)
        if law is None:
            self.words.print(f"no law without a name was found: {file} is not written")
            return
        with inside("--found"):
            write(file, law.text(Path(file).name))
        self.words.print(f"law: {file} (--effects {file} --with {law.label})", soft_wrap=True)


def _same(one: str | Path, other: str | Path) -> bool:
    return os.path.realpath(one) == os.path.realpath(other)


@contextlib.contextmanager
def computing() -> Iterator[Callable[[str], None]]:
    """Progress while something is computed, and what cannot be computed as one complaint."""
    with progress("loading") as say, one_complaint():
        yield say


@contextlib.contextmanager
def one_complaint() -> Iterator[None]:
    """What cannot be computed, as the one line that the user reads: numbers that cannot be had, or
    effects that do not exist or go with the experiment, or an extra that is not installed."""
    from numpy.linalg import LinAlgError

    from ..fitting import FitError, MissingExtra

    work_begins()
    try:
        yield
    except FitError as error:
        raise NoNumbers(str(error)) from None
    except LinAlgError:  # a ValueError that no input is to blame for
        raise
    except (ValueError, MissingExtra) as error:
        raise InputError(str(error)) from None


def must_go_with(experiment: "Experiment", option: str, effects: Sequence[str]) -> None:
    """**Raises:** `InputError` for an effect that does not exist, or does not go with the
    experiment."""
    recordings = [r for r in experiment.recordings if r.role != "inertia"]
    if effects and recordings:
        with one_complaint(), inside(option):
            from ..fitting.problem import check_identifiable, mechanism_of, model_for, richest

            most = richest([mechanism_of(experiment, r) for r in recordings])
            check_identifiable(experiment.fit_recordings, model_for(most, effects).effects)


def must_stand(fit: "Fit", who: str = "") -> None:
    """What every command that ends in a fit does last.

    **Raises:** `NoNumbers` for a fit that did not settle or is not physical.
    """
    if not fit.stands:
        raise NoNumbers(f"{who}{fit.reason}")
    if fit.unphysical:
        names = ", ".join(n.name for n in fit.unphysical)
        raise NoNumbers(f"{who}{names}: negative, which is not physical")


def load(path: str) -> "Experiment":
    """Read the experiment, and say on standard error what was made of a lab's own files."""
    with progress("reading"):
        from ..recordings.experiment import load as read_experiment

        loaded = read_experiment(path)
    for line in loaded.understood:
        tell(line)
    return loaded


def bring(files: Sequence[str] | None) -> None:
    """Add the effects of users' files to the catalogue."""
    if files:
        with progress("loading"):
            from ..effects import load_effects

            for file in files:
                load_effects(file)


def input_files(path: str, experiment: "Experiment", own: Sequence[str] | None) -> list[Path]:
    """Every file that was read, so that none of them is written over."""
    named = [Path(file) for file in (path, *(own or ())) if file != "-"]
    return named + [Path(path).parent / r.name for r in experiment.recordings]


def float_of(key: str, words: str, least: float | None = None) -> float:
    """The number in these words, in SI units."""
    value: float | str = words
    with contextlib.suppress(ValueError):
        value = float(words)
    return number(key, value, "in SI units", least=least)


def floats_of(
    option: str, words: str, names: Sequence[str], least: float | None = None
) -> list[float]:
    """Numbers separated by commas, one for each of these names."""
    parts, count = words.split(","), len(names)
    if len(parts) != count:
        many = f"{count} numbers separated by commas" if count > 1 else "one number"
        raise InputError(f"{option} {words}: must be {many}, for {', '.join(names)}")
    return [float_of(option, part, least) for part in parts]


def title(path: str) -> str:
    """What to call an experiment at the head of a page."""
    return "Experiment from standard input" if path == "-" else Path(path).name


def models(found: "Diagnosis", title: str = "") -> "list[tuple[str, Fit]]":
    """The first and the last model of a diagnosis, each with a heading for the report."""
    from ..reporting.names import base_name

    fits = [found.base, found.fit] if found.added else [found.fit]
    return [(": ".join(filter(None, [title, base_name(fit)])), fit) for fit in fits]

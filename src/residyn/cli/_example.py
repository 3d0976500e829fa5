"""`residyn example` and `residyn new`: a first experiment, shipped or from one's own recordings."""

import os
from pathlib import Path
from typing import Annotated

from ..errors import InputError, quote
from ..files import write
from . import _options
from ._shell import console


def example(
    folder: Annotated[str, _options.argument("FOLDER", "Where to write it.")],
    name: Annotated[
        str,
        _options.argument(
            "[NAME]",
            "release (a hidden effect), driven (step 1), bearings (step 3) or pendulum (measured).",
        ),
    ] = "release",
) -> None:
    """Write a shipped example, ready to run."""
    from ..demo import EXAMPLES, write_example

    if name not in EXAMPLES:
        raise InputError(f"{quote(name)}: there is no such example; it is {', '.join(EXAMPLES)}")
    files = write_example(name, Path(folder))
    words = console()
    for file in files:
        words.print(str(file), soft_wrap=True)
    words.print(f"next: {EXAMPLES[name][2]} {files[0]}", soft_wrap=True)


def new(
    experiment: Annotated[str, _options.argument("EXPERIMENT.toml", "The file to write.")],
    recordings: Annotated[list[str], _options.argument("RECORDING.csv...", "What was recorded.")],
) -> None:
    """Write a first experiment file from recordings. What they cannot tell is marked "?"."""
    path = Path(experiment)
    if path.suffix != ".toml":
        raise InputError(f"{experiment}: the experiment comes first, and must end in .toml")
    if os.path.lexists(path):
        raise InputError(f"{experiment}: is there already; choose another name")
    from ..recordings.new_experiment import experiment_text

    text = experiment_text([Path(file) for file in recordings], path.parent)
    write(path, text)
    words = console()
    words.print(text, soft_wrap=True, end="")
    words.print(f'\nnext: fill in each "?" in {experiment}, then residyn diagnose {experiment}')

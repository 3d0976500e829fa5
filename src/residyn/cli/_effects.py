"""`residyn effects`."""

import inspect
import io
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from ..errors import InputError, inside
from ..files import check_writable, write
from . import _options
from ._shell import console, indented, progress
from ._work import Work, bring, computing

if TYPE_CHECKING:
    from rich.console import Console

    from ..effects import AbstractEffect
    from ..physics.parameter import Parameter

_ROOMY = 110  # columns of text from which the table has a column for everything


def effects(
    name: Annotated[
        str | None, _options.argument("NAME", "One effect, in full; all, if not given.")
    ] = None,
    plot: Annotated[
        str | None,
        _options.option(
            "--plot FILE", "Draw what the effect NAME does, to a file (.png, .svg or .pdf)."
        ),
    ] = None,
    experiment: Annotated[
        str | None,
        _options.option(
            "--detectable EXPERIMENT",
            "From which strength each effect would show in recordings like these, and be told "
            "from its rivals.",
        ),
    ] = None,
    own: _options.Effects = None,
    json: _options.Json = None,
    no_cache: _options.NoCache = False,
) -> None:
    """List the effects, or tell all of one. With --detectable: what recordings could show."""
    if experiment is not None:
        if name is not None or plot is not None:
            raise InputError("--detectable EXPERIMENT is about all effects: leave the rest out")
        out = Work(json)
        loaded = out.begin(experiment, own, no_cache)
        with computing() as say:
            from ..diagnosis.detectable import detectable

            say("smoothing the motion")
            found = detectable(loaded)
        return out.give(found)
    if json is not None:
        raise InputError("--json goes with --detectable EXPERIMENT")
    if plot is not None:
        if name is None:
            raise InputError("--plot draws one effect: residyn effects NAME --plot FILE")
        if Path(plot).suffix not in (".png", ".svg", ".pdf"):
            raise InputError(f"--plot {plot}: must end in .png, .svg or .pdf")
        with inside("--plot"):
            check_writable(plot)
    bring(own)
    with progress("loading"):
        from ..effects import catalogue, kind_named
    known = catalogue()
    out = console()
    if name is not None:
        name = name.partition(":")[0]
        _one(out, kind_named(name))
        if plot is not None:
            _draw(name, plot)
            out.print(f"picture: {plot}", soft_wrap=True)
    elif out.is_terminal:
        tabulate(out, list(known.values()))
        out.print("spring and damper are in every model; --with NAME adds another")
    else:  # one line each with tabs between cells, for grep, cut and friends
        print("name", "equation", "parameters", "looks like", sep="\t")
        for kind in known.values():
            print(kind.name, kind.equation, ", ".join(_numbers(kind)), kind.looks_like, sep="\t")


def _draw(name: str, file: str) -> None:
    with progress("drawing"):
        from ..reporting.figures import signature

        buffer = io.BytesIO()
        signature(name).savefig(buffer, dpi=150, format=Path(file).suffix[1:])
        with inside("--plot"):
            write(file, buffer.getvalue())


def _numbers(kind: "type[AbstractEffect]") -> list[str]:
    """Each parameter as `name (unit)`; both units where rotary and sliding joints differ."""
    from ..physics.parameter import parameters_of

    return [f"{p.name}{_unit(p)}" for p in parameters_of(kind)]


def _unit(parameter: "Parameter") -> str:
    unit = parameter.dimension.unit()
    return "" if unit == "1" else f" ({unit})"


def tabulate(out: "Console", kinds: "list[type[AbstractEffect]]") -> None:
    """For a terminal: a column for everything; where that is too narrow, the name, and all else
    below each other beside it."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    roomy = out.width >= _ROOMY
    table = Table(box=SIMPLE_HEAD, padding=(0, 2, 1, 0), pad_edge=False, expand=roomy)
    table.add_column("name", no_wrap=True, style="bold")
    heads = {"equation": 3, "parameters": 3, "what it looks like in the data": 4}
    for head, ratio in heads.items() if roomy else [(", ".join(heads), 1)]:
        table.add_column(head, ratio=ratio)
    for kind in kinds:
        cells = [kind.equation, "\n".join(_numbers(kind)), kind.looks_like]
        table.add_row(kind.name, *(cells if roomy else ["\n".join(filter(None, cells))]))
    out.print(table)


def _one(out: "Console", kind: "type[AbstractEffect]") -> None:
    from ..effects import JointEffect
    from ..physics.effect import BASE
    from ..physics.parameter import parameters_of

    numbers = []
    for p in parameters_of(kind):
        limits = ", never negative" if p.sign == "positive" else ""
        fixed = "" if p.fitted else ", not fitted"
        absent = "a shape" if p.silent is None else f"absent at {p.silent:g}"
        numbers.append(f"{p.name}{_unit(p)}: {p.words}{limits}{fixed}; {absent}")
    remembers = ", ".join(each.name for each in kind.memory)
    properties = {
        "never adds energy": kind.dissipates,
        "may add energy as well as take it": not kind.dissipates,
        "dry: lets a joint stick": kind.dry,
        f"remembers: {remembers}": kind.memory,
        "acts on the reading, not on the motion": kind.senses,
        "belongs to the air bearings: leaves when they are taken off": kind.of_bearings,
    }
    out.print(kind.name, style="bold")
    for part in inspect.cleandoc(kind.__doc__ or "").split("\n\n"):
        indented(out, " ".join(part.split()))
        out.print()
    for head, paragraphs in {
        "equation": [kind.equation],
        "parameters": numbers,
        "what it looks like in the data": [kind.looks_like],
        "properties": [words for words, true in properties.items() if true],
        "source": [kind.source],
    }.items():
        if any(paragraphs):
            out.print(head, style="bold")
        for words in filter(None, paragraphs):
            indented(out, words)
    if kind.name in BASE:
        out.print("in every model already")
    else:
        place = "[:JOINT]" if issubclass(kind, JointEffect) else ""
        out.print(f"residyn fit EXPERIMENT --with {kind.name}{place}")

"""Effects that users bring: from a Python file, or from an installed package.

A user's effect is a class like any of the catalogue's, and joins it: from then on it goes by its
name in every command. A package offers effects as entry points of the group `residyn.effects`; a
file needs only be named.
"""

import importlib.metadata
import importlib.util
import inspect
import sys
from pathlib import Path
from types import ModuleType

from ..errors import InputError, inside, quote
from ..files import check_ordinary
from ..physics.effect import AbstractEffect
from .trial import check_law

GROUP = "residyn.effects"


def read_effects(path: str | Path) -> list[type[AbstractEffect]]:
    """The effects that a Python file defines.

    **Raises:** `InputError`, in one line, if the file cannot be run or defines none.
    """
    where = str(path)
    check_ordinary(path, "Python file of effects")
    spec = importlib.util.spec_from_file_location(f"residyn_own_{Path(path).stem}", path)
    if spec is None or spec.loader is None:
        raise InputError(f"{where}: is not a Python file (its name must end in .py)")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # where dataclasses look up a class's own names
    try:
        spec.loader.exec_module(module)
    except SyntaxError as error:
        raise InputError(f"{where}, line {error.lineno}: {error.msg}") from None
    except Exception as error:  # whatever the user's file does
        line = _line_in(error, where)
        raise InputError(f"{where}{line}: {type(error).__name__}: {error}") from None
    found = _defined_in(module)
    if not found:
        raise InputError(f"{where}: defines no effect (a subclass of residyn.JointEffect, say)")
    return [checked(kind, where) for kind in found]


def installed() -> list[type[AbstractEffect]]:
    """The effects that installed packages offer.

    **Raises:** `InputError`, in one line, for an entry point that offers something else.
    """
    found = []
    for point in importlib.metadata.entry_points(group=GROUP):
        where = f"entry point {point.name} ({point.value})"
        try:
            offered = point.load()
        except Exception as error:
            raise InputError(f"{where}: {type(error).__name__}: {error}") from None
        kinds = _defined_in(offered) if isinstance(offered, ModuleType) else [offered]
        found += [checked(kind, where) for kind in kinds]
    return found


def checked(kind: object, where: str) -> type[AbstractEffect]:
    """A class that can join the catalogue.

    **Raises:** `InputError`, in one line, that says what is missing.
    """
    if not (isinstance(kind, type) and issubclass(kind, AbstractEffect)):
        raise InputError(f"{where}: {quote(kind)} is no effect (a subclass of AbstractEffect)")
    name = getattr(kind, "name", None)
    if not isinstance(name, str) or not name.isidentifier():
        raise InputError(
            f"{where}: {kind.__name__} needs a name, such as name = "
            f'"{_snake(kind.__name__)}", by which commands call it'
        )
    lacking = sorted(getattr(kind, "__abstractmethods__", ()))
    if lacking:
        raise InputError(f"{where}: {kind.__name__} lacks the method {lacking[0]}")
    with inside(where):
        check_law(kind)
    return kind


def _defined_in(module: ModuleType) -> list[type[AbstractEffect]]:
    """Its own effects, in the order they are written; what it imports or calls _private is not."""
    kinds = [
        kind
        for kind in vars(module).values()
        if isinstance(kind, type)
        and issubclass(kind, AbstractEffect)
        and kind.__module__ == module.__name__
        and not kind.__name__.startswith("_")
    ]
    return sorted(set(kinds), key=lambda kind: inspect.getsourcelines(kind)[1])


def _line_in(error: Exception, where: str) -> str:
    """Where in the user's file it went wrong."""
    line, trace = None, error.__traceback__
    while trace is not None:
        if trace.tb_frame.f_code.co_filename.endswith(Path(where).name):
            line = trace.tb_lineno
        trace = trace.tb_next
    return "" if line is None else f", line {line}"


def _snake(name: str) -> str:
    return "".join(f"_{c.lower()}" if c.isupper() and i else c.lower() for i, c in enumerate(name))

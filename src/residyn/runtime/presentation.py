"""Where a result finds its text: the package's one step upwards.

A result holds data. What is printed, drawn or typeset of it is written in `residyn.reporting`,
which imports the results and must not be imported by them. `print(result)` still has to work. So
`Result` looks `reporting` up by name, when it is asked for text and not before.

Its class says which module there writes `about` it. The functions `text`, `latex`, `csv`,
`sentences` and `warnings` of that module take the result.
"""

import importlib
from types import ModuleType
from typing import Any, ClassVar


class Result:
    """A result that can be printed."""

    about: ClassVar[str]

    def __init_subclass__(cls, about: str | None = None) -> None:
        if about is not None:
            cls.about = about

    def __str__(self) -> str:
        return self._presented("text")

    @property
    def reporting(self) -> ModuleType:
        """The module that writes about results of this class."""
        return importlib.import_module(f"residyn.reporting.{self.about}")

    def _presented(self, function: str) -> Any:
        """What `residyn.reporting` makes of this result."""
        return getattr(self.reporting, function)(self)


class TableResult(Result):
    """A result that also has tables for a paper."""

    def to_latex(self) -> str:
        """Tables in LaTeX (package booktabs), values rounded by their standard errors."""
        return self._presented("latex")

    def to_csv(self) -> str:
        """The same as comma-separated values, a line for each number."""
        return self._presented("csv")

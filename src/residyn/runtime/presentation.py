"""Where a result finds its text: the package's one step upwards.

A result holds data. What is printed, drawn or typeset of it is written in `residyn.reporting`,
which imports the results and must not be imported by them. `print(result)` still has to work. So
`Result` looks `reporting` up by name, when it is asked for text and not before.

`residyn.reporting.of(result)` is the module that writes about results of this class. Its functions
`text`, `latex`, `csv`, `sentences` and `warnings` take the result.
"""

import importlib
from typing import Any


class Result:
    """A result that can be printed."""

    def __str__(self) -> str:
        return self._presented("text")

    def _presented(self, function: str) -> Any:
        """What `residyn.reporting` makes of this result."""
        module = importlib.import_module("residyn.reporting").of(self)
        return getattr(module, function)(self)


class TableResult(Result):
    """A result that also has tables for a paper."""

    def to_latex(self) -> str:
        """Tables in LaTeX (package booktabs), values rounded by their standard errors."""
        return self._presented("latex")

    def to_csv(self) -> str:
        """The same as comma-separated values, a line for each number."""
        return self._presented("csv")

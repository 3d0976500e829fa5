"""What `compare` returns, and how it reads: the verdict first, then the fit, then the tables."""

import textwrap
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..fitting.result import Fit
from .horizon import HeldOut, Horizon
from .missing import Missing, summary
from .tables import tables
from .where import Where
from .words import SURE, sentences

_WIDTH = 80


@dataclass(frozen=True, eq=False)
class Comparison:
    """A fitted model against measurement. Print it; or `to_dict()` for the JSON."""

    fit: Fit
    where: Where
    held_out: HeldOut | None
    """None if the fit of the first two thirds did not settle."""
    horizon: Horizon | None
    """None if the fit of the first third did not settle."""
    missing_torque: tuple[Missing, ...]
    """One per fitted recording."""

    @property
    def p(self) -> float:
        """Probability that noise alone leaves a residual so far from white, all joints together;
        1 where no joint has enough readings to tell."""
        each = [w.p for w in self.where.white.values() if np.isfinite(w.p)]
        return float(-np.expm1(len(each) * np.log1p(-min(each)))) if each and min(each) < 1 else 1.0

    @property
    def explained(self) -> bool:
        """Whether what is left is as white as noise is."""
        return self.p >= SURE

    @property
    def words(self) -> tuple[str, ...]:
        """The verdict: where the model fails, or that it does not, in a few sentences."""
        return sentences(self)

    def to_dict(self) -> dict[str, Any]:
        """The JSON of `residyn compare`: that of `fit`, and

        - `words`: the verdict, a sentence each;
        - `where`: see `Where.to_dict`; `white` in it has the p-value of each joint;
        - `held_out`: null, or `what` ("check recordings" or "last third"), and under `joints` and
          `fitted` the errors of each joint there and in the fitted part: `rmse` (rad or m), `ratio`
          (in times the noise), `expected` (the ratio that a right model would leave, or null);
        - `horizon`: null, or `seconds` (of the fitted third), `fitted`, and `ahead`, a list of
          `start`, `stop` (s after the last fitted reading) and `joints`, with errors as above;
        - `missing_torque`: per joint its `rms` (in `unit`) and `share_of_spring`, the share of the
          spring torque's rms.
        """
        joints = self.fit.joints
        return {
            **self.fit.to_dict(),
            "words": list(self.words),
            "where": self.where.to_dict(),
            "held_out": None if self.held_out is None else self.held_out.to_dict(joints),
            "horizon": None if self.horizon is None else self.horizon.to_dict(joints),
            "missing_torque": summary(self.missing_torque),
        }

    def __str__(self) -> str:
        verdict = textwrap.wrap(" ".join(self.words), _WIDTH, break_on_hyphens=False)
        return "\n".join([*verdict, "", str(self.fit), *tables(self)])

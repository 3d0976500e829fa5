"""Least squares in which the model's own unknowns come first.

An effect is judged by what it explains beyond what numbers and initial states explain already. So
these are eliminated, initial states recording by recording, then the shared numbers; what is left
of every column is what only it can do.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from .answers import Answers
from .linear import Near

_BLIND = 1e-9  # of a direction's square: what the model's own numbers do, too
_LEAST = 1e-7  # of a column's square that must be left when the model has adjusted


class Solver(NamedTuple):
    """Least squares with the model's own unknowns taken out."""

    square: np.ndarray  # (C, C) of the columns, less what the model's unknowns do
    slope: np.ndarray  # (C,) of the columns with what is left
    whole: np.ndarray  # (C,) squares of the columns as they are
    alone: float  # chi-square without any column
    numbers: np.ndarray  # (P, C + 1) steps that each column, and what is left, ask of the numbers
    states: list[np.ndarray]  # (s, P + C + 1) of each recording, initial states, and for numbers

    @classmethod
    def of(cls, near: Near, answers: Answers) -> "Solver":
        """Eliminate initial states recording by recording, then the numbers."""
        wide = near.numbers + answers.columns[0].shape[1] + 1
        total, whole = np.zeros((wide, wide)), np.zeros(wide)
        asked = []
        for left, numbers, states, columns in answers.recordings():
            rows = np.hstack([numbers, columns, left[:, None]])
            square, taken = rows.T @ rows, basis_of(states).T @ rows
            total += square - taken.T @ taken
            whole += np.diag(square)
            asked.append(np.linalg.pinv(states, rcond=1e-9) @ rows)
        p = near.numbers
        inner = inverse_of(total[:p, :p])
        moved = inner @ total[:p, p:]
        rest = total[p:, p:] - total[p:, :p] @ moved
        alone = float(rest[-1, -1])
        return cls(rest[:-1, :-1], rest[:-1, -1], whole[p:-1], alone, moved, asked)

    def beside(self, which: Sequence[int], factors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The model's numbers (P,) and each recording's initial states (R, s) that go with some
        columns' factors, as steps in the problem's scales."""
        p, columns = len(self.numbers), np.asarray(which)
        numbers = self.numbers[:, -1] - self.numbers[:, columns] @ factors
        states = [x[:, -1] - x[:, p + columns] @ factors - x[:, :p] @ numbers for x in self.states]
        return numbers, np.stack(states)

    def solve(self, chosen: Sequence[int], free: Sequence[bool]) -> tuple[np.ndarray, float]:
        """Factors of some columns, none negative that is not `free`, and the drop they bring."""
        which = np.asarray(chosen)
        good = self.square[which, which] > _LEAST * self.whole[which]
        while True:
            factors, use = np.zeros(len(which)), which[good]
            if len(use):
                factors[good] = inverse_of(self.square[np.ix_(use, use)]) @ self.slope[use]
            wrong = [i for i, any_sign in enumerate(free) if not any_sign and factors[i] < 0]
            if not wrong:
                drop = 2 * factors @ self.slope[which]
                drop -= factors @ self.square[np.ix_(which, which)] @ factors
                return factors, float(drop)
            good[min(wrong, key=lambda i: factors[i])] = False


def basis_of(columns: np.ndarray) -> np.ndarray:
    size = np.sqrt((columns**2).sum(axis=0))
    u, s, _ = np.linalg.svd(columns[:, size > 0] / size[size > 0], full_matrices=False)
    return u[:, s > 1e-7 * s.max(initial=0.0)]


def inverse_of(square: np.ndarray) -> np.ndarray:
    """Of a symmetric matrix, blind where its unit columns are."""
    diagonal = np.diag(square)
    size = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    inverse = np.linalg.pinv(square / size / size[:, None], rcond=_BLIND, hermitian=True)
    return inverse / size / size[:, None]

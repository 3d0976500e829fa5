"""A study that goes on in the background while pages look at it.

Each has a thread of its own for the long work (smoothing, screening, the search). Fits that
somebody waits for run in one more thread, one after the other, and quick ones in another, which a
program that is being compiled does not hold up; of what one window asks for only the newest is
begun.
"""

import asyncio
import contextlib
import enum
import json
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import jax

from ...errors import InputError
from ...fitting.result import FitError
from ...recordings.experiment import Experiment
from .files import ExperimentFiles
from .payload import fitted, packed, payload, refitted
from .study import Study

T = TypeVar("T")
_IDLE = 2.0  # s without a question, after which fits ahead that compile are begun


class How(enum.StrEnum):
    """What a page asks of a model: least squares by the smoother, the fit, or what the better one
    of these that is known predicts of the readings that were held out."""

    SMOOTHED = enum.auto()
    PREDICTED = enum.auto()
    REFITTED = enum.auto()


class Workbench:
    """One experiment, live."""

    def __init__(
        self,
        experiment: Experiment,
        effects: tuple[str, ...],
        name: str,
        files: ExperimentFiles | None = None,
        hidden: str | None = None,
    ):
        """Begin at once. `hidden` is what was hidden in a simulated arm."""
        self.experiment, self.effects, self.name = experiment, effects, name
        self.files, self.hidden = files, hidden
        self.words, self.error = "starting", ""
        self.study: Study | None = None
        self.text: str | None = None  # the payload as JSON, once it is there
        self.version = 0  # counts what the search has added
        self.stopped, self._tried = False, 1
        # When somebody last asked for a fit, and how many wait for one.
        self.asked, self.asking = time.monotonic(), 0
        self.looked_at: tuple[str, ...] = ()  # the model that somebody looks at
        self.shown: tuple[str, ...] = ()  # effects whose chips are shown first, likeliest first
        threading.Thread(target=_in_double, args=(self._work,), daemon=True).start()

    def _work(self) -> None:
        try:
            study = Study(self.experiment, self.effects, say=self._say)
            toml = None if self.files is None else self.files.text
            self.text = json.dumps(packed(payload(study, live=True, name=self.name, toml=toml)))
            self.study = study
            study.diagnose()
            self.version += 1
            self.words = ""
            self._ahead(study)
        except Superseded:
            self.words = ""
        except (FitError, InputError, ValueError) as error:
            self.error = " ".join(str(error).split())
        except Exception as error:
            self.error = f"this should not have happened, {type(error).__name__}: {error}"

    def _ahead(self, study: Study) -> None:
        """While nobody asks, fit what is likely to be asked for next: the model that somebody looks
        at with one of the effects that are shown more or less; by the smoother first."""
        failed: set[frozenset[str]] = set()
        while not self.stopped:
            time.sleep(0.05)
            next_ = study.neighbours(self.looked_at, self.shown)
            if self.asking:
                continue
            with contextlib.suppress(Superseded):
                refits = study.refits
                if new := [k for k in next_ if k not in refits]:
                    study.refit(sorted(new[0]), self._go_on)
                elif new := [k for k in next_ if refits[k] and k not in study.predictions]:
                    study.predicted(sorted(new[0]), self._go_on)
                else:
                    # Only what does not settle: a compilation, once begun, slows a click down.
                    new = [k for k in next_ if not (refits[k] or k in study.fits or k in failed)]
                    if not new or time.monotonic() - self.asked < _IDLE:
                        continue
                    try:
                        study.fit(sorted(new[0]), progress=self._go_on)
                        study.predict(sorted(new[0]))
                    except FitError:
                        failed.add(new[0])
                self.version += 1

    def _go_on(self, words: str = "") -> None:
        if self.stopped or self.asking:
            raise Superseded

    def _say(self, words: str) -> None:
        if self.stopped:
            raise Superseded
        self.words = words
        if self.study is not None and len(self.study.search.tried) != self._tried:
            self._tried = len(self.study.search.tried)
            self.version += 1

    def state(self) -> dict[str, Any]:
        """What a page asks for every second."""
        return {
            "ready": self.text is not None,
            "words": self.words,
            "error": self.error,
            "version": self.version,
            "changed": [] if self.files is None else self.files.changed(),
            "new": [] if self.files is None else self.files.new(),
        }

    def fit(
        self,
        study: Study,
        added: list[str],
        held: dict[str, float],
        how: How,
        progress: Callable[[str], None],
    ) -> dict[str, Any]:
        """The fit that a page asks for, or `error` in a line. One by the smoother is null if that
        does not settle."""
        self.asked, self.looked_at = time.monotonic(), tuple(added)
        self.asking += 1
        try:
            if how is not How.REFITTED and not held and frozenset(added) not in study.fits:
                work = study.refit if how is How.SMOOTHED else study.predicted
                work(added, lambda: progress(""))
                return {"fit": refitted(study, sorted(added))}
            found = study.fit(added, held, progress)
            if how is How.PREDICTED:
                found = study.predict(added, held)
            return {"fit": fitted(study, sorted(added), found, [*held])}
        except (FitError, ValueError) as error:
            return {"error": " ".join(str(error).split())}
        finally:
            self.asked = time.monotonic()
            self.asking -= 1

    def look(self, words: str) -> None:
        """Somebody looks at some effects, and at chips of others: a JSON list of two."""
        with contextlib.suppress(TypeError, ValueError):
            seen, shown = map(tuple, json.loads(words))
            if self.study and {*seen, *shown} <= set(self.study.labels):
                self.looked_at, self.shown = seen, shown

    def stop(self) -> None:
        self.stopped = True
        if self.study is not None:
            self.study.stop()


class Superseded(Exception):
    """What is under way is not wanted any more."""


class Worker:
    """One thread for what windows wait for."""

    def __init__(self, newest: dict[str, int]):
        """`newest`: what each window asked for last, of this worker or of one beside it."""
        self._newest = newest
        self._thread = ThreadPoolExecutor(1)

    async def newest(self, window: str, number: int, work: Callable[[], Any]) -> Any:
        """Do some work for a window; None if it has asked for something newer before that begins,
        or before the work has called `go_on`."""
        self._newest[window] = max(number, self._newest.get(window, 0))

        def begin() -> Any:
            try:
                self.go_on(window, number)
                return work()
            except Superseded:
                return None

        return await self.do(begin)

    def go_on(self, window: str, number: int) -> None:
        """To be called now and then by long work.

        **Raises:** `Superseded` if the window has asked for something newer.
        """
        if self._newest[window] != number:
            raise Superseded

    async def do(self, work: Callable[[], T]) -> T:
        """Do some work, in float64."""
        return await asyncio.get_running_loop().run_in_executor(self._thread, _in_double, work)


def _in_double(work: Callable[[], T]) -> T:
    with jax.enable_x64(True):  # JAX's settings are each thread's own
        return work()

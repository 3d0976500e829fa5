"""A study that goes on in the background while pages look at it.

Each has a thread of its own for the long work (smoothing, screening, the search). Fits that
somebody waits for run in one more thread, one after the other, and quick ones in another, which a
program that is being compiled does not hold up; of what one window asks for only the newest is
begun.
"""

import asyncio
import contextlib
import json
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from ...errors import InputError
from ...fitting.result import FitError
from ...recordings.experiment import Experiment
from .files import ExperimentFiles
from .payload import fitted, packed, payload, refitted
from .study import Study

_IDLE = 2.0  # s without a question, after which work ahead is begun
_AHEAD = 8  # effects: as many as the page shows first


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
        self.text: str | None = None
        """The payload as JSON, once it is there."""
        self.version = 0
        """Counts what the search has added."""
        self.stopped, self._tried = False, 1
        self.asked, self.looked_at = time.monotonic(), ()
        """When somebody last asked for a fit, and of which effects."""
        self.thread = threading.Thread(target=self._work, daemon=True)
        self.thread.start()

    def _work(self) -> None:
        try:
            study = Study(self.experiment, self.effects, say=self._say)
            toml = None if self.files is None else self.files.text
            self.text = json.dumps(packed(payload(study, live=True, name=self.name, toml=toml)))
            self.study = study
            study.diagnose(self._say)
            self.version += 1
            self.words = ""
            self._ahead(study)
        except _Stopped:
            self.words = ""
        except (FitError, InputError, ValueError) as error:
            self.error = " ".join(str(error).split())
        except Exception as error:
            self.error = f"this should not have happened, {type(error).__name__}: {error}"

    def _ahead(self, study: Study) -> None:
        """While nobody asks, fit what is likely to be asked for next: beside the model that
        somebody looks at, one more of the most probable effects."""
        tried: set[frozenset[str]] = set()
        while not self.stopped:
            time.sleep(0.2)
            beside, found = self.looked_at, self.study and study.found
            if time.monotonic() - self.asked < _IDLE or found is None:
                continue
            likely = [c.effect for c in found.candidates if c.effect not in beside][:_AHEAD]
            next_ = [frozenset((*beside, x)) for x in likely]
            todo = [k for k in next_ if k not in study.fits and k not in tried]
            if not todo:
                continue
            tried.add(todo[0])
            near = study.refit(sorted(todo[0]))
            if near is not None:  # what does not settle takes many starts: only if it is asked for
                with contextlib.suppress(FitError):
                    study.fit(sorted(todo[0]))
                    self.version += 1

    def _say(self, words: str) -> None:
        if self.stopped:
            raise _Stopped
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
        self, study: Study, added: list[str], held: dict[str, float], quick: bool
    ) -> dict[str, Any]:
        """The fit that a page asks for, or `error` in a line. A `quick` one is by the smoother; it
        is null if that does not settle."""
        self.asked, self.looked_at = time.monotonic(), tuple(sorted(added))
        try:
            if quick and frozenset(added) not in study.fits:
                return {"fit": refitted(study, sorted(added))}
            return {"fit": fitted(study, sorted(added), study.fit(added, held), [*held])}
        except (FitError, ValueError) as error:
            return {"error": " ".join(str(error).split())}
        finally:
            self.asked = time.monotonic()

    def stop(self) -> None:
        """End what is under way, at its next step."""
        self.stopped = True
        if self.study is not None:
            self.study.stop()


class _Stopped(Exception):
    pass


class Worker:
    """One thread for what windows wait for."""

    def __init__(self, newest: dict[str, int] | None = None):
        """`newest`: what each window asked for last, if several workers are asked by the same."""
        self._newest = {} if newest is None else newest
        self._thread = ThreadPoolExecutor(1)

    async def newest(self, window: str, number: int, work: Callable[[], Any]) -> Any:
        """Do some work for a window, unless it has asked for something newer before that begins:
        None then."""
        self._newest[window] = max(number, self._newest.get(window, 0))
        return await self.do(lambda: work() if self._newest[window] == number else None)

    async def do(self, work: Callable[[], Any]) -> Any:
        """Do some work."""
        return await asyncio.get_running_loop().run_in_executor(self._thread, work)

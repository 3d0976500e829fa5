"""A process of its own for each piece of work, with what it took."""

import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple


class Took(NamedTuple):
    """A process and its answers."""

    answers: list[Any]
    """What it printed, a JSON value a line."""
    wall: float
    """s, from its start to its end, imports included."""
    cpu: float
    """s, user and system."""
    error: str
    """The last line that it wrote to standard error, if it failed; else empty."""


def fresh(module: str, *words: str, given: Any = None, cache: Path | None = None) -> Took:
    """Run `python -m module words` with `given` as JSON on its standard input.

    `cache`: the folder for what residyn keeps; None: the user's.
    """
    more = {} if cache is None else {"XDG_CACHE_HOME": str(cache)}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    began = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", module, *words],
        input=json.dumps(given),
        capture_output=True,
        text=True,
        env=os.environ | more,
    )
    wall, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    failed = (done.stderr.strip().splitlines() or [""])[-1] or f"exit status {done.returncode}"
    answers = [json.loads(line) for line in done.stdout.splitlines() if line[:1] in "{["]
    return Took(answers, wall, cpu, failed if done.returncode else "")


def memory_mb(what: str = "VmHWM") -> float:
    """The largest resident memory of this process so far (or `VmRSS`, now), MB.

    NaN where there is no /proc.
    """
    try:
        lines = Path("/proc/self/status").read_text().splitlines()
    except OSError:
        return float("nan")
    return next(float(x.split()[1]) for x in lines if x.startswith(what)) * 1024 / 1e6


def markdown(head: list[str], rows: list[list[str]]) -> str:
    """A table."""
    return "\n".join("| " + " | ".join(r) + " |" for r in (head, ["---"] * len(head), *rows))

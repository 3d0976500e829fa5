"""Hide an effect in a MuJoCo arm, and see whether `residyn.diagnose` names it.

    python -m benchmarks.hidden_effects run --what single none outside pairs --out FILE
    python -m benchmarks.hidden_effects report FILE...
    python -m benchmarks.hidden_effects sindy --what single none --out FILE    (another environment)
    python -m benchmarks.hidden_effects bic --only cubic_stiffness:elbow --out FILE

Random arms, releases and strengths; one recording each, 20 s at 100 Hz. Hidden are: one effect of
the catalogue at one place (`single`), nothing (`none`), something that no catalogue has (`outside`:
a ripple in the angle, a burst in time, drag with the fifth power of the rate, a magnet), and two
effects of different physical kinds at once, 2 to 10 % of the spring's torque each (`pairs`).
Nothing of the rig shares code with the package. Noise is a share of the amplitude (of both joints'
largest swings; `--of rms`: of the motion's rms about its mean, less than half of that).

*Seeds.* `--seeds tuning` is for work on the package, `--seeds report` for the published table. The
report seeds were written down and committed before `residyn.diagnose` existed, so before anything
of it could be tuned; nothing may be tuned on them.

*What counts.* A case counts if an oracle, which fits the true effect, could tell it from springs
and dampers alone: chi-square falls by more than 25 + 2 for every number of the effect. Of two
effects each must be tellable so given the other; outside the catalogue the oracle is the true
motion. The share of cases that it could not tell is printed too.

A run appends one JSON line a case to FILE and skips what is there already, so that it may be
stopped and gone on with; `--jobs 2` works on two cases at a time. `--count` is of each label at
each noise (of `none` and `pairs`: at each noise). `report FILE --beside OTHERS` sets the answers of
PySINDy and BIC beside residyn's on the cases that they share.
"""

import argparse
import itertools
import json
import multiprocessing
import os
import sys
import time
import traceback
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

from benchmarks._hidden_cases import NOISE, SEEDS, Spec, specs
from benchmarks._hidden_score import read

WHAT = ("single", "none", "outside", "pairs")
_ONE_THREAD = {
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
}

_FORGET = 10  # cases
_worked = itertools.count(1)

Work = Callable[[Spec], Any]


def diagnosed(spec: Spec) -> Any:
    """One case, diagnosed."""
    from benchmarks._hidden_run import run_case

    return run_case(spec)


def by_bic(spec: Spec) -> Any:
    """One case, by the least BIC of all effects."""
    from benchmarks._hidden_run import bic

    return bic(spec)


def by_sindy(spec: Spec) -> Any:
    """One case, by both forms of PySINDy."""
    from benchmarks._hidden_sindy import sindy

    return sindy(spec)


def by_sindy_tuning(spec: Spec) -> Any:
    """One case, by PySINDy at every setting."""
    from benchmarks._hidden_sindy import tuning

    return tuning(spec)


def _safe(work: Work, spec: Spec) -> list[dict[str, Any]]:
    if next(_worked) % _FORGET == 0:
        _forget()
    try:
        rows = work(spec)
    except Exception:
        about = {"key": spec.key, "what": spec.what, "hidden": list(spec.labels)}
        return [about | {"noise": spec.noise, "error": "case", "trace": traceback.format_exc()}]
    return rows if isinstance(rows, list) else [rows]


def _forget() -> None:
    """Drop compiled programs: a process may map only so many pieces of memory."""
    if "jax" in sys.modules:
        import jax

        jax.clear_caches()


def work_through(work: Work, todo: list[Spec], out: Path, jobs: int, again: bool) -> None:
    """Do the cases that the file lacks (`again`: or that broke), and append them as they come."""
    done = set()
    if out.exists():
        rows = [json.loads(line) for line in out.read_text().splitlines()]
        done = {row["key"] for row in rows if not (again and row.get("error"))}
    left = {spec.key: spec for spec in todo if spec.key not in done}
    print(f"{len(left)} cases to do, {len(todo) - len(left)} done before", flush=True)
    out.parent.mkdir(parents=True, exist_ok=True)
    began, total = time.perf_counter(), len(left)

    def keep(rows: list[dict[str, Any]]) -> None:
        left.pop(rows[0]["key"])
        with out.open("a") as file:
            file.writelines(json.dumps(row) + "\n" for row in rows)
        print(f"{total - len(left)}/{total} {time.perf_counter() - began:.0f} s ", end="")
        print(_line(rows[0]), flush=True)

    if jobs == 1:
        for spec in list(left.values()):
            keep(_safe(work, spec))
        return
    os.environ |= {k: v for k, v in _ONE_THREAD.items() if k not in os.environ}
    for _ in range(5):
        if not left:
            return
        fresh = multiprocessing.get_context("spawn")
        try:
            with ProcessPoolExecutor(jobs, fresh) as pool:
                waiting = [pool.submit(_safe, work, spec) for spec in left.values()]
                for each in as_completed(waiting):
                    keep(each.result())
        except BrokenProcessPool:
            print("a worker died (memory?): its cases are tried again", flush=True)


def _line(row: dict[str, Any]) -> str:
    if row.get("error"):
        return f"{row['key']}: {row['error']}: {row['trace'].strip().splitlines()[-1]}"
    if "named" in row:
        return f"{row['key']}: {row['method']}: {', '.join(row['named'][:3]) or 'nothing'}"
    counted = "" if row["oracle"]["tellable"] or row["what"] == "none" else " (not tellable)"
    return f"{row['key']}: {'+'.join(row['added']) or '-'}, {row['verdict']}{counted}"


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="command", required=True)
    works: dict[str, Work] = {"run": diagnosed, "bic": by_bic, "sindy": by_sindy}
    for name in works:
        one = commands.add_parser(name)
        one.add_argument("--what", nargs="+", choices=WHAT, default=list(WHAT[:2]))
        one.add_argument("--noise", nargs="+", type=float, default=list(NOISE))
        one.add_argument("--of", choices=("amplitude", "rms"), default="amplitude")
        one.add_argument("--count", type=int, default=1)
        one.add_argument("--seeds", choices=list(SEEDS), default="tuning")
        one.add_argument("--skip", type=int, default=0, help="of these seeds, the first so many")
        one.add_argument("--only", nargs="+", default=[], metavar="LABEL")
        one.add_argument("--jobs", type=int, default=1)
        one.add_argument("--out", type=Path, required=True, help="JSON lines; not for git")
        one.add_argument("--again", action="store_true", help="also what broke before")
        if name == "sindy":
            one.add_argument("--tune", action="store_true", help="every setting, tuning seeds only")
    told = commands.add_parser("report")
    told.add_argument("files", nargs="+", type=Path)
    told.add_argument("--beside", nargs="+", type=Path, default=[], help="files of bic and sindy")
    told.add_argument("--picture", type=Path, help="calibration curve, PNG or SVG")
    options = parser.parse_args()
    if options.command == "report":
        from benchmarks._hidden_beside import beside
        from benchmarks._hidden_report import report

        rows = read(options.files)
        print(report(rows, options.picture))
        if options.beside:
            print("\n" + beside(rows, read(options.beside)))
        return
    work, tune = works[options.command], getattr(options, "tune", False)
    if tune:
        if options.seeds != "tuning":
            parser.error("nothing is tuned on the report seeds")
        work = by_sindy_tuning
    o = options
    todo = specs(o.what, o.noise, o.count, o.seeds, o.only, o.of, o.skip)
    work_through(work, list(todo), options.out, options.jobs, options.again)
    if tune:
        from benchmarks._hidden_beside import settings

        print(settings(read([options.out])))


if __name__ == "__main__":
    main()

"""Hide an effect in a MuJoCo arm, and see whether `residyn.diagnose` names it.

    python -m benchmarks.hidden_effects run --seeds fresh --jobs 2 --shuffle --out RUN
    python -m benchmarks.hidden_effects oracle RUN [OTHER...] --jobs 2 --out ORACLE
    python -m benchmarks.hidden_effects report RUN --oracle ORACLE --beside NAME=OTHER...
    python -m benchmarks.hidden_effects sindy --seeds fresh --out OTHER     (another environment)

Random arms, releases and strengths; one recording each, 20 s at 100 Hz. Hidden are: one effect of
the catalogue at one place (`single`), nothing (`none`), something that no catalogue has (`outside`:
a ripple in the angle, a burst in time, drag with the fifth power of the rate, a magnet, a spring
that comes loose), and two effects of different physical kinds at once, 2 to 10 % of the spring's
torque each (`pairs`). Nothing of the rig shares code with the package. Noise is a share of the
amplitude (of both joints' largest swings, root mean square).

`run` appends one JSON line a case to its file and skips what is there already, so it may be stopped
and gone on with. Each case is a process of its own: its times and peak memory are those of a first
diagnosis whose programs may be in the cache; MuJoCo, which makes the recording, takes part in the
memory. `--batch 10` is quicker (programs are compiled once in ten cases). `--shuffle` takes the
cases in a fixed random order, so that a partial run is a fair sample; `--seconds` begins no case
after that long. Without `--what` the cases are those of the published table (`PLAN` in
`_hidden_cases`).

`oracle` fits by name: springs and dampers, the truth, and whatever the given files named or gave 1
% or more instead of it. `--every` fits all effects of the catalogue to cases with one effect or
none, and their BIC joins the methods of the report.

`report` prints the scores; `_hidden_report` says what each is. `--beside` sets other files beside
the first on the cases that all have.
"""

import argparse
import itertools
import json
import os
import random
import subprocess
import sys
import time
import traceback
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Lock
from typing import Any

from benchmarks._hidden_cases import NOISE, PLAN, SEEDS, Spec, specs

WHAT = ("single", "none", "outside", "pairs")
LIKELY = 0.01
"""Names with this probability or more are the oracle's rivals."""


def read(path: Path) -> list[dict[str, Any]]:
    """All lines; of a case that was run twice, the later."""
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    return list({(row["key"], row.get("method")): row for row in rows}.values())


def here(command: str) -> None:
    """The cases on standard input, in this process, a line of answers each."""
    import residyn

    residyn.set_up()
    from benchmarks._hidden_run import diagnosed, oracle

    for key, more in json.load(sys.stdin):
        try:
            if command == "run":
                rows = [diagnosed(Spec.of(key))]
            else:
                rows = [oracle(Spec.of(key), [x for x in more if x != "every"], "every" in more)]
        except Exception as error:
            rows = [_failed(key, f"{type(error).__name__}: {error}", traceback.format_exc())]
        print(json.dumps(rows), flush=True)


def _sindy(key: str, more: list[str]) -> list[dict[str, Any]]:
    from benchmarks._hidden_sindy import sindy

    return sindy(Spec.of(key), tune="tune" in more)


def _one_thread() -> dict[str, str]:
    """The environment of a process that shares the machine with others like it."""
    flags = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
    flags = f"{os.environ.get('XLA_FLAGS', '')} {flags}".strip()
    return os.environ | {"XLA_FLAGS": flags, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def _apart(
    command: str, cases: list[tuple[str, list[str]]], alone: bool
) -> Iterator[list[dict[str, Any]]]:
    """Cases in a process of their own; `error` in place of what could not be had."""
    if command == "sindy":
        yield from (_sindy(*case) for case in cases)
        return
    words = [sys.executable, "-m", "benchmarks.hidden_effects", "here", command]
    left = dict(cases)
    with subprocess.Popen(
        words,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=None if alone else _one_thread(),
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(json.dumps(cases))
        process.stdin.close()
        for line in process.stdout:
            rows = json.loads(line)
            left.pop(rows[0]["key"])
            yield rows
    for key in left:
        yield [_failed(key, f"the process ended with {process.returncode} (memory?)", "")]


def _failed(key: str, error: str, trace: str) -> dict[str, Any]:
    spec = Spec.of(key)
    row = {"key": key, "what": spec.what, "hidden": list(spec.labels), "noise": spec.noise}
    return row | {"error": error, "trace": trace}


def work_through(command: str, todo: dict[str, list[str]], options: argparse.Namespace) -> None:
    """Do the cases that the file lacks, each with its words, and append them as they come."""
    out: Path = options.out
    out.parent.mkdir(parents=True, exist_ok=True)
    done = {r["key"] for r in (read(out) if out.exists() else []) if not r.get("error")}
    left = [(key, more) for key, more in todo.items() if key not in done]
    if options.shuffle:
        random.Random(0).shuffle(left)
    print(f"{len(left)} cases to do, {len(todo) - len(left)} done before", flush=True)
    began, lock, count = time.perf_counter(), Lock(), itertools.count(1)

    def work(cases: list[tuple[str, list[str]]]) -> None:
        if options.seconds and time.perf_counter() - began > options.seconds:
            return
        for rows in _apart(command, cases, options.jobs == 1):
            with lock:
                with out.open("a") as file:
                    file.writelines(json.dumps(row) + "\n" for row in rows)
                since = time.perf_counter() - began
                print(f"{next(count)}/{len(left)} {since:.0f} s {_line(rows[0])}", flush=True)

    with ThreadPoolExecutor(options.jobs) as pool:
        list(
            pool.map(
                work, (left[i : i + options.batch] for i in range(0, len(left), options.batch))
            )
        )


def _line(row: dict[str, Any]) -> str:
    if row.get("error"):
        return f"{row['key']}: {row['error']}"
    if "fits" in row:
        return f"{row['key']}: {len(row['fits'])} fits"
    names = row["named"][:3] if "named" in row else row["added"]
    told = f"{row['seconds']:.1f} s, {row.get('peak_mb', 0):.0f} MB"
    return (
        f"{row['key']}: {'+'.join(names) or '-'}, {row.get('verdict', row.get('method'))}, {told}"
    )


def _planned(o: argparse.Namespace) -> list[Spec]:
    plan = [(w, tuple(o.noise), o.count) for w in o.what] if o.what else PLAN
    return [
        s for w, noise, count in plan for s in specs([w], noise, count, o.seeds, o.only, o.skip)
    ]  # fmt: skip


def _rivals(files: list[Path], every: bool) -> dict[str, list[str]]:
    """By case, what the files named or thought likely."""
    found: dict[str, dict[str, None]] = {}
    for row in (row for file in files for row in read(file)):
        own = found.setdefault(row["key"], {})
        if every and row["what"] in ("single", "none"):
            own["every"] = None
        likely = [c[0] for c in row.get("candidates", []) if c[1] >= LIKELY]
        own.update(dict.fromkeys([*row.get("added", row.get("named", []))[:3], *likely]))
    return {key: list(own) for key, own in found.items()}


def main() -> None:
    """The command."""
    if sys.argv[1:2] == ["here"]:
        here(sys.argv[2])
        return
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="command", required=True)
    for name in ("run", "sindy", "oracle"):
        own = commands.add_parser(name)
        if name == "oracle":
            own.add_argument("files", nargs="+", type=Path, help="of run and of other methods")
            own.add_argument("--every", action="store_true", help="all effects are rivals")
        else:
            own.add_argument("--seeds", choices=list(SEEDS), default="tuning")
            own.add_argument("--what", nargs="+", choices=WHAT, help="instead of the whole plan")
            own.add_argument("--noise", nargs="+", type=float, default=list(NOISE))
            own.add_argument("--count", type=int, default=1, help="of each label at each noise")
            own.add_argument(
                "--skip", type=int, default=0, help="of these seeds, the first so many"
            )
            own.add_argument("--only", nargs="+", default=[], metavar="LABEL")
        if name == "sindy":
            own.add_argument("--tune", action="store_true", help="every setting, tuning seeds only")
        own.add_argument("--jobs", type=int, default=1)
        own.add_argument("--batch", type=int, default=1, help="cases of one process")
        own.add_argument("--shuffle", action="store_true")
        own.add_argument("--seconds", type=float)
        own.add_argument("--out", type=Path, required=True, help="JSON lines; not for git")
    told = commands.add_parser("report")
    told.add_argument("file", type=Path)
    told.add_argument("--oracle", type=Path, help="without it, plain counts")
    told.add_argument("--beside", nargs="+", default=[], metavar="NAME=FILE")
    told.add_argument("--picture", type=Path, help="calibration curve, PNG or SVG")
    o = parser.parse_args()
    if o.command == "report":
        from benchmarks._hidden_report import counted, report

        if o.oracle is None:
            print(counted(read(o.file)))
            return
        others = {name: read(Path(file)) for name, file in (x.split("=", 1) for x in o.beside)}
        print(report(read(o.file), read(o.oracle), others, o.picture))
    elif o.command == "oracle":
        work_through("oracle", _rivals(o.files, o.every), o)
    elif getattr(o, "tune", False):
        if o.seeds != "tuning":
            parser.error("nothing is tuned on the other seeds")
        from benchmarks._hidden_sindy import settings

        work_through("sindy", {s.key: ["tune"] for s in _planned(o)}, o)
        print(settings(read(o.out)))
    else:
        work_through(o.command, {s.key: [] for s in _planned(o)}, o)


if __name__ == "__main__":
    main()

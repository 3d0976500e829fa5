"""Hide a law that no catalogue has in a MuJoCo arm, and see whether `residyn.diagnose` finds it.

    python -m benchmarks.unnamed_laws run --out RUN [--seeds report] [--what unnamed named none]
    python -m benchmarks.unnamed_laws report RUN [--beside OTHER]
    python -m benchmarks.unnamed_laws carts FOLDER
    python -m benchmarks.unnamed_laws sindy --out OTHER [--seeds report]    (another environment)

Random arms, one release each, 20 s at 100 Hz, noise 1 % of the amplitude. `unnamed`: 40 arms, five
of each law of `tests.rig.UNNAMED`, which acts with 2 to 10 % of the spring's torque at one joint;
`named`: 40 arms, each effect of the catalogue at each place once, as strong; `none`: 20 arms with
nothing hidden. The lists of seeds are frozen; whatever was tuned was tuned on `TUNING`.

`run` appends a JSON line a case and skips what is there already, so it may be stopped and gone on
with; a process does `--batch` cases, which share its compiled programs. Beside each law stands what
was possible: a fit of springs and dampers with the true law, its strength and nothing else free.

`report` prints for each law: how often joint and variable are right (of the law that has most of
the probability); which share of the visited range the curve's 95 % band holds the truth in; how
often the formula's terms are of the right kind, of those where the readings tell (the true law has
a BIC lower by 6, odds of 20 to 1, than the law that was found); and how often the held-out error is
within 5 % of that of the true motion.
"""

import argparse
import itertools
import json
import math
import random
import subprocess
import sys
import time
import traceback
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._hidden_cases import Spec
from tests import rig

TUNING = tuple(range(940001, 941001))
REPORT = tuple(range(950027, 951027))
"""For one final run. Frozen."""
SEEDS = {"tuning": TUNING, "report": REPORT}
NOISE = 0.01
ARMS = 5
"""Of each law."""
CLEAN = 20
WHAT = ("unnamed", "named", "none")
JOINTS = ("shoulder", "elbow")
TELLS = 2 * math.log(20.0)
"""Difference of BIC from which the readings tell two laws apart."""


def specs(what: list[str], seeds: str, skip: int = 0) -> Iterator[Spec]:
    """The cases: each takes the next seed of the list, of which `skip` are passed over."""
    own = iter(SEEDS[seeds][skip:])
    each: list[tuple[str, tuple[str, ...]]] = [
        ("unnamed", (f"{name}:{JOINTS[(i + k) % 2]}",))
        for i, name in enumerate(rig.UNNAMED)
        for k in range(ARMS)
    ]
    each += [("named", (label,)) for label in rig.NAMES]
    each += [("none", ())] * CLEAN
    for (kind, labels), seed in zip(each, own, strict=False):
        if kind in what:
            yield Spec(kind, labels, NOISE, seed)


# -- one case --------------------------------------------------------------------------------------


def _truth(spec: Spec, values: dict[str, float]):
    """The hidden law as an effect whose strength is free."""
    import jax.numpy as jnp

    import residyn
    from residyn.parameter import RATIO

    name, _, joint = spec.labels[0].partition(":")
    n = {k.rpartition(".")[2]: v for k, v in values.items()}

    def law(x):
        if name == "three_halves_drag":
            return n["coefficient"] * jnp.sign(x) * jnp.abs(x) ** 1.5
        if name in ("quintic_drag", "quintic_stiffness"):
            return n["coefficient"] * x**5
        if name == "exponential_stop":
            return n["side"] * n["torque"] * jnp.exp((n["side"] * x - n["angle"]) / n["width"])
        if name == "two_cogs":
            second = n["second"] * jnp.sin(n["ratio"] * n["waves"] * x + n["shift"])
            return n["torque"] * jnp.sin(n["waves"] * x + n["phase"]) + second
        if name == "soft_magnet":
            z = (x - n["angle"]) / n["width"]
            return n["torque"] * z * jnp.exp(-z * z)
        if name == "fading_friction":
            return n["torque"] * jnp.exp(-x / n["decay"])
        return n["side"] * n["coefficient"] * jnp.maximum(n["side"] * x, 0.0) ** 2

    kind = rig.UNNAMED[name]

    class TrueLaw(residyn.JointEffect):
        name = f"true_{spec.labels[0].partition(':')[0]}"
        title = "The true law"
        equation = "scale f"
        dry = kind.factor == "direction"
        scale: Any = residyn.param("its size, 1 as it is", RATIO, default=1.0)

        def joint_torque(self, motion):
            x = {"angle": motion.q, "rate": motion.v, "time": motion.t}[kind.variable]
            return self.scale * law(x) * (motion.direction if self.dry else 1.0)

    return TrueLaw(joint)


def case(spec: Spec) -> dict[str, Any]:
    """One line."""
    import residyn
    from benchmarks._fresh import memory_mb
    from benchmarks._hidden_run import about, chi2_of, ratio
    from benchmarks.effects import experiment_of

    made = spec.make()
    experiment = experiment_of(made)
    cpu = time.process_time()
    found = residyn.diagnose(experiment)
    row = about(spec) | {
        "values": {k: float(v) for k, v in made.numbers.items()},
        "cpu": time.process_time() - cpu,
        "verdict": found.verdict,
        "added": list(found.added),
        "likely": [[c.effect, c.probability] for c in found.candidates if c.probability > 0.01],
        "lookalikes": [list(x) for x in found.lookalikes],
        "laws": [
            {
                "place": [x.joint, x.variable, x.factor],
                "beside": list(x.beside),
                "probability": x.probability,
                "log_evidence": x.log_evidence,
                "formula": None if x.formula is None else x.formula.to_dict(),
            }
            for x in found.laws
        ],
    }
    lead = next((x for x in found.laws if x.probability > 0.5 and x.fit is not None), None)
    off = (made.q - made.truth) / made.noise
    fit, held = (
        (found.fit, found.ladder[-1].held_out) if lead is None else (lead.fit, lead.held_out)
    )
    assert fit is not None
    count = len(fit.numbers) + fit.recordings[0].state.size
    row["chi2"] = {"truth": float(np.sum(off**2)), "base": chi2_of(found.base),
                   "found": chi2_of(fit)}  # fmt: skip
    row["bic"] = row["chi2"]["found"] + count * math.log(off.size)
    if held is not None:
        row["held_out"] = ratio(held.held_out.ratio) / ratio(off[len(off) * 2 // 3 :])
    if spec.what == "unnamed":
        kind = rig.UNNAMED[spec.labels[0].partition(":")[0]]
        numbers = {k.rpartition(".")[2]: v for k, v in made.numbers.items()}
        joint = spec.labels[0].partition(":")[2]
        if lead is not None and (lead.joint, lead.variable) == (joint, kind.variable):
            truth = lead.on_grid(np.array([kind.value(numbers, float(x)) for x in lead.grid]))
            inside = np.abs(lead.mean - truth) <= 1.96 * lead.std
            row["coverage"] = float(np.mean(inside[lead.visits > 0]))
            row["band"] = float(np.sqrt(np.mean(lead.std**2)) / np.sqrt(np.mean(truth**2)))
        possible = residyn.fit(experiment, effects=[_truth(spec, made.numbers)], starts=2)
        extra = kind.numbers - 1  # the shapes that were given it
        count = len(possible.numbers) + possible.recordings[0].state.size + extra
        row["chi2"]["possible"] = chi2_of(possible)
        row["bic_possible"] = chi2_of(possible) + count * math.log(off.size)
    return row | {"peak_mb": memory_mb()}


def here(out: Path, keys: list[str]) -> None:
    """These cases, in this process."""
    import residyn

    residyn.set_up()
    for key in keys:
        try:
            row = case(Spec.of(key))
        except Exception as error:
            row = {"key": key, "error": f"{type(error).__name__}: {error}"}
            row["trace"] = traceback.format_exc()
        with out.open("a") as file:
            file.write(json.dumps(row) + "\n")
        print(_line(row), flush=True)


def _line(row: dict[str, Any]) -> str:
    if row.get("error"):
        return f"{row['key']}: {row['error']}"
    laws = ", ".join(
        f"{' '.join(x['place'])} {x['probability']:.2f}"
        + (f" {x['formula']['equation']}" if x["formula"] else "")
        for x in row["laws"]
    )
    more = "  ".join(f"{k} {row[k]:.2f}" for k in ("coverage", "band", "held_out") if k in row)
    gap = ""
    if "bic_possible" in row:
        gap = f"BIC {row['bic'] - row['bic_possible']:+.1f} to the truth's"
    names = "+".join(row["added"]) or "-"
    return (
        f"{row['key']}: {row['verdict']} {names} | {laws or '-'} | {more} {gap} {row['cpu']:.0f} s"
    )


def read(path: Path) -> list[dict[str, Any]]:
    """All lines; of a case that was run twice, the later."""
    rows = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    return list({row["key"]: row for row in rows}.values())


def run(o: argparse.Namespace) -> None:
    """The cases that the file lacks."""
    done = {row["key"] for row in read(o.out) if not row.get("error")}
    left = [s.key for s in specs(o.what, o.seeds, o.skip) if s.key not in done]
    left = [key for key in left if not o.only or any(x in key for x in o.only)]
    random.Random(0).shuffle(left)
    print(f"{len(left)} cases to do, {len(done)} done before", flush=True)
    left = left[: o.most]
    for i in range(0, len(left), o.batch):
        words = [sys.executable, "-m", "benchmarks.unnamed_laws", "here", str(o.out)]
        subprocess.run([*words, *left[i : i + o.batch]], check=False)


# -- another way -----------------------------------------------------------------------------------

_SHARES = tuple(x / 20 for x in range(1, 20))


def library(_: Any, q: np.ndarray, v: np.ndarray, t: np.ndarray, j: int):
    """Springs, dampers, and the terms of the grammar for a torque of the angle or the rate and for
    a friction of time, on its grids: (joint, variable, factor, kind) and column."""
    x, w, t = q[:, j], v[:, j], t - t[0]
    found = [(f"spring:{JOINTS[j]}", x), (f"damper:{JOINTS[j]}", w)]

    def add(variable: str, factor: str, family: str, column: np.ndarray) -> None:
        found.append((f"{JOINTS[j]} {variable} {factor or '-'} {family}", column))

    for variable, z in (("angle", x / np.abs(x).max()), ("rate", w / np.abs(w).max())):
        for p in (1.5, 2, 3, 5, 7) if variable == "angle" else (1.5, 2, 3, 5):
            add(variable, "", "power", np.sign(z) * np.abs(z) ** p)
        for p in (1, 2, 4) if variable == "angle" else (1, 1.5, 2, 3):
            add(variable, "", "power", np.abs(z) ** p)
        for side in (1, -1):
            add(variable, "", "power", np.maximum(side * z, 0.0) ** 2)
        for width in (0.05, 0.1, 0.2, 0.5):
            add(variable, "", "saturation", np.tanh(z / width))
            add(variable, "", "exponential", np.exp((z - 1) / width))
            add(variable, "", "exponential", np.exp(-(z + 1) / width))
        if variable == "angle":
            for n in range(1, 25):
                add(variable, "", "sine", np.sin(np.pi * n / 2 * z))
                add(variable, "", "sine", np.cos(np.pi * n / 2 * z))
            for centre, width in itertools.product(
                np.arange(-0.9, 1.0, 0.1), (0.05, 0.1, 0.2, 0.4)
            ):
                u = (z - centre) / width
                add(variable, "", "well", u * np.exp(0.5 - 0.5 * u**2))
    u, sign = t / t[-1], np.sign(w)
    add("time", "direction", "constant", sign)
    for p in (1, 2):
        add("time", "direction", "power", sign * u**p)
    for decay in (0.05, 0.1, 0.2, 0.5, 1.0, 2.0):
        add("time", "direction", "exponential", sign * np.exp(-u / decay))
    for centre, width in itertools.product(_SHARES, (0.01, 0.03, 0.1, 0.3)):
        add("time", "direction", "saturation", sign * np.tanh((u - centre) / width))
    return found


def sindy(o: argparse.Namespace) -> None:
    """PySINDy's weak form with those terms, as tuned for `hidden_effects` at this noise."""
    from benchmarks._hidden_sindy import TUNED, Regression, names

    setting, done = TUNED["weak"][NOISE], {row["key"] for row in read(o.out)}
    for spec in specs(o.what, o.seeds, o.skip):
        if spec.key in done:
            continue
        made = spec.make()
        there = Regression(made, setting.window, library)
        found = names(there, "weak", setting.threshold, setting.ridge, setting.cleared)
        row = {"key": spec.key, "what": spec.what, "hidden": list(spec.labels), "terms": found}
        with o.out.open("a") as file:
            file.write(json.dumps(row) + "\n")


def score_sindy(rows: list[dict[str, Any]]) -> str:
    """Largest term at the right joint and of the right variable; the same and all terms at that
    place of the right kind; nothing where nothing is."""
    places, kinds, clean = [], [], []
    for row in rows:
        first = row["terms"][0].split() if row["terms"] else ["-"] * 4
        if row["what"] == "none":
            clean.append(not row["terms"])
        if row["what"] == "unnamed":
            name, _, joint = row["hidden"][0].partition(":")
            kind = rig.UNNAMED[name]
            right = first[:3] == [joint, kind.variable, kind.factor or "-"]
            own = {x.split()[3] for x in row["terms"] if x.split()[:3] == first[:3]}
            places.append(right)
            kinds.append(right and own == kind.families)
    return (f"PySINDy: joint and variable {_share(places)}; kind of formula {_share(kinds)}; "
            f"nothing on clean arms {_share(clean)}")  # fmt: skip


# -- scores ----------------------------------------------------------------------------------------


def right_place(row: dict[str, Any]) -> bool:
    """Whether the law with most of the probability is at the right joint, of the right variable."""
    name, _, joint = row["hidden"][0].partition(":")
    law = leading(row)
    kind = rig.UNNAMED[name]
    return law is not None and law["place"][:2] == [joint, kind.variable]


def leading(row: dict[str, Any]) -> dict[str, Any] | None:
    """The law that has most of the probability."""
    return next((x for x in row["laws"] if x["probability"] > 0.5), None)


def tells(row: dict[str, Any]) -> bool:
    """Whether the readings tell the true law from what was found."""
    return row["bic"] - row["bic_possible"] > TELLS


def right_family(row: dict[str, Any]) -> bool:
    """Whether the formula's terms are of the true law's kind."""
    law = leading(row)
    if law is None or law["formula"] is None or not right_place(row):
        return False
    return set(law["formula"]["terms"]) == rig.UNNAMED[row["hidden"][0].partition(":")[0]].families


def _share(values: list[bool]) -> str:
    return f"{sum(values)} of {len(values)}" if values else "-"


def report(rows: list[dict[str, Any]]) -> str:
    """The tables, in Markdown."""
    from benchmarks._fresh import markdown

    unnamed = [r for r in rows if r["what"] == "unnamed"]
    lines = []
    order = [*rig.UNNAMED, ""]
    for name in order:
        own = [r for r in unnamed if not name or r["hidden"][0].startswith(f"{name}:")]
        if not own:
            continue
        told = [right_family(r) for r in own if right_family(r) or tells(r)]
        held = [r["held_out"] < 1.05 for r in own if "held_out" in r]
        inside = [r["coverage"] for r in own if "coverage" in r]
        lines.append([
            name.replace("_", " ") or "**all**",
            _share([right_place(r) for r in own]),
            _share([right_place(r) for r in own if right_place(r) or tells(r)]),
            f"{100 * np.mean(inside):.0f} %" if inside else "-",
            _share(told),
            _share(held),
        ])  # fmt: skip
    head = ["hidden law", "joint and variable", "where the readings tell",
            "band holds the truth", "kind of formula, where the readings tell",
            "held-out error within 5 %"]  # fmt: skip
    out = [markdown(head, lines)]
    named = [r for r in rows if r["what"] == "named"]
    if named:
        out.append(f"\nnames: no curve ahead in {_share([not leading(r) for r in named])}")
        out += [f"- {_line(r)}" for r in named if leading(r)]
    clean = [r for r in rows if r["what"] == "none"]
    if clean:
        nothing = [not leading(r) and not r["added"] for r in clean]
        out.append(f"clean: nothing found in {_share(nothing)}")
    cpu = [r["cpu"] for r in rows]
    out.append(f"CPU time a diagnosis: median {np.median(cpu):.0f} s, largest {max(cpu):.0f} s")
    return "\n".join(out)


# -- carts -----------------------------------------------------------------------------------------


def carts(folder: Path, wanted: list[str], image: Path | None) -> None:
    """What stays of measured carts after Coulomb friction, each run by itself: the likeliest law,
    and how alike the curves of one spring and load are."""
    import residyn
    from benchmarks.measured_diagnosis import cart, carts_of

    residyn.set_up()
    found: dict[str, list[Any]] = {}
    for path in sorted((folder / "carts").glob("*.csv")):
        group = path.stem.rpartition("_")[0]
        if wanted and group not in wanted:
            continue
        experiment = carts_of(cart(path))
        answer = residyn.diagnose(experiment, effects=["coulomb_friction:cart"], max_effects=0)
        print(f"{path.stem}: {answer.verdict}", flush=True)
        for law in answer.laws:
            size = float(np.sqrt(np.sum(law.visits * law.mean**2)))
            formula = law.formula and law.formula.to_dict()
            place = f"{law.factor or 1} f({law.variable}) {law.probability:.3f}"
            told = f"{law.log_evidence:.0f} nats, rms {size:.3g} {law.unit}"
            print(f"  {place}, {told}, {formula}", flush=True)
        found.setdefault(group, []).extend(answer.laws[:1])
    for group, laws in found.items():
        print(f"{group}: {alike(laws)}", flush=True)
    if image is not None:
        figure = picture([law for laws in found.values() for law in laws])
        figure.savefig(image, facecolor="white", bbox_inches="tight", metadata={"Date": None})


def picture(laws: list[Any]) -> Any:
    """The curves of some runs with their bands."""
    from matplotlib.figure import Figure

    from residyn.reporting.figures.style import FAINT, INK, JOINTS, WIDE, styled

    @styled
    def drawn() -> Figure:
        figure = Figure(figsize=(WIDE, 3.4), layout="constrained")
        axes = figure.subplots()
        for i, (law, colour) in enumerate(zip(laws, (JOINTS[0], JOINTS[1], INK), strict=False)):
            x, band = 1e3 * law.grid, 1.96 * law.std
            low, high = law.mean - band, law.mean + band
            axes.fill_between(x, low, high, color=colour, alpha=0.2, lw=0)
            axes.plot(x, law.mean, color=colour, lw=1.2, label=f"run {i + 1}")
        axes.axhline(0.0, color=FAINT, lw=0.6, zorder=0)
        axes.set(xlabel="position (mm)", ylabel=f"beside spring and friction ({laws[0].unit})")
        axes.legend()
        return figure

    return drawn()


def alike(laws: list[Any]) -> str:
    """How often two runs' curves of one variable are within their 95 % bands of each other, over
    the range that both visited, each less the line there."""
    words = []
    for i, one in enumerate(laws):
        for other in laws[i + 1 :]:
            if (one.variable, one.factor) != (other.variable, other.factor):
                words.append("not of one variable")
                continue
            low, high = max(one.grid[0], other.grid[0]), min(one.grid[-1], other.grid[-1])
            x = np.linspace(low, high, 101)
            a, b = (np.interp(x, law.grid, law.mean) for law in (one, other))
            s, t = (np.interp(x, law.grid, law.std) for law in (one, other))
            line = np.polynomial.Polynomial.fit(x, a - b, 1)
            off = np.abs(a - b - line(x)) / np.sqrt(s**2 + t**2)
            share = np.corrcoef(a, b)[0, 1]
            words.append(f"{np.mean(off < 1.96):.0%} within the bands, correlation {share:.3f}")
    return "; ".join(words) or "nothing to compare"


def main() -> None:
    """The command."""
    if sys.argv[1:2] == ["here"]:
        here(Path(sys.argv[2]), sys.argv[3:])
        return
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="command", required=True)
    for name in ("run", "sindy"):
        own = commands.add_parser(name)
        own.add_argument("--seeds", choices=list(SEEDS), default="tuning")
        own.add_argument("--what", nargs="+", choices=WHAT, default=list(WHAT))
        own.add_argument("--only", nargs="+", default=[], metavar="TEXT", help="part of a name")
        own.add_argument("--skip", type=int, default=0, help="seeds to pass over")
        own.add_argument("--batch", type=int, default=12, help="cases of one process")
        own.add_argument("--most", type=int, help="cases to do now")
        own.add_argument("--out", type=Path, required=True, help="JSON lines; not for git")
    told = commands.add_parser("report")
    told.add_argument("file", type=Path)
    told.add_argument("--beside", type=Path, help="of sindy")
    measured = commands.add_parser("carts")
    measured.add_argument("folder", type=Path, help="with carts/ in it")
    measured.add_argument("--picture", type=Path, help="of the curves, SVG or PNG")
    measured.add_argument("groups", nargs="*", help="high_spring_bare, ...; all if none is given")
    o = parser.parse_args()
    if o.command == "carts":
        carts(o.folder, o.groups, o.picture)
        return
    if o.command == "report":
        rows = read(o.file)
        for row in (r for r in rows if r.get("error")):
            print(_line(row))
        print(report([r for r in rows if not r.get("error")]))
        if o.beside:
            print(score_sindy(read(o.beside)))
        return
    {"run": run, "sindy": sindy}[o.command](o)


if __name__ == "__main__":
    main()

"""The house plan: imports run one way, physics needs JAX alone, importing changes nothing."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[1] / "src" / "residyn"

# Each layer may import from those before it, and from within itself.
LAYERS = [
    ["ahead", "kept", "_cache", "_input", "_json", "_threads", "_units", "parameter", "motion"],
    ["mechanism", "bearings"],
    ["effects"],
    ["model"],
    ["modal"],
    ["equation"],
    ["stick_slip"],
    ["stepping", "nodes"],
    ["integrators"],
    ["simulation"],
    [
        "recording",
        "_arrays",
        "_columns",
        "_csv",
        "_doubts",
        "_lab_files",
        "_labels",
        "_marker_checks",
        "_mended",
        "_new",
        "_noise",
        "_plane",
        "_release",
        "_rest",
        "_rigid",
        "_sanity",
        "_spectrum",
        "_stretches",
        "_tables",
        "_toml",
        "_trajectories",
        "_wild",
        "motion_capture",
    ],
    ["fitting"],
    ["filtering"],
    ["diagnosis"],
    ["procedure"],
    ["explorer"],
    ["_verdict", "plot", "report"],
    ["demo"],
    ["cli"],
]
PHYSICS = ["parameter", "motion", "mechanism", "bearings", "effects", "model"]
PHYSICS_MAY = {"jax", "equinox", "jaxtyping"}
# Steps upwards, taken when they are called: `mechanism + effect` builds a Model, and a result
# prints itself in words that stand in `report`.
UPWARDS = {("mechanism", "model"), ("diagnosis", "report")}
RANK = {name: rank for rank, layer in enumerate(LAYERS) for name in layer}


def modules():
    for path in sorted(SOURCE.rglob("*.py")):
        parts = path.relative_to(SOURCE).with_suffix("").parts
        if parts not in {("__init__",), ("__main__",)}:
            yield path, parts


def imported(path, parts):
    """(top part of a residyn module or None, name of an outside package) of each import."""
    guarded = set()
    tree = ast.parse(path.read_text())
    for node in ast.walk(tree):  # what only the type checker reads is no dependency
        if isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING":
            guarded |= set(ast.walk(node))
    for node in ast.walk(tree):
        if node in guarded:
            continue
        if isinstance(node, ast.ImportFrom) and node.level:
            package = ["residyn", *parts[:-1]]
            base = package[: len(package) - node.level + 1] + (node.module or "").split(".")
            names = [base[1]] if len(base) > 1 and base[1] else [a.name for a in node.names]
            yield from ((name, None) for name in names)
        elif isinstance(node, ast.ImportFrom):
            yield None, (node.module or "").split(".")[0]
        elif isinstance(node, ast.Import):
            yield from ((None, alias.name.split(".")[0]) for alias in node.names)


@pytest.mark.parametrize(("path", "parts"), list(modules()), ids=lambda x: getattr(x, "name", None))
def test_imports_run_one_way(path, parts):
    me = parts[0]
    for ours, outside in imported(path, parts):
        if ours is not None and ours != me and ours != "__version__":
            if (me, ours) in UPWARDS:
                continue
            assert RANK[ours] <= RANK[me], f"{me} imports {ours}"
        if me in PHYSICS and outside is not None:
            known = outside in PHYSICS_MAY or outside in sys.stdlib_module_names
            assert known, f"{me} is physics and imports {outside}"
        if me not in ("integrators", "simulation") and outside == "diffrax":
            pytest.fail(f"{me} imports diffrax: only what integrates does")


def module_imports():
    """Per module, the modules of this package that it imports when it is imported itself."""
    known = {".".join(parts): path for path, parts in modules()}
    found = {}
    for path, parts in modules():
        name = ".".join(parts)
        found[name] = set()
        for node in ast.parse(path.read_text()).body:
            if not (isinstance(node, ast.ImportFrom) and node.level):
                continue
            package = parts[:-1]  # of an `__init__` too: its name is the last part
            base = package[: len(package) - node.level + 1]
            base = (*base, *(node.module or "").split(".")) if node.module else base
            for alias in node.names:
                for each in ((*base, alias.name), base, (*base, "__init__")):
                    if ".".join(each) in known:
                        found[name].add(".".join(each))
                        break
    return found


@pytest.mark.parametrize("folder", ["filtering", "diagnosis", "report", "plot"])
def test_no_cycle_inside_a_folder(folder):
    graph = {a: {b for b in to if b != a} for a, to in module_imports().items()}
    inside = {a for a in graph if a.startswith(f"{folder}.") and not a.endswith("__init__")}
    while inside:  # take away what imports nothing of the rest, until nothing is left
        free = {a for a in inside if not graph[a] & inside}
        assert free, f"a cycle among {sorted(inside)}"
        inside -= free


def test_every_module_has_a_place():
    assert {parts[0] for _, parts in modules()} <= set(RANK)


def test_importing_changes_no_setting_and_draws_nothing():
    code = (
        "import jax; before = dict(jax.config.values); import residyn, sys;"
        "assert dict(jax.config.values) == before;"
        "assert 'matplotlib' not in sys.modules; assert 'typer' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)

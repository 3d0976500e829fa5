"""The house plan: imports run one way, physics needs JAX alone, importing changes nothing."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[1] / "src" / "residyn"

# Each folder (or module of the top level) may import from those before it, and from within itself.
HOUSE = [
    "errors",
    "files",
    "runtime",
    "physics",
    "effects",
    "simulation",
    "recordings",
    "fitting",
    "filtering",
    "diagnosis",
    "procedure",
    "reporting",
    "parameter",
    "recording",
    "plot",
    "demo",
    "cli",
]
RANK = {name: rank for rank, name in enumerate(HOUSE)}
PHYSICS_MAY = {"jax", "equinox", "jaxtyping", "numpy"}
# The one step upwards: a result looks up by name, when it is printed, what is written about it.
# Text is for people and changes often; results must not depend on it, and `print(fit)` must work.
HOOK = ("runtime", "presentation")


def modules():
    for path in sorted(SOURCE.rglob("*.py")):
        parts = path.relative_to(SOURCE).with_suffix("").parts
        if parts not in {("__init__",), ("__main__",)}:
            yield parts, ast.parse(path.read_text())


TREES = dict(modules())


def imports(parts):
    """Every import of a module, wherever it stands, those for type checkers included: (parts of a
    module of this package or None, name of an outside package or None)."""
    for node in ast.walk(TREES[parts]):
        if isinstance(node, ast.ImportFrom) and node.level:
            folder = parts[: len(parts) - node.level]
            base = (*folder, *(node.module.split(".") if node.module else ()))
            for alias in node.names:
                name = *base, alias.name
                places = name, (*name, "__init__"), base, (*base, "__init__")
                yield next((m for m in places if m in TREES), None), None
        elif isinstance(node, ast.ImportFrom):
            yield None, (node.module or "").split(".")[0]
        elif isinstance(node, ast.Import):
            yield from ((None, alias.name.split(".")[0]) for alias in node.names)


@pytest.mark.parametrize("parts", TREES, ids=".".join)
def test_imports_run_one_way(parts):
    for ours, outside in imports(parts):
        if ours is not None:
            assert RANK[ours[0]] <= RANK[parts[0]], f"{'.'.join(parts)} imports {'.'.join(ours)}"
        if parts[0] in ("physics", "effects") and outside is not None:
            known = outside in PHYSICS_MAY or outside in sys.stdlib_module_names
            assert known, f"{'.'.join(parts)} is physics and imports {outside}"
        if parts[0] != "simulation" and outside == "diffrax":
            pytest.fail(f"{'.'.join(parts)} imports diffrax: only what integrates does")


def test_no_cycle():
    """In the whole package, not even one that only a type checker sees."""
    graph = {a: {b for b, _ in imports(a) if b is not None and b != a} for a in TREES}
    left = set(graph)
    while left:  # take away what imports nothing of the rest, until nothing is left
        free = {a for a in left if not graph[a] & left}
        assert free, f"a cycle among {sorted('.'.join(a) for a in left)}"
        left -= free


def test_one_module_reaches_upwards_and_by_name_alone():
    """No other module of the package imports a part of it by a name in a string, where the tests
    above would not see it."""
    by_name = {
        parts
        for parts, tree in TREES.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Attribute)
        and node.func.attr == "import_module"
        and any("residyn" in ast.unparse(a) or "__package__" in ast.unparse(a) for a in node.args)
    }
    assert by_name == {HOOK}


def test_every_module_has_a_place():
    assert {parts[0] for parts in TREES} == set(RANK)


def test_tests_mirror_the_tree():
    """A folder of tests is one of the package. Beside the folders: what concerns no single one."""
    here = Path(__file__).parent
    for path in here.rglob("test_*.py"):
        folder = path.parent.relative_to(here)
        assert (SOURCE / folder).is_dir(), f"no folder residyn/{folder} for {path.name}"


# Private names that tests use, and why.
PRIVATE_AND_USED = {
    "residyn.cli._": "a command's file has the command's name with _ before it; `main` is public",
    "jax._src": "JAX tells nowhere else how many programs it has compiled",
}
PRIVATE = re.compile(r"\b(?!self\b|cls\b)[a-z]\w*(?:\.\w+)*\._(?!_|replace\b|asdict\b|fields\b)\w+")


def names_used(tree):
    """What is imported from this package, every attribute, and the strings that say what to
    replace."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("residyn"):
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Attribute):
            yield ast.unparse(node)
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("setattr"):
            words = [str(a.value) for a in node.args[:2] if isinstance(a, ast.Constant)]
            yield ".".join(words if len(words[0].split(".")) > 1 else ["patched", *words])


def test_tests_use_public_names():
    """What a test needs of a module is part of the module's interface."""
    used = {
        (path.name, found[0])
        for path in Path(__file__).parent.rglob("*.py")
        for name in names_used(ast.parse(path.read_text()))
        if (found := PRIVATE.match(name))
    }
    assert not {(p, n) for p, n in used if not n.startswith(tuple(PRIVATE_AND_USED))}
    assert all(any(n.startswith(kind) for _, n in used) for kind in PRIVATE_AND_USED)


def test_importing_changes_no_setting_and_draws_nothing():
    code = (
        "import jax; before = dict(jax.config.values); import residyn, sys;"
        "assert dict(jax.config.values) == before;"
        "assert 'matplotlib' not in sys.modules; assert 'typer' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_fit_and_its_words_import_no_diagnosis():
    """It would be a twentieth of a short command's time."""
    code = (
        "import sys; import residyn.fitting.fit, residyn.reporting.fit;"
        "assert not [x for x in sys.modules if x.startswith('residyn.diagnosis')]"
    )
    subprocess.run([sys.executable, "-c", code], check=True)

"""What the site's build adds to the pages: outputs, pictures, the catalogue, the public names.

None of this is in the repository, so none of it can be out of date. A page's code is run where the
page shows what comes of it (`blocks.py`), and so is every notebook's (`notebooks.py`); what it
draws is found under `made/PAGE/`. Everything is kept in `.cache/docs` until the package or the page
changes. `RESIDYN_DOCS=words` leaves out what takes time, for a look at words and links alone.
"""

import ast
import hashlib
import html
import importlib
import inspect
import itertools
import os
import pkgutil
import re
import shutil
import tempfile
from pathlib import Path

import blocks
import notebooks
from mkdocs.structure.files import File

ROOT = Path(__file__).parents[1]
CACHE = ROOT / ".cache" / "docs"
WORDS_ONLY = os.environ.get("RESIDYN_DOCS") == "words"
_PLACEHOLDER = (
    '<svg xmlns="http://www.w3.org/2000/svg" width="300" height="40">'
    '<text x="4" y="24">left out: RESIDYN_DOCS=words</text></svg>'
)
_MADE = re.compile(r"\]\((made/[\w./-]+)\)")
_printed: dict[str, list[str]] = {}
# Pages of the repository that the site shows too; links to them are those of the repository.
_ELSEWHERE = {"benchmarks/README.md": "benchmarks.md", "CONTRIBUTING.md": "contributing.md"}


# -- what mkdocs calls -----------------------------------------------------------------------


def on_files(files, config):
    """Add what the pages' code makes, and the pictures of the catalogue."""
    for path, uri in _ELSEWHERE.items():
        text = (ROOT / path).read_text(encoding="utf-8").replace("](../docs/", "](")
        files.append(File.generated(config, uri, content=text))
    for file in list(files.documentation_pages()):
        if file.src_uri in _ELSEWHERE.values():
            continue
        text = Path(file.abs_src_path).read_text(encoding="utf-8")
        stem = Path(file.src_uri).stem
        made: dict[str, bytes] = {}
        if "<!-- catalogue -->" in text:
            made |= {f"made/{stem}/{name}": data for name, data in _pictures().items()}
        if "<!-- output" in text or _MADE.search(text):
            _printed[stem], more = _ran(text, file.src_uri)
            made |= {f"made/{stem}/{name}": data for name, data in more.items()}
        if WORDS_ONLY:
            made |= {link: _PLACEHOLDER.encode() for link in _MADE.findall(text)}
        for uri, data in made.items():
            files.append(File.generated(config, uri, content=data))
    for path in notebooks.paths(ROOT):
        folder = _notebook(path)
        page = notebooks.page(path, folder)
        files.append(File.generated(config, f"{notebooks.SITE}/{path.stem}.md", content=page))
        for picture in sorted(folder.glob("*.svg")) if folder else ():
            uri = f"made/{path.stem}/{picture.name}"
            files.append(File.generated(config, uri, content=picture.read_bytes()))
    return files


def on_page_markdown(markdown, page, config, files):
    """Put outputs, the catalogue and the public names where the page asks for them."""
    stem = Path(page.file.src_uri).stem
    markdown = notebooks.on_the_site(markdown)
    for path, uri in _ELSEWHERE.items():
        markdown = markdown.replace(f"](../{path}", f"]({uri}")
    if stem in _printed:
        markdown = _with_outputs(markdown, _printed[stem])
    if "<!-- catalogue -->" in markdown:
        markdown = markdown.replace("<!-- catalogue -->", _catalogue(stem))
    if "<!-- public names -->" in markdown:
        markdown = markdown.replace("<!-- public names -->", _public_names())
    return markdown


# -- what is kept ----------------------------------------------------------------------------


def _kept(name: str, text: str, make) -> Path:
    """A folder that `make` fills, made again when the package or the text has changed."""
    digest = hashlib.sha256(text.encode())
    data = [p for p in (ROOT / "src").rglob("*") if p.suffix in (".py", ".toml", ".csv", ".j2")]
    for path in sorted([*data, *Path(__file__).parent.glob("*.py")]):
        digest.update(path.read_bytes())
    folder = CACHE / f"{name}-{digest.hexdigest()[:16]}"
    if not folder.exists():
        from residyn import set_up

        set_up()
        for old in CACHE.glob(f"{name}-*"):
            shutil.rmtree(old)
        with tempfile.TemporaryDirectory() as work:
            make(Path(work))
            shutil.copytree(work, folder)
    return folder


# -- outputs ---------------------------------------------------------------------------------


def _ran(text: str, name: str) -> tuple[list[str], dict[str, bytes]]:
    """What each block of a page prints, and the pictures and reports that they make."""
    if WORDS_ONLY:
        return [], {}

    def make(folder: Path) -> None:
        printed = blocks.run(text, name, folder)
        (folder / "printed.txt").write_text("\0".join(printed), encoding="utf-8")

    folder = _kept(Path(name).stem, text, make)
    printed = (folder / "printed.txt").read_text(encoding="utf-8").split("\0")
    return printed, {p.relative_to(folder).as_posix(): p.read_bytes() for p in _made(folder)}


def _made(folder: Path) -> list[Path]:
    return blocks.made_in(folder)


def _notebook(path: Path) -> Path | None:
    """What a notebook prints and draws."""
    if WORDS_ONLY:
        return None
    text = path.read_text(encoding="utf-8")
    return _kept(path.stem, text, lambda folder: notebooks.made(notebooks.run(path), folder))


def _with_outputs(markdown: str, printed: list[str]) -> str:
    found = blocks.blocks(markdown)
    for block, words in reversed(list(zip(found, printed, strict=bool(printed)))):
        if block.output is None:
            continue
        lines = [line.rstrip() for line in words.rstrip().splitlines()]
        first, last = (
            next((i for i, x in enumerate(lines) if edge and x.startswith(edge)), None)
            for edge in block.output
        )
        lines = lines[:last] + ([] if last is None else ["..."])
        lines = lines if not first else ["...", *lines[first:]]
        _, end = block.span
        shown = "\n".join(['```{ .text .output title="prints" }', *lines, "```"])
        markdown = f"{markdown[:end]}\n\n{shown}\n{markdown[end:]}"
    return markdown


# -- the catalogue ---------------------------------------------------------------------------

_GROUPS = (
    (
        "The base model",
        "In every model already. Drawn: what a model without it would miss.",
    ),
    ("At a joint", "Named `NAME:JOINT`; `NAME` alone puts one at every joint."),
    ("In the sensors", "They change the reading and leave the motion alone."),
    ("Of the whole mechanism", "Named without a joint."),
)
_COLUMNS = 4
_POINTS = 1600  # of a curve: more only make the file heavier
_SHARP = 0.12  # share of a torque's variance that its natural axis may leave unexplained
_BINS = 60
_OVERSHOOT = 7  # samples


def _group(kind) -> int:
    from residyn.effects import JointEffect

    if kind.name in ("spring", "damper"):
        return 0
    return 3 if not issubclass(kind, JointEffect) else 2 if kind.senses else 1


def _grouped() -> list[tuple[str, str, list]]:
    from residyn.effects import CATALOGUE

    kinds = list(CATALOGUE.values())
    each = [(t, w, [k for k in kinds if _group(k) == i]) for i, (t, w) in enumerate(_GROUPS)]
    return [group for group in each if group[2]]


def _pictures() -> dict[str, bytes]:
    """An overview of each group, and each effect's own picture."""
    names = [f"group{i}.svg" for i in range(len(_grouped()))]
    names += [f"{kind.name}.svg" for _, _, kinds in _grouped() for kind in kinds]
    if WORDS_ONLY:
        return dict.fromkeys(names, _PLACEHOLDER.encode())

    def make(folder: Path) -> None:
        import functools

        from residyn.reporting import figures as plot
        from residyn.reporting.figures import effect

        # At the strength that it would have, the arm gains energy and flies apart.
        motions = functools.cache(effect._motions)
        effect._motions = motions  # an overview and a picture share one simulation
        for i, (_, _, kinds) in enumerate(_grouped()):
            _overview(kinds, motions).savefig(folder / f"group{i}.svg")
            for kind in kinds:
                plot.signature(kind.name).savefig(folder / f"{kind.name}.svg")

    folder = _kept("catalogue", "", make)
    return {name: (folder / name).read_bytes() for name in names}


def _overview(kinds, motions):
    """Small multiples: the torque of each effect against its natural axis."""
    import jax
    import numpy as np
    from matplotlib.figure import Figure

    from residyn.reporting.figures.style import FAINT, RESIDUAL, WIDE, styled

    @styled
    def draw() -> Figure:
        columns = min(_COLUMNS, len(kinds))
        rows = -(-len(kinds) // columns)
        size = (WIDE * columns / _COLUMNS, 1.95 * rows + 0.1)
        figure = Figure(figsize=size, layout="constrained")
        axes = figure.subplots(rows, columns, squeeze=False).ravel()
        for ax in axes[len(kinds) :]:
            ax.remove()
        for ax, kind in zip(axes, kinds, strict=False):
            with jax.enable_x64(True):
                t, _, _, angle, rate, torque = motions(kind.name)
            x, label, tau = _natural(kind, t, angle, rate, torque)
            most = 1.08 * float(np.max(np.abs(tau))) or 1.0
            thin = slice(None, None, max(1, len(x) // _POINTS))
            ax.axhline(0.0, color=FAINT, lw=0.6)
            ax.plot(x[thin], tau[thin], RESIDUAL, lw=0.9)
            ax.set(xlabel=label, ylim=(-most, most))
            ax.set_title(kind.name, fontsize=9)
            ax.locator_params(nbins=3)
        for ax in axes[: len(kinds) : columns]:
            ax.set_ylabel("torque (N m)")
        return figure

    return draw()


def _natural(kind, t, angle, rate, torque):
    """The axis on which an effect's torque is most nearly a line, and the torque against it: of a
    torque that remembers, the angle (it draws a loop); of one that none explains, time."""
    import numpy as np
    from scipy.signal import medfilt

    from residyn.effects import JointEffect

    joint = int(np.argmax(np.sqrt(np.mean(torque**2, axis=0))))
    # A torque that jumps overshoots for a sample or two where it was had from differences.
    tau = medfilt(torque[:, joint], _OVERSHOOT)
    if kind.oscillates or np.std(tau) < 1e-2 * np.abs(np.mean(tau)):
        return t, "time (s)", tau
    joints, alone = ("shoulder", "elbow"), issubclass(kind, JointEffect)
    axes = {}
    for j in (joint,) if alone else (joint, 1 - joint):
        axes[f"{joints[j]} angle (rad)"] = angle[:, j]
        axes[f"{joints[j]} rate (rad/s)"] = rate[:, j]
    if not alone:
        axes["rate of link 2 (rad/s)"] = rate.sum(axis=1)
        axes[f"{joints[joint]} acceleration (rad/s²)"] = np.gradient(rate[:, joint], t)
    left = {label: _scatter(x, tau) for label, x in axes.items()}
    best = min(left, key=lambda label: left[label])
    if alone and kind.memory:
        best = f"{joints[joint]} angle (rad)"
    elif left[best] > _SHARP:
        return t, "time (s)", tau
    return axes[best], best, tau


def _scatter(x, tau) -> float:
    """Share of a torque's variance that is no function of x. Every stretch of x counts alike, so
    that a joint that sticks, at rate 0, is one stretch."""
    import numpy as np

    place = np.minimum((x - x.min()) / np.ptp(x) * _BINS, _BINS - 1).astype(int)
    parts = [tau[place == i] for i in range(_BINS)]
    within = np.array([np.var(p) for p in parts if len(p) > 1])
    between = np.var([np.mean(p) for p in parts if len(p)])
    return float(within.mean() / (within.mean() + between))


def _catalogue(stem: str) -> str:
    parts = []
    for i, (title, words, kinds) in enumerate(_grouped()):
        names = ", ".join(kind.name for kind in kinds)
        parts.append(f"## {title}\n\n{words}\n")
        parts.append(
            f"![Torque of {names}, each against its natural axis](made/{stem}/group{i}.svg)\n"
        )
        parts += [_effect(kind, stem) for kind in kinds]
    return "\n".join(parts)


def _effect(kind, stem: str) -> str:
    from residyn.physics.parameter import parameters_of

    lines = [f"### {kind.name}", ""]
    lines += [
        _plain(" ".join(p.split())) + "\n" for p in inspect.cleandoc(kind.__doc__).split("\n\n")
    ]
    lines += [f"`{kind.equation}`{{ .equation }}", ""]
    lines += [f"In the data: {_plain(kind.looks_like)}.", ""]
    lines += ["| number | what it is | unit | sign | absent at |", "|---|---|---|---|---|"]
    for p in parameters_of(kind):
        words = p.words if p.fitted else f"{p.words} (not fitted)"
        absent = "(a shape)" if p.silent is None else f"{p.silent:g}"
        sign = "not negative" if p.sign == "positive" else "any"
        unit = " or ".join(dict.fromkeys((p.dimension.rotary, p.dimension.sliding)))
        unit = "-" if unit == "1" else _units(unit)
        lines.append(f"| `{p.name}` | {_plain(words)} | {unit} | {sign} | {absent} |")
    lines += ["", " ".join([*_properties(kind), f"Source: {_plain(kind.source)}."]), ""]
    lines += [
        f"![{kind.name}: reading with and without it, and the missing torque against time, angle "
        f"and rate](made/{stem}/{kind.name}.svg){{ loading=lazy }}",
        "",
    ]
    return "\n".join(lines)


def _properties(kind) -> list[str]:
    found = ["It never adds energy." if kind.dissipates else ""]
    found.append("It is dry: it lets a joint stick." if kind.dry else "")
    if kind.memory:
        found.append(f"It remembers: {', '.join(each.name for each in kind.memory)}.")
    found.append("It leaves with the air bearings." if kind.of_bearings else "")
    return [each for each in found if each]


def _units(unit: str) -> str:
    return unit.replace("^2", "²").replace("^3", "³")


def _plain(words: str) -> str:
    """Words that Markdown shall show as they are, but for what is in backticks."""
    parts = words.split("`")
    for i in range(0, len(parts), 2):
        parts[i] = re.sub(r"([*_|\[\]\\])", r"\\\1", html.escape(parts[i], quote=False))
    return "`".join(parts)


# -- the public names ------------------------------------------------------------------------


def _public_names() -> str:
    """Headings and directives for mkdocstrings: every name of the package, then what its
    subpackages offer beside."""

    import residyn

    parts, told = [], set()
    stub = ast.parse(Path(residyn.__file__).with_suffix(".pyi").read_text())
    homes = [node for node in stub.body if isinstance(node, ast.ImportFrom) and node.module]
    for home, names in itertools.groupby(homes, key=lambda node: node.module):
        names = [alias.name for node in names for alias in node.names]
        told |= set(names)
        words = _first(importlib.import_module(f"residyn.{home}"))
        parts.append(f"## residyn: {home}\n\n{words}\n")
        parts += [f"::: {_home(residyn, name)}\n" for name in names]
    for info in pkgutil.iter_modules(residyn.__path__):
        if not info.ispkg or info.name.startswith("_") or info.name == "cli":
            continue
        whole = f"residyn.{info.name}"
        module = importlib.import_module(whole)
        # `import x as x` is how the package says that a name is meant for others.
        meant = set(re.findall(r"import (\w+) as \1\b", inspect.getsource(module)))
        own = [
            name
            for name, value in vars(module).items()
            if name not in told
            and (inspect.isclass(value) or inspect.isfunction(value))
            and (name in meant or (value.__module__ == whole and not name.startswith("_")))
        ]
        if own:
            parts.append(f"## {whole}\n\n{_first(module)}\n")
            parts += [f"::: {_home(module, name)}\n" for name in own]
    return "\n".join(parts)


def _home(module, name: str) -> str:
    """Where a name is defined: some functions share their names with the module that they are in,
    and mkdocstrings would take the module."""
    value = getattr(module, name)
    if inspect.isclass(value) or inspect.isfunction(value):
        return f"{value.__module__}.{value.__qualname__}"
    return f"{module.__name__}.{name}"


def _first(module) -> str:
    return _plain(" ".join(inspect.getdoc(module).split("\n\n")[0].split()))

"""The page: the same template, style and scripts for the live server and for a report.

Live, scripts are files of the server. In a report everything stands in the page: the modules as
`data:` addresses of an import map, the data as JSON that no markup can leave.
"""

import base64
import importlib.resources
import re
from pathlib import PurePath
from typing import Any

import jax
import jinja2
import markupsafe

from ...diagnosis.result import Diagnosis
from .payload import packed, payload
from .study import Study

_STATIC = importlib.resources.files("residyn.reporting.explorer") / "static"
FILES = tuple(sorted(each.name for each in _STATIC.iterdir()))
"""All that the server hands out."""
MODULES = tuple(n for n in FILES if n.endswith(".js") and not n.startswith("uPlot"))
"""One idea each; `explorer.js` starts the page."""
_SPARE = re.compile(r"^\s*//[^\n]*\n|^\s*/\*.*?\*/\n|^[ ]+", re.M | re.S)
_IMPORT = re.compile(r'(from\s+|import\s+)"\./([a-z_]+\.js)"')


def static(name: str) -> str:
    return (_STATIC / name).read_text(encoding="utf-8")


def environment(folder: str) -> jinja2.Environment:
    """The templates in a folder of the package; all words that they are given are escaped."""
    found = jinja2.Environment(
        loader=jinja2.PackageLoader("residyn", folder),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    found.policies["json.dumps_kwargs"] = {"ensure_ascii": False, "allow_nan": False}
    return found


def _filled(template: str, **given: Any) -> str:
    return environment("reporting/explorer/templates").get_template(template).render(given)


def live(name: str) -> str:
    """The page of the server; `name` of the experiment."""
    return _filled("live.html.j2", name=name)


def embedded(found: Diagnosis) -> str:
    """The explorer of a diagnosis, as a piece of HTML for the body of a page: styles, scripts and
    data inside, nothing fetched. It shows nothing where scripts do not run, and is not printed.

    **Returns:** HTML, or nothing if the diagnosis has not kept its search.
    """
    if found.search is None:
        return ""
    name = PurePath(found.fits.whole.path or "experiment.toml").name
    with jax.enable_x64(True):
        return piece(payload(Study.of(found), name=name))


def piece(data: dict[str, Any]) -> str:
    """The explorer of a payload, as a piece of HTML for the body of a page."""
    addresses = {f"explorer/{name}": _address(static(name)) for name in MODULES}
    return _filled(
        "embedded.html.j2",
        styles=[markupsafe.Markup(static(n)) for n in ("uPlot.min.css", "explorer.css")],
        licence=static("uPlot.LICENSE.txt").splitlines()[2],
        uplot=markupsafe.Markup(static("uPlot.iife.min.js")),
        modules={"imports": addresses},
        payload=packed(data),
    )


def _address(script: str) -> str:
    """A module as an address, without comments and indents; what it imports goes by the names of
    the import map."""
    text = _IMPORT.sub(r'\1"explorer/\2"', _SPARE.sub("", script))
    return "data:text/javascript;base64," + base64.b64encode(text.encode()).decode()

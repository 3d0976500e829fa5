"""What an experiment file says, before any recording is read.

The file has one table of inertia, `[arm]` or `[inertia]`, which free motion cannot tell; the air
bearings that the arm rides on; and its recordings. Every key is known and has a meaning, so a key
that is not known is a mistake and never ignored.
"""

import dataclasses
import inspect
import json
import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from ..errors import InputError, did_you_mean, flag, inside, quote
from ..simulation.integrator import Integrator
from .columns import Layout
from .limits import Limits
from .recording import Recording, check_role
from .tables import ArmTable, Bearing, InertiaTable

_TABLES = ("arm", "inertia", "air_bearings", "recordings", "integrator", "limits")
_MANY = ("air_bearings", "recordings")
_WORDS = ("file", "columns", "separator", "decimal", "markers")  # keys of words
_OF_A_LINK = re.compile(r"(mass|inertia|length|com|link|rho|[mlcrij])[_a-z]*\d?", re.I)
_INERTIAS = (
    "from masses m, lengths l, centres of mass c (from their joint) and inertias J about these: "
    "shoulder = J1 + m1 c1^2 + m2 l1^2, elbow = J2 + m2 c2^2, coupling = m2 c2 (docs/lab-files.md)"
)


def parse(text: str, where: str) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """The fields of an `Experiment` that its file's text says, `where` being its name; and the keys
    of each `[[recordings]]`, most of their values unchecked yet."""
    with inside(where):
        tables = _tables(text)
        _check_keys("the file", tables, _TABLES)
        _check_filled_in(tables)
        recordings = _many(tables, "recordings", _RECORDING)
        if not recordings:
            raise InputError("there is no [[recordings]] table: nothing to work on")
        if ("arm" in tables) == ("inertia" in tables):
            have = "both [arm] and [inertia]" if "arm" in tables else "neither [arm] nor [inertia]"
            raise InputError(
                f"has {have}: give one, [arm] for two links or [inertia] for any matrix"
            )
        for i, entry in enumerate(recordings):
            with inside(f"[[recordings]] {i + 1}"):
                _check_recording(entry, "arm" in tables, bool(tables.get("air_bearings")))
        roles = {entry.get("role", "fit") for entry in recordings}
        if roles == {"check"}:
            raise InputError(
                'every recording has role = "check", so there is nothing to fit: '
                'at least one must have role = "fit" or "inertia"'
            )
        inertia = _one(tables, "arm", ArmTable) or _one(tables, "inertia", InertiaTable)
        if isinstance(inertia, ArmTable) and inertia.missing and roles != {"inertia"}:
            raise InputError(
                f"[arm]: {', '.join(inertia.missing)} missing: free motion fixes only the ratios "
                "of stiffness and damping to inertia (Eq. 9), so inertia must be measured first: "
                '`residyn inertia` finds it from driven recordings with role = "inertia", in a '
                "file of their own"
            )
        bearings = []
        for i, entry in enumerate(_many(tables, "air_bearings", _keys_of(Bearing))):
            with inside(f"[[air_bearings]] {i + 1}"):
                bearings.append(_made(Bearing, entry))
        limits = _one(tables, "limits", Limits)
        if limits is not None:
            with inside("[limits]"):
                limits.check(inertia.joints, "arm" in tables, bool(bearings))
        integrator = _one(tables, "integrator", _integrator, ("solver", "rtol", "atol"))
        fields = {"inertia": inertia, "bearings": bearings, "limits": limits}
        return fields | {"integrator": integrator}, recordings


def _tables(text: str) -> dict[str, Any]:
    try:
        return tomllib.loads(text.replace("\r\n", "\n"))
    except tomllib.TOMLDecodeError as error:
        # "... (at line 3, column 5)" or "... (at end of document)"
        place = r"^(.*) \(at (?:line (\d+), column \d+|end of document)\)$"
        found = re.search(place, str(error), re.S)
        what, line = found.groups() if found else (error, None)
        line = int(line or text.rstrip().count("\n") + 1)
        what = _in_words(text.split("\n")[line - 1], str(what))
        raise InputError(f"line {line}: {what}") from None
    except RecursionError:
        raise InputError("is not TOML of an experiment: brackets are nested too deep") from None
    except ValueError as error:  # integers of thousands of digits
        raise InputError(f"is not TOML of an experiment: {error}") from None


def _in_words(line: str, what: str) -> str:
    """What is wrong with a line of TOML, where that is what people often write; else `what`."""
    line = line.partition("#")[0].strip()
    name, key = line.strip("[] \t"), line.partition("=")[0].strip()
    comma = re.search(r"=\s*([-+]?\d+),(\d+)$", line)
    if comma:
        return f"{quote(line)}: a number has a decimal point, as {comma[1]}.{comma[2]}"
    if what.startswith("Cannot declare") and line.startswith("["):
        many = f"; each stands under a line of its own, [[{name}]]" * (name in _MANY)
        return f"[{name}] is there twice{many}"
    if what.startswith("Cannot overwrite"):
        return f"{key} is there twice in its table"
    return f"is not TOML: {what}"


def _check_filled_in(tables: Mapping[str, Any]) -> None:
    """That no "?" is left where `residyn new` writes one."""
    left = []
    for name, content in tables.items():
        many = isinstance(content, list)
        for i, entry in enumerate(content if many else [content], 1):
            keys = [
                key
                for key, value in (entry.items() if isinstance(entry, dict) else ())
                if key not in _WORDS and '"?"' in json.dumps(value, default=str)
            ]
            if keys:
                left.append((f"[[{name}]] {i} " if many else f"[{name}] ") + ", ".join(keys))
    if left:
        raise InputError(
            f'"?" is left in {"; ".join(left)}: write numbers there, in SI units'
            f"{', and for units their names' * ('units' in str(left))}"
        )


def _check_keys(where: str, keys: Mapping[str, Any], known: Sequence[str]) -> None:
    for key in keys:
        if key not in known:
            of_link = where == "[arm]" and _OF_A_LINK.fullmatch(key)
            hint = did_you_mean(key, known, cutoff=0.75 if of_link else 0.5)
            else_say = _INERTIAS if of_link else f"{where} has {', '.join(known)}"
            raise InputError(f"unknown key {quote(key)}: {hint or else_say}")


def _keys_of(kind: Any) -> list[str]:
    return [field.name for field in dataclasses.fields(kind)]


_OPTIONS = set(inspect.signature(Recording.from_arrays).parameters)
_OPTIONS -= {"time", "angle", "drive", "name", "stated"}  # which the file itself has
_RECORDING = ("file", *_keys_of(Layout), *sorted(_OPTIONS), "markers", "normal")


def _made(kind: Any, keys: Mapping[str, Any]) -> Any:
    """A table's object, which checks its values itself."""
    for field in dataclasses.fields(kind):
        if field.default is dataclasses.MISSING and field.name not in keys:
            raise InputError(f"{field.name} is missing")
    return kind(**keys)


def _one(
    tables: Mapping[str, Any],
    name: str,
    kind: Callable[..., Any],
    known: Sequence[str] | None = None,
) -> Any:
    """The object of a table that is there once, or None; `known` keys if `kind` is no dataclass."""
    if name not in tables:
        return None
    if not isinstance(tables[name], dict):
        raise InputError(f"{name} must be one table, [{name}]")
    with inside(f"[{name}]"):
        _check_keys(f"[{name}]", tables[name], known or _keys_of(kind))
        return _made(kind, tables[name]) if known is None else kind(**tables[name])


def _integrator(solver: Any = None, **tolerances: Any) -> Integrator:
    if solver is None:
        raise InputError('solver is missing: must be the name of a solver, such as "Tsit5"')
    return Integrator(solver, **tolerances)


def _many(tables: Mapping[str, Any], name: str, known: Sequence[str]) -> list[dict[str, Any]]:
    entries = tables.get(name, [])
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise InputError(f"{name} must be tables, each under a line [[{name}]]")
    for i, entry in enumerate(entries):
        with inside(f"[[{name}]] {i + 1}"):
            _check_keys(f"[{name}]", entry, known)
    return entries


def _check_recording(entry: Mapping[str, Any], arm: bool, bearings: bool) -> None:
    """What can be said before the recording is read."""
    if not isinstance(entry.get("file"), str) or not entry["file"]:
        have = f"file = {quote(entry['file'])}" if "file" in entry else "file is missing"
        raise InputError(f"{have}: must be the name of a recording's file")
    check_role(entry.get("role", "fit"))
    if not flag("air_bearings", entry.get("air_bearings", True)) and not bearings:
        raise InputError(
            "air_bearings = false, but there is no [[air_bearings]] table to say what was taken off"
        )
    if not arm and "theta2" in entry:
        raise InputError("theta2 is the elbow's angle of an [arm]; with [inertia] leave it out")
    if arm and "extra_mass" in entry:
        raise InputError(
            "extra_mass is for [inertia] only; for an [arm] give the loaded arm's own inertias"
        )

"""A file of results, one JSON line each, that goes on where a killed run stopped.

A line is appended in one write. So a run that is killed leaves whole lines, and at most one cut
line at the end, which the next run takes out. Each line carries a digest of all that the result
depends on; what was made of something else is taken out too. One run at a time holds the file.
"""

import contextlib
import dataclasses
import errno
import hashlib
import inspect
import json
import os
import sys
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np

from ..effects import AbstractEffect, catalogue
from ..errors import InputError
from ..files import read_bytes, write
from ..recordings.experiment import Experiment
from ..runtime.export_cache import sources
from ..runtime.json import finite

if sys.platform != "win32":
    import fcntl


# -- what a result depends on ----------------------------------------------------------------


def digest(
    experiment: str | os.PathLike[str] | Experiment,
    effects: Sequence[str | AbstractEffect],
    starts: int,
) -> str:
    """SHA-256 of the TOML and its recordings' bytes (or the experiment's numbers), the effects and
    the sources of those that are not this package's, the options, and this package's sources."""
    found = hashlib.sha256()
    _feed(found, [sources(), starts])
    for effect in effects:
        _feed(found, effect)
        if isinstance(effect, str):
            kind = catalogue().get(effect.partition(":")[0])
            _feed(found, [] if kind is None else _source(kind))
    _feed(found, experiment if isinstance(experiment, Experiment) else _contents(Path(experiment)))
    return found.hexdigest()


def _contents(path: Path) -> list[bytes]:
    """The bytes of an experiment file and of the recordings it names; what cannot be read is
    empty, and will be an error in its own words."""
    text = _bytes(path)
    try:
        entries = tomllib.loads(text.decode("utf-8-sig")).get("recordings", [])
        files = [path.parent / entry["file"] for entry in entries]
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        files = []
    return [text, *map(_bytes, files)]


def _bytes(path: Path) -> bytes:
    with contextlib.suppress(InputError):
        return read_bytes(path, "recording")
    return b""


def _feed(found: Any, value: Any) -> None:
    """Add a value to a digest: type, shape and contents, so that no two values read the same."""
    if isinstance(value, list | tuple):
        found.update(f"{len(value)} of them:".encode())
        for each in value:
            _feed(found, each)
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        _feed(found, [type(value).__qualname__, *_source(type(value))])
        for field in dataclasses.fields(value):
            _feed(found, [field.name, getattr(value, field.name, None)])
    else:
        if hasattr(value, "dtype"):
            value = (array := np.asarray(value)).tobytes()
            _feed(found, [str(array.dtype), *array.shape])
        content = value if isinstance(value, bytes) else repr(value).encode()
        found.update(f"{len(content)} bytes:".encode() + content)


def _source(kind: type) -> list[bytes]:
    """The files that define a class, but for this package's and those it is built on."""
    files = []
    for each in kind.__mro__:
        if each.__module__.partition(".")[0] not in ("residyn", "equinox", "builtins", "abc"):
            with contextlib.suppress(TypeError, OSError):
                files.append(_bytes(Path(inspect.getsourcefile(each) or "")))
    return files


# -- the file --------------------------------------------------------------------------------

_BEGINS = b'{"name": "'  # every line


class ResultLines:
    """The file, held by this run until `close`.

    **Arguments:** `digests`, by name: what this run is to do. Lines of other names stay.

    **Raises:** `InputError` if another run holds it, it has other things in it, or it cannot be
    written.
    """

    def __init__(self, path: str | os.PathLike[str], digests: Mapping[str, str]):
        self.path = Path(path)
        self.done: dict[str, dict[str, Any]] = {}
        """The results that need not be had again, by name."""
        self._held = contextlib.ExitStack()
        try:
            self._file = self._hold()
            if self.path.is_file():
                self._take_out(digests)
        except OSError as error:
            self.close()
            raise self._unwritable(error) from None
        except BaseException:
            self.close()
            raise

    def add(self, told: Mapping[str, Any]) -> None:
        """Append a line, whole or not at all."""
        line = json.dumps(finite(told), allow_nan=False).encode() + b"\n"
        try:
            before = os.fstat(self._file.fileno()).st_size
            if self._file.write(line) != len(line):
                os.ftruncate(self._file.fileno(), before)
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError as error:
            raise self._unwritable(error) from None

    def close(self) -> None:
        """Let other runs have it."""
        self._held.close()

    def _unwritable(self, error: OSError) -> InputError:
        return InputError(f"{self.path}: cannot be written ({error.strerror or error})")

    def _hold(self) -> IO[bytes]:
        """Open the file and lock it; again, if it was replaced in between."""
        while True:
            file = self._held.enter_context(open(self.path, "ab", buffering=0))  # noqa: SIM115
            try:
                if sys.platform != "win32":
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise InputError(
                    f"{self.path}: another run writes into it; wait until it is done, or choose "
                    "another file"
                ) from None
            except OSError:  # a file system without locks
                pass
            if os.path.samestat(os.fstat(file.fileno()), os.stat(self.path)):
                return file

    def _take_out(self, digests: Mapping[str, str]) -> None:
        """Read what is done; write the file anew without lines that are cut, errors, or of
        something else."""
        stays: list[bytes] = []
        data = self.path.read_bytes()
        for number, line in enumerate(data.splitlines(keepends=True), start=1):
            try:
                told = json.loads(line)
                name = told["name"]
            except (ValueError, KeyError, TypeError):
                begun = line.startswith(_BEGINS) or _BEGINS.startswith(line)
                if begun and not line.endswith(b"\n"):  # the run was killed while it wrote
                    break
                raise InputError(
                    f"{self.path}: line {number}: no result of a fit; must be a file that an "
                    "earlier run wrote, or a new one"
                ) from None
            if name in digests:
                if "error" in told or told.get("digest") != digests[name] or name in self.done:
                    continue
                self.done[name] = told
            stays.append(line if line.endswith(b"\n") else line + b"\n")
        if b"".join(stays) != data:
            write(self.path, b"".join(stays))
            self._file = self._hold()

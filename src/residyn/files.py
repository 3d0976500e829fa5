"""Files: reading is bounded by what such a file can be, writing is all or nothing.

A file is written beside its place and then renamed onto it. So whoever interrupts, or fills the
disk, finds the old content or the new one, never half of it.
"""

import contextlib
import os
import secrets
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

from .errors import InputError

_LARGEST = {"TOML file": 10_000_000}
_LARGEST_RECORDING = 300_000_000
"""Bytes: a million samples of ten columns with every digit."""


def check_ordinary(path: str | os.PathLike[str], kind: str) -> None:
    """That there is such a file, and no folder, pipe or device; `kind` is what it should be, for
    the error's line.

    **Raises:** `InputError`.
    """
    with _reading(path, kind):
        mode = os.stat(path).st_mode
        if not stat.S_ISREG(mode):
            raise OSError("is a folder" if stat.S_ISDIR(mode) else "is no ordinary file")


def read_bytes(path: str | os.PathLike[str], kind: str) -> bytes:
    """The bytes of a file that is no larger than such files are."""
    if kind not in _LARGEST:  # a recording is read twice, a pipe could be once; a device never ends
        check_ordinary(path, kind)
    with _reading(path, kind), open(path, "rb") as file:
        return read_stream(file, os.fspath(path), kind)


def read_stream(file: IO, where: str, kind: str) -> Any:
    """What a stream still holds, if that is no more than such files have."""
    most = _LARGEST.get(kind, _LARGEST_RECORDING)
    data = file.read(most + 1)
    if len(data) > most:
        raise InputError(f"{where}: has more than {most / 1e6:g} MB, too large for a {kind}")
    return data


@contextlib.contextmanager
def _reading(path: str | os.PathLike[str], kind: str) -> Iterator[None]:
    """What fails, in one line."""
    try:
        yield
    except InputError:
        raise
    except FileNotFoundError:
        what = "there is no such file"
    except IsADirectoryError:
        what = "is a folder"
    except (OSError, ValueError) as error:
        own = isinstance(error, OSError) and error.errno is None  # from `check_ordinary`
        what = str(error) if own else f"cannot be read ({getattr(error, 'strerror', 0) or error})"
    else:
        return
    raise InputError(f"{os.fspath(path)}: {what}; a {kind} was expected")


def read_text(path: str | os.PathLike[str], kind: str) -> str:
    """The text of a UTF-8 file."""
    return decode(read_bytes(path, kind), os.fspath(path), kind)


def read_table_text(path: str | os.PathLike[str]) -> str:
    """The text of a lab's table: UTF-8, UTF-16 if it begins so, else Latin-1 as Windows has it."""
    data = read_bytes(path, "CSV file")
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        data = data.decode("utf-16", errors="replace").encode()
    if b"\0" in data:
        line = data.count(b"\n", 0, data.find(b"\0")) + 1
        raise InputError(f"{os.fspath(path)}, line {line}: is not text; a CSV file was expected")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp1252", errors="replace")


def decode(data: bytes, where: str, kind: str) -> str:
    """`data` as text; a byte order mark at its start is dropped."""
    bad = data.find(b"\0")
    if bad < 0:
        try:
            return data.decode("utf-8-sig")
        except UnicodeDecodeError as error:
            bad = error.start
    line = data.count(b"\n", 0, bad) + 1
    raise InputError(f"{where}, line {line}: is not UTF-8 text; a {kind} in UTF-8 was expected")


def write(path: str | os.PathLike[str], content: str | bytes) -> None:
    """Write a file, whole or not at all; a pipe or a device is written to as it is.

    **Raises:** `InputError` if that cannot be done.
    """
    data = content.encode() if isinstance(content, str) else content
    with _writing(path) as (place, there):
        if there is not None and not stat.S_ISREG(there.st_mode):
            place.write_bytes(data)
            return
        beside = place.with_name(f".residyn-{secrets.token_hex(8)}")
        try:
            with open(beside, "xb") as file:
                file.write(data)
                if there is not None:
                    os.chmod(beside, stat.S_IMODE(there.st_mode))
            os.replace(beside, place)
        except BaseException:
            with contextlib.suppress(OSError):
                os.unlink(beside)
            raise


def make_folder(path: Path) -> None:
    """Make a folder and those above it, where they are not there.

    **Raises:** `InputError`.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{path}: cannot be made ({error.strerror})") from None


def check_folder(path: Path) -> None:
    """That `make_folder` could make this folder, before the work whose results go there.

    **Raises:** `InputError`.
    """
    missing = [each for each in (path, *path.parents) if not each.exists()]
    make_folder(path)
    with contextlib.suppress(OSError):
        for each in missing:
            each.rmdir()


def check_writable(path: str | os.PathLike[str]) -> None:
    """That `write` could write this file, before the work whose result it will be.

    **Raises:** `InputError`.
    """
    with _writing(path) as (place, there):
        if there is not None:
            with open(place, "ab"):
                pass
        if there is None or stat.S_ISREG(there.st_mode):
            beside = place.with_name(f".residyn-{secrets.token_hex(8)}")
            with open(beside, "xb"):
                os.unlink(beside)


@contextlib.contextmanager
def _writing(path: str | os.PathLike[str]) -> Iterator[tuple[Path, os.stat_result | None]]:
    """The place that a path leads to and what is there; what fails is told in one line."""
    try:
        place = Path(os.path.realpath(path))
        yield place, place.stat() if place.exists() else None
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise InputError(f"{os.fspath(path)}: cannot be written ({why})") from None

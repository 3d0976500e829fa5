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

from .errors import InputError

_LARGEST = {"TOML file": 10_000_000}
_LARGEST_RECORDING = 300_000_000
"""Bytes: a million samples of ten columns with every digit."""


def read_bytes(path: str | os.PathLike[str], kind: str) -> bytes:
    """The bytes of a file that is no larger than such files are; `kind` is what it should be, for
    the error's line."""
    where, most = os.fspath(path), _LARGEST.get(kind, _LARGEST_RECORDING)
    try:
        found = os.stat(path)
        # A recording is read twice; a pipe could be read once, and some devices never end.
        if kind not in _LARGEST and not stat.S_ISREG(found.st_mode):
            what = "a folder" if stat.S_ISDIR(found.st_mode) else "no ordinary file"
            raise InputError(f"{where}: is {what}; a {kind} was expected")
        with open(path, "rb") as file:
            data = b"" if found.st_size > most else file.read(most + 1)
    except FileNotFoundError:
        raise InputError(f"{where}: there is no such file; a {kind} was expected") from None
    except IsADirectoryError:
        raise InputError(f"{where}: is a folder; a {kind} was expected") from None
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise InputError(f"{where}: cannot be read ({why}); a {kind} was expected") from None
    if max(found.st_size, len(data)) > most:
        raise InputError(f"{where}: has more than {most / 1e6:g} MB, too large for a {kind}")
    return data


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

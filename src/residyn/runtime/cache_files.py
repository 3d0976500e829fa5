"""A cache that is never believed without proof: private files, each with its name and a checksum.

A program from a cache runs. A damaged one may crash, or compute something else without a word; one
that somebody else could have written may do anything. So the folder and its files are their owner's
alone, a folder that others may write to is not used, and a file is read only if it holds what was
written, under the name that is asked for:

    magic (16 bytes) | SHA-256 of all that follows | length of the name (8 bytes) | name | content

Files that were not used for long are removed, and the oldest ones where all together are large.
"""

import contextlib
import hashlib
import os
import stat
import tempfile
import time
from pathlib import Path

_MAGIC = b"residyn cache 1\n"
_SUM = hashlib.sha256().digest_size
_LARGEST = 500_000_000  # bytes of all files together, beyond which the oldest are removed
_OLDEST = 60 * 24 * 3600.0  # seconds after its last use when a file is removed
_ROOM = 0.8  # share of the largest size to which a cache is cut down, so that this is seldom done


class UnsafeFolder(OSError):
    """Others may write to the folder: what is in it may be theirs."""


class Cache:
    """Contents by name, in a folder that is made if need be.

    **Raises:** `UnsafeFolder`; another `OSError` for a folder that cannot be made or written.
    """

    def __init__(self, folder: Path):
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = folder.stat()
        if hasattr(os, "geteuid"):  # on Windows a user's folder is the user's
            if found.st_uid != os.geteuid() or found.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
                raise UnsafeFolder(f"{folder}: others may write to it")
            if stat.S_IMODE(found.st_mode) != 0o700:
                folder.chmod(0o700)
        if not os.access(folder, os.R_OK | os.W_OK | os.X_OK):
            raise PermissionError(f"{folder}: cannot be written")
        self.folder = folder
        self._pruned = False

    def get(self, name: str) -> bytes | None:
        """The content of this name; None if there is none that is whole."""
        file = self.file(name)
        try:
            content = unpacked(file.read_bytes(), name)
            if content is not None:
                os.utime(file)
            return content
        except OSError:
            return None

    def put(self, name: str, content: bytes | bytearray) -> None:
        """Keep it, all at once: another process may be reading. What cannot be kept is not."""
        with contextlib.suppress(OSError):
            handle, temporary = tempfile.mkstemp(dir=self.folder)  # of mode 0600
            try:
                with os.fdopen(handle, "wb") as out:
                    out.write(packed(name, content))
                os.replace(temporary, self.file(name))
            except BaseException:
                os.unlink(temporary)
                raise
            if not self._pruned:
                self._pruned = True
                self.prune()

    def prune(self, largest: float = _LARGEST, oldest: float = _OLDEST) -> None:
        """Remove files not used for `oldest` s; if the rest has more than `largest` bytes, the
        longest unused of them, to 80 % of that."""
        entries = [entry for entry in os.scandir(self.folder) if entry.is_file()]
        used = sorted(
            ((e.stat().st_mtime, e.stat().st_size, e.path) for e in entries), reverse=True
        )
        total, now = 0, time.time()
        room = largest if sum(size for _, size, _ in used) <= largest else _ROOM * largest
        for last, size, path in used:
            total += size
            if now - last > oldest or total > room:
                with contextlib.suppress(OSError):
                    os.unlink(path)

    def file(self, name: str) -> Path:
        return self.folder / hashlib.sha256(name.encode()).hexdigest()


def packed(name: str, content: bytes | bytearray) -> bytes:
    """The bytes of a file."""
    words = name.encode()
    rest = len(words).to_bytes(8, "little") + words + content
    return _MAGIC + hashlib.sha256(rest).digest() + rest


def unpacked(data: bytes, name: str) -> bytes | None:
    """The content in the bytes of a file; None if they are damaged, or of another name."""
    rest, words = data[len(_MAGIC) + _SUM :], name.encode()
    if data[: -len(rest) or None] != _MAGIC + hashlib.sha256(rest).digest():
        return None
    head = len(words).to_bytes(8, "little") + words
    return rest[len(head) :] if rest.startswith(head) else None

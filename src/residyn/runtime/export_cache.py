"""Traced programs that are kept: what one process has traced, a later one need not trace again.

JAX keeps what XLA has compiled, but asks for it with the whole traced program in hand, and tracing
a fit takes a second of Python each time. So a function marked `kept` is exported, once, as the
program that XLA is given, and a later process that calls it with inputs of the same structure and
shapes reads that instead. `residyn.set_up` says where; without it, `kept` is `equinox.filter_jit`.
JAX's own compiled programs go into the same cache, which checks every file that it reads.

A program must never be taken for another one. It is named by everything that made it: the sources
of this package, the versions of what it is built on, and the structure of what was put in. What
cannot be told by its text (a class or a function of somebody else's) is traced, as ever.
"""

import functools
import gc
import hashlib
import threading
import warnings
from collections import OrderedDict
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.export
import numpy as np
from jax.core import Tracer

from .cache_files import Cache, UnsafeFolder

_MADE_OF = ("jax", "jaxlib", "equinox", "diffrax", "optimistix", "lineax")
_TOLD = (int, float, bool, str, type(None))
# Calls into LAPACK for which JAX promises nothing to later versions; a later one traces anew.
_LAPACK = ("dgeqrf", "dormqr", "dorgqr", "dtrsm", "dpotrf", "dgetrf", "dgesdd", "dsyevd")

_cache: Cache | None = None


def keep_in(folder: Path | None) -> Path | None:
    """Keep traced programs in this folder from now on; None: nowhere.

    **Returns:** the folder, or None if it cannot be used. A folder that others may write to is a
    `UserWarning`.
    """
    global _cache
    _cache = None
    if folder is not None:
        try:
            _cache = Cache(folder)
        except UnsafeFolder as error:
            warnings.warn(f"{error}, so no compiled programs are kept there", stacklevel=3)
        except OSError:  # nothing is wrong without a cache; it is only slower
            pass
    return None if _cache is None else folder


def check_compiled() -> bool:
    """Have JAX keep what it compiles in our cache, if told to keep it in the same folder: JAX's own
    files have no checksum, and a damaged one may crash or compute something else.

    **Returns:** whether that could be had; it is no public function of JAX.
    """
    try:
        from jax._src import compilation_cache
        from jax._src.compilation_cache_interface import CacheInterface

        original = compilation_cache.get_file_cache
    except (ImportError, AttributeError):
        return False

    class Compiled(CacheInterface):
        def __init__(self, cache: Cache):
            self.cache, self._path = cache, cache.folder

        def get(self, key: str) -> bytes | None:  # pyrefly: ignore[bad-override]
            return self.cache.get(f"compiled {key}")

        def put(self, key: str, value: bytes) -> None:
            self.cache.put(f"compiled {key}", value)

    def file_cache(path: str):
        if _cache is not None and Path(path) == _cache.folder:
            return Compiled(_cache), path
        return original(path)

    if original.__module__ != __name__:
        compilation_cache.get_file_cache = file_cache
    return True


def kept(like: Any, *, seldom: bool = False) -> Callable[[Callable], "Kept"]:
    """`equinox.filter_jit` for a function of arrays and models whose traced program is kept.

    It takes no keywords, and returns arrays in the structure of `like`, whose leaves are anything.
    It must be a module's own: what a closure holds is not in a program's name. One that is called
    `seldom`, a few times a process, is compiled without LLVM's optimisations, which take longer
    than they then save.
    """
    options = {"xla_backend_optimization_level": 0} if seldom else {}
    return lambda function: Kept(function, like, options)


_MOST = 24
"""Programs that a process holds, 15 to 50 MB each: a diagnosis takes about 16. What is asked for
again is in the cache."""
_held: OrderedDict[tuple["Kept", Any, Any], "_Program"] = OrderedDict()
"""The programs of this process, the last used one last."""
_lock = threading.Lock()


class _Program:
    """A compiled program, once somebody has needed it."""

    def __init__(self):
        self.lock, self.call = threading.Lock(), None


class Kept:
    """What `kept` makes of a function."""

    def __init__(self, function: Callable, like: Any, options: dict[str, Any]):
        functools.update_wrapper(self, function)
        self._options = options
        self._plain = eqx.filter_jit(function, compiler_options=options)  # pyrefly: ignore
        self._within = eqx.filter_jit(function)  # a program takes no options for a part of it
        self._name = f"{function.__module__}.{function.__qualname__}"
        self._out = jax.tree.structure(like)

    def __call__(self, *args):
        leaves, structure = jax.tree.flatten(args)
        if any(isinstance(x, Tracer) for x in leaves):
            return self._within(*args)
        arrays = [x for x in leaves if eqx.is_array(x)]
        spread = any(isinstance(x, jax.Array) and len(x.devices()) > 1 for x in arrays)
        if _cache is None or spread:
            return self._plain(*args)
        told = _key(leaves, structure)
        key = self, told, _devices(arrays)
        with _lock:
            program = _held.setdefault(key, _Program())
            _held.move_to_end(key)
            gone = [_held.popitem(last=False) for _ in range(len(_held) - _MOST)]
        if gone:
            del gone
            gc.collect()
        with program.lock:
            if program.call is None:
                found = self._found(_cache, args, arrays, told)
                # Ahead of the call: by itself JAX would compile once more for arrays that another
                # exported program has returned, which it takes for bound to their device.
                program.call = found.lower(*arrays).compile(self._options)
        return jax.tree.unflatten(self._out, program.call(*arrays))

    def _found(self, cache: Cache, args, arrays, key) -> Any:
        """The program for these inputs, as it was kept, or traced and kept now."""
        structure, leaves = key[:2]
        words = _words(structure)
        if words is None or not all(type(x) in (tuple, *_TOLD) for x in leaves):
            return jax.jit(self._flat(args))
        name = "\n".join([self._name, made_of(), words, repr(key[1:])])
        try:
            exported = jax.export.deserialize(bytearray(cache.get(name) or b""))
        except Exception:  # not there, or of no use: why does not matter
            flat = jax.jit(self._flat(args))
            try:
                unsure = [
                    jax.export.DisabledSafetyCheck.custom_call(f"lapack_{x}_ffi") for x in _LAPACK
                ]
                exported = jax.export.export(flat, disabled_checks=unsure)(*arrays)
                cache.put(name, exported.serialize())
            except (ImportError, ValueError, NotImplementedError):  # not everything can be exported
                return flat
        return jax.jit(exported.call)

    def _flat(self, args) -> Callable:
        """The function of the arrays among these arguments alone, its result's leaves as a list."""
        given, others = eqx.partition(args, eqx.is_array)
        structure = jax.tree.structure(given)

        def flat(*arrays):
            filled = eqx.combine(jax.tree.unflatten(structure, arrays), others)
            found = self.__wrapped__(*filled)  # pyrefly: ignore[missing-attribute]
            values, built = jax.tree.flatten(found)
            assert built == self._out, f"{self._name} returns {built}, not {self._out}"
            return values

        return flat


def _key(leaves, structure) -> tuple:
    """All that tells one program of a function from another one."""
    told = tuple(
        (x.shape, np.dtype(x.dtype).str, bool(getattr(x, "weak_type", False)))
        if eqx.is_array(x)
        else x
        for x in leaves
    )
    return structure, told, jax.config.jax_enable_x64, jax.default_backend()  # pyrefly: ignore


def _devices(arrays) -> frozenset:
    """Where a program with these inputs runs."""
    bound = (x for x in arrays if isinstance(x, jax.Array) and x.committed)
    default = jax.config.jax_default_device or jax.devices()[0]  # pyrefly: ignore
    return frozenset(device for x in bound for device in x.devices()) or frozenset([default])


def _words(structure) -> str | None:
    """All of the inputs' structure, in words; None if words cannot tell all of it."""
    node = structure.node_data()
    if node is None:
        return "*" if structure.num_leaves else "-"
    kind, more = node
    home, told = kind.__module__, "" if more is kind else repr(more)
    # "<" begins what has no text of its own; "..." is an array cut short.
    if home.partition(".")[0] not in ("residyn", "builtins") or "<" in told or "..." in told:
        return None
    parts = [_words(child) for child in structure.children()]
    if any(part is None for part in parts):
        return None
    return f"{home}.{kind.__qualname__}{told}({','.join(parts)})"  # pyrefly: ignore


@functools.cache
def sources() -> str:
    """SHA-256 of this package's sources."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parents[1].rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


@functools.cache
def made_of() -> str:
    """What this package and those it is built on are, in few words."""
    return " ".join([sources(), *(f"{name} {version(name)}" for name in _MADE_OF)])

"""What a program may ask of JAX before it starts: float64, XLA's options, programs that are kept.

Importing the package changes nothing of JAX. A command calls `set_up` for itself; a program or a
notebook that wants the same says so in its first lines.

*XLA's options* (of its compiler for CPUs). A simulation is a loop of small steps. By default XLA
runs a loop as a list of kernels that are called one by one, some dozens a step, and calling takes
several times as long as computing. It can compile a whole loop as one kernel instead, and does so
if the loop touches less than 1 kB; `set_up` lifts that limit. And of XLA's two emitters of kernels
it takes the older one, which compiles in two thirds of the time; what it compiles is as quick.
"""

import os
from pathlib import Path

_OPTIONS = {
    "xla_cpu_small_while_loop_byte_threshold": "1000000000",
    "xla_cpu_disable_new_fusion_emitters": "true",
}


def set_up(*, cache: bool | str | Path = True) -> None:
    """Make JAX ready for residyn: call it first, before JAX computes anything.

    Switches float64 on, has XLA compile loops as one kernel and compile sooner (JAX reads those
    options at its first computation and never again; fits with friction or memory gain most), and
    keeps compiled programs for the next run. An option that `XLA_FLAGS` sets is left as it is. Has
    glibc give large arrays back to the system when they are freed.

    **Arguments:**

    - `cache`: where compiled programs are kept: a folder, True for `residyn` in the user's cache
      folder (none if that cannot be written), False for nowhere. The folder is made private (mode
      0700), and one that others may write to is not used, with a `UserWarning`.
    """
    set_compiler_options()
    import jax

    jax.config.update("jax_enable_x64", True)
    from .export_cache import check_compiled, keep_in
    from .memory import give_back_arrays

    give_back_arrays()
    folder = cache_folder() if cache is True else None if cache is False else Path(cache)
    folder = keep_in(folder)
    if folder is not None and check_compiled():
        jax.config.update("jax_compilation_cache_dir", str(folder))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
        jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


def set_compiler_options() -> None:
    """The part of `set_up` that sets XLA's options, those that `XLA_FLAGS` does not set already."""
    flags = os.environ.get("XLA_FLAGS", "")
    more = ",".join(f"{name}={value}" for name, value in _OPTIONS.items() if name not in flags)
    if more:
        os.environ["XLA_FLAGS"] = f"{flags} --xla_backend_extra_options={more}".strip()


def cache_folder() -> Path | None:
    """Where a user's caches are, or None if that cannot be known."""
    base = os.environ.get("XDG_CACHE_HOME", "")
    try:
        # A relative XDG_CACHE_HOME is invalid, says its specification, and must be ignored.
        home = Path(base) if os.path.isabs(base) else Path.home() / ".cache"
        return home / "residyn"
    except RuntimeError:
        return None

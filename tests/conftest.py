"""Compiled programs are kept between tests and runs: compiling is most of what a test costs."""

import gc
from pathlib import Path

import hypothesis
import jax
import pytest

from residyn import effects
from residyn.runtime.export_cache import keep_in
from residyn.runtime.settings import set_compiler_options

set_compiler_options()  # the rest of `set_up` sets float64, for which tests ask one by one
CACHE = Path(__file__).parents[1] / ".pytest_cache" / "jax"

jax.config.update("jax_compilation_cache_dir", str(CACHE))
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)

# No test is timed: a machine may be busy.
hypothesis.settings.register_profile("untimed", deadline=None)
hypothesis.settings.load_profile("untimed")

gc.freeze()  # what is imported stays: every collection would go through all of it


@pytest.fixture(scope="module", autouse=True)
def forget():
    """Programs stay on the disk, not in memory: a thousand tests would need 6 GB a worker. And what
    a command sets in JAX, as commands may, or adds to the catalogue is not left to the next
    module."""
    wide, known = jax.config.values["jax_enable_x64"], dict(effects.CATALOGUE)
    yield
    effects.CATALOGUE.clear()
    effects.CATALOGUE.update(known)
    jax.config.update("jax_enable_x64", wide)
    jax.config.update("jax_compilation_cache_dir", str(CACHE))
    keep_in(None)
    jax.clear_caches()
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="module")
def compiled_in_less_time():
    """Without most of XLA's optimisations: a program compiles in half the time and runs several
    times as long. For modules of many programs that run once or twice, not for searches."""
    jax.config.update("jax_disable_most_optimizations", True)
    yield
    jax.config.update("jax_disable_most_optimizations", False)


@pytest.fixture(scope="module")
def pictures_not_written():
    """Pages with pictures that are drawn and not written as SVG, most of what a page costs. For
    modules that read a page's words."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("residyn.reporting.figures.inline.svg", lambda figure: "<svg/>")
        yield


@pytest.fixture(scope="module")
def float64():
    """In double precision, as commands compute; modules ask for it with `pytestmark`."""
    with jax.enable_x64(True):
        yield

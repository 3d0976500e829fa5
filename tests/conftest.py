"""Compiled programs are kept between tests and runs: compiling is most of what a test costs."""

import gc
from pathlib import Path

import jax
import pytest

CACHE = Path(__file__).parents[1] / ".pytest_cache" / "jax"

jax.config.update("jax_compilation_cache_dir", str(CACHE))
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)


@pytest.fixture(scope="module", autouse=True)
def forget():
    """Programs stay on the disk, not in memory: a thousand tests would need 6 GB a worker."""
    yield
    jax.clear_caches()
    gc.collect()

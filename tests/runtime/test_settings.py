"""What `set_up` does to JAX, and that nothing else does."""

import json
import os
import platform
import subprocess
import sys

import pytest

ASK = """
import json, os
import residyn
{call}
import jax
print(json.dumps([os.environ.get("XLA_FLAGS", ""), jax.config.jax_enable_x64,
                  jax.config.jax_compilation_cache_dir]))
"""


def told(call, **environment):
    env = {k: v for k, v in os.environ.items() if not k.startswith(("XLA_", "JAX_"))}
    done = subprocess.run(
        [sys.executable, "-c", ASK.format(call=call)],
        env=env | environment,
        capture_output=True,
        text=True,
        check=True,
    )
    return json.loads(done.stdout)


def test_importing_sets_nothing():
    assert told("residyn.fit") == ["", False, None]


def test_float64_compiler_options_and_a_cache(tmp_path):
    flags, wide, folder = told("residyn.set_up()", XDG_CACHE_HOME=str(tmp_path))
    assert "small_while_loop" in flags
    assert "new_fusion_emitters" in flags
    assert wide
    assert folder == str(tmp_path / "residyn")


def test_no_cache_and_a_cache_elsewhere(tmp_path):
    assert told("residyn.set_up(cache=False)")[2] is None
    assert told(f"residyn.set_up(cache={str(tmp_path)!r})")[2] == str(tmp_path)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="of glibc alone")
def test_an_array_that_is_made_again_and_again_has_the_same_pages():
    again = """
import resource
import numpy as np
import residyn
residyn.set_up(cache=False)
made = lambda times: [np.ones(450_000).sum() for _ in range(times)]
made(10)
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
made(100)
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""
    done = subprocess.run([sys.executable, "-c", again], capture_output=True, text=True, check=True)
    assert int(done.stdout) < 4 * 900  # pages of a few such arrays, of a hundred


def test_flags_of_the_user_stay():
    own = "--xla_force_host_platform_device_count=2"
    flags, _, _ = told("residyn.set_up(cache=False)", XLA_FLAGS=own)
    assert flags.startswith(own + " ")
    chosen = "xla_cpu_small_while_loop_byte_threshold=0"
    here = f"--xla_backend_extra_options={chosen}"
    flags, _, _ = told("residyn.set_up(cache=False)", XLA_FLAGS=here)
    assert flags.count("small_while_loop") == 1
    both = f"{here},xla_cpu_disable_new_fusion_emitters=false"
    assert told("residyn.set_up(cache=False)", XLA_FLAGS=both)[0] == both


def test_loops_as_one_kernel_compute_the_same():
    """The numbers of a fit, in a process that calls `set_up` and in one that does not."""
    fit = """
import numpy as np
import jax
from residyn import PlanarArm, Spring, Damper, CoulombFriction, simulate
jax.config.update("jax_enable_x64", True)
arm = PlanarArm([0.4, 0.4], shoulder=1.1662, elbow=0.5790, coupling=1.4384, theta2=0.3)
model = arm + Spring("shoulder", 16.7) + Spring("elbow", 16.7) + Damper("elbow", 0.1)
model = model + CoulombFriction("elbow", 0.05)
q = simulate(model, np.linspace(0.0, 10.0, 200), [0.2, -0.1]).q
print(np.asarray(q).tolist())
"""
    env = {k: v for k, v in os.environ.items() if not k.startswith(("XLA_", "JAX_"))}
    q = [
        json.loads(
            subprocess.run(
                [sys.executable, "-c", first + fit],
                env=env,
                capture_output=True,
                text=True,
                check=True,
            ).stdout
        )
        for first in ("", "import residyn\nresidyn.set_up(cache=False)")
    ]
    off = max(abs(a - b) for x, y in zip(*q, strict=True) for a, b in zip(x, y, strict=True))
    assert off < 1e-9

"""What `set_up` does to JAX, and that nothing else does."""

import json
import os
import platform
import subprocess
import sys

import numpy as np
import pytest

TELL = """
import json, os, sys
import residyn

told = []
for call, environment in json.loads(sys.argv[1]):
    os.environ.pop("XLA_FLAGS", None)
    os.environ.update(environment)
    exec(call)
    import jax
    told.append([os.environ.get("XLA_FLAGS", ""), jax.config.jax_enable_x64,
                 jax.config.jax_compilation_cache_dir])
print(json.dumps(told))
"""


def in_a_new_process(code, *words):
    """What it prints as JSON, without the options of this process."""
    env = {k: v for k, v in os.environ.items() if not k.startswith(("XLA_", "JAX_"))}
    command = [sys.executable, "-c", code, *words]
    done = subprocess.run(command, env=env, capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


def told(*calls):
    """After each of these calls, with its own environment: XLA's flags, whether numbers are wide,
    and the cache; one after the other in one process."""
    return in_a_new_process(TELL, json.dumps(calls))


def test_importing_sets_nothing_and_set_up_all(tmp_path):
    """float64, compiler options, and a cache: none, the user's or another."""
    other = str(tmp_path / "other")
    imported, without, elsewhere, usual = told(
        ("residyn.fit", {}),
        ("residyn.set_up(cache=False)", {}),
        (f"residyn.set_up(cache={other!r})", {}),
        ("residyn.set_up()", {"XDG_CACHE_HOME": str(tmp_path)}),
    )
    assert imported == ["", False, None]
    assert [without[2], elsewhere[2], usual[2]] == [None, other, str(tmp_path / "residyn")]
    for flags, wide, _ in (without, elsewhere, usual):
        assert "small_while_loop" in flags
        assert "new_fusion_emitters" in flags
        assert wide


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
    assert in_a_new_process(again) < 4 * 900  # pages of a few such arrays, of a hundred


def test_flags_of_the_user_stay():
    own = "--xla_force_host_platform_device_count=2"
    here = "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=0"
    both = f"{here},xla_cpu_disable_new_fusion_emitters=false"
    call = "residyn.set_up(cache=False)"
    (one, *_), (chosen, *_), (all_, *_) = told(
        *((call, {"XLA_FLAGS": flags}) for flags in (own, here, both))
    )
    assert one.startswith(own + " ")
    assert chosen.count("small_while_loop") == 1
    assert all_ == both


def test_loops_as_one_kernel_compute_the_same():
    """The motion of an arm, in this process with XLA's options, and in one without."""
    code = """
import numpy as np
import jax
from residyn import PlanarArm, Spring, Damper, CoulombFriction, simulate
with jax.enable_x64(True):
    arm = PlanarArm([0.4, 0.4], shoulder=1.1662, elbow=0.5790, coupling=1.4384, theta2=0.3)
    model = arm + Spring("shoulder", 16.7) + Spring("elbow", 16.7) + Damper("elbow", 0.1)
    model = model + CoulombFriction("elbow", 0.05)
    q = np.asarray(simulate(model, np.linspace(0.0, 10.0, 200), [0.2, -0.1]).q).tolist()
"""
    assert "small_while_loop" in os.environ["XLA_FLAGS"]
    here: dict = {}
    exec(code, here)
    there = in_a_new_process(f"{code}\nprint(q)")
    np.testing.assert_allclose(here["q"], there, rtol=0.0, atol=1e-9)

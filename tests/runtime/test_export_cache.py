"""Traced programs that are kept: found again, never taken for others, and nothing without them."""

import functools
import os
import stat
import subprocess
import sys
import time
import weakref

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from residyn import PlanarArm, Spring
from residyn.physics.parameter import all_floating
from residyn.runtime import cache_files as _cache
from residyn.runtime import export_cache as kept
from residyn.runtime.export_cache import keep_in


@pytest.fixture
def folder(tmp_path):
    keep_in(tmp_path)
    yield tmp_path
    keep_in(None)


def watched(count):
    """A function as in a fresh process, and how often its body is traced."""

    def body(model, x):
        count.append(1)
        return {"twice": 2 * x}, model.vector().sum()

    return kept.kept(like=({"twice": 0}, 0))(body)


def arm(stiffness=2.0):
    return all_floating(
        PlanarArm([0.4, 0.4], 1.0, 0.5, 1.4, 0.7)
        + Spring("shoulder", stiffness)
        + Spring("elbow", 3.0)
    )


def test_a_later_process_traces_nothing(folder):
    first, second = [], []
    for seen in (first, second):
        out, total = watched(seen)(arm(), np.arange(3.0))
        np.testing.assert_array_equal(out["twice"], [0.0, 2.0, 4.0])
        assert float(total) == 5.0
    assert (len(first), len(second)) == (1, 0)
    assert len(list(folder.iterdir())) == 1


def test_other_numbers_are_the_same_program_and_other_shapes_are_not(folder):
    seen = []
    call = watched(seen)
    assert float(call(arm(5.0), np.arange(3.0))[1]) == 8.0
    assert float(call(arm(6.0), 2 * np.arange(3.0))[1]) == 9.0
    assert len(seen) == 1
    call(arm(), np.arange(4.0))
    call(arm(), np.arange(3, dtype=np.int32))
    call(arm().mechanism + Spring("shoulder", jnp.asarray(1.0)), np.arange(3.0))
    assert len(seen) == 4
    assert len(list(folder.iterdir())) == 4


def test_a_program_is_compiled_once_for_numpy_and_for_results_of_another_program(folder):
    @kept.kept(like=0)
    def doubled(x):
        return 2.0 * x

    @kept.kept(like=0)
    def summed(x):
        return jnp.sum(x)

    compiled = []

    def listen(event, duration, **more):
        if event == "/jax/core/compile/backend_compile_duration":
            compiled.append(event)

    numbers = np.arange(3, dtype=np.float32)
    first = doubled(numbers)
    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        assert float(summed(numbers)) == 3.0
        assert len(compiled) == 1
        assert float(summed(first)) == 6.0
        assert len(compiled) == 1
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)


def test_a_process_lets_go_of_old_programs(folder):
    @kept.kept(like=0)
    def applied(function, x):
        return function(x)

    alive = []
    for number in range(30):
        add = functools.partial(jnp.add, number)
        alive.append(weakref.ref(add))
        assert float(applied(add, np.asarray(1.0))) == number + 1.0
    del add
    held = sum(ref() is not None for ref in alive)
    assert 0 < held < 30
    assert alive[-1]() is not None


def test_another_function_and_other_sources_are_other_programs(folder, monkeypatch):
    @kept.kept(like=0)
    def one(x):
        return x + 1

    @kept.kept(like=0)
    def other(x):
        return x + 2

    assert float(one(np.asarray(1.0))) == 2.0
    assert float(other(np.asarray(1.0))) == 3.0
    seen = []
    watched(seen)(arm(), np.arange(3.0))
    monkeypatch.setattr(kept, "made_of", lambda: "edited")
    watched(seen)(arm(), np.arange(3.0))
    assert len(seen) == 2


class Doubler(eqx.Module):
    """Somebody's own class: its code is not in the name of a program."""

    factor: float = 2.0


def test_what_words_cannot_tell_is_traced(folder):
    @kept.kept(like=0)
    def scaled(own, x):
        return own.factor * x

    @kept.kept(like=0)
    def applied(function, x):
        return function(x)

    assert float(scaled(Doubler(), np.asarray(3.0))) == 6.0
    assert float(applied(lambda x: x - 1, np.asarray(3.0))) == 2.0
    assert float(applied(lambda x: x - 2, np.asarray(3.0))) == 1.0
    assert not list(folder.iterdir())


def test_a_broken_file_is_written_again(folder):
    seen = []
    watched(seen)(arm(), np.arange(3.0))
    (file,) = folder.iterdir()
    file.write_bytes(b"broken")
    watched(seen)(arm(), np.arange(3.0))
    assert len(seen) == 2
    watched(seen)(arm(), np.arange(3.0))
    assert len(seen) == 2


DAMAGES = 600


def damaged(content, i):
    """The i-th of many ways in which a disk, or a copy that was interrupted, damages a file."""
    rng = np.random.default_rng(i)
    data = bytearray(content)
    at = int(rng.integers(len(data)))
    if i % 4 == 0:
        data[at] ^= 1 << int(rng.integers(8))
    elif i % 4 == 1:
        del data[at:]
    elif i % 4 == 2:
        end = min(len(data), at + 1 + int(rng.integers(4096)))
        data[at:end] = bytes(end - at)
        data[at] ^= data[at] == content[at]
    else:
        data += b"\0"
    assert data != content
    return bytes(data)


def test_no_damaged_file_is_read():
    content = np.random.default_rng(0).bytes(20_000)
    file = _cache.packed("name", content)
    assert _cache.unpacked(file, "name") == content
    for i in range(DAMAGES):
        assert _cache.unpacked(damaged(file, i), "name") is None
    assert _cache.unpacked(file, "nam") is None
    assert _cache.unpacked(file, "name\0") is None
    assert _cache.unpacked(b"", "name") is None
    assert _cache.unpacked(_cache.packed("", b""), "") == b""


def test_a_file_of_another_name_is_not_read(tmp_path):
    cache = _cache.Cache(tmp_path / "new")
    cache.put("one", b"1")
    (file,) = cache.folder.iterdir()
    cache.put("other", b"2")
    (theirs,) = set(cache.folder.iterdir()) - {file}
    file.replace(theirs)
    assert cache.get("other") is None
    cache.put("other", b"2")
    assert cache.get("other") == b"2"


@pytest.mark.parametrize("i", range(8))
def test_a_damaged_program_is_traced_anew_and_replaced(i, folder):
    seen = []
    watched(seen)(arm(), np.arange(3.0))
    (file,) = folder.iterdir()
    good = file.read_bytes()
    file.write_bytes(damaged(good, i))
    for count in (2, 2):
        out, total = watched(seen)(arm(), np.arange(3.0))
        np.testing.assert_array_equal(out["twice"], [0.0, 2.0, 4.0])
        assert (float(total), len(seen)) == (5.0, count)
    assert file.read_bytes()[:16] == good[:16]


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="no modes of files here")
def test_the_cache_is_its_owners_alone(tmp_path):
    (tmp_path / "mine").mkdir(mode=0o755)
    for folder in (tmp_path / "new" / "deep", tmp_path / "mine"):
        cache = _cache.Cache(folder)
        cache.put("name", b"content")
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700
        assert [stat.S_IMODE(f.stat().st_mode) for f in folder.iterdir()] == [0o600]
    for mode in (0o770, 0o707, 0o777):
        (tmp_path / "mine").chmod(mode)
        with pytest.warns(UserWarning, match="mine: others may write to it, so no compiled"):
            assert keep_in(tmp_path / "mine") is None
        assert float(watched([])(arm(), np.arange(3.0))[1]) == 5.0
        assert len(list((tmp_path / "mine").iterdir())) == 1


def test_a_cache_is_pruned_by_age_and_size(tmp_path):
    cache = _cache.Cache(tmp_path)
    now = time.time()
    for i in range(10):
        cache.put(f"{i}", bytes(1000))
        file = cache.file(f"{i}")
        os.utime(file, (now, now - 100 * i))
    cache.prune(oldest=450)
    assert [cache.get(f"{i}") is not None for i in range(10)] == [True] * 5 + [False] * 5
    for i in range(5):
        os.utime(cache.file(f"{i}"), (now, now - 100 * i))
    assert cache.get("4") is not None  # used again: now it is the youngest
    size = cache.file("0").stat().st_size
    cache.prune(largest=4 * size)
    assert [cache.get(f"{i}") is not None for i in range(5)] == [True, True, False, False, True]


def test_inside_a_larger_program_it_is_a_function_like_any_other(folder):
    seen = []
    call = watched(seen)
    slope = jax.grad(lambda x: jnp.sum(call(arm(), x)[0]["twice"]))(jnp.arange(3.0))
    np.testing.assert_array_equal(slope, 2.0)
    assert not list(folder.iterdir())


@pytest.mark.parametrize("keeping", [True, False])
def test_a_program_that_is_called_seldom_computes_the_same_alone_and_inside_another(
    keeping, tmp_path
):
    @kept.kept(like=0, seldom=True)
    def cubes(x):
        return jax.lax.map(lambda y: y**3, x)

    keep_in(tmp_path if keeping else None)
    try:
        x = np.arange(4.0)
        np.testing.assert_allclose(cubes(x), x**3)
        np.testing.assert_allclose(jax.jit(lambda y: 2 * cubes(y))(x), 2 * x**3)
    finally:
        keep_in(None)


def test_a_folder_that_cannot_be_written_is_no_reason_to_fail(tmp_path):
    (tmp_path / "file").write_text("in the way")
    keep_in(tmp_path / "file" / "folder")
    try:
        assert float(watched([])(arm(), np.arange(3.0))[1]) == 5.0
    finally:
        keep_in(None)


def test_a_second_command_traces_no_fit_and_answers_the_same(tmp_path):
    """Two processes with one cache, the second on a recording of another length."""
    rng = np.random.default_rng(0)
    for i, count in enumerate((300, 550)):
        time = np.arange(count) / 50.0
        ringing = 0.1 * np.exp(-0.1 * time) * np.cos(5.0 * time)
        rows = np.column_stack([time, ringing + 1e-3 * rng.standard_normal(count)])
        np.savetxt(tmp_path / f"{i}.csv", rows, delimiter=",", header="t,q1", comments="")
        (tmp_path / f"{i}.toml").write_text(
            '[inertia]\njoints = ["cart"]\nunits = ["m"]\nmatrix = [[2.0]]\n\n'
            f'[[recordings]]\nfile = "{i}.csv"\nnoise = 1e-3\n'
        )
    code = """
import sys
import residyn
residyn.set_up(cache=sys.argv[1])
import jax.export
traced, own = [], jax.export.export
jax.export.export = lambda *given, **more: traced.append(given) or own(*given, **more)
fit = residyn.fit(residyn.load(sys.argv[2]))
print(len(traced), *(n.value for n in fit.numbers))
"""

    def told(cache, i):
        command = [sys.executable, "-c", code, str(tmp_path / cache), str(tmp_path / f"{i}.toml")]
        done = subprocess.run(command, capture_output=True, text=True, check=True, env=os.environ)
        count, *numbers = done.stdout.split()
        return int(count), [float(x) for x in numbers]

    assert told("one", 0)[0] > 0
    count, numbers = told("one", 1)
    assert count == 0
    _, alone = told("other", 1)
    np.testing.assert_array_equal(numbers, alone)
    # Every file of it damaged, the numbers are the same: those that JAX compiled are checked too.
    files = sorted((tmp_path / "one").iterdir())
    assert len(files) > 4  # traced and compiled
    for i, file in enumerate(files):
        file.write_bytes(damaged(file.read_bytes(), i))
    count, numbers = told("one", 1)
    assert count > 0
    np.testing.assert_array_equal(numbers, alone)
    assert told("one", 1)[0] == 0

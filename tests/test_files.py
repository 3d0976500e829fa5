"""Files are written whole or not at all, and read only as far as such files go."""

import contextlib
import os
import resource
import signal
import stat

import pytest

from residyn.errors import InputError
from residyn.files import check_writable, read_bytes, write


@contextlib.contextmanager
def small_disk():
    """Nothing that is written within may have more than 1 kB; a log of these tests may."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    old = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, old)


def test_a_full_disk_leaves_the_old_file_and_nothing_beside_it(tmp_path):
    write(tmp_path / "x", "old")
    with small_disk():
        with pytest.raises(InputError, match=r"x: cannot be written \(File too large\)"):
            write(tmp_path / "x", "new" * 1000)
        with pytest.raises(InputError):
            write(tmp_path / "y", "new" * 1000)
    assert {f.name: f.read_text() for f in tmp_path.iterdir()} == {"x": "old"}


def test_an_interruption_leaves_the_old_file(tmp_path, monkeypatch):
    write(tmp_path / "x", "old")

    def stop(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", stop)
    with pytest.raises(KeyboardInterrupt):
        write(tmp_path / "x", "new")
    assert {f.name: f.read_text() for f in tmp_path.iterdir()} == {"x": "old"}


def test_what_was_there_keeps_its_mode_and_its_link(tmp_path):
    (tmp_path / "x").write_text("old")
    (tmp_path / "x").chmod(0o640)
    (tmp_path / "link").symlink_to("x")
    check_writable(tmp_path / "link")
    write(tmp_path / "link", "new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "x").read_text() == "new"
    assert stat.S_IMODE((tmp_path / "x").stat().st_mode) == 0o640
    write(tmp_path / "y", "new")
    (tmp_path / "z").write_text("")
    assert (tmp_path / "y").stat().st_mode == (tmp_path / "z").stat().st_mode
    assert len(list(tmp_path.iterdir())) == 4


@pytest.mark.parametrize("name", ["no/x", ".", "x\0", "n" * 300, "file/x", "/proc/x"])
def test_a_place_that_cannot_be_written_is_told_before(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("")
    for call in (check_writable, lambda path: write(path, "x")):
        with pytest.raises(InputError, match="cannot be written") as error:
            call(name)
        assert "\n" not in str(error.value)


def test_devices_and_pipes_are_written_to_as_they_are():
    check_writable("/dev/null")
    write("/dev/null", "x")
    assert stat.S_ISCHR(os.stat("/dev/null").st_mode)
    with pytest.raises(InputError, match="No space left"):
        write("/dev/full", "x")


def test_a_huge_file_is_refused_unread(tmp_path):
    with open(tmp_path / "huge.csv", "wb") as file:
        file.truncate(10**12)  # sparse: read whole, it would not fit into any memory
    with pytest.raises(InputError, match="more than 300 MB"):
        read_bytes(tmp_path / "huge.csv", "CSV file")
    with pytest.raises(InputError, match="more than 10 MB"):
        read_bytes("/dev/zero", "TOML file")
    with pytest.raises(InputError, match="no ordinary file"):
        read_bytes("/dev/zero", "CSV file")

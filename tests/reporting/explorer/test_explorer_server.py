"""The live server: who may ask it, and what it answers. No browser is needed here."""

import json
import shutil
import socket
import time

import pytest

import residyn
from residyn import demo

pytest.importorskip("starlette")
pytest.importorskip("uvicorn")
pytest.importorskip("httpx")

from starlette.testclient import TestClient

from residyn.errors import InputError
from residyn.reporting.explorer import page
from residyn.reporting.explorer.files import ExperimentFiles
from residyn.reporting.explorer.server import Explorer, serve

PORT = 8000
OWN = f"http://127.0.0.1:{PORT}"


class Idle:
    """In place of a workbench, for what needs no numbers."""

    study = text = files = None

    def state(self):
        return {"ready": False, "words": "smoothing", "error": "", "version": 0}

    def stop(self):
        pass


@pytest.fixture
def explorer(monkeypatch):
    monkeypatch.setattr("residyn.reporting.explorer.server.Workbench", lambda *a, **k: Idle())
    with demo.experiment_file() as path:
        experiment = residyn.load(path)
    return Explorer(experiment, name="<b>bold</b>.toml", token="secret")


@pytest.fixture
def client(explorer):
    return TestClient(explorer.app(PORT), base_url=OWN)


def test_of_a_port_that_is_taken_the_line_says_which_is_not(explorer):
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(InputError, match=f"--port {port}: .*; --port 0 takes one that is free"):
            serve(explorer, port, print)


def test_its_own_page_is_served_with_a_strict_policy(client):
    answer = client.get("/secret/")
    assert answer.status_code == 200
    policy = answer.headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    assert answer.headers["referrer-policy"] == "no-referrer"
    assert answer.headers["x-content-type-options"] == "nosniff"
    assert "<b>bold" not in answer.text  # a name is text


def test_every_file_of_the_page_is_served_and_no_other(client):
    for name in page.FILES:
        assert client.get(f"/secret/static/{name}").status_code == 200, name
    for name in ("payload.py", "..%2Fserver.py", "nothing.js"):
        assert client.get(f"/secret/static/{name}").status_code == 404, name


def test_nothing_is_fetched_from_elsewhere(client):
    texts = [client.get("/secret/").text, *map(page.static, page.MODULES)]
    for text in texts:
        assert "//cdn" not in text
        assert "https://" not in text


@pytest.mark.parametrize("path", ["/", "/static/explorer.js", "/api/0/state", "/wrong/api/0/state"])
def test_without_the_token_there_is_nothing(client, path):
    assert client.get(path).status_code == 404


@pytest.mark.parametrize("host", ["evil.example", f"evil.example:{PORT}", "127.0.0.1:9999", ""])
def test_a_wrong_host_is_refused(client, host):
    assert client.get("/secret/api/0/state", headers={"Host": host}).status_code == 403


@pytest.mark.parametrize(
    "origin", ["https://evil.example", "null", "http://127.0.0.1:9999", f"https://127.0.0.1:{PORT}"]
)
def test_a_wrong_origin_is_refused(client, origin):
    headers = {"Origin": origin}
    assert client.get("/secret/api/0/state", headers=headers).status_code == 403
    asked = client.post("/secret/api/0/fit", json={}, headers=headers)
    assert asked.status_code == 403


def test_another_site_is_refused_by_what_the_browser_says(client):
    for site in ("cross-site", "same-site"):
        headers = {"Sec-Fetch-Site": site}
        assert client.get("/secret/api/0/state", headers=headers).status_code == 403


def test_what_changes_something_needs_an_origin_and_json(client):
    address, own = "/secret/api/0/hide", {"Origin": OWN}
    assert client.post(address, json={}).status_code == 403
    assert client.post(address, data={"a": "b"}, headers=own).status_code == 403
    assert client.post(address, json={"a": "x" * 200_000}, headers=own).status_code == 403
    assert client.get(address).status_code == 405
    assert client.post(address, json={}, headers=own).status_code == 404  # idle: no study yet


def test_its_own_requests_are_answered(client):
    assert client.get("/secret/api/0/state", headers={"Origin": OWN}).json()["words"] == "smoothing"
    local = {"Host": f"localhost:{PORT}", "Origin": f"http://localhost:{PORT}"}
    assert client.get("/secret/api/0/state", headers=local).status_code == 200
    assert client.get("/secret/api/7/state").status_code == 404


# -- files -------------------------------------------------------------------------------------


@pytest.fixture
def folder(tmp_path):
    with demo.experiment_file() as path:
        for name in ("experiment.toml", "release.csv", "check.csv"):
            shutil.copy(path.parent / name, tmp_path / name)
    return tmp_path


def test_a_recording_that_changes_and_one_that_is_new_are_offered(folder):
    shutil.copy(folder / "check.csv", folder / "old one.csv")
    files = ExperimentFiles(folder / "experiment.toml")
    assert (files.changed(), files.new()) == ([], [])
    shutil.copy(folder / "release.csv", folder / "another one.csv")
    text = (folder / "check.csv").read_text()
    (folder / "check.csv").write_text("\n".join(text.splitlines()[:-5]) + "\n")
    assert (files.changed(), files.new()) == (["check.csv"], ["another one.csv"])
    again = ExperimentFiles(folder / "experiment.toml", ["another one.csv"], files.before)
    assert (again.changed(), again.new()) == ([], [])
    # One that was there is offered once it changes; one that was not goes on being offered.
    shutil.copy(folder / "release.csv", folder / "old one.csv")
    shutil.copy(folder / "release.csv", folder / "later.csv")
    assert again.new() == ["later.csv", "old one.csv"]
    reread = ExperimentFiles(folder / "experiment.toml", (), files.before)
    assert reread.new() == ["another one.csv", "later.csv", "old one.csv"]
    names = [r.name for r in again.experiment.recordings]
    assert names == ["release.csv", "check.csv", "another one.csv"]
    first, check, added = again.experiment.recordings
    assert (added.role, added.theta2) == ("fit", first.theta2)
    assert len(check.time) == len(files.experiment.recordings[1].time) - 5
    # What is saved is an experiment file that says the same.
    (folder / "saved.toml").write_text(again.text)
    saved = residyn.load(folder / "saved.toml")
    assert [r.name for r in saved.recordings] == names
    assert (saved.recordings[2].noise == added.noise).all()


def test_a_new_file_that_is_no_recording_is_one_line(folder):
    (folder / "notes.csv").write_text("a,b\nnothing,here\n")
    with pytest.raises(InputError, match=r"notes\.csv"):
        ExperimentFiles(folder / "experiment.toml", ["notes.csv"])


# -- the newest request wins -------------------------------------------------------------------


def test_of_one_window_only_the_newest_is_begun_and_two_do_not_disturb_each_other():
    import asyncio
    import threading

    from residyn.reporting.explorer.workbench import Worker

    begun, gate = [], threading.Event()

    def work(name):
        begun.append(name)
        gate.wait(10)
        return name

    async def ask():
        worker = Worker({})
        first = asyncio.create_task(worker.newest("a", 1, lambda: work("a1")))
        while not begun:
            await asyncio.sleep(0.01)
        more = [
            asyncio.create_task(worker.newest(w, n, lambda w=w, n=n: work(f"{w}{n}")))
            for w, n in (("a", 2), ("b", 1), ("a", 3))
        ]
        await asyncio.sleep(0.05)
        gate.set()
        return [await each for each in (first, *more)]

    assert asyncio.run(ask()) == ["a1", None, "b1", "a3"]
    assert begun == ["a1", "b1", "a3"]


# -- the command -------------------------------------------------------------------------------


def test_the_command_complains_in_one_line(folder, capsys):
    from residyn.cli import main

    for args, line in (
        ([str(folder / "none.toml")], "none.toml"),
        ([str(folder / "experiment.toml"), "--with", "magic"], "magic"),
        ([str(folder / "experiment.toml"), "--port", "70000"], "--port"),
    ):
        assert main(["explore", *args, "--no-browser", "--no-cache"]) == 2
        said = capsys.readouterr().err
        assert line in said
        assert len(said.splitlines()) == 1


def test_the_command_serves_until_it_is_interrupted(folder):
    import signal
    import subprocess
    import sys
    import urllib.request

    command = [sys.executable, "-m", "residyn", "explore", str(folder / "experiment.toml")]
    with subprocess.Popen(
        [*command, "--no-browser"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as running:
        assert running.stdout is not None
        address = running.stdout.readline().strip()
        assert address.startswith("http://127.0.0.1:")
        for _ in range(100):
            try:
                with urllib.request.urlopen(f"{address}api/0/state") as answer:
                    assert "ready" in json.load(answer)
                break
            except OSError:
                time.sleep(0.1)
        else:
            pytest.fail("the server does not answer")
        running.send_signal(signal.SIGINT)
        assert running.wait(60) == 0
        assert running.stderr is not None
        assert "Traceback" not in running.stderr.read()

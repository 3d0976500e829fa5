"""How long a click on the explorer's page takes, in a real browser, on the demo.

    python -m benchmarks.explorer_speed [--toggles 30] [--seed 1] [--pause 0.2]

It starts `residyn explore demo`, waits until the search has ended, and toggles effects at random
among those that the page shows first, at most three at a time, waiting for the exact answer each
time. A model that comes up again is left out: only what the page has not shown before is timed.
Wall times are of the browser, from the click to the frame that shows the answer; CPU times are of
the server, which also fits ahead meanwhile. The load of the machine stands beside them.
"""

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from tests.chromium import complaints, driver, until

MOST = 3  # effects at a time
PATIENCE = 20  # s; what the smoother does not settle takes many starts, and longer
_WATCH = """
window.seen = [];
const status = document.querySelector(".status");
const look = () => requestAnimationFrame((now) =>
  seen.push([performance.now(), status.className, status.textContent]));
new MutationObserver(look).observe(status, { attributes: true, childList: true });
"""
_CLICK = """
window.seen = [];
const began = performance.now();
document.querySelector(`.chip[data-effect="${arguments[0]}"]`).click();
return began;
"""


def cpu(pid: int) -> float:
    """CPU seconds of a process so far."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def toggled(browser, pid: int, label: str) -> dict[str, float | str]:
    """One toggle, ms: `first` (until the page has answered at all), `near` (least squares by the
    smoother, or better), `smoothed` (the same where it was by the smoother), `cpu` of the server
    until then; `how` the first answer was."""
    before = cpu(pid)
    began = browser.execute_script(_CLICK, label)
    found: dict[str, float | str] = {}

    def answered() -> bool:
        for at, kind, words in browser.execute_script("return seen"):
            found.setdefault("first", at - began)
            found.setdefault("how", words.split(":")[0])
            exact = words.startswith("refitted")
            if exact or "error" in kind:
                found["smoothed"] = at - began if "smoother" in words else np.nan
                found["near"] = at - began if exact else np.nan
                return True
        return False

    try:
        until(answered, PATIENCE)
    except AssertionError:
        found["near"] = np.inf
        found["smoothed"] = np.nan
    found["cpu"] = 1e3 * (cpu(pid) - before)
    return found


def main() -> None:
    """Toggle, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--toggles", type=int, default=30)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--pause", type=float, default=0.2, help="s between an answer and a click")
    given = parser.parse_args()
    random = np.random.default_rng(given.seed)
    command = [sys.executable, "-m", "residyn", "explore", "demo", "--no-browser"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        browser = driver()
        try:
            browser.get(server.stdout.readline().strip())
            until(lambda: browser.find_elements("css selector", ".chip"), 600)
            shown = cpu(server.pid)
            until(lambda: not browser.find_elements("css selector", ".searching"), 600)
            print(
                f"the page: {shown:.0f} s of CPU; the search: {cpu(server.pid) - shown:.0f} s more"
            )
            browser.execute_script(_WATCH)
            load = os.getloadavg()[0]
            rows = _walk(browser, server.pid, random, given)
            assert complaints(browser) == []
        finally:
            browser.quit()
            server.kill()
    print(f"seed {given.seed}, load {load:.1f} before and {os.getloadavg()[0]:.1f} after")
    for name in ("first", "near", "smoothed", "cpu"):
        each = np.array([r[name] for r in rows])
        each = each[~np.isnan(each)]
        low, middle, high = np.percentile(each, [10, 50, 90], method="nearest")
        print(f"{name:9}{middle:8.0f} ms median of {len(each)}, {low:.0f} to {high:.0f} in 8 of 10")


def _walk(browser, pid: int, random: np.random.Generator, given: argparse.Namespace):
    labels = browser.execute_script(
        "return [...document.querySelectorAll('.chips')[0].children].map((c) => c.dataset.effect)"
    )
    chosen: list[str] = []
    known: set[frozenset[str]] = {frozenset()}
    rows = []
    while len(rows) < given.toggles:
        label = str(random.choice(labels))
        if label not in chosen and len(chosen) == MOST:
            label = str(random.choice(chosen))
        found = toggled(browser, pid, label)
        time.sleep(given.pause)
        chosen = browser.execute_script(
            "return [...document.querySelectorAll('.chip[aria-pressed=true]')]"
            ".map((c) => c.dataset.effect)"
        )
        if frozenset(chosen) not in known:
            known.add(frozenset(chosen))
            rows.append(found)
            print(
                f"{found['first']:6.0f} {found['near']:7.0f} {found['cpu']:7.0f} ms"
                f"  {found['how']}: {' + '.join(chosen)}",
                flush=True,
            )
    return rows


if __name__ == "__main__":
    main()

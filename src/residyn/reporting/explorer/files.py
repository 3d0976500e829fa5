"""The files of an experiment while a page looks at it: which have changed, and which are new.

A recording that comes into the experiment's folder, or changes there, while the page is open and is
not in the experiment file is offered as a further one. It is read with the keys of the first fitted
recording, as the file would say it if the same table stood there once more; that text is what "save
as TOML" saves.
"""

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path

from ...files import read_text
from ...recordings.experiment import Experiment, from_text
from ...recordings.new_experiment import toml_value

_NOT_SHARED = ("file", "role")


class ExperimentFiles:
    """An experiment file, its recordings, and further recordings of its folder."""

    def __init__(
        self,
        path: Path,
        added: Sequence[str] = (),
        before: Mapping[str, tuple[int, int] | None] | None = None,
    ):
        """Read the file; `added` are names of further recordings in its folder, `before` the CSV
        files that were in it when the page began, by name: None are those that are in it now.

        **Raises:** `InputError`.
        """
        self.path, self.folder, self.added = path, path.parent, tuple(added)
        text = read_text(path, "TOML file").replace("\r\n", "\n")
        self.text = text + "".join(_table(text, name) for name in self.added)
        self.experiment: Experiment = from_text(self.text, self.folder, str(path), str(path))
        self.names = tuple(r.name for r in self.experiment.recordings)
        self.before = {x: self._stamp(x) for x in self._csv()} if before is None else before
        self._stamps = {name: self._stamp(name) for name in (path.name, *self.names)}

    def _stamp(self, name: str) -> tuple[int, int] | None:
        try:
            found = (self.folder / name).stat()
        except OSError:
            return None
        return found.st_mtime_ns, found.st_size

    def changed(self) -> list[str]:
        """Names of files that are not as they were when they were read."""
        return [name for name, was in self._stamps.items() if self._stamp(name) not in (was, None)]

    def new(self) -> list[str]:
        """Names of CSV files in the folder that came or changed since the page began and are no
        recording of the experiment."""
        known = {(self.folder / name).resolve() for name in self.names}
        return [
            name for name in self._csv()
            if (self.folder / name).resolve() not in known
            and (name not in self.before or self._stamp(name) != self.before[name])
        ]  # fmt: skip

    def _csv(self) -> list[str]:
        try:
            return sorted(p.name for p in self.folder.glob("*.csv"))
        except OSError:
            return []


def _table(text: str, name: str) -> str:
    """A `[[recordings]]` table for one more recording, with the keys of the first fitted one."""
    entries = tomllib.loads(text).get("recordings", [])
    first = next((e for e in entries if e.get("role", "fit") == "fit"), {})
    keys = {"file": name, **{k: v for k, v in first.items() if k not in _NOT_SHARED}}
    lines = [f"{key} = {toml_value(value)}" for key, value in keys.items()]
    return "\n\n[[recordings]]\n" + "\n".join(lines) + "\n"

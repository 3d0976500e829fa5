"""The picture of the error falling: `python -m benchmarks.readme_picture` writes docs/images."""

from importlib.resources import files
from pathlib import Path

import residyn
from residyn.plot import errors


def main() -> None:
    """Fit the demo's recording twice and draw both errors."""
    experiment = residyn.load(str(files("residyn") / "data/demo/experiment.toml"))
    fits = [residyn.fit(experiment, effects=e) for e in ([], ["coulomb_friction:elbow"])]
    figure = errors(fits, ["springs and dampers", "with coulomb_friction:elbow"])
    figure.savefig(
        Path(__file__).parents[1] / "docs/images/errors.svg",
        facecolor="white",
        bbox_inches="tight",
        metadata={"Date": None},
    )


if __name__ == "__main__":
    main()

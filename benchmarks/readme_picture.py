"""The picture of the error falling: `python -m benchmarks.readme_picture` writes docs/images."""

from importlib.resources import files
from pathlib import Path

import residyn
from residyn.reporting.figures import ladder


def main() -> None:
    """Diagnose the demo's recording and draw the ladder."""
    experiment = residyn.load(str(files("residyn") / "data/demo/experiment.toml"))
    found = residyn.diagnose(experiment)
    print(found)
    ladder(found).savefig(
        Path(__file__).parents[1] / "docs/images/errors.svg",
        facecolor="white",
        bbox_inches="tight",
        metadata={"Date": None},
    )


if __name__ == "__main__":
    main()

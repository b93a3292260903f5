# Two commands are enough on a fresh machine: `make demo` and `make test`.
# Each makes the environment (.venv) it needs.

PYTHON  ?= python3
VENV    ?= .venv
BIN     := $(VENV)/bin
LIMBCLI := $(BIN)/limbcli
OUT     ?= out
DEMO    ?= demo
CASES   ?= $(patsubst %/case.toml,%,$(wildcard cases/*/case.toml))
JOBS    ?=
WORKERS ?= 2
# Two test processes share the cores: each keeps its libraries and simulations to one thread (a small simulation takes
# twice the processor time on two). Modules are kept compiled, as many tests start the program.
ONE     := OMP_NUM_THREADS=1 MKL_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 LIMBCLI_THREADS=1 PYTHONDONTWRITEBYTECODE=

.PHONY: help env demo test test-quick lint types cases bench bench-against fuzz hidden docs clean
.DELETE_ON_ERROR:

help:            ## list what can be made
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*## */\t/' | expand -t 14

env: $(VENV)/.ready   ## the environment, in .venv

$(VENV)/.ready: pyproject.toml
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@$(BIN)/python -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "limbcli needs Python 3.11 or newer; try: make PYTHON=python3.11 $(MAKECMDGOALS)"; exit 1; }
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e .
	@touch $@

# What tests, checks and benchmarks need is not installed for the demo and the cases.
$(VENV)/.dev: $(VENV)/.ready
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[dev]'
	@touch $@

# Quadratic tetrahedra and measurements simulated on another mesh than the fit's, as by default; to be quick, 10 N
# and edges of 4 mm under the probe instead of 2.5: `batch` keeps the options of a stage that was called by hand.
# The measurements hide what no stage knows of, a stiff skin: the diagnosis has to name it.
demo: env        ## the main job: a synthetic subject through every stage, to a report with a diagnosis
	$(LIMBCLI) phantom $(DEMO)/subject --seed 7 --max-force-n 10 --effect skin-layer=4 --force
	$(LIMBCLI) segment $(DEMO)/subject --out $(DEMO)/results
	$(LIMBCLI) mesh $(DEMO)/subject --out $(DEMO)/results --size-mm 4 --far-size-mm 12
	$(LIMBCLI) batch $(DEMO)/subject --out $(DEMO)/results --diagnose
	@echo "hidden in the measurements:  $$(sed -n 's/^effect = "\(.*\)"/\1/p' $(DEMO)/subject/truth/truth.toml)"
	@sed -n 's/^ *"p1: diagnosis: \(.*\)",*$$/diagnosis:                 \1/p' $(DEMO)/results/report/report.json
	@echo "the whole of it, to be opened in a browser: $(DEMO)/results/report/report.html"

lint: $(VENV)/.dev   ## style and format
	$(BIN)/ruff check limbcli tests docs
	$(BIN)/ruff format --check limbcli tests docs

types: $(VENV)/.dev  ## type checks
	$(BIN)/mypy

# The solver's kernels are compiled once, beside the checks of style and types, before two test processes would each
# compile the same.
COMPILE := $(BIN)/python -m limbcli.stages.machine.kernels

test: $(VENV)/.dev   ## everything that must hold
	@{ $(ONE) $(COMPILE) && $(ONE) $(BIN)/python -m tests.compile_kernels; } & compiling=$$!; $(MAKE) --no-print-directory lint types && wait $$compiling
	$(ONE) $(BIN)/python -m pytest -n $(WORKERS) --dist worksteal --durations=15

test-quick: $(VENV)/.dev  ## the part that answers sooner
	@$(ONE) $(COMPILE)
	@$(ONE) $(BIN)/python -m tests.compile_kernels
	$(ONE) $(BIN)/python -m pytest -n $(WORKERS) --dist worksteal -m "not slow"

# Only what changed is redone; one that fails does not stop the others. The shell takes CASES apart: any paths
# will do, also with patterns and quotes; what is no folder is left out.
cases: env       ## all of cases/, or CASES=path/*: compared with expected.toml where there is one (JOBS=N)
	@set --; for each in $(CASES); do if test -d "$$each"; then set -- "$$@" "$$each"; fi; done; \
	test $$# -gt 0 || { echo "there is no case folder in $(CASES)"; exit 2; }; \
	LIMBCLI_OUT="$(OUT)" $(LIMBCLI) batch "$$@" --expect $(if $(JOBS),--jobs $(JOBS))

bench: $(VENV)/.dev  ## benchmarks, as tables
	$(BIN)/python -m tests.benchmarks

bench-against: $(VENV)/.dev ## the commands' processor time beside that of COMMIT=... (ROWS=help,segment)
	@test -n "$(COMMIT)" || { echo "give the commit to compare with: make bench-against COMMIT=v0.1.0"; exit 2; }
	$(BIN)/python -m tests.benchmarks.against $(COMMIT) $(if $(ROWS),--rows $(ROWS))

fuzz: $(VENV)/.dev   ## 20,000 damaged files, as a table of how they were answered
	$(ONE) $(BIN)/python -m tests.benchmarks.fuzz

hidden: $(VENV)/.dev ## the hidden-effect study: resumable, confusion matrix and gates in out/hidden
	$(ONE) $(BIN)/python -m tests.benchmarks.hidden_study --out $(OUT)/hidden --repeats 6 --own-tissue

docs: $(VENV)/.docs   ## the documentation, in out/docs; a warning is an error
	$(BIN)/python -m sphinx -W --keep-going -q -b html docs $(OUT)/docs
	@echo $(OUT)/docs/index.html

$(VENV)/.docs: $(VENV)/.ready
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[docs]'
	@touch $@

clean:           ## what was made, except the environment
	rm -rf $(OUT) $(DEMO) build dist docs/generated .pytest_cache .mypy_cache .ruff_cache
	find limbcli tests -name __pycache__ -type d -prune -exec rm -rf {} +

# Each target sets up .venv by itself, as far as it needs it, and only when pyproject.toml or
# constraints.txt has changed. `make` alone lists the targets. Extra flags go in ARGS:
#   make compare ARGS="--laws cnvc lnvc"
# Another Python for a new .venv:  make clean compare PYTHON=/path/to/python

VENV := .venv
PY := $(VENV)/bin/python
ARGS ?=
# Test processes: one for each core.
JOBS ?= auto

# The first Python that runs, has the right version, and can make a virtual environment.
can_make_venv := import sys, venv, ensurepip; sys.exit(not (3, 10) <= sys.version_info[:2] < (3, 14))
PYTHON ?= $(shell for p in python3.11 python3.12 python3.13 python3.10 python3; do \
	"$$p" -c '$(can_make_venv)' >/dev/null 2>&1 && echo "$$p" && break; done)

.PHONY: help
help: ## list these targets
	@echo 'usage: make TARGET [ARGS="..."]'
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  %-15s %s\n", $$1, $$2 }' \
		$(firstword $(MAKEFILE_LIST))

# ---- commands ---------------------------------------------------------------------------------

# `qcar --help` lists the same commands; results go into results/ and runs/.
QCAR := $(VENV)/bin/qcar

.PHONY: compare report watch benchmark train sweep learning-report tune figures fidelity calibrate \
	throughput docs
compare: $(VENV)/.installed-compare ## compare the control laws on the paper's worst case
	$(QCAR) $@ $(ARGS)

report: $(VENV)/.installed-report ## the same with an interactive page, results/compare/report.html
	$(QCAR) $@ $(ARGS)

watch: $(VENV)/.installed-watch ## watch a policy drive over the hump
	$(QCAR) $@ $(ARGS)

benchmark: $(VENV)/.installed-train ## score every policy on every track
	$(QCAR) $@ $(ARGS)

ALGO ?= sac
TRACK ?= paper
SEED ?= 0
train: $(VENV)/.installed-train ## train an agent: ALGO=sac TRACK=paper SEED=0
	$(QCAR) $@ --algo $(ALGO) --track $(TRACK) --seed $(SEED) $(ARGS)

sweep: $(VENV)/.installed-sweep ## train over settings and seeds, on this machine or a cluster
	$(QCAR) $@ $(ARGS)

learning-report: $(VENV)/.installed-train ## how agents learn, from the runs in runs/
	$(QCAR) $@ $(ARGS)

tune: $(VENV)/.installed-compare ## tune the gains of the scripted policies, into baselines/tuned.json
	$(QCAR) $@ --out baselines/tuned.json $(ARGS)

figures: $(VENV)/.installed-compare ## make the paper's figures
	$(QCAR) $@ $(ARGS)

fidelity: $(VENV)/.installed-compare ## write docs/fidelity.md: the paper beside ours
	$(QCAR) $@ --out docs/fidelity.md $(ARGS)

calibrate: $(VENV)/.installed-compare ## repeat the calibration on the paper's Table 1
	$(QCAR) $@ $(ARGS)

throughput: $(VENV)/.installed-train ## measure environment steps per second
	$(QCAR) $@ $(ARGS)

docs: docs/conf.py $(VENV)/.installed-docs ## build the documentation into docs/_build/html
	$(PY) -m sphinx -W --keep-going -b html docs docs/_build/html $(ARGS)

# ---- checks -----------------------------------------------------------------------------------

# One BLAS and OpenMP thread for each test process: there is one process for each core.
.PHONY: test test-core test-learning lint
test: $(VENV)/.installed-test ## run all tests
	OMP_NUM_THREADS=1 $(PY) -m pytest -n $(JOBS) $(ARGS)

test-core: $(VENV)/.installed-core ## run what needs no torch, with any Python: VENV=.venv-3.13 PYTHON=...
	OMP_NUM_THREADS=1 $(PY) -m pytest -n $(JOBS) --ignore tests/test_docs.py $(ARGS)

.PHONY: test-lowest
test-lowest: ## run all but the documentation's tests with the lowest versions of pyproject.toml
	@mkdir -p build && grep -oE '"[a-z0-9-]+(\[[a-z,]+\])?>=[0-9.]+' pyproject.toml | grep -v '"torch' \
		| sed -E 's/"([a-z0-9-]+)(\[[a-z,]+\])?>=/\1==/' | sort -u > build/lowest.txt
	$(MAKE) .venv-lowest/.installed-lowest VENV=.venv-lowest CONSTRAINTS=build/lowest.txt
	OMP_NUM_THREADS=1 .venv-lowest/bin/python -m pytest -n $(JOBS) --ignore tests/test_docs.py $(ARGS)

test-learning: $(VENV)/.installed-test ## run the tests that train agents
	$(PY) -m pytest -m learning $(ARGS)

lint: $(VENV)/.installed-test ## check style, format and types
	$(PY) -m ruff check
	$(PY) -m ruff format --check
	$(PY) -m pyright

.PHONY: clean
clean: ## remove .venv, caches and builds (results stay)
	rm -rf $(VENV) build dist *.egg-info docs/_build
	rm -rf .pytest_cache .ruff_cache .hypothesis .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# ---- set-up -----------------------------------------------------------------------------------

extras_compare := plots,run
extras_report := plots,run,mpc,report
extras_watch := plots,run,mpc,render
extras_train := plots,run,mpc,train,render,report
extras_sweep := plots,run,mpc,train,render,report,cluster
extras_core := plots,run,mpc,render,report,test
extras_lowest := plots,run,mpc,train,render,report,test
extras_docs := plots,run,mpc,render,report,docs
extras_test := plots,run,mpc,train,render,report,docs,cluster,rllib,test,dev
stamps := $(addprefix $(VENV)/.installed-,compare report watch train sweep core lowest docs test)

# .venv is ready if it was made here and completely, and its Python still runs.
ready := $(shell [ ! -e $(VENV)/.unfinished ] && [ "$$(cat $(VENV)/.root 2>/dev/null)" = "$(CURDIR)" ] \
	&& $(PY) -c '' 2>/dev/null && echo yes)
CONSTRAINTS := constraints.txt
torch = $(shell sed -n 's/^\(torch==[^ ;]*\).*/\1/p' constraints.txt)

# torch goes first, so that what depends on it finds the tested version and brings no other.
# `test` holds the other sets, so it sets their stamps too.
$(stamps): $(VENV)/.installed-%: pyproject.toml constraints.txt $(if $(ready),,new-venv)
	@echo "Installing qcar_env[$(extras_$*)] into $(VENV): once, some minutes at most"
	$(if $(findstring train,$(extras_$*)),$(PY) -m pip install -c constraints.txt "$(torch)")
	$(PY) -m pip install -c $(CONSTRAINTS) -e ".[$(extras_$*)]"
	@touch $(if $(filter test,$*),$(stamps),$@)

# A .venv that somebody made by hand is used if it has pip, and otherwise left alone.
.PHONY: new-venv
new-venv:
	@if [ -d $(VENV) ] && [ ! -e $(VENV)/.unfinished ] && [ ! -e $(VENV)/.root ]; then \
		$(PY) -m pip --version >/dev/null 2>&1 || { \
			echo "$(VENV) is not ours and has no working pip: remove it and try again" >&2; exit 1; }; \
	else \
		[ -n "$(PYTHON)" ] || { \
			echo "no Python >= 3.10, < 3.14 with venv found: install one (Debian and Ubuntu:" \
				"python3-venv), or name one with PYTHON=/path/to/python" >&2; exit 1; }; \
		"$(PYTHON)" -c '$(can_make_venv)' || { \
			echo "$(PYTHON) is not Python >= 3.10, < 3.14 with venv and ensurepip" >&2; exit 1; }; \
		rm -rf $(VENV) && mkdir $(VENV) && touch $(VENV)/.unfinished && \
		"$(PYTHON)" -m venv $(VENV) && rm $(VENV)/.unfinished; \
	fi
	@printf '%s' "$(CURDIR)" > $(VENV)/.root

export PIP_DISABLE_PIP_VERSION_CHECK := 1
export PYRIGHT_PYTHON_IGNORE_WARNINGS := 1
.NOTPARALLEL:
.DELETE_ON_ERROR:

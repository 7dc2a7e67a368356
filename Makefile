# Two commands do everything: `make reproduce` and `make test`. Needed: Python >= 3.11 and make.

PYTHON ?= python3
VENV ?= .venv
JOBS ?= 2
STAMP := $(VENV)/.installed
BIN := $(VENV)/bin

.DEFAULT_GOAL := help
.PHONY: help venv reproduce test bench clean

help:  ## list the targets
	@awk -F ':.*## ' '/^[a-z]+:.*## / { printf "make %-10s %s\n", $$1, $$2 }' Makefile

venv: $(STAMP)  ## make the virtual environment VENV (.venv) and install into it

reproduce: $(STAMP)  ## run every experiment of the paper that is not stored yet, draw every figure, write the report
	$(BIN)/mvla reproduce
	@echo "Report: results/report.html; tables and figures of each experiment: results/*/"

test: $(STAMP)  ## check style and types, then run every test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/python -m pytest -n $(JOBS) --dist worksteal

bench: $(STAMP)  ## measure how cost grows, then against references, into results/bench
	$(BIN)/mvla bench
	$(BIN)/mvla bench --ratios

clean:  ## delete the virtual environment and what tools left behind; results stay
	rm -rf $(VENV) build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find mvla_sim tests -name __pycache__ -type d -prune -exec rm -rf {} +

# Debian splits the venv module: without its python3-venv, a pip outside the environment can fill it as well.
$(STAMP): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "$(PYTHON) is missing or older than Python 3.11: install a newer one, or name it with PYTHON=..."; exit 1; }
	@if $(PYTHON) -c 'import ensurepip' 2>/dev/null; then $(PYTHON) -m venv --clear $(VENV); \
	elif $(PYTHON) -c 'import pip, venv' 2>/dev/null; then $(PYTHON) -m venv --clear --without-pip $(VENV) && \
	  $(PYTHON) -m pip --python $(BIN)/python install --quiet pip; \
	else echo "$(PYTHON) cannot make virtual environments: apt-get install python3-venv, then run make again"; exit 1; fi
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	@touch $(STAMP)

# Two commands for a fresh machine with Python 3.11 or later: `make demo` and `make test`. Without make: see README.md.

PYTHON ?= python3
VENV ?= .venv
BIN = $(VENV)/bin
# OpenCL for the processor: PoCL needs a linker and libgcc
RUNTIME := $(if $(and $(shell command -v ld),$(shell command -v gcc)),pocl,intel)

.PHONY: demo test thorough check bench docs clean

demo: $(VENV)/demo.stamp
	$(BIN)/python examples/figure6.py --output figure6.png

test: $(VENV)/test.stamp
	$(BIN)/python -m pytest

thorough: $(VENV)/test.stamp
	$(BIN)/python -m pytest -m thorough

check: $(VENV)/test.stamp
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

bench: $(VENV)/bench.stamp
	$(BIN)/python -m bench

docs: $(VENV)/docs.stamp
	$(BIN)/python -m sphinx --fail-on-warning --keep-going --jobs 2 --doctree-dir docs/_build/doctrees docs docs/_build/html

clean:
	rm -rf $(VENV) dist figure6.png docs/_build docs/auto_gallery docs/api/generated

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)

$(VENV)/demo.stamp: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --editable ".[$(RUNTIME)]"
	touch $@

$(VENV)/test.stamp: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --editable ".[$(RUNTIME),dev]"
	touch $@

$(VENV)/bench.stamp: $(VENV)/test.stamp
	$(BIN)/python -m pip install --quiet --editable ".[$(RUNTIME),bench]"
	touch $@

$(VENV)/docs.stamp: $(VENV)/demo.stamp
	$(BIN)/python -m pip install --quiet --editable ".[docs]"
	touch $@

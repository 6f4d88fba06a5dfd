# Two commands for a fresh machine with Python 3.11 or later: `make demo` and `make test`. Without make: see README.md.

PYTHON ?= python3
VENV ?= .venv
BIN = $(VENV)/bin
# What installs into it; uv does in seconds what takes pip minutes
INSTALL ?= $(BIN)/python -m pip install --quiet
# OpenCL for the processor: PoCL needs a linker and libgcc
RUNTIME := $(if $(and $(shell command -v ld),$(shell command -v gcc)),pocl,intel)

# Of the long runs
MINUTES ?= 60
HOURS ?= 1
# What tells whether a version of a dependency is too old
LOWEST = test_package.py show/test_picture.py interfaces/test_interpolator.py ndimage/test_gaps.py $(addprefix formats/test_,medical.py tiff.py hdf5.py)

.PHONY: demo test thorough check style types bench gpu runtimes docs fuzz soak lowest sbom clean

demo: $(VENV)/demo.stamp
	$(BIN)/python examples/figure6.py --output figure6.png

test: $(VENV)/test.stamp
	$(BIN)/python -m pytest

thorough: $(VENV)/test.stamp
	CLVOL_TEST_THOROUGH=1 $(BIN)/python -m pytest -m "" --numprocesses=auto --dist=loadfile --no-loadscope-reorder

check: style types

style: $(VENV)/test.stamp
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/test.stamp
	$(BIN)/mypy
	$(BIN)/towncrier build --draft >/dev/null

bench: $(VENV)/bench.stamp
	$(BIN)/python -m bench

# Errors and times on a GPU; without one on the processor
gpu: $(VENV)/demo.stamp
	$(BIN)/python -m bench.gpu

# Errors with each OpenCL runtime for the processor: pip's, and those of the system
runtimes: $(VENV)/demo.stamp $(VENV)/intel.stamp
	$(BIN)/python -m bench.runtimes

docs: $(VENV)/docs.stamp
	$(BIN)/python -m sphinx --fail-on-warning --keep-going --jobs 2 --doctree-dir docs/_build/doctrees docs docs/_build/html

# Damaged files, for hours; findings are kept
fuzz: $(VENV)/test.stamp
	$(BIN)/python -m tests.fuzz --seconds $$(( 3600 * $(HOURS) ))

# Random work over all that is public, in threads
soak: $(VENV)/test.stamp
	$(BIN)/python -m bench.soak --minutes $(MINUTES)

# With the lowest versions that pyproject.toml allows; they have wheels for Python 3.11
lowest: $(VENV)/lowest.stamp
	$(VENV)/lowest/bin/clvol render phantom:box --mode mip --size 64 64 --output $(VENV)/lowest/frame.png
	$(VENV)/lowest/bin/python -m pytest --numprocesses=2 --dist=loadfile $(addprefix tests/,$(LOWEST))

# What an installation of the package alone brings along, in CycloneDX's format; pip, which installs it, is not part of it
sbom:
	$(PYTHON) -m venv --clear $(VENV)/sbom/tool
	$(VENV)/sbom/tool/bin/python -m pip install --quiet cyclonedx-bom
	$(PYTHON) -m venv --clear --without-pip $(VENV)/sbom/clvol
	$(VENV)/sbom/tool/bin/python -m pip --python $(VENV)/sbom/clvol/bin/python install --quiet .
	$(VENV)/sbom/tool/bin/cyclonedx-py environment --pyproject pyproject.toml --mc-type library --output-reproducible \
		--output-file sbom.cdx.json $(VENV)/sbom/clvol/bin/python

clean:
	rm -rf $(VENV) dist figure6.png sbom.cdx.json docs/_build docs/auto_gallery docs/api/generated

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)

$(VENV)/demo.stamp: pyproject.toml | $(BIN)/python
	$(INSTALL) --editable ".[$(RUNTIME)]"
	touch $@

$(VENV)/test.stamp: pyproject.toml | $(BIN)/python
	$(INSTALL) --editable ".[$(RUNTIME),dev]"
	touch $@

$(VENV)/lowest.stamp: pyproject.toml $(VENV)/test.stamp
	$(BIN)/uv venv --quiet --clear --no-python-downloads --python $(BIN)/python $(VENV)/lowest
	$(BIN)/uv pip install --quiet --python $(VENV)/lowest/bin/python --resolution lowest-direct --editable ".[$(RUNTIME),test]"
	touch $@

$(VENV)/bench.stamp: $(VENV)/test.stamp
	$(INSTALL) --editable ".[$(RUNTIME),bench]"
	touch $@

$(VENV)/intel.stamp: $(VENV)/test.stamp
	$(INSTALL) --editable ".[intel]"
	touch $@

$(VENV)/docs.stamp: $(VENV)/demo.stamp
	$(INSTALL) --editable ".[docs]"
	touch $@

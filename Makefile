# make demo  reproduces the paper, compares the methods and draws a picture
# make test  runs the linters, the type checker and the tests of the code; make test-docs and make test-slow the others
# make bench measures the package beside its peers, into benchmarks/results.md; make bench BENCH=--quick for a look
# Each first sets up what it needs in .venv.

PYTHON ?= python3
# Each worker begins with half of the tests in order, so that those of a file share what is made for them once.
PYTEST ?= -n auto --dist worksteal
BENCH ?=
VENV := .venv
BIN := $(VENV)/bin
INSTALL := $(BIN)/python -m pip install --quiet --constraint constraints.txt

.PHONY: demo test test-docs test-slow coverage bench lint docs figures description clean

demo: $(VENV)/.demo
	@mkdir -p build
	@$(BIN)/spm-pin demo --out build/demo.png

# A worker has one core: threads of OpenBLAS beside those of the others would wait for one another.
test test-docs test-slow coverage: export OPENBLAS_NUM_THREADS := 1

# The linters run beside the tests, and their result is printed last: mypy has one thread.
test: $(VENV)/.test
	@mkdir -p build
	@$(MAKE) --no-print-directory lint >build/lint.txt 2>&1 & lint=$$!; \
	$(BIN)/python -m pytest $(PYTEST) -m "not slow and not documents"; tests=$$?; \
	wait $$lint; linted=$$?; cat build/lint.txt; exit $$((tests | linted))
	@echo "Not run here: pages, examples and benchmarks (make test-docs), sweeps and long comparisons (make test-slow)"

test-docs: $(VENV)/.test
	$(BIN)/python -m pytest $(PYTEST) -m "documents and not slow"

# Lines of spm_pin that the tests run, compiled kernels aside. Counting them slows Python down, so the tests go without.
coverage: $(VENV)/.test
	$(BIN)/python -m pytest $(PYTEST) -m "not slow" --cov --cov-report=
	@$(BIN)/coverage report

test-slow: $(VENV)/.test
	$(BIN)/python -m pytest $(PYTEST) -m slow

bench: $(VENV)/.bench
	$(BIN)/python benchmarks/run.py $(BENCH)

lint: $(VENV)/.test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-logo

# The documentation as a static site in build/site; `make figures` draws its figures anew,
# but for those of the viewer, which need Chromium: docs/site/viewer_figures.py; and MuJoCo's, docs/site/engine_figure.py.
docs: $(VENV)/.test
	$(BIN)/python docs/site/build.py build/site
	@echo "Open build/site/index.html"

figures: $(VENV)/.test
	$(BIN)/python docs/site/figures.py
	$(BIN)/python docs/site/example_figures.py
	$(BIN)/python docs/site/moving_picture.py
	$(BIN)/python docs/site/live_page.py docs/live.html
	$(BIN)/python docs/site/balancer_page.py docs/balancer.html

# Rewrites urdf/meshes, and spm.urdf, spm.srdf, spm.xml, spm.sdf and spm_closures.yaml from their sources.
description: $(VENV)/.demo
	$(BIN)/python scripts/generate_meshes.py
	$(BIN)/python scripts/generate_description.py

$(VENV)/.python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
		echo "spm-pin needs Python 3.11 or newer, and $(PYTHON) is $$($(PYTHON) --version)."; \
		echo "Try for example: make PYTHON=python3.12"; exit 1; }
	@$(PYTHON) -m venv $(VENV)
	@$(BIN)/python -m pip install --quiet --upgrade pip # which installs in half the time of the one that comes with Python
	@touch $@

# Without bytecode of all that is installed, which takes as long as unpacking it; what is imported makes its own.
$(VENV)/.demo: $(VENV)/.python pyproject.toml constraints.txt
	@echo "Installing into $(VENV): 1.3 GB, most of it Pinocchio, CasADi and LLVM; a minute or two, in silence"
	@$(INSTALL) --no-compile --editable '.[plots]'
	@touch $@

$(VENV)/.test: $(VENV)/.demo
	$(INSTALL) --editable '.[plots,cluster,design,viewer,engines,gym,robots,docs,benchmarks,dev]'
	@$(BIN)/python -W ignore -m compileall -q -j 0 $(VENV)/lib || true # as pip, whatever a package has that is no Python
	@touch $@

$(VENV)/.bench: $(VENV)/.demo
	$(INSTALL) --editable '.[plots,benchmarks]'
	@touch $@

clean:
	rm -rf $(VENV) build dist .artifacts .hypothesis .mypy_cache .pytest_cache .ruff_cache .import_linter_cache

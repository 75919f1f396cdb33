# Python 3.11 or newer; choose another with `make PYTHON=python3.12 ...`.
PYTHON ?= python3
BIN := .venv/bin

.PHONY: help demo test test-all coverage lint format bench docs clean

help:
	@echo "make demo    run a dam break and animate it"
	@echo "make test    format check, lint, types, layers, tests"
	@echo "make test-all  tests and those that take long and show more of the same"
	@echo "make coverage  which lines and branches the tests reach"
	@echo "make lint    all of these but the tests"
	@echo "make format  format the code"
	@echo "make bench   run the benchmarks"
	@echo "make docs    build the documentation, build/docs/index.html"
	@echo "make clean   remove the environment and what runs have made"

.venv/.installed: pyproject.toml
	@command -v $(PYTHON) >/dev/null || \
		{ echo "error: $(PYTHON) not found; choose a Python with make PYTHON=..." >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "error: jaxmps needs Python 3.11 or newer, but $(PYTHON) is" \
		"$$($(PYTHON) -V 2>&1); choose another with make PYTHON=..." >&2; exit 1; }
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet -e .
	@touch $@

.venv/.installed-test: .venv/.installed
	$(BIN)/python -m pip install --quiet -e '.[test]'
	@touch $@

.venv/.installed-docs: .venv/.installed
	$(BIN)/python -m pip install --quiet -e '.[docs]'
	@touch $@

demo: .venv/.installed
	$(BIN)/jaxmps run dam_break --spacing 0.02 --until 1.6 --save-every 0.04 --out demo --force
	$(BIN)/jaxmps animate demo/run.vtkhdf --fps 20 --force
	@echo "Pictures and animation:"
	@ls demo/*.png demo/*.gif demo/*.mp4 2>/dev/null | sed 's/^/  /'
	@echo "Data, for ParaView or PyVista:"
	@ls demo/*.vtkhdf | sed 's/^/  /'

lint: .venv/.installed-test
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/pyright --pythonpath $(BIN)/python
	$(BIN)/lint-imports

test: lint
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder

test-all: lint
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder -m ""

coverage: .venv/.installed-test
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder --cov=jaxmps --cov-branch

format: .venv/.installed-test
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

# Large pages: without them, touching fresh memory takes a third of the time of a call with 500 000 particles.
bench: .venv/.installed
	GLIBC_TUNABLES=glibc.malloc.hugetlb=1 $(BIN)/python -m benchmarks

docs: .venv/.installed-docs
	JAX_PLATFORMS=cpu $(BIN)/python -m sphinx -W --keep-going -q -j 2 -b html docs/site build/docs
	$(BIN)/python docs/site/offline.py build/docs
	@echo build/docs/index.html

clean:
	rm -rf .venv build dist out demo .pytest_cache .ruff_cache .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

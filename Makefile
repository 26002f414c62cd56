# Two commands do everything from a bare clone: `make run` and `make test`.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
export OMP_NUM_THREADS ?= 1

.PHONY: run test test-all test-pythons docs quick lint style types checks benchmarks clean

run: $(VENV)/run.done
	$(BIN)/airswing run configs/quickstart.yaml

# The type checker runs in one process while the tests run in two.
test: $(VENV)/test.done style
	$(MAKE) -j2 types checks

checks: $(VENV)/test.done
	$(BIN)/python -m pytest -m "not slow" -n 2 --dist loadfile --no-loadscope-reorder tests

# Everything, with the statistics and fuzzing that take minutes, and the notebooks in new kernels.
test-all: $(VENV)/test.done style
	$(MAKE) types
	$(BIN)/python -m pytest -n 2 --dist loadfile --nbmake --nbmake-timeout=300 tests notebooks

# The tests on every supported Python that is installed, each in an environment of its own.
test-pythons:
	for version in 3.11 3.12 3.13 3.14; do \
		if python$$version --version >/dev/null 2>&1; then \
			$(MAKE) test PYTHON=python$$version VENV=.venv-$$version || exit 1; \
		else echo "python$$version is not installed"; fi; \
	done

# Linters, the import direction, and the tests of the folders that differ from main.
CHANGED = $(wildcard $(addprefix tests/,$(shell git diff --name-only main -- pipeline | cut -d/ -f3 | sort -u)))
quick: $(VENV)/test.done lint
	$(BIN)/python -m pytest -q -m "not slow" -n 2 tests/test_layout.py $(CHANGED)

lint: style types

style: $(VENV)/test.done
	$(BIN)/ruff check pipeline tests benchmarks configs docs
	$(BIN)/ruff format --check pipeline tests benchmarks configs docs

types: $(VENV)/test.done
	$(BIN)/mypy

benchmarks: $(VENV)/test.done
	$(BIN)/python -m benchmarks

$(BIN)/python:
	$(PYTHON) -c 'import sys; sys.exit("airswing needs Python 3.11 or later" if sys.version_info < (3, 11) else 0)'
	$(PYTHON) -m venv $(VENV)

$(VENV)/run.done: $(BIN)/python requirements.lock pyproject.toml
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	touch $@

$(VENV)/test.done: $(VENV)/run.done requirements-dev.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements-dev.lock
	touch $@

# The documentation site: docs/_build/html/index.html. Warnings are errors.
docs: $(VENV)/docs.done
	$(BIN)/python -m sphinx -W --keep-going -q -b html docs docs/_build/html

$(VENV)/docs.done: $(VENV)/test.done requirements-docs.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements-docs.lock
	touch $@

clean:
	rm -rf $(VENV) results

# Every target makes .venv by itself when it is missing.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

.PHONY: demo test lint bench clean
.DEFAULT_GOAL := test

demo: $(VENV)/made
	$(BIN)/raden demo --out demo

test: lint
	$(BIN)/pytest

lint: $(VENV)/made
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: $(VENV)/made
	$(BIN)/python benchmarks/startup.py
	$(BIN)/raden bench --out benchmarks/results
	$(BIN)/python benchmarks/onnx_session.py
	$(BIN)/python benchmarks/kernel.py
	$(BIN)/python benchmarks/normals.py

clean:
	rm -rf $(VENV) demo

# torch first and alone: a resolver that sees it late may choose another build
$(VENV)/made: pyproject.toml constraints-dev.txt $(wildcard kernel/*)
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check \
		-c constraints-dev.txt torch scikit-build-core nanobind cmake ninja
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-build-isolation \
		-c constraints-dev.txt -e '.[dev]'
	touch $@

# Every target makes .venv by itself when it is missing.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

.PHONY: demo test lint bench docs links release runtimes clean
.DEFAULT_GOAL := test

demo: $(VENV)/made
	$(BIN)/raden demo --out demo

test: lint runtimes
	$(BIN)/pytest -n auto --maxprocesses 4 --dist loadgroup

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

	rm -rf $(VENV) demo build/site build/notebooks release-work runtimes/made runtimes/node_modules runtimes/onnxruntime-*

# other programs that run exported shaders; tests of what cannot be had here skip
runtimes: runtimes/made

runtimes/made: runtimes/package.json runtimes/install.sh
	runtimes/install.sh

clean:
	rm -rf $(VENV) demo build/site build/notebooks release-work runtimes/made runtimes/node_modules runtimes/onnxruntime-*

# torch first and alone: a resolver that sees it late may choose another build
$(VENV)/made: pyproject.toml constraints-dev.txt $(wildcard kernel/*)
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check \
		-c constraints-dev.txt torch scikit-build-core nanobind cmake ninja
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-build-isolation \
		-c constraints-dev.txt -e '.[dev]'
	touch $@

# Every target makes .venv by itself when it is missing.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

.PHONY: demo test lint bench docs links runtimes clean
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

# the site: build/site/index.html; notebooks run again when they or the package have changed
docs: $(VENV)/made build/notebooks/current
	RADEN_TORCH_DOCS_NOTEBOOKS=cache $(BIN)/sphinx-build -q -W --keep-going -c docs/site . build/site

# what the pages link to outside is asked for, over the network
links: $(VENV)/made
	$(BIN)/sphinx-build -q -b linkcheck -c docs/site . build/links

build/notebooks/current: $(shell find raden_torch kernel -name '*.py' -o -name '*.cpp' -o -name '*.h')
	rm -rf build/notebooks
	mkdir -p build/notebooks
	touch $@

# other programs that run exported shaders; tests of what cannot be had here skip
runtimes: runtimes/made

runtimes/made: runtimes/package.json runtimes/install.sh
	runtimes/install.sh

clean:
	rm -rf $(VENV) demo build/site build/notebooks runtimes/made runtimes/node_modules runtimes/onnxruntime-*

# torch first and alone: a resolver that sees it late may choose another build
$(VENV)/made: pyproject.toml constraints-dev.txt $(wildcard kernel/*)
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check \
		-c constraints-dev.txt torch scikit-build-core nanobind cmake ninja
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-build-isolation \
		-c constraints-dev.txt -e '.[dev]'
	touch $@

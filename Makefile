# `make demo` and `make test` need Python >= 3.11 with its venv module, and nothing else prepared.
PYTHON ?= $(shell for p in python3.13 python3.12 python3.11 python3; do \
	$$p -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null \
	&& echo $$p && break; done)
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready

# One thread for each OpenBLAS call: equal bytes on every machine, and faster on arrays this small.
export OPENBLAS_NUM_THREADS ?= 1

.PHONY: demo test check gate docs wheel opengl both-opengl clean help
.DEFAULT_GOAL := help

help:
	@echo "make demo    render four swinging boxes, run SDPL-SLAM on them, write demo/report.html"
	@echo "make test    the test suite"
	@echo "make check   style, types and the layering of the modules"
	@echo "make gate    the suite smoke, held against baselines/smoke.json"
	@echo "make docs    the documentation site, build/site/index.html"
	@echo "make wheel   build the wheel and try it outside the source tree"
	@echo "make clean   remove what these made, but for the virtual environment"

$(READY): pyproject.toml
	@test -n "$(PYTHON)" || { echo "simbench needs Python 3.11 or newer with its venv module: install python3 and python3-venv (Debian, Ubuntu), or name one: make PYTHON=/path/to/python3.12" >&2; exit 2; }
	@"$(PYTHON)" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { echo "$(PYTHON) does not run or is older than Python 3.11: name a newer one, make PYTHON=/path/to/python3.12" >&2; exit 2; }
	@echo "Making $(VENV) and installing simbench in it"
	@test -x $(BIN)/python || "$(PYTHON)" -m venv $(VENV)
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ".[dev,docs,pyrender]"
	@touch $@

opengl:
	@sh scripts/install_opengl.sh

both-opengl:
	@sh scripts/install_opengl.sh both

demo: $(READY) opengl
	$(BIN)/simbench run SwingingBoxes-v0 --system sdpl --sensor kinect --flow dis --frames 90 --out demo
	@echo "The report: $(CURDIR)/demo/report.html"

test: $(READY) both-opengl
	$(BIN)/python -m pytest

check: $(READY)
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache --no-logo

gate: $(READY) opengl
	rm -rf build/smoke
	$(BIN)/simbench suite smoke --out build/smoke
	$(BIN)/simbench gate build/smoke --baseline baselines/smoke.json

docs: $(READY)
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet --clean
	@echo "The documents: $(CURDIR)/build/site/index.html"

wheel: $(READY) opengl
	bash scripts/check_wheel.sh $(BIN)/python

clean:
	rm -rf demo dist build .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
	find slam simbench tests -name __pycache__ -type d -prune -exec rm -rf {} +

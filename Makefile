# `make run` and `make test` set up everything they need on a Debian-like machine with Python >= 3.11.
# PYTHON=... chooses the interpreter; JOBS=... the number of test workers.

VENV := .venv
BIN  := $(VENV)/bin
PIP  := $(BIN)/python -m pip --disable-pip-version-check --quiet
JOBS ?= 2

# Mesa's OpenGL for the runtime; LLVM for mitsuba, which only tests use. Debian's names.
GL     := libegl1 libgl1 libgl1-mesa-dri
ORACLE := libllvm19

# What JAX compiled is kept, for the test workers to share with each other and with the processes that tests start. LLVM does not
# optimise it: tests compile for longer than they compute, a quarter less so, and their bounds hold without.
COMPILED := XLA_FLAGS=--xla_backend_optimization_level=0 \
            JAX_COMPILATION_CACHE_DIR=$(CURDIR)/.pytest_cache/jax \
            JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS=0 JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES=-1

.PHONY: run test assets lint format lock clean

# The main job: bake, fit, evaluate, time, report.
run: $(VENV)/installed
	@$(call system_packages,$(GL))
	$(BIN)/prt-bench run experiments/quickstart.toml

test: $(VENV)/installed-dev
	@$(call system_packages,$(GL) $(ORACLE))
	$(COMPILED) $(BIN)/python -m pytest --numprocesses $(JOBS) --dist loadfile --no-loadscope-reorder

# Meshes that are not vendored, for the scenes that use them; nothing else needs this step.
assets: $(VENV)/installed
	$(BIN)/prt-bench assets

lint: $(VENV)/installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/basedpyright

format: $(VENV)/installed-dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# Pins and hashes for every platform and Python version, free of index addresses.
COMPILE := $(BIN)/uv pip compile pyproject.toml --universal --python-version 3.11 --generate-hashes \
           --group build --no-emit-index-url --no-annotate --no-header --quiet
lock: $(VENV)/installed-dev
	$(PIP) install uv
	$(COMPILE) --output-file requirements.txt
	$(COMPILE) --extra dev --constraint requirements.txt --output-file requirements-dev.txt

clean:
	rm -rf $(VENV) build dist .pytest_cache .ruff_cache .hypothesis

$(VENV)/installed: requirements.txt pyproject.toml | $(VENV)
	$(call install,requirements.txt)

$(VENV)/installed-dev: requirements-dev.txt pyproject.toml | $(VENV)
	$(call install,requirements-dev.txt)
	@touch $(VENV)/installed

$(VENV):
	@$(find_python); echo "making $(VENV) with $$($$python --version)"; $$python -m venv $(VENV)

# The first interpreter that works. Later versions than these are tried last: some dependencies have no wheels for them yet.
define find_python
suits() { "$$1" -c 'import sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1; }; \
for python in $(PYTHON) python3.12 python3.13 python3.11 python3 none; do suits $$python && break; done; \
if [ $$python = none ]; then \
    echo "prt-bench needs Python 3.11 or later: apt-get install python3 python3-venv, or make PYTHON=/path/to/python" >&2; exit 1; \
fi; \
if ! $$python -c 'import ensurepip' 2>/dev/null; then $(call system_packages,python3-venv); fi
endef

define install
@echo "installing $(1)"
@$(PIP) install --require-hashes --requirement $(1)
@$(PIP) install --no-deps --no-build-isolation --editable .
@touch $@
endef

# Installs what is missing of $(1) when root; otherwise says what to type. The work goes on either way.
define system_packages
missing=; for package in $(1); do dpkg -s $$package >/dev/null 2>&1 || missing="$$missing $$package"; done; \
if [ -n "$$missing" ] && command -v apt-get >/dev/null && [ "$$(id -u)" = 0 ]; then \
    echo "installing$$missing"; apt-get update -qq; \
    for package in $$missing; do \
        DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends $$package >/dev/null \
            || echo "$$package could not be installed; going on without it" >&2; \
    done; \
elif [ -n "$$missing" ]; then \
    echo "going on without$$missing; to have it: sudo apt-get install$$missing (prt-bench doctor says what needs it)" >&2; \
fi
endef

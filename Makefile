# Two commands do all set-up themselves: `make demo` and `make test`.
VENV ?= .venv
PYTHON ?= python3
PY := $(VENV)/bin/python
READY := $(VENV)/.ready
TESTS ?= not bench and not (faults and slow)

# Every command that a test starts would compile the program's modules anew.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo models test check unit uncompiled faults format bench docs fuzz clean

$(READY): requirements.lock pyproject.toml
	@$(PYTHON) -c "import sys; sys.exit(sys.version_info < (3, 11))" || \
	  { echo "Python 3.11 or later is needed: make PYTHON=/path/to/python3.11"; exit 1; }
	test -x $(PY) || $(PYTHON) -m venv $(VENV)
	$(PY) -m pip install --quiet --disable-pip-version-check -r requirements.lock
	$(PY) -m pip install --quiet --disable-pip-version-check --no-deps --editable .
	touch $(READY)

demo: $(READY)
	$(VENV)/bin/fwclass demo

# Trains the models that have a name, from public data in DATA, and writes the package fwclass-models to MODELS.
DATA ?= ../shared/data
MODELS ?= build/fwclass-models
models: $(READY)
	mkdir -p $(MODELS)/fwclass_models
	cp conf/models/pyproject.toml conf/models/README.md $(MODELS)/
	cp conf/models/package.py $(MODELS)/fwclass_models/__init__.py
	FWCLASS_DATA=$(DATA) $(VENV)/bin/fwclass train ign-hd --model $(MODELS)/fwclass_models/ign-hd --leave-out --keep-rows 6000 --overwrite

check: $(READY)
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/ruff check .
	$(VENV)/bin/mypy
	$(VENV)/bin/lint-imports
	$(PY) -m pytest -n auto -m "not slow and not bench"

unit: $(READY)
	$(PY) -m pytest -n 2 --unit

uncompiled: $(READY)
	$(PY) -m pytest -s tests/uncompiled

test: $(READY)
	$(PY) -m pytest -n auto -m "$(TESTS)"

faults: $(READY)
	$(PY) -m pytest -v -m faults

format: $(READY)
	$(VENV)/bin/ruff format .
	$(VENV)/bin/ruff check --fix .

bench: $(READY)
	for file in tests/bench/bench_*.py; do echo "== $$file"; $(PY) $$file; done

docs: $(READY)
	$(VENV)/bin/mkdocs build --strict --quiet

fuzz: $(READY)
	$(PY) -m pytest -n auto -m hypothesis --hypothesis-profile default
	$(PY) tests/fuzz/long.py --inputs 100000
	$(PY) tests/fuzz/long.py --inputs 100000 --commands --cover

clean:
	rm -rf $(VENV) demo-run .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache

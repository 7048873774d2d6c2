PYTHON ?= python3
# Without bytecode, each process that a test starts would compile the package again.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: check lint test slow hosts bench fuzz random-printers audit

check: lint test

lint:
	$(PYTHON) -m ruff check .
	$(PYTHON) -m ruff format --check .
	$(PYTHON) -m mypy
	lint-imports

test:
	$(PYTHON) -m pytest -n auto --dist worksteal

slow:
	$(PYTHON) -m pytest -m slow -n auto --dist worksteal

# HOSTS: a folder for environments with the real programs
HOSTS ?= $(HOME)/.cache/hframe-post-hosts
hosts: $(HOSTS)/moonraker-0.11.0 $(HOSTS)/octoprint-1.11.8
	MOONRAKER_PYTHON=$</bin/python OCTOPRINT_PYTHON=$(word 2,$^)/bin/python \
		$(PYTHON) -m pytest -m slow tests/hosts

$(HOSTS)/%:
	$(PYTHON) -m venv $@ && $@/bin/pip install -q $(subst -,==,$*)

bench:
	$(PYTHON) -m pytest tests/benchmarks -o addopts='' --benchmark-only

fuzz:
	$(PYTHON) -m tests.fuzz $(FUZZ)

random-printers:
	$(PYTHON) -m tests.identification.random_printers $(RANDOM_PRINTERS)

audit:
	@$(PYTHON) -c 'import bandit, pip_audit' 2>/dev/null || { echo "pip install -e '.[audit]' first"; exit 1; }
	$(PYTHON) -m bandit -q -c pyproject.toml -r hframe_post
	$(PYTHON) -m pip_audit --skip-editable

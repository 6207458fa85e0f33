# Targets install what they need into .venv first.
BIN := .venv/bin

# Where a shell sets it, hundreds of processes would each compile the same modules.
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.PHONY: help setup dev demo check test test-long bench tables robustness fuzz soak mutants compat stubs stubs-fresh fmt page

help: ## List what can be made
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/\1|\2/p' $(MAKEFILE_LIST) | while IFS='|' read -r name text; do \
	  printf '  make %-10s %s\n' "$$name" "$$text"; done

setup: ## Install what freerein needs to run; TORCH_INDEX= for a machine with a CUDA device
	@tools/setup

dev: ## Install what the tests and checks need, too
	@tools/setup dev

demo: setup ## Show six results, two of them learned meanwhile: three to five minutes on two cores
	@$(BIN)/freerein demo

check: dev stubs-fresh ## Lint, format, types, import contracts, proto, its stubs and its changes
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/buf lint proto
	$(BIN)/buf breaking proto --against proto/released.binpb
	tools/page check

# Most of a worker's time is waiting: for other processes, deadlines, leases.
WORKERS = $(shell expr $$(nproc) \* 3)

PARALLEL = --numprocesses $(WORKERS) --dist loadfile --no-loadscope-reorder

test: dev ## Run the tests, a file at a time on each worker; three workers for each core
	$(BIN)/pytest $(PARALLEL) -m "not long"

test-long: dev ## Run the tests that take long by nature; commit tests/long-tests.sha256 when they have passed
	$(BIN)/pytest $(PARALLEL) -m long
	tools/long-tests passed

bench: dev ## Compare the speed of services with that of what they serve
	$(BIN)/python -m benchmarks

tables: dev ## Make the tables of all experiments from the committed results
	$(BIN)/python -m experiments table

robustness: dev ## Every model under every condition: runs what lacks a result, then makes the table; all anew takes about an hour
	$(BIN)/python -m experiments run robustness
	$(BIN)/python -m experiments table robustness

fuzz: dev ## The fault tests with their large counts: 20 000 generated requests per REST API, 20 kills
	FREEREIN_FUZZ=1 $(BIN)/pytest $(PARALLEL) --timeout 1200 tests/faults tests/freerein/test_benchmarks.py

soak: dev ## All five services under mixed load: MINUTES=20
	$(BIN)/python -m soak --minutes $(or $(MINUTES),$(FREEREIN_SOAK_MINUTES),20)

mutants: dev ## Change the code in up to 300 places, and expect a test to fail each time
	$(BIN)/python -m mutants

compat: dev ## Open our datasets in LeRobot, and LeRobot's in ours; call a service from its environment
	PYTHON=$(CURDIR)/$(BIN)/python tests/compat/run

stubs: dev ## Regenerate the Python stubs of proto/
	tools/stubs

page: ## Build the web page into the orchestrator's package
	tools/page build

stubs-fresh: dev
	@fresh=$$(mktemp -d) && trap 'rm -rf "$$fresh"' EXIT && tools/stubs "$$fresh" && \
	  diff -r -x __init__.py -x __pycache__ "$$fresh/freerein/api" src/freerein/api || \
	  { echo "The stubs in src/freerein/api are stale: run make stubs" >&2; exit 1; }

fmt: dev ## Format the code and fix what ruff can
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

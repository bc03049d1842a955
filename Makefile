# make demo   create the environment, install, build and query a small scene (pictures and a table in demo/)
# make test   create the environment, install, run the tests (two processes of one thread each)
# make lint   ruff and pyright

PYTHON ?= python3
BIN := .venv/bin

.PHONY: demo test lint format clean

demo: .venv/installed
	$(BIN)/scoup demo --out demo --overwrite

test: .venv/installed-dev
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2

lint: .venv/installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright

format: .venv/installed-dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

.venv/installed: pyproject.toml tools/install.py
	$(PYTHON) tools/install.py
	@touch $@

.venv/installed-dev: pyproject.toml tools/install.py
	$(PYTHON) tools/install.py dev
	@touch $@ .venv/installed

clean:
	rm -rf .venv demo build dist .pytest_cache .hypothesis .ruff_cache

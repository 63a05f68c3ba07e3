# `make demo` and `make test` each do all set-up on a fresh machine with Python 3.11+ and make.
PYTHON ?= python3
BIN := .venv/bin
SOURCES := pyproject.toml Makefile $(wildcard requirements/*.txt)
CHROMIUM ?= chromium
AXE := 4.14.1
ASYNCAPI := @asyncapi/parser@3.6.3 @asyncapi/protobuf-schema-parser@3.9.0
# What examples/plots.mjs takes.
CLIENT := mqtt@5.16.0 protobufjs@8.8.1
# Two for each processor: where one test waits, another computes.
JOBS ?= $(shell expr 2 '*' $$(getconf _NPROCESSORS_ONLN))
# Nothing is installed but files whose hashes stand in requirements/: uv by pip, and by uv all else, in an
# eighteenth of pip's processor time. uv reads no pip.conf: UV_DEFAULT_INDEX says where a mirror is.
UV := $(BIN)/uv --quiet pip
INSTALL := $(UV) install --python $(BIN)/python --require-hashes --requirement requirements
# The package itself, from this folder, with what is here already.
OURSELVES := --no-deps --no-build-isolation --editable .
has = $(shell command -v $(1))
# Looked for at every call, so that what comes after the set-up is noticed.
TOOLS := $(if $(call has,c++),.venv-asterix-decoder/.ready) $(if $(and $(call has,npm),$(call has,node)),.node/.ready)
# A file or a test for what each of others' packages does here, and every number of the shipped scenes.
LOWEST := tests/replay/mcap/test_mcap.py tests/replay/test_tables.py \
  tests/proto/asterix/test_asterix_judges.py::test_libasterix_reads_the_same_in_recordings \
  tests/proto/sapient/test_sapient.py tests/feeds/formats/test_formats.py \
  tests/feeds/telemetry/flights/test_golden_flights.py \
  tests/feeds/telemetry/flights/test_logs.py \
  tests/feeds/telemetry/test_foreign_files.py tests/feeds/engine/test_terrain_files.py \
  tests/feeds/scene/test_sea_heights.py tests/feeds/session/test_metrics.py \
  tests/feeds/page/test_server.py::test_every_file_is_served_by_its_kind_and_policy_and_nothing_else_is \
  tests/feeds/page/test_server.py::test_a_viewer_gets_a_snapshot_and_then_updates_with_details_of_what_anybody_watches \
  tests/feeds/lab/test_oracle.py::test_every_shipped_scene_asks_what_its_sensors_do \
  tests/feeds/lab/test_needs.py::test_the_commands_say_it_in_groups_and_draw_it

# Where that is set, every command that the tests start compiles the package anew.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test environments test-lowest lint audit bench fuzz mutations mutants soak verdicts proto pages pictures docs lock clean

demo: .venv/.ready
	$(BIN)/plotfeed demo $(ARGS)

# In that many processes, a file in one of them; with ARGS, one run of what they name.
test: .venv/.ready-test environments
	$(BIN)/python -m pytest $(if $(ARGS),$(ARGS),--processes $(JOBS))

# Of others' packages that tests drive, each apart.
environments: .venv-docs/.ready .venv-tables/.ready .venv-utm/.ready $(TOOLS)

# With the lowest versions that pyproject.toml allows; what skips for want of tools runs in `test`.
test-lowest: .venv-lowest/.ready
	CI= .venv-lowest/bin/python -m pytest -p no:cacheprovider $(if $(ARGS),$(ARGS),$(LOWEST))

PROTOC = $(BIN)/python -m grpc_tools.protoc --proto_path=plotfeed/proto=proto \
  plotfeed/proto/plotfeed.proto plotfeed/proto/ledger.proto

lint: .venv/.ready-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	PYTHONPATH=.typing $(BIN)/lint-imports
	@made=$$(mktemp --directory) && $(PROTOC) --python_out=$$made --pyi_out=$$made && \
	  for each in $$made/plotfeed/proto/*; do \
	    cmp $$each proto/$${each##*/} || { echo "proto/ is out of date: run 'make proto'"; exit 1; }; done; \
	  code=$$?; rm -r $$made; exit $$code

# What in the code looks unsafe, and which packages have known holes.
audit: .venv-audit/.ready
	.venv-audit/bin/bandit --quiet --recursive face feeds models proto replay
	.venv-audit/bin/python requirements/known_holes.py

.venv/.ready: $(SOURCES)
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "plotfeed needs Python 3.11 or newer; set PYTHON=")'
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes --requirement requirements/uv.txt
	$(INSTALL)/run.txt
	$(UV) install --python $(BIN)/python $(OURSELVES)
	touch $@

.venv/.ready-test: .venv/.ready
	mkdir -p .typing/plotfeed
	for room in feeds models proto replay face/__init__.py face/testing.py face/py.typed; do \
	ln -sfn ../../$$room .typing/plotfeed/$${room##*/}; done
	$(INSTALL)/test.txt
	$(INSTALL)/test-page.txt || echo 'no playwright for this machine: the tests of the page in a browser will be skipped'
	$(INSTALL)/fleet.txt || echo 'no Ray for this machine: the tests of fleets and sweeps over processes will be skipped'
	touch $@

# Built by what .venv has, into an environment of its own: it imports under the name of libasterix.
.venv-asterix-decoder/.ready: requirements/test-asterix.txt .venv/.ready-test
	test -x $(@D)/bin/python || $(BIN)/uv --quiet venv --python $(BIN)/python $(@D)
	if $(INSTALL)/test-asterix.txt --no-build-isolation --prefix $(@D); then touch $@; else \
	rm -rf $(@D); echo 'asterix-decoder was not built: tests with it will be skipped'; fi

.node/.ready: Makefile
	npm install --silent --no-audit --no-fund --ignore-scripts --prefix .node axe-core@$(AXE) $(ASYNCAPI) $(CLIENT) || \
	echo "axe-core, AsyncAPI's parser and MQTT.js did not come: tests with them will be skipped"
	mkdir -p .node && touch $@

# Each with what may not be in one environment with the rest.
APART := $(patsubst %,.venv-%/.ready,audit docs mutants tables utm lowest)
$(APART): .venv-%/.ready: requirements/%.txt .venv/.ready
	test -x $(@D)/bin/python || $(BIN)/uv --quiet venv --python $(BIN)/python $(@D)
	$(UV) sync --python $(@D)/bin/python --require-hashes $<
	$(if $(findstring lowest,$*),$(UV) install --python $(@D)/bin/python $(OURSELVES))
	touch $@

proto: .venv/.ready-test
	$(PROTOC) --python_out=.typing --pyi_out=.typing

# Half an hour; nothing depends on the figures.
bench: .venv/.ready-test
	$(BIN)/python tools/benchmarks/write_benchmarks.py

# An hour, or what MINUTES says; what is found is kept in tools/fuzz/seeds.
fuzz: .venv/.ready-test
	$(INSTALL)/fuzz.txt
	$(BIN)/python tools/fuzz/run_fuzz.py --minutes $(or $(MINUTES),60)

# docs/soak.md, in an hour and a half on a machine that does nothing else.
soak: .venv/.ready-test
	$(BIN)/python tools/soak/promises.py
	$(BIN)/python tools/soak/chaos.py
	$(BIN)/python tools/soak/soak.py --minutes 30
	$(BIN)/python tools/soak/soak.py --minutes 30 --radars 200

# How often right feeds are called wrong, in 200 random scenes, into docs/report.md: ten minutes.
verdicts: .venv/.ready-test
	nice $(BIN)/python tools/soak/random_reports.py $(ARGS)

# Which of the faults in tools/mutations/faults.toml no test notices: an hour; ARGS chooses some.
mutations: .venv/.ready-test
	$(BIN)/python tools/mutations/plant_faults.py $(ARGS)

# Which changes of a sign, a number or a comparison no test notices, drawn from lines that are new.
mutants: .venv/.ready-test .venv-mutants/.ready
	.venv-mutants/bin/python tools/mutations/mutate_changes.py $(ARGS)

# What of the documentation is written from the code alone, in seconds.
pages: .venv/.ready-test
	$(BIN)/python docs/commands/write_scene_reference.py
	$(BIN)/python docs/commands/write_presets.py
	$(BIN)/python docs/commands/write_messages.py
	$(BIN)/python docs/commands/write_limits.py
	$(BIN)/python docs/commands/write_stability.py

# What is drawn and counted as well, in some minutes.
pictures: pages
	$(BIN)/python docs/commands/draw_ppi.py
	$(BIN)/python docs/commands/draw_section_4_active.py
	$(BIN)/python docs/commands/draw_section_4.py
	$(BIN)/plotfeed check feeds/scene/examples/section-4.toml --chart docs/section-4-check.png --force
	$(BIN)/python docs/commands/write_section_4.py
	$(BIN)/python docs/commands/write_needs.py
	if command -v $(CHROMIUM) >/dev/null; then $(BIN)/python docs/commands/draw_page.py; fi
	$(BIN)/python docs/commands/draw_commands.py
	$(BIN)/python docs/commands/write_stability.py picture
	$(BIN)/python docs/commands/equation_figures.py

# The documentation as a site in site/ that can be searched; a link that leads nowhere is an error.
docs: .venv-docs/.ready
	.venv-docs/bin/mkdocs build --strict
	@echo 'to read it: $(PYTHON) -m http.server --directory site, and http://127.0.0.1:8000/'

# Versions and hashes, after a change of pyproject.toml; with UPGRADE=--upgrade the newest.
lock: .venv/.ready
	$(BIN)/python requirements/make_locks.py $(UPGRADE)

clean:
	rm -rf .venv .venv-* .typing .node site

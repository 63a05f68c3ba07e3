# `make demo` and `make test` each do all set-up on a fresh machine with Python 3.11+ and make.
PYTHON ?= python3
BIN := .venv/bin
SOURCES := pyproject.toml Makefile constraints.txt
CHROMIUM ?= chromium
AXE := 4.14.1
# Two for each processor: where one test waits, another computes.
JOBS ?= $(shell expr 2 '*' $$(getconf _NPROCESSORS_ONLN))
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt

# Where that is set, every command that the tests start compiles the package anew.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test lint bench fuzz proto pages pictures constraints clean

demo: .venv/.ready
	$(BIN)/plotfeed demo $(ARGS)

# In that many processes, a file in one of them; with ARGS, one run of what they name.
test: .venv/.ready-test
	$(BIN)/python -m pytest $(if $(ARGS),$(ARGS),--numprocesses $(JOBS) --dist loadfile --no-loadscope-reorder)

lint: .venv/.ready-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python tests/support/stale_proto.py

.venv/.ready: $(SOURCES)
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "plotfeed needs Python 3.11 or newer; set PYTHON=")'
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(PIP) --editable '.[page]'
	touch $@

.venv/.ready-test: .venv/.ready
	mkdir -p .typing/plotfeed
	for room in feeds models proto replay; do ln -sfn ../../$$room .typing/plotfeed/$$room; done
	extras=test; page=; \
	if command -v c++ >/dev/null; then extras=$$extras,test-asterix; \
	else echo 'no C++ compiler: the tests against asterix-decoder will be skipped'; fi; \
	if command -v $(CHROMIUM) >/dev/null; then page=,test-page; \
	else echo 'no Chromium: the tests of the page in a browser will be skipped'; fi; \
	$(PIP) --editable ".[$$extras$$page]" || \
	{ test "$$page" && $(PIP) --editable ".[$$extras]" && echo 'playwright did not come'; }
	if command -v npm >/dev/null; then \
	  npm install --silent --no-audit --no-fund --ignore-scripts --prefix .node axe-core@$(AXE) || echo 'axe-core did not come'; \
	else echo 'no npm: the test of accessibility will be skipped'; fi
	touch $@

proto: .venv/.ready-test
	$(BIN)/python -m grpc_tools.protoc --proto_path=plotfeed/proto=proto --python_out=.typing --pyi_out=.typing plotfeed/proto/plotfeed.proto

# Half an hour; nothing depends on the figures.
bench: .venv/.ready-test
	$(BIN)/python tests/benchmarks/write_benchmarks.py

# An hour, or what MINUTES says; what is found is kept in tests/fuzz/seeds.
fuzz: .venv/.ready-test
	$(PIP) --editable '.[test,fuzz]'
	$(BIN)/python tests/fuzz/run_fuzz.py --minutes $(or $(MINUTES),60)

# What of the documentation is written from the code alone, in seconds.
pages: .venv/.ready-test
	$(BIN)/plotfeed schema >feeds/scene/examples/scene.schema.json
	$(BIN)/plotfeed schema asyncapi >docs/asyncapi.json
	$(BIN)/python docs/commands/write_scene_reference.py
	$(BIN)/python docs/commands/write_presets.py
	$(BIN)/python docs/commands/write_messages.py
	$(BIN)/python docs/commands/write_stability.py

# What is drawn and counted as well, in some minutes.
pictures: pages
	$(BIN)/python docs/commands/draw_ppi.py
	$(BIN)/python docs/commands/draw_section_4_active.py
	$(BIN)/python docs/commands/draw_section_4.py
	$(BIN)/plotfeed check feeds/scene/examples/section-4.toml --chart docs/section-4-check.png --force
	$(BIN)/python docs/commands/write_section_4.py
	$(BIN)/python docs/commands/draw_speed_accuracy.py
	if command -v $(CHROMIUM) >/dev/null; then $(BIN)/python docs/commands/draw_page.py; fi
	$(BIN)/python docs/commands/draw_report.py
	$(BIN)/python docs/commands/draw_stability.py
	$(BIN)/python docs/commands/equation_figures.py

constraints: .venv/.ready-test
	echo "# The versions that the tests run with; made by 'make constraints'." >constraints.new
	$(BIN)/python -m pip freeze --exclude plotfeed --exclude pip --exclude setuptools \
	  --exclude asterix_decoder | LC_ALL=C sort -f >>constraints.new
	mv constraints.new constraints.txt

clean:
	rm -rf .venv .venv-ast-tool .venv-libasterix .venv-stonesoup .typing .node

# make demo    keypoints and matches on a photograph, with the bundled model
# make test    lint, types, the documentation and all tests
# make docs    the documentation as a site, in out/site
# make lean    the runtime's wheel without exporter, evaluation and fp32 model, in out/lean
# make web     the page of web/, with all that it loads
# Both do all the set-up, from nothing but Python and pip.  The runtime's environment has no PyTorch.
PYTHON ?= python3
PIP = -m pip install --quiet --disable-pip-version-check
RUNTIME = .venv/runtime
FULL = .venv/full
LOWEST = .venv/lowest
NEWEST = .venv/newest
RELEASE = .venv/release
DOCS = .venv/docs

# A worker per core; each is busy by itself, so torch's own threads would only wait for one another.
PYTEST = -m pytest -q --numprocesses auto --maxprocesses 4 --dist worksteal

.PHONY: web lean demo test test-runtime test-lowest test-newest test-full lint docs bench mutants models release-check clean

demo: $(RUNTIME)/ready
	$(RUNTIME)/bin/elf-detect demo/palace.jpg -o out
	$(RUNTIME)/bin/python demo/second_view.py demo/palace.jpg out/demo/view.png
	$(RUNTIME)/bin/elf-match demo/palace.jpg out/demo/view.png --ransac homography -o out/demo/matches.png
	@echo "Look at out/demo/palace.png and out/demo/matches.png"

test: lint docs test-runtime test-lowest test-full

# What a robot runs: the three base dependencies, no PyTorch, no onnx.
test-runtime: $(RUNTIME)/ready
	$(RUNTIME)/bin/python $(PYTEST) -m "not torch"

# The same with the oldest versions that pyproject.toml allows; here elf-eval's plots too.
test-lowest: $(LOWEST)/ready
	$(LOWEST)/bin/python $(PYTEST) -m "not torch"

# The same with the newest versions that there are today, which may be newer than those of constraints.txt.
test-newest:
	@$(PYTHON) -m venv $(NEWEST)
	@$(NEWEST)/bin/python $(PIP) --upgrade --upgrade-strategy eager --editable . pytest pytest-xdist hypothesis
	$(NEWEST)/bin/python $(PYTEST) -m "not torch"

test-full: $(FULL)/ready
	OMP_NUM_THREADS=1 $(FULL)/bin/python $(PYTEST)

lint: $(FULL)/ready
	$(FULL)/bin/ruff check .
	$(FULL)/bin/ruff format --check .
	$(FULL)/bin/mypy
	$(FULL)/bin/lint-imports --no-cache

# A link that leads nowhere ends it; not with --quiet, which hides warnings from --strict.
docs: $(DOCS)/ready
	NO_MKDOCS_2_WARNING=1 $(DOCS)/bin/mkdocs build --strict
	@echo "Open out/site/index.html"

# The page of web/ with all that it loads; needs npm.
web: $(FULL)/ready
	cd web && npm install --no-fund --no-audit
	$(FULL)/bin/python web/vendor.py
	@echo "python web/serve.py, then open http://localhost:8000/"

bench: $(FULL)/ready
	$(FULL)/bin/python benchmarks/latency.py

# Thousands of damaged models and images: docs/reliability.md.
mutants: $(FULL)/ready
	PYTHONPATH=tests OMP_NUM_THREADS=1 $(FULL)/bin/python -m mutants

# Regenerate the bundled model; models/README.md says what it must be.
models: $(FULL)/ready
	$(FULL)/bin/python tools/make_bundled_model.py

# The source archive and the wheel in dist/, checked and installed: CONTRIBUTING.md has the release recipe.
release-check: $(RELEASE)/ready
	rm -rf dist
	$(RELEASE)/bin/python -m build
	$(RELEASE)/bin/twine check --strict dist/*
	$(RELEASE)/bin/python tools/check_release.py dist

# docs/install.md says what it is for.
lean: $(RELEASE)/ready
	rm -rf out/lean
	$(RELEASE)/bin/python -m build --wheel --outdir out/lean/whole
	$(RELEASE)/bin/python tools/lean_wheel.py out/lean/whole/*.whl -o out/lean

$(RUNTIME)/ready: pyproject.toml constraints.txt
	@echo "Setting up $(RUNTIME), once"
	@$(PYTHON) -m venv $(RUNTIME)
	@$(RUNTIME)/bin/python $(PIP) --constraint constraints.txt --editable . pytest pytest-xdist hypothesis
	@touch $@

# The tests' own tools are those of constraints.txt.
$(LOWEST)/ready: pyproject.toml constraints-lowest.txt constraints.txt
	@echo "Setting up $(LOWEST), once"
	@$(PYTHON) -m venv $(LOWEST)
	@grep -E "^(pytest|pytest-xdist|hypothesis)==" constraints.txt | cat constraints-lowest.txt - > $(LOWEST)/constraints.txt
	@$(LOWEST)/bin/python $(PIP) --constraint $(LOWEST)/constraints.txt --editable ".[eval]" pytest pytest-xdist hypothesis
	@touch $@

# torch first: whichever build the package index gives (the CPU one is enough) satisfies the rest.
$(FULL)/ready: pyproject.toml constraints.txt
	@echo "Setting up $(FULL), once; torch is large"
	@$(PYTHON) -m venv $(FULL)
	@$(FULL)/bin/python $(PIP) --constraint constraints.txt torch
	@$(FULL)/bin/python $(PIP) --constraint constraints.txt --editable ".[dev]"
	@touch $@

$(DOCS)/ready: pyproject.toml constraints.txt
	@echo "Setting up $(DOCS), once"
	@$(PYTHON) -m venv $(DOCS)
	@$(DOCS)/bin/python $(PIP) --constraint constraints.txt --editable ".[docs]"
	@touch $@

$(RELEASE)/ready: constraints.txt
	@echo "Setting up $(RELEASE), once"
	@$(PYTHON) -m venv $(RELEASE)
	@$(RELEASE)/bin/python $(PIP) --constraint constraints.txt build twine
	@touch $@

clean:
	rm -rf .venv out dist

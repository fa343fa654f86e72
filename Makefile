# The commands of the README. Each sets everything up by itself in .venv; a second call only checks.

PYTHON ?= python3.11
CORES ?= 2
BIN := .venv/bin
# One thread a process: what runs in parallel here are processes, and jobs set their own number.
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1
export MKL_NUM_THREADS ?= 1
# A waiting thread sleeps: one that spins takes the core from whoever it waits for.
export OMP_WAIT_POLICY ?= PASSIVE
# Python compiles a module at its first import and keeps the result, whatever the machine's setting: pip would compile
# every module it installs, most of which nothing here imports.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: krauss physical view demo published test coverage slurm-test campaigns scenarios lint types workflow docs tables notebooks lock package crate
.DEFAULT_GOAL := krauss

krauss: .venv/.installed
	$(BIN)/snakemake -c$(CORES) results/tables/krauss.tex

physical: .venv/.installed
	$(BIN)/snakemake -c$(CORES) results/tables/physical.tex results/tables/truth.tex

# A simulated rocker, fitted by the quick profile in some minutes where it is not there yet, then pushed in the browser.
ROCKER := results/quick/simulated/rainbow_rocker/default-0/default-0
view: .venv/.installed
	$(BIN)/snakemake -c$(CORES) $(ROCKER)/dynamics.json
	$(BIN)/lagsplat view $(ROCKER)

# A shipped film is fitted, pushed in the browser and compared with another: minutes, and nothing to configure.
demo: .venv/.installed
	$(BIN)/python -W ignore examples/06_demo.py results/demo

# Every file of results/published that benchmarks/published.yaml names, again at this commit: hours; it goes on where it was stopped.
published: .venv/.installed
	$(BIN)/python -m benchmarks.published

# The documentation as a site, in build/docs; a broken link or docstring is an error.
docs: .venv/.installed
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

# The tables of README and documentation, from the files of results/published.
tables: .venv/.installed
	$(BIN)/python -m benchmarks.published_tables

# The pictures and pages that the notebooks of the documentation show; they run in build/notebooks.
notebooks: .venv/.installed
	set -e; for script in docs/notebooks/*.py; do \
	    name=$$(basename $$script .py); rm -rf build/notebooks/$$name; mkdir -p build/notebooks/$$name docs/notebooks/$$name; \
	    (cd build/notebooks/$$name && MPLBACKEND=Agg $(CURDIR)/$(BIN)/python $(CURDIR)/$$script); \
	    find build/notebooks/$$name -maxdepth 1 -name '*.png' -o -name run.html | xargs cp -t docs/notebooks/$$name; \
	done

# The scenarios compile Numba's kernels for all that follows. What needs all cores in one process comes next: a
# browser that draws in software, and what is computed by several threads. Then the others, a process a core.
SHARED := --numprocesses $(CORES) --dist loadfile --no-loadscope-reorder
ALL_CORES := tests/browser tests/scenarios/test_thread_counts.py
# To count lines and branches slows what is counted. Here it is done for what meets files and strangers, by the tests
# of that alone; `make coverage` does it for all.
COUNTED := tests/unit/io tests/unit/viewer/server tests/unit/diagnose/simulators tests/laws/test_parsers.py
PARTS := $(CURDIR)/build/coverage
COUNT := COVERAGE_PROCESS_START=$(CURDIR)/pyproject.toml COVERAGE_FILE=$(PARTS)/part $(BIN)/python -m pytest -p tests.coverage_marks
test: .venv/.installed
	@$(MAKE) --no-print-directory --jobs=$(CORES) --output-sync types lint workflow docs
	@$(MAKE) --no-print-directory scenarios
	@$(BIN)/python -m pytest $(ALL_CORES)
	@rm -rf $(PARTS); mkdir -p $(PARTS)
	@COVERAGE_FOLDERS="lagsplat/io lagsplat/viewer/server" $(COUNT) --quiet $(SHARED) $(COUNTED)
	@$(BIN)/python -m pytest $(SHARED) $(ALL_CORES:%=--ignore=%) $(COUNTED:%=--ignore=%) --ignore=tests/scenarios

# Lines and branches of the whole package that any test reaches; fails below the marks of tests/coverage_marks.py.
coverage: .venv/.installed
	@rm -rf $(PARTS); mkdir -p $(PARTS)
	@$(COUNT) $(SHARED)

# What takes too long for every change: the sealed check of the diagnosis, the methods beside it, and cases that repeat
# what others cover.
campaigns: .venv/.installed
	$(BIN)/python -m pytest -m campaign -n $(CORES) --dist loadfile

# The toy profile on a SLURM cluster of one node; skipped, with the reason, where SLURM is not there. The plugin is not
# among the extras of the tests, because every start of Snakemake loads it.
slurm-test: .venv/.installed
	$(BIN)/python -m pip install --quiet --no-compile --constraint requirements/lock.txt --editable ".[cluster]"
	$(BIN)/python -m pytest -m campaign -rs tests/workflow/test_slurm.py

scenarios: .venv/.installed
	$(BIN)/python -m pytest --quiet $(SHARED) $(ALL_CORES:%=--ignore=%) tests/scenarios

# The workflow, and the tables and figures that are there, as an RO-Crate in build/crate.
crate: .venv/.installed
	$(BIN)/python -m pip install --quiet --no-compile --editable ".[crate]"
	rm -rf build/crate
	$(BIN)/python workflow/crate.py build/crate

# The wheel, built and installed in an empty environment, and the pipeline that it lays down.
package: .venv/.installed
	$(BIN)/python -m pytest --quiet tests/package

lint: .venv/.installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: .venv/.installed
	$(BIN)/mypy

workflow: .venv/.installed
	$(BIN)/snakefmt --check Snakefile workflow
	$(BIN)/snakemake --lint

# pyproject.toml gives ranges for whoever installs the package beside others; here every version is exact.
LOCK := requirements/lock.txt

# torch first, by its pin: whichever build of it is chosen here, nothing that follows replaces it.
.venv/.installed: pyproject.toml $(LOCK)
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --no-compile "$$(grep '^torch==' $(LOCK))"
	$(BIN)/python -m pip install --quiet --no-compile --requirement $(LOCK)
	$(BIN)/python -m pip install --quiet --no-compile --no-deps --editable .
	$(BIN)/python -m pip check
	touch $@

# The newest versions within the ranges, into the lock. KEEP="torch==2.13.0 numpy==2.4.6" keeps those.
KEEP :=
lock:
	$(PYTHON) -m venv build/lock
	build/lock/bin/python requirements/renew.py $(KEEP) > build/lock.txt
	mv build/lock.txt $(LOCK)

#!/bin/sh
# Sets up a test environment in .venv and runs everything: style, types, tests in both forms, the virtual-machine
# lanes, the lane that wants the same bytes from another processor, the report page in a real browser, the documentation
# with its commands, and the experiments of the papers in full.
set -eu
cd "$(dirname "$0")/.."
. deploy/venv.sh
make_venv .venv
.venv/bin/pip install --quiet --disable-pip-version-check -c deploy/constraints.txt -e '.[test]'
.venv/bin/ruff format --check .
.venv/bin/ruff check .
.venv/bin/mypy
.venv/bin/python -m pytest --numprocesses auto --maxprocesses 4 --dist worksteal "$@"
.venv/bin/python -m tests.compiled -q --numprocesses auto --maxprocesses 4 --dist worksteal
.venv/bin/python -m tests.vm
.venv/bin/python -m tests.vm.power_cut 2
.venv/bin/python -m tests.equality
.venv/bin/python -m tests.browser
.venv/bin/python -m tests.docs
.venv/bin/python -m tests.experiments

#!/bin/sh
# Sets up DriveGate in .venv beside this checkout and runs the demo; arguments go to `drivegate demo`.
set -eu
cd "$(dirname "$0")/.."
. deploy/venv.sh
make_venv .venv
.venv/bin/pip install --quiet --disable-pip-version-check -c deploy/constraints.txt .
exec .venv/bin/drivegate demo "$@"

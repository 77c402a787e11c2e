#!/bin/sh
# Sets up DriveGate in .venv beside this checkout and runs the demo; arguments go to `drivegate demo`.
set -eu
cd "$(dirname "$0")/.."
. deploy/venv.sh
# Compiling takes minutes: not again while nothing has changed since.
if [ ! -x .venv/bin/drivegate ] ||
    [ -n "$(find drivers gateway replay deploy pyproject.toml -type f ! -name '*.pyc' -newer .venv/bin/drivegate)" ]; then
    echo "setting up .venv, which takes a few minutes" >&2
    make_venv .venv
    .venv/bin/pip install --quiet --disable-pip-version-check -c deploy/constraints.txt '.[desk]'
fi
exec .venv/bin/drivegate demo "$@"

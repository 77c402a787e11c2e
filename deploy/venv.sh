# shellcheck shell=sh
# Sourced by the scripts that set up a virtual environment: `make_venv DIRECTORY`, idempotent.
# Debian ships Python without ensurepip; its python3-venv package brings it.

make_venv() {
    [ -x "$1/bin/pip" ] && return 0
    python3 -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "Python 3.11 or newer is needed" >&2; return 1; }
    python3 -m venv "$1" 2>/dev/null && return 0
    rm -rf "$1"
    DEBIAN_FRONTEND=noninteractive apt-get update -qq
    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends python3-venv >/dev/null
    python3 -m venv "$1"
}

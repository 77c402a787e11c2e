# shellcheck shell=sh
# Sourced by the scripts that set up a virtual environment: `make_venv DIRECTORY [WHEELS]`, idempotent. With a directory
# of wheels nothing else is asked for anything. Debian ships Python without ensurepip; its python3-venv package brings it.

python_is_new() {
    python3 -c 'import sys; sys.exit(sys.version_info < (3, 11))' && return 0
    echo "Python 3.11 or newer is needed (Debian 12 has it); python3 is $(python3 -V 2>&1 || true)" >&2
    return 1
}

make_venv() {
    [ -x "$1/bin/pip" ] && return 0
    python_is_new || return 1
    if [ -n "${2:-}" ]; then
        rm -rf "$1"
        python3 -m venv --without-pip "$1" || return 1
        set -- "$1" "$2" "$2"/pip-*.whl
        [ -f "$3" ] || { echo "$2 has no pip-*.whl: make it with deploy/wheelhouse.py" >&2; return 1; }
        "$1/bin/python" "$3/pip" install --quiet --no-index --find-links "$2" pip
        return
    fi
    python3 -m venv "$1" 2>/dev/null && return 0
    rm -rf "$1"
    if ! { DEBIAN_FRONTEND=noninteractive apt-get update -qq &&
        DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends python3-venv >/dev/null; }; then
        echo "python3-venv is missing and cannot be installed: as root and with a network, apt-get install python3-venv" >&2
        return 1
    fi
    python3 -m venv "$1"
}

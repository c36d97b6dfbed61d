# Sourced by the scripts: makes .venv from the lock when it is missing or stale, and steps into it.
# The package itself is installed again when pyproject.toml changes: its commands and plugins are in there.
# First, --help prints the comment that the script begins with, and nothing is made.
set -euo pipefail
case ${1:-} in
  -h | --help) sed -n '2,/^[^#]/ s/^# \{0,1\}//p' "$0"; exit 0 ;;
esac
cd "$(dirname "${BASH_SOURCE[0]}")/.."

stamp=$(cksum < requirements.lock)
if [ "$(cat .venv/omniscv-stamp 2>/dev/null)" != "$stamp" ]; then
  python=${PYTHON:-python3}
  "$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' || {
    echo "omniscv needs Python 3.11 or later; '$python' is $("$python" --version). Set PYTHON to one." >&2
    exit 1
  }
  echo "Making .venv from requirements.lock (once, about a minute) ..."
  rm -rf .venv
  "$python" -m venv .venv
  .venv/bin/pip install --quiet --disable-pip-version-check --require-hashes \
    --requirement requirements.lock
  echo "$stamp" > .venv/omniscv-stamp
fi
package=$(cksum < pyproject.toml)
if [ "$(cat .venv/omniscv-package-stamp 2>/dev/null)" != "$package" ]; then
  .venv/bin/pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
  echo "$package" > .venv/omniscv-package-stamp
fi
export PATH="$PWD/.venv/bin:$PATH"
unset PYTHONDONTWRITEBYTECODE # where it is set, every process compiles every module anew

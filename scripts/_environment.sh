# Sourced by the scripts: makes .venv from a lock when it is missing or stale, and steps into it. The lock is
# requirements-test.lock; scripts that only run omniscv set lock=requirements.lock. Both have the same versions.
# The package itself is installed again when pyproject.toml changes: its commands and plugins are in there.
# First, --help prints the comment that the script begins with, and nothing is made.
set -euo pipefail
case ${1:-} in
  -h | --help) sed -n '2,/^[^#]/ s/^# \{0,1\}//p' "$0"; exit 0 ;;
esac
cd "$(dirname "${BASH_SOURCE[0]}")/.."
lock=${lock:-requirements-test.lock}

fail() {
  echo "$(basename "$0"): $1" >&2
  exit 1
}

# logged COMMAND...: run quietly; .venv/install.log has what it says.
logged() { "$@" >> .venv/install.log 2>&1; }

# uv_install OPTIONS..., pip_install OPTIONS...: install into .venv.
uv_install() { [ -x .venv/bin/uv ] && logged .venv/bin/uv pip install --python .venv/bin/python "$@"; }
pip_install() { logged .venv/bin/python -m pip install --disable-pip-version-check --retries 1 "$@"; }
cannot_install() {
  fail "cannot install: $(grep -i error .venv/install.log | tail -n 1); is there a network? See .venv/install.log"
}

# make_venv: an empty one, and uv in it, which is several times as fast as pip.
make_venv() {
  local python=${PYTHON:-python3}
  [ ! -e .venv ] || [ -e .venv/omniscv-stamp ] ||
    fail "expected no .venv, or one that scripts/ made; move yours away, or install there: pip install ."
  "$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2> /dev/null ||
    fail "expected Python 3.11 or later, got '$python': $("$python" --version 2> /dev/null || echo none); set PYTHON to one"
  echo "Making .venv from $lock (once, seconds with a fast network) ..."
  rm -rf .venv
  "$python" -m venv .venv > /dev/null ||
    fail "cannot make .venv with '$python'; on Debian: apt-get install python3-venv"
  echo unfinished > .venv/omniscv-stamp
  sed -n '/^uv==/,/[^\\]$/p' "$lock" > .venv/uv.lock
  pip_install --require-hashes --requirement .venv/uv.lock || true
}

stamp=$(cat .venv/omniscv-stamp 2> /dev/null || true)
tested=$(cksum < requirements-test.lock)
wanted=$(cksum < "$lock")
if [ "$stamp" != "$wanted" ] && [ "$stamp" != "$tested" ]; then
  # What tests need is added to what omniscv needs.
  [ "$stamp" = "$(cksum < requirements.lock)" ] || make_venv
  uv_install --require-hashes --requirement "$lock" || {
    sed '/^uv==/,/[^\\]$/d' "$lock" > .venv/pip.lock
    pip_install --require-hashes --requirement .venv/pip.lock || cannot_install
  }
  echo "$wanted" > .venv/omniscv-stamp
fi
package=$(cksum < pyproject.toml)
if [ "$(cat .venv/omniscv-package-stamp 2> /dev/null)" != "$package" ]; then
  editable=(--no-deps --no-build-isolation --editable .)
  uv_install "${editable[@]}" || pip_install "${editable[@]}" || cannot_install
  echo "$package" > .venv/omniscv-package-stamp
fi
export PATH="$PWD/.venv/bin:$PATH"
unset PYTHONDONTWRITEBYTECODE # where it is set, every process compiles every module anew

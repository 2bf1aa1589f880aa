#!/usr/bin/env bash
# Fill .venv at the project's root: uv (from PyPI when missing), Python 3.12 (from the machine, pyenv
# or uv), the locked dependencies, then the project itself in editable form.
set -euo pipefail
cd "$(dirname "$0")/.."

find_uv() {
  if command -v uv >/dev/null 2>&1; then command -v uv; return; fi
  local boot=.venv-uv
  [ -x "$boot/bin/uv" ] || { python3 -m venv "$boot" && "$boot/bin/python" -m pip install --quiet uv; } >&2
  echo "$boot/bin/uv"
}

find_python() {
  local candidate
  for candidate in python3.12 "$HOME"/.pyenv/versions/3.12*/bin/python3.12 /usr/local/bin/python3.12; do
    if "$candidate" -c 'import sys; sys.exit(sys.version_info[:2] != (3, 12))' >/dev/null 2>&1; then
      command -v "$candidate"; return
    fi
  done
  echo 3.12   # uv fetches its own
}

# Without it uv leaves compiling to each first import, which read-only installs and PYTHONDONTWRITEBYTECODE forbid:
# then every process compiles torch, transformers and LeRobot anew, 30 of 44 s of its start.
export UV_COMPILE_BYTECODE=1
uv=$(find_uv)
echo "set-up: uv $("$uv" --version | cut -d' ' -f2), python $(find_python)"
[ -x .venv/bin/python ] || "$uv" venv --quiet --python "$(find_python)" .venv
echo "set-up: fetching and compiling the libraries (some 6 GB); minutes the first time, without a word"
"$uv" pip sync --quiet --python .venv/bin/python requirements.lock
"$uv" pip install --quiet --python .venv/bin/python --no-deps --editable .
"$uv" pip install --quiet --python .venv/bin/python --no-deps --only-binary :all: -r requirements-clients.lock ||
  echo "set-up: no wheels of the Franka client or of rerun for this machine; their tests will be skipped, saying so"
command -v chromium chromium-browser google-chrome google-chrome-stable >/dev/null ||
  echo "set-up: no Chromium on this machine; the tests of the page of \`uniforce show\` in a browser will be skipped"
.venv/bin/python -c 'import cv2, mujoco, torch, lerobot; print("set-up: torch", torch.__version__, "mujoco", mujoco.__version__, "cv2", cv2.__version__)'

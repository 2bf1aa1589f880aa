#!/usr/bin/env bash
# The wheel, in a fresh environment: plain `pip install .`, `import cv2`, and LeRobot finding the plugin.
set -euo pipefail
cd "$(dirname "$0")/.."
fresh=$(mktemp -d)
trap 'rm -rf "$fresh"' EXIT
.venv/bin/python -m venv "$fresh/venv"
"$fresh/venv/bin/pip" install --quiet .
cd "$fresh"
venv/bin/python -c 'import cv2, uniforce_vtla; print("cv2", cv2.__version__); cv2.GaussianBlur(__import__("numpy").zeros((8, 8), "uint8"), (3, 3), 1)'
HF_HUB_OFFLINE=1 venv/bin/lerobot-train --policy.type=pi05_uniforce --help >help.txt
grep -q touch.slots help.txt
echo "wheel: installed, imported, and found by lerobot-train"

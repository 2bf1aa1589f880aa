"""The notebook of docs/ runs as a notebook does: in a kernel of its own, from the first cell to the
last."""

import base64
from pathlib import Path

import cv2
import jupytext
import numpy as np
import pytest
from nbclient import NotebookClient

NOTEBOOKS = sorted((Path(__file__).parents[1] / "docs" / "notebooks").glob("*.py"))
SHOWS = "plt.show()"


def pictures(cell):
    """Return what a cell shows, (H, W, 3) uint8 each."""
    encoded = [
        out["data"]["image/png"] for out in cell["outputs"] if "image/png" in out.get("data", {})
    ]
    return [
        cv2.imdecode(np.frombuffer(base64.b64decode(text), np.uint8), cv2.IMREAD_COLOR)
        for text in encoded
    ]


@pytest.mark.thorough
@pytest.mark.timeout(900)  # 40 s of work; other processes may leave it little of a core
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_every_cell_runs_and_shows_its_picture(path, monkeypatch):
    monkeypatch.delenv("MPLBACKEND", raising=False)  # else the kernel draws into no notebook
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    notebook = jupytext.read(path)
    NotebookClient(notebook, timeout=600).execute()  # raises CellExecutionError where a cell fails
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert all(cell.execution_count for cell in code)
    showing = [cell for cell in code if SHOWS in cell.source]
    assert showing
    for cell in showing:
        shown = pictures(cell)
        assert shown, f"no picture: {cell.source}"
        assert all(picture.std() > 10 for picture in shown)  # not blank

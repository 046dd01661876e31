"""The notebook runs from top to bottom, and is stored without its outputs."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from helpers import ROOT

NOTEBOOK = ROOT / "examples" / "notebooks" / "first_hour.ipynb"
RUN = """
import json, sys
import nbclient, nbformat

notebook = nbformat.read(sys.argv[1], as_version=4)
folder = {"metadata": {"path": sys.argv[2]}}
nbclient.NotebookClient(notebook, timeout=300, kernel_name="python3", resources=folder).execute()
print(json.dumps([cell["outputs"] for cell in notebook.cells if cell.cell_type == "code"]))
"""


def test_it_is_stored_without_outputs_and_in_one_form() -> None:
    text = NOTEBOOK.read_text(encoding="utf-8")
    notebook = json.loads(text)
    assert text == json.dumps(notebook, indent=1, ensure_ascii=False, sort_keys=True) + "\n"
    assert [cell["id"] for cell in notebook["cells"]] == [f"cell-{i:02d}" for i in range(len(notebook["cells"]))]
    for cell in notebook["cells"]:
        assert cell["cell_type"] == "markdown" or (cell["outputs"], cell["execution_count"]) == ([], None)
    assert set(notebook["metadata"]) == {"kernelspec", "language_info"}


@pytest.mark.parametrize("folder", [NOTEBOOK.parent, ROOT], ids=["its own", "the project's"])
def test_it_runs_from_top_to_bottom(folder: Path) -> None:
    for module in ("nbclient", "ipykernel"):
        pytest.importorskip(module, reason=f"{module} is not installed: pip install nbclient ipykernel")
    env = {**os.environ, "PYTHONPATH": str(ROOT / "runtime"), "PYDEVD_DISABLE_FILE_VALIDATION": "1"}
    command = [sys.executable, "-c", RUN, str(NOTEBOOK), str(folder)]
    done = subprocess.run(command, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    outputs = json.loads(done.stdout.splitlines()[-1])
    assert not [output for cell in outputs for output in cell if output["output_type"] == "error"]
    shown = [output["data"] for cell in outputs for output in cell if output["output_type"] == "execute_result"]
    pictures = [data for data in shown if "image/png" in data]
    assert len(pictures) == 4  # features, their trace, the matches, and features under a mask
    said = "".join(output.get("text", "") for cell in outputs for output in cell)
    assert "corners are off by" in said

"""Notebooks run from top to bottom, and the paired files say the same."""

from pathlib import Path

import jupytext
import nbformat
import pytest
from nbclient import NotebookClient

NOTEBOOKS = Path(__file__).resolve().parents[1] / "notebooks"
SCRIPTS = sorted(NOTEBOOKS.glob("*.py"))


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_notebook_runs(script: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """The notebooks check their own claims: a failed check stops them."""
    monkeypatch.setenv("PRT_BENCH_DATA", str(tmp_path / "data"))
    monkeypatch.setenv("JUPYTER_RUNTIME_DIR", str(tmp_path / "jupyter"))
    notebook = jupytext.read(script)
    NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(tmp_path)}}).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    assert any("image/png" in output.get("data", {}) for output in outputs), "it shows pictures"
    assert not [output for output in outputs if output.output_type == "stream" and output.name == "stderr"]


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_paired_notebook_is_in_step_and_free_of_outputs(script: Path):
    paired = nbformat.read(script.with_suffix(".ipynb"), as_version=4)
    nbformat.validate(paired)
    cells = [(cell.cell_type, cell.source) for cell in paired.cells]
    assert cells == [(cell.cell_type, cell.source) for cell in jupytext.read(script).cells], (
        f"run: jupytext --to ipynb notebooks/{script.name}"
    )
    assert not any(cell.get("outputs") or cell.get("execution_count") for cell in paired.cells)

"""Run the notebooks, or those that are named: ``python notebooks/run.py [--out out/notebooks] [01_first_track …]``."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import jupytext
import nbformat
from nbclient import NotebookClient

HERE = Path(__file__).parent
NAMES = sorted(path.stem for path in HERE.glob("[0-9]*.py"))
MOST_SECONDS = 300  # of one cell; the first ever compiles the kernels


def run(name: str, out: Path) -> Path:
    """The notebook with what its cells gave. Raises nbclient's CellExecutionError where one fails."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    notebook = jupytext.read(HERE / f"{name}.py")
    place = {"metadata": {"path": str(HERE.parent)}}
    NotebookClient(notebook, timeout=MOST_SECONDS, kernel_name="python3", resources=place).execute()
    out.mkdir(parents=True, exist_ok=True)
    nbformat.write(notebook, out / f"{name}.ipynb")
    return out / f"{name}.ipynb"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=NAMES)
    parser.add_argument("--out", type=Path, default=Path("out/notebooks"))
    options = parser.parse_args()
    for wanted in options.names:
        print(run(wanted, options.out), flush=True)

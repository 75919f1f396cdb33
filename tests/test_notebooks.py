"""The notebooks run from top to bottom, small."""

from pathlib import Path

import nbclient
import nbformat
import pytest

NOTEBOOKS = sorted((Path(__file__).parent.parent / "notebooks").glob("*.ipynb"))
SMALL = {
    "01_first_run": "spacing = 0.1\nuntil = 0.2",
    "02_schemes_compared": "spacing = 0.1\nuntil = 0.2",
    "03_tuning_alpha_ds": "spacing = 0.1\nuntil = 1.2\nupdates = 3\nseeds = 2",
    "04_tuning_alpha_stochastic": "spacing = 0.1\nuntil = 0.5\nupdates = 3\nrate = 0.2\npairs = 1\nseeds = 2",
    "05_ensembles": "spacing = 0.1\nuntil = 0.2\nmembers = 4\n"
    "wave_spacing = 0.1\nwave_until = 0.2\nalphas = 2\nseeds = 2",
}
"""The first cell of each, with the parameters."""
FIGURES = {
    "01_first_run": 3,
    "02_schemes_compared": 3,
    "03_tuning_alpha_ds": 2,
    "04_tuning_alpha_stochastic": 4,
    "05_ensembles": 3,
}
SAYS = {
    "01_first_run": "by gravity",
    "02_schemes_compared": "tip",
    "03_tuning_alpha_ds": "better by",
    "04_tuning_alpha_stochastic": "better by",
    "05_ensembles": "least error at alpha",
}

HURRY = f"""
%matplotlib inline
import sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
import hasty
hasty.hurry()"""
"""What these tests compute takes less time than to compile it."""


QUICK = ("01_first_run",)


@pytest.mark.parametrize(
    "path",
    [pytest.param(path, id=path.stem, marks=() if path.stem in QUICK else pytest.mark.slow) for path in NOTEBOOKS],
)
def test_notebook_runs_and_shows_figures(path, tmp_path):
    notebook = nbformat.read(path, as_version=4)
    names = [line.split(" = ")[0] for line in notebook.cells[0].source.splitlines()]
    assert names == ["# Parameters", *(line.split(" = ")[0] for line in SMALL[path.stem].splitlines())]
    notebook.cells[0].source = SMALL[path.stem] + HURRY
    nbclient.NotebookClient(
        notebook, timeout=300, kernel_name="python3", resources={"metadata": {"path": tmp_path}}
    ).execute()
    outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    assert sum("image/png" in output.get("data", {}) for output in outputs) == FIGURES[path.stem]
    assert any(SAYS[path.stem] in output.get("text", "") for output in outputs)

"""What can be checked of the notebook without a kernel; `make notebook` runs it."""

import ast
import json
from importlib import import_module
from pathlib import Path

NOTEBOOK = Path(__file__).parents[2] / "examples" / "notebook" / "gingerbread.ipynb"


def test_it_holds_no_results_and_its_cells_can_be_read() -> None:
    notebook = json.loads(NOTEBOOK.read_text())
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert len(cells) > 5
    for cell in cells:
        assert (cell["outputs"], cell["execution_count"]) == ([], None)
        for node in ast.walk(ast.parse("".join(cell["source"]))):
            if isinstance(node, ast.ImportFrom) and str(node.module).startswith("nilbs"):
                assert all(hasattr(import_module(str(node.module)), name.name) for name in node.names)

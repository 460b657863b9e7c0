"""Run gingerbread.ipynb in a fresh kernel and write it with its results: `make notebook`."""

import argparse
from pathlib import Path

import nbformat
from nbclient import NotebookClient

HERE = Path(__file__).parent


def main() -> None:
    parser = argparse.ArgumentParser(description="Run the notebook; an error in a cell ends with its traceback.")
    parser.add_argument("--out", type=Path, default=HERE.parents[1] / "out" / "gingerbread.ipynb")
    args = parser.parse_args()
    notebook = nbformat.read(HERE / "gingerbread.ipynb", as_version=4)
    nbformat.validate(notebook)
    # The kernel of this interpreter, whatever kernels the user has.
    client = NotebookClient(notebook, timeout=120, kernel_name="python3", resources={"metadata": {"path": str(HERE)}})
    client.execute()
    args.out.parent.mkdir(parents=True, exist_ok=True)
    nbformat.write(notebook, args.out)
    print(args.out)


if __name__ == "__main__":
    main()

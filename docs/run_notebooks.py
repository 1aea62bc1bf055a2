"""Execute the notebooks from a fresh folder beside a demo and store their outputs.

`python docs/run_notebooks.py DEMO` needs the folder that `wavefield demo` has written; with `--check` nothing
is stored.
"""

import argparse
import json
import tempfile
from pathlib import Path

import nbformat
from nbclient import NotebookClient

NOTEBOOKS = Path(__file__).parents[1] / "notebooks"


def executed(path: Path, folder: Path) -> nbformat.NotebookNode:
    """The notebook with the outputs of a kernel that starts in a folder."""
    notebook = nbformat.read(path, as_version=4)
    NotebookClient(notebook, timeout=600, resources={"metadata": {"path": str(folder)}}).execute()
    for cell in notebook.cells:
        cell.metadata.clear()
    return notebook


def without_paths(notebook: nbformat.NotebookNode, folder: Path) -> nbformat.NotebookNode:
    """The same without the place of the folder and of temporary files."""
    text = json.dumps(notebook)
    for place in (str(folder.resolve()), str(folder)):
        text = text.replace(f"{place}/", "")
    return nbformat.from_dict(json.loads(text))


def main() -> None:
    """Execute all notebooks."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("demo", type=Path)
    parser.add_argument("--check", action="store_true", help="store nothing")
    parser.add_argument("--only", nargs="*", help="names of notebooks")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as fresh:
        folder = Path(fresh) / "elsewhere"
        folder.mkdir()
        (Path(fresh) / "wavefield-demo").symlink_to(options.demo.resolve())
        for path in sorted(NOTEBOOKS.glob("*.ipynb")):
            if options.only and path.stem not in options.only:
                continue
            notebook = executed(path, folder)
            print(f"{path.name}: {len(notebook.cells)} cells")
            if not options.check:
                nbformat.write(without_paths(notebook, Path(fresh)), path)


if __name__ == "__main__":
    main()

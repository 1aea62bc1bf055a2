"""Execute the notebooks from a fresh folder beside a demo and store their outputs.

`python docs/run_notebooks.py DEMO` needs the folder that `wavefield demo` has written; with `--check` nothing
is stored.
"""

import argparse
import base64
import json
import re
import tempfile
from pathlib import Path

import cv2
import nbformat
import numpy as np
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
    text = re.sub(re.escape(tempfile.gettempdir()) + r"/tmp\w+/", "", text)
    return nbformat.from_dict(json.loads(text))


def with_small_pictures(notebook: nbformat.NotebookNode, limit: int = 100_000) -> nbformat.NotebookNode:
    """The same with PNG pictures beyond a limit, characters, as JPEG."""
    for data in (
        output["data"] for cell in notebook.cells for output in cell.get("outputs", ()) if "data" in output
    ):
        if len(data.get("image/png", "")) > limit:
            pixels = cv2.imdecode(
                np.frombuffer(base64.b64decode(data.pop("image/png")), np.uint8), cv2.IMREAD_COLOR
            )
            jpeg = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, 80])[1]
            data["image/jpeg"] = base64.b64encode(jpeg.tobytes()).decode()
    return notebook


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
                nbformat.write(with_small_pictures(without_paths(notebook, Path(fresh))), path)


if __name__ == "__main__":
    main()

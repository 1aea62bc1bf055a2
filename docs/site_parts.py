"""What the site is made from beside its pages: a small simulated experiment, and pictures of figures."""

import hashlib
import re
import shutil
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from sphinx_gallery.scrapers import figure_rst

SCENE = {
    "name": "gallery",
    "frames": 43,
    "rig": {"crop": 0.3},
    "grid": {"x": [-0.26, 0.26], "y": [-0.18, 0.18], "step": 0.01},
    "sea": {
        "kind": "random",
        "rms": 0.012,
        "spectrum": {"kind": "power", "peak": 1.5, "exponent": 6},
        "shortest": 0.06,
    },
    "calibration": {"tilted": 0},
}


def simulate(folder: Path) -> None:
    """Simulate, measure and analyse a small experiment, unless the folder has one by this very code."""
    import wavefield as wf
    from wavefield.commands.cli import main

    sources = sorted(Path(wf.__file__).parent.rglob("*.py"))
    made = hashlib.sha256(repr(SCENE).encode() + b"".join(path.read_bytes() for path in sources)).hexdigest()
    done = folder / "made_by"
    if done.exists() and done.read_text(encoding="utf-8") == made:
        return
    shutil.rmtree(folder, ignore_errors=True)
    experiment = wf.simulate(wf.Scene.from_dict(SCENE), folder)
    rig = folder / "truth" / "rig.yaml"
    for words in (["run", experiment, "--rig", rig], ["analyze", folder / "cube.zarr"]):
        if main(["-q", *map(str, words)]):
            raise RuntimeError(f"wavefield {words[0]} failed on the experiment of the gallery")
    done.write_text(made, encoding="utf-8")


def last_figure(block: Any, block_vars: dict[str, Any], gallery_conf: dict[str, Any]) -> str:
    """Save the figure that the last expression of a block gives, as a notebook would show it."""
    known = block_vars["example_globals"]
    figure, known["___"] = known.get("___"), None
    if not isinstance(figure, Figure):
        return ""
    path = next(block_vars["image_path_iterator"])
    figure.savefig(path, dpi=100)
    return figure_rst([path], gallery_conf["src_dir"])


def keep_formulas(app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Let the signs of a docstring's formulas be themselves: |k|, K * f and z_-1 are no markup."""
    for i, line in enumerate(lines):
        if not re.match(r"\s*(>>>|\.\.\.)", line):
            parts = re.split(r"(`+[^`]*`+)", line)
            parts[::2] = [
                re.sub(r"(\||(?<=\s)\*(?=[\s)])|(?<=\w)_(?![\w`]))", r"\\\1", p) for p in parts[::2]
            ]
            lines[i] = "".join(parts)

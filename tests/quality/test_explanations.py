"""A remark is one line with a code, and `wavefield explain` has the rest."""

import ast
from pathlib import Path

import wavefield
from wavefield.commands.cli import main
from wavefield.quality.camera_faults import _EXPLANATIONS as CAMERA_FAULTS
from wavefield.quality.explanations import EXPLANATIONS
from wavefield.quality.frame_remarks import FAULT_WORDS
from wavefield.store.verdict import Remark
from wavefield.waves.probes.probe_fit import ProbeFit

FITS = [
    ProbeFit("p", 0.1, 0.1, 0.0, 1.0),
    ProbeFit("p", 0.1, 0.1, 0.0, 1.0, (0.1, 0.2)),
    ProbeFit("p", 0.9, -0.9, 0.0, 1.0),
    ProbeFit("p", 0.1, 0.9, 3.0, 1.0),
    ProbeFit("p", 0.9, 0.9, 0.0, 1000.0),
    ProbeFit("p", 0.9, 0.9, 0.0, 1.7),
]


def kinds_of_remarks():
    """The kinds of all remarks that the package can make."""
    found = {kind for kind, *_ in FAULT_WORDS.values()} | set(CAMERA_FAULTS)
    found |= {kind for fit in FITS for kind, *_ in fit.problems(0.05)}
    for path in Path(wavefield.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "Remark" and len(node.args) > 1:
                found |= {one.value for one in ast.walk(node.args[1]) if isinstance(one, ast.Constant)}
    return found


def test_each_remark_has_an_explanation_and_each_explanation_a_remark():
    codes = {Remark("", kind, "note", "").code for kind in kinds_of_remarks()}
    assert codes == set(EXPLANATIONS)


def test_a_remark_is_one_line_with_its_code():
    remark = Remark("rig", "no rest", "note", "no still-water record", "z = 0 on it", "record one")
    assert str(remark) == "rig: no still-water record; record one [no-rest]"
    assert str(Remark("velocity", "eps'", "remark", "0.2 px")).endswith(" [eps]")


def test_explain_prints_one_or_all_and_suggests_a_code(capsys):
    assert main(["explain", "[no-rest]"]) == 0
    assert "z_level_std" in capsys.readouterr().out
    assert main(["explain"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines if not line.startswith(" ")] == list(EXPLANATIONS)
    assert max(map(len, lines)) <= 100
    assert main(["explain", "no-rst"]) == 2
    assert "did you mean no-rest?" in capsys.readouterr().err

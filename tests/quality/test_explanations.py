"""A remark is one line with a code, and `wavefield explain` prints its explanation."""

import ast
from pathlib import Path

import wavefield
from wavefield.commands.cli import main
from wavefield.quality.cameras import _CAMERA_FAULTS as CAMERA_FAULTS
from wavefield.quality.remarks import EXPLANATIONS
from wavefield.store.verdict import Remark


def kinds_of_remarks():
    """The kinds of all remarks that the package can make."""
    found = set(CAMERA_FAULTS)
    for path in Path(wavefield.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "Remark" and len(node.args) > 1:
                found |= {one.value for one in ast.walk(node.args[1]) if isinstance(one, ast.Constant)}
    return found


def test_each_remark_has_an_explanation_and_each_explanation_a_remark():
    codes = {Remark("", kind, "note", "").code for kind in kinds_of_remarks()}
    assert codes == set(EXPLANATIONS)


def test_a_remark_is_one_line_with_its_code():
    remark = Remark("rig", "water level", "note", "no still water", "z = 0 is the target", "Record one?")
    assert str(remark) == "rig: no still water. z = 0 is the target. Record one? [water-level]"
    assert str(Remark("velocity", "eps'", "remark", "0.2 px")).endswith(" [eps]")


def test_explain_prints_one_or_all_and_suggests_a_code(capsys):
    assert main(["explain", "[water-level]"]) == 0
    assert "z_level_std" in capsys.readouterr().out
    assert main(["explain"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines if not line.startswith(" ")] == list(EXPLANATIONS)
    assert max(map(len, lines)) <= 100
    assert main(["explain", "water-lvel"]) == 2
    assert "did you mean water-level?" in capsys.readouterr().err

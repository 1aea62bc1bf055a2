"""What the site is made from beside its pages: the demo, pages of the commands, groups of the reference."""

import ast
import hashlib
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
from latex2mathml.converter import convert
from matplotlib.figure import Figure
from sphinx_gallery.scrapers import figure_rst

HERE = Path(__file__).resolve().parent

# tasks, and the modules whose public names belong to them: a new name finds its group by its module
TASKS = {
    "Describe an experiment": ("series.", "grid", "measurement.", "execution."),
    "Calibrate the cameras": ("calibration.", "rig."),
    "Plan and simulate": ("tank.", "pipeline.checking"),
    "Measure": ("pipeline.lazy", "pipeline.running", "pipeline.catalog", "matching.", "store.ledger"),
    "Open, check and export": (
        "pipeline.opened_run",
        "pipeline.assess",
        "store.",
        "waves.inputs",
    ),
    "Waves": ("waves.", "pipeline.analysis"),
    "See and report": ("explorer.", "reports.", "figures."),
}
OTHER = "Other"


def demo(folder: Path) -> None:
    """Run the demo, unless the folder has one by this very code."""
    from wavefield.commands.cli import main

    done = folder / "made_by"
    if done.exists() and done.read_text(encoding="utf-8") == code():
        return
    shutil.rmtree(folder, ignore_errors=True)
    if main(["-q", "demo", str(folder)]):
        raise RuntimeError("the demo of the site failed")
    sign_demo(folder)


def sign_demo(folder: str | Path) -> None:
    """Note in a demo's folder which code made it."""
    (Path(folder) / "made_by").write_text(code(), encoding="utf-8")


def code() -> str:
    """A digest of the package's sources."""
    import wavefield as wf

    sources = sorted(Path(wf.__file__).parent.rglob("*.py"))
    return hashlib.sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()


def tasks() -> dict[str, list[str]]:
    """Public names of the package by task."""
    stub = ast.parse((HERE.parent / "wavefield" / "__init__.pyi").read_text(encoding="utf-8"))
    found: dict[str, list[str]] = {task: [] for task in (*TASKS, OTHER)}
    for statement in stub.body:
        if isinstance(statement, ast.ImportFrom):
            module = (statement.module or "").removeprefix("wavefield.")
            starts = [(start, task) for task, modules in TASKS.items() for start in modules]
            fits = [(len(start), task) for start, task in starts if module.startswith(start)]
            task = max(fits, default=(0, OTHER))[1]
            found[task] += [alias.asname or alias.name for alias in statement.names]
    return {task: sorted(names) for task, names in found.items() if names}


def write_reference(path: Path) -> None:
    """Write tables of the public names, one for each task."""
    head = ".. autosummary::\n   :toctree: api\n   :nosignatures:\n\n"
    parts = []
    for task, names in tasks().items():
        table = head + "".join(f"   wavefield.{name}\n" for name in names)
        parts.append(f"## {task}\n\n```{{eval-rst}}\n{table}```\n")
    path.write_text("\n".join(parts), encoding="utf-8")


def commands() -> Iterator[tuple[str, click.Command]]:
    """Every command with its full name."""
    from wavefield.commands.cli import cli

    for name, command in cli.commands.items():
        yield name, command
        if isinstance(command, click.Group):
            yield from ((f"{name} {inner}", part) for inner, part in command.commands.items())


def command_page(name: str, command: click.Command) -> str:
    """The page of a command: usage, what it does, arguments and options, examples."""
    context = click.Context(command, info_name=f"wavefield {name}")
    usage = " ".join(command.collect_usage_pieces(context))
    rows = []
    for parameter in command.get_params(context):
        if isinstance(parameter, click.Option) and not parameter.hidden and "--help" not in parameter.opts:
            left, right = parameter.get_help_record(context) or ("", "")
            left, right = (text.replace("|", "\\|") for text in (left, right))
            rows.append(f"| `{left}` | {right} |")
    text = [f"# wavefield {name}", f"```text\nwavefield {name} {usage}\n```", _paragraphs(command.help or "")]
    if rows:
        text.append("\n".join(["| option | meaning |", "|---|---|", *rows]))
    if command.epilog:
        text.append(_paragraphs(command.epilog))
    if isinstance(command, click.Group):
        links = [f"- [wavefield {name} {inner}]({name}-{inner}.md)" for inner in command.commands]
        text.append("\n".join(links))
    return "\n\n".join(text) + "\n"


def _paragraphs(text: str) -> str:
    """Help of a command as Markdown: what click leaves as it is becomes a block of its own."""
    out = []
    for part in re.split(r"\n\s*\n", text.replace("\f", "")):
        if part.lstrip().startswith("\b"):
            lines = part.split("\b", 1)[1].strip("\n").splitlines()
            indent = min((len(line) - len(line.lstrip()) for line in lines if line.strip()), default=0)
            lines = [line[indent:] for line in lines]
            if lines and lines[0].rstrip().endswith(":") and not lines[0].startswith(" "):
                out.append(lines.pop(0))
                indent = min((len(line) - len(line.lstrip()) for line in lines if line.strip()), default=0)
                lines = [line[indent:] for line in lines]
            out.append("```text\n" + "\n".join(lines) + "\n```")
        else:
            words = " ".join(part.split())
            out.append(re.sub(r"(?<!`)`([^`]+)`(?!`)", r"`\1`", words).replace("<", "&lt;"))
    return "\n\n".join(out)


def write_commands(folder: Path) -> None:
    """Write a page for every command, and the table of them all."""
    from wavefield.quality.remarks import EXPLANATIONS

    folder.mkdir(exist_ok=True)
    rows = ["| command | what it does |", "|---|---|"]
    for name, command in commands():
        page, file = command_page(name, command), f"{name.replace(' ', '-')}.md"
        if name == "explain":
            codes = [f"| `{code}` | {text} |" for code, text in EXPLANATIONS.items()]
            page += (
                "\n" + "\n".join(["| remark | what it means and what to do |", "|---|---|", *codes]) + "\n"
            )
        (folder / file).write_text(page, encoding="utf-8")
        rows.append(f"| [wavefield {name}]({folder.name}/{file}) | {command.get_short_help_str(200)} |")
    (folder / "table.txt").write_text("\n".join(rows) + "\n", encoding="utf-8")


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


def inline_formula(writer: Any, node: Any) -> None:
    """A formula in a line as MathML, which browsers draw without a script."""
    import docutils.nodes

    writer.body.append(convert(node.astext()))
    raise docutils.nodes.SkipNode


def block_formula(writer: Any, node: Any) -> None:
    """A formula of its own as MathML, with its number if it has one."""
    import docutils.nodes

    number = f'<span class="eqno">({node["number"]})</span>' if node.get("number") else ""
    formula = convert(node.astext().strip(), display="block")
    writer.body.append(f'<div class="formula">{number}{formula}</div>')
    raise docutils.nodes.SkipNode

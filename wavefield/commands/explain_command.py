"""`wavefield explain`: what a remark of a verdict means and what to do."""

import difflib

import click
from click.shell_completion import CompletionItem


def _complete(context: click.Context, parameter: click.Parameter, begun: str) -> list[CompletionItem]:
    from wavefield.quality.remarks import EXPLANATIONS

    return [CompletionItem(code) for code in EXPLANATIONS if code.startswith(begun)]


@click.command(
    epilog="""\b
Examples:
  wavefield explain             # all codes
  wavefield explain water-level
"""
)
@click.argument("code", required=False, shell_complete=_complete)
@click.pass_context
def explain(context: click.Context, code: str | None) -> None:
    """Explain a remark of `check`, `run` or `status`.

    CODE is the word in brackets at the end of the remark; without it, all codes are listed.
    """
    from wavefield.quality.remarks import EXPLANATIONS, first_sentence

    if code is None:
        formatter = context.make_formatter()
        formatter.write_dl([(name, first_sentence(text)) for name, text in EXPLANATIONS.items()])
        click.echo(formatter.getvalue(), nl=False)
        return
    name = code.strip("[]").lower()
    if name not in EXPLANATIONS:
        near = difflib.get_close_matches(name, EXPLANATIONS, n=1)
        remedy = f"did you mean {near[0]}?" if near else "`wavefield explain` lists all codes"
        raise click.UsageError(f"there is no remark {code!r}; {remedy}")
    click.echo(click.wrap_text(EXPLANATIONS[name], 90))

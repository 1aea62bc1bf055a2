"""What each remark of a verdict means, how it is found, and what to do: the text of `wavefield explain`."""

from pathlib import Path

import yaml

EXPLANATIONS: dict[str, str] = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text(encoding="utf-8"))


def first_sentence(text: str) -> str:
    """The first sentence of an explanation.

    Examples
    --------
    >>> first_sentence("It is blurred. Focus it.")
    'It is blurred.'
    """
    return text.partition(". ")[0].rstrip(".") + "."

"""Text of others in Markdown: names of estimators, titles of tasks and reasons of failures stay what they are."""

import html
import re
from collections.abc import Sequence


def escaped(text: str) -> str:
    """Return a text that Markdown shows as it is: no HTML, no further cell of a table, no link, code or emphasis."""
    return re.sub(r"([\\`*|\[])", r"\\\1", html.escape(text, quote=False))


def table_of(rows: Sequence[Sequence[str]], numbers: Sequence[bool]) -> str:
    """Return a table, its heading the first row. numbers: whether each column holds numbers."""
    header, *others = rows
    lines = [header, ["--:" if right else "---" for right in numbers], *others]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)

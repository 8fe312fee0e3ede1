"""HTML from templates: all text is escaped, and nothing but the project's own scripts can run."""

import hashlib
import json
import math
import re
from base64 import b64encode
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from castor_envs.files import write_atomically

FOLDER = Path(__file__).parent
STYLES = ("uplot/uPlot.min.css", "page.css")
SCRIPTS = ("uplot/uPlot.iife.min.js", "page.js", "charts.js")
LICENCE = "uplot/LICENSE"

MARK = '<meta name="generator" content="castor-envs">'
"""In the head of every page, by which a command knows what it may replace."""
LONGEST = 60
"""Characters of a file name that come from a name; with a digest and a suffix far below what file systems take."""


def render(folder: Path, template: str, assets: str | None = None, scripted: bool = True, **context: Any) -> str:
    """Return the page of a template in `folder` that extends ``base.html``.

    assets: where the page finds what `write_assets` wrote, such as ``../assets``; None: the page holds it itself.
    scripted: whether it has curves and tables to sort; else it has no script and runs none.
    context: what the template names; text in it is escaped. Raises jinja2.UndefinedError for what it lacks.
    """
    from jinja2 import Environment, FileSystemLoader, StrictUndefined  # slow to import
    from markupsafe import Markup

    environment = Environment(
        loader=FileSystemLoader([folder, FOLDER]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["data"] = lambda value: Markup(as_data(value))
    style_names, script_names = (STYLES, SCRIPTS) if scripted else (STYLES[-1:], ())
    styles = [] if assets is not None else [Markup(_read(name)) for name in style_names]
    scripts = [] if assets is not None else [Markup(_script(name)) for name in script_names]
    linked = [] if assets is None else [f"{assets}/{Path(name).name}" for name in (*style_names, *script_names)]
    return environment.get_template(template).render(
        mark=Markup(MARK),
        policy=_policy(linked=assets is not None, scripted=scripted),
        styles=styles,
        scripts=scripts,
        style_links=[link for link in linked if link.endswith(".css")],
        script_links=[link for link in linked if link.endswith(".js")],
        **context,
    )


def write_assets(folder: Path) -> None:
    """Write the style, the scripts and the licence of the plotting library, for pages that link to them."""
    for name in STYLES:
        write_atomically(folder / Path(name).name, _read(name))
    for name in SCRIPTS:
        write_atomically(folder / Path(name).name, _script(name))
    write_atomically(folder / "uPlot.LICENSE.txt", _read(LICENCE))


def as_data(value: Any) -> str:
    """Return data as JSON that is inert inside HTML; numbers that are not finite become null."""
    text = json.dumps(_plain(value), allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def safe_name(name: str) -> str:
    """Return a name for a file or a folder: the name itself where it is short and plain, else one with a digest.

    Different names never share one, also where file systems take upper and lower case for the same.
    """
    if re.fullmatch(r"[a-z0-9][a-z0-9._-]*", name) and len(name) <= LONGEST:
        return name
    plain = re.sub(r"[^A-Za-z0-9._-]+", "_", name).strip("._-")[:LONGEST]
    digest = hashlib.sha256(name.encode(errors="surrogatepass")).hexdigest()[:8]
    return f"{plain or 'name'}-{digest}"


def _plain(value: Any) -> Any:
    """Return arrays as lists, and numbers that JSON does not have as None."""
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


@cache
def _read(name: str) -> str:
    return (FOLDER / name).read_text(encoding="utf-8")


def _script(name: str) -> str:
    """Return a script's text; its licence is named above the library that has one of its own."""
    licence = " ".join(_read(LICENCE).split()).replace("*/", "* /")
    return f"/*! uPlot. {licence} */\n{_read(name)}" if name.startswith("uplot/") else _read(name)


@cache
def _policy(linked: bool, scripted: bool) -> str:
    """Return the content security policy: scripts by their hash where they stand in the page, so that no other runs."""
    digests = (b64encode(hashlib.sha256(_script(name).encode()).digest()).decode() for name in SCRIPTS)
    scripts = "'self'" if linked else " ".join(f"'sha256-{digest}'" for digest in digests)
    # uPlot sets styles of its elements, which the policy would refuse without 'unsafe-inline'.
    styles = "'self' 'unsafe-inline'" if linked else "'unsafe-inline'"
    runs = scripts if scripted else "'none'"
    rules = {"default-src": "'none'", "style-src": styles, "script-src": runs, "img-src": "data:", "base-uri": "'none'"}
    return "; ".join(f"{name} {value}" for name, value in rules.items()) + "; form-action 'none'"

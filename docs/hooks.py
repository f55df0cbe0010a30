"""What the site shows beside the pages of this folder; mkdocs calls these functions (mkdocs.yml).

* CHANGELOG, CONTRIBUTING and SECURITY, which stand at the root of the repository, become pages.
* The example programs become one page, each notebook (a script of jupytext's percent format) a page of its own.
* The page on the command line shows the help of every command that is installed, and leads to a page made of the
  classes of all reports.
* A link that leads out of this folder leads to the page made of that file, or becomes plain text where there is none.
"""

from __future__ import annotations

import contextlib
import io
import os
import posixpath
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest.mock import patch

from json_page import json_page
from mkdocs.structure.files import File

DOCS = Path(__file__).parent
ROOT = DOCS.parent

PAGES_FROM_ROOT = {"CHANGELOG.md": "changelog.md", "CONTRIBUTING.md": "contributing.md", "SECURITY.md": "security.md"}
EXAMPLES_PAGE = "examples/index.md"
NOTEBOOKS = "notebooks"
COMMANDS_PAGE = "command-line.md"
COMMANDS_MARK = "<!-- help of every command -->"
JSON_PAGE = "json.md"
JSON_MARK = "a page made from the code"
BOOSTS = {
    "index.md": 4.0,
    "glossary.md": 4.0,
    "changelog.md": 0.2,
    "reliability.md": 0.5,
    "api-": 0.5,
    "json.md": 0.5,
    "specification/": 0.5,
}
"""How far up a page comes in the search, by the beginning of its path; first what explains to newcomers."""
HELP_WIDTH = 80  # columns, as many as a page shows without scrolling

_LINKS = re.compile(
    r"(?P<code>^ *```.*?^ *```[^\n]*$)|\[(?P<text>[^\]\[]*)\]\((?P<target>[^()\s]+)\)|(?P<inline>`[^`\n]*`)",
    re.MULTILINE | re.DOTALL,
)
_ROLE = re.compile(r":(?:attr|class|data|exc|func|meth|mod):(?=<code>)")
_EXTERNAL = re.compile(r"[a-z]+:|#")
_COMMAND_LINE = re.compile(r"^[ │|]*([a-z][a-z0-9]*(?:-[a-z0-9]+)*)(?: {2,}| *[│|]?$)", re.MULTILINE)


def on_config(config: Any) -> Any:
    """Make the anchors of headings those of GitHub, which citations in the code use."""
    config.mdx_configs["toc"] = {**config.mdx_configs.get("toc", {}), "slugify": anchor}
    return config


def anchor(title: str, separator: str) -> str:
    """Return the anchor of a heading: lower case, words joined by hyphens, no other signs."""
    return re.sub(r"[^\w\- ]", "", title.strip().lower()).replace(" ", separator)


def on_files(files: Any, config: Any) -> Any:
    """Add the pages that are made of files elsewhere."""
    for source, page in PAGES_FROM_ROOT.items():
        text = (ROOT / source).read_text(encoding="utf-8")
        files.append(File.generated(config, page, content=with_site_links(text, source)))
    files.append(File.generated(config, EXAMPLES_PAGE, content=examples_page()))
    files.append(File.generated(config, JSON_PAGE, content=json_page()))
    for script in sorted((DOCS / NOTEBOOKS).glob("*.py")):
        text = with_site_links(notebook_page(script), f"docs/{NOTEBOOKS}/{script.name}")
        files.append(File.generated(config, f"{NOTEBOOKS}/{script.stem}.md", content=text))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Turn the links of a page into links of the site, and fill in the help of the commands."""
    uri = page.file.src_uri
    boosts = [boost for beginning, boost in BOOSTS.items() if uri.startswith(beginning)]
    page.meta.setdefault("search", {"boost": boosts[0] if boosts else 1.0})
    if uri == COMMANDS_PAGE:
        markdown = markdown.replace(COMMANDS_MARK, "\n".join(command_sections()))
        markdown = markdown.replace(JSON_MARK, f"[{JSON_MARK}]({JSON_PAGE})")
    if page.file.generated_by:
        return markdown
    return with_site_links(markdown, f"docs/{uri}")


def on_page_content(html: str, **_: Any) -> str:
    """Leave out the roles of docstrings (``:class:``), which stand before names in the reference of the API."""
    return _ROLE.sub("", html)


def with_site_links(text: str, source: str) -> str:
    """Return a page's text with links that work on the site.

    Args:
        text: Markdown.
        source: Path of its file below the root of the repository.
    """

    def replaced(match: re.Match[str]) -> str:
        if match["target"] is None or _EXTERNAL.match(match["target"]):
            return match[0]
        path, mark, heading = match["target"].partition("#")
        target = site_path(posixpath.normpath(posixpath.join(posixpath.dirname(source), path)))
        if target is None:
            return match["text"]
        start = posixpath.dirname(PAGES_FROM_ROOT.get(source) or source.removeprefix("docs/"))
        return f"[{match['text']}]({posixpath.relpath(target, start or '.')}{mark}{heading})"

    return _LINKS.sub(replaced, text)


def site_path(path: str) -> str | None:
    """Return where a file of the repository stands below the site's root; None where it is no part of it."""
    if path in PAGES_FROM_ROOT:
        return PAGES_FROM_ROOT[path]
    if not path.startswith("docs/"):
        return None
    below = path.removeprefix("docs/")
    if below.startswith(f"{NOTEBOOKS}/"):
        return str(Path(below).with_suffix(".md"))
    return EXAMPLES_PAGE if (ROOT / path).is_dir() and below.startswith("examples") else below


def examples_page() -> str:
    """Return a page with the text of the example programs."""
    lines = [
        "# Example programs",
        "",
        "Complete methods outside prbench's own process, as the [wire protocol](../wire-protocol.md) describes them:",
        "the same method in Python and in JavaScript, and the description that starts the first one.",
        "The files [stdin.bin](exchange/stdin.bin) and [stdout.bin](exchange/stdout.bin) hold everything that goes",
        "through the two pipes for two short sequences.",
    ]
    for name, language in (("glide.py", "python"), ("glide.mjs", "javascript"), ("glide.toml", "toml")):
        text = (DOCS / "examples" / name).read_text(encoding="utf-8").rstrip()
        lines += ["", f"## {name}", "", f"Download: [{name}]({name})", "", f"```{language}", text, "```"]
    return "\n".join(lines) + "\n"


def notebook_page(script: Path) -> str:
    """Return a notebook as a page: its text as it stands, its code in blocks, without what the code prints."""
    _, *cells = re.split(r"^# %%(.*)\n", script.read_text(encoding="utf-8"), flags=re.MULTILINE)
    parts = []
    for kind, text in zip(cells[::2], cells[1::2], strict=True):
        if "[markdown]" in kind:
            parts.append(re.sub(r"^# ?", "", text, flags=re.MULTILINE).strip())
        elif text.strip():
            parts.append(f"```python\n{text.strip()}\n```")
    title, _, rest = parts[0].partition("\n")
    download = f'<a href="{script.name}" download>{script.name}</a>'
    note = f"*A notebook: {download} is a script that runs as it is, and that Jupyter opens with jupytext.*"
    return "\n\n".join([title, note, rest.strip(), *parts[1:]]) + "\n"


def command_sections() -> Iterator[str]:
    """Yield lines: a heading and the help text for the program and each of its commands."""
    for words, text in every_help():
        level = "##" if len(words) < 2 else "###"
        yield f"\n{level} prbench {' '.join(words)}".rstrip() + "\n"
        yield f"```text\n{text.strip()}\n```\n"


def every_help(words: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], str]]:
    """Yield the words of each command and its help text, the program itself first."""
    text = help_text(words)
    if text is None:
        return
    yield words, text
    for name in commands_named(text):
        below = help_text((*words, name))
        # A word that is no command makes an error, or the help of the command above, whose usage lacks the word.
        if below is not None and re.search(
            rf"prbench {' '.join((*words, name))}(?![\w-])", below.strip().partition("\n\n")[0]
        ):
            yield from every_help((*words, name))


def commands_named(text: str) -> list[str]:
    """Return the words at the beginning of a help text's lines that may be commands, in their order."""
    return list(dict.fromkeys(_COMMAND_LINE.findall(text)))


def help_text(words: tuple[str, ...]) -> str | None:
    """Return what ``prbench WORDS --help`` prints without colours; None if it fails."""
    from prbench.cli import main

    printed = io.StringIO()
    environment = {"COLUMNS": str(HELP_WIDTH), "NO_COLOR": "1", "TERM": "dumb"}
    code: Any = 0
    with (
        patch.dict(os.environ, environment),
        patch.object(sys, "argv", ["prbench"]),
        contextlib.redirect_stdout(printed),
        contextlib.redirect_stderr(io.StringIO()),
    ):
        try:
            code = main([*words, "--help"])
        except SystemExit as end:
            code = end.code
    if code:
        return None
    return re.sub(r"\x1b\[[0-9;]*m", "", printed.getvalue())

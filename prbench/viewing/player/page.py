"""The page of the player: one HTML file that loads nothing and works from disk."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from prbench.files.storage import sole_writer, write_text
from prbench.shown import html
from prbench.viewing.player.document import PlayerSequence, encoded

_HERE = Path(__file__).parent
_THREE = _HERE / "vendor" / "three" / "three.js"


@dataclass(frozen=True)
class Assets:
    """What a page needs to show the player.

    Attributes:
        scripts: JavaScript: three.js, then the player; it defines ``prbench.player.mount``.
        style: CSS.
    """

    scripts: str
    style: str


def player_assets() -> Assets:
    """Read the player's scripts and style, to be put into ``<script>`` and ``<style>`` or copied beside a page."""
    own = sorted(_HERE.glob("*.js"), key=lambda path: (path.name == "player.js", path.name))  # which needs the others
    scripts = [path.read_text(encoding="utf-8") for path in (_THREE, *own) if path.is_file()]
    styles = [path.read_text(encoding="utf-8") for path in sorted(_HERE.glob("*.css"))]
    # A string in a script that spells the end of a script would end the element.
    return Assets(";\n".join(scripts).replace("</script", "<\\/script"), "\n".join(styles))


def page_text(sequences: Iterable[PlayerSequence], title: str = "prbench view") -> str:
    """Return the page of some sequences; the motions of each are decoded when it is chosen.

    Args:
        sequences: What the menu offers, in its order.
        title: Title of the page.
    """
    contents = [encoded(sequence).decode() for sequence in sequences]
    documents = "\n".join(f'<script type="application/json" class="sequence">{each}</script>' for each in contents)
    assets = player_assets()
    parts = {"TITLE": html(title), "STYLE": assets.style, "DOCUMENTS": documents, "PLAYER": assets.scripts}
    return filled(_HERE / "page.html", parts)


def filled(template: Path, parts: Mapping[str, str]) -> str:
    """Return a template of ours with its places, such as ``__TITLE__``, filled.

    Args:
        template: HTML with each place once.
        parts: The text of each place by its name, in the template's order: no part's own text is taken for a place.
    """
    text = template.read_text(encoding="utf-8")
    pieces = []
    for place, part in parts.items():
        before, _, text = text.partition(f"__{place}__")
        pieces += [before, part]
    return "".join([*pieces, text])


def write_page(sequences: Iterable[PlayerSequence], out: Path, title: str = "prbench view") -> None:
    """Write the page of some sequences into one file.

    Args:
        sequences: What the menu offers, in its order.
        out: The file; replaced when it exists.
        title: Title of the page.

    Raises:
        StorageError: if the file cannot be written.
    """
    with sole_writer(out):
        write_text(out, page_text(sequences, title))

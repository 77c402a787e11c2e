"""The site as a folder of pages that need nothing else, and whether everything that they link to is there.

How this works
--------------
Pages are Markdown for any reader of it. What they leave to be filled in, lines such as `<!-- generated: codes -->` and
formulae, is filled in here, so that the builder of the site is a matter of one call and one `mkdocs.yml`: plain
Markdown with few extensions. Formulae become MathML, which browsers draw by themselves.
"""

import re
import shutil
import subprocess
import sysconfig
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Final
from urllib.parse import unquote, urlsplit

from latex2mathml.converter import convert

from tests.docs.generated import PARTS
from tests.docs.pages import DOCS, ROOT

SETTINGS: Final = DOCS.parent / "mkdocs.yml"
IMAGES: Final = DOCS.parent / "images"
# A link in front of it is for who reads the page where it lies.
_PART: Final = re.compile(r"^(?:\[.+?\]\(\S+\) )?<!-- (generated|included|readme): (.+?) -->$", re.MULTILINE)
_FORMULA: Final = re.compile(r"^```math\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_CODE: Final = re.compile(r"(^```.*?^```$|`[^`\n]+`)", re.MULTILINE | re.DOTALL)
_FUNCTION: Final = re.compile(r"(<mi>(?:sin|cos|tan|arcsin)</mi>)(?!<mo)")  # a space behind it, which is not made
_INLINE: Final = re.compile(r"\$([^$\n]+)\$")


class SiteError(Exception):
    """What is wrong with the pages."""


def filled(text: str) -> str:
    """A page with its generated parts and its formulae. Raises SiteError."""
    return _formulae(_PART.sub(lambda found: _part(found[1], found[2]), text))


def _part(kind: str, words: str) -> str:
    if kind == "included":
        return (ROOT / words).read_text(encoding="utf-8")
    if kind == "readme":
        return _of_readme(*words.split(" | "))
    name, *arguments = words.split()
    if name not in PARTS:
        raise SiteError(f"generated: {name}: there is {', '.join(PARTS)}")
    return PARTS[name](*arguments)


def _of_readme(title: str, first: str = "", end: str = "") -> str:
    """A section of the README, or of it the lines from the one that begins with `first` until before `end`."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    text = text.replace("](deploy/README.md", "](../begin/install.md").replace("](deploy/docs/", "](../")
    text = text.replace("](deploy/images/", "](../../images/")
    found = re.search(rf"^## {re.escape(title)}\n.*?(?=^## |\Z)", text, re.MULTILINE | re.DOTALL)
    lines = [] if found is None else found[0].splitlines()
    begin = next((at for at, line in enumerate(lines) if line.startswith(first)), None)
    if begin is None:
        raise SiteError(f"the README has no section {title!r}, or no line in it that begins with {first!r}")
    until = next((at for at, line in enumerate(lines) if end and at > begin and line.startswith(end)), None)
    if end and until is None:
        raise SiteError(f"section {title!r} of the README has no line that begins with {end!r}")
    return "\n".join(lines[begin:until])


def _formulae(text: str) -> str:
    text = _FORMULA.sub(lambda found: f'<div class="formula">{_math(found[1], display="block")}</div>', text)
    pieces = _CODE.split(text)  # every second one is code
    # Within a span: a line that begins with a formula would be no paragraph.
    pieces[::2] = [
        _INLINE.sub(lambda found: f"<span>{_math(found[1], display='inline')}</span>", piece) for piece in pieces[::2]
    ]
    return "".join(pieces)


def _math(latex: str, *, display: str) -> str:
    made: str = convert(latex.strip(), display=display)
    return _FUNCTION.sub(r'\1<mspace width="0.17em"/>', made)


def build(folder: Path) -> Path:
    """The pages in `folder`, as strict as the builder can be; the folder of the site. Raises SiteError."""
    shutil.copytree(DOCS, folder / "docs")
    shutil.copytree(IMAGES, folder / "docs" / "images")
    shutil.copy(SETTINGS, folder / "mkdocs.yml")
    for page in (folder / "docs").rglob("*.md"):
        try:
            text = filled(page.read_text(encoding="utf-8")).replace("../images/", "images/")  # they lie beside the docs
            page.write_text(text, encoding="utf-8")
        except SiteError as error:
            raise SiteError(f"{page.relative_to(folder)}: {error}") from None
    builder = Path(sysconfig.get_path("scripts")) / "zensical"
    made = subprocess.run(
        [builder, "build", "--strict", "--clean"], cwd=folder, capture_output=True, text=True, timeout=120, check=False
    )
    if made.returncode != 0:
        raise SiteError(f"the builder says:\n{made.stdout}{made.stderr}")
    return folder / "site"


# -- links ------------------------------------------------------------------------------------------------------------


class _Page(HTMLParser):
    """What a page links to, what it loads, and the places in it that can be linked to."""

    def __init__(self) -> None:
        super().__init__()
        self.links: set[str] = set()
        self.loads: set[str] = set()
        self.places: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {key: value for key, value in attrs if value}
        if "id" in given:
            self.places.add(given["id"])
        if tag == "a" and "href" in given:
            self.links.add(given["href"])
        if tag == "link" and given.get("rel") != "canonical" and "href" in given:
            self.loads.add(given["href"])
        if "src" in given:
            self.loads.add(given["src"])


def _read(page: Path) -> _Page:
    found = _Page()
    found.feed(page.read_text(encoding="utf-8"))
    return found


def broken(site: Path) -> Iterator[str]:
    """Every link of the site that leads nowhere, and everything that a page would fetch from elsewhere."""
    pages = {page: _read(page) for page in sorted(site.rglob("*.html")) if page.name != "404.html"}
    for page, found in pages.items():
        where = page.relative_to(site)
        yield from (f"{where} loads {one}" for one in sorted(found.loads) if urlsplit(one).netloc)
        for link in sorted(found.links | found.loads):
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = page if not parts.path else (page.parent / unquote(parts.path)).resolve()
            if target.is_dir():
                target /= "index.html"
            if not target.is_file():
                yield f"{where}: nothing is at {link}"
            elif parts.fragment and target in pages and unquote(parts.fragment) not in pages[target].places:
                yield f"{where}: no such place: {link}"
    for sheet in site.rglob("*.css"):
        fetched = re.findall(
            r"url\(['\"]?(?:https?:)?//[^)]*\)|@import[^;]*//[^;]*;", sheet.read_text(encoding="utf-8")
        )
        yield from (f"{sheet.relative_to(site)} loads {one}" for one in fetched)


def broken_in_repository(page: Path) -> Iterator[str]:
    """Of a page that is read where it lies: links to files that are not there, and to headings that nobody makes."""
    text = page.read_text(encoding="utf-8")
    for link in re.findall(r"\]\(([^)\s]+)\)", _CODE.sub("", text)):
        parts = urlsplit(link)
        if parts.scheme or parts.netloc:
            continue
        target = page if not parts.path else page.parent / unquote(parts.path)
        if not target.exists():
            yield f"{page.relative_to(ROOT)}: nothing is at {link}"
        elif (
            parts.fragment
            and not target.is_relative_to(DOCS)
            and parts.fragment not in anchors(target.read_text(encoding="utf-8"))
        ):
            yield f"{page.relative_to(ROOT)}: no such heading: {link}"


def anchors(text: str) -> set[str]:
    """Of the headings of a page, as they are made by who shows Markdown in a repository."""
    headings = re.findall(r"^#+ (.+)$", re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}

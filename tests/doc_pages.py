"""The pages of the documentation as text: their code, tables, headings and links."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"

GENERATED = ("docs/gallery/", "docs/reference/api/", "docs/reproduced/")
"""Folders of pages that programs write."""

PAGES = sorted(
    page
    for folder, pattern in (
        (ROOT, "*.md"),
        (ROOT / "assets", "**/*.md"),
        (ROOT / "benchmarks", "**/*.md"),
        (DOCS, "**/*.md"),
    )
    for page in folder.glob(pattern)
    if not page.relative_to(ROOT).as_posix().startswith(GENERATED)
)

NOT_RUN = re.compile(r"<!-- not run: .{10,} -->")

_FENCE = re.compile(
    r"^(?P<indent> *)(?P<ticks>```+|~~~+|:::+)(?P<kind>[^`\n]*)\n"
    r"(?P<code>.*?)^(?P=indent)(?P=ticks)$",
    flags=re.DOTALL | re.MULTILINE,
)
_LINK = re.compile(r"!?\[(?:[^\[\]]|\[[^\]]*\])*\]\(\s*<?([^)\s>]+)>?(?:\s+\"[^\"]*\")?\s*\)")
_SOURCE = re.compile(r"<(?:img|source|video)[^>]*? src=\"([^\"]+)\"")
_DIRECTIVE = re.compile(r"^(?:```+|:::+)\{(?:image|figure)\} *(\S+)", flags=re.MULTILINE)


@dataclass(frozen=True)
class Block:
    """A fenced block: its language, its text, its first line in the page, and whether it is run."""

    kind: str
    code: str
    line: int
    runs: bool


def name(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def read(page: Path) -> str:
    return page.read_text(encoding="utf-8")


def blocks(page: Path, kind: str) -> Iterator[Block]:
    """List the fenced blocks of a language."""
    text = read(page)
    for found in re.finditer(_FENCE, text):
        if found["kind"].strip() == kind:
            before = text[: found.start()].rstrip().splitlines()
            runs = not (before and NOT_RUN.fullmatch(before[-1].strip()))
            indent = len(found["indent"])
            lines = [line[indent:] for line in found["code"].splitlines()]
            line = text.count("\n", 0, found.start("code")) + 1
            yield Block(kind, "\n".join(lines) + "\n", line, runs)


def commands(page: Path) -> Iterator[str]:
    """List the commands of the console blocks: lines after "$ ", joined where they continue."""
    for block in blocks(page, "console"):
        text = block.code.replace("\\\n", " ")
        yield from (line[2:].strip() for line in text.splitlines() if line.startswith("$ "))


def expanded(page: Path) -> str:
    """Return a page with the pages that it includes."""
    return re.sub(
        r"^```+\{include\} *(\S+)\n(?:.*\n)*?```+$",
        lambda found: read((page.parent / found[1]).resolve()),
        read(page),
        flags=re.MULTILINE,
    )


def without_blocks(text: str) -> str:
    """Return a text without its blocks of code; directives stay."""
    return re.sub(_FENCE, lambda found: found[0] if found["kind"].startswith("{") else "", text)


def spans(page: Path) -> list[str]:
    """List the code within sentences."""
    found = re.findall(r"(?<!`)`([^`]+)`(?!`)", without_blocks(read(page)))
    return [" ".join(span.split()) for span in found if span.strip()]


def targets(page: Path) -> list[str]:
    """List the targets of a page's links and pictures."""
    text = re.sub(r"(?<!\[)`[^`\n]+`(?!\])", "", without_blocks(read(page)))
    return [*_LINK.findall(text), *_SOURCE.findall(text), *_DIRECTIVE.findall(text)]


def anchors(text: str) -> set[str]:
    """List the anchors of a page's headings, as GitHub and MyST make them."""
    text = re.sub(_FENCE, "", text)
    found: dict[str, int] = {}
    for heading in re.findall(r"^#{1,6} +(.+?) *#*$", text, flags=re.MULTILINE):
        plain = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).replace("`", "").replace("*", "")
        slug = re.sub(r"[^\w\- ]", "", plain.lower()).strip().replace(" ", "-")
        found[slug] = found.get(slug, -1) + 1
    explicit = re.findall(r"^\(([\w-]+)\)=$", text, flags=re.MULTILINE)
    return {
        f"{slug}-{n}" if n else slug for slug, most in found.items() for n in range(most + 1)
    } | set(explicit)


def tables(page: Path) -> dict[str, list[list[str]]]:
    """Return the rows of each table that a comment `<!-- fields: NAME -->` precedes, by NAME."""
    found = {}
    for key, table in re.findall(
        r"<!-- fields: ([\w-]+) -->\n((?:\|.*\n)+)", read(page), flags=re.MULTILINE
    ):
        assert key not in found, key
        lines = table.splitlines()[2:]
        found[key] = [[cell.strip() for cell in line[1:-1].split(" | ")] for line in lines]
    return found

"""Set the theory pages as one paper: `python docs/site/theory_pdf.py [FILE]`. Needs `pip install ".[docs,pdf]"`.

Pandoc translates the pages to Typst, and Typst sets them; both come as wheels, and no TeX is needed.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pypandoc
import typst
from literature import with_tables

DOCS = Path(__file__).parents[1]
SETTINGS = """
#show figure: set block(breakable: true)
#show table.cell: set align(left)
#show table.cell: set text(size: 8pt)
#show table.cell: set par(justify: false)
"""


def main(file: Path) -> None:
    """Write the paper to `file`."""
    text = "\n\n".join(_with_absolute_images(page) for page in (*pages(), DOCS / "related_work.md"))
    options = ["--standalone", "--wrap=none", "--metadata=title:Kinematics of the 3RPS-3SPR manipulator"]
    source = pypandoc.convert_text(
        with_tables(text), "typst", format="commonmark_x+tex_math_dollars", extra_args=options
    )
    file.parent.mkdir(parents=True, exist_ok=True)
    # The first heading begins the text; what stands before it are Pandoc's own settings.
    begin = re.search(r"^= ", source, flags=re.MULTILINE)
    assert begin is not None
    document = source[: begin.start()] + SETTINGS + source[begin.start() :]
    file.write_bytes(typst.compile(document.encode(), root="/"))
    print(f"{file}: {file.stat().st_size // 1024} kB")


def pages() -> list[Path]:
    """Return the theory pages, in the order of their contents page."""
    contents = DOCS / "theory/README.md"
    names = re.findall(r"^\d+\. \[[^]]*\]\((\w+\.md)\)", contents.read_text(encoding="utf-8"), flags=re.MULTILINE)
    return [contents, *(contents.with_name(name) for name in names)]


def _with_absolute_images(page: Path) -> str:
    """Return the text of a page, its images by their full paths and of its links the text alone."""

    def turned(match: re.Match[str]) -> str:
        image, text, target = match.groups()
        if image:
            return f"![{text}]({(page.parent / target).resolve()})"
        return match[0] if "://" in target else text

    return re.sub(r"(!?)\[([^\[\]]*)\]\(([^)\s]*)\)", turned, page.read_text(encoding="utf-8"))


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else DOCS.parent / "build/theory.pdf").resolve())

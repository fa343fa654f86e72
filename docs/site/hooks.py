"""Hooks of the documentation's build: pages and figures that live elsewhere, and pages made from the code.

Pages link to files of the repository by relative paths, so that they also work where the repository is
read. A few of those files lie outside of ``docs/``: figures, tables and the exported pages in
``results/published/``, and the change log. They join the site under their own paths, and links to them are
adapted. A notebook is a script with cells: its text and code become a page, and links to it lead there. Its
pictures lie beside it, made by ``make notebooks``.
"""

import posixpath
import re
import sys
from pathlib import Path
from typing import Any

import jupytext
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[2]
PUBLISHED = "results/published"
PAGES = ("CHANGELOG.md", "CONTRIBUTING.md", f"{PUBLISHED}/README.md")
NOTEBOOK = re.compile(r"^(notebooks/[^/]+)\.py$")
LINK = re.compile(r"(\]\()((?!\w+:|#)[^)\s#]+)")

sys.path.insert(0, str(ROOT))
sys.path.insert(0, str(Path(__file__).parent))

import generate  # noqa: E402  (the folder is no package)


def on_files(files: Files, config: Any) -> Files:
    """Add what lives outside of ``docs/`` and what is made from the code."""
    published = [path for path in (ROOT / PUBLISHED).rglob("*") if path.is_file() and path.suffix != ".md"]
    for name in [*PAGES, *(str(path.relative_to(ROOT)) for path in sorted(published))]:
        files.append(File(name, str(ROOT), config.site_dir, config.use_directory_urls))
    for script in sorted((ROOT / "docs" / "notebooks").glob("*.py")):
        page = jupytext.writes(jupytext.read(script, fmt="py:percent"), fmt="md")
        files.append(File.generated(config, f"notebooks/{script.stem}.md", content=page))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Adapt links to files outside of ``docs/``; replace the places of generated content by it."""
    here = page.file.src_uri
    outside = here in PAGES

    def adapt(match: re.Match[str]) -> str:
        folder = posixpath.dirname(here if outside else f"docs/{here}")
        target = posixpath.normpath(posixpath.join(folder, match[2]))
        if target.startswith("docs/"):
            target = NOTEBOOK.sub(r"\1.md", target.removeprefix("docs/"))
        elif target not in PAGES and not target.startswith(f"{PUBLISHED}/"):
            return match[0]
        return match[1] + posixpath.relpath(target, posixpath.dirname(here) or ".")

    text = LINK.sub(adapt, generate.fill(markdown))
    if script := NOTEBOOK.match(here.replace(".md", ".py")):
        name = posixpath.basename(script[0])
        text += f"\n\n[This page as a script]({name}), for Python, or for Jupyter by jupytext."
    return text

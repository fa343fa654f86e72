"""Pages: links lead somewhere, pages are short and have a figure, the glossary explains the terms."""

import re
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import pytest

from benchmarks.published_tables import list_pages, write_pages
from lagsplat.diagnose.effects.registry import catalogue

ROOT = Path(__file__).parents[1]
DOCS = sorted((ROOT / "docs").rglob("*.md"))
PAGES = [*sorted(ROOT.glob("*.md")), *DOCS, ROOT / "results" / "published" / "README.md"]
SHORT = [page for page in DOCS if page.parent.name != "measurements"]
LINK = re.compile(r"\]\(((?!https?:)[^)\s]+)\)")
FIGURE = re.compile(r"!\[[^\]]+\]\(([^)\s]+)\)")
TERMS = """actuation; held-out block; brush; chart; whitening; closure; conditioning; effect; evidence;
    excitation; floor; gaussian splat; identifiability; lagrangian; latent coordinate; multiple shooting;
    natural period; nrmse; operating point; prior; profile; pull-back; recording; rollout; sim-to-real gap;
    trajectory; verdict; visibility metric"""


def name_of(page: Path) -> str:
    return str(page.relative_to(ROOT))


def anchors(page: Path) -> set[str]:
    """The places inside a page that a link may name, as GitHub spells them."""
    titles = re.findall(r"^#+ (.+)$", page.read_text(), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_link_within_the_project_leads_somewhere(page: Path) -> None:
    for link in LINK.findall(page.read_text()):
        name, _, place = link.partition("#")
        target = page.parent / name if name else page
        assert target.exists(), f"{page.name} names {link}, which is not there"
        assert not place or place in anchors(target), (
            f"{page.name} names {link}; {target.name} has no such title"
        )


def test_every_page_is_reached_from_the_first() -> None:
    reached, waiting = set(), [ROOT / "README.md"]
    while waiting:
        page = waiting.pop()
        reached.add(page)
        links = {(page.parent / link.partition("#")[0]).resolve() for link in LINK.findall(page.read_text())}
        waiting += [link for link in links if link.suffix == ".md" and link not in reached]
    assert set(DOCS) <= reached, f"no link leads to {[name_of(page) for page in set(DOCS) - reached]}"


def test_the_contents_of_the_site_list_every_page() -> None:
    contents = (ROOT / "mkdocs.yml").read_text()
    for page in DOCS:
        assert f": {page.relative_to(ROOT / 'docs')}\n" in contents, f"mkdocs.yml does not list {page.name}"


@pytest.mark.parametrize("page", SHORT, ids=name_of)
def test_a_page_is_short_and_has_a_figure(page: Path) -> None:
    text = page.read_text()
    assert len(text.split()) < 800, f"{name_of(page)} has {len(text.split())} words; split it"
    assert FIGURE.search(text), f"{name_of(page)} has no figure"


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_figures_are_light(page: Path) -> None:
    for figure in FIGURE.findall(page.read_text()):
        most = 3_000_000 if figure.endswith(".gif") else 300_000
        assert (page.parent / figure).stat().st_size < most, f"{figure} is too heavy for a page"


def test_the_first_page_is_short() -> None:
    assert len((ROOT / "README.md").read_text().splitlines()) < 120


def test_published_results_are_few() -> None:
    files = [path for path in (ROOT / "results" / "published").rglob("*") if path.is_file()]
    assert sum(path.stat().st_size for path in files) <= 4_000_000


def test_tables_of_pages_are_those_of_the_published_files() -> None:
    assert len(list_pages()) >= 5
    assert write_pages("--check", "--diff") == 0, "make tables"


def test_the_glossary_explains_the_terms() -> None:
    page = (ROOT / "docs" / "reference" / "glossary.md").read_text()
    titles = " ".join(re.findall(r"^## (.+)$", page, flags=re.MULTILINE)).lower()
    for term in TERMS.split(";"):
        assert " ".join(term.split()) in titles, f"the glossary lacks {term.strip()}"
    for verdict in ("none", "unknown", "undetermined"):
        assert f"*{verdict}*" in page


def test_the_walks_are_short_and_each_file_belongs_to_its_walk() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text()
    walks = [re.findall(r"^\d+\. `(.+?)`", part, flags=re.MULTILINE) for part in page.split("## Walk ")[1:]]
    assert len(walks) == 2
    for walk in walks:
        assert len(walk) <= 12
        sources = [(ROOT / file).read_text() for file in walk]
        for file in walk[1:-1]:
            package, _, module = file.removesuffix(".py").replace("/", ".").rpartition(".")
            imported = re.compile(rf"{package}(\.| import .*\b){module}\b")
            assert any(imported.search(source) for source in sources), f"no file of the walk imports {file}"


@pytest.fixture(scope="module")
def generate() -> ModuleType:
    """What makes parts of the pages from the code."""
    spec = spec_from_file_location("generate", ROOT / "docs" / "site" / "generate.py")
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_catalogue_of_effects_is_complete(generate: ModuleType) -> None:
    page = generate.fill("<!-- generated: effects -->")
    assert sorted(re.findall(r"^### `(\w+)`", page, flags=re.MULTILINE)) == sorted(catalogue())


def test_every_public_name_is_described_once(generate: ModuleType) -> None:
    pages = [page.read_text() for page in (ROOT / "docs" / "reference" / "api").glob("*.md")]
    described = re.findall(r"^::: ([\w.]+)$", "\n".join(map(generate.fill, pages)), flags=re.MULTILINE)
    assert sorted(described) == sorted(f"{module}.{name}" for name, module in generate.public_names().items())

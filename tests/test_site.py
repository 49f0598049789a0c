"""The documentation site: it builds without warnings, and its pages fit small and large screens."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.doc_pages import DOCS

pytest.importorskip("sphinx", reason="pip install 'packit-sim[docs]'")
pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, as `make docs` builds it."""
    out = tmp_path_factory.mktemp("site")
    options = ["-q", "-W", "-n", "--keep-going", "-d", str(out / "doctrees")]
    built = subprocess.run(
        [sys.executable, "-m", "sphinx", *options, str(DOCS), str(out / "html")],
        capture_output=True,
        text=True,
    )
    assert built.returncode == 0, built.stderr
    return out / "html"


@pytest.mark.parametrize("width", [390, 1280])
def test_no_page_scrolls_sideways_or_loads_anything_from_elsewhere(chromium, site, width) -> None:
    shown = chromium.new_page(viewport={"width": width, "height": 900})
    asked: list[str] = []
    shown.on("request", lambda request: asked.append(request.url))
    pages = sorted(site.rglob("*.html"))
    assert len(pages) > 100
    too_wide = {}
    for page in pages:
        shown.goto(page.as_uri(), wait_until="domcontentloaded")
        wider = shown.evaluate(
            "document.documentElement.scrollWidth - document.documentElement.clientWidth"
        )
        if wider > 0:
            too_wide[page.relative_to(site).as_posix()] = wider
    shown.close()
    assert not too_wide
    assert {url.partition(":")[0] for url in asked} <= {"file", "data"}


def test_pages_have_different_titles_and_a_short_sidebar(site) -> None:
    titles: dict[str, str] = {}
    for page in sorted(set(site.rglob("*.html")) - {site / "search.html"}):
        name = page.relative_to(site).as_posix()
        text = page.read_text(encoding="utf-8")
        title = re.search(r"<title>(.*?)</title>", text, re.DOTALL)[1]
        assert titles.setdefault(title, name) == name, title
    front = (site / "index.html").read_text(encoding="utf-8")
    assert 20 < front.count('<li class="toctree-l1') <= 30
    assert front.index("I have parts") < front.index("I train agents") < front.index("It rebuilds")


def test_the_search_finds_what_newcomers_type(site) -> None:
    index = (site / "searchindex.js").read_text(encoding="utf-8")
    terms = json.loads(index[index.index("(") + 1 : index.rindex(")")])
    pack = terms["docnames"].index("guides/pack")
    for word in ("inch", "print", "bed", "carton", "step", "nest", "bin"):
        found = [terms[kind].get(word, []) for kind in ("terms", "titleterms")]
        assert any(pack in ([one] if isinstance(one, int) else one) for one in found), word


def test_pictures_of_examples_have_alternative_texts(site) -> None:
    index = (site / "gallery" / "index.html").read_text(encoding="utf-8")
    for example in DOCS.glob("examples/plot_*.py"):
        title = example.read_text(encoding="utf-8").splitlines()[1]
        page = (site / "gallery" / f"{example.stem}.html").read_text(encoding="utf-8")
        assert f'alt="{title}"' in page, example.name
        assert f'alt="{title}"' in index, example.name


def test_the_tables_of_the_leaderboard_fit(chromium, site) -> None:
    shown = chromium.new_page(viewport={"width": 1280, "height": 900})
    pages = [site / "benchmarks" / "leaderboard.html", *site.glob("benchmarks/boards/*.html")]
    assert len(pages) > 5
    for page in pages:
        shown.goto(page.as_uri())
        wider = shown.locator("table").evaluate_all(
            "all => all.map(one => one.scrollWidth - one.clientWidth)"
        )
        assert wider and max(wider) <= 0, page.name
    shown.close()


def test_the_gallery_has_a_picture_for_each_example(site) -> None:
    for example in DOCS.glob("examples/plot_*.py"):
        page = (site / "gallery" / f"{example.stem}.html").read_text(encoding="utf-8")
        assert "sphx-glr-single-img" in page or "sphx-glr-multi-img" in page, example.name


def test_the_commands_have_a_section_each(site) -> None:
    page = (site / "reference" / "cli.html").read_text(encoding="utf-8")
    for name in ("packit-evaluate", "packit-shapes-import", "packit-train"):
        assert f'id="{name}"' in page

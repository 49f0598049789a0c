"""The documentation site: it builds without warnings, and its pages fit small and large screens."""

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


def test_the_gallery_has_a_picture_for_each_example(site) -> None:
    for example in DOCS.glob("examples/plot_*.py"):
        page = (site / "gallery" / f"{example.stem}.html").read_text(encoding="utf-8")
        assert "sphx-glr-single-img" in page or "sphx-glr-multi-img" in page, example.name


def test_the_commands_have_a_section_each(site) -> None:
    page = (site / "reference" / "cli.html").read_text(encoding="utf-8")
    for name in ("packit-evaluate", "packit-shapes-import", "packit-train"):
        assert f'id="{name}"' in page

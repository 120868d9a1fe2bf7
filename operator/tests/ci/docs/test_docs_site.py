"""The site of `make docs`: its pages, its navigation, and the check that it loads nothing from elsewhere."""

from __future__ import annotations

from pathlib import Path

import pytest

from ci.docs import __main__ as docs
from ci.docs import links, loading, pages
from ci.errors import InputError, SetUpError

pytestmark = pytest.mark.processes

FILES = frozenset(
    {"README.md", "docs/page.md", "charts/app/README.md", "charts/app/values.yaml", "operator/src/x/chart/README.md"}
)
PAGES = frozenset(pages.Repository(FILES).pages())
FORGE = "https://forge.example.com/src"


def linked(text: str, address: str = "") -> str:
    return pages.linked("docs/page.md", text, PAGES, address)


def test_files_for_others_to_start_from_are_no_pages() -> None:
    assert sorted(PAGES) == ["README.md", "charts/app/README.md", "docs/page.md"]


def test_links_between_pages_and_to_elsewhere_stay() -> None:
    text = "[a](page.md#x) [b](#own) [c](https://example.org) `[d](../x)`\n\n```\n[e](../x)\n```\n"
    assert linked(text) == text


def test_pictures_stand_where_pages_show_them() -> None:
    there = frozenset([*PAGES, *pages.Repository(FILES | {"docs/images/a.webp", "docs/b.webp"}).pictures()])
    text = "![What it shows](images/a.webp)"
    assert pages.linked("docs/page.md", text, there, FORGE) == text
    assert pages.linked("README.md", "![A](docs/images/a.webp)", there) == "![A](docs/images/a.webp)"
    assert pages.linked("docs/page.md", "![B](b.webp)", there) == "!B (`docs/b.webp`)"  # not a picture of the site


@pytest.mark.parametrize(
    ("text", "without", "address"),
    [
        ("[top](../README.md#x)", "[top](../index.md#x)", "[top](../index.md#x)"),
        ("[chart](../charts/app)", "[chart](../charts/app/index.md)", "[chart](../charts/app/index.md)"),
        ("[chart](../charts/app/)", "[chart](../charts/app/index.md)", "[chart](../charts/app/index.md)"),
        ("[chart](../charts/app#x)", "[chart](../charts/app/index.md#x)", "[chart](../charts/app/index.md#x)"),
        (
            "[t][a] `[t][a]`\n\n[a]: ../README.md",
            "[t](../index.md) `[t][a]`\n\n[a]: ../README.md",
            "[t](../index.md) `[t][a]`\n\n[a]: ../README.md",
        ),
        ("[t](<../a b.py>)", "t (`a b.py`)", f"[t](<{FORGE}/a b.py>)"),
        ("a [test](../operator/x.py#L3) b", "a test (`operator/x.py`) b", f"a [test]({FORGE}/operator/x.py) b"),
        ("[`operator/x.py`](../operator/x.py)", "`operator/x.py`", f"[`operator/x.py`]({FORGE}/operator/x.py)"),
    ],
)
def test_links_to_folders_and_other_files_lead_to_their_index_or_the_forge_or_name_the_file(
    text: str, without: str, address: str
) -> None:
    assert linked(text) == without
    assert linked(text, FORGE) == linked(text, f"{FORGE}/") == address


def test_every_page_of_this_repository_is_in_the_contents_once() -> None:
    names = pages.Repository(frozenset(links.files())).pages()
    contents = pages.contents(names)
    assert list(contents) == list(pages.SECTIONS)
    assert sorted([pages.TOP, *(name for section in contents.values() for name in section)]) == sorted(names)


def test_a_repository_without_its_first_page_is_refused_in_words() -> None:
    with pytest.raises(SetUpError, match=r"no README\.md, the first page of the site; add it"):
        pages.site(pages.Repository(FILES - {"README.md"}), lambda name: "")


def test_the_first_page_has_the_contents() -> None:
    texts = pages.site(pages.Repository(FILES), lambda name: f"# {name}\n")
    assert sorted(texts) == ["charts/app/index.md", "docs/page.md", "index.md"]
    assert texts["docs/page.md"] == "# docs/page.md\n"
    assert ":caption: Charts\n\ncharts/app </charts/app/index>\n```" in texts["index.md"]
    assert ":caption: Project\n\n/docs/page\n```" in texts["index.md"]


@pytest.mark.parametrize(
    "html",
    [
        '<script src="https://cdn.example.org/x.js"></script>',
        '<link rel="stylesheet" href="//fonts.example.org/css">',
        '<link rel="preconnect" href="https://fonts.example.org">',
        '<img src="HTTPS://example.org/x.png">',
        '<img srcset="a.png 1x, https://example.org/b.png 2x">',
        '<iframe src="http://example.org"></iframe>',
        "<style>@import 'https://example.org/x.css';</style>",
        '<p style="background: url(//example.org/x.png)">',
        '<svg><use href="https://example.org/x.svg#y"/></svg>',
        "<style>@import url(https://example.org/x.css);</style>",
        '<style>a { background: image-set("https://example.org/x.png" 1x, "y.png" 2x) }</style>',
        '<script>import("https://example.org/x.js")</script>',
        '<script type="module">import x from "https://example.org/x.js"</script>',
        "<script>fetch('//example.org/x.json').then(show)</script>",
        "<script>request.open('GET', 'https://example.org/x')</script>",
        '<meta http-equiv="Refresh" content="0; url=https://example.org/">',
        '<base href="https://example.org/">',
        '<frameset><frame src="https://example.org/"></frameset>',
        "<iframe srcdoc='<img src=\"https://example.org/x.png\">'></iframe>",
        """<p onclick="location = 'https://example.org/'">""",
    ],
)
def test_what_is_loaded_from_elsewhere_is_found(html: str, tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "page.html").write_text(f"<html><body>{html}</body></html>", encoding="utf-8")
    loaded = list(loading.findings(tmp_path))
    assert len(loaded) == 1
    assert loaded[0].startswith("folder/page.html: ")


@pytest.mark.parametrize(
    "html",
    [
        '<a href="https://example.org">a link waits for a person</a>',
        '<link rel="canonical" href="https://example.org/page">',
        '<script src="../assets/x.js"></script><img src="data:image/png;base64,AA==">',
        "<code>url(https://example.org)</code>",
        "<style>.a { background: url(x.png) }</style>",
        "<style>/* @import url(https://example.org/x.css) */ @import url(x.css); @import 'y.css';</style>",
        "<script>import('./x.js'); fetch('/x.json'); let spec = 'https://example.org/'</script>",
        '<meta http-equiv="refresh" content="0; url=other.html"><meta name="x" content="url=https://example.org">',
    ],
)
def test_what_is_not_loaded_is_no_finding(html: str) -> None:
    assert loading.in_page(html) == []


def test_style_sheets_and_scripts_are_read(tmp_path: Path) -> None:
    (tmp_path / "good.css").write_text("a { background: url(data:image/svg+xml;x) } b { src: url(../f.woff2) }")
    (tmp_path / "wrong.css").write_text('@font-face { src: url("https://fonts.example.org/f.woff2") }')
    (tmp_path / "wrong.js").write_text("import x from 'https://example.org/x.js'\n")
    assert list(loading.findings(tmp_path)) == [
        "wrong.css: https://fonts.example.org/f.woff2",
        "wrong.js: https://example.org/x.js",
    ]


@pytest.mark.parametrize(
    "rule",
    [
        "@import url(https://fonts.example/a.css);",
        "@import url( 'https://fonts.example/a.css' );",
        '@import "https://fonts.example/a.css" screen;',
        "@import'https://fonts.example/a.css';",
        "a { background: image-set(url(https://fonts.example/a.css) 1x) }",
        "a { background: -webkit-image-set('https://fonts.example/a.css' 1x) }",
    ],
)
def test_every_form_of_an_address_in_a_style_sheet_is_found_once(rule: str) -> None:
    assert loading.in_style(rule) == ["https://fonts.example/a.css"]


def generator(monkeypatch: pytest.MonkeyPatch, folder: Path, script: str) -> None:
    """Has `script` stand for the generator; it writes into $site."""
    program = folder / "generator"
    program.write_text(f"#!/bin/sh\nsite={folder}/output/site; mkdir -p $site\n{script}\n")
    program.chmod(0o755)
    monkeypatch.setattr(docs, "OUTPUT", folder / "output")
    monkeypatch.setattr(docs, "generator", lambda: program)


def test_a_site_is_built_from_pages_and_settings(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    generator(monkeypatch, tmp_path, 'echo "<p>good</p>" > $site/index.html')
    assert docs.build("") == tmp_path / "output" / "site"
    written = tmp_path / "output" / "pages"
    pictures = [name for name in links.files() if name.startswith(pages.PICTURES)]
    assert pictures
    for name in ("index.md", "docs/decisions/index.md", "CHANGELOG.md", "conf.py", "_static/site.css", *pictures):
        assert (written / name).is_file(), name


@pytest.mark.parametrize(
    ("script", "words"),
    [
        ("echo 'page.md:3: WARNING: not found' >&2; exit 1", "page.md:3: WARNING: not found\nThe site was not built"),
        ("echo '<script src=\"https://example.org/x.js\">' > $site/x.html", "x.html: <script src> https://example.org"),
    ],
)
def test_a_wrong_page_or_something_foreign_is_refused(
    script: str, words: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    generator(monkeypatch, tmp_path, script)
    with pytest.raises(InputError) as refusal:
        docs.build("")
    assert words in str(refusal.value)

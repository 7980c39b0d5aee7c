"""The documentation is true: its examples run, its made pages are those of the code, its site asks nobody for anything.

Commands run in a folder with the examples; what two pages have in common runs once. A command that would take minutes runs
at its least: one perturbed trial, clips of a few pictures; benchmarks are read here and run in test_bench.py and
test_benchmarks.py, targets of make are read by make.
"""

import contextlib
import functools
import hashlib
import io
import re
import shlex
import shutil
import subprocess
import sys
import types
import webbrowser
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import urlparse

import pytest
import yaml
from PIL import Image

from pages import commands, fields, gallery
from pages.__main__ import MADE
from regrasp.cli import main
from regrasp.commands import measuring, viewing
from regrasp.control.controller import Control
from regrasp.planner.task import Settings
from regrasp.scene.load import Loader, builtin, validate
from regrasp.scene.schema import Scene
from regrasp.settings import read
from regrasp.view import clip, show
from tests.browser import Browser

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
BLOCK = re.compile(r"^```(sh|python|yaml|console)\n(.*?)^```", re.DOTALL | re.MULTILINE)
PAGES = [page for page in (ROOT / "README.md", *sorted(DOCS.glob("*.md"))) if BLOCK.search(page.read_text("utf-8"))]
BASE = {
    "name": "base", "model": {"hand": "puma"}, "object": {"shape": "sphere", "size": [0.03], "mass": 0.1},
    "start": {"pose": {"position": [0, 0, 0.15]}}, "goal": {"pose": {"position": [0, 0, 0.16]}},
}  # fmt: skip


class Runner:
    """Runs commands; one that has run with the same inputs gives what it gave before."""

    def __init__(self, store: Path) -> None:
        self.store, self.done = store, {}

    def __call__(self, arguments: list[str]) -> tuple[int, str]:
        if "--trials" in arguments:
            arguments[arguments.index("--trials") + 1] = "1"
        out = arguments[arguments.index("-o") + 1] if "-o" in arguments else ""
        inputs = [hashlib.sha1(Path(a).read_bytes()).hexdigest() for a in arguments if a != out and Path(a).is_file()]
        key = (*(Path(a).suffix if a == out else a for a in arguments), *inputs)
        if key not in self.done:
            said = io.StringIO()
            with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
                code = main(arguments)
            kept = self.store / f"{len(self.done)}{Path(out).suffix}"
            if out and Path(out).is_file():
                shutil.copy(out, kept)
            self.done[key] = code, said.getvalue(), kept
        code, text, kept = self.done[key]
        if out and kept.is_file():
            shutil.copy(kept, out)
        return code, text


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Runner:
    return Runner(tmp_path_factory.mktemp("made"))


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    """Where examples are at hand, pictures small, clips short, pages served for a moment, and benchmarks that are not run."""
    shutil.copytree(ROOT / "examples", tmp_path / "examples")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(clip, "FORMS", {suffix: clip.Form(320, 100, 3) for suffix in clip.FORMS})
    monkeypatch.setattr(show, "WIDTH", 320)
    monkeypatch.setattr(viewing, "_wait", lambda: None)
    monkeypatch.setattr(webbrowser, "open", lambda url: True)
    bench = types.SimpleNamespace(**{name: lambda seeds, **_: {} for name in measuring.BENCHES})
    monkeypatch.setattr(measuring, "importlib", types.SimpleNamespace(import_module=lambda name: bench))
    return tmp_path


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_example_of_a_page_runs(page, run, folder):
    names = {"__name__": page.stem}
    for kind, text in BLOCK.findall(page.read_text(encoding="utf-8")):
        if kind == "python":
            with contextlib.redirect_stdout(io.StringIO()):
                exec(compile(text, str(page), "exec"), names)
        elif kind == "yaml":
            take(yaml.load(text, Loader), text)
        elif kind == "sh":
            for line in text.splitlines():
                if arguments := shlex.split(line, comments=True):
                    obey(arguments, run)
        else:
            console(text, run)


def obey(arguments: list[str], run: Runner) -> None:
    """Run a line of a shell as far as is cheap."""
    program, *rest = arguments
    if program == "make":
        assert subprocess.run(["make", "-n", *rest], cwd=ROOT, capture_output=True).returncode == 0, arguments
    elif rest[:2] == ["-m", "benchmarks"]:
        assert all(word in benchmarks_help() for word in rest if word.startswith("-") and word != "-m")
    else:
        assert program == "regrasp", arguments
        code, said = run(rest)
        # A plan that may take only so long may not be there yet on a busy machine.
        assert code == 0 or ("--time-limit" in rest and code == 1), (arguments, said)


@functools.cache
def benchmarks_help() -> str:
    """What `python -m benchmarks --help` prints."""
    command = [sys.executable, "-m", "benchmarks", "--help"]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True).stdout


def console(text: str, run: Runner) -> None:
    """Run commands after `$`, and find the lines shown below them; `…` stands for lines left out."""
    printed: list[str] = []
    for line in text.splitlines():
        if line.startswith("$ regrasp "):
            code, said = run(shlex.split(line.removeprefix("$ regrasp ")))
            assert code == 0, said
            printed = said.splitlines()
        elif line != "…":
            assert line in printed


def take(part: dict, text: str) -> None:
    """Read a scene, which commands then find under its name, or a part of one."""
    if "start" in part:
        Path(f"{part['name']}.yaml").write_text(text, encoding="utf-8")
        validate(part)
    else:
        own = {"model": {"file": "robot.xml"}} if "agents" in part else {}
        validate(BASE | own | part)
    read(Settings, part.get("planner", {}))
    read(Control, part.get("control", {}))


def test_the_scene_of_the_own_hand_page_is_the_example_and_short():
    shown = (DOCS / "own-hand.md").read_text("utf-8").split("```yaml\n")[1].split("```")[0]
    assert shown == (ROOT / "examples" / "claw.yaml").read_text(encoding="utf-8")
    assert len(shown.splitlines()) <= 30


@pytest.mark.parametrize("name", MADE)
def test_a_page_made_from_the_code_is_in_step_with_it(name):
    assert (DOCS / name).read_text(encoding="utf-8") == MADE[name](), "run python -m pages"


def test_the_made_pages_tell_every_command_and_every_field():
    told = commands.page()
    for name in measuring.BENCHES:
        assert name in told
    for flag in ("--time-limit", "--planner.local.annealing.iterations", "--trials", "--what"):
        assert flag in told
    table = fields.page()
    defs = Scene.model_json_schema()["$defs"]
    for part in (Scene.model_json_schema(), *defs.values()):
        for key in part["properties"]:
            assert f"| `{key}` |" in table
    # The page in words says something of each of them.
    words = (DOCS / "scenes.md").read_text("utf-8")
    assert [key for part in defs.values() for key in part["properties"] if f"`{key}`" not in words] == []


def test_the_gallery_has_every_built_in_scene_and_what_it_shows_is_small():
    text = (DOCS / "gallery.md").read_text(encoding="utf-8")
    assert re.findall(r"^## (.*)$", text, re.MULTILINE) == list(builtin())
    for name in builtin():
        with Image.open(DOCS / "img" / f"{name}.png") as picture:
            assert picture.width >= gallery.WIDTH
    for file in (DOCS / "img").iterdir():
        assert file.stat().st_size < (150e3 if file.suffix == ".png" else 2**20), file


class Requests(HTMLParser):
    """Addresses that a page makes a browser fetch."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        if tag != "a" and not (tag == "link" and given.get("rel") == "canonical"):
            self.found += [given[key] for key in ("src", "href", "poster") if given.get(key)]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("docs") / "site"
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return folder


def test_the_site_is_whole_and_names_nobody_to_ask(site):
    shown = {path.stem for path in site.glob("*.html")} - {"404"}
    assert shown == {path.stem for path in DOCS.glob("*.md")}
    for path in site.glob("*.html"):
        parser = Requests()
        parser.feed(path.read_text(encoding="utf-8"))
        assert parser.found
        for address in parser.found:
            assert not urlparse(address).netloc, (path.name, address)
            if path.stem != "404" and not address.startswith(("#", "data:")):
                assert (path.parent / urlparse(address).path).exists(), (path.name, address)
    for style in site.rglob("*.css"):
        assert not re.search(r"url\(['\"]?https?:|@import", style.read_text(encoding="utf-8"))


def test_the_site_asks_nobody_for_anything(site, tmp_path):
    page = Browser(tmp_path / "profile")
    try:
        for path in site.glob("*.html"):
            page.open(path.as_uri(), f"location.href === '{path.as_uri()}' && document.readyState === 'complete'")
        assert len(page.requests) > len(list(site.glob("*.html")))
        assert {urlparse(address).scheme for address in page.requests} <= {"file", "data", "blob"}
    finally:
        page.close()


def test_links_between_the_pages_and_to_files_lead_somewhere():
    for page in (ROOT / "README.md", ROOT / "CHANGELOG.md", *DOCS.glob("*.md")):
        for address in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
            if not urlparse(address).netloc and urlparse(address).path:
                assert (page.parent / urlparse(address).path).exists(), (page.name, address)
